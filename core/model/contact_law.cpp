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

SpeedFunction::SpeedFunction(std::function<double(double)> value) : function_(std::move(value)) {}

int SpeedFunction::piece(double speed) const {
  return static_cast<int>(std::upper_bound(speeds_.begin(), speeds_.end(), speed) - speeds_.begin()) - 1;
}

double SpeedFunction::rise(int piece) const {
  if (piece < 0 || piece + 1 == static_cast<int>(speeds_.size())) return 0.0;
  const auto i = static_cast<std::size_t>(piece);
  return (values_[i + 1] - values_[i]) / (speeds_[i + 1] - speeds_[i]);
}

double SpeedFunction::operator()(double speed) const {
  if (function_ != nullptr) return function_(speed);
  const int at = piece(speed);
  const auto i = static_cast<std::size_t>(std::max(0, at));
  return values_[i] + rise(at) * (speed - speeds_[i]);
}

double SpeedFunction::slope(double speed) const {
  if (function_ == nullptr) return rise(piece(speed));
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
