// Dynamics of a tree: everything the integrator and the contact layer ask of a mechanical model, and nothing else.
//
//   momentum_and_forces   P = M v, dT/dq and dV/dq (left-trivialised) in one forward and one backward pass, no matrices
//   assemble_newton       M + h/2 (A - A^T) + Lie terms, A = d(M v)/dq, into the tree-sparse matrix
//   assemble_mass         M
//   world_placements      poses of the bodies, for contact geometry
//
// Formulas (X: parent to body, H_j: momentum of j's subtree in frame j, I_j: its composite inertia, S_j constant):
//   P_j = S_j^T H_j ;  (dT/dq)_j = -S_j^T ((X v_parent) x* H_j) ;  (dV/dq)_j = -S_j^T [M_j g ; c_j x g]
//   A_jk = -S_j^T I_j w_k for k above or in j's joint, S_j^T (S_k x* H_k - I_k w_k) for k below,
//          w_k = S_k x (X v_parent)
// (A: rigid motion of k's subtree leaves its momenta unchanged but for the velocity it inherits.)
#pragma once

#include <vector>

#include "tree.hpp"
#include "tree_lu.hpp"

namespace contactvi {

struct Composite {  // composite rigid body inertia in a body frame
  double mass;
  Vec3 first_moment;
  Mat3 inertia;
};

struct BodyState {
  Mat3 R;           // body frame in the parent's
  Vec3 r;           // its origin in the parent's
  Twist inherited;  // X v_parent
  Twist velocity;
  Wrench momentum;  // after the backward pass: of the whole subtree
  Vec3 gravity;     // in the body frame
  double subtree_mass;
  Vec3 subtree_moment;
};

struct KernelWorkspace {
  explicit KernelWorkspace(const Tree& tree);
  std::vector<BodyState> bodies;
  std::vector<Composite> composites;
  std::vector<Mat3> R_W;  // body frames in the world, filled by world_placements
  std::vector<Vec3> p_W;
};

// Placements of the bodies in their parents (R, r) at q.
void local_placements(const Tree& tree, const VecCRef& q, KernelWorkspace& ws);

// P = M v, dT = dT/dq, dV = dV/dq of gravity alone; each of shape (nv,).
void momentum_and_forces(const Tree& tree, const VecCRef& q, const VecCRef& v, KernelWorkspace& ws, VecRef P, VecRef dT,
                         VecRef dV);

// Needs momentum_and_forces at the same (q, v) before. P = M v enters through the Lie terms of spherical joints.
void assemble_newton(const Tree& tree, double h, const VecCRef& P, KernelWorkspace& ws, TreeLu& matrix);

// Needs local_placements (or momentum_and_forces) at the same q before.
void assemble_mass(const Tree& tree, KernelWorkspace& ws, TreeLu& matrix);

// Needs local_placements (or momentum_and_forces) at the same q before.
void world_placements(const Tree& tree, KernelWorkspace& ws);

// Potential energy of gravity; needs world_placements.
double gravity_potential(const Tree& tree, const KernelWorkspace& ws);

}  // namespace contactvi
