// A world that is advanced step by step, with the record of the steps that nobody has asked for yet. A step appends to
// arrays; what is made of them for the caller is made where it is asked for.
#pragma once

#include "run/world.hpp"

namespace contactvi {

class SteppedWorld : public World {
 public:
  using World::World;

  // The contact problems that steps pose are kept from now on, where all trees are advanced together.
  void keep_problems() { World::keep_problems(&problems_); }
  ProblemLog& problems() { return problems_; }

  // How a step went. kNotable: the caller has to look at the status, at an error of a function of the user, or at a
  // record that has grown to its limit.
  enum class Outcome { kOrdinary, kNotable };
  // Time [s], q and p at the start of the last call of step_once().
  struct Before {
    double time = 0;
    VecX q, p;
    bool known = false;
  };
  // What was recorded since it was last taken.
  struct Record {
    Recording recording;
    Status status;
    double seconds = 0;   // wall time of the steps
    bool forced = false;  // whether some input was not zero
  };

  // How many nodes are recorded before a step is notable for it; 0: of the step before nothing is kept.
  void limit_record(std::size_t nodes) { limit_ = nodes; }
  // The inputs of the next step_once(), nv and 2 nv numbers; null: none. False, and nothing is set, where a force is
  // not a number of ordinary size.
  bool set_step_inputs(const double* tau, const double* target);
  Outcome step_once(const Progress& progress);
  // Steps with these inputs until one is notable, `most` of them at most; returns how many were ordinary.
  long step_while_ordinary(long most, const Progress& progress);
  bool stepping() const { return stepping_; }
  bool has_record() const { return !record_.recording.t.empty(); }
  Record take_record() { return std::exchange(record_, Record()); }
  const Before& before() const { return before_; }
  // Forgets what was recorded and where the last step started.
  void forget_steps();

 private:
  ProblemLog problems_;
  Record record_;
  Before before_;
  MatX step_tau_, step_target_;
  std::size_t limit_ = static_cast<std::size_t>(-1);
  bool stepping_ = false;
};

}  // namespace contactvi
