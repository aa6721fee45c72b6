#include "base/lobatto.hpp"

#include <array>
#include <cmath>

namespace contactvi {

namespace {

struct LegendreValue {
  long double P, slope, curvature;
};

// P_s and its first two derivatives at x in (-1, 1).
LegendreValue legendre_at(int s, long double x) {
  long double before = 1, P = x;
  for (int k = 2; k <= s; ++k) {
    const long double next = ((2 * k - 1) * x * P - (k - 1) * before) / k;
    before = P;
    P = next;
  }
  if (s == 0) return {1, 0, 0};
  const long double slope = s * (x * P - before) / (x * x - 1);
  return {P, slope, (2 * x * slope - s * (s + 1) * P) / (1 - x * x)};
}

LobattoTable make_lobatto(int s) {
  LobattoTable table{};
  const GaussTable& gauss = gauss_table(s);
  table.s = s;
  for (int k = 0; k <= s; ++k) {
    long double x = k == 0 ? -1.0L : k == s ? 1.0L : -std::cos(3.14159265358979323846264338327950288L * k / s);
    for (int i = 0; k > 0 && k < s && i < 100; ++i) {  // Newton's method on the derivative of P_s
      const LegendreValue at = legendre_at(s, x);
      const long double change = at.slope / at.curvature;
      x -= change;
      if (std::fabs(change) < 1e-19L) break;
    }
    const long double P = k == 0 || k == s ? 1.0L : legendre_at(s, x).P;
    table.d[k] = static_cast<double>((1 + x) / 2);
    table.e[k] = static_cast<double>(1 / (s * (s + 1) * P * P));
    // The Lagrange polynomial is a sum of Legendre polynomials, whose integrals are those of the next and the last one.
    std::array<long double, kMaxStages + 2> legendre{1, x};
    for (int n = 2; n <= s; ++n) legendre[n] = ((2 * n - 1) * x * legendre[n - 1] - (n - 1) * legendre[n - 2]) / n;
    for (int j = 0; j < s; ++j) {
      long double sum = gauss.to_legendre[0][j] * (1 + x) / 2;
      for (int n = 1; n < s; ++n)
        sum += gauss.to_legendre[n][j] * (legendre[n + 1] - legendre[n - 1]) / (2 * (2 * n + 1));
      table.to_node[k][j] = k == 0 ? 0.0 : k == s ? gauss.b[j] : static_cast<double>(sum);
    }
  }
  for (int i = 0; i < s; ++i)
    for (int k = 0; k <= s; ++k) table.share[i][k] = k == s ? 0.0 : 1.0 - table.to_node[k][i] / gauss.b[i];
  return table;
}

}  // namespace

const LobattoTable& lobatto_table(int s) {
  static const std::array<LobattoTable, kMaxStages> tables = [] {
    std::array<LobattoTable, kMaxStages> all{};
    for (int k = 1; k <= kMaxStages; ++k) all[k - 1] = make_lobatto(k);
    return all;
  }();
  return tables[s - 1];
}

}  // namespace contactvi
