// The masses with which a dense step solves its contact problem, and how they change with the step.
//
// They are the matrix of the step's iterations, tree by tree: its factor is made with the velocity at the start, and it
// is applied where the step without impulses has its middle. Their derivative is taken by differences of fourth order,
// over 1e-3 rad or m: what these leave out and their rounding is below 1e-12 of the masses.
#pragma once

#include "contact/dense_rows.hpp"
#include "contact/dense_step_record.hpp"
#include "step/impulse_step.hpp"

namespace contactvi {

class StepMasses {
 public:
  explicit StepMasses(const Scene& scene);

  // Takes a step with its inputs; v0: the velocity at its start.
  void take(const DenseStepRecord& step, const VecX& tau, const Servo* servo, const VecX& v0);
  // The changes of D u per unit of the start q0, of the velocity there, of that of the step without impulses, (nv, nv)
  // each, and of the length, side by side: (nv, 3 nv + 1).
  MatX effect(const VecX& u) const;

 private:
  // Of which of the three, or of the length.
  enum Of { kStart, kStartVelocity, kVelocity, kLength };
  void add(Of of, int dof, double change, double weight, MatX& D);
  template <class Visit>
  void each_block(Visit visit) const;

  const Scene* scene_;
  ImpulseStep integrator_;
  DenseRows rows_;
  int largest_ = 0;  // block
  const DenseStepRecord* step_ = nullptr;
  VecX tau_, v0_;
  std::vector<MatX> changes_;  // per quantity and degree of freedom of the blocks, (nv, largest block)
};

}  // namespace contactvi
