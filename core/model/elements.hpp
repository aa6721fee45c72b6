// Forces, actuators and constraints on a tree, beyond its joints' linear springs and damping: data that is fixed when
// the scene is made. Forces are evaluated in forces.hpp, constraints in constraints.hpp.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

// A frame fixed to a body (engine joint; -1: world), in that body's frame.
struct BodyFrame {
  int body = -1;
  Mat3 R_B = Mat3::Identity();
  Vec3 p_B = Vec3::Zero();
};

// Value, rate and acceleration of a number that the user prescribes, at a time [s].
using Signal = std::function<std::array<double, 3>(double)>;

// V(x) = sum_k coefficients[k] x^(k+2), x = q - rest of a joint with one number in q.
struct JointPotential {
  int joint;
  double rest;
  std::vector<double> coefficients;
};

// Spring and damper along a line through points: V = k/2 (l - l0)^2 of its length l, tension k (l - l0) + c dl/dt. With
// tension_only it does nothing below l0, and its tension is never negative.
struct PathSpring {
  std::vector<BodyFrame> points;
  double stiffness, rest_length, damping;
  bool tension_only;
};

class ContactFunction;  // model/contact_function.hpp

// The normal force of a compliant contact of depth d, and its friction at the slip speed s:
// f = stiffness d^exponent (1 + damping d'), never negative, and friction f s / sqrt(s^2 + slip_speed^2).
struct ComplianceLaw {
  double stiffness;   // [N/m^exponent]
  double exponent;    // >= 1; of a law of the user, the power with which its force grows from the opening on
  double damping;     // [s/m]
  double friction;    // Coulomb's coefficient
  double slip_speed;  // [m/s], > 0
  // Laws of the user: the force of (depth, its rate) in the place of the first three numbers, the energy of (depth, 0)
  // of which the force at rest is the slope, and the bound on friction of (normal force, slip speed) in the place of
  // friction f. Null: none.
  std::shared_ptr<const ContactFunction> force = nullptr, energy = nullptr, bound = nullptr;
  bool rubs() const { return friction > 0.0 || bound != nullptr; }
  bool dissipates() const { return damping > 0.0 || rubs() || force != nullptr; }
};

struct TouchingShapes;  // model/touching_shapes.hpp

// Where the two shapes of a compliant pair press on each other. Bodies are engine joints, -1: world.
struct CompliantContact {
  int body_a, body_b;
  ComplianceLaw law;
  std::shared_ptr<const TouchingShapes> shapes;
  int pair;       // among the compliant pairs of the whole scene
  bool reversed;  // whether the first shape of that pair is b's
};

// Force [N] and torque [N m] (3 + 3) at a frame's origin, in world axes or in the frame's.
struct AppliedWrench {
  BodyFrame at;
  bool world_axes;
  Eigen::Matrix<double, 6, 1> value;
  std::function<Eigen::Matrix<double, 6, 1>(double)> signal;  // of time, instead of value, if set
};

// Functions of the user, in public coordinates. Where one fails it returns NaN, and its owner keeps the reason.
struct UserForce {
  std::function<void(double, const VecX&, const VecX&, VecX&)> value;              // t, q, v -> generalized force
  std::function<void(double, const VecX&, const VecX&, MatX&, MatX&)> derivative;  // -> df/dq, df/dv; may be empty
};
struct UserPotential {
  std::function<double(const VecX&)> value;
  std::function<void(const VecX&, VecX&)> gradient;
  std::function<void(const VecX&, MatX&)> hessian;  // may be empty
};

enum class ConstraintKind { kPoint, kDistance, kWeld, kScrew, kEquality, kPrescribed };

// The residuals are in constraints.hpp.
struct Constraint {
  ConstraintKind kind;
  BodyFrame a, b;                  // kPoint to kScrew
  int joint_a = -1, joint_b = -1;  // kEquality, kPrescribed: engine joints
  std::vector<double> numbers;
  Signal signal;  // empty: numbers
  int row = 0, rows = 0;
  std::string name = {};
};

// Owner of the users' functions that elements call. Whether one of them has failed, after which a run ends at once, is
// known per thread, because runs of one scene in several threads do not end each other.
class UserCalls {
 public:
  virtual ~UserCalls() = default;
  bool failed() const { return failed_ == this; }
  void fail() const { failed_ = this; }
  void forget_failure() const {
    if (failed()) failed_ = nullptr;
  }

 private:
  inline static thread_local const UserCalls* failed_ = nullptr;
};

struct Elements {
  VecX joint_friction;  // bounds of the joints' friction [N; N m], nv, or empty
  // Servos of joints with one degree of freedom: gains [N m/rad; N m s/rad] and largest torque; empty: none.
  VecX servo_kp, servo_kd, servo_effort;
  // Largest effort and speed of the joints' actuators; empty: no limits.
  VecX effort, speed;
  std::vector<JointPotential> joint_potentials;
  std::vector<PathSpring> path_springs;
  std::vector<CompliantContact> compliances;
  std::vector<std::shared_ptr<const ContactFunction>> contact_functions;  // which their laws share
  std::vector<AppliedWrench> wrenches;
  std::vector<UserForce> forces;
  std::vector<UserPotential> potentials;
  std::vector<Constraint> constraints;
  int constraint_rows = 0;
  // Those that were given, with their own rows: some of them may be couplings of joints, which steps know as
  // coordinates (model/coupling.hpp).
  std::vector<Constraint> given_constraints;
  int given_rows = 0;
  std::vector<int> friction_dofs;        // those whose joint friction is not 0
  std::shared_ptr<UserCalls> functions;  // of the users; null: none

  bool any_force() const {
    return !(joint_potentials.empty() && path_springs.empty() && compliances.empty() && wrenches.empty() &&
             forces.empty() && potentials.empty());
  }
  bool user_failed() const { return functions && functions->failed(); }
  // Calls from now on count anew.
  void forget_failure() const {
    if (functions) functions->forget_failure();
  }
  // Whether every step needs impulses, with contacts or without.
  bool constrained() const { return !constraints.empty() || !friction_dofs.empty(); }
  // Whether a constraint depends on time, so that its forces do work.
  bool driven() const {
    for (const Constraint& c : constraints)
      if (c.signal) return true;
    return false;
  }
};

}  // namespace contactvi
