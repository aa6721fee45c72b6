#include "run/run_comparison.hpp"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "run/states_between.hpp"

namespace contactvi {

namespace {
constexpr double kEnded = 1e-3;      // of the time of a run: one that ended so much earlier did not reach its end
constexpr double kSameTime = 1e-12;  // of the time of a run
constexpr double kDistinct = 1.3;    // ratio of errors, by the law, below which the steps of a flight are much alike
constexpr double kMatters = 0.01;    // share of a flight in the error, by the law, below which that does not matter
constexpr int kStarts = 3;           // flights whose first step is looked at

// The whole number nearest to x, halves to the even one.
std::size_t nearest(double x) { return static_cast<std::size_t>(std::nearbyint(x)); }

// `times` nodes up to the number `count`, the last one among them: spread evenly over the time.
std::vector<std::size_t> nodes_over_time(const std::vector<double>& t, std::size_t count, int times) {
  std::vector<std::size_t> nodes;
  for (int k = 1; k <= times; ++k) {
    const double time = t[0] + (t[count - 1] - t[0]) * k / times * (1.0 - kSameTime);
    nodes.push_back(static_cast<std::size_t>(std::lower_bound(t.begin(), t.end(), time) - t.begin()));
  }
  return nodes;
}

// As this, one in each of as many parts with equally many nodes: that to which the other run's step is shortest, for a
// short step takes few iterations.
std::vector<std::size_t> nodes_in_parts(const std::vector<double>& t, std::size_t count, int times,
                                        const SegmentPaths& other) {
  std::vector<std::size_t> nodes;
  const std::size_t last = count - 1;
  for (int k = 1; k <= times; ++k) {
    const auto end_of = [&](int part) { return nearest(static_cast<double>(last) * part / times); };
    std::size_t best = end_of(k);
    for (std::size_t i = end_of(k - 1) + 1; best < last && i < end_of(k); ++i)
      if (other.step_to(t[i]) < other.step_to(t[best])) best = i;
    nodes.push_back(best);
  }
  return nodes;
}

// Nodes up to the number `count` at whose times the other run has a node too, with the numbers of both.
std::vector<std::pair<std::size_t, std::size_t>> common_nodes(const std::vector<double>& t, std::size_t count,
                                                              const std::vector<double>& other) {
  std::vector<std::pair<std::size_t, std::size_t>> nodes;
  const double slack = kSameTime * std::max(std::abs(t.front()), std::abs(t.back()));
  for (std::size_t k = 1, m = 1; k < count && m < other.size();) {
    if (std::abs(t[k] - other[m]) <= slack)
      nodes.emplace_back(k++, m++);
    else if (t[k] < other[m])
      ++k;
    else
      ++m;
  }
  return nodes;
}

}  // namespace

VecX distances(const Scene& scene, const SimulatorOptions& options, const KeptRun& other, const KeptRun& found,
               int times, bool over_time, bool ended) {
  const Tree& tree = scene.tree;
  const std::vector<double>& t = found.recording.t;
  const double last = other.recording.t.back();
  if (t.size() < 2 || other.recording.segments.t.empty() ||
      (!ended && std::abs(t.back() - last) > kEnded * (t.back() - t.front())))
    return VecX::Constant(1, kInfinity);
  const std::size_t both = static_cast<std::size_t>(std::upper_bound(t.begin(), t.end(), last) - t.begin());
  const auto common = common_nodes(t, both, other.recording.t);
  if (common.size() >= static_cast<std::size_t>(times)) {
    VecX apart(times);
    for (int k = 0; k < times; ++k) {
      const double share = static_cast<double>(k + 1) / times;
      const auto [own, others] = common[nearest(share * static_cast<double>(common.size())) - 1];
      apart[k] = configuration_distance(tree, other.configuration(tree, others), found.configuration(tree, own));
    }
    return apart;
  }
  StatesBetween states(scene, options, other);
  const std::vector<std::size_t> nodes =
      over_time ? nodes_over_time(t, both, times) : nodes_in_parts(t, both, times, states.paths());
  VecX apart(static_cast<Eigen::Index>(nodes.size())), q(tree.nq);
  for (std::size_t k = 0; k < nodes.size(); ++k)
    apart[static_cast<Eigen::Index>(k)] = states.configuration(t[nodes[k]], q)
                                              ? configuration_distance(tree, q, found.configuration(tree, nodes[k]))
                                              : kInfinity;
  return apart;
}

double error_share(const KeptRun& companion, const KeptRun& found, int power, double dt_contact) {
  const std::vector<double>&begins = found.recording.adaptive_t, &lengths = found.recording.adaptive_dt;
  const bool persistent = contact_time(found) > 0.0;
  if (begins.empty() || companion.recording.impacts.size() != found.recording.impacts.size())
    return persistent && contact_time(companion) > 0.0 ? kNaN : kInfinity;
  const std::size_t flights = found.recording.impacts.size() + 1;
  const auto sums = [&](const KeptRun& run) {
    std::vector<double> sum(flights);
    const Segments& s = run.recording.segments;
    const std::vector<double> impacts = impact_times(run.recording);
    for (std::size_t k = 0; k < s.t.size(); ++k) {
      const double middle = s.t[k] + 0.5 * s.h[k];
      const std::ptrdiff_t at = std::upper_bound(begins.begin(), begins.end(), middle) - begins.begin() - 1;
      const double unit = lengths[static_cast<std::size_t>(std::max<std::ptrdiff_t>(at, 0))];
      const double weight =
          s.persistent[k] == Segments::kContactStep ? std::pow(s.h[k] / dt_contact, 3) : std::pow(s.h[k] / unit, power);
      sum[static_cast<std::size_t>(std::lower_bound(impacts.begin(), impacts.end(), middle) - impacts.begin())] +=
          weight;
    }
    return sum;
  };
  const std::vector<double> own = sums(found), larger = sums(companion);
  double whole = 0.0, difference = 0.0;
  for (double x : own) whole += x;
  for (double x : larger) difference += x;
  difference -= whole;
  for (std::size_t k = 0; k < flights; ++k)
    if (larger[k] < kDistinct * own[k] && own[k] > kMatters * whole) return kInfinity;
  return whole / difference;
}

double first_step_error(const Scene& scene, const SimulatorOptions& options, const KeptRun& run) {
  const Tree& tree = scene.tree;
  StatesBetween states(scene, options, run);
  if ((!tree.has_damping && !tree.elements.any_force() && !states.has_servos()) || states.has_branches()) return 0.0;
  const Segments& s = run.recording.segments;
  const std::vector<double> impacts = impact_times(run.recording);
  std::vector<std::size_t> starts{0};
  for (int k = 0; k < kStarts && !impacts.empty(); ++k) {
    const std::size_t impact = static_cast<std::size_t>(static_cast<double>(k * (impacts.size() - 1)) / (kStarts - 1));
    const auto after = std::lower_bound(s.t.begin(), s.t.end(), impacts[impact]);
    if (after != s.t.end()) starts.push_back(static_cast<std::size_t>(after - s.t.begin()));
  }
  std::sort(starts.begin(), starts.end());
  starts.erase(std::unique(starts.begin(), starts.end()), starts.end());
  SegmentPaths& paths = states.paths();
  VecX whole(tree.nq);
  double worst = 0.0;
  for (const std::size_t start : starts) {
    const Eigen::Index segment = static_cast<Eigen::Index>(start);
    if (start >= s.t.size() || paths.persistent(segment)) continue;
    const StepPath* path = paths.path(segment, states.integrator());
    if (path == nullptr) return kInfinity;
    VecX q = paths.q(segment), p = paths.p(segment);
    const double begin = paths.start(segment), half = 0.5 * paths.length(segment);
    if (!states.advance(begin, begin, half, q, p) || !states.advance(begin, begin + half, half, q, p)) return kInfinity;
    path->configuration(1.0, whole);
    worst = std::max(worst, configuration_distance(tree, whole, q));
  }
  return worst;
}

}  // namespace contactvi
