#include "step/stages.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "model/coordinates.hpp"
#include "step/ball_step.hpp"

namespace contactvi {

namespace {

// Damping enters the factor as h d_i: d such that 1 - D^-1 A is nilpotent, so the iterations contract however stiff it
// is (MIN-SR-S of Caklovic, Lunet, Goetschel, Ruprecht, "Improving efficiency of parallel across the method spectral
// deferred corrections", 2024; computed for the Gauss nodes, contraction <= 0.38 for all h damping / M).
constexpr double kDampingShare[kMaxStages][kMaxStages] = {
    {0.5},
    {0.5, 0.16666666666666666},
    {0.41977771306776773, 0.2587543039897111, 0.07672056533634782},
    {0.35289559190305525, 0.2672600216972396, 0.14841017299118658, 0.04252524399372092},
    {0.11088870964149516, 0.04863676778534509, 0.12083587885750975, 0.20172835816959556, 0.25153783504034943},
    {0.12816865185976184, 0.10301061858644761, 0.04299443517754974, 0.09387652000355524, 0.15231703977162664,
     0.18518849417214353},
    {0.08897662975823498, 0.05858880590183659, 0.0326676160402129, 0.08886355060383533, 0.12987990342188702,
     0.1620012220525913, 0.18145219905150142},
    {0.0502412342118846, 0.01902262904015866, 0.04697573049010983, 0.08098940134436716, 0.11556648235370606,
     0.1463601526582321, 0.17010037049336507, 0.1842079428360344}};

// Springs as h^2 e_i, e = c^2 times this share: the iterations contract for every stiffness, the slower the stiffer.
double spring_share(int s) { return s == 1 ? 1.0 : s == 2 ? 0.5 : 0.25; }

// Of the charts of spherical joints, whose displacements depend on themselves: enough for a contraction of 0.5, and
// a change [rad] that is rounding.
constexpr int kTurnIterations = 60;
constexpr double kTurnExact = 1e-15;

}  // namespace

Stages::Stages(const Tree& tree, const FlatModel& model, int stages, int directions)
    : tree_(&tree),
      model_(&model),
      table_(&gauss_table(stages)),
      kernel_(&lane_kernel(stages)),
      work_{},
      memory_(0),
      field_(tree),
      q0_(VecX::Zero(tree.nq)),
      tau_(VecX::Zero(tree.nv)),
      q_stage_(tree.nq),
      X_stage_(tree.nv),
      v_stage_(tree.nv),
      force_(tree.nv),
      size_(tree.nv),
      element_input_(VecX::Zero(stages)),
      element_dissipation_(VecX::Zero(stages)) {
  work_.s = stages;
  work_.S = (stages + kernel_->lanes - 1) / kernel_->lanes * kernel_->lanes;
  allocate(directions);
  for (const Joint& joint : tree.joints) {
    const bool ball = joint.type == JointType::kSpherical;
    has_ball_springs_ |= ball && joint.stiffness != 0;
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d) {
      stiffness_[d] = ball ? 0.0 : joint.stiffness;
      damping_[d] = tree.damping[d];
    }
  }
  if (tree.nq == tree.nv) {
    turns_.setZero(tree.nv);
    for (std::size_t i = 0; i < tree.joints.size(); ++i)
      if (tree.joints[i].type == JointType::kRevolute || tree.joints[i].type == JointType::kHelical)
        turns_[tree.joints[i].iv] = model.joints[i].turn;
  }
  work_.hA = hA_;
  work_.hb = hb_;
  work_.he = he_;
  work_.he_turn = he_ + work_.S;
  work_.base = base_;
  work_.ball_base = ball_base_;
  work_.p0 = p0_;
  work_.deflection = deflection_;
  work_.damping = damping_;
  work_.X = X_;
  work_.v = v_;
  work_.rate = model.lanes.balls > 0 ? rate_ : v_;
  work_.P = P_;
  work_.G = G_;
  work_.Y = Y_;
  work_.px = px_;
  work_.dv = dv_;
  work_.magnitude = magnitude_;
  work_.diagonal = diagonal_;
  work_.storage = storage_;
  work_.slots = slots_;
  work_.coupled = coupled_;
  work_.error = per_stage_;
  work_.kinetic = per_stage_ + work_.S;
  work_.impulse_energy = per_stage_ + 2 * work_.S;
  work_.context = this;
}

// One block for all arrays, each starting on a cache line.
void Stages::allocate(int directions) {
  const std::size_t S = work_.S, n = tree_->nv, size = n * S, balls = model_->lanes.balls, s = work_.s;
  const std::size_t parts = std::size_t{1} << directions;  // numbers and derivatives
  const std::size_t ball_size = balls > 0 ? size : 0, slots = std::max(1, model_->lanes.slots);
  const std::pair<double**, std::size_t> arrays[] = {{&X_, size},
                                                     {&v_, size},
                                                     {&P_, size},
                                                     {&G_, size},
                                                     {&dv_, size},
                                                     {&diagonal_, size},
                                                     {&magnitude_, size},
                                                     {&rate_, ball_size},
                                                     {&Y_, ball_size},
                                                     {&px_, ball_size},
                                                     {&applied_, tree_->split.empty() ? 0 : size},
                                                     {&storage_, parts * model_->lanes.storage * S},
                                                     {&slots_, parts * 36 * slots * kernel_->lanes},
                                                     {&coupled_, 2 * coupled_rows(model_->lanes) * S},
                                                     {&per_stage_, 3 * S},
                                                     {&hA_, s * S},
                                                     {&he_, 2 * S},
                                                     {&hb_, s},
                                                     {&base_, n},
                                                     {&ball_base_, 9 * balls},
                                                     {&p0_, n},
                                                     {&stiffness_, n},
                                                     {&deflection_, n},
                                                     {&damping_, n},
                                                     {&input_, n},
                                                     {&moving_impulse_, directions > 0 ? size : 0}};
  std::size_t total = 0;
  for (const auto& array : arrays) total += (array.second + 7) / 8 * 8;
  memory_ = AlignedArray(parts * total);
  work_.shadow = static_cast<long>(total);
  double* at = memory_.data();
  for (const auto& array : arrays) {
    *array.first = at;
    at += (array.second + 7) / 8 * 8;
  }
  if (directions == 0) moving_impulse_ = nullptr;
}

// base = q0 + turns. False, and the base is to be made again: some number is so large that it may be an angle of many
// revolutions.
bool Stages::add_turns(const VecCRef& q0) {
  const double *q = q0.data(), *turn = turns_.data();
  double* __restrict base = base_;
  bool large = false;
  for (int d = 0; d < tree_->nv; ++d) {
    base[d] = q[d] + turn[d];
    large |= std::abs(base[d]) > kManyTurns;
  }
  return !large;
}

void Stages::set_base(const VecCRef& q0) {
  if (turns_.size() > 0 && add_turns(q0)) return;
  int ball = 0;
  for (std::size_t i = 0; i < tree_->joints.size(); ++i) {
    const Joint& joint = tree_->joints[i];
    const LaneJoint& j = model_->joints[i];
    switch (joint.type) {
      case JointType::kRevolute: {
        const double angle = q0[joint.iq] + j.turn;
        base_[joint.iv] = std::abs(angle) > kManyTurns ? std::remainder(angle, kTwoPi) : angle;
        break;
      }
      case JointType::kContinuous:
        base_[joint.iv] = std::atan2(q0[joint.iq + 1], q0[joint.iq]) + j.turn;
        break;
      case JointType::kHelical:
        base_[joint.iv] = q0[joint.iq] + j.turn;
        break;
      case JointType::kPrismatic:
        base_[joint.iv] = q0[joint.iq];
        break;
      case JointType::kTranslation:
        for (int d = 0; d < 3; ++d) base_[joint.iv + d] = q0[joint.iq + d];
        break;
      case JointType::kSpherical: {
        const Quat quat(q0[joint.iq + 3], q0[joint.iq], q0[joint.iq + 1], q0[joint.iq + 2]);
        start_ball(j.C, quat, ball_base_ + 9 * ball++);
        break;
      }
    }
  }
}

void Stages::set_base_change(const VecCRef& dq, long shadow) {
  int ball = 0;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical) {
      for (int d = joint.iv; d < joint.iv + joint.nv; ++d) base_[d + shadow] = dq[d];
      continue;
    }
    double* B = ball_base_ + 9 * ball++;
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> base(B);
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> change(B + shadow);
    change = base * skew(dq.segment<3>(joint.iv));
  }
}

void Stages::set_step(double h) {
  const int s = work_.s, S = work_.S;
  if (h != tableau_h_) {
    for (int j = 0; j < s; ++j) {
      hb_[j] = h * table_->b[j];
      for (int i = 0; i < S; ++i) hA_[j * S + i] = h * table_->A[std::min(i, s - 1)][j];
    }
    for (int i = 0; i < S; ++i) {
      const double c = table_->c[std::min(i, s - 1)];
      he_[i] = h * c / s;
      he_[S + i] = -0.5 * h * (1.0 - c) / s;
    }
    tableau_h_ = h;
  }
  work_.h = h;
  if (h == diagonal_h_) return;
  const double share = spring_share(s);
  for (std::size_t k = 0; k < tree_->joints.size(); ++k) {
    const Joint& joint = tree_->joints[k];
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d)
      for (int i = 0; i < S; ++i) {
        const int stage = std::min(i, s - 1);
        const double c = table_->c[stage];
        diagonal_[d * S + i] = tree_->armature[d] + h * kDampingShare[s - 1][stage] * damping_[d] +
                               h * h * share * c * c * std::max(joint.stiffness, stiffness_[d]);
      }
  }
  diagonal_h_ = h;
}

std::pair<double, double> Stages::shares(int i) const {
  const double c = table_->c[i], h = work_.h;
  return {h * kDampingShare[work_.s - 1][i], h * h * spring_share(work_.s) * c * c};
}

void Stages::begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  set_base(q0);
  set_step(h);
  set_forces(q0, tau);
  start_from(p0);
}

void Stages::start_from(const VecCRef& p0) { std::copy_n(p0.data(), tree_->nv, p0_); }

double* Stages::impulse() {
  if (moving_impulse_ != nullptr) {
    work_.impulse = moving_impulse_;
    return moving_impulse_;
  }
  if (!has_impulse_) impulse_ = AlignedArray(static_cast<std::size_t>(tree_->nv) * work_.S);
  has_impulse_ = true;
  work_.impulse = impulse_.data();
  return impulse_.data();
}

void Stages::at(const VecCRef& q0) {
  set_base(q0);
  std::fill(X_, X_ + tree_->nv * work_.S, 0.0);
  for (int d = 0; d < tree_->nv; ++d)
    for (int i = 0; i < work_.S; ++i) diagonal_[d * work_.S + i] = tree_->armature[d];
  diagonal_h_ = std::numeric_limits<double>::quiet_NaN();
  work_.stiffness = nullptr;
  work_.tau = nullptr;
  work_.extra = nullptr;
}

void Stages::settle() {
  const int size = tree_->nv * work_.S;
  std::vector<double> before;
  for (int k = 0; k < kTurnIterations; ++k) {
    before.assign(X_, X_ + size);
    rates();
    kernel_->combine(tree_->nv, work_.s, work_.S, hA_, work_.rate, X_, false);
    if (model_->lanes.balls == 0) return;
    double change = 0.0;
    for (int i = 0; i < size; ++i) change = std::max(change, std::abs(X_[i] - before[i]));
    if (change <= kTurnExact) return;
  }
}

void Stages::settle_turns(double exact) {
  if (model_->lanes.balls == 0) return;
  const std::size_t S = work_.S;
  double before[3 * kMaxStages];
  for (int k = 0; k < kTurnIterations; ++k) {
    rates();
    double change = 0.0;
    for (const Joint& joint : tree_->joints) {
      if (joint.type != JointType::kSpherical) continue;
      double* X = X_ + joint.iv * S;
      std::copy_n(X, 3 * S, before);
      kernel_->combine(3, work_.s, work_.S, hA_, work_.rate + joint.iv * S, X, false);
      for (std::size_t i = 0; i < 3 * S; ++i) change = std::max(change, std::abs(X[i] - before[i]));
    }
    if (change <= exact) return;
  }
}

void Stages::evaluate_with_forces() {
  evaluate();
  if (work_.extra) work_.extra(work_.context);
}

double Stages::sum(const double* array, int dof) const {
  const double* row = array + static_cast<std::size_t>(dof) * work_.S;
  double total = hb_[0] * row[0];
  for (int j = 1; j < work_.s; ++j) total += hb_[j] * row[j];
  return total;
}

Vec3 Stages::ball_end(const Joint& joint, const VecCRef& p0) {
  const int iv = joint.iv;
  const Vec3 X1(sum(work_.rate, iv), sum(work_.rate, iv + 1), sum(work_.rate, iv + 2));
  const Vec3 total = p0.segment<3>(iv) + Vec3(sum(Y_, iv), sum(Y_, iv + 1), sum(Y_, iv + 2));
  return end_ball_momentum(X1, total);
}

void Stages::configuration(const VecCRef& q0, int i, VecRef q) {
  for (int d = 0; d < tree_->nv; ++d) X_stage_[d] = X_[static_cast<std::size_t>(d) * work_.S + i];
  integrate(*tree_, q0, X_stage_, 1.0, q);
}

}  // namespace contactvi
