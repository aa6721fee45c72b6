// Which laws of contact have derivatives.
#pragma once

#include "contact/persistent_contact.hpp"

namespace contactvi {

// Of steps from files of older versions: throws NoDerivative where a guard has another law of friction than Coulomb's
// with one number, a surface that moves along itself, or adhesion; time: of the contact [s].
void require_plain_law(const Scene& scene, int guard, double time);
// Of dense steps: throws NoDerivative where the friction of a guard depends on the normal force and the time.
void refuse_friction_by_state(const Scene& scene, int guard, double time);
// Whether the friction of a contact, as it sticks or slides, is the number of its pair.
bool takes_friction(const Scene& scene, int guard, bool sticks);
inline bool takes_friction(const Scene& scene, const PersistentContact& contact) {
  return contact.mu > 0.0 && takes_friction(scene, contact.point.guard, contact.sticks);
}

}  // namespace contactvi
