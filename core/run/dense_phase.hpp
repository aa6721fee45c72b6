// When a run takes dense steps instead of locating events: the counts by which it decides, as a value.
#pragma once

namespace contactvi {

// Which steps a run takes where bodies touch. The numbers are those of the option of the Python API.
enum class ContactSteps : int {
  kAuto = 0,    // located events, and dense steps where those accumulate or would end the run
  kEvents = 1,  // located events alone
  kDense = 2,   // dense steps alone
};

struct DensePhase {
  bool active = false;
  int quiet = 0;        // dense steps one after the other in which no contact began, ended or closed fast
  int wanted = 8;       // quiet steps after which events are located again
  long since_return = 0;  // steps since then
};

// What has accumulated in the interval under way.
struct EventCount {
  long coupled_impacts = 0;  // at instants with several closed contacts
  int changes = 0;           // begins and releases of persistent contacts
  int contact_halvings = 0;  // of steps with persistent contacts that were not solved
  int contact_parts = 0;     // partial steps with persistent contacts
};

}  // namespace contactvi
