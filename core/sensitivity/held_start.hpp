// The start of a held step where contacts or joints slide: the velocity there, and the directions of the slips.
#pragma once

#include "sensitivity/slip_start.hpp"
#include "step/step_adjoint.hpp"
#include "step/step_tangent.hpp"

namespace contactvi {

class HeldStart {
 public:
  HeldStart(const Scene& scene, Kinks& kinks);

  // Takes a step whose first node this is, with its inputs; all are to stay alive. momenta: has M. Throws NoDerivative.
  void take(HeldNode& node, const HeldStepRecord& step, PersistentRows& phase, const VecX& tau, const Servo* servo,
            StepTangent& momenta);
  const VecX& velocity() const { return v0_; }
  VecX velocity_change(const ContactStepDirection& direction) const;
  // Of the numbers of the slips (held_node.hpp); dmu: of their coefficients of friction, (slides,).
  VecX turns(const ContactStepDirection& direction, const VecX& dmu);
  // What begins to slide is at rest: along a direction that moves it there is a kink.
  void check(const ContactStepDirection& direction);
  // From the gradients in the numbers and in the velocity to those in the parameters.
  void pass(VecX lnumbers, VecX lv, StepAdjoint& momenta, StepParameters& sums);

 private:
  void meet_moved(int guard) const;
  Eigen::Index slides() const { return slips_.size(); }

  const Scene* scene_;
  Kinks* kinks_;
  Integrator masses_;
  const HeldNode* node_ = nullptr;
  const HeldStepRecord* record_ = nullptr;
  StepTangent* momenta_ = nullptr;
  std::vector<int> guards_;  // of the slides
  VecX v0_, slips_;          // the slips along their directions
  // M^-1, d(M v)/dq, and by the configuration the changes of the equations of the numbers and of the slips along their
  // directions.
  MatX inverse_, mass_change_, watched_change_, along_change_;
  MatX watched_;     // gradients of these equations, (nv, numbers),
  VecX own_, by_t_;  // by the number of each, and by the time
  SlipStart slip_start_;
};

}  // namespace contactvi
