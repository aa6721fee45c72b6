#include "sensitivity/known_laws.hpp"

#include "base/no_derivative.hpp"

namespace contactvi {

void require_plain_law(const Scene& scene, int guard, double time) {
  const ContactLaw* law = scene.law(guard);
  const bool moves = scene.is_pair(guard) && scene.pairs[guard].moves && scene.friction(guard) > 0.0;
  const bool other = law != nullptr &&
                     (scene.friction_varies(guard) || law->axis_of >= 0 || law->adheres() || law->turning_rows() > 0);
  if (!moves && !other) return;
  throw NoDerivative({"law", guard, time}, "The file of the run lacks what derivatives through this contact need",
                     "in files of older versions Coulomb's friction with one number, on surfaces that do not move "
                     "along themselves, without adhesion",
                     moves ? "a surface that moves along itself" : "another law of friction, or adhesion",
                     "Make the run again");
}

void refuse_friction_by_state(const Scene& scene, int guard, double time) {
  if (!scene.friction_by_state(guard)) return;
  throw NoDerivative({"law", guard, time},
                     "A dense step has friction that depends on the normal force, without a derivative there",
                     "a coefficient that is a number, or depends on the speed of the slip", "friction_of_state=",
                     "Use contact_mode='events', or give friction= a number, a table or a function of the speed");
}

bool takes_friction(const Scene& scene, int guard, bool sticks) {
  const ContactLaw* law = scene.law(guard);
  return law == nullptr || !(law->mu.given() || law->mu_of_state != nullptr || (sticks && law->static_mu >= 0.0));
}

}  // namespace contactvi
