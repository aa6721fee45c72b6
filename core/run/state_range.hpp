// The numbers of a state that still have a meaning.
#pragma once

#include <cmath>

#include "base/numerics.hpp"

namespace contactvi {

// Of the numbers of a state: the energy of a larger one may overflow. What scenes and starts are made of is below 1e50
// (contactvi/inputs.py), and a motion that gets here from there has no meaning.
constexpr double kLargestNumber = 1e100;

// Whether all of these numbers are finite and small enough. NaN is not <= anything.
inline bool in_range(const double* x, Eigen::Index count) {
  double sum = 0.0;
  for (Eigen::Index i = 0; i < count; ++i) sum += x[i] * x[i];
  if (sum <= kLargestNumber * kLargestNumber) return true;
  for (Eigen::Index i = 0; i < count; ++i)
    if (!(std::abs(x[i]) <= kLargestNumber)) return false;
  return true;
}

// Whether all numbers of a state are, so that its energy is finite.
inline bool in_range(const VecX& q, const VecX& p) {
  return in_range(q.data(), q.size()) && in_range(p.data(), p.size());
}

}  // namespace contactvi
