#include "step/raised_nodes.hpp"

namespace contactvi {

RaisedNodes::RaisedNodes(int stages)
    : plain(stages, stages),
      rate_by_start(VecX::Zero(stages)),
      rate_by_end(VecX::Zero(stages)),
      moved(stages, stages),
      moved_by_start(VecX::Zero(stages)),
      moved_by_end(VecX::Zero(stages)) {
  const LobattoTable& table = lobatto_table(stages);
  const GaussTable& gauss = gauss_table(stages);
  for (int k = 0; k < stages; ++k) {
    double P[kMaxStages];
    legendre(2.0 * table.d[k + 1] - 1.0, stages, P);
    for (int j = 0; j < stages; ++j) {
      plain(j, k) = 0.0;
      for (int n = 0; n < stages; ++n) plain(j, k) += P[n] * gauss.to_legendre[n][j];
      moved(j, k) = table.to_node[k + 1][j];
    }
  }
  rate = plain;
  double start[kMaxStages];
  for (int j = 0; j < stages; ++j) {
    start[j] = 0.0;
    for (int n = 0; n < stages; ++n) start[j] += (n % 2 == 0 ? 1.0 : -1.0) * gauss.to_legendre[n][j];
  }
  // The path is raised by P_s(x) (a + b x), which takes the velocities at both ends. Its displacement at the end stays.
  const double sign = stages % 2 == 0 ? 1.0 : -1.0, s = stages;
  for (int k = 0; k + 1 < stages; ++k) {
    double P[kMaxStages + 2], I[kMaxStages + 2];
    const double x = 2.0 * table.d[k + 1] - 1.0;
    legendre(x, stages + 1, P);
    rate_by_end[k] = 0.5 * P[stages] * (1.0 + x);
    rate_by_start[k] = 0.5 * sign * P[stages] * (1.0 - x);
    legendre_integrals(table.d[k + 1], stages + 2, I);
    const double even = I[stages], odd = ((s + 1.0) * I[stages + 1] + s * I[stages - 1]) / (2.0 * s + 1.0);
    moved_by_end[k] = 0.5 * (even + odd);
    moved_by_start[k] = 0.5 * sign * (even - odd);
    for (int j = 0; j < stages; ++j) {
      rate(j, k) -= rate_by_end[k] * plain(j, stages - 1) + rate_by_start[k] * start[j];
      moved(j, k) -= moved_by_end[k] * plain(j, stages - 1) + moved_by_start[k] * start[j];
    }
  }
}

}  // namespace contactvi
