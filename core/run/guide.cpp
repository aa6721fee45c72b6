#include "run/guide.hpp"

#include <algorithm>

#include "base/gauss.hpp"

namespace contactvi {

namespace {
constexpr double kBeyond = 1.0;  // of a segment: how far beyond its ends its polynomial is continued
}

SegmentArrays arrays_of(const Segments& s) {
  return {static_cast<Eigen::Index>(s.t.size()),
          s.t.data(),
          s.h.data(),
          s.q.data(),
          s.p.data(),
          s.p1.data(),
          s.rates.data(),
          s.persistent.data()};
}

std::vector<double> impact_times(const Recording& recording) {
  std::vector<double> times;
  times.reserve(recording.impacts.size());
  for (const ImpactRecord& impact : recording.impacts) times.push_back(impact.time);
  return times;
}

Guide::Guide(const Tree& tree, int stages, const Recording& earlier)
    : paths_(tree, stages, arrays_of(earlier.segments)),
      impacts_(impact_times(earlier)),
      velocities_(tree.nv, stages),
      v_(tree.nv),
      start_(tree.nv) {}

Guide::Flight Guide::flight(double time) const {
  const auto next = std::upper_bound(impacts_.begin(), impacts_.end(), time);
  const Eigen::Index last = paths_.count() - 1;
  return {next == impacts_.begin() ? paths_.start(0) : *(next - 1),
          next == impacts_.end() ? paths_.start(last) + paths_.length(last) : *next};
}

bool Guide::velocity(double time, const Flight& flight, Integrator& integrator, VecRef v) {
  Eigen::Index k = paths_.at(std::clamp(time, flight.begin, flight.end));
  if (k > 0 && paths_.start(k) >= flight.end) --k;  // that one belongs to the next flight
  const double tau = (time - paths_.start(k)) / paths_.length(k);
  if (paths_.persistent(k) || tau < -kBeyond || tau > 1.0 + kBeyond) return false;
  const StepPath* path = paths_.path(k, integrator);
  if (path == nullptr) return false;
  path->velocity(tau, v);
  return true;
}

const MatX* Guide::lead(double t, double h, const VecX& q, const VecX& p, Integrator& integrator) {
  if (paths_.count() == 0) return nullptr;
  const GaussTable& table = gauss_table(static_cast<int>(velocities_.cols()));
  const Flight now = flight(t + 0.5 * h);
  if (!velocity(t, now, integrator, start_)) return nullptr;
  for (Eigen::Index i = 0; i < velocities_.cols(); ++i)
    if (!velocity(t + table.c[i] * h, now, integrator, velocities_.col(i))) return nullptr;
  if (!integrator.node_velocity(q, p, v_)) return nullptr;
  velocities_.colwise() += v_ - start_;
  return &velocities_;
}

}  // namespace contactvi
