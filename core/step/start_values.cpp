#include "step/start_values.hpp"

#include <algorithm>

#include "step/legendre_weights.hpp"

namespace contactvi {

namespace {
constexpr int kEnough = 4;  // nodes of the extrapolation: low orders gain nothing from more than degree 3

// Value at x of the Lagrange polynomial of node j.
double lagrange(const double* nodes, int count, int j, double x) {
  double value = 1.0;
  for (int k = 0; k < count; ++k)
    if (k != j) value *= (x - nodes[k]) / (nodes[j] - nodes[k]);
  return value;
}

}  // namespace

StartValues::StartValues(int nv, const Stages& stages)
    : nv_(nv), s_(stages.count()), S_(stages.padded()), smoothed_(static_cast<std::size_t>(s_) * S_) {
  const std::size_t size = static_cast<std::size_t>(nv) * S_;
  for (int k = 0; k < std::max(1, kEnough / s_); ++k) {
    history_.emplace_back(size);
    weight_.emplace_back(static_cast<std::size_t>(s_) * S_);
  }
}

void StartValues::push(const double* velocities, double h) {
  const int kept = static_cast<int>(history_.size());  // as many steps as the extrapolation uses
  newest_ = (newest_ + kept - 1) % kept;
  std::copy(velocities, velocities + history(0).size(), history(0).data());
  if (alike_ == kept && h == h_[0]) return;
  alike_ = alike_ > 0 && h == h_[0] ? alike_ + 1 : 1;
  for (int k = kept - 1; k > 0; --k) h_[k] = h_[k - 1];
  h_[0] = h;
  count_ = std::min(count_ + 1, kept);
}

bool StartValues::is_even(double h) const {
  return s_ == 1 && count_ == kSteps && std::all_of(h_, h_ + kSteps, [h](double length) { return length == h; });
}

StartValues::History StartValues::history() const {
  History kept;
  kept.lengths.assign(h_, h_ + count_);
  kept.velocities.reserve(static_cast<std::size_t>(count_) * nv_ * s_);
  for (int k = 0; k < count_; ++k)
    for (int d = 0; d < nv_; ++d) {
      const double* stages = history(k).data() + static_cast<std::size_t>(d) * S_;
      kept.velocities.insert(kept.velocities.end(), stages, stages + s_);
    }
  return kept;
}

void StartValues::recall(const History& kept) {
  newest_ = alike_ = 0;
  count_ = static_cast<int>(kept.lengths.size());
  std::copy(kept.lengths.begin(), kept.lengths.end(), h_);
  const double* at = kept.velocities.data();
  for (int k = 0; k < count_; ++k)
    for (int d = 0; d < nv_; ++d, at += s_)
      for (int i = 0; i < S_; ++i) history(k)[static_cast<std::size_t>(d) * S_ + i] = at[std::min(i, s_ - 1)];
}

int StartValues::nodes_used() const { return count_; }

void StartValues::weigh(double h) {
  const int steps = nodes_used();
  if (weights_alike_ && h == weight_h_[kSteps] && alike_ == steps && h == h_[0] &&
      steps == static_cast<int>(history_.size()))
    return;
  bool same = steps == weight_count_ && h == weight_h_[kSteps];
  for (int m = 0; m < steps && same; ++m) same = h_[m] == weight_h_[m];
  if (same) return;
  weights_alike_ = h == h_[0] && alike_ == static_cast<int>(history_.size());
  const GaussTable& table = gauss_table(s_);
  double nodes[kSteps * kMaxStages];
  double end = 0.0;
  for (int m = 0; m < steps; ++m) {
    end -= h_[m];
    for (int j = 0; j < s_; ++j) nodes[m * s_ + j] = end + table.c[j] * h_[m];
    weight_h_[m] = h_[m];
  }
  if (steps == 1 && s_ > 1) {  // steps cut at samples have other lengths again and again
    double x[kMaxStages];
    for (int i = 0; i < S_; ++i) x[i] = 1.0 + table.c[std::min(i, s_ - 1)] * h / h_[0];
    legendre_weights(table, x, S_, weight_[0].data());
  } else {
    for (int m = 0; m < steps; ++m)
      for (int j = 0; j < s_; ++j)
        for (int i = 0; i < S_; ++i)
          weight_[m][j * S_ + i] = lagrange(nodes, steps * s_, m * s_ + j, table.c[std::min(i, s_ - 1)] * h);
  }
  weight_h_[kSteps] = h;
  weight_count_ = steps;
}

void StartValues::extrapolate(double h, Stages& stages) {
  weigh(h);
  if (S_ == 1) {  // one number per dof: what combine does, without a call for each step
    double* __restrict v = stages.v();
    if (nodes_used() == kEnough) {  // the same sums, in one pass
      const double *a = history(0).data(), *b = history(1).data(), *c = history(2).data(), *d = history(3).data();
      const double wa = weight_[0].data()[0], wb = weight_[1].data()[0], wc = weight_[2].data()[0],
                   wd = weight_[3].data()[0];
      for (int k = 0; k < nv_; ++k) v[k] = a[k] * wa + b[k] * wb + c[k] * wc + d[k] * wd;
      return;
    }
    for (int m = 0; m < nodes_used(); ++m) {
      const double weight = weight_[m].data()[0], *__restrict before = history(m).data();
      if (m == 0)
        for (int d = 0; d < nv_; ++d) v[d] = before[d] * weight;
      else
        for (int d = 0; d < nv_; ++d) v[d] = v[d] + before[d] * weight;
    }
    return;
  }
  for (int m = 0; m < nodes_used(); ++m)
    stages.kernel().combine(nv_, s_, S_, weight_[m].data(), history(m).data(), stages.v(), m > 0);
}

void StartValues::extrapolate_smoothed(double h, Stages& stages) {
  const GaussTable& table = gauss_table(s_);
  const int modes = std::max(1, s_ - 2);
  double P[kMaxStages];
  for (int i = 0; i < S_; ++i) {
    legendre(2.0 * (1.0 + table.c[std::min(i, s_ - 1)] * h / h_[0]) - 1.0, modes, P);
    for (int j = 0; j < s_; ++j) {
      double weight = 0.0;
      for (int k = 0; k < modes; ++k) weight += P[k] * table.to_legendre[k][j];
      smoothed_[j * S_ + i] = weight;
    }
  }
  stages.kernel().combine(nv_, s_, S_, smoothed_.data(), history(0).data(), stages.v(), false);
}

void StartValues::end(const GaussTable& table, VecRef v) const {
  double weights[kMaxStages];
  for (int j = 0; j < s_; ++j) {
    weights[j] = 0.0;
    for (int k = 0; k < s_; ++k) weights[j] += table.to_legendre[k][j];  // Legendre's polynomials are 1 there
  }
  for (int d = 0; d < nv_; ++d) {
    v[d] = 0.0;
    for (int j = 0; j < s_; ++j) v[d] += weights[j] * history(0)[d * S_ + j];
  }
}

void StartValues::add_piece(const Stages& stages, double start, double length) {
  if (ramp_.empty())
    for (int k = 0; k < kPieces; ++k) ramp_.push_back({AlignedArray(history_[0].size()), 0.0, 0.0});
  Piece& piece = ramp_[pieces_++];
  std::copy(stages.v(), stages.v() + piece.v.size(), piece.v.data());
  piece.start = start;
  piece.length = length;
}

void StartValues::assemble(double h, Stages& stages) {
  const GaussTable& table = gauss_table(s_);
  for (int i = 0; i < S_; ++i) {
    const double t = table.c[std::min(i, s_ - 1)] * h;
    int k = 0;
    while (k + 1 < pieces_ && t > ramp_[k + 1].start) ++k;
    const double x = (t - ramp_[k].start) / ramp_[k].length;
    for (int dof = 0; dof < nv_; ++dof) {
      double value = 0.0;
      for (int j = 0; j < s_; ++j) value += lagrange(table.c, s_, j, x) * ramp_[k].v[dof * S_ + j];
      stages.v()[dof * S_ + i] = value;
    }
  }
}

}  // namespace contactvi
