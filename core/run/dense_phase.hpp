// When a run takes dense steps instead of locating events: the counts by which it decides, as a value.
#pragma once

#include <algorithm>

namespace contactvi {

// Which steps a run takes where bodies touch. The numbers are those of the option of the Python API.
enum class ContactSteps : int {
  kAuto = 0,    // located events, and dense steps where those accumulate or would end the run
  kEvents = 1,  // located events alone
  kDense = 2,   // dense steps alone
};

// What locating events has cost beyond what it may cost [us of step_costs.hpp].
struct LocatedCost {
  double excess = 0.0;

  // Of an interval, and what it may cost.
  void add(double cost, double allowed) { excess = std::max(0.0, excess + cost - allowed); }
  // Of bodies that meet.
  void join(const LocatedCost& other) { excess = std::max(excess, other.excess); }
};

struct DensePhase {
  static constexpr int kQuietSteps = 8, kMostQuietSteps = 1024;
  static constexpr int kSoon = 8;  // times the quiet steps wanted: events that accumulate again so soon

  bool active = false;
  int quiet = 0;          // dense steps one after the other in which no contact began, ended or closed fast
  int wanted = 0;         // quiet steps after which events are located again; 0: there were no dense steps yet
  long since_return = 0;  // steps since then
  double longest = 0;     // the next step to try [s], a power of two of the nominal one; 0: to the end of the interval
  LocatedCost located;

  // Dense steps from here on; after twice as many quiet steps as the last time where that was not long ago.
  void begin();
};

}  // namespace contactvi
