#include "run/contact_modes.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/tolerances.hpp"
#include "run/contact_set.hpp"

namespace contactvi {

namespace {
constexpr double kClosed = 1e-10;  // of the speeds: a contact whose normal speed is larger is not held,
constexpr double kRise = 1e-11;    // [m] unless the force on it brings it back from there
// Switch functions are known to rounding of 1e-12 by their finder; continuous forces to this times as much.
constexpr double kCoarse = 1e3;
// Of the larger one of two forces, or of the cone: a force that is extrapolated to less, or comes closer, may reach
// zero or the cone in the step.
constexpr double kFalling = 0.35, kInside = 0.8;
// Of what a distance to the border of a feature changes by in a step: one that is larger at the start, the stages and
// the end has no root in between.
constexpr double kWithin = 0.25;
constexpr double kBegun = 1e-9;     // of the speeds: the path of a step knows no slower slip that begins with it
constexpr double kTogether = 1e-6;  // of the forces: contacts whose margins differ less slip together
constexpr double kParadox = 1e-6;   // of G_nn: a sliding contact with a smaller A is left to contact steps
}  // namespace

ContactModes::ContactModes(const Scene& scene, Guards& guards, ContactStep& step, Integrator& integrator)
    : scene_(&scene),
      guards_(&guards),
      step_(&step),
      integrator_(&integrator),
      rows_(guards, scene.tree.nv),
      borders_(guards),
      q_stage_(scene.tree.nq),
      v_stage_(scene.tree.nv) {}

bool ContactModes::begin_step(const VecX& q, const VecX& v, double t, const VecX& tau, Recording& recording) {
  std::vector<PersistentContact>& contacts = step_->contacts();
  if (!step_->modes_known() && !find_modes(q, v, t, tau, recording)) return false;
  step_->set_modes_known();
  endings_.clear();
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    endings_.push_back({i, End::kRelease});
    if (contacts[i].mu > 0.0) endings_.push_back({i, contacts[i].sticks ? End::kSlip : End::kStick});
  }
  const std::vector<FrictionJoint>& joints = step_->friction_joints();
  for (std::size_t k = 0; k < joints.size(); ++k)
    endings_.push_back({k, joints[k].sticks ? End::kJointSlips : End::kJointSticks});
  guards_->place(q);
  borders_.begin(contacts);
  for (int k = 0; k < borders_.count(); ++k) endings_.push_back({static_cast<std::size_t>(k), End::kFeature});
  depths_.resize(borders_.count());
  for (PersistentContact& c : contacts) step_->set_coefficient(c, t);
  rows_.set(contacts, joints, 2 * integrator_->stages() + 1);
  integrator_->hold(&rows_);
  active_ = true;
  watches_ = false;
  t_ = t;
  return true;
}

// Which contacts stick, from the accelerations at the start of a phase.
bool ContactModes::find_modes(const VecX& q, const VecX& v, double t, const VecX& tau, Recording& recording) {
  std::vector<PersistentContact>& contacts = step_->contacts();
  directions_.assign(contacts.size(), Vec3::Zero());
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    contacts[i].heading.setZero();
    if (contacts[i].mu > 0.0 && !contacts[i].sticks) directions_[i] = contacts[i].slip;
  }
  settle_joints(step_->friction_joints(), q, v);
  if (!step_->forces_at(*integrator_, q, v, t, tau, directions_, forces_)) return false;
  for (std::size_t i = 0; i < contacts.size(); ++i)
    if (!stays_closed(i, kClosed * (1.0 + v.cwiseAbs().maxCoeff()))) return false;
  const double begins = kBegins * forces_.largest;
  begin_joint_slips(step_->friction_joints(), step_->of_joints(forces_.a), begins);
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    PersistentContact& c = contacts[i];
    if (c.mu == 0.0) continue;
    const int r = step_->row(i);
    if (c.sticks) {
      const Eigen::Vector2d a = forces_.a.segment<2>(r + 1);
      if (!(a.norm() > begins) || !(forces_.f[r] > 0.0)) continue;
      c.heading = step_->force_frame(i).slip(a).normalized();
      c.sticks = c.anchored = false;
      step_->set_coefficient(c, t);
      directions_[i] = c.heading;
      record_change(t, c.point, Change::kSlip, 0.0, recording);
    }
    if (is_paradox(i)) return false;
  }
  return true;
}

// Whether contact i, which separates or closes at most slowly, is held. One that separates and is pressed together
// comes back at once: the impulse at the start of the step takes its speed, as that of its return would. If it rises
// farther than rows are held to it is left to contact steps, which know whether it stays.
bool ContactModes::stays_closed(std::size_t i, double slow) const {
  const int r = step_->row(i);
  const double speed = step_->force_normal_speed(i), pressed = step_->force_matrix()(r, r) * forces_.f[r];
  return std::abs(speed) <= slow || (speed > 0.0 && speed * speed <= 2.0 * kRise * pressed);
}

// Whether no force keeps a contact closed that slides along directions_: A = W_n M^-1 (W_n - mu W_t d) <= 0.
bool ContactModes::is_paradox(std::size_t i) const {
  const MatX& G = step_->force_matrix();
  const int r = step_->row(i);
  const Eigen::Vector2d d = step_->force_frame(i).rows(directions_[i]).normalized();
  return G(r, r) - step_->contacts()[i].mu * G.row(r).segment<2>(r + 1).dot(d) <= kParadox * G(r, r);
}

bool ContactModes::fits(const VecX& q1, bool beyond_borders) {
  if (rows_.runs_far(integrator_->stages() + 1)) return false;
  guards_->place(q1);
  for (const PersistentContact& c : step_->contacts()) {
    if (c.point.kind == PointKind::kWitness || c.point.kind == PointKind::kLimit) continue;
    const Placements& at = guards_->placements(c.point.guard);
    if (guards_->manifolds().valid(c.point, at)) continue;
    if (!beyond_borders || guards_->manifolds().inside_face(c.point, at) > 0.0) return false;
  }
  return true;
}

void ContactModes::take_step(double h, const VecX& v0, const VecX& q1, const VecX& tau) {
  h_ = h;
  v0_ = v0;
  tau_ = tau;
  const int s = integrator_->stages();
  const MatX& angles = integrator_->constraints()->slip_angles();
  headings_.assign(static_cast<std::size_t>(s) + 1, std::vector<Vec3>(step_->contacts().size(), Vec3::Zero()));
  for (int k = 0; k <= s; ++k)
    for (std::size_t i = 0; i < step_->contacts().size(); ++i) {
      const int j = rows_.slide(i);
      if (j < 0) continue;
      headings_[static_cast<std::size_t>(k)][i] =
          rows_.site(k, i).frame.slip({std::cos(angles(j, k)), std::sin(angles(j, k))});
    }
  const bool crossed = borders_may_be_crossed(q1);
  watches_ = crossed || may_end();
  const StageConstraints& rows = *integrator_->constraints();
  shares_ = rows.shares_load();
  begins_.assign(step_->contacts().size(), 0);
  for (std::size_t i = 0; i < begins_.size(); ++i)
    if (const int j = rows_.slide(i); j >= 0) begins_[i] = rows.slips()(j, 0) < kBegun ? 1 : 0;
}

// Direction of the slip of contact i, roughly: it only tells which way along its slip is forward.
Vec3 ContactModes::direction(double at, std::size_t i) const {
  const LobattoTable& table = integrator_->constraints()->table();
  int k = 0;
  while (k < table.s && table.d[k + 1] <= at) ++k;
  return headings_[static_cast<std::size_t>(k)][i];
}

// By the impulses of the step: forces to leading order, and slips.
bool ContactModes::may_end() const {
  const StageConstraints& rows = *integrator_->constraints();
  const LobattoTable& table = rows.table();
  const auto impulses = rows.phase_impulses();
  const std::vector<PersistentContact>& contacts = step_->contacts();
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const int r = rows_.row(i), j = rows_.slide(i);
    double least = INFINITY, largest = 0.0, slowest = INFINITY, fastest = 0.0;
    for (int k = 0; k <= table.s; ++k) {
      const double n = impulses(r, k) / table.e[k];
      least = std::min(least, n);
      largest = std::max(largest, std::abs(n));
      if (j >= 0) {
        slowest = std::min(slowest, rows.slips()(j, k));
        fastest = std::max(fastest, rows.slips()(j, k));
      } else if (contacts[i].mu > 0.0) {
        const double t = impulses.block(r + 1, k, 2, 1).norm() / table.e[k];
        const double mu = rows_.friction_by_state(i)
                              ? rows_.friction(i, 0.0, n / h_, t_ + table.d[k] * h_, contacts[i].mu, false).mu
                              : contacts[i].mu;
        if (!(t < kInside * mu * n)) return true;
      }
    }
    if (!(least > kFalling * largest) || (j >= 0 && !(slowest > kFalling * fastest))) return true;
  }
  return joints_may_end(rows);
}

bool ContactModes::joints_may_end(const StageConstraints& rows) const {
  const LobattoTable& table = rows.table();
  const std::vector<FrictionJoint>& joints = step_->friction_joints();
  for (std::size_t k = 0; k < joints.size(); ++k) {
    const int r = rows_.joint_row(k);
    if (r >= 0) {
      for (int node = 0; node <= table.s; ++node)
        if (!(std::abs(rows.phase_impulses()(r, node)) < kInside * joints[k].limit * table.e[node] * h_)) return true;
      continue;
    }
    const double sign = joints[k].heading, v0 = sign * v0_[joints[k].dof],
                 v1 = sign * rows.end_velocity()[joints[k].dof];
    double slowest = std::min(v0, v1), fastest = std::max(v0, v1);
    for (int i = 0; i < table.s; ++i) {
      const double v = sign * integrator_->stage_velocities()[joints[k].dof * integrator_->padded_stages() + i];
      slowest = std::min(slowest, v);
      fastest = std::max(fastest, v);
    }
    if (!(slowest > kFalling * fastest)) return true;
  }
  return false;
}

// By where the points are on their features at the start, the stages and the end of the step.
bool ContactModes::borders_may_be_crossed(const VecX& q1) {
  if (borders_.count() == 0) return false;
  const int s = integrator_->stages();
  for (int i = 0; i <= s; ++i) {
    if (i < s) integrator_->stage_state(i, q_stage_, v_stage_);
    guards_->place(i < s ? q_stage_ : q1);
    if (i == 0) {
      borders_.settle();
      for (int k = 0; k < borders_.count(); ++k) depths_[k] = borders_.start_depth(k);
      least_ = largest_ = depths_;
    }
    for (int k = 0; k < borders_.count(); ++k) depths_[k] = borders_.depth(k);
    least_ = least_.cwiseMin(depths_);
    largest_ = largest_.cwiseMax(depths_);
  }
  return !(least_.array() > kWithin * (largest_ - least_).array()).all();
}

// How far the friction of contact i is from its cone [N]. Where contacts share a load only that of all points of a pair
// together is known.
double ContactModes::stick_margin(std::size_t i) const {
  const std::vector<PersistentContact>& contacts = step_->contacts();
  if (!shares_) return forces_.margin(step_->row(i), step_->force_friction(i));
  double normal = 0.0, bound = 0.0;
  Vec3 friction = Vec3::Zero();  // in the measure of its bound
  for (std::size_t k = 0; k < contacts.size(); ++k) {
    if (contacts[k].point.guard != contacts[i].point.guard) continue;
    const int r = step_->row(k);
    normal += forces_.f[r];
    bound += step_->force_friction(k) * forces_.f[r];
    TangentFrame tangents = step_->force_frame(k);
    tangents.shares.setOnes();
    friction += tangents.force(forces_.f.segment<2>(r + 1));
  }
  return (rows_.friction_by_state(i) ? bound : contacts[i].mu * normal) - friction.norm();
}

double ContactModes::friction_work() {
  if (!active_) return 0.0;
  impulses_.take(step_->contacts(), rows_, *integrator_->constraints());
  return impulses_.friction_work();
}

void ContactModes::evaluate(double at, const VecX& q, const VecX& v, VecRef values) {
  const std::vector<PersistentContact>& contacts = step_->contacts();
  for (std::size_t i = 0; i < contacts.size(); ++i)
    directions_[i] = rows_.slide(i) < 0 ? Vec3(Vec3::Zero()) : direction(at, i);
  const bool found = step_->forces_at(*integrator_, q, v, t_ + at * h_, tau_, directions_, forces_);
  if (!found) {
    values.setConstant(std::numeric_limits<double>::quiet_NaN());
    return;
  }
  guards_->place(q);
  for (int k = 0; k < borders_.count(); ++k) depths_[k] = borders_.depth(k);
  const MatX& G = step_->force_matrix();
  const double largest = forces_.largest, speed = 1.0 + v.cwiseAbs().maxCoeff();
  for (std::size_t k = 0; k < endings_.size(); ++k) {
    const std::size_t i = endings_[k].contact;
    if (endings_[k].end == End::kFeature) {
      values[static_cast<Eigen::Index>(k)] = depths_[static_cast<Eigen::Index>(i)];
      continue;
    }
    const bool of_joint = endings_[k].end == End::kJointSlips || endings_[k].end == End::kJointSticks;
    const int r = of_joint ? step_->joint_row(i) : step_->row(i);
    const double size = kCoarse * std::max(forces_.scale, largest / G(r, r));
    double& value = values[static_cast<Eigen::Index>(k)];
    // What sticks is held up to the friction's bound, and beyond it begins to slip with an acceleration.
    const auto holds = [&](double acceleration, double margin) {
      return (acceleration > kBegins * largest ? -acceleration / G(r, r) : std::max(0.0, margin)) / size;
    };
    const auto slides = [&](double along, bool begins) {
      along /= speed;
      return begins ? std::copysign(std::max(0.0, std::abs(along) - kBegun), along) : along;
    };
    switch (endings_[k].end) {
      case End::kRelease:
        value = (forces_.f[r] > 0.0 ? forces_.f[r] : -forces_.a[r] / G(r, r)) / size;
        break;
      case End::kSlip:
        value = holds(forces_.a.segment<2>(r + 1).norm(), stick_margin(i));
        break;
      case End::kStick:
        value = slides(step_->force_slip(i).dot(step_->force_frame(i).rows(directions_[i])), begins_[i] != 0);
        break;
      case End::kJointSlips:
        value = holds(std::abs(forces_.a[r]), step_->friction_joints()[i].limit - std::abs(forces_.f[r]));
        break;
      case End::kJointSticks: {
        const FrictionJoint& joint = step_->friction_joints()[i];
        value = slides(joint.heading * v[joint.dof], std::abs(v0_[joint.dof]) < kBegun);
        break;
      }
      case End::kFeature:
        break;
    }
  }
}

void ContactModes::begin_slip(std::size_t first, double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = step_->contacts();
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    PersistentContact& c = contacts[i];
    if (c.mu == 0.0 || !c.sticks) continue;
    const int r = step_->row(i);
    const Eigen::Vector2d f = forces_.f.segment<2>(r + 1);
    if (i != first && !(forces_.margin(r, step_->force_friction(i)) <= kTogether * forces_.scale && f.norm() > 0.0))
      continue;
    c.heading = -step_->force_frame(i).slip(f).normalized();
    c.sticks = c.anchored = false;
    step_->set_coefficient(c, time);
    record_change(time, c.point, Change::kSlip, 0.0, recording);
  }
  step_->leave();
}

void ContactModes::come_to_rest(std::size_t first, const VecX& v, double time, Recording& recording) {
  std::vector<PersistentContact>& contacts = step_->contacts();
  const double still = kStill * (1.0 + v.cwiseAbs().maxCoeff());
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    PersistentContact& c = contacts[i];
    if (c.mu == 0.0 || c.sticks || (i != first && c.slip.norm() > still)) continue;
    c.sticks = true;
    c.anchored = false;
    c.slip.setZero();
    step_->set_coefficient(c, time);
    record_change(time, c.point, Change::kStick, 0.0, recording);
  }
  step_->invalidate();
}

void ContactModes::begin_joint_slip(std::size_t k) {
  FrictionJoint& joint = step_->friction_joints()[k];
  joint.sticks = joint.anchored = false;
  joint.heading = -std::copysign(1.0, forces_.f[step_->joint_row(k)]);
  step_->leave();
}

bool ContactModes::admits() {
  impulses_.take(step_->contacts(), rows_, *integrator_->constraints());
  return impulses_.are_admissible();
}

void ContactModes::commit(double time, long step, bool wanted, Recording& recording) {
  const StageConstraints& rows = *integrator_->constraints();
  const double h = integrator_->length();
  const int s = rows.table().s;
  std::vector<PersistentContact>& contacts = step_->contacts();
  impulses_.take(contacts, rows_, rows);
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    PersistentContact& c = contacts[i];
    const int j = rows_.slide(i);
    const PersistentRows::Site& end = rows_.site(s, i);
    const HeldImpulses::Impulse& impulse = impulses_.of(i);
    c.force = impulse.local / h;
    if (c.mu > 0.0 && c.point.kind != PointKind::kVertex) c.tangent = end.frame.t1;
    c.slip.setZero();
    if (j >= 0) {
      const double angle = rows.slip_angles()(j, s);
      const Vec3 along = end.frame.slip({std::cos(angle), std::sin(angle)});
      c.heading = along.normalized();
      c.slip = rows.slips()(j, s) * along;
      step_->set_coefficient(c, time);
    } else if (c.counts_by_place() && c.mu > 0.0 && !c.anchored) {
      c.anchor = rows_.reference(i);
      c.anchored = true;
    }
    if (!wanted) continue;
    const Vec3 zero = Vec3::Zero();
    if (!scene_->is_pair(c.point.guard)) {
      recording.contacts.push_back({time, h, c.point.guard, 0, ContactMode::kFrictionless, step, zero, zero,
                                    0.5 * impulse.local, 0.5 * impulse.local, end.contact.gap, zero});
      continue;
    }
    const ContactMode mode = c.mu == 0.0 ? ContactMode::kFrictionless
                             : j >= 0    ? ContactMode::kSlips
                                         : ContactMode::kSticks;
    recording.contacts.push_back({time, h, c.point.guard, c.point.feature, mode, step,
                                  0.5 * (end.contact.point_a + end.contact.point_b),
                                  impulses_.mean_normal(i, end.contact.normal), 0.5 * impulse.world,
                                  0.5 * impulse.world, end.contact.gap, c.slip, impulse.work});
  }
  step_->leave();
  step_->follow(rows.end_velocity());
}

}  // namespace contactvi
