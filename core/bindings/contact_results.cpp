#include "bindings/contact_results.hpp"

#include <nanobind/eigen/dense.h>

#include "bindings/arrays.hpp"

namespace nb = nanobind;

namespace contactvi {

namespace {
using IntVec = Eigen::Matrix<std::int64_t, Eigen::Dynamic, 1>;
}

std::pair<int, int> public_guard(const Scene& s, int guard) {
  if (guard < 0) return {-1, -1};
  if (s.is_pair(guard)) return {0, guard};
  const JointLimit& limit = s.tree.limits[guard - s.pairs.size()];
  return {1, 2 * limit.source_joint + (limit.upper ? 1 : 0)};
}

nb::object contact_rows(const Scene& s, ContactRows& rows) {
  const std::size_t n = rows.t.size();
  if (n == 0) return nb::none();
  IntVec kind(n), index(n), point(n), mode(n), step(n);
  for (std::size_t i = 0; i < n; ++i) {
    std::tie(kind[i], index[i]) = public_guard(s, rows.guard[i]);
    point[i] = rows.point[i];
    mode[i] = rows.mode[i];
    step[i] = rows.step[i];
  }
  nb::dict d;
  d["kind"] = kind;
  d["index"] = index;
  d["point"] = point;
  d["mode"] = mode;
  d["step"] = step;
  d["t"] = hand_over(std::move(rows.t));
  d["h"] = hand_over(std::move(rows.h));
  d["gap"] = hand_over(std::move(rows.gap));
  d["position"] = hand_over(std::move(rows.position), n, 3);
  d["normal"] = hand_over(std::move(rows.normal), n, 3);
  d["start"] = hand_over(std::move(rows.position_impulse), n, 3);
  d["end"] = hand_over(std::move(rows.velocity_impulse), n, 3);
  d["slip"] = hand_over(std::move(rows.slip), n, 3);
  return d;
}

nb::object contact_changes(const Scene& s, const std::vector<ChangeRecord>& changes) {
  const Eigen::Index n = static_cast<Eigen::Index>(changes.size());
  if (n == 0) return nb::none();
  VecX time(n), value(n);
  IntVec kind(n), index(n), point(n), change(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const ChangeRecord& c = changes[i];
    std::tie(kind[i], index[i]) = public_guard(s, c.guard);
    time[i] = c.time;
    value[i] = c.value;
    point[i] = c.point;
    change[i] = static_cast<int>(c.change);
  }
  nb::dict d;
  d["time"] = hand_over(std::move(time));
  d["kind"] = kind;
  d["index"] = index;
  d["point"] = point;
  d["change"] = change;
  d["value"] = hand_over(std::move(value));
  return d;
}

nb::object step_phases(Recording& recording) {
  const std::size_t n = recording.phase_t.size();
  if (n == 0) return nb::none();
  IntVec persistent(n);
  for (std::size_t i = 0; i < n; ++i) persistent[i] = recording.phase_persistent[i];
  nb::dict d;
  d["t"] = hand_over(std::move(recording.phase_t));
  d["dt"] = hand_over(std::move(recording.phase_dt));
  d["held"] = persistent;
  return d;
}

void add_contact_stats(const Simulator& sim, nb::dict& d) {
  const ContactStepCounters& c = sim.contact_counters();
  d["held_steps"] = c.steps;
  d["contact_rounds"] = c.contact_iterations;
  d["cone_problems"] = c.problems;
  d["cone_iterations"] = c.iterations;
  d["cone_fallbacks"] = c.fallbacks;
  d["contact_seconds"] = sim.contact_seconds();
}

}  // namespace contactvi
