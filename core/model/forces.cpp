#include "model/forces.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "model/coordinates.hpp"
#include "model/point_jacobian.hpp"

namespace contactvi {

namespace {

constexpr double kDifference = 2e-5;  // [m; rad] by which a configuration moves for a difference

// V, dV/dx and d2V/dx2 of a joint's polynomial.
struct Polynomial {
  double value = 0, slope = 0, curvature = 0;
  Polynomial(const JointPotential& potential, double x) {
    const auto& c = potential.coefficients;
    for (std::size_t k = c.size(); k-- > 0;) {
      const double n = static_cast<double>(k) + 2.0;
      value = value * x + c[k];
      slope = slope * x + n * c[k];
      curvature = curvature * x + n * (n - 1.0) * c[k];
    }
    value *= x * x;
    slope *= x;
  }
};

bool in_reach(const PathSpring& spring, double length) { return !spring.tension_only || length > spring.rest_length; }

}  // namespace

ForceField::ForceField(const Tree& tree)
    : tree_(&tree),
      at_(tree),
      any_(tree.elements.any_force()),
      row_(tree.nv),
      q_(tree.nq),
      v_(tree.nv),
      force_(tree.nv),
      q_side_(tree.nq),
      v_side_(tree.nv) {
  const Elements& e = tree.elements;
  stiff_columns_ = static_cast<int>(e.path_springs.size() + e.joint_potentials.size());
  bool derivatives = false;
  for (const UserForce& force : e.forces) derivatives |= static_cast<bool>(force.derivative);
  for (const UserPotential& potential : e.potentials) derivatives |= static_cast<bool>(potential.hessian);
  if (!derivatives) return;
  user_column_ = stiff_columns_;
  stiff_columns_ += tree.nv;
  first_.resize(tree.nv, tree.nv);
  second_.resize(tree.nv, tree.nv);
}

// Length of the path at the placed configuration, and its gradient.
double ForceField::length(const PathSpring& spring, VecRef gradient) const {
  gradient.setZero();
  double total = 0.0;
  for (std::size_t i = 0; i + 1 < spring.points.size(); ++i) {
    const BodyFrame &a = spring.points[i], &b = spring.points[i + 1];
    const Vec3 x_a = world_point(at_, a.body, a.p_B), x_b = world_point(at_, b.body, b.p_B), d = x_b - x_a;
    const double part = d.norm();
    total += part;
    if (part <= kLeastDivisor) continue;  // it has no direction, and between two points no force either
    add_point_row(*tree_, at_, b.body, x_b, d / part, 1.0, gradient);
    add_point_row(*tree_, at_, a.body, x_a, d / part, -1.0, gradient);
  }
  return total;
}

// Tension of spring k at a length that grows with a speed; elastic: the part that comes from the potential.
double ForceField::tension(std::size_t k, double length, double speed, double& elastic) const {
  const PathSpring& spring = tree_->elements.path_springs[k];
  const bool held = spring.tension_only && pulls_ != nullptr, pulls = held && (*pulls_)[k] != 0;
  elastic = 0.0;
  if (!pulls && !in_reach(spring, length)) return 0.0;
  elastic = spring.stiffness * (length - spring.rest_length);
  const double whole = elastic + spring.damping * speed;
  if (held) return pulls ? whole : 0.0;
  return spring.tension_only ? std::max(0.0, whole) : whole;
}

// A spring pulls where it is longer than at rest and where spring and damper together pull: where the lesser of the
// two, as lengths, is positive. The first becomes zero on the way out and the second, at the latest, on the way back.
void ForceField::slackness(const std::vector<int>& springs, const VecCRef& q, const VecCRef& v,
                           std::vector<Slackness>& found) {
  place(*tree_, q, at_);
  found.clear();
  for (const int k : springs) {
    const PathSpring& spring = tree_->elements.path_springs[static_cast<std::size_t>(k)];
    const double l = length(spring, row_), over = l - spring.rest_length;
    double pull = over, moved = 0.0;
    if (spring.damping > 0.0) {
      const double speed = row_.dot(v);
      // A damper without a spring: the length of a second.
      moved = spring.stiffness > 0.0 ? spring.damping / spring.stiffness * speed : speed;
      pull = spring.stiffness > 0.0 ? over + moved : moved;
    }
    found.push_back({std::min(over, pull), std::max(l, spring.rest_length) + std::abs(moved)});
  }
}

double ForceField::potential(const VecCRef& q) {
  if (!any_) return 0.0;
  const Elements& e = tree_->elements;
  double total = 0.0;
  for (const JointPotential& p : e.joint_potentials)
    total += Polynomial(p, q[tree_->joints[p.joint].iq] - p.rest).value;
  if (!e.path_springs.empty()) place(*tree_, q, at_);
  for (const PathSpring& spring : e.path_springs) {
    const double l = length(spring, row_), x = l - spring.rest_length;
    if (in_reach(spring, l)) total += 0.5 * spring.stiffness * x * x;
  }
  if (!e.potentials.empty()) q_ = q;
  for (const UserPotential& p : e.potentials) total += p.value(q_);
  return total;
}

void ForceField::add_gradient(const VecCRef& q, VecRef dV) {
  if (!any_) return;
  const Elements& e = tree_->elements;
  for (const JointPotential& p : e.joint_potentials) {
    const Joint& joint = tree_->joints[p.joint];
    dV[joint.iv] += Polynomial(p, q[joint.iq] - p.rest).slope;
  }
  if (!e.path_springs.empty()) place(*tree_, q, at_);
  for (const PathSpring& spring : e.path_springs) {
    const double l = length(spring, row_);
    if (in_reach(spring, l)) dV += spring.stiffness * (l - spring.rest_length) * row_;
  }
  if (!e.potentials.empty()) q_ = q;
  for (const UserPotential& p : e.potentials) {
    p.gradient(q_, force_);
    public_to_engine(*tree_, q, force_);
    dV += force_;
  }
}

double ForceField::power_rate(const VecCRef& q, const VecCRef& v, const VecCRef& a) {
  if (!any_) return 0.0;
  const double delta = kDifference / (1.0 + v.cwiseAbs().maxCoeff() + std::sqrt(a.cwiseAbs().maxCoeff()));
  // By central differences of order 4.
  double sum = 0.0;
  for (const auto& [side, weight] : {std::pair(1.0, 8.0), {-1.0, -8.0}, {2.0, -1.0}, {-2.0, 1.0}}) {
    const double s = side * delta;
    v_side_ = v + 0.5 * s * a;
    integrate(*tree_, q, v_side_, s, q_side_);
    v_side_ = v + s * a;
    VecX gradient = VecX::Zero(tree_->nv);
    add_gradient(q_side_, gradient);
    sum += weight * gradient.dot(v_side_);
  }
  return sum / (12.0 * delta);
}

void ForceField::add_wrenches(double t, const VecCRef& v, VecRef f, VecRef size) {
  for (const AppliedWrench& wrench : tree_->elements.wrenches) {
    const Eigen::Matrix<double, 6, 1> value = wrench.signal ? wrench.signal(t) : wrench.value;
    Vec3 force = value.head<3>(), torque = value.tail<3>();
    if (!wrench.world_axes) {
      const Mat3 R = world_axes(at_, wrench.at.body, wrench.at.R_B);
      force = R * force;
      torque = R * torque;
    }
    row_.setZero();
    add_point_row(*tree_, at_, wrench.at.body, world_point(at_, wrench.at.body, wrench.at.p_B), force, 1.0, row_);
    add_turn_row(*tree_, at_, wrench.at.body, torque, 1.0, row_);
    f += row_;
    size += row_.cwiseAbs();
    input_ += row_.dot(v);
  }
}

void ForceField::add_users(double t, const VecCRef& q, const VecCRef& v, VecRef f, VecRef size) {
  const Elements& e = tree_->elements;
  if (e.forces.empty() && e.potentials.empty()) return;
  q_ = q;
  v_ = v;
  engine_to_public(*tree_, q, v_);
  for (const UserForce& user : e.forces) {
    user.value(t, q_, v_, force_);
    public_to_engine(*tree_, q, force_);
    f += force_;
    size += force_.cwiseAbs();
    input_ += force_.dot(v);
  }
  for (const UserPotential& user : e.potentials) {
    user.gradient(q_, force_);
    public_to_engine(*tree_, q, force_);
    f -= force_;
    size += force_.cwiseAbs();
  }
}

void ForceField::add(double t, const VecCRef& q, const VecCRef& v, VecRef f, VecRef size) {
  input_ = dissipation_ = 0.0;
  if (!any_) return;
  const Elements& e = tree_->elements;
  for (const JointPotential& p : e.joint_potentials) {
    const Joint& joint = tree_->joints[p.joint];
    const double slope = Polynomial(p, q[joint.iq] - p.rest).slope;
    f[joint.iv] -= slope;
    size[joint.iv] += std::abs(slope);
  }
  if (!e.path_springs.empty() || !e.wrenches.empty()) place(*tree_, q, at_);
  for (std::size_t k = 0; k < e.path_springs.size(); ++k) {
    const double l = length(e.path_springs[k], row_), speed = row_.dot(v);
    double elastic = 0.0;
    const double pull = tension(k, l, speed, elastic);
    f -= pull * row_;
    size += std::abs(pull) * row_.cwiseAbs();
    dissipation_ += (pull - elastic) * speed;
  }
  add_wrenches(t, v, f, size);
  add_users(t, q, v, f, size);
}

// C += factor T A T^T, T from public to engine coordinates.
void ForceField::add_matrix(const MatX& public_matrix, const VecCRef& q, double factor, Eigen::Ref<MatX> C) {
  MatX A = public_matrix;
  for (Eigen::Index k = 0; k < A.cols(); ++k) public_to_engine(*tree_, q, A.col(k));
  MatX B = A.transpose();
  for (Eigen::Index k = 0; k < B.cols(); ++k) public_to_engine(*tree_, q, B.col(k));
  C += factor * B.transpose();
}

void ForceField::newton_terms(double t, const VecCRef& q, const VecCRef& v, double damping, double stiffness,
                              Eigen::Ref<MatX> J, Eigen::Ref<MatX> C) {
  const Elements& e = tree_->elements;
  J.setZero();
  C.setZero();
  int column = 0;
  for (const JointPotential& p : e.joint_potentials) {
    const Joint& joint = tree_->joints[p.joint];
    J(joint.iv, column) = 1.0;
    C(column, column) = stiffness * std::max(0.0, Polynomial(p, q[joint.iq] - p.rest).curvature);
    ++column;
  }
  if (!e.path_springs.empty()) place(*tree_, q, at_);
  for (std::size_t k = 0; k < e.path_springs.size(); ++k) {
    const PathSpring& spring = e.path_springs[k];
    const double l = length(spring, J.col(column));
    const bool acts = spring.tension_only && pulls_ != nullptr ? (*pulls_)[k] != 0 : in_reach(spring, l);
    if (acts) C(column, column) = damping * spring.damping + stiffness * spring.stiffness;
    ++column;
  }
  if (user_column_ < 0) return;
  const int n = tree_->nv;
  J.middleCols(user_column_, n).setIdentity();
  auto block = C.block(user_column_, user_column_, n, n);
  q_ = q;
  v_ = v;
  engine_to_public(*tree_, q, v_);
  for (const UserForce& user : e.forces) {
    if (!user.derivative) continue;
    user.derivative(t, q_, v_, first_, second_);
    add_matrix(first_, q, -stiffness, block);
    add_matrix(second_, q, -damping, block);
  }
  for (const UserPotential& user : e.potentials) {
    if (!user.hessian) continue;
    user.hessian(q_, first_);
    add_matrix(first_, q, stiffness, block);
  }
}

double total_potential(const Tree& tree, ForceField& field, const Placements& at, const VecCRef& q) {
  return total_potential(tree, field, gravity_potential(tree, at), q);
}

double total_potential(const Tree& tree, ForceField& field, double gravity, const VecCRef& q) {
  return gravity + spring_potential(tree, q) + field.potential(q);
}

}  // namespace contactvi
