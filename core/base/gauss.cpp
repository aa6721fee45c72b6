#include "base/gauss.hpp"

#include <cmath>
#include <vector>

namespace contactvi {

void legendre(double x, int count, double* P) {
  if (count > 0) P[0] = 1.0;
  if (count > 1) P[1] = x;
  for (int k = 2; k < count; ++k) P[k] = ((2 * k - 1) * x * P[k - 1] - (k - 1) * P[k - 2]) / k;
}

void legendre_integrals(double tau, int count, double* I) {
  // The integral of P_k over x is (P_{k+1} - P_{k-1}) / (2 k + 1), which vanishes at x = -1 for k >= 1; dtau = dx/2.
  double P[2 * kMaxStages + 2];
  legendre(2.0 * tau - 1.0, count + 1, P);
  I[0] = tau;
  for (int k = 1; k < count; ++k) I[k] = 0.5 * (P[k + 1] - P[k - 1]) / (2 * k + 1);
}

namespace {

// Computes in long double, so that the rounded entries are correct to the last place.
GaussTable make_gauss(int s) {
  GaussTable table{};
  table.s = s;
  std::vector<long double> x(s), w(s);
  for (int i = 0; i < s; ++i) {
    // Newton's method on P_s from Tricomi's approximation of the root.
    long double z = -std::cos(3.14159265358979323846264338327950288L * (i + 0.75L) / (s + 0.5L));
    long double slope = 1;
    for (int k = 0; k < 100; ++k) {
      long double P0 = 1, P1 = z;
      for (int n = 2; n <= s; ++n) {
        const long double P2 = ((2 * n - 1) * z * P1 - (n - 1) * P0) / n;
        P0 = P1;
        P1 = P2;
      }
      slope = s * (z * P1 - P0) / (z * z - 1);
      const long double change = P1 / slope;
      z -= change;
      if (std::fabs(change) < 1e-19L) break;
    }
    x[i] = z;
    w[i] = 1 / ((1 - z * z) * slope * slope);  // on [0, 1]
  }
  auto values = [](long double z, int count) {
    std::vector<long double> P(count + 1);
    P[0] = 1;
    if (count > 0) P[1] = z;
    for (int k = 2; k <= count; ++k) P[k] = ((2 * k - 1) * z * P[k - 1] - (k - 1) * P[k - 2]) / k;
    return P;
  };
  std::vector<std::vector<long double>> P(s);
  for (int i = 0; i < s; ++i) P[i] = values(x[i], s);
  for (int i = 0; i < s; ++i) {
    table.c[i] = static_cast<double>((1 + x[i]) / 2);
    table.b[i] = static_cast<double>(w[i]);
    for (int j = 0; j < s; ++j) {
      // By discrete orthogonality the Lagrange polynomial is l_j = sum_k (2k+1) w_j P_k(x_j) P_k.
      long double a = 0;
      for (int k = 0; k < s; ++k) {
        const long double integral = k == 0 ? (1 + x[i]) / 2 : (P[i][k + 1] - P[i][k - 1]) / (2 * (2 * k + 1));
        a += (2 * k + 1) * w[j] * P[j][k] * integral;
      }
      table.A[i][j] = static_cast<double>(a);
    }
  }
  for (int k = 0; k < s; ++k)
    for (int j = 0; j < s; ++j) table.to_legendre[k][j] = static_cast<double>((2 * k + 1) * w[j] * P[j][k]);
  return table;
}

}  // namespace

const GaussTable& gauss_table(int s) {
  static const std::vector<GaussTable> tables = [] {
    std::vector<GaussTable> all;
    for (int k = 1; k <= kMaxStages; ++k) all.push_back(make_gauss(k));
    return all;
  }();
  return tables[s - 1];
}

}  // namespace contactvi
