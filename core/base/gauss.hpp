// Gauss-Legendre collocation on [0, 1] with s = 1 .. 8 stages: nodes c, weights b, coefficients A (Hairer, Lubich,
// Wanner, Geometric Numerical Integration, II.1.3), computed once to rounding.
#pragma once

namespace contactvi {

constexpr int kMaxStages = 8;

struct GaussTable {
  int s;
  double c[kMaxStages];
  double b[kMaxStages];
  double A[kMaxStages][kMaxStages];            // A[i][j] = integral of the j-th Lagrange polynomial over [0, c_i]
  double to_legendre[kMaxStages][kMaxStages];  // [k][j]: values at the nodes -> coefficients of P_k(2 tau - 1)
};

// The table of s in 1 .. kMaxStages stages.
const GaussTable& gauss_table(int s);

// P_0 .. P_{count-1} of x in [-1, 1].
void legendre(double x, int count, double* P);
// Integrals of P_k(2 tau - 1) over [0, tau], k = 0 .. count-1.
void legendre_integrals(double tau, int count, double* I);

}  // namespace contactvi
