#include "model/compliance.hpp"

#include <memory>
#include <utility>

namespace contactvi {

namespace {

// Of the numbers of contacts, of which a law holds for first >= 0 alone. Below, in steps that end where it comes to
// zero, the point reflection of the law there goes on smoothly: twice its value at zero less that of the other side.
class Reflected {
 public:
  void add(double first, double second) {
    places_.push_back({values_.size(), first < 0.0});
    put(std::abs(first), second);
    if (first < 0.0) put(0.0, second);
  }
  void ask(const ContactFunction& function, bool derivatives) {
    if (!values_.empty()) function(numbers_.data(), static_cast<int>(values_.size()), derivatives, values_.data());
  }
  ContactValue operator[](std::size_t k) const {
    const ContactValue& there = values_[places_[k].first];
    if (!places_[k].second) return there;
    const ContactValue& zero = values_[places_[k].first + 1];
    return {2.0 * zero.value - there.value, there.by_first, 2.0 * zero.by_second - there.by_second};
  }

 private:
  void put(double first, double second) {
    numbers_.insert(numbers_.end(), {first, second});
    values_.push_back({});
  }

  std::vector<double> numbers_;
  std::vector<std::pair<std::size_t, bool>> places_;
  std::vector<ContactValue> values_;
};

// Calls `each` for every function that contacts have in a place of their laws, with the contacts that have it.
template <class Each>
void for_each_function(std::vector<AskedPress>& contacts,
                       std::shared_ptr<const ContactFunction> ComplianceLaw::* function, Each each) {
  std::vector<char> done(contacts.size(), 0);
  std::vector<AskedPress*> group;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const ContactFunction* own = (contacts[i].law->*function).get();
    if (own == nullptr || done[i] != 0) continue;
    group.clear();
    for (std::size_t j = i; j < contacts.size(); ++j) {
      if ((contacts[j].law->*function).get() != own) continue;
      done[j] = 1;
      group.push_back(&contacts[j]);
    }
    each(*own, group);
  }
}

}  // namespace

AskedPress asked_press(const ComplianceLaw& law, const Touch<double>& touch, const Vec3& velocity) {
  const double along = touch.normal.dot(velocity);
  return {&law, -touch.gap, along, (velocity - along * touch.normal).norm()};
}

// The rate of the depth is that of the gap turned round.
void ask(std::vector<AskedPress>& contacts, bool derivatives) {
  for_each_function(contacts, &ComplianceLaw::force, [&](const ContactFunction& force, const auto& group) {
    Reflected asked;
    for (const AskedPress* c : group) {
      asked.add(c->depth, -c->along);
      asked.add(c->depth, 0.0);
    }
    asked.ask(force, derivatives);
    for (std::size_t k = 0; k < group.size(); ++k) {
      GivenPress& given = group[k]->given;
      given.force = asked[2 * k];
      given.at_rest = asked[2 * k + 1].value;
      given.elastic = group[k]->law->energy ? given.at_rest : 0.0;
    }
  });
  // The normal force may be below zero as the depth may.
  for_each_function(contacts, &ComplianceLaw::bound, [&](const ContactFunction& bound, const auto& group) {
    Reflected asked;
    for (const AskedPress* c : group) {
      const ComplianceLaw& law = *c->law;
      const double built_in = law.stiffness * signed_power(c->depth, law.exponent) * (1.0 - law.damping * c->along);
      asked.add(law.force ? c->given.force.value : built_in, c->slip);
    }
    asked.ask(bound, derivatives);
    for (std::size_t k = 0; k < group.size(); ++k) group[k]->given.bound = asked[k];
  });
}

double signed_power(double d, double n) {
  if (n == 1.0) return d;
  return std::copysign(std::pow(std::abs(d), n), d);
}

DualNumber signed_power(const DualNumber& d, double n) {
  return {signed_power(d.x, n), n == 1.0 ? d.d : n * std::pow(std::abs(d.x), n - 1.0) * d.d};
}

double compliance_energy(const ComplianceLaw& law, double gap) {
  if (law.force) return law.energy && gap < 0.0 ? (*law.energy)(-gap, 0.0).value : 0.0;
  return gap < 0.0 ? law.stiffness / (law.exponent + 1.0) * std::pow(-gap, law.exponent + 1.0) : 0.0;
}

double touch_size(const CompliantContact& contact, const Touch<double>& touch) {
  const double other = contact.shapes->b.bound;
  return touch.point.norm() + std::abs(touch.gap) + contact.shapes->a.bound + (std::isfinite(other) ? other : 0.0);
}

double compliance_elastic(const ComplianceLaw& law, double gap) {
  if (!(gap < 0.0)) return 0.0;
  if (law.force) return law.energy ? (*law.force)(-gap, 0.0).value : 0.0;
  return law.stiffness * std::pow(-gap, law.exponent);
}

double compliance_scale(const ComplianceLaw& law, double gap) {
  if (!law.force) return compliance_energy(law, gap);
  return gap < 0.0 ? std::abs((*law.force)(-gap, 0.0).value * gap) : 0.0;
}

double pull_share(const ComplianceLaw& law, double along, const GivenPress& given) {
  if (!law.force) return 1.0 - law.damping * along;
  const double force = given.force.value, both = std::abs(force) + std::abs(given.at_rest);
  return both > 0.0 ? force / both : 1.0;
}

double compliance_slope(const ComplianceLaw& law, double gap, const GivenPress& given) {
  const double n = law.exponent;
  if (law.force) return gap != 0.0 ? n * std::abs(given.at_rest / gap) : 0.0;
  return law.stiffness * (n == 1.0 ? 1.0 : n * std::pow(std::abs(gap), n - 1.0));
}

TouchPose<double> touch_pose(const Placements& at, int body) {
  if (body < 0) return {};
  return {at.R_W[body], at.p_W[body]};
}

Touch<double> touch_of(const CompliantContact& contact, const Placements& at) {
  const TouchPose<double> A = touch_pose(at, contact.body_a), B = touch_pose(at, contact.body_b);
  const NearestFeatures nearest = nearest_touch(*contact.shapes, A, B);
  return touch(nearest.a, nearest.b, A, B);
}

}  // namespace contactvi
