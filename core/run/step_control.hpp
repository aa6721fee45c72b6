// How long the next step may be: halving after a step that was not solved, growing after several that were.
//
// Once for free steps and for contact steps. A value: part of the state of a run.
#pragma once

namespace contactvi {

// The longest step of one kind to try, shorter than the nominal one after a step that was not solved.
struct StepLength {
  double longest = 0;     // [s]
  int solved_in_row = 0;  // steps of that length solved one after the other

  void start(double nominal) { *this = {nominal, 0}; }
  void halve(double h) { *this = {0.5 * h, 0}; }
  // After a step of the longest length was solved.
  void grow();
  void limit(double h) {
    if (h < longest) longest = h;
  }
};

struct StepControl {
  // Part of a nominal step to which steps are halved.
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
