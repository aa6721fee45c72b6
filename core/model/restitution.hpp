// Coefficients of restitution that depend on the state of a contact.
#pragma once

#include <cmath>

#include "model/contact_function.hpp"
#include "model/contact_law.hpp"

namespace contactvi {

inline bool restitution_varies(const ContactLaw& law) { return law.e.given() || law.e_of_state != nullptr; }

// Of a contact that closes with this speed, >= 0, and slips with another one before, at the time t [s]. NaN: a law by
// the state gave a number beyond [0, 1], which would make energy.
inline double restitution_at(const ContactLaw& law, double closing, double slip, double t) {
  if (law.e.given()) return law.e(closing);
  const double e = (*law.e_of_state)(closing, slip, t, false).value;
  return e >= 0.0 && e <= 1.0 ? e : std::nan("");
}

// Its derivatives by the three numbers.
inline Vec3 restitution_slopes(const ContactLaw& law, double closing, double slip, double t) {
  if (law.e.given()) return {law.e.slope(closing), 0.0, 0.0};
  const ContactValue found = (*law.e_of_state)(closing, slip, t, true);
  return {found.by_first, found.by_second, found.by_third};
}

}  // namespace contactvi
