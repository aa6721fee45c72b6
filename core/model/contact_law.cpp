#include "model/contact_law.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "base/differences.hpp"

namespace contactvi {

namespace {
constexpr double kStep = 1e-3;       // of the place, of differences
constexpr double kLeastStep = 1e-6;  // [m/s; s]
}  // namespace

NumberFunction::NumberFunction(std::vector<double> places, std::vector<double> values)
    : places_(std::move(places)), values_(std::move(values)) {}

NumberFunction::NumberFunction(std::function<double(double)> value) : function_(std::move(value)) {}

int NumberFunction::piece(double place) const {
  return static_cast<int>(std::upper_bound(places_.begin(), places_.end(), place) - places_.begin()) - 1;
}

double NumberFunction::rise(int piece) const {
  if (piece < 0 || piece + 1 == static_cast<int>(places_.size())) return 0.0;
  const auto i = static_cast<std::size_t>(piece);
  return (values_[i + 1] - values_[i]) / (places_[i + 1] - places_[i]);
}

double NumberFunction::operator()(double place) const {
  if (function_ != nullptr) return function_(place);
  const int at = piece(place);
  const auto i = static_cast<std::size_t>(std::max(0, at));
  return values_[i] + rise(at) * (place - places_[i]);
}

double NumberFunction::slope(double place) const {
  if (function_ == nullptr) return rise(piece(place));
  const double step = std::max(kStep * place, kLeastStep);
  double sum = 0.0;
  if (place > 2.0 * step) {
    for (const DifferenceTerm& term : kDifference) sum += term.weight * function_(place + term.count * step);
  } else {  // it is not negative
    for (int i = 0; i < 5; ++i) sum -= kOneSided[i] * function_(place + i * step);
  }
  return sum / (kDifferenceParts * step);
}

}  // namespace contactvi
