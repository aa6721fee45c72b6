// Integrator: sums over the stages of the step just solved.
#include <cmath>

#include "step/integrator.hpp"

namespace contactvi {

double Integrator::truncation() const {
  const int s = stages_.count(), S = stages_.padded();
  const double* weight = stages_.table().to_legendre[s - 1];
  double sum = 0.0;
  for (int d = 0; d < tree_->nv; ++d) {
    double mode = 0.0;
    for (int j = 0; j < s; ++j) mode += weight[j] * stages_.v()[d * S + j];
    sum += mode * mode;
  }
  return std::abs(h_) * std::sqrt(sum);
}

// Gauss's sum of what value(i) says at the stages.
template <class Value>
double Integrator::quadrature(Value value) const {
  double total = 0.0;
  for (int i = 0; i < stages_.count(); ++i) total += h_ * stages_.table().b[i] * value(i);
  return total;
}

double Integrator::input_work() const {
  return quadrature([&](int i) { return stages_.input_power(i); });
}

double Integrator::damping_loss() const {
  return quadrature([&](int i) { return stages_.dissipation(i); });
}

double Integrator::mean_work() const {
  const GaussTable& table = stages_.table();
  double total = 0.0;
  for (int j = 0; j < stages_.count(); ++j) {
    double weight = 0.0;
    for (int i = 0; i < stages_.count(); ++i) weight += table.b[i] * table.A[i][j];
    total += h_ * weight * (stages_.input_power(j) - stages_.dissipation(j));
  }
  return total;
}

double Integrator::discrete_energy() {
  const int S = stages_.padded();
  double total = 0.0;
  for (int i = 0; i < stages_.count(); ++i) {
    stages_.configuration(q0_, i, q_stage_);
    place(*tree_, q_stage_, placements_);
    double energy = total_potential(*tree_, stages_.field(), placements_, q_stage_);
    // P belongs to the velocity before the last correction: 1/2 (v - dv) M (v - dv) + ... = 1/2 P.(v + dv) to second
    // order.
    for (int d = 0; d < tree_->nv; ++d)
      energy += 0.5 * stages_.P()[d * S + i] * (stages_.v()[d * S + i] + stages_.dv()[d * S + i]);
    total += stages_.table().b[i] * energy;
  }
  return total;
}

}  // namespace contactvi
