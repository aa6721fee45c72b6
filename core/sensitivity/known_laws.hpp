// Which laws of contact have derivatives.
#pragma once

#include "contact/persistent_contact.hpp"

namespace contactvi {

// Throws NoDerivative where a guard has friction against spinning or rolling; time: of the contact [s].
void require_known_law(const Scene& scene, int guard, double time);
// Of dense steps, and of steps from files: also where its friction depends on the speed or the direction of its slip,
// or on a surface that moves along itself, or is larger at rest, or where it adheres.
void require_plain_law(const Scene& scene, int guard, double time);
// Whether the friction of a contact, as it sticks or slides, is the number of its pair.
bool takes_friction(const Scene& scene, const PersistentContact& contact);

}  // namespace contactvi
