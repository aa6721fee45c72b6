#include "model/force_rate.hpp"

#include <algorithm>
#include <cmath>

#include "base/differences.hpp"
#include "base/no_derivative.hpp"

namespace contactvi {

namespace {
constexpr double kRateSpan = 1e-4;  // [s]
// How far this difference and one of second order may be apart: of the rate, by which they are 1e-2 apart where the
// force swings with 1000 rad/s, and by its size where it jumps; and of the forces there [1/s], by which they are 1e-2
// apart where the rate of one that swings with 100 rad/s passes zero, and by 1e4 times a jump.
constexpr double kSmooth = 0.1, kSmall = 1.0;
// Of second order with twice the length, of values at t, t - length, .., t - 4 length, in 1 / length.
constexpr double kSecond[] = {0.75, 0.0, -1.0, 0.0, 0.25};
}  // namespace

bool forces_depend_on_time(const Elements& e) {
  const auto by_signal = [](const AppliedWrench& wrench) { return static_cast<bool>(wrench.signal); };
  return !e.forces.empty() || std::any_of(e.wrenches.begin(), e.wrenches.end(), by_signal);
}

void force_rate(ForceField& field, double t, double before, const VecCRef& q, const VecCRef& v, double scale,
                VecRef rate) {
  rate.setZero();
  const double length = std::min(kRateSpan, 0.25 * before);
  if (!(t - length < t)) return;  // a step of no length, in which no force does anything
  const auto n = rate.size();
  VecX size = VecX::Zero(n), other = size, force(n);
  for (int i = 0; i < 5; ++i) {
    force.setZero();
    field.add(t - i * length, q, v, force, size);
    rate += kOneSided[i] / (kDifferenceParts * length) * force;
    other += kSecond[i] / length * force;
  }
  const double most = std::max(rate.cwiseAbs().maxCoeff(), other.cwiseAbs().maxCoeff());
  if ((rate - other).cwiseAbs().maxCoeff() <= kSmooth * most + kSmall * std::max(scale, size.maxCoeff())) return;
  throw NoDerivative({"time", -1, t},
                     "A force that depends on time has no known rate beside an event, whose time moves",
                     "forces that change smoothly with time", "one that jumps, or changes within .1 ms",
                     "Give the force as control, which is constant over each step");
}

}  // namespace contactvi
