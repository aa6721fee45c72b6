// Where a step that keeps rows stands at its Lobatto nodes (base/lobatto.hpp), and at its stages where rows are of
// velocities: configurations, gradients of the rows, impulses along them, and the directions of slips. It is what
// StageConstraints solves for.
#pragma once

#include <vector>

#include "base/lobatto.hpp"
#include "model/constraints.hpp"
#include "model/placement.hpp"
#include "step/phase_rows.hpp"
#include "step/stages.hpp"
#include "step/step_equations.hpp"

namespace contactvi {

class StageNodes {
 public:
  StageNodes(const StageNodes&) = delete;
  StageNodes& operator=(const StageNodes&) = delete;

 protected:
  struct Node {
    double t = 0.0;
    VecX q, X, phi, rate;
    // Gradients, tangents of sliding contacts, directions in which impulses act: (nv, m), (nv, 2 slides), (nv, m).
    MatX W, T, F;
    // Along the slip and across it, (nv, slides).
    MatX along, across;
    MatX chart_W, chart_F, chart_across;  // by the chart at the start of the step
    VecX slip_across;                     // velocities
    VecX pull;                            // adhesion along W [N], (m,)
    VecX drift;                           // of surfaces that move along themselves, along the tangents T, (2 slides,)
    Placements at;
    MotionValues motions;  // at t
    explicit Node(const Tree& tree);
  };

  StageNodes(const Tree& tree, int stages);
  ~StageNodes() = default;

  // From the next step on the rows of the phase are kept besides those of the constraints; null: none.
  void hold(PhaseRows* rows);
  // The start of the step of length h from (q0, p0) at t0 [s]; forces: of the rows, (rows,), for the first impulses.
  void begin(StepEquations& equations, const VecCRef& q0, const VecCRef& p0, double t0, double h, const VecX& forces);
  // The nodes, and the rows of velocities, to which the rates of the stages lead.
  void place(const Stages& stages);
  void place(Node& node, int number);
  // The directions of the slips at a node, and what follows from them.
  void direct(Node& node, int number);
  // The coefficients at nodes from one to another one, where they depend on the slips and the forces there. Whether
  // some has changed by more than rounding.
  bool follow_slips(int from, int to);
  // Where they depend on the forces: the same with the impulses as they are, and the directions of what they act along.
  void follow_forces();
  // Sets impulse_ to what acts at a node, in the chart at the start or in the node's axes.
  void impulse_at(int node, bool chart);
  // The start momentum with all impulses but the last one; on spherical joints in the frame of the start.
  void add_impulses();
  // Whether forces at an end of the step depend on each other less than their rows do.
  bool forces_exceed_rows() const;

  const Tree* tree_;
  PhaseRows* phase_ = nullptr;
  const VecX* load_ = nullptr;
  const LobattoTable* table_;
  int fixed_, rows_, stages_;     // rows of the constraints, of all, of the stages
  int slides_ = 0, rolling_ = 0;  // sliding contacts, rows of velocities
  VecX q0_, p0_, v0_, p_start_, impulse_;
  double h_ = 0.0;
  std::vector<Node> nodes_;  // s + 1
  MatX lambda_;              // (m, s + 1)
  MatX angles_, slips_;      // (slides, s + 1)
  MatX friction_;            // coefficients of the slides, (slides, s + 1)
  std::vector<MatX> rolls_;  // per stage: W of all rows of the phase there, (nv, count)
  MatX roll_rates_;          // of them, velocities of surfaces that move along themselves, (count, s)

 private:
  void resize();
  void to_chart(const Node& node, const MatX& from, MatX& to) const;
  void place_rates(const Stages& stages);

  double t0_ = 0.0;
  bool varies_ = false;  // whether the coefficient of some slide does
  std::vector<PhaseRows::SlideState> slide_states_;
  VecX q_stage_, X_stage_, phi_;
};

}  // namespace contactvi
