#include "run/side_by_side.hpp"

#include <algorithm>
#include <boost/context/protected_fixedsize_stack.hpp>

namespace contactvi {

namespace {
// [bytes] of a stack, as the first thread of a process has it; only what is used of it takes memory.
constexpr std::size_t kStackSize = std::size_t{8} << 20;
}  // namespace

void SideBySide::run(int stacks, const std::function<void()>& work) {
  using boost::context::fiber;
  stacks_.resize(stacks);
  for (Stack& stack : stacks_)
    stack.work =
        fiber(std::allocator_arg, boost::context::protected_fixedsize_stack(kStackSize), [&stack, &work](fiber&& back) {
          stack.back = std::move(back);
          work();
          return std::move(stack.back);
        });
  for (bool any = true; any;) {
    any = false;
    for (Stack& stack : stacks_) {
      if (stack.step != nullptr || !stack.work) continue;
      now_ = &stack;
      stack.work = std::move(stack.work).resume();
    }
    for (const Stack& stack : stacks_) any |= stack.step != nullptr;
    if (any) iterate_most();
  }
  stacks_.clear();
}

long SideBySide::shared_iterations() const {
  long sum = 0;
  for (const auto& lanes : lanes_) sum += lanes->made();
  return sum;
}

LaneIterations& SideBySide::lanes_of(const Integrator& step) {
  for (const auto& lanes : lanes_)
    if (lanes->fits(step)) return *lanes;
  lanes_.push_back(std::make_unique<LaneIterations>(step));
  return *lanes_.back();
}

void SideBySide::iterate(Integrator& step, LaneIterations& lanes) {
  Stack& stack = *now_;
  stack.step = &step;
  stack.lanes = &lanes;
  stack.back = std::move(stack.back).resume();
}

// All runs that are not at their end wait: the iterations that most of them wait for are made.
void SideBySide::iterate_most() {
  LaneIterations* most = nullptr;
  std::ptrdiff_t count = 0;
  for (const Stack& stack : stacks_) {
    if (stack.step == nullptr) continue;
    const std::ptrdiff_t waiting = std::count_if(stacks_.begin(), stacks_.end(), [&](const Stack& other) {
      return other.step != nullptr && other.lanes == stack.lanes;
    });
    if (waiting > count) {
      most = stack.lanes;
      count = waiting;
    }
  }
  steps_.clear();
  for (Stack& stack : stacks_)
    if (stack.step != nullptr && stack.lanes == most) steps_.push_back(std::exchange(stack.step, nullptr));
  most->iterate(steps_);
}

}  // namespace contactvi
