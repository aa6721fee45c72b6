#include "model/forces.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/tolerances.hpp"
#include "model/compliance.hpp"
#include "model/coordinates.hpp"
#include "model/point_jacobian.hpp"

namespace contactvi {

namespace {

constexpr double kForceDifference = 2e-5;  // [m; rad] by which a configuration moves for a difference

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

// Of the force by the whole of the places from which a depth comes. With the tolerance of the stage equations, 1e-12 of
// a force's size, that is ten times the rounding.
constexpr double kOfPlaces = 1e-3;
constexpr int kCompliantColumns = 3;  // of the Newton terms of a contact
// Of the sizes of the terms of a gap: a depth below is nothing but their rounding.
constexpr double kLeastDepth = 1e-14;
// Of them, the depth at which a contact's force at rest is no jump.
constexpr double kOfJump = 1e-9;

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
  const int compliant = kCompliantColumns * static_cast<int>(e.compliances.size());
  if (compliant > 0) rows_.resize(tree.nv, kCompliantColumns);
  place_of_.assign(e.compliances.size(), -1);
  for (std::size_t k = 0; k < e.compliances.size(); ++k)
    if (asks(e.compliances[k].law)) asking_.push_back(k);
  bool derivatives = false;
  for (const UserForce& force : e.forces) derivatives |= static_cast<bool>(force.derivative);
  for (const UserPotential& potential : e.potentials) derivatives |= static_cast<bool>(potential.hessian);
  if (derivatives) user_column_ = stiff_columns_;
  stiff_columns_ += compliant + (derivatives ? tree.nv : 0);
  if (!derivatives) return;
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

double ForceField::depth(int law, const VecCRef& q, VecRef gradient) {
  const CompliantContact& c = tree_->elements.compliances[law - tree_->elements.path_springs.size()];
  place(*tree_, q, at_);
  const Touch<double> touch = touch_of(c, at_);
  gradient.setZero();
  add_point_row(*tree_, at_, c.body_a, touch.point, touch.normal, 1.0, gradient);
  add_point_row(*tree_, at_, c.body_b, touch.point, touch.normal, -1.0, gradient);
  return -touch.gap;
}

// Where it opens before the shapes are apart its normal force comes to zero by itself.
bool ForceField::jumps(int law, const VecCRef& q, const VecCRef& v) {
  const CompliantContact& c =
      tree_->elements.compliances[static_cast<std::size_t>(law) - tree_->elements.path_springs.size()];
  if (!asks(c.law)) return false;
  place(*tree_, q, at_);
  Press now;
  now.touch = touch_of(c, at_);
  move_apart(c, v, now);
  const double shallow = kOfJump * touch_size(c, now.touch);
  std::vector<AskedPress> at(2, asked_press(c.law, now.touch, now.velocity));
  const bool apart = at[0].depth < shallow;
  at[0].depth = 0.0;
  at[1].depth = shallow;
  at[1].along = 0.0;
  ask(at, false);
  const double least = std::abs(c.law.force ? at[1].given.force.value : compliance_elastic(c.law, -shallow));
  const double normal = apart && c.law.force ? at[0].given.force.value : 0.0;
  const double bound = c.law.bound ? (*c.law.bound)(std::max(0.0, normal), at[0].slip).value : 0.0;
  return std::abs(normal) > least || bound > least;
}

bool ForceField::is_open(std::size_t k) const {
  return pulls_ != nullptr && (*pulls_)[tree_->elements.path_springs.size() + k] == 0;
}

bool ForceField::meets(std::size_t k, const VecCRef& v, Press& press) {
  const CompliantContact& c = tree_->elements.compliances[k];
  const bool by_state = pulls_ == nullptr || is_open(k);
  if (by_state && least_gap(*c.shapes, touch_pose(at_, c.body_a), touch_pose(at_, c.body_b)) > 0.0) return false;
  press.touch = touch_of(c, at_);
  if (by_state && !(press.touch.gap < 0.0)) return false;
  move_apart(c, v, press);
  return true;
}

// The rows in rows_ are those of the motion of a's point against b's along the normal and two tangents.
void ForceField::move_apart(const CompliantContact& c, const VecCRef& v, Press& press) {
  const Vec3 directions[kCompliantColumns] = {press.touch.normal, any_tangent(press.touch.normal),
                                              press.touch.normal.cross(any_tangent(press.touch.normal))};
  rows_.setZero();
  add_point_rows(*tree_, at_, c.body_a, press.touch.point, directions, 1.0, rows_);
  add_point_rows(*tree_, at_, c.body_b, press.touch.point, directions, -1.0, rows_);
  press.velocity.setZero();
  for (int i = 0; i < kCompliantColumns; ++i) press.velocity += rows_.col(i).dot(v) * directions[i];
}

// The functions of laws, once for all contacts.
void ForceField::ask_laws(const VecCRef& v, bool derivatives) {
  if (asking_.empty()) return;
  Press now;
  asked_.clear();
  for (const std::size_t k : asking_) {
    place_of_[k] = -1;
    if (!meets(k, v, now)) continue;
    place_of_[k] = static_cast<int>(asked_.size());
    asked_.push_back(asked_press(tree_->elements.compliances[k].law, now.touch, now.velocity));
  }
  ask(asked_, derivatives);
}

bool ForceField::press(std::size_t k, const VecCRef& v, Press& press) {
  if (!meets(k, v, press)) return false;
  const ComplianceLaw& law = tree_->elements.compliances[k].law;
  press.given = asks(law) ? asked_[static_cast<std::size_t>(place_of_[k])].given : GivenPress();
  press.acts = press_of(law, press.touch, press.velocity, press.given);
  const double along = press.touch.normal.dot(press.velocity);
  if (is_open(k) || (pulls_ == nullptr && !presses(law, press.touch.gap, along, press.given))) {
    press.acts.normal = 0.0;
    press.acts.force.setZero();
  }
  return true;
}

void ForceField::add_compliances(const VecCRef& v, VecRef f, VecRef size) {
  ask_laws(v, false);
  Press now;
  for (std::size_t k = 0; k < tree_->elements.compliances.size(); ++k) {
    if (!press(k, v, now)) continue;
    dissipation_ += now.acts.elastic * now.touch.normal.dot(now.velocity) - now.acts.force.dot(now.velocity);
    if (now.acts.normal == 0.0) continue;
    const Vec3 t1 = any_tangent(now.touch.normal), t2 = now.touch.normal.cross(t1);
    row_ =
        now.acts.normal * rows_.col(0) + now.acts.force.dot(t1) * rows_.col(1) + now.acts.force.dot(t2) * rows_.col(2);
    f += row_;
    // The depth is a difference of places, whose rounding a stiff law magnifies: iterations come no nearer.
    const CompliantContact& c = tree_->elements.compliances[k];
    size += row_.cwiseAbs() + kOfPlaces * compliance_slope(c.law, now.touch.gap, now.given) * touch_size(c, now.touch) *
                                  rows_.col(0).cwiseAbs();
  }
}

// In the directions of the rows, n and both tangents, with the slip speed s, its vector v_t and r = sqrt(s^2 + slow^2):
// f_n = k d^e (1 - c v_n) and f_t = -mu f_n v_t / r. Without the change of the directions, and of r: with it the
// iterations overshoot from slip to the other side, without it they contract from anywhere (Kacanov's method).
int ForceField::compliant_terms(const VecCRef& v, double damping, double stiffness, int column, Eigen::Ref<MatX> J,
                                Eigen::Ref<MatX> C) {
  ask_laws(v, true);
  Press now;
  for (std::size_t k = 0; k < tree_->elements.compliances.size(); ++k) {
    const ComplianceLaw& law = tree_->elements.compliances[k].law;
    if (!press(k, v, now) || now.acts.normal == 0.0) continue;
    const Vec3 n = now.touch.normal, t1 = any_tangent(n), t2 = n.cross(t1);
    const double along = n.dot(now.velocity), slope = compliance_slope(law, now.touch.gap, now.given);
    const double by_rate = law.force ? now.given.force.by_second : law.damping * now.acts.elastic;
    const double by_depth = law.force ? now.given.force.by_first : slope * (1.0 - law.damping * along);
    const double normal = damping * std::max(0.0, by_rate) + stiffness * std::max(0.0, by_depth);
    const bool rubs = law.rubs();
    const int columns = rubs ? kCompliantColumns : 1;
    J.middleCols(column, columns) = rows_.leftCols(columns);
    auto block = C.block(column, column, columns, columns);
    block(0, 0) = normal;
    if (rubs) {
      const Eigen::Vector2d slip(t1.dot(now.velocity), t2.dot(now.velocity));
      const double r = std::sqrt(slip.squaredNorm() + law.slip_speed * law.slip_speed);
      const double bound = law.bound ? now.given.bound.value : law.friction * now.acts.normal;
      const double by_normal = law.bound ? now.given.bound.by_first : law.friction;
      const double weight = damping * std::max(0.0, bound) / r;
      block.bottomRightCorner(2, 2) = weight * Eigen::Matrix2d::Identity();
      block.bottomLeftCorner(2, 1) = -by_normal * normal / r * slip;
    }
    column += columns;
  }
  return column;
}

// A spring pulls where it is longer than at rest and where spring and damper together pull: where the lesser of the
// two, as lengths, is positive. The first becomes zero on the way out and the second, at the latest, on the way back.
void ForceField::slackness(const std::vector<int>& laws, const VecCRef& q, const VecCRef& v,
                           std::vector<Slackness>& found) {
  place(*tree_, q, at_);
  found.clear();
  asked_.clear();
  const std::size_t springs = tree_->elements.path_springs.size();
  for (const int number : laws) {
    const auto k = static_cast<std::size_t>(number);
    if (k >= springs) {
      found.push_back(openness(tree_->elements.compliances[k - springs], v));
      continue;
    }
    const PathSpring& spring = tree_->elements.path_springs[k];
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
  if (!asked_.empty()) ask_openness(laws, found);
}

// Of the contacts that `openness` has put into asked_.
void ForceField::ask_openness(const std::vector<int>& laws, std::vector<Slackness>& found) {
  ask(asked_, false);
  const std::size_t springs = tree_->elements.path_springs.size();
  std::size_t next = 0;
  for (std::size_t i = 0; i < laws.size() && next < asked_.size(); ++i) {
    const auto number = static_cast<std::size_t>(laws[i]);
    const AskedPress& c = asked_[next];
    if (number < springs || &tree_->elements.compliances[number - springs].law != c.law) continue;
    found[i].value = std::min(c.depth, found[i].size * pull_share(*c.law, c.along, c.given));
    ++next;
  }
}

// A contact opens where the shapes come apart, or where its damper pulls as much as its spring pushes. Where its law is
// to be asked the second one is left to `slackness`, which asks for all contacts.
Slackness ForceField::openness(const CompliantContact& c, const VecCRef& v) {
  if (c.shapes->b.kind == TouchingShape::Kind::kPolytope) {
    // While it is far from a shape with many faces these need not be looked at. What jumps there is positive before
    // and after.
    const double least = least_gap(*c.shapes, touch_pose(at_, c.body_a), touch_pose(at_, c.body_b));
    if (least > c.shapes->a.bound) return {-least, c.shapes->a.bound + c.shapes->b.bound + least};
  }
  const Touch<double> touch = touch_of(c, at_);
  const double size = touch_size(c, touch), depth = -touch.gap;
  if (!(c.law.damping > 0.0) && !c.law.force) return {depth, size};
  row_.setZero();
  add_point_row(*tree_, at_, c.body_a, touch.point, touch.normal, 1.0, row_);
  add_point_row(*tree_, at_, c.body_b, touch.point, touch.normal, -1.0, row_);
  const double along = row_.dot(v);
  if (c.law.force) {
    // No deeper than rounding the law tells nothing, where its force grows from zero.
    if (depth > kLeastDepth * size) asked_.push_back({&c.law, depth, along, 0.0});
    return {depth, size};
  }
  return {std::min(depth, size * pull_share(c.law, along, {})), size};
}

double ForceField::potential(const VecCRef& q) {
  if (!any_) return 0.0;
  const Elements& e = tree_->elements;
  double total = 0.0;
  for (const JointPotential& p : e.joint_potentials)
    total += Polynomial(p, q[tree_->joints[p.joint].iq] - p.rest).value;
  if (!e.path_springs.empty() || !e.compliances.empty()) place(*tree_, q, at_);
  for (const PathSpring& spring : e.path_springs) {
    const double l = length(spring, row_), x = l - spring.rest_length;
    if (in_reach(spring, l)) total += 0.5 * spring.stiffness * x * x;
  }
  for (const CompliantContact& c : e.compliances) {
    if (least_gap(*c.shapes, touch_pose(at_, c.body_a), touch_pose(at_, c.body_b)) > 0.0) continue;
    total += compliance_energy(c.law, touch_of(c, at_).gap);
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
  if (!e.path_springs.empty() || !e.compliances.empty()) place(*tree_, q, at_);
  for (std::size_t k = 0; k < e.compliances.size(); ++k) {
    const double over = depth(static_cast<int>(e.path_springs.size() + k), q, row_);
    if (over > 0.0) dV -= compliance_elastic(e.compliances[k].law, -over) * row_;
  }
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
  const double delta = kForceDifference / (1.0 + v.cwiseAbs().maxCoeff() + std::sqrt(a.cwiseAbs().maxCoeff()));
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
  if (!e.path_springs.empty() || !e.compliances.empty() || !e.wrenches.empty()) place(*tree_, q, at_);
  for (std::size_t k = 0; k < e.path_springs.size(); ++k) {
    const double l = length(e.path_springs[k], row_), speed = row_.dot(v);
    double elastic = 0.0;
    const double pull = tension(k, l, speed, elastic);
    f -= pull * row_;
    size += std::abs(pull) * row_.cwiseAbs();
    dissipation_ += (pull - elastic) * speed;
  }
  if (!e.compliances.empty()) add_compliances(v, f, size);
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

int ForceField::newton_terms(double t, const VecCRef& q, const VecCRef& v, double damping, double stiffness,
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
  if (!e.path_springs.empty() || !e.compliances.empty()) place(*tree_, q, at_);
  for (std::size_t k = 0; k < e.path_springs.size(); ++k) {
    const PathSpring& spring = e.path_springs[k];
    const double l = length(spring, J.col(column));
    const bool acts = spring.tension_only && pulls_ != nullptr ? (*pulls_)[k] != 0 : in_reach(spring, l);
    if (acts) C(column, column) = damping * spring.damping + stiffness * spring.stiffness;
    ++column;
  }
  const int n = tree_->nv;
  if (!e.compliances.empty()) {
    const int first = user_column_ < 0 ? column : column + n;
    const int last = compliant_terms(v, damping, stiffness, first, J, C);
    if (user_column_ < 0) return last;
    column = last;
  } else {
    column = stiff_columns_;
  }
  if (user_column_ < 0) return column;
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
  return column;
}

double total_potential(const Tree& tree, ForceField& field, const Placements& at, const VecCRef& q) {
  return total_potential(tree, field, gravity_potential(tree, at), q);
}

double total_potential(const Tree& tree, ForceField& field, double gravity, const VecCRef& q) {
  return gravity + spring_potential(tree, q) + field.potential(q);
}

}  // namespace contactvi
