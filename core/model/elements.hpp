// What pushes, drives and closes a tree, beyond its joints' linear springs and damping: data, fixed when the scene is
// made. Forces are evaluated in forces.hpp, constraints in constraints.hpp.
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

// Value, rate and acceleration of a number that the user drives, at a time [s].
using Signal = std::function<std::array<double, 3>(double)>;

// V(x) = sum_k coefficients[k] x^(k+2), x = q - rest of a joint with one number in q.
struct JointPotential {
  int joint;
  double rest;
  std::vector<double> coefficients;
};

// Spring and damper along a line through points: V = k/2 (l - l0)^2 of its length l, tension k (l - l0) + c dl/dt. One
// that only pulls does nothing below l0, and its tension is never negative.
struct PathSpring {
  std::vector<BodyFrame> points;
  double stiffness, rest_length, damping;
  bool tension_only;
};

// Force and torque (3 + 3) at a frame's origin, in world axes or in the frame's.
struct AppliedWrench {
  BodyFrame at;
  bool world_axes;
  Eigen::Matrix<double, 6, 1> value;
  std::function<Eigen::Matrix<double, 6, 1>(double)> signal;  // of time, instead of value, if set
};

// Functions of the user, public coordinates. Whatever goes wrong in them they return NaN and keep the reason.
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

// See constraints.hpp for the residuals.
struct Constraint {
  ConstraintKind kind;
  BodyFrame a, b;                  // kPoint to kScrew
  int joint_a = -1, joint_b = -1;  // kEquality, kPrescribed: engine joints
  std::vector<double> numbers;
  Signal signal;  // empty: numbers
  int row = 0, rows = 0;
  std::string name = {};
};

struct Elements {
  VecX joint_friction;  // nv, or empty
  // Servos of joints with one number in q: gains [N m/rad; N m s/rad] and largest torque; empty: none.
  VecX servo_kp, servo_kd, servo_effort;
  // Largest effort and speed of the joints' actuators; empty: no limits.
  VecX effort, speed;
  std::vector<JointPotential> joint_potentials;
  std::vector<PathSpring> path_springs;
  std::vector<AppliedWrench> wrenches;
  std::vector<UserForce> forces;
  std::vector<UserPotential> potentials;
  std::vector<Constraint> constraints;
  int constraint_rows = 0;
  std::vector<int> friction_dofs;  // with friction
  // Owner of the users' functions, which the ones above call.
  std::shared_ptr<void> functions;
  // Whether a function of the user has failed: a run then ends at once.
  std::shared_ptr<bool> failed = std::make_shared<bool>(false);

  bool any_force() const {
    return !(joint_potentials.empty() && path_springs.empty() && wrenches.empty() && forces.empty() &&
             potentials.empty());
  }
  // Whether every step has to satisfy something.
  bool constrained() const { return !constraints.empty() || !friction_dofs.empty(); }
  // Whether a constraint depends on time: its forces do work.
  bool driven() const {
    for (const Constraint& c : constraints)
      if (c.signal) return true;
    return false;
  }
};

}  // namespace contactvi
