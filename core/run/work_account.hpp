// What has been done on a scene since the reset: work of inputs, losses by damping and friction, and the reactions of
// constraints. A value: part of the state of a run.
#pragma once

#include "contact/contact_step.hpp"
#include "contact/dense_step.hpp"
#include "impact/sequence.hpp"
#include "record/recording.hpp"
#include "step/integrator.hpp"

namespace contactvi {

class WorkAccount {
 public:
  // does_work: whether anything but gravity and springs does work; else nothing is counted.
  void start(double t, int constraint_rows, bool does_work);
  // Inputs do work from now on.
  void expect_inputs() { does_work_ = true; }

  // Works of one smooth step [J], taken before the integrator solves another one.
  struct FreeWork {
    double input = 0, damping = 0;
  };
  FreeWork of(const Integrator& integrator) const;
  void add(const FreeWork& work);
  void add(const ContactStep& step);
  void add(const DenseStep& step);
  void add(const ImpactSequence& impacts);
  // Adds what another account has counted since it was last taken; rows: its constraint rows in this one's numbers.
  void take(WorkAccount& part, const std::vector<int>& rows);
  void clear();
  // Appends the entries of the node at t [s] that was recorded last.
  void record_node(double t, Recording& recording);

 private:
  bool does_work_ = false;
  // Work [J] of inputs, servos and wrenches; dissipated by damping, by joint friction; of driven constraints.
  double input_ = 0, damping_ = 0, joint_friction_ = 0, driven_ = 0;
  VecX reactions_, mean_reactions_;  // impulses of the constraints since the last node; their mean force before it
  double node_time_ = 0;             // [s]
};

}  // namespace contactvi
