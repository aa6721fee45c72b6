// Runs that are made side by side, as one of them sees them: the kernel does its work on their steps together.
#pragma once

namespace contactvi {

class Integrator;
class LaneIterations;

class LaneCompany {
 public:
  virtual ~LaneCompany() = default;
  // Where steps on the same tree are iterated.
  virtual LaneIterations& lanes_of(const Integrator& step) = 0;
  // Makes iterations of the step that was begun, with the same digits as alone. Where others have no use for the same
  // iterations they are left to the caller.
  virtual void iterate(Integrator& step, LaneIterations& lanes) = 0;
};

}  // namespace contactvi
