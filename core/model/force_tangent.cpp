#include "model/force_tangent.hpp"

#include "base/tolerances.hpp"
#include "model/compliance.hpp"
#include "model/coordinates.hpp"
#include "model/point_jacobian.hpp"

namespace contactvi {

namespace {

// d2V/dx2 of a joint's polynomial.
double curvature(const JointPotential& potential, double x) {
  double value = 0.0;
  for (std::size_t k = potential.coefficients.size(); k-- > 0;) {
    const double n = static_cast<double>(k) + 2.0;
    value = value * x + n * (n - 1.0) * potential.coefficients[k];
  }
  return value;
}

}  // namespace

ForceTangent::ForceTangent(const Tree& tree)
    : tree_(&tree),
      any_(tree.elements.any_force()),
      bodies_(tree),
      wrenches_(tree.elements.wrenches.size()),
      forces_(tree.elements.forces.size()),
      potentials_(tree.elements.potentials.size()),
      dq_(tree.nv),
      dv_(tree.nv),
      change_(tree.nv) {
  for (std::vector<User>* users : {&forces_, &potentials_})
    for (User& user : *users) user = {VecX::Zero(tree.nv), MatX::Zero(tree.nv, tree.nv), MatX::Zero(tree.nv, tree.nv)};
}

ForceTangent::Point ForceTangent::point(const BodyFrame& frame) const {
  Point at = {world_point(bodies_.placements(), frame.body, frame.p_B), Vec3::Zero(), Vec3::Zero(), Vec3::Zero()};
  if (frame.body < 0) return at;
  const Twist &V = bodies_.speed(frame.body), &D = bodies_[frame.body], &dV = bodies_.speed_moved(frame.body);
  at.moved = D.lin + D.ang.cross(at.x);
  at.speed = V.lin + V.ang.cross(at.x);
  at.speed_moved = dV.lin + dV.ang.cross(at.x) + V.ang.cross(at.moved);
  return at;
}

void ForceTangent::add_wrench(int body, const Point& at, const Vec3& F, const Vec3& dF, const Vec3& T, const Vec3& dT,
                              VecRef df) {
  bodies_.add_wrench(body, at.x, at.moved, F, dF, T, dT, df);
}

void ForceTangent::add_springs(VecRef df) {
  for (const PathSpring& spring : tree_->elements.path_springs) {
    double length = 0.0, speed = 0.0, d_length = 0.0, d_speed = 0.0;
    const std::size_t parts = spring.points.size() - 1;
    for (std::size_t i = 0; i < parts; ++i) {
      const Point a = point(spring.points[i]), b = point(spring.points[i + 1]);
      const Vec3 d = b.x - a.x, moved = b.moved - a.moved, rate = b.speed - a.speed;
      const double part = d.norm();
      length += part;
      if (part <= kLeastDivisor) continue;
      const Vec3 n = d / part, dn = (moved - n * n.dot(moved)) / part;
      speed += n.dot(rate);
      d_length += n.dot(moved);
      d_speed += dn.dot(rate) + n.dot(b.speed_moved - a.speed_moved);
    }
    if (spring.tension_only && length <= spring.rest_length) continue;
    const double pull = spring.stiffness * (length - spring.rest_length) + spring.damping * speed;
    if (spring.tension_only && pull <= 0.0) continue;
    const double d_pull = spring.stiffness * d_length + spring.damping * d_speed;
    const Vec3 none = Vec3::Zero();
    for (std::size_t i = 0; i < parts; ++i) {
      const Point a = point(spring.points[i]), b = point(spring.points[i + 1]);
      const Vec3 d = b.x - a.x, moved = b.moved - a.moved;
      const double part = d.norm();
      if (part <= kLeastDivisor) continue;
      const Vec3 n = d / part, dn = (moved - n * n.dot(moved)) / part;
      const Vec3 F = pull * n, dF = d_pull * n + pull * dn;
      add_wrench(spring.points[i].body, a, F, dF, none, none, df);
      add_wrench(spring.points[i + 1].body, b, -F, -dF, none, none, df);
    }
  }
}

void ForceTangent::take_compliances() {
  pressing_.clear();
  const std::vector<CompliantContact>& contacts = tree_->elements.compliances;
  if (contacts.empty()) return;
  const VecX none = VecX::Zero(v_.size());
  bodies_.move(v_, none, none);
  const auto velocity = [&](int body, const Vec3& x) {
    return body < 0 ? Vec3(Vec3::Zero()) : Vec3(bodies_.speed(body).lin + bodies_.speed(body).ang.cross(x));
  };
  std::vector<Pressing> met;
  std::vector<AskedPress> asked;
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    const CompliantContact& c = contacts[k];
    const Placements& at = bodies_.placements();
    const TouchPose<double> A = touch_pose(at, c.body_a), B = touch_pose(at, c.body_b);
    if (least_gap(*c.shapes, A, B) > 0.0) continue;
    const NearestFeatures found = nearest_touch(*c.shapes, A, B);
    const Touch<double> now = touch(found.a, found.b, A, B);
    if (!(now.gap < 0.0)) continue;
    met.push_back({k, found, {}});
    asked.push_back(asked_press(c.law, now, velocity(c.body_a, now.point) - velocity(c.body_b, now.point)));
  }
  ask(asked, true);
  for (std::size_t i = 0; i < met.size(); ++i) {
    met[i].given = asked[i].given;
    if (presses(*asked[i].law, -asked[i].depth, asked[i].along, asked[i].given)) pressing_.push_back(met[i]);
  }
}

// With dual numbers, whose derivatives are those along the direction.
void ForceTangent::add_compliances(VecRef df) {
  const Placements& at = bodies_.placements();
  const auto moved = [&](int body) {
    TouchPose<DualNumber> pose;
    if (body < 0) return pose;
    const Twist& D = bodies_[body];
    pose.R = dual(at.R_W[body], skew(D.ang) * at.R_W[body]);
    pose.p = dual(at.p_W[body], D.lin + D.ang.cross(at.p_W[body]));
    return pose;
  };
  const auto velocity = [&](int body, const Dual3& x) {
    if (body < 0) return Dual3(Dual3::Zero());
    const Twist &V = bodies_.speed(body), &dV = bodies_.speed_moved(body);
    return Dual3(dual(V.lin, dV.lin) + Dual3(dual(V.ang, dV.ang)).cross(x));
  };
  const Vec3 none = Vec3::Zero();
  for (const Pressing& pressing : pressing_) {
    const CompliantContact& c = tree_->elements.compliances[pressing.contact];
    const Touch<DualNumber> now = touch(pressing.features.a, pressing.features.b, moved(c.body_a), moved(c.body_b));
    const Dual3 speed = velocity(c.body_a, now.point) - velocity(c.body_b, now.point);
    const PressOf<DualNumber> acts = press_of(c.law, now, speed, pressing.given);
    const Vec3 F = value(acts.force), dF = derivative(acts.force), x = value(now.point), dx = derivative(now.point);
    bodies_.add_wrench(c.body_a, x, dx, F, dF, none, none, df);
    bodies_.add_wrench(c.body_b, x, dx, -F, -dF, none, none, df);
  }
}

void ForceTangent::add_wrenches(VecRef df) {
  for (std::size_t k = 0; k < wrenches_.size(); ++k) {
    const AppliedWrench& wrench = tree_->elements.wrenches[k];
    const Eigen::Matrix<double, 6, 1>& value = wrenches_[k];
    Vec3 F = value.head<3>(), T = value.tail<3>(), dF = Vec3::Zero(), dT = Vec3::Zero();
    const int body = wrench.at.body;
    if (!wrench.world_axes) {
      const Mat3 R = world_axes(bodies_.placements(), body, wrench.at.R_B);
      F = R * F;
      T = R * T;
      if (body >= 0) {
        dF = bodies_[body].ang.cross(F);
        dT = bodies_[body].ang.cross(T);
      }
    }
    add_wrench(body, point(wrench.at), F, dF, T, dT, df);
  }
}

void ForceTangent::add_users(const VecCRef& dq, const VecCRef& dv, VecRef df) {
  if (forces_.empty() && potentials_.empty()) return;
  dq_ = dq;
  engine_to_public(*tree_, q_, dq_);
  dv_ = dv;
  engine_to_public_tangent(*tree_, q_, dq, v_, dv_);
  for (const User& user : forces_) {
    change_.noalias() = user.by_q * dq_ + user.by_v * dv_;
    public_to_engine_tangent(*tree_, q_, dq, user.force, change_);
    df += change_;
  }
  for (const User& user : potentials_) {
    change_.noalias() = user.by_q * dq_;
    public_to_engine_tangent(*tree_, q_, dq, user.force, change_);
    df -= change_;
  }
}

void ForceTangent::take(double t, const VecCRef& q, const VecCRef& v) {
  if (!any_) return;
  const Elements& e = tree_->elements;
  q_ = q;
  v_ = v;
  if (!e.path_springs.empty() || !e.compliances.empty() || !e.wrenches.empty()) bodies_.place(q);
  take_compliances();
  for (std::size_t k = 0; k < wrenches_.size(); ++k)
    wrenches_[k] = e.wrenches[k].signal ? e.wrenches[k].signal(t) : e.wrenches[k].value;
  if (forces_.empty() && potentials_.empty()) return;
  public_v_ = v;
  engine_to_public(*tree_, q, public_v_);
  for (std::size_t k = 0; k < forces_.size(); ++k) {
    if (!e.forces[k].derivative) continue;
    e.forces[k].value(t, q_, public_v_, forces_[k].force);
    e.forces[k].derivative(t, q_, public_v_, forces_[k].by_q, forces_[k].by_v);
  }
  for (std::size_t k = 0; k < potentials_.size(); ++k) {
    if (!e.potentials[k].hessian) continue;
    e.potentials[k].gradient(q_, potentials_[k].force);
    e.potentials[k].hessian(q_, potentials_[k].by_q);
  }
}

void ForceTangent::add(const VecCRef& dq, const VecCRef& dv, VecRef df) {
  if (!any_) return;
  const Elements& e = tree_->elements;
  for (const JointPotential& p : e.joint_potentials) {
    const Joint& joint = tree_->joints[p.joint];
    df[joint.iv] -= curvature(p, q_[joint.iq] - p.rest) * dq[joint.iv];
  }
  if (!e.path_springs.empty() || !pressing_.empty() || !e.wrenches.empty()) {
    bodies_.move(v_, dq, dv);
    add_springs(df);
    add_compliances(df);
    add_wrenches(df);
  }
  add_users(dq, dv, df);
}

}  // namespace contactvi
