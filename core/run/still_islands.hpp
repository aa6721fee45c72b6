// The islands that lie still. Each repeats its last step until something changes, so that a step costs nothing for them
// and what they record is told once for all steps of a span.
#pragma once

#include <memory>
#include <vector>

#include "run/island.hpp"

namespace contactvi {

class StillIslands {
 public:
  // From now on they are these, in the order of their first trees; they have just made their last step, or made it
  // before.
  void set(std::vector<Island*> islands);
  // Appends what they do in a step from t [s]: step k of the run starts at start_time + k dt and has this length.
  void record(long step, double start_time, double dt, double t, double length, Recording& recording) const;
  // The reactions of their constraints in a step of this length, in the numbers of the account.
  void add_reactions(double length, WorkAccount& work) const;
  // The highest kind among their steps, and the length of such a step [s].
  StepKind kind() const { return kind_; }
  double kind_dt() const { return kind_dt_; }
  long dense_steps() const { return static_cast<long>(dense_.size()); }

 private:
  std::vector<Island*> islands_, constrained_;
  std::shared_ptr<StillRows> rows_;
  std::vector<DenseRecord> dense_;
  StepKind kind_ = StepKind::kFree;
  double kind_dt_ = 0.0;
};

}  // namespace contactvi
