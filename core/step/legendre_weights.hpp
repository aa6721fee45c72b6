// Values of the polynomial through the Gauss nodes of a step at other places.
#pragma once

#include "base/gauss.hpp"

namespace contactvi {

// Weights of the values at the Gauss nodes in those at x[i], i < count, of the polynomial through them; x: fractions of
// the step. weights[j * count + i] of node j.
inline void legendre_weights(const GaussTable& table, const double* x, int count, double* __restrict weights) {
  double P[kMaxStages][kMaxStages];  // Legendre's polynomials, lane by lane
  for (int i = 0; i < count; ++i) {
    P[0][i] = 1.0;
    P[1][i] = 2.0 * x[i] - 1.0;
  }
  for (int k = 2; k < table.s; ++k)
    for (int i = 0; i < count; ++i) P[k][i] = ((2 * k - 1) * P[1][i] * P[k - 1][i] - (k - 1) * P[k - 2][i]) / k;
  for (int j = 0; j < table.s; ++j) {
    double* __restrict row = weights + j * count;
    for (int i = 0; i < count; ++i) row[i] = table.to_legendre[0][j];
    for (int k = 1; k < table.s; ++k)
      for (int i = 0; i < count; ++i) row[i] += table.to_legendre[k][j] * P[k][i];
  }
}

}  // namespace contactvi
