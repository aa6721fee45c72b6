// Runs side by side in one thread: each has a stack of its own, and waits where its step is to be iterated, or a mass
// matrix to be solved with, until the others do the same. That is then done together, in the lanes of the kernel.
//
// A run knows nothing of the others: whether and when it meets which of them changes none of its digits. One that has
// an event, or steps in contact, goes on alone until it flies again.
#pragma once

#include <boost/context/fiber.hpp>
#include <functional>
#include <memory>
#include <vector>

#include "step/lane_iterations.hpp"
#include "step/node_lanes.hpp"

namespace contactvi {

class SideBySide final : public LaneCompany, public NodeCompany {
 public:
  // How many runs gain something from each other; 1: none.
  static int most_runs(int stages) { return stages == 1 ? StageLanes::most_runs() : 1; }

  // Calls work() on so many stacks, or on fewer where the process may have no more memory, and returns when all calls
  // have. False, and no call, where there is not even one. work() may throw nothing.
  bool run(int stacks, const std::function<void()>& work);
  int stacks() const { return static_cast<int>(stacks_.size()); }
  // Stage iterations that were made together with others.
  long shared_iterations() const;

  LaneIterations& lanes_of(const Integrator& step) override;
  void iterate(Integrator& step, LaneIterations& lanes) override;
  StageLanes& node_lanes_of(const FlatModel& model) override;
  bool solve_masses(Stages& node, StageLanes& lanes) override;

 private:
  struct Stack {
    boost::context::fiber work;  // where it waits
    boost::context::fiber back;  // where the others are, while it does not
    // What it waits for: iterations of a step, or a node; null: for nothing.
    Integrator* step = nullptr;
    Stages* node = nullptr;
    const void* lanes = nullptr;  // with which that is done
    bool done = false;            // of a node
    bool waits() const { return step != nullptr || node != nullptr; }
  };
  void make_stacks(int count, const std::function<void()>& work);
  void wait(const void* lanes);
  void serve_most();

  std::vector<std::unique_ptr<LaneIterations>> lanes_;  // of each kind of tree
  std::vector<std::unique_ptr<StageLanes>> node_lanes_;
  std::vector<Stack> stacks_;
  Stack* now_ = nullptr;  // the one that is not waiting
  std::vector<Integrator*> steps_;
  std::vector<Stages*> nodes_;
};

}  // namespace contactvi
