// How long the next step may be: halving after a step that was not solved, growing after several that were.
//
// Once for free steps and for contact steps. A value: part of the state of a run. All lengths are the nominal one by
// powers of two, so that they do not move with the times of events: derivatives of runs take them for fixed.
#pragma once

namespace contactvi {

// The longest step of one kind to try, shorter than the nominal one after a step that was not solved.
struct StepLength {
  double nominal = 0, longest = 0;  // [s]
  int solved_in_row = 0;            // steps of that length solved one after the other

  void start(double length) { *this = {length, length, 0}; }
  // After a step of length h was not solved: half of it, where h is one of the lengths.
  void halve(double h);
  // After a step of the longest length was solved.
  void grow();
  // No longer than h.
  void limit(double h);
  // At least h.
  void allow(double h);
};

// The largest nominal length by a power of two that is at most h [s].
double step_length_within(double h, double nominal);

struct StepControl {
  // Part of a nominal step to which steps are halved. Events that come sooner after each other count as ones at the
  // same instant where they make no impact: rounding of places may let them follow each other for ever.
  static constexpr double kShortest = 1e-6;

  StepLength free, contact;
  double flight = 0;  // longest free step after a short flight [s]; 0: any
  // Events and changes of contact one after the other, at one instant, that make no impact.
  int without_progress = 0;
  long halved = 0;  // steps since the reset

  void start(double dt, double contact_dt);
  double longest_free() const { return flight > 0.0 && flight < free.longest ? flight : free.longest; }
  void halve_free(double h) {
    free.halve(h);
    ++halved;
  }
  void halve_contact(double h) {
    contact.halve(h);
    ++halved;
  }
  // A free step without an event was taken, or one to an event after which a flight of this length [s] is expected (0:
  // of any length); dt: nominal step.
  void flew(double dt);
  void expect_flight(double length, double dt);

  // Steps past an event that is one of rounding: much shorter ones.
  void step_past_rounding(double dt, double contact_dt);
  // Counts an event or a change of contact without progress; false: there have been too many of them.
  bool count_standstill() { return ++without_progress <= kMostWithoutProgress; }
  // Whether there have been so many that rounding of the positions is assumed.
  bool stands_still() const { return without_progress >= kStandstill; }
  void progress() { without_progress = 0; }

 private:
  static constexpr int kStandstill = 3;
  static constexpr int kMostWithoutProgress = 200;
};

}  // namespace contactvi
