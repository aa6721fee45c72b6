#include "model/contact_law.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/differences.hpp"

namespace contactvi {

namespace {
constexpr double kStep = 1e-3;       // of the speed, of differences
constexpr double kLeastStep = 1e-6;  // [m/s]
}  // namespace

SpeedFunction::SpeedFunction(std::vector<double> speeds, std::vector<double> values)
    : speeds_(std::move(speeds)), values_(std::move(values)) {}

SpeedFunction::SpeedFunction(std::function<double(double)> value, std::function<double(double)> slope)
    : function_(std::move(value)), slope_(std::move(slope)) {}

double SpeedFunction::operator()(double speed) const {
  if (function_ != nullptr) return function_(speed);
  const auto next = std::upper_bound(speeds_.begin(), speeds_.end(), speed);
  if (next == speeds_.begin()) return values_.front();
  if (next == speeds_.end()) return values_.back();
  const auto i = static_cast<std::size_t>(next - speeds_.begin());
  const double share = (speed - speeds_[i - 1]) / (speeds_[i] - speeds_[i - 1]);
  return values_[i - 1] + share * (values_[i] - values_[i - 1]);
}

double SpeedFunction::slope(double speed) const {
  if (slope_ != nullptr) return slope_(speed);
  if (function_ == nullptr) {
    const auto next = std::upper_bound(speeds_.begin(), speeds_.end(), speed);
    if (next == speeds_.begin() || next == speeds_.end()) return 0.0;
    const auto i = static_cast<std::size_t>(next - speeds_.begin());
    return (values_[i] - values_[i - 1]) / (speeds_[i] - speeds_[i - 1]);
  }
  const double step = std::max(kStep * speed, kLeastStep);
  double sum = 0.0;
  if (speed > 2.0 * step) {
    for (const DifferenceTerm& term : kDifference) sum += term.weight * function_(speed + term.count * step);
  } else {  // a speed is not negative
    for (int i = 0; i < 5; ++i) sum -= kOneSided[i] * function_(speed + i * step);
  }
  return sum / (kDifferenceParts * step);
}

}  // namespace contactvi
