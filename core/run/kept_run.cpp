#include "run/kept_run.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

namespace contactvi {

namespace {
constexpr double kInfinity = std::numeric_limits<double>::infinity(), kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kEnded = 1e-3;      // of the time of a run: one that ended so much earlier did not reach its end
constexpr double kSameTime = 1e-12;  // of the time of a run
constexpr double kDistinct = 1.3;    // ratio of errors, by the law, below which the steps of a flight are much alike
constexpr double kMatters = 0.01;    // share of a flight in the error, by the law, below which that does not matter
constexpr int kStarts = 3;           // flights whose first step is looked at
constexpr int kMostParts = 16;       // in which a step may be solved
constexpr int kMostIterations = 100;

Eigen::Map<const VecX> configuration(const Tree& tree, const KeptRun& run, std::size_t node) {
  return {run.recording.q.data() + node * static_cast<std::size_t>(tree.nq), tree.nq};
}

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

// Advances a state by h, in the fewest powers of two of parts that are solved, led by a run. t: of the state [s].
bool advance_state(Integrator& integrator, Guide& guide, double t, double h, VecX& q, VecX& p) {
  const VecX q0 = q, p0 = p;
  VecX q1(q.size()), p1(p.size());
  for (int parts = 1; parts <= kMostParts; parts *= 2) {
    const double length = h / parts;
    q = q0;
    p = p0;
    int solved = 0;
    for (; solved < parts; ++solved) {
      integrator.forget();
      integrator.set_time(t + solved * length);
      integrator.lead(&guide, t + solved * length);
      if (!integrator.solve(q, p, length, VecX())) break;
      integrator.finish(q1, p1);
      q = q1;
      p = p1;
    }
    if (solved == parts) return true;
  }
  return false;
}

// The servos of a run; none where there are no references. Moving ones are still to be referred to a time.
Servo servos_of(const Tree& tree, const KeptRun& run) {
  const Elements& e = tree.elements;
  Servo servo;
  const Servo& used = run.state.actuators.servo;
  if (e.servo_kp.size() == 0 || used.q_ref.size() == 0) return servo;
  servo.any = true;
  servo.kp = e.servo_kp;
  servo.kd = e.servo_kd;
  servo.q_ref = used.q_ref;
  servo.v_ref = used.v_ref;
  servo.feed = VecX::Zero(tree.nv);
  if (run.references) servo.moving = &run.references;
  return servo;
}

// Whether steps are known whole only, by their polynomials: the branches of actuators in them are not kept.
bool has_branches(const Tree& tree) {
  const Elements& e = tree.elements;
  const auto any = [](const VecX& limits) { return limits.size() > 0 && limits.minCoeff() < kInfinity; };
  return e.servo_kp.size() > 0 && (any(e.servo_effort) || any(e.effort) || any(e.speed));
}

}  // namespace

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

double motion_size(const Tree& tree, const KeptRun& run) {
  double size = 0.0;
  for (std::size_t k = 1; k < run.recording.t.size(); ++k)
    size = std::max(size, configuration_distance(tree, configuration(tree, run, 0), configuration(tree, run, k)));
  return size;
}

double contact_time(const KeptRun& run) {
  const Segments& s = run.recording.segments;
  double sum = 0.0;
  for (std::size_t k = 0; k < s.t.size(); ++k)
    if (s.persistent[k] == Segments::kContactStep) sum += s.h[k];
  return sum;
}

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
      apart[k] = configuration_distance(tree, configuration(tree, other, others), configuration(tree, found, own));
    }
    return apart;
  }
  SegmentPaths paths(tree, options.stages, arrays_of(other.recording.segments));
  const std::vector<std::size_t> nodes =
      over_time ? nodes_over_time(t, both, times) : nodes_in_parts(t, both, times, paths);
  Guide guide(tree, arrays_of(other.recording.segments), impact_times(other.recording));
  Integrator integrator(tree, options.stages, options.tol, options.max_iterations, keeps_constraints(tree, options));
  Servo servo = servos_of(tree, other);
  integrator.set_servo(&servo);
  VecX apart(static_cast<Eigen::Index>(nodes.size())), q(tree.nq), p(tree.nv);
  for (std::size_t k = 0; k < nodes.size(); ++k) {
    const double time = t[nodes[k]];
    const Eigen::Index segment = paths.at(time);
    const double begin = paths.start(segment);
    q = paths.q(segment);
    p = paths.p(segment);
    if (servo.moving != nullptr) servo.refer(begin);
    const bool solved = !has_branches(tree) && !paths.persistent(segment) && paths.step_to(time) > 0.0 &&
                        advance_state(integrator, guide, begin, time - begin, q, p);
    const bool known = solved || paths.state(time, integrator, q, p);  // from the polynomial
    apart[static_cast<Eigen::Index>(k)] =
        known ? configuration_distance(tree, q, configuration(tree, found, nodes[k])) : kInfinity;
  }
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
  Servo servo = servos_of(tree, run);
  if ((!tree.has_damping && !tree.elements.any_force() && !servo.any) || has_branches(tree)) return 0.0;
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
  SegmentPaths paths(tree, options.stages, arrays_of(s));
  Guide guide(tree, arrays_of(s), impacts);
  Integrator integrator(tree, options.stages, options.tol, kMostIterations, keeps_constraints(tree, options));
  integrator.set_servo(&servo);
  VecX whole(tree.nq);
  double worst = 0.0;
  for (const std::size_t start : starts) {
    const Eigen::Index segment = static_cast<Eigen::Index>(start);
    if (start >= s.t.size() || paths.persistent(segment)) continue;
    const StepPath* path = paths.path(segment, integrator);
    if (path == nullptr) return kInfinity;
    VecX q = paths.q(segment), p = paths.p(segment);
    const double half = 0.5 * paths.length(segment), middle = paths.start(segment) + half;
    if (servo.moving != nullptr) servo.refer(middle - half);
    if (!advance_state(integrator, guide, middle - half, half, q, p) ||
        !advance_state(integrator, guide, middle, half, q, p))
      return kInfinity;
    path->configuration(1.0, whole);
    worst = std::max(worst, configuration_distance(tree, whole, q));
  }
  return worst;
}

}  // namespace contactvi
