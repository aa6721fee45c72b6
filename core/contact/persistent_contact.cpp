#include "contact/persistent_contact.hpp"

#include <algorithm>

namespace contactvi {

double adhesion(const Scene& scene, const PersistentContact& contact, double t) {
  const ContactLaw* law = scene.law(contact.point.guard);
  return law != nullptr && law->pull.given() ? contact.pull_share * std::max(0.0, law->pull(t)) : 0.0;
}

bool any_adhesion(const Scene& scene, const std::vector<PersistentContact>& contacts) {
  return !scene.laws.empty() && std::any_of(contacts.begin(), contacts.end(), [&scene](const PersistentContact& c) {
    const ContactLaw* law = scene.law(c.point.guard);
    return law != nullptr && law->pull.given();
  });
}

}  // namespace contactvi
