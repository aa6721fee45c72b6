// A smooth step at its solution, of which derivatives are taken: its start, length and forces, the stages with their
// velocities, and the factor that the step's iterations use there.
#pragma once

#include "step/stages.hpp"
#include "step/stiff_terms.hpp"

namespace contactvi {

class SolvedStep {
 public:
  SolvedStep(const Tree& tree, int stages);
  SolvedStep(const SolvedStep&) = delete;
  SolvedStep& operator=(const SolvedStep&) = delete;

  // The start, length and forces of the step, and the velocities at its stages, (nv, s). The servo must live on.
  void take(const VecX& q0, const VecX& p0, double h, const VecX& tau, double time, const Servo* servo,
            const MatX& velocities);
  // Sets other stages of the same tree to this step, with its v and X.
  void copy_to(Stages& other) const;
  // dv <- D^-1 dv of the stages, D being the matrix of the step's iterations, or with D^T.
  void solve();
  void solve_transposed();

  const FlatModel& model() const { return model_; }
  Stages& stages() { return stages_; }  // at the solution: X, v, P, and G with all forces
  const VecX& q0() const { return q0_; }
  const VecX& p0() const { return p0_; }
  double time() const { return time_; }     // of its start [s]
  const VecX& tau() const { return tau_; }  // public coordinates; empty: none

 private:
  const Tree* tree_;
  FlatModel model_;
  Stages stages_;
  StiffTerms stiff_;
  VecX q0_, p0_, tau_;
  double time_ = 0.0;
};

}  // namespace contactvi
