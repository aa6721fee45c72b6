// When a run takes dense steps instead of locating events: the counts by which it decides, as a value.
#pragma once

namespace contactvi {

// Which steps a run takes where bodies touch. The numbers are those of the option of the Python API.
enum class ContactSteps : int {
  kAuto = 0,    // located events, and dense steps where those accumulate or would end the run
  kEvents = 1,  // located events alone
  kDense = 2,   // dense steps alone
};

// What has accumulated. The counts fade, so that a burst and a rate that lasts are bounded by the same limits.
struct EventCount {
  double coupled_impacts = 0;  // at instants with several closed contacts
  double changes = 0;          // begins and releases of persistent contacts
  double contact_parts = 0;    // steps with persistent contacts beyond those asked for
  int contact_halvings = 0;    // of steps with persistent contacts that were not solved, in the interval under way

  bool none() const { return coupled_impacts + changes + contact_parts + contact_halvings == 0.0; }
  // An interval of this length [s] begins.
  void fade(double length);
  // Of bodies that meet.
  void join(const EventCount& other);
};

struct DensePhase {
  static constexpr int kQuietSteps = 8, kMostQuietSteps = 1024;
  static constexpr int kSoon = 8;  // times the quiet steps wanted: events that accumulate again so soon

  bool active = false;
  int quiet = 0;          // dense steps one after the other in which no contact began, ended or closed fast
  int wanted = 0;         // quiet steps after which events are located again; 0: there were no dense steps yet
  long since_return = 0;  // steps since then
  double longest = 0;     // the next step to try [s]: twice the last one; 0: to the end of the interval
  EventCount events;

  // Dense steps from here on; after twice as many quiet steps as the last time where that was not long ago.
  void begin();
};

}  // namespace contactvi
