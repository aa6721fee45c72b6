#include "sensitivity/known_laws.hpp"

#include "base/no_derivative.hpp"

namespace contactvi {

namespace {
[[noreturn]] void refuse(int guard, double time, const char* expected, const char* got) {
  throw NoDerivative({"law", guard, time}, "Derivatives through this law of contact are not known", expected, got,
                     "Differentiate a run without it, or by differences of runs");
}
}  // namespace

void require_known_law(const Scene& scene, int guard, double time) {
  const ContactLaw* law = scene.law(guard);
  if (law != nullptr && law->turning_rows() > 0)
    refuse(guard, time, "friction against the slip alone", "friction against spinning or rolling");
}

void require_plain_law(const Scene& scene, int guard, double time) {
  require_known_law(scene, guard, time);
  const ContactLaw* law = scene.law(guard);
  const char* expected =
      "in dense steps and in runs from files Coulomb's friction with one number, on surfaces that do not move along "
      "themselves, without adhesion";
  if (scene.is_pair(guard) && scene.pairs[guard].moves && scene.friction(guard) > 0.0)
    refuse(guard, time, expected, "a surface that moves along itself");
  if (law != nullptr && (scene.friction_varies(guard) || law->axis_of >= 0 || law->pull.given()))
    refuse(guard, time, expected, "another law of friction, or adhesion");
}

bool takes_friction(const Scene& scene, const PersistentContact& contact) {
  const ContactLaw* law = scene.law(contact.point.guard);
  return contact.mu > 0.0 && (law == nullptr || !(law->mu.given() || (contact.sticks && law->static_mu >= 0.0)));
}

}  // namespace contactvi
