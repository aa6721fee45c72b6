// The derivative of a smooth step of any order that keeps rows (step/stage_constraints.hpp): of its equations at their
// solution.
//
// Unknown are the changes dU of the chart rates at the stages and dLambda of the impulses at all nodes but the last.
// The stage equations along them are StepTangent's, with the changes of the impulses
//   d(W_k Lambda_k) = W_k dLambda_k + (dW_k . dq_k) Lambda_k,   dq_k the change of the configuration at node k,
// and beside them stand the rows, W_k^T dq_k + (d phi/dt) dt_k = 0 at the nodes after the first. As a matrix
//   [A B; C 0] (dU, dLambda) + (right sides) = 0,
// made column by column, it is solved by a factor of A and one of C A^-1 B, in which rows may depend on each other. The
// impulse at the end follows from the velocities of the rows there.
#pragma once

#include <Eigen/LU>

#include "contact/held_step_record.hpp"
#include "sensitivity/contact_step_tangent.hpp"
#include "sensitivity/held_node.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

class HeldStepTangent {
 public:
  HeldStepTangent(const Scene& scene, int stages);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const HeldStepRecord& step, const VecX& tau, const Servo* servo);
  // The derivative of (q1, p1), (nv,) each.
  void solve(const ContactStepDirection& direction, VecRef dq1, VecRef dp1);

 private:
  friend class HeldStepAdjoint;  // its transpose, from the same parts

  [[noreturn]] void refuse(const char* reason, const char* fact, const char* expected, const char* got,
                           const char* remedy) const;
  void place_nodes();
  void give_impulses();
  void make_matrix();
  void take_end();
  int stage_unknowns() const { return nv_ * stages_; }
  int unknowns() const { return stage_unknowns() + rows_ * stages_; }
  int unknown_at(int node, int row) const { return stage_unknowns() + node * rows_ + row; }
  // What the equations are off by along a direction with changes x of the unknowns, (unknowns,), and how the end
  // changes with them before its impulse.
  void assess(const ContactStepDirection& direction, const VecX& x, VecRef off, VecRef dq1, VecRef dp1);
  // x with matrix x + right = 0; and with its transpose.
  VecX solve_matrix(const VecX& right) const;
  VecX solve_transposed(const VecX& right) const;

  const Scene* scene_;
  const Tree* tree_;
  int nv_, stages_, rows_ = 0;
  const LobattoTable* table_;
  StepTangent step_;
  Integrator masses_;
  const HeldStepRecord* record_ = nullptr;
  std::vector<HeldNode> nodes_;    // s + 1
  std::vector<NodeChart> charts_;  // of the stages
  MatX weights_, to_nodes_;        // h a_ij as [j, i]; h times displacements at the nodes of rates, [j, k], (s, s + 1)
  VecX p_start_;                   // with all impulses but the last one
  MatX velocities_, impulses_;     // at the stages, (nv, s)
  StepDirection step_direction_;
  // The matrix, and what a unit of each unknown changes the end by, (2 nv, unknowns).
  MatX matrix_, ends_;
  Eigen::PartialPivLU<MatX> stage_factor_;
  MatX answers_;  // A^-1 B
  SharedLoad row_system_, end_system_;
  MatX MinvW_;  // at the end
  VecX dp_mass_, none_;
};

}  // namespace contactvi
