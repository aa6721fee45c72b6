#include "base/extrapolation.hpp"

#include <algorithm>

namespace contactvi {

void Extrapolation::times(double h, double* t) const {
  double end = -0.5 * h;
  for (int k = 0; k < known_.count; ++k) {
    t[k] = end - 0.5 * known_.lengths[k];
    end -= known_.lengths[k];
  }
}

void Extrapolation::push(const VecX& x, double h) {
  const Eigen::Index n = x.size();
  if (known_.differences.rows() != n || known_.differences.cols() != kMost) {
    known_.differences.resize(n, kMost);
    known_.lengths.resize(kMost);
    clear();
  }
  double t[kMost], product = 1.0, least = 0.0;
  times(h, t);
  const int tried = known_.count;
  int best = 0;
  off_ = -x;
  newer_ = x;
  for (int k = 0; k < tried; ++k) {
    auto difference = known_.differences.col(k);
    off_ += product * difference;
    product *= -t[k];
    const double error = n > 0 ? off_.cwiseAbs().maxCoeff() : 0.0;
    if (k == 0 || error < least) {
      best = k;
      least = error;
    }
    older_ = difference;
    difference = newer_;
    newer_ = (newer_ - older_) / -t[k];
  }
  if (tried < kMost) known_.differences.col(tried) = newer_;
  // The vector now added allows one degree more, which is tried where the highest so far was the best.
  known_.count = std::min(tried + 1, kMost);
  known_.degree = tried == 0 ? 0 : best == tried - 1 ? std::min(best + 1, known_.count - 1) : best;
  for (int k = known_.count - 1; k > 0; --k) known_.lengths[k] = known_.lengths[k - 1];
  known_.lengths[0] = h;
}

void Extrapolation::predict(double h, VecX& x) const {
  double t[kMost], product = 1.0;
  times(h, t);
  x = known_.differences.col(0);
  for (int k = 1; k <= known_.degree && t[0] - t[k] >= kApart * -t[0]; ++k) {
    product *= -t[k - 1];
    x += product * known_.differences.col(k);
  }
}

Extrapolation::History Extrapolation::history() const {
  History kept = known_;
  kept.lengths.conservativeResize(known_.count);
  kept.differences.conservativeResize(Eigen::NoChange, known_.count);
  return kept;
}

void Extrapolation::recall(const History& history) {
  known_ = history;
  known_.lengths.conservativeResize(kMost);
  known_.differences.conservativeResize(Eigen::NoChange, kMost);
}

}  // namespace contactvi
