// Accumulating impacts: which impacts at an event count as plastic, because infinitely many would follow them in a
// finite time, and where a run without persistent contact ends for that reason.
#pragma once

#include <utility>
#include <vector>

#include "impact/sequence.hpp"

namespace contactvi {

// The flights of one guard between its impacts [s], from which an accumulation of impacts is recognised.
struct Bouncing {
  double last_time = 0, last_flight = 0, longest_flight = 0;
  double last_speed = 0;  // with which the last impact closed [m/s]
  int impacts = 0, shrinking_flights = 0, short_flights = 0;
};
// Of the guards that have had impacts, sorted by guard.
class Flights {
 public:
  using Entry = std::pair<int, Bouncing>;
  const Bouncing* find(int guard) const;  // null: no impact so far
  Bouncing& at(int guard);                // a new one where there is none
  const std::vector<Entry>& entries() const { return entries_; }
  void clear() { entries_.clear(); }

 private:
  std::vector<Entry> entries_;
};

class ZenoDetector {
 public:
  // persistent: whether a contact whose impacts accumulate may persist; else the run ends there.
  ZenoDetector(const Scene& scene, bool dissipative, bool persistent);

  // Finds the guards among the closed ones of `sequence` whose impacts accumulate: their impacts at this event are
  // plastic. p: before them; step: the shortest nominal length of steps [s].
  void find_accumulating_impacts(const Flights& flights, ImpactSequence& sequence, const VecX& p, double time,
                                 double step);
  // Per guard: whether its impacts at this event are plastic.
  const std::vector<char>& plastic() const { return plastic_; }
  // Counts the flights of the guards that had an impact. adaptive_dt: the present length of free steps [s]. False:
  // impacts accumulate at a guard, and no contact may persist; accumulating() and ends() tell which and when.
  bool update_bouncing(Flights& flights, ImpactSequence& sequence, double time, double step, double adaptive_dt,
                       Recording& recording);
  int accumulating() const { return accumulating_; }
  double ends() const { return ends_; }
  // The guards that had an impact at the last event, and the shortest of their last flights [s]; 0: there was none.
  const std::vector<int>& impacted() const { return impacted_; }
  double shortest_flight(const Flights& flights) const;

 private:
  double short_flight_limit(double e) const;

  bool dissipative_;  // whether some force dissipates energy
  bool persistent_;
  std::vector<char> plastic_;
  std::vector<int> plastic_guards_, impacted_;
  std::vector<double> closing_;  // speeds of the closed guards of the sequence at this event [m/s]
  int accumulating_ = -1;
  double ends_ = 0;
};

}  // namespace contactvi
