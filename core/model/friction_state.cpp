#include "model/friction_state.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "model/contact_function.hpp"

namespace contactvi {

namespace {

constexpr double kLeast = 1e-9;  // a coefficient that no measurement tells from none

double coefficient(double given) { return given >= 0.0 ? std::max(kLeast, given) : std::nan(""); }

}  // namespace

void set_friction(const Scene& scene, std::vector<FrictionState>& states, bool derivatives) {
  std::vector<char> done(states.size(), 0);
  std::vector<std::size_t> group;
  std::vector<double> numbers;
  std::vector<ContactValue> values;
  for (std::size_t i = 0; i < states.size(); ++i) {
    if (done[i] != 0) continue;
    FrictionState& state = states[i];
    const ContactLaw* law = scene.law(state.guard);
    const ContactFunction* own = law == nullptr ? nullptr : law->mu_of_state.get();
    if (own == nullptr) {
      state.mu = state.sticks ? scene.static_friction(state.guard) : scene.sliding_friction(state.guard, state.slip);
      if (derivatives && !state.sticks && law != nullptr && law->mu.given()) state.by_slip = law->mu.slope(state.slip);
      continue;
    }
    group.clear();
    numbers.clear();
    for (std::size_t j = i; j < states.size(); ++j) {
      const ContactLaw* other = scene.law(states[j].guard);
      if (other == nullptr || other->mu_of_state.get() != own) continue;
      done[j] = 1;
      if (!(states[j].normal > 0.0) || std::isnan(states[j].slip)) continue;
      group.push_back(j);
      numbers.insert(numbers.end(), {states[j].sticks ? 0.0 : states[j].slip, states[j].normal, states[j].time});
    }
    if (group.empty()) continue;
    values.assign(group.size(), ContactValue());
    (*own)(numbers.data(), static_cast<int>(group.size()), derivatives, values.data());
    for (std::size_t k = 0; k < group.size(); ++k) {
      FrictionState& found = states[group[k]];
      found.mu = coefficient(values[k].value);
      if (!derivatives) continue;
      found.by_slip = found.sticks ? 0.0 : values[k].by_first;
      found.by_normal = values[k].by_second;
      found.by_time = values[k].by_third;
    }
  }
}

double FrictionRounds::larger(double change, double next, double& mu) {
  const double own = std::abs(next - mu) / mu;
  mu = next;
  return std::isfinite(own) ? std::max(change, own) : std::numeric_limits<double>::infinity();
}

// Its force is beyond all bounds.
FrictionState impact_friction(const ContactLaw& law, double slip, double time, bool derivatives) {
  const double force = std::numeric_limits<double>::infinity();
  const ContactValue found = (*law.mu_of_state)(slip, force, time, derivatives);
  return {-1, false, slip, force, time, coefficient(found.value), found.by_first, 0.0, found.by_third};
}

double friction_of(const Scene& scene, const FrictionState& state) {
  std::vector<FrictionState> one{state};
  set_friction(scene, one);
  return one.front().mu;
}

}  // namespace contactvi
