#include "contact/persistent_contact.hpp"

#include <algorithm>

namespace contactvi {

namespace {
// The sum over what pulls, by a function of each NumberFunction.
template <class Of>
double sum_of_pulls(const Scene& scene, const PersistentContact& contact, const Of& of) {
  const ContactLaw* law = scene.law(contact.point.guard);
  if (law == nullptr) return 0.0;
  double sum = law->pull.given() ? contact.pull_share * of(law->pull) : 0.0;
  for (int k = 0; k < 2; ++k)
    if (law->body_pulls[k] >= 0)
      sum += contact.body_shares[k] * of(scene.body_pulls[static_cast<std::size_t>(law->body_pulls[k])]);
  return sum;
}
}  // namespace

double adhesion(const Scene& scene, const PersistentContact& contact, double t) {
  return sum_of_pulls(scene, contact, [t](const NumberFunction& pull) { return std::max(0.0, pull(t)); });
}

double adhesion_rate(const Scene& scene, const PersistentContact& contact, double t) {
  return sum_of_pulls(scene, contact, [t](const NumberFunction& pull) { return pull.slope(t); });
}

bool any_adhesion(const Scene& scene, const std::vector<PersistentContact>& contacts) {
  return !scene.laws.empty() && std::any_of(contacts.begin(), contacts.end(), [&scene](const PersistentContact& c) {
    const ContactLaw* law = scene.law(c.point.guard);
    return law != nullptr && law->adheres();
  });
}

}  // namespace contactvi
