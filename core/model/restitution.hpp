// Coefficients of restitution that depend on the state of a contact.
#pragma once

#include "model/contact_law.hpp"

namespace contactvi {

inline bool restitution_varies(const ContactLaw& law) { return law.e.given() || law.e_of_state.given(); }

// Of a contact that closes with this speed, >= 0, and slips with another one before, at the time t [s].
inline double restitution_at(const ContactLaw& law, double closing, double slip, double t) {
  return law.e.given() ? law.e(closing) : law.e_of_state(closing, slip, t);
}

}  // namespace contactvi
