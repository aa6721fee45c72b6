// The transposed derivative of a dense step: from the gradient of some function in its end to those in all that it
// depends on.
//
// It is the transpose of DenseStepTangent::solve(), part by part in the reverse order. That of the smooth steps is
// StepAdjoint; how rows, gaps and slips change is made as matrices, column by column.
#pragma once

#include "sensitivity/dense_step_tangent.hpp"
#include "step/step_adjoint.hpp"

namespace contactvi {

// Gradients in what a dense step depends on; those of DenseStepDirection.
struct DenseStepGradient {
  VecX q, p;
  double t = 0.0, h = 0.0;
  VecX tau, mu, e;
};

class DenseStepAdjoint {
 public:
  DenseStepAdjoint(const Scene& scene, Kinks& kinks);

  // Takes a step with its inputs; it is to stay alive. Throws NoDerivative.
  void take(const DenseStepRecord& step, const VecX& tau, const Servo* servo);
  // The step that was taken, forward.
  DenseStepTangent& tangent() { return tangent_; }
  // From the gradients in (q1, p1), (nv,) each. Adds those in the parameters. False where the equations of a smooth
  // step were not solved.
  bool solve(const VecX& lq, const VecX& lp, DenseStepGradient& gradient, StepParameters& sums);

 private:
  // How all changes per unit of the configuration where points are found: of the start, or of the end of a place.
  struct Source {
    int place;                      // -1: the start
    std::vector<MatX> W0, W1;       // per degree of freedom, (nv, rows)
    std::vector<MatX> gaps, slips;  // per place, (rows, nv)
    MatX own0, own1;                // of the velocities of surfaces at both ends, (rows, nv)
  };
  // Per place: how its slips change with its end and its velocity, (rows, nv).
  struct Slips {
    MatX of_q, of_v;
  };
  struct Change {
    VecX q, v, lambda;
  };

  void set_matrices();
  void fill(Source& source, int dof);
  void pass_rows(const MatX& lW0, const MatX& lW1);
  void pass_gaps(int place, const VecX& lgaps);
  void pass_end_times(std::size_t place, const VecX& lrows);
  void pass_slips(int place, const VecX& lslips);
  void pass_coefficients(const VecX& lmu, const VecX& le, MatX& lW0, VecX& lown0);
  void pass_pull(bool at_end, const VecX& lpull);
  void pass_own(const VecX& lown0, const VecX& lown1);
  VecX& of(const Source& source) { return source.place < 0 ? lq0_ : places_[source.place].q; }
  void pass_end(const VecX& lq, const VecX& lp, StepParameters& sums);
  void pass_end_base(const DenseStepTangent::End& end, const VecX& lbase, StepParameters& sums);
  bool pass_free(StepParameters& sums);
  bool pass_round(std::size_t k, StepParameters& sums);
  void pass_masses(const DenseStepTangent::Round& round, const VecX& u, const VecX& l, StepParameters& sums);
  bool pass_step(const VecX& p_start, const DenseStepRecord::Place& place, const VecX& lq, const VecX& lv,
                 const VecX& lp, VecX& lp_start, StepParameters& sums);

  const Scene* scene_;
  DenseStepTangent tangent_;
  StepAdjoint adjoint_;
  const DenseStepRecord* record_ = nullptr;
  VecX tau_;
  const Servo* servo_ = nullptr;
  std::vector<Source> sources_;
  std::vector<Slips> slips_;
  std::vector<MatX> W1_of_q1_;
  MatX own1_of_q1_;
  // Gradients on the way.
  std::vector<Change> places_;
  VecX lq0_, lp0_, lv0_, lp_minus_, ltau_, lmu_, le_, lallowed_, work_;
  double lt_ = 0.0, lh_ = 0.0;
  MatX lW1_;
  VecX lown1_;
};

}  // namespace contactvi
