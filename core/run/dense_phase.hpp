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

// What steps with persistent contacts, and impacts at instants with several closed contacts, have cost lately [us of
// step_costs.hpp]. It fades.
struct LocatedCost {
  static constexpr double kMemory = 5e-3;  // [s] after which half of it is forgotten
  double spent = 0.0;

  // An interval of this length [s] begins.
  void fade(double length) { spent /= 1.0 + length / kMemory; }
  // What it comes to in the end if it is `rate` in every interval of this length.
  static double lasting(double rate, double length) { return rate * (1.0 + kMemory / length); }
  // Of bodies that meet.
  void join(const LocatedCost& other) { spent = std::max(spent, other.spent); }
};

struct DensePhase {
  static constexpr int kQuietSteps = 8, kMostQuietSteps = 1024;
  static constexpr int kSoon = 8;  // times the quiet steps wanted: events that accumulate again so soon

  bool active = false;
  int quiet = 0;          // dense steps one after the other in which no contact began, ended or closed fast
  int wanted = 0;         // quiet steps after which events are located again; 0: there were no dense steps yet
  long since_return = 0;  // steps since then
  double longest = 0;     // the next step to try [s]: twice the last one; 0: to the end of the interval
  LocatedCost located;

  // Dense steps from here on; after twice as many quiet steps as the last time where that was not long ago.
  void begin();
};

}  // namespace contactvi
