#include "step/guide.hpp"

#include <algorithm>
#include <utility>

#include "step/legendre_weights.hpp"

namespace contactvi {

namespace {
constexpr double kBeyond = 1.0;  // of a segment: how far beyond its ends its polynomial is continued
}  // namespace

Guide::Guide(const Tree& tree, const SegmentArrays& earlier, std::vector<double> impacts)
    : tree_(&tree), segments_(earlier), impacts_(std::move(impacts)), difference_(tree.nv) {}

Guide::Flight Guide::flight(double time) const {
  const auto next = std::upper_bound(impacts_.begin(), impacts_.end(), time);
  const Eigen::Index last = segments_.count - 1;
  return {next == impacts_.begin() ? segments_.t[0] : *(next - 1),
          next == impacts_.end() ? segments_.t[last] + segments_.h[last] : *next};
}

bool Guide::place(double time, const Flight& flight, Place& place) {
  const double inside = std::clamp(time, flight.begin, flight.end);
  Eigen::Index& k = cursor_;  // one time lies near the one before
  while (k + 1 < segments_.count && segments_.t[k + 1] <= inside && segments_.t[k + 1] < flight.end) ++k;
  while (k > 0 && (segments_.t[k] > inside || segments_.t[k] >= flight.end)) --k;
  place = {k, (time - segments_.t[k]) / segments_.h[k]};
  return segments_.persistent[k] == 0.0 && place.x >= -kBeyond && place.x <= 1.0 + kBeyond;
}

// Angular velocities at the stages of a segment, from the chart rates in v.
void Guide::turn(const Joint& joint, Eigen::Index segment, const Stages& stages, double* v) const {
  const int s = stages.count(), S = stages.padded();
  const GaussTable& table = stages.table();
  Vec3 turned[kMaxStages];
  for (int i = 0; i < s; ++i) {
    Vec3 X = Vec3::Zero();
    for (int j = 0; j < s; ++j)
      for (int d = 0; d < 3; ++d) X[d] += segments_.h[segment] * table.A[i][j] * v[(joint.iv + d) * S + j];
    const Vec3 rate(v[joint.iv * S + i], v[(joint.iv + 1) * S + i], v[(joint.iv + 2) * S + i]);
    const So3Coefficients c = so3_coefficients(X.squaredNorm());
    turned[i] = so3_apply(X, -c.cos_t, c.cub_t, rate);
  }
  for (int i = 0; i < s; ++i)
    for (int d = 0; d < 3; ++d) v[(joint.iv + d) * S + i] = turned[i][d];
}

const double* Guide::velocities(Eigen::Index segment, const Stages& stages) {
  for (Known& known : known_)
    if (known.segment == segment) return known.v[0].data();
  const int nv = tree_->nv, s = stages.count(), S = stages.padded();
  Known& known = known_[oldest_];
  oldest_ = (oldest_ + 1) % kKnown;
  known.segment = segment;
  if (known.v.empty()) known.v.emplace_back(static_cast<std::size_t>(nv) * S);
  double* v = known.v[0].data();
  const double* rates = segments_.rates + segment * nv * s;
  for (int i = 0; i < s; ++i)
    for (int d = 0; d < nv; ++d) v[d * S + i] = rates[i * nv + d];
  for (const Joint& joint : tree_->joints)
    if (joint.type == JointType::kSpherical) turn(joint, segment, stages, v);
  return v;
}

bool Guide::lead(double t, double h, const StartValues& own, Stages& stages) {
  if (segments_.count == 0) return false;
  const GaussTable& table = stages.table();
  const int nv = tree_->nv, s = stages.count(), S = stages.padded();
  const Flight now = flight(t + 0.5 * h);
  Place start, places[kMaxStages];
  if (!place(t, now, start)) return false;
  for (int i = 0; i < s; ++i)
    if (!place(t + table.c[i] * h, now, places[i])) return false;
  if (weights_.empty()) weights_.emplace_back(static_cast<std::size_t>(s) * S);
  double* weights = weights_[0].data();
  double x[kMaxStages];
  for (int i = 0; i < S; ++i) x[i] = places[std::min(i, s - 1)].x;
  // The lanes of one segment after the other, with no weight for the others.
  for (int first = 0; first < s;) {
    int end = first + 1;
    while (end < s && places[end].segment == places[first].segment) ++end;
    legendre_weights(table, x, S, weights);
    const int last = end == s ? S : end;
    for (int j = 0; j < s; ++j) {
      std::fill_n(weights + j * S, first, 0.0);
      std::fill_n(weights + j * S + last, S - last, 0.0);
    }
    stages.kernel().combine(nv, s, S, weights, velocities(places[first].segment, stages), stages.v(), first > 0);
    first = end;
  }
  if (own.count() == 0) return true;
  own.end(table, difference_);
  double at_start[kMaxStages];
  legendre_weights(table, &start.x, 1, at_start);
  const double* v = velocities(start.segment, stages);
  for (int d = 0; d < nv; ++d) {
    double difference = difference_[d];
    for (int j = 0; j < s; ++j) difference -= at_start[j] * v[d * S + j];
    for (int i = 0; i < S; ++i) stages.v()[d * S + i] += difference;
  }
  return true;
}

}  // namespace contactvi
