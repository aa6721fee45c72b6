// Interface of the stage kernel, which evaluates all stages of a Gauss step side by side in SIMD lanes.
//
// One source (kernel.hpp and what it includes) is compiled once per instruction set, each object with its own flags
// and one exported symbol. Only plain structs and pointers cross: an inline function of the standard library or of
// Eigen compiled with AVX-512 could win at link time and crash on an older processor.
//
// Arrays over dofs and stages are [dof * S + stage], S the stage count padded to the lanes, 64-byte aligned. Padding
// lanes repeat the last stage, so nothing in them divides by zero. Sums over stages run over the real ones in order,
// and the compiler may not fuse (-ffp-contract=off): every instruction set gives the same bits.
//
// The functions of runs take lanes that are the only stages of steps of different runs. There what the stages of a step
// share (its length, its start, its linear forces) has a number for each lane, and stands in the arrays as the numbers
// per dof and stage do. No lane sees another one: each gets the bits that its run has alone.
#pragma once

namespace contactvi {

enum LaneJointType { kLaneTurn, kLaneSlide, kLaneScrew, kLaneTranslate, kLaneBall };

// Angle between two axes: most robots' are parallel or at right angles, and need no products for the transform.
enum LaneAngle { kLaneAnyAngle, kLaneNoAngle, kLaneQuarterTurn };  // quarter: cos 0 and sin 1 exactly

// One joint and the body it moves. 1-dof joints: the body's z axis is the joint's, and
// (body in parent) = shift(r) Rz(gamma) Rx(alpha) shift_z(d) Rz(angle), so most transforms are rotations in a plane.
// Translations: shift(r) C shift(q). Balls: shift(r) R, R = B exp(X).
struct LaneJoint {
  int type;
  int parent;       // -1: world
  int dof;          // first of 1 or 3
  int ball;         // number among the balls, else -1
  int at;           // offset of its storage, in vectors
  int velocity;     // offset of (w, v, g) in it
  int slot;         // accumulator in which its children are summed, -1: leaf
  int parent_slot;  // -1: root
  bool first;       // writes its parent's slot instead of adding to it
  bool has_gamma, has_rotation;
  bool coupled;  // it follows another joint, or others follow it
  int alpha;     // LaneAngle
  double cos_gamma, sin_gamma, cos_alpha, sin_alpha;
  double turn;                  // constant turn of its frame, part of base; turns and screws
  double cos_fixed, sin_fixed;  // of the constant turn, for slides
  double r[3];
  double C[9];  // row-major
  double pitch;
  double mass, subtree_mass;
  double moment[3];   // mass times centre of mass
  double inertia[6];  // about the body frame's origin: xx xy xz yy yz zz
  double armature[3];
  double gravity[3];  // roots: gravity before the joint's own turn
};

// Storage of a joint of 1 or 3 dofs after its kinematics, in vectors: the factor (lane_factor.hpp), then the Newton
// factor (lane_newton.hpp).
const int kLaneFactor1 = 7, kLaneFactor3 = 24, kLaneNewton1 = 6 + 9 + 24, kLaneNewton3 = 6 + 9 + 72;

// Coupled joints, v = S u: a dof that follows others has the sum of ratio times their velocities (lane_coupled.hpp).
struct LaneTerm {
  int dof, joint;
  double ratio;
};
struct LaneFollower {
  int dof, joint;
  int first, count;  // of its terms, the leaders
  // Of LaneTree::path: the joints that carry it or its leaders, and these, ascending; then so many dofs of theirs.
  int path, joints, dofs;
};
struct LaneLeader {
  int dof, joint;
  int first, count;  // of its terms, the followers
};
// Followers whose trees belong together, and the range of joints and dofs in which these trees lie.
struct LaneCoupling {
  int first, count;
  int joint, joint_end, dof, dof_end;
};

struct LaneTree {
  int joints, nv, balls, slots;
  int storage;  // vectors per group of lanes
  const LaneJoint* joint;
  int followers, leaders, couplings;  // 0: no joints are coupled
  const LaneFollower* follower;
  const LaneLeader* leader;
  const LaneCoupling* coupling;
  const LaneTerm* term;
  const int* path;
};

// Numbers per stage that a factor of coupled joints takes (lane_coupled.hpp).
static constexpr int coupled_rows(const LaneTree& tree) noexcept {
  return tree.followers * (2 * tree.nv + tree.followers + 1);
}

struct LaneWork {
  int s, S;
  const double* hA;  // [j * S + i] = h A[i][j]
  const double* hb;  // [j] = h b[j]
  // [i]: h times the diagonals that replace A in the Newton matrix, and on balls 1/2 (A - 1).
  const double *he, *he_turn;
  double h;
  const double* run_h;  // in place of h, per lane, in the functions of runs
  // Start of the step, per dof.
  const double* base;       // angle (its frame's constant turn included) or displacement
  const double* ball_base;  // [ball * 9]: B, row-major
  const double* p0;
  const double* impulse;  // per dof and stage, added to the (chart) momentum of the stage; null: none
  // Linear forces -stiffness (deflection + X) - damping v + tau per dof; null: none.
  const double *stiffness, *deflection, *damping, *tau;
  // Per dof and stage.
  double* X;               // chart displacement
  double* rate;            // X'; the same array as v without balls
  double* v;               // engine velocity, the unknown
  double* P;               // M v
  double* G;               // dT/dq - dV/dq + forces, left-trivialised
  double* Y;               // balls: exp(X) G, summed for the momentum balance
  double* px;              // balls: rate of the chart momentum
  double* dv;              // residual, then correction
  double* magnitude;       // sizes of the terms of G
  const double* diagonal;  // added to the mass matrix in the factor (armature, stiffness, damping)
  double *storage, *slots;
  double* coupled;  // factors of coupled joints, coupled_rows() per stage of the mass matrix, then of Newton's matrix
  // From each array to that of its derivatives, for the functions that need them; from there on to those along a second
  // direction, twice that. Storage and slots, which these functions use for pairs and quadruples of numbers, excepted.
  long shadow;
  // Per stage.
  double* error;           // r . dv
  double* kinetic;         // P . v
  double* impulse_energy;  // of the impulses h f of the single forces f [J]
  // Adds forces to G and their size to magnitude after it was evaluated; null: none.
  void (*extra)(void* context);
  void* context;
};

// Right sides side by side, for the factor of a kernel with one lane.
struct LaneColumns {
  int width;          // columns in memory, a multiple of the lanes
  double* X;          // [dof * width + column], aligned to 64 bytes
  double* work;       // 6 (joints + slots) + followers lanes of vectors, aligned to 64 bytes
  const int* joints;  // whole trees, in the tree's order: only their dofs are read and written
  int count;
  const double* coupled;  // of the stage whose factor it is
  const int* couplings;   // of these trees
  int coupling_count;
};

enum LaneFlags {
  kLaneFactor = 1,        // the factor is made anew,
  kLaneNewton = 2,        // that of the Newton matrix, not of the mass matrix alone
  kLaneFirst = 4,         // first iteration of a step: the old X is no approximation
  kLaneKeepVelocity = 8,  // v is not changed
};

struct LaneKernel {
  int lanes;
  // Kinematics, P and G (without linear forces) at the given X and v.
  void (*evaluate)(const LaneTree*, const LaneWork*);
  // Kinematics at the given X as far as factor and solve need them.
  void (*place)(const LaneTree*, const LaneWork*);
  void (*factor)(const LaneTree*, const LaneWork*);
  void (*solve)(const LaneTree*, const LaneWork*);  // dv <- (M + diagonal)^-1 dv; S (S^T (M + diagonal) S)^-1 S^T dv
  // X <- (M + diagonal)^-1 X with the factor in the storage of a kernel with one lane.
  void (*solve_columns)(const LaneTree*, const double* storage, const LaneColumns*);
  // X from the rates, P and G there, residual p0 + hA G - P, correction dv by the stored factor, v += dv.
  void (*iterate)(const LaneTree*, const LaneWork*, int flags);
  void (*rates)(const LaneTree*, const LaneWork*);  // balls: X' from v and X
  // out[dof * S + i] (+)= sum_j weight[j * S + i] in[dof * S + j], j < s.
  void (*combine)(int nv, int s, int S, const double* weight, const double* in, double* out, bool add);
  // The derivatives of X, P, G and of the residual (dv) along a direction: that of v, of the start, of the forces and
  // of the step's length in the shadows. The values are computed beside them.
  void (*tangent)(const LaneTree*, const LaneWork*);
  // Of P and G alone, at the given X and v.
  void (*evaluate_tangent)(const LaneTree*, const LaneWork*);
  // And their derivatives along a second direction, with all shadows of X, v and base.
  void (*evaluate_second)(const LaneTree*, const LaneWork*);
  // Y (rows, width) -= A X, or Y = -A X, with A (rows, inner) in rows of stride numbers and X (inner, width), which may
  // be Y. At most 8 inner ones; a width that is a multiple of 8; X and Y aligned to 64 bytes.
  void (*subtract_product)(int rows, int inner, int width, const double* A, int stride, const double* X, double* Y,
                           bool anew);
};

// For runs whose steps have one stage each: a run in each lane, S = lanes.
struct RunKernel {
  int lanes;
  void (*iterate)(const LaneTree*, const LaneWork*, int flags);
  void (*rates)(const LaneTree*, const LaneWork*);
  // dv <- (M + diagonal)^-1 dv at the given X.
  void (*solve)(const LaneTree*, const LaneWork*);
  // Numbers [row * lanes + lane], weights [lane]. out = the sum of four past ones with their weights, in that order.
  void (*extrapolate)(int rows, const double* const* past, const double* const* weight, double* out);
  // base and end: base + (weight rate + carry); carry and lost: what that sum loses.
  void (*add)(int rows, const double* weight, const double* rate, double* base, double* carry, double* end,
              double* lost);
};

}  // namespace contactvi

extern "C" {
// Of a single stage.
extern const contactvi::LaneKernel contactvi_lanes_one_stage;
// Two widths each: for up to 4 stages and for more.
extern const contactvi::LaneKernel contactvi_lanes_base[2];
extern const contactvi::LaneKernel contactvi_lanes_avx2[2];
extern const contactvi::LaneKernel contactvi_lanes_avx512[2];
extern const contactvi::RunKernel contactvi_runs_base;
extern const contactvi::RunKernel contactvi_runs_avx2;
extern const contactvi::RunKernel contactvi_runs_avx512;
}
