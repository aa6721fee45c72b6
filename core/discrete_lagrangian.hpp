// The midpoint discrete Lagrangian L_d(q0, v; h) = h L(q0 (+) h v/2, v), q1 = q0 (+) h v, and its two momenta.
//
// Forced discrete Euler-Lagrange equation in position-momentum form (Marsden, West 2001; on the group as in design of
// trep, Johnson, Murphey 2009): with q_m = q0 (+) h v/2, P = M(q_m) v, Q = dT/dq - dV/dq + F at (q_m, v),
//   1-dof and translation joints   p0 = P - h/2 Q                               p1 = P + h/2 Q
//   spherical joints, xi = h v     p0 = Jr(xi)^-1 [P + h/2 Jl(xi/2) Q] - h exp(xi/2) Q
//                                  p1 = exp(-xi) (p0 + h exp(xi/2) Q)
// where Jr^-1 stands for exp(xi) Jr(xi)^-T = Jr(xi)^-1 and Jl(xi/2) = Jr(xi/2)^T. p1 is formed from the given p0 and
// the balance of momentum, so what is left of the residual cannot make momentum maps drift.
#pragma once

#include "kernel.hpp"

namespace contactvi {

struct StepWorkspace {
  explicit StepWorkspace(const Tree& tree);
  KernelWorkspace kernel;
  VecX q_mid;      // nq
  VecX P, dT, dV;  // nv
  VecX force;      // nv, Q = dT/dq - dV/dq + F
  VecX magnitude;  // nv, sum of the absolute values that cancel in Q
  VecX residual;   // nv
};

// r(v) = p0 - p0(v) into ws.residual; leaves P, Q and the kernel at (q_m, v) in ws. tau: external generalized force in
// public coordinates at q_m, shape (nv,) or empty.
void residual(const Tree& tree, const VecCRef& q0, const VecCRef& p0, const VecCRef& v, double h, const VecX& tau,
              StepWorkspace& ws);

// -dr/dv to O(h^2), from the workspace left by residual(); factored. False if it is not positive.
bool newton_matrix(const Tree& tree, double h, StepWorkspace& ws, TreeLu& matrix);

// p1 from the workspace left by residual() at the solution v.
void end_momentum(const Tree& tree, const VecCRef& p0, const VecCRef& v, double h, const StepWorkspace& ws, VecRef p1);

// Power of damping and external forces at the midpoint [W], from the workspace left by residual() at v.
double nonconservative_power(const Tree& tree, const VecX& v, const VecX& tau, const StepWorkspace& ws);

// dV/dq of the springs at q added to dV, and their energy returned.
double add_springs(const Tree& tree, const VecCRef& q, VecRef dV);

}  // namespace contactvi
