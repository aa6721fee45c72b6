// The derivative of a smooth step of any order that keeps rows (step/stage_constraints.hpp): of its equations at their
// solution.
//
// Unknown are the changes dU of the chart rates at the stages and dLambda of the impulses at all nodes but the last.
// The stage equations along them are StepTangent's, with the changes of the impulses
//   d(W_k Lambda_k) = W_k dLambda_k + (dW_k . dq_k) Lambda_k,   dq_k the change of the configuration at node k,
// and beside them stand the rows, W_k^T dq_k + (d phi/dt) dt_k = 0 at the nodes after the first. What the rows of
// contacts are off by at the start goes within the step, as the step has it; where a material point sticks its
// displacement counts from an anchor, or from the start. Rows of surfaces that roll stand at the stages instead,
// W_i^T dv_i + (dW_i . dq_i)^T v_i = 0. As a matrix
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
  // contact_points: of a pair, at most.
  HeldStepTangent(const Scene& scene, int stages, int contact_points);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const HeldStepRecord& step, const VecX& tau, const Servo* servo);
  // The derivative of (q1, p1), (nv,) each.
  void solve(const ContactStepDirection& direction, VecRef dq1, VecRef dp1);
  // Of a contact's material point: the derivative, by q0, of its place in the frame of the plane's body, (3, nv).
  MatX start_place_change(std::size_t contact) { return nodes_[0].place_change(record_->contacts[contact].point); }

 private:
  friend class HeldStepAdjoint;  // its transpose, from the same parts

  [[noreturn]] void refuse(const char* reason, int guard, const char* fact, const char* expected,
                           const std::string& got, const char* remedy) const;
  [[noreturn]] void refuse_unsolved() const;
  int first_guard() const;  // of its contacts; -1: it has none
  void place_nodes();
  void give_impulses();
  void make_matrix();
  void take_end();
  int stage_unknowns() const { return nv_ * stages_; }
  int unknowns() const { return stage_unknowns() + rows_ * stages_; }
  int held() const { return rows_ - fixed_; }
  // The impulses of a node among the unknowns x, or the equations of the node after it: (rows,).
  VecX of_node(const VecX& x, int node) const;
  void set_node(VecRef x, int node, const VecX& values) const;
  VecX row_sizes(const ContactStepDirection& direction, double length) const;
  VecX anchor_changes(const ContactStepDirection& direction, const VecX& start) const;
  // What the equations are off by along a direction with changes x of the unknowns, (unknowns,), and how the end
  // changes with them before its impulse.
  void assess(const ContactStepDirection& direction, const VecX& x, VecRef off, VecRef dq1, VecRef dp1);
  // x with matrix x + right = 0; and with its transpose.
  // size: of the terms of the equations of rows; agree: whether those that depend on each other do not contradict.
  VecX solve_matrix(const VecX& right, const VecX& size, bool& agree) const;
  VecX solve_transposed(const VecX& right) const;

  const Scene* scene_;
  const Tree* tree_;
  int nv_, stages_;
  int fixed_, rows_ = 0;  // rows of the constraints, of all
  const LobattoTable* table_;
  StepTangent step_;
  Integrator masses_;
  Guards guards_;
  PersistentRows phase_;
  const HeldStepRecord* record_ = nullptr;
  std::vector<int> rolling_;  // rows of velocities
  HeldNode at_stage_;
  std::vector<MatX> roll_W_, roll_change_;  // of these at each stage: W (nv, count), d(W^T v)/dq (count, nv)
  std::vector<HeldNode> nodes_;             // s + 1
  std::vector<NodeChart> charts_;           // of the stages
  MatX weights_, to_nodes_;     // h a_ij as [j, i]; h times displacements at the nodes of rates, [j, k], (s, s + 1)
  VecX p_start_;                // with all impulses but the last one
  MatX velocities_, impulses_;  // at the stages, (nv, s)
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
