// Values of the polynomial through the Gauss nodes of a step at other places.
#pragma once

#include <type_traits>

#include "base/gauss.hpp"

namespace contactvi {

// Weights of the values at the Gauss nodes in those at x[i], i < count, of the polynomial through them; x:
// fractions of the step. weights[j * count + i] of node j. A count that the compiler knows takes half of the time.
template <class Count>
void weigh_by_legendre(const GaussTable& table, const double* x, Count count, double* __restrict weights) {
  double P[kMaxStages][kMaxStages];  // Legendre's polynomials, lane by lane
  for (int i = 0; i < count; ++i) {
    P[0][i] = 1.0;
    P[1][i] = 2.0 * x[i] - 1.0;
  }
  for (int k = 2; k < table.s; ++k)
    for (int i = 0; i < count; ++i) P[k][i] = ((2 * k - 1) * P[1][i] * P[k - 1][i] - (k - 1) * P[k - 2][i]) / k;
  for (int j = 0; j < table.s; ++j) {
    double row[kMaxStages];
    for (int i = 0; i < count; ++i) row[i] = table.to_legendre[0][j];
    for (int k = 1; k < table.s; ++k)
      for (int i = 0; i < count; ++i) row[i] += table.to_legendre[k][j] * P[k][i];
    for (int i = 0; i < count; ++i) weights[j * count + i] = row[i];
  }
}

inline void legendre_weights(const GaussTable& table, const double* x, int count, double* weights) {
  if (count == kMaxStages)
    weigh_by_legendre(table, x, std::integral_constant<int, kMaxStages>(), weights);
  else
    weigh_by_legendre(table, x, count, weights);
}

}  // namespace contactvi
