#include "base/extrapolation.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

// Weights of the values at the first count of the times in the polynomial's value at 0 (Lagrange).
void lagrange_at_zero(const double* t, int count, double* weights) {
  for (int j = 0; j < count; ++j) {
    weights[j] = 1.0;
    for (int k = 0; k < count; ++k)
      if (k != j) weights[j] *= t[k] / (t[k] - t[j]);
  }
}

}  // namespace

void Extrapolation::times(double h, double* t) const {
  double end = -0.5 * h;
  for (int k = 0; k < known_.count; ++k) {
    t[k] = end - 0.5 * known_.lengths[k];
    end -= known_.lengths[k];
  }
}

void Extrapolation::push(const VecX& x, double h) {
  const Eigen::Index n = x.size();
  if (known_.values.rows() != n || known_.values.cols() != kMost) {
    known_.values.resize(n, kMost);
    known_.lengths.resize(kMost);
    clear();
  }
  double t[kMost], weights[kMost], least = 0.0;
  times(h, t);
  int best = 0;
  for (int count = 1; count <= known_.count; ++count) {
    lagrange_at_zero(t, count, weights);
    predicted_ = -x;
    for (int k = 0; k < count; ++k) predicted_ += weights[k] * known_.values.col(k);
    const double error = n > 0 ? predicted_.cwiseAbs().maxCoeff() : 0.0;
    if (count > 1 && !(error < least)) continue;
    best = count - 1;
    least = error;
  }
  // The vector now added allows one degree more, which is tried where the highest so far was the best.
  const int tried = known_.count;
  known_.count = std::min(tried + 1, kMost);
  known_.degree = tried == 0 ? 0 : best == tried - 1 ? std::min(best + 1, known_.count - 1) : best;
  for (int k = known_.count - 1; k > 0; --k) {
    known_.values.col(k) = known_.values.col(k - 1);
    known_.lengths[k] = known_.lengths[k - 1];
  }
  known_.values.col(0) = x;
  known_.lengths[0] = h;
}

void Extrapolation::predict(double h, VecX& x) const {
  double t[kMost], weights[kMost];
  times(h, t);
  const int count = known_.degree + 1;
  lagrange_at_zero(t, count, weights);
  x = weights[0] * known_.values.col(0);
  for (int k = 1; k < count; ++k) x += weights[k] * known_.values.col(k);
}

Extrapolation::History Extrapolation::history() const {
  History kept = known_;
  kept.lengths.conservativeResize(known_.count);
  kept.values.conservativeResize(Eigen::NoChange, known_.count);
  return kept;
}

void Extrapolation::recall(const History& history) {
  known_ = history;
  known_.lengths.conservativeResize(kMost);
  known_.values.conservativeResize(Eigen::NoChange, kMost);
}

}  // namespace contactvi
