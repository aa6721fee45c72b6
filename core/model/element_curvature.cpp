#include "model/element_curvature.hpp"

#include "base/tolerances.hpp"

namespace contactvi {

namespace {

DualTwist operator-(const DualTwist& a, const DualTwist& b) { return {a.ang - b.ang, a.lin - b.lin}; }
DualTwist cross(const DualTwist& a, const DualTwist& b) {
  return {a.ang.cross(b.ang), a.ang.cross(b.lin) + a.lin.cross(b.ang)};
}
Dual3 at_point(const DualTwist& V, const Dual3& x) { return V.lin + V.ang.cross(x); }

// d3V/dx3 of a joint's polynomial.
double third_derivative(const JointPotential& potential, double x) {
  double value = 0.0, power = 1.0;
  for (std::size_t k = 1; k < potential.coefficients.size(); ++k) {
    const double n = static_cast<double>(k) + 2.0;
    value += n * (n - 1.0) * (n - 2.0) * potential.coefficients[k] * power;
    power *= x;
  }
  return value;
}

}  // namespace

MovingBodies::MovingBodies(const Tree& tree)
    : tree_(&tree), bodies_(tree), R_(tree.joints.size()), p_(tree.joints.size()) {
  for (auto& motion : motion_) motion.resize(tree.joints.size());
}

DualTwist MovingBodies::axis(int joint, int d) const {
  const DualMat3& R = R_[joint];
  const Dual3& p = p_[joint];
  switch (tree_->joints[joint].type) {
    case JointType::kRevolute:
    case JointType::kContinuous:
      return {R.col(2), p.cross(R.col(2))};
    case JointType::kPrismatic:
      return {Dual3::Zero(), R.col(2)};
    case JointType::kHelical:
      return {R.col(2), p.cross(R.col(2)) + DualNumber(tree_->joints[joint].pitch) * R.col(2)};
    case JointType::kTranslation:
      return {Dual3::Zero(), R.col(d)};
    default:
      return {R.col(d), p.cross(R.col(d))};
  }
}

void MovingBodies::take(const VecCRef& q, const VecCRef& dq, const DualX& v, const DualX& u) {
  bodies_.place(q);
  bodies_.move(dq);
  const Placements& at = bodies_.placements();
  for (int i = 0; i < static_cast<int>(tree_->joints.size()); ++i) {
    const Joint& joint = tree_->joints[i];
    const Twist& moved = bodies_[i];
    R_[i] = dual(at.R_W[i], skew(moved.ang) * at.R_W[i]);
    p_[i] = dual(at.p_W[i], moved.lin + moved.ang.cross(at.p_W[i]));
    for (int k = 0; k < 2; ++k) {
      const DualX& w = k == 0 ? v : u;
      DualTwist& total = motion_[k][i];
      total = joint.parent < 0 ? DualTwist{Dual3::Zero(), Dual3::Zero()} : motion_[k][joint.parent];
      for (int d = 0; d < joint.nv; ++d) {
        const DualTwist S = axis(i, d);
        total.ang += w[joint.iv + d] * S.ang;
        total.lin += w[joint.iv + d] * S.lin;
      }
    }
  }
}

DualMat3 MovingBodies::axes(const BodyFrame& frame) const {
  const DualMat3 R_B = frame.R_B.cast<DualNumber>();
  return frame.body < 0 ? R_B : DualMat3(R_[frame.body] * R_B);
}

MovingPoint MovingBodies::point(int body, const Vec3& p_B) const {
  const Dual3 own = p_B.cast<DualNumber>();
  if (body < 0) return {own, Dual3::Zero(), Dual3::Zero()};
  const Dual3 x = p_[body] + R_[body] * own;
  return {x, at_point(motion_[0][body], x), at_point(motion_[1][body], x)};
}

void MovingBodies::add_row(int body, const Dual3& x, const Dual3& n, DualX& W) const {
  for (int j = body; j >= 0; j = tree_->joints[j].parent) {
    const Joint& joint = tree_->joints[j];
    for (int d = 0; d < joint.nv; ++d) W[joint.iv + d] += n.dot(at_point(axis(j, d), x));
  }
}

// A joint turns all motions beyond it, its own included, and moves the point.
void MovingBodies::add_point(int body, const MovingPoint& at, const MovingPoint& bar, DualX& lq, DualX& lv) const {
  for (int j = body; j >= 0; j = tree_->joints[j].parent) {
    const Joint& joint = tree_->joints[j];
    for (int d = 0; d < joint.nv; ++d) {
      const DualTwist S = axis(j, d);
      const Dual3 moved = at_point(S, at.x);
      DualNumber sum = bar.x.dot(moved);
      for (int k = 0; k < 2; ++k) {
        const DualTwist& V = motion_[k][body];
        const DualTwist beyond = joint.parent < 0 ? V : V - motion_[k][joint.parent];
        const Dual3 change = at_point(cross(S, beyond), at.x) + V.ang.cross(moved);
        sum += (k == 0 ? bar.v : bar.u).dot(change);
      }
      lq[joint.iv + d] += sum;
      lv[joint.iv + d] += bar.v.dot(moved);
    }
  }
}

void MovingBodies::add_turn(int body, const Dual3& of_spin, const Dual3& of_turn, DualX& lq) const {
  for (int j = body; j >= 0; j = tree_->joints[j].parent) {
    const Joint& joint = tree_->joints[j];
    const DualTwist& V = motion_[1][body];
    const Dual3 beyond = joint.parent < 0 ? V.ang : Dual3(V.ang - motion_[1][joint.parent].ang);
    for (int d = 0; d < joint.nv; ++d) {
      const DualTwist S = axis(j, d);
      lq[joint.iv + d] += of_spin.dot(S.ang.cross(beyond)) + of_turn.dot(S.ang);
    }
  }
}

ElementCurvature::ElementCurvature(const Tree& tree)
    : tree_(&tree),
      any_(tree.elements.any_force()),
      bodies_(tree),
      v_(tree.nv),
      u_(tree.nv),
      lq_(tree.nv),
      lv_(tree.nv) {}

// -pull(l, l') (dl/dq . u), with the length l and its rates along v and u.
void ElementCurvature::add_spring(const PathSpring& spring) {
  const DualNumber k = spring.stiffness, c = spring.damping;
  DualNumber length = 0.0, speed = 0.0, along = 0.0;
  points_.clear();
  for (const BodyFrame& frame : spring.points) points_.push_back(bodies_.point(frame.body, frame.p_B));
  const auto direction = [&](std::size_t i, DualNumber& part) {
    const Dual3 d = points_[i + 1].x - points_[i].x;
    part = sqrt(d.dot(d));
    return Dual3(d / (part.x <= kLeastDivisor ? DualNumber(1.0) : part));
  };
  for (std::size_t i = 0; i + 1 < points_.size(); ++i) {
    DualNumber part;
    const Dual3 n = direction(i, part);
    if (part.x <= kLeastDivisor) continue;  // it has no direction, and between two points no force either
    length += part;
    speed += n.dot(points_[i + 1].v - points_[i].v);
    along += n.dot(points_[i + 1].u - points_[i].u);
  }
  if (spring.tension_only && length.x <= spring.rest_length) return;
  const DualNumber pull = k * (length - spring.rest_length) + c * speed;
  if (spring.tension_only && pull.x <= 0.0) return;
  for (std::size_t i = 0; i + 1 < points_.size(); ++i) {
    DualNumber part;
    const Dual3 n = direction(i, part);
    if (part.x <= kLeastDivisor) continue;
    const MovingPoint &a = points_[i], &b = points_[i + 1];
    const Dual3 of_n = (-c * along) * (b.v - a.v) - pull * (b.u - a.u);
    MovingPoint bar;
    bar.x = (-k * along) * n + (of_n - n * n.dot(of_n)) / part;
    bar.v = (-c * along) * n;
    bar.u = -pull * n;
    bodies_.add_point(spring.points[i + 1].body, b, bar, lq_, lv_);
    bodies_.add_point(spring.points[i].body, a, {-bar.x, -bar.v, -bar.u}, lq_, lv_);
  }
}

void ElementCurvature::add_wrench(double t, const AppliedWrench& wrench) {
  const int body = wrench.at.body;
  if (body < 0) return;
  const Eigen::Matrix<double, 6, 1> given = wrench.signal ? wrench.signal(t) : wrench.value;
  Dual3 force = Vec3(given.head<3>()).cast<DualNumber>(), torque = Vec3(given.tail<3>()).cast<DualNumber>();
  const MovingPoint at = bodies_.point(body, wrench.at.p_B);
  Dual3 of_turn = Dual3::Zero();
  if (!wrench.world_axes) {
    const DualMat3 R = bodies_.axes(wrench.at);
    force = (R * force).eval();
    torque = (R * torque).eval();
    of_turn = force.cross(at.u) + torque.cross(bodies_.of_u(body).ang);
  }
  bodies_.add_point(body, at, {Dual3::Zero(), Dual3::Zero(), force}, lq_, lv_);
  bodies_.add_turn(body, torque, of_turn, lq_);
}

void ElementCurvature::add(double t, const VecCRef& q, const VecCRef& v, const VecCRef& dq, const VecCRef& dv,
                           const VecCRef& f_bar, VecRef lq, VecRef lv) {
  if (!any_) return;
  const Elements& e = tree_->elements;
  for (const JointPotential& p : e.joint_potentials) {
    const Joint& joint = tree_->joints[p.joint];
    lq[joint.iv] -= third_derivative(p, q[joint.iq] - p.rest) * dq[joint.iv] * f_bar[joint.iv];
  }
  if (e.path_springs.empty() && e.wrenches.empty()) return;
  v_ = dual(v, dv);
  u_ = f_bar.cast<DualNumber>();
  lq_.setZero();
  lv_.setZero();
  bodies_.take(q, dq, v_, u_);
  for (const PathSpring& spring : e.path_springs) add_spring(spring);
  for (const AppliedWrench& wrench : e.wrenches) add_wrench(t, wrench);
  lq += derivative(lq_);
  lv += derivative(lv_);
}

}  // namespace contactvi
