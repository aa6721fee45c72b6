// Coefficients of friction of contacts as they stick or slide now, of any law of friction.
#pragma once

#include <vector>

#include "model/scene.hpp"

namespace contactvi {

// A contact of a guard, and its coefficient: on input the one that it keeps where it is not pressed, because no
// friction tells then what it is.
struct FrictionState {
  int guard;
  bool sticks;
  double slip;    // speed [m/s]; of what sticks it is taken as 0
  double normal;  // force [N]
  double time;    // [s]
  double mu;
  // Derivatives of mu by slip, normal force and time, where they are asked for; 0 of what sticks by its slip.
  double by_slip = 0.0, by_normal = 0.0, by_time = 0.0;
};

// Sets the coefficients, of all contacts of a law of the user with one call of it. A number that is none of a
// coefficient >= 0 becomes NaN. They are larger than zero, as contacts with friction take for granted.
void set_friction(const Scene& scene, std::vector<FrictionState>& states, bool derivatives = false);
double friction_of(const Scene& scene, const FrictionState& state);
// Coefficients that depend on forces are found with these, in rounds: forces, coefficients, forces again.
class FrictionRounds {
 public:
  // near: a change that the error of forces may keep alive; most: rounds.
  explicit FrictionRounds(double near = 1e-9, int most = 40) : near_(near), most_(most) {}
  // After a round that has changed coefficients by so much of themselves: whether there is another one.
  bool go_on(double change) {
    settled_ = change <= kExact || (change <= near_ && change >= 0.5 * last_);
    last_ = change;
    return !settled_ && ++count_ < most_;
  }
  bool settled() const { return settled_; }
  // The larger one of a change and that of a coefficient, which becomes `next`.
  static double larger(double change, double next, double& mu);

 private:
  static constexpr double kExact = 1e-13;  // a change that is rounding
  double near_, last_ = 0.0;
  int most_, count_ = 0;
  bool settled_ = true;
};
// Of a law by the state, in an impact.
FrictionState impact_friction(const ContactLaw& law, double slip, double time, bool derivatives = false);

}  // namespace contactvi
