// The derivative of a smooth step of any order that keeps rows (step/stage_constraints.hpp): of its equations at their
// solution.
//
// Unknown are the changes dU of the chart rates at the stages, dLambda of the impulses at all nodes but the last, and
// of the directions in which contacts slide at the nodes between both ends. The stage equations along them are
// StepTangent's, with the changes of the forces F_k Lambda_k at the nodes (held_node.hpp),
//   d(F_k Lambda_k) = F_k dLambda_k + (dF_k / ddirection) Lambda_k ddirection + (dF_k . dq_k) Lambda_k,
// dq_k the change of the configuration at node k. Beside them stand the rows, W_k^T dq_k + (d phi/dt) dt_k = 0 at the
// nodes after the first. What the rows of contacts are off by at the start goes within the step, as the step has it;
// where a material point sticks its displacement counts from an anchor, or from the start, that of a joint from the
// start. Rows of surfaces that roll, and of joints without a coordinate, stand at the stages instead,
// W_i^T dv_i + (dW_i . dq_i)^T v_i = 0. And the slips across their directions stay zero, of the path that is raised by
// the velocities at both ends (held_slips.hpp). Where friction depends on the speed of slips their coefficients are
// unknown beside the directions; both are the numbers of the slips (held_node.hpp). As a matrix
//   [A B; C D] (dU, dLambda and numbers) + (right sides) = 0,
// made column by column, it is solved by a factor of A and one of D - C A^-1 B, in which rows may depend on each other.
// The velocity at the end, and the impulse and the numbers there, follow from all that is before it, by the rows and
// slips there (held_end.hpp); they are functions in these equations, and so are the numbers at the start
// (held_start.hpp).
#pragma once

#include <Eigen/LU>

#include "contact/held_step_record.hpp"
#include "sensitivity/contact_step_tangent.hpp"
#include "sensitivity/held_end.hpp"
#include "sensitivity/held_slips.hpp"
#include "sensitivity/held_start.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

class HeldStepTangent {
 public:
  // contact_points: of a pair, at most.
  HeldStepTangent(const Scene& scene, int stages, int contact_points, Kinks& kinks);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const HeldStepRecord& step, const VecX& tau, const Servo* servo);
  // The derivative of (q1, p1), (nv,) each.
  void solve(const ContactStepDirection& direction, VecRef dq1, VecRef dp1);
  // Of the last direction: those of the slips that come to rest at the end, the first of which ended the step [m/s;
  // rad/s]; and the sizes of their terms.
  const VecX& slip_changes() const { return slip_changes_; }
  const VecX& slip_sizes() const { return slip_sizes_; }
  // Its end, which a force ends.
  PhaseEnd phase_end() { return end_.phase_end(phase_, stages_); }
  // Of a contact's material point: the derivative, by q0, of its place in the frame of the plane's body, (3, nv).
  MatX start_place_change(std::size_t contact) { return nodes_[0].place_change(record_->contacts[contact].point); }

 private:
  friend class HeldStepAdjoint;  // its transpose, from the same parts

  [[noreturn]] void refuse(const char* reason, int guard, const char* fact, const char* expected,
                           const std::string& got, const char* remedy) const;
  // An obstacle that is a kink.
  void meet(const char* reason, const char* fact, const char* expected, const std::string& got,
            const char* remedy) const;
  [[noreturn]] void refuse_unsolved() const;
  int first_guard() const;  // of its contacts; -1: it has none
  std::vector<std::array<int, 2>> find_features(const VecX& X);
  void place_nodes();
  HeldNode::Acting acting(int node) const;
  void give_impulses();
  void make_matrix();
  int stage_unknowns() const { return nv_ * stages_; }
  bool slides() const { return slides_ > 0 || !record_->joints.empty(); }
  int numbers() const { return varies_ ? 2 * slides_ : slides_; }  // of the slips at a node
  int turns() const { return numbers() * (stages_ - 1); }
  int unknowns() const { return stage_unknowns() + rows_ * stages_ + turns(); }
  int held() const { return rows_ - fixed_; }
  int turns_at(int node) const { return stage_unknowns() + rows_ * stages_ + (node - 1) * numbers(); }
  // The impulses of a node among the unknowns x, with the numbers there, (rows + numbers,); start: those of the first.
  VecX of_node(const VecX& x, int node, const VecX& start) const;
  // The equations of the rows at the node after it: (rows,).
  void set_node(VecRef x, int node, const VecX& values) const;
  VecX anchor_changes(const ContactStepDirection& direction, const VecX& start) const;
  VecX friction_changes(const ContactStepDirection& direction) const;
  VecX force_change(int node, const ContactStepDirection& direction, const VecX& dq, const VecX& impulses) const;
  VecX start_numbers(const ContactStepDirection& direction);
  // Along a direction and with changes x of the unknowns, (unknowns,): what the equations are off by, and what the end
  // changes by, as HeldEnd has it. start: changes of the numbers at the start. False where the impulse at the end
  // does not exist; size: of the terms of its equations.
  bool assess(const ContactStepDirection& direction, const VecX& x, const VecX& start, const VecX& size, VecRef off,
              VecRef end);
  // x with matrix x + right = 0; and with its transpose.
  // size: of the terms of the equations of rows; agree: whether those that depend on each other do not contradict.
  VecX solve_matrix(const VecX& right, const VecX& size, bool& agree) const;
  VecX solve_transposed(const VecX& right) const;

  const Scene* scene_;
  const Tree* tree_;
  int nv_, stages_;
  Kinks* kinks_;
  int fixed_, rows_ = 0, slides_ = 0;  // rows of the constraints, of all; contacts that slide
  bool varies_ = false;                // the friction of any of these depends on its speed
  const LobattoTable* table_;
  StepTangent step_;
  Guards guards_;
  PersistentRows phase_;
  const HeldStepRecord* record_ = nullptr;
  std::vector<int> rolling_;           // rows of velocities
  std::vector<std::size_t> slide_of_;  // contact of each slide
  HeldNode at_stage_;
  // Of these at each stage: W (nv, count), and the derivatives of W^T v by q (count, nv) and by the time (count,).
  std::vector<MatX> roll_W_, roll_change_;
  std::vector<VecX> roll_rates_;
  std::vector<HeldNode> nodes_;    // s + 1
  std::vector<NodeChart> charts_;  // of the stages
  MatX weights_, to_nodes_;        // h a_ij as [j, i]; h times displacements at the nodes of rates, [j, k], (s, s + 1)
  VecX p_start_;                   // with all impulses but the last one
  MatX velocities_, impulses_;     // at the stages, (nv, s)
  MatX dX_, dX_nodes_;             // along the present direction
  StepDirection step_direction_;
  HeldStart start_;  // where something slides
  HeldSlips slips_;  // where contacts do
  HeldEnd end_;
  // The matrix, and what a unit of each unknown changes the end by, (end_.size(), unknowns).
  MatX matrix_, ends_;
  Eigen::PartialPivLU<MatX> stage_factor_;
  MatX answers_;  // A^-1 B
  SharedLoad row_system_;
  VecX slip_changes_, slip_sizes_;
  VecX none_;
};

}  // namespace contactvi
