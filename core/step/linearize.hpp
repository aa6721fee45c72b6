// The derivative of one smooth step in public coordinates, all columns: A and B of the discrete-time linear system.
#pragma once

#include <memory>
#include <optional>

#include "step/public_step.hpp"
#include "step/step_map.hpp"

namespace contactvi {

struct LinearStep {
  VecX q1, x1;  // the end: configuration, and velocity or momentum
  MatX A;       // d(q1, x1)/d(q0, x0), (2 nv, 2 nv), tangent vectors of Pinocchio
  MatX B;       // d(q1, x1)/d tau, (2 nv, nv)
  VecX h;       // d(q1, x1)/dh, (2 nv,)
};

// Fills A, B and h column by column. Direction: a change of q, p, tau and h; to_engine(q, p) turns a public change of
// the start into the engine's, solve(direction, column) fills the change of the end.
template <class Direction, class ToEngine, class Solve>
void fill_columns(LinearStep& result, int n, const ToEngine& to_engine, const Solve& solve) {
  result.A.resize(2 * n, 2 * n);
  result.B.resize(2 * n, n);
  result.h.resize(2 * n);
  Direction direction;
  for (int k = 0; k < 2 * n; ++k) {
    direction.q = VecX::Zero(n);
    direction.p = VecX::Zero(n);
    (k < n ? direction.q[k] : direction.p[k - n]) = 1.0;
    to_engine(direction.q, direction.p);
    solve(direction, result.A.col(k));
  }
  direction = Direction();
  for (int k = 0; k < n; ++k) {
    direction.tau = VecX::Unit(n, k);
    solve(direction, result.B.col(k));
  }
  direction = Direction();
  direction.h = 1.0;
  solve(direction, result.h);
}

// Linearises one step after the other of a tree.
class StepLinearizer {
 public:
  StepLinearizer(const Tree& tree, int stages, double tol);

  // A step of length h from (q0, x0), which stays solved until the next call. Throws Refusal where it cannot be solved.
  // What was solved before changes no digit.
  const LinearStep& solve(const VecX& q0, const VecX& x0, StateKind kind, double h, const StepInputs& inputs);
  // The same by one tangent equation per column (step_tangent.hpp): slow, and the reference of tests.
  const LinearStep& solve_by_columns(const VecX& q0, const VecX& x0, StateKind kind, double h,
                                     const StepInputs& inputs);
  // Of the last call.
  const PublicStep& step() const { return *step_; }
  Integrator& integrator() { return integrator_; }
  // How much of a velocity of size one is lost at the start (step/lost_velocity.hpp).
  double lost_velocity();

 private:
  void make_step(const VecX& q0, const VecX& x0, StateKind kind, double h, const StepInputs& inputs);
  void solve_columns();

  const Tree* tree_;
  int stages_;
  Integrator integrator_;
  std::unique_ptr<StepMap> maps_[2];  // in velocities, in momenta
  std::optional<PublicStep> step_;
  LinearStep result_;
};

// Forces of springs, dampers and elements, without servos and gravity, at q, v and t [s], in public coordinates, (nv,).
VecX passive_forces(const Tree& tree, const VecX& q, const VecX& v, double t);

// Forces of springs, dampers, servos and elements at a state, without gravity, in public coordinates.
struct LinearForces {
  VecX f;         // (nv,)
  MatX f_q, f_v;  // (nv, nv), tangent vectors of Pinocchio
};
LinearForces linearize_forces(const Tree& tree, const VecX& q, const VecX& v, const StepInputs& inputs);

}  // namespace contactvi
