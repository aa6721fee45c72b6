#include "sensitivity/known_laws.hpp"

#include "base/no_derivative.hpp"

namespace contactvi {

void require_known_law(const Scene& scene, int guard, double time) {
  if (!scene.is_pair(guard)) return;
  const ContactLaw* law = scene.law(guard);
  const bool moves = scene.pairs[guard].moves && scene.friction(guard) > 0.0;
  const bool other = law != nullptr && (scene.friction_varies(guard) || law->axis_of >= 0 || law->pull.given());
  if (!moves && !other) return;
  throw NoDerivative({"law", guard, time}, "Derivatives through this law of contact are not known",
                     "Coulomb's friction with one number, on surfaces that do not move along themselves",
                     moves ? "a surface that moves along itself" : "another law of friction, or adhesion",
                     "Differentiate a run without it, or by differences of runs");
}

}  // namespace contactvi
