// Whether a smooth step is beyond doubt the whole motion of a scene in its time: no guard comes near zero, no actuator
// reaches a limit. What is not beyond doubt here, a run decides.
#pragma once

#include "geometry/guard.hpp"
#include "step/path.hpp"
#include "step/public_step.hpp"

namespace contactvi {

class ClearStep {
 public:
  ClearStep(const Scene& scene, int stages);

  // Of a step that was solved by this integrator.
  bool check(const PublicStep& step, Integrator& integrator, const StepInputs& inputs, double h);

 private:
  bool actuators_are_free(const PublicStep& step, const Integrator& integrator, const StepInputs& inputs) const;
  bool guards_are_open(const PublicStep& step, Integrator& integrator, double h);
  bool is_open(int guard);

  const Scene* scene_;
  Guards guards_;
  StepPath path_;
  VecX bound_, change_;
  Contact contact_;
};

}  // namespace contactvi
