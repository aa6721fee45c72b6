#include "model/flat_model.hpp"

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <string>

#include "base/refusal.hpp"

namespace contactvi {

namespace {

bool is_one_dof(const Joint& joint) {
  return joint.type != JointType::kTranslation && joint.type != JointType::kSpherical;
}

// cos and sin; exact at right angles, the common case, where rounding of pi/2 leaves 6e-17.
void cos_sin(double angle, double& c, double& s) {
  c = std::cos(angle);
  s = std::sin(angle);
  if (std::abs(c) < 1e-16) c = 0.0;
  if (std::abs(s) < 2e-16) s = 0.0;
}

Mat3 turn_z(double angle) {
  Mat3 R = Mat3::Identity();
  cos_sin(angle, R(0, 0), R(1, 0));
  R(1, 1) = R(0, 0);
  R(0, 1) = -R(1, 0);
  return R;
}

// R = Rz(gamma) Rx(alpha) Rz(beta); gamma = 0 where only gamma + beta or gamma - beta is determined.
struct Euler {
  double gamma, cos_alpha, sin_alpha, beta;
};

Euler euler(const Mat3& R) {
  Euler e{0.0, R(2, 2), std::hypot(R(0, 2), R(1, 2)), 0.0};
  if (std::abs(e.cos_alpha) < 2e-16) e.cos_alpha = 0.0;  // a right angle from a file
  if (e.cos_alpha == 0.0) e.sin_alpha = 1.0;
  if (e.sin_alpha < 1e-15) {
    e.sin_alpha = 0.0;
    e.cos_alpha = R(2, 2) > 0 ? 1.0 : -1.0;
  } else {
    e.gamma = std::atan2(R(0, 2), -R(1, 2));
  }
  // beta comes from what remains of R after gamma and alpha, not from its third row: nearly parallel axes determine
  // gamma and beta to few digits each, but their sum must be right.
  const Mat3 rest = turn_z(e.gamma).transpose() * R;
  const double x = rest(0, 0), y = e.cos_alpha * rest(1, 0) + e.sin_alpha * rest(2, 0);
  e.beta = std::atan2(y, x);
  return e;
}

int lane_type(JointType type) {
  switch (type) {
    case JointType::kPrismatic:
      return kLaneSlide;
    case JointType::kHelical:
      return kLaneScrew;
    case JointType::kTranslation:
      return kLaneTranslate;
    case JointType::kSpherical:
      return kLaneBall;
    default:
      return kLaneTurn;
  }
}

void copy3(const Vec3& from, double* to) {
  for (int i = 0; i < 3; ++i) to[i] = from[i];
}

// How far each body frame is turned about its z axis, so that its largest child needs no rotation before its own axis.
std::vector<double> frame_turns(const Tree& tree) {
  const int n = static_cast<int>(tree.joints.size());
  std::vector<int> size(n, 1), heir(n, -1);
  for (int i = n - 1; i >= 0; --i)
    if (tree.joints[i].parent >= 0) size[tree.joints[i].parent] += size[i];
  for (int i = 0; i < n; ++i) {
    const int parent = tree.joints[i].parent;
    if (parent >= 0 && is_one_dof(tree.joints[i]) && (heir[parent] < 0 || size[i] > size[heir[parent]]))
      heir[parent] = i;
  }
  std::vector<double> turn(n, 0.0);
  for (int i = 0; i < n; ++i) {
    if (!is_one_dof(tree.joints[i])) continue;
    turn[i] = heir[i] >= 0 ? euler(tree.joints[heir[i]].R_PJ).gamma : -euler(tree.joints[i].R_PJ).beta;
  }
  return turn;
}

void place_in_parent(const Joint& joint, double parent_turn, double own_turn, LaneJoint& j) {
  const Mat3 back = turn_z(parent_turn).transpose();
  copy3(back * joint.p_PJ, j.r);
  const Mat3 C = back * joint.R_PJ;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) j.C[3 * r + c] = C(r, c);
  j.has_rotation = !C.isIdentity(0);
  if (!is_one_dof(joint)) return;
  const Euler e = euler(joint.R_PJ);
  const double gamma = e.gamma - parent_turn;
  j.has_gamma = gamma != 0.0;
  cos_sin(gamma, j.cos_gamma, j.sin_gamma);
  j.cos_alpha = e.cos_alpha;
  j.sin_alpha = e.sin_alpha;
  j.alpha = e.cos_alpha == 1.0 && e.sin_alpha == 0.0   ? kLaneNoAngle
            : e.cos_alpha == 0.0 && e.sin_alpha == 1.0 ? kLaneQuarterTurn
                                                       : kLaneAnyAngle;
  j.turn = e.beta + own_turn;
  cos_sin(j.turn, j.cos_fixed, j.sin_fixed);
}

// Gravity in the axes in which start_at_world() of the kernel takes it.
Vec3 root_gravity(const Tree& tree, const Joint& joint, const LaneJoint& j) {
  if (joint.type == JointType::kSpherical) return tree.gravity;
  if (joint.type == JointType::kTranslation) return joint.R_PJ.transpose() * tree.gravity;
  Mat3 Rx = Mat3::Identity();
  Rx(1, 1) = Rx(2, 2) = j.cos_alpha;
  Rx(2, 1) = j.sin_alpha;
  Rx(1, 2) = -j.sin_alpha;
  return Rx.transpose() * turn_z(std::atan2(j.sin_gamma, j.cos_gamma)).transpose() * tree.gravity;
}

void add_inertia(const Joint& joint, double own_turn, LaneJoint& j) {
  const Mat3 back = turn_z(own_turn).transpose();
  const Mat3 I = own_turn == 0.0 ? joint.inertia : Mat3(back * joint.inertia * back.transpose());
  const double packed[6] = {I(0, 0), I(0, 1), I(0, 2), I(1, 1), I(1, 2), I(2, 2)};
  std::memcpy(j.inertia, packed, sizeof(packed));
  copy3(back * joint.first_moment, j.moment);
  j.mass = j.subtree_mass = joint.mass;
}

// Assigns accumulators for the sums over children: a chain needs one, a tree one more for each branch in progress.
int assign_slots(std::vector<LaneJoint>& joints) {
  std::vector<int> free;
  int count = 0;
  for (int i = static_cast<int>(joints.size()) - 1; i >= 0; --i) {
    LaneJoint& j = joints[i];
    if (j.slot >= 0) free.push_back(j.slot);  // it is read before the parent's is written
    if (j.parent < 0) continue;
    LaneJoint& up = joints[j.parent];
    j.first = up.slot < 0;
    if (j.first) {
      if (free.empty()) free.push_back(count++);
      up.slot = free.back();
      free.pop_back();
    }
    j.parent_slot = up.slot;
  }
  return count;
}

}  // namespace

FlatModel::FlatModel(const Tree& tree) : joints(tree.joints.size()), lanes{} {
  const std::vector<double> turn = frame_turns(tree);
  int at = 0, balls = 0;
  for (std::size_t i = 0; i < joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    LaneJoint& j = joints[i];
    j = LaneJoint{};
    j.type = lane_type(joint.type);
    j.parent = joint.parent;
    j.dof = joint.iv;
    j.ball = j.type == kLaneBall ? balls++ : -1;
    j.at = at;
    j.velocity = j.type == kLaneBall ? 9 : 3;
    at += j.velocity + 9 + (is_one_dof(joint) ? kLaneFactor1 + kLaneNewton1 : kLaneFactor3 + kLaneNewton3);
    j.slot = j.parent_slot = -1;
    place_in_parent(joint, joint.parent < 0 ? 0.0 : turn[joint.parent], turn[i], j);
    j.pitch = joint.pitch;
    add_inertia(joint, turn[i], j);
    for (int d = 0; d < joint.nv; ++d) j.armature[d] = tree.armature[joint.iv + d];
    if (joint.parent < 0) copy3(root_gravity(tree, joint, j), j.gravity);
  }
  for (int i = static_cast<int>(joints.size()) - 1; i >= 0; --i)
    if (joints[i].parent >= 0) joints[joints[i].parent].subtree_mass += joints[i].subtree_mass;
  const int slots = assign_slots(joints);
  take_couplings(tree);
  lanes = {static_cast<int>(joints.size()),
           tree.nv,
           balls,
           slots,
           at,
           joints.data(),
           static_cast<int>(followers.size()),
           static_cast<int>(leaders.size()),
           static_cast<int>(couplings.size()),
           followers.data(),
           leaders.data(),
           couplings.data(),
           terms.data(),
           path.data()};
}

void FlatModel::take_couplings(const Tree& tree) {
  std::vector<std::vector<LaneTerm>> led(tree.joints.size());
  for (const Follower& f : tree.followers) {
    std::vector<char> on_path(tree.joints.size(), 0);
    const auto walk = [&](int joint) {
      for (; joint >= 0 && on_path[joint] == 0; joint = tree.joints[joint].parent) on_path[joint] = 1;
    };
    walk(f.joint);
    for (const Follower::Leader& leader : f.leaders) walk(leader.joint);
    const int start = static_cast<int>(path.size());
    for (std::size_t j = 0; j < on_path.size(); ++j)
      if (on_path[j] != 0) path.push_back(static_cast<int>(j));
    const int end = static_cast<int>(path.size());
    for (int k = start; k < end; ++k)
      for (int d = 0; d < tree.joints[path[k]].nv; ++d) path.push_back(tree.joints[path[k]].iv + d);
    followers.push_back({f.iv, f.joint, static_cast<int>(terms.size()), static_cast<int>(f.leaders.size()), start,
                         end - start, static_cast<int>(path.size()) - end});
    joints[f.joint].coupled = true;
    for (const Follower::Leader& leader : f.leaders) {
      joints[leader.joint].coupled = true;
      terms.push_back({leader.iv, leader.joint, leader.ratio});
      led[leader.joint].push_back({f.iv, f.joint, leader.ratio});
    }
  }
  for (std::size_t j = 0; j < led.size(); ++j) {
    if (led[j].empty()) continue;
    leaders.push_back(
        {tree.joints[j].iv, static_cast<int>(j), static_cast<int>(terms.size()), static_cast<int>(led[j].size())});
    terms.insert(terms.end(), led[j].begin(), led[j].end());
  }
  for (const Coupling& c : tree.couplings) {
    const Joint &first = tree.joints[c.joint], &last = tree.joints[c.joint_end - 1];
    couplings.push_back({c.first, c.count, c.joint, c.joint_end, first.iv, last.iv + last.nv});
  }
}

namespace {

struct InstructionSet {
  const char* name;
  const LaneKernel* kernels;
  const RunKernel* runs;
  bool present;
};

const std::vector<InstructionSet>& known_sets() {
  static const std::vector<InstructionSet> sets = [] {
    std::vector<InstructionSet> all = {{"base", contactvi_lanes_base, &contactvi_runs_base, true}};
#ifdef CONTACTVI_X86
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                        __builtin_cpu_supports("avx512dq");
    all.push_back({"avx2", contactvi_lanes_avx2, &contactvi_runs_avx2, avx2});
    all.push_back({"avx512", contactvi_lanes_avx512, &contactvi_runs_avx512, avx512});
#endif
    return all;
  }();
  return sets;
}

const InstructionSet* find(const char* name) {
  for (const InstructionSet& set : known_sets())
    if (set.present && std::strcmp(set.name, name) == 0) return &set;
  return nullptr;
}

const InstructionSet*& chosen() {
  static const InstructionSet* set = [] {
    const char* wanted = std::getenv("CONTACTVI_INSTRUCTION_SET");
    if (wanted != nullptr && *wanted != 0) {
      if (const InstructionSet* set = find(wanted)) return set;
      std::string own;
      for (const char* name : instruction_sets()) own += (own.empty() ? "" : ", ") + std::string(name);
      throw Refusal("The environment variable CONTACTVI_INSTRUCTION_SET names nothing that this processor runs",
                    "one of " + own, "'" + std::string(wanted) + "'",
                    "Unset CONTACTVI_INSTRUCTION_SET, which takes the best one, or set it to one of these");
    }
    const InstructionSet* best = nullptr;
    for (const InstructionSet& each : known_sets())
      if (each.present) best = &each;
    return best;
  }();
  return set;
}

// A single stage gains nothing from lanes and runs as plain doubles everywhere, in a build of its own.
const LaneKernel& of(const InstructionSet& set, int stages) {
  if (stages == 1) return contactvi_lanes_one_stage;
  return set.kernels[stages <= 4 ? 0 : 1];
}

}  // namespace

std::vector<const char*> instruction_sets() {
  std::vector<const char*> names;
  for (const InstructionSet& set : known_sets())
    if (set.present) names.push_back(set.name);
  return names;
}

const char* instruction_set() { return chosen()->name; }

bool set_instruction_set(const char* name) {
  const InstructionSet* set = find(name);
  if (set == nullptr) return false;
  chosen() = set;
  return true;
}

const LaneKernel& lane_kernel(int stages) { return of(*chosen(), stages); }

const RunKernel& run_kernel() { return *chosen()->runs; }

}  // namespace contactvi
