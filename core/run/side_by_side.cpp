#include "run/side_by_side.hpp"

#include <algorithm>
#include <boost/context/protected_fixedsize_stack.hpp>
#include <new>
#include <utility>

namespace contactvi {

namespace {

// [bytes] of a stack, as the first thread of a process has it; only what is used of it takes memory.
constexpr std::size_t kStackSize = std::size_t{8} << 20;

// The lanes among these that fit, which are made where there are none.
template <class Lanes, class Model>
Lanes& fitting(std::vector<std::unique_ptr<Lanes>>& all, const Model& model) {
  for (const auto& lanes : all)
    if (lanes->fits(model)) return *lanes;
  all.push_back(std::make_unique<Lanes>(model));
  return *all.back();
}

}  // namespace

bool SideBySide::run(int stacks, const std::function<void()>& work) {
  make_stacks(stacks, work);
  if (stacks_.empty()) return false;
  for (bool any = true; any;) {
    for (Stack& stack : stacks_) {
      if (stack.waits() || !stack.work) continue;
      now_ = &stack;
      stack.work = std::move(stack.work).resume();
    }
    any = std::any_of(stacks_.begin(), stacks_.end(), [](const Stack& stack) { return stack.waits(); });
    if (any) serve_most();
  }
  stacks_.clear();
  return true;
}

// So many stacks, or as many as the process may have.
void SideBySide::make_stacks(int count, const std::function<void()>& work) {
  using boost::context::fiber;
  stacks_.resize(count);
  for (std::size_t k = 0; k < stacks_.size(); ++k) {
    Stack& stack = stacks_[k];
    try {
      stack.work = fiber(std::allocator_arg, boost::context::protected_fixedsize_stack(kStackSize),
                         [&stack, &work](fiber&& back) {
                           stack.back = std::move(back);
                           work();
                           return std::move(stack.back);
                         });
    } catch (const std::bad_alloc&) {
      stacks_.resize(k);
    }
  }
}

long SideBySide::shared_iterations() const {
  long sum = 0;
  for (const auto& lanes : lanes_) sum += lanes->made();
  return sum;
}

LaneIterations& SideBySide::lanes_of(const Integrator& step) { return fitting(lanes_, step); }

StageLanes& SideBySide::node_lanes_of(const FlatModel& model) { return fitting(node_lanes_, model); }

// To the other runs, until what this one waits for has been done.
void SideBySide::wait(const void* lanes) {
  Stack& stack = *now_;
  stack.lanes = lanes;
  stack.back = std::move(stack.back).resume();
}

void SideBySide::iterate(Integrator& step, LaneIterations& lanes) {
  now_->step = &step;
  wait(&lanes);
}

bool SideBySide::solve_masses(Stages& node, StageLanes& lanes) {
  Stack& stack = *now_;
  stack.node = &node;
  wait(&lanes);
  return stack.done;
}

// All runs that are not at their end wait: what most of them wait for is done.
void SideBySide::serve_most() {
  const Stack* most = nullptr;
  std::ptrdiff_t count = 0;
  for (const Stack& stack : stacks_) {
    if (!stack.waits()) continue;
    const auto same = [&](const Stack& other) { return other.waits() && other.lanes == stack.lanes; };
    const std::ptrdiff_t waiting = std::count_if(stacks_.begin(), stacks_.end(), same);
    if (waiting > count) most = &stack;
    count = std::max(count, waiting);
  }
  const void* lanes = most->lanes;
  steps_.clear();
  nodes_.clear();
  for (Stack& stack : stacks_) {
    if (!stack.waits() || stack.lanes != lanes) continue;
    if (stack.step != nullptr) steps_.push_back(stack.step);
    if (stack.node != nullptr) nodes_.push_back(stack.node);
    stack.step = nullptr;
    stack.node = nullptr;
    stack.done = count > 1;
  }
  for (const auto& each : lanes_)
    if (each.get() == lanes) each->iterate(steps_);
  for (const auto& each : node_lanes_)
    if (each.get() == lanes && count > 1) each->solve_masses(nodes_);
}

}  // namespace contactvi
