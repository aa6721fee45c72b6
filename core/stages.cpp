#include "stages.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <new>
#include <utility>

#include "coordinates.hpp"

namespace contactvi {

namespace {

// Damping enters the factor as h d_i: d such that 1 - D^-1 A is nilpotent, so the sweeps contract however stiff it is
// (MIN-SR-S of Caklovic, Lunet, Goetschel, Ruprecht, "Improving efficiency of parallel across the method spectral
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

// Springs as h^2 e_i, e = c^2 times this: the sweeps contract for every stiffness, the slower the stiffer.
double spring_share(int s) { return s == 1 ? 1.0 : s == 2 ? 0.5 : 0.25; }

// Angles beyond this are turned back by whole revolutions: the kernel's sine is good to 1e6.
constexpr double kManyTurns = 1e4;
constexpr double kTwoPi = 6.283185307179586476925;

}  // namespace

void AlignedArray::Free::operator()(double* p) const { std::free(p); }

AlignedArray::AlignedArray(std::size_t size) : size_(size) {
  const std::size_t bytes = std::max<std::size_t>(1, (size * sizeof(double) + 63) / 64) * 64;
  owner_.reset(static_cast<double*>(std::aligned_alloc(64, bytes)));
  if (!owner_) throw std::bad_alloc();
  data_ = owner_.get();
  fill(0.0);
}

void AlignedArray::fill(double value) { std::fill(data_, data_ + size_, value); }

Stages::Stages(const Tree& tree, const FlatModel& model, int stages)
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
  allocate();
  for (const Joint& joint : tree.joints) {
    const bool ball = joint.type == JointType::kSpherical;
    has_ball_springs_ |= ball && joint.stiffness != 0;
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d) {
      stiffness_[d] = ball ? 0.0 : joint.stiffness;
      damping_[d] = tree.damping[d];
    }
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
  work_.error = per_stage_;
  work_.kinetic = per_stage_ + work_.S;
  work_.floor = per_stage_ + 2 * work_.S;
  work_.context = this;
}

// One block for all arrays, each starting on a cache line.
void Stages::allocate() {
  const std::size_t S = work_.S, n = tree_->nv, size = n * S, balls = model_->lanes.balls, s = work_.s;
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
                                                     {&storage_, model_->lanes.storage * S},
                                                     {&slots_, 36 * slots * kernel_->lanes},
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
                                                     {&input_, n}};
  std::size_t total = 0;
  for (const auto& array : arrays) total += (array.second + 7) / 8 * 8;
  memory_ = AlignedArray(total);
  double* at = memory_.data();
  for (const auto& array : arrays) {
    *array.first = at;
    at += (array.second + 7) / 8 * 8;
  }
}

void Stages::set_base(const VecCRef& q0) {
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
        Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> B(ball_base_ + 9 * ball++);
        const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> C(j.C);
        B.noalias() = C * quat.toRotationMatrix();
        break;
      }
    }
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

// The joints' springs and damping, those of the servos among them.
void Stages::set_servo(const Servo* servo) {
  const bool before = servo_ != nullptr && servo_->any, now = servo != nullptr && servo->any;
  servo_ = servo;
  if (!before && !now) return;
  for (const Joint& joint : tree_->joints)
    for (int d = joint.iv; d < joint.iv + joint.nv; ++d) {
      const bool ball = joint.type == JointType::kSpherical;
      const double stiffness = (ball ? 0.0 : joint.stiffness) + (now ? servo->kp[d] : 0.0);
      const double damping = tree_->damping[d] + (now ? servo->kd[d] : 0.0);
      if (stiffness == stiffness_[d] && damping == damping_[d]) continue;
      stiffness_[d] = stiffness;
      damping_[d] = damping;
      diagonal_h_ = std::numeric_limits<double>::quiet_NaN();
    }
}

void Stages::set_forces(const VecCRef& q0, const VecX& tau) {
  has_inputs_ = tau.size() > 0;
  const bool servo = servo_ != nullptr && servo_->any;
  const bool linear = tree_->has_springs || tree_->has_damping || servo;
  work_.stiffness = linear ? stiffness_ : nullptr;
  if (tree_->has_springs) {
    q0_ = q0;
    for (const Joint& joint : tree_->joints) {
      if (joint.stiffness == 0 || joint.type == JointType::kSpherical) continue;
      const Vec3 deflection = spring_deflection(*tree_, joint, q0);
      for (int d = 0; d < joint.nv; ++d) deflection_[joint.iv + d] = deflection[d];
    }
  }
  if (servo) {
    q0_ = q0;
    for (const Joint& joint : tree_->joints) {
      const int d = joint.iv;
      if (joint.nv != 1 || servo_->kp[d] == 0.0) continue;
      // Two springs are one: that of the joint and that of the servo.
      const double own = joint.stiffness != 0.0 ? joint.stiffness * deflection_[d] : 0.0;
      deflection_[d] = (own + servo_->kp[d] * (q0[joint.iq] - servo_->q_ref[d])) / stiffness_[d];
    }
  }
  work_.tau = nullptr;
  const bool split = has_inputs_ && !tree_->split.empty();
  if (has_inputs_) {
    q0_ = q0;
    tau_ = tau;
    for (int d = 0; d < tree_->nv; ++d) input_[d] = tau[d];
    // The forces on split joints turn with the body.
    for (const SplitJoint& joint : tree_->split)
      for (int d = 0; d < (joint.planar ? 2 : 3); ++d) input_[joint.iv + d] = 0.0;
    work_.tau = input_;
  }
  if (servo) {
    if (!has_inputs_) std::fill_n(input_, tree_->nv, 0.0);
    for (int d = 0; d < tree_->nv; ++d) input_[d] += servo_->feed[d] + servo_->kd[d] * servo_->v_ref[d];
    work_.tau = input_;
  }
  if (field_.any()) q0_ = q0;
  work_.extra = split || has_ball_springs_ || field_.any() ? &Stages::add_extra : nullptr;
}

void Stages::begin(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  set_base(q0);
  set_step(h);
  set_forces(q0, tau);
  start_from(p0);
}

void Stages::start_from(const VecCRef& p0) {
  for (int d = 0; d < tree_->nv; ++d) p0_[d] = p0[d];
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
  const So3Coefficients k = so3_coefficients(X1.squaredNorm());
  return so3_apply(-X1, k.sin_t, k.cos_t, total);
}

void Stages::configuration(const VecCRef& q0, int i, VecRef q) {
  for (int d = 0; d < tree_->nv; ++d) X_stage_[d] = X_[static_cast<std::size_t>(d) * work_.S + i];
  integrate(*tree_, q0, X_stage_, 1.0, q);
}

double Stages::input_power(int i) const {
  double total = element_input_[i];
  const int S = work_.S;
  if (work_.tau != nullptr)
    for (int d = 0; d < tree_->nv; ++d)
      total += (input_[d] + (has_inputs_ && !tree_->split.empty() ? applied_[d * S + i] : 0.0)) * v_[d * S + i];
  if (servo_ == nullptr || !servo_->any) return total;
  // input_ has the feed and what belongs to v_ref.
  for (const Joint& joint : tree_->joints) {
    const int d = joint.iv;
    if (joint.nv != 1) continue;
    const double v = v_[d * S + i], kp = servo_->kp[d];
    if (kp != 0.0) total += kp * (servo_->q_ref[d] - q0_[joint.iq] - X_[d * S + i]) * v;
    total -= servo_->kd[d] * v * v;
  }
  return total;
}

double Stages::dissipation(int i) const {
  double total = element_dissipation_[i];
  const int S = work_.S;
  if (tree_->has_damping)
    for (int d = 0; d < tree_->nv; ++d) total += tree_->damping[d] * v_[d * S + i] * v_[d * S + i];
  return total;
}

void Stages::add_extra(void* self) {
  Stages& stages = *static_cast<Stages*>(self);
  if (stages.has_inputs_ && !stages.tree_->split.empty()) stages.add_split_inputs();
  if (stages.has_ball_springs_) stages.add_ball_springs();
  if (stages.field_.any()) stages.add_elements();
}

void Stages::add_elements() {
  const int S = work_.S, n = tree_->nv;
  for (int i = 0; i < work_.s; ++i) {
    configuration(q0_, i, q_stage_);
    for (int d = 0; d < n; ++d) v_stage_[d] = v_[d * S + i];
    force_.setZero();
    size_.setZero();
    field_.add(time(i), q_stage_, v_stage_, force_, size_);
    element_input_[i] = field_.input();
    element_dissipation_[i] = field_.dissipation();
    const int last = i + 1 == work_.s ? S : i + 1;  // lanes without a stage of their own get the last one's
    for (int d = 0; d < n; ++d)
      for (int k = i; k < last; ++k) {
        G_[d * S + k] += force_[d];
        magnitude_[d * S + k] += size_[d];
      }
  }
}

void Stages::add_split_inputs() {
  const int S = work_.S;
  for (int i = 0; i < S; ++i) {
    for (const SplitJoint& joint : tree_->split) {
      const int iv = joint.iv, iq = joint.iq, turning = joint.planar ? 2 : 3;
      Vec3 force = Vec3::Zero();
      if (joint.planar) {
        const double angle = X_[(iv + 2) * S + i], c0 = q0_[iq + 2], s0 = q0_[iq + 3];
        const double c = c0 * std::cos(angle) - s0 * std::sin(angle), s = s0 * std::cos(angle) + c0 * std::sin(angle);
        force = Vec3(c * tau_[iv] - s * tau_[iv + 1], s * tau_[iv] + c * tau_[iv + 1], 0.0);
      } else {
        const Quat quat(q0_[iq + 6], q0_[iq + 3], q0_[iq + 4], q0_[iq + 5]);
        const Vec3 X(X_[(iv + 3) * S + i], X_[(iv + 4) * S + i], X_[(iv + 5) * S + i]);
        force = quat * (so3_exp(X) * tau_.segment<3>(iv));
      }
      for (int d = 0; d < turning; ++d) {
        const int at = (iv + d) * S + i;
        applied_[at] = force[d];
        G_[at] += force[d];
        magnitude_[at] += std::abs(force[d]);
      }
    }
  }
}

// On SO(3) the gradient of |log R|^2/2 is log R itself, because log R is an eigenvector of its Jacobian.
void Stages::add_ball_springs() {
  const int S = work_.S;
  for (const Joint& joint : tree_->joints) {
    if (joint.type != JointType::kSpherical || joint.stiffness == 0) continue;
    const int iv = joint.iv;
    q_stage_ = q0_;
    for (int i = 0; i < S; ++i) {
      const Vec3 X(X_[iv * S + i], X_[(iv + 1) * S + i], X_[(iv + 2) * S + i]);
      const Quat start(q0_[joint.iq + 3], q0_[joint.iq], q0_[joint.iq + 1], q0_[joint.iq + 2]);
      q_stage_.segment<4>(joint.iq) = (start * so3_exp(X)).coeffs();
      const Vec3 deflection = spring_deflection(*tree_, joint, q_stage_);
      for (int d = 0; d < 3; ++d) {
        G_[(iv + d) * S + i] -= joint.stiffness * deflection[d];
        magnitude_[(iv + d) * S + i] += joint.stiffness * std::abs(deflection[d]);
      }
    }
  }
}

}  // namespace contactvi
