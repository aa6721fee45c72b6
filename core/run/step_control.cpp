#include "run/step_control.hpp"

#include <cmath>

namespace contactvi {

namespace {
constexpr int kEasySteps = 4;              // short steps solved one after the other before a longer one is tried
constexpr double kFlights = 20.0;          // a free step after a short flight covers so many flights,
constexpr double kGrowth = 8.0;            // and grows by this factor while there is no event
constexpr double kLessThanFailed = 0.75;   // of a step that was not solved: upper limit of the next one
constexpr double kPastRounding = 0x1p-13;  // of a nominal step: length of the step past an event by rounding
}  // namespace

double step_length_within(double h, double nominal) {
  int exponent = 0;
  std::frexp(h / nominal, &exponent);  // h / nominal is from 1/2 to 1 of this power of two
  return std::ldexp(nominal, exponent - 1);
}

void StepLength::halve(double h) {
  longest = step_length_within(kLessThanFailed * h, nominal);
  solved_in_row = 0;
}

void StepLength::limit(double h) {
  if (h < longest) longest = step_length_within(h, nominal);
}

void StepLength::allow(double h) {
  while (longest < h) longest *= 2.0;
}

void StepLength::grow() {
  if (++solved_in_row < kEasySteps) return;
  longest *= 2.0;
  solved_in_row = 0;
}

void StepControl::start(double dt, double contact_dt) {
  *this = StepControl();
  free.start(dt);
  contact.start(contact_dt);
}

void StepControl::flew(double dt) {
  flight = kGrowth * flight < dt ? kGrowth * flight : 0.0;
  progress();
}

// The polynomial of a whole step would be too coarse to show the next flight, if that is as short as the last one.
void StepControl::expect_flight(double length, double dt) {
  flight = length > 0.0 && kFlights * kFlights * length < dt ? step_length_within(kFlights * length, dt) : 0.0;
}

void StepControl::step_past_rounding(double dt, double contact_dt) {
  contact.limit(kPastRounding * contact_dt);
  free.limit(kPastRounding * dt);
}

}  // namespace contactvi
