#include "bindings/contact_results.hpp"

#include <nanobind/eigen/dense.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/shared_ptr.h>

#include <algorithm>

#include "model/coordinates.hpp"
#include "step/integrator.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

PublicGuard public_guard(const Scene& s, int guard) {
  if (guard < 0 || s.is_pair(guard)) return {GuardKind::kContact, guard};
  const JointLimit& limit = s.tree.limits[guard - s.pairs.size()];
  return {GuardKind::kLimit, 2 * limit.source_joint + (limit.upper ? 1 : 0)};
}

VecX public_momentum(const Tree& tree, const VecX& q, VecX p) {
  if (!tree.followers.empty()) Integrator(tree, 1, 1e-12, 1).complete_momentum(q, p);
  engine_to_public(tree, q, p);
  return p;
}

Dict impact_rows(const Scene& s, const std::vector<ImpactRecord>& impacts) {
  const Eigen::Index n = static_cast<Eigen::Index>(impacts.size());
  VecX time(n), impulse(n), gamma_minus(n), gamma_plus(n), G_c(n), gap(n), restitution(n), jump(n), before(n), after(n);
  VecX friction(n), loss(n);
  IntVec kind(n), index(n), iterations(n), step(n), method(n), fallback(n), points(n);
  Rows point(n, 3), normal(n, 3), impulse_vector(n, 3), q(n, s.tree.nq), p_minus(n, s.tree.nv), p_plus(n, s.tree.nv);
  for (Eigen::Index i = 0; i < n; ++i) {
    const ImpactRecord& r = impacts[i];
    const PublicGuard guard = public_guard(s, r.guard);
    kind[i] = static_cast<int>(guard.kind);
    index[i] = guard.index;
    time[i] = r.time;
    impulse[i] = r.impulse;
    gamma_minus[i] = r.gamma_minus;
    gamma_plus[i] = r.gamma_plus;
    G_c[i] = r.G_c;
    gap[i] = r.gap;
    restitution[i] = r.restitution;
    friction[i] = r.friction;
    loss[i] = r.loss;
    points[i] = r.points;
    impulse_vector.row(i) = r.impulse_vector;
    iterations[i] = r.iterations;
    step[i] = r.step;
    method[i] = static_cast<int>(r.method);
    fallback[i] = static_cast<int>(r.fallback);
    jump[i] = r.jump;
    before[i] = r.before;
    after[i] = r.after;
    point.row(i) = r.point;
    normal.row(i) = r.normal;
    q.row(i) = r.q;
    p_minus.row(i) = public_momentum(s.tree, r.q, r.p_minus);
    p_plus.row(i) = public_momentum(s.tree, r.q, r.p_plus);
  }
  Dict d;
  d["time"] = hand_over(std::move(time));
  d["kind"] = kind;
  d["index"] = index;
  d["point"] = hand_over(std::move(point));
  d["normal"] = hand_over(std::move(normal));
  d["impulse"] = hand_over(std::move(impulse));
  d["gamma_minus"] = hand_over(std::move(gamma_minus));
  d["gamma_plus"] = hand_over(std::move(gamma_plus));
  d["G_c"] = hand_over(std::move(G_c));
  d["gap"] = hand_over(std::move(gap));
  d["restitution"] = hand_over(std::move(restitution));
  d["friction"] = hand_over(std::move(friction));
  d["loss"] = hand_over(std::move(loss));
  d["points"] = points;
  d["impulse_vector"] = hand_over(std::move(impulse_vector));
  d["iterations"] = iterations;
  d["step"] = step;
  d["method"] = method;
  d["fallback"] = fallback;
  d["jump"] = hand_over(std::move(jump));
  d["before"] = hand_over(std::move(before));
  d["after"] = hand_over(std::move(after));
  d["q"] = hand_over(std::move(q));
  d["p_minus"] = hand_over(std::move(p_minus));
  d["p_plus"] = hand_over(std::move(p_plus));
  return d;
}

std::optional<Dict> contact_rows(const Scene& s, const std::vector<ContactRow>& rows) {
  const auto n = static_cast<Eigen::Index>(rows.size());
  if (n == 0) return std::nullopt;
  IntVec kind(n), index(n), point(n), mode(n), dense(n), step(n);
  VecX t(n), h(n), gap(n), work(n);
  Rows position(n, 3), normal(n, 3), start(n, 3), end(n, 3), slip(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const ContactRow& row = rows[static_cast<std::size_t>(i)];
    const PublicGuard guard = public_guard(s, row.guard);
    kind[i] = static_cast<int>(guard.kind);
    index[i] = guard.index;
    point[i] = row.point;
    mode[i] = static_cast<int>(row.mode);
    dense[i] = row.dense ? 1 : 0;
    step[i] = row.step;
    t[i] = row.t;
    h[i] = row.h;
    gap[i] = row.gap;
    work[i] = row.work;
    position.row(i) = row.position;
    normal.row(i) = row.normal;
    start.row(i) = row.position_impulse;
    end.row(i) = row.velocity_impulse;
    slip.row(i) = row.slip;
  }
  Dict d;
  d["kind"] = kind;
  d["index"] = index;
  d["point"] = point;
  d["mode"] = mode;
  d["dense"] = dense;
  d["step"] = step;
  d["t"] = hand_over(std::move(t));
  d["h"] = hand_over(std::move(h));
  d["gap"] = hand_over(std::move(gap));
  d["position"] = hand_over(std::move(position));
  d["normal"] = hand_over(std::move(normal));
  d["start"] = hand_over(std::move(start));
  d["end"] = hand_over(std::move(end));
  d["slip"] = hand_over(std::move(slip));
  d["work"] = hand_over(std::move(work));
  return d;
}

std::optional<nb::list> still_contacts(const std::vector<StillContacts>& spans) {
  if (spans.empty()) return std::nullopt;
  nb::list found;
  for (const StillContacts& span : spans)
    found.append(nb::make_tuple(span.rows, span.first, span.count, span.start_time, span.dt, span.length));
  return found;
}

void expose_still_rows(nb::module_& m) {
  nb::class_<StillRows>(m, "StillRows", "Contacts of what lies still, the same in every step of a span.")
      .def(
          "columns", [](const StillRows& still, const Scene& scene) { return contact_rows(scene, still.rows); },
          "scene"_a, "Return the columns of one step; its start, length and number are of no account.")
      .def("__len__", [](const StillRows& still) { return still.rows.size(); });
}

std::optional<Dict> contact_changes(const Scene& s, const std::vector<ChangeRecord>& changes) {
  const Eigen::Index n = static_cast<Eigen::Index>(changes.size());
  if (n == 0) return std::nullopt;
  VecX time(n), value(n);
  IntVec kind(n), index(n), point(n), change(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const ChangeRecord& c = changes[i];
    const PublicGuard guard = public_guard(s, c.guard);
    kind[i] = static_cast<int>(guard.kind);
    index[i] = guard.index;
    time[i] = c.time;
    value[i] = c.value;
    point[i] = c.point;
    change[i] = static_cast<int>(c.change);
  }
  Dict d;
  d["time"] = hand_over(std::move(time));
  d["kind"] = kind;
  d["index"] = index;
  d["point"] = point;
  d["change"] = change;
  d["value"] = hand_over(std::move(value));
  return d;
}

std::optional<Dict> step_phases(Recording& recording) {
  const std::size_t n = recording.phase_t.size();
  if (n == 0) return std::nullopt;
  IntVec persistent(n);
  for (std::size_t i = 0; i < n; ++i) persistent[i] = recording.phase_kind[i];
  Dict d;
  d["t"] = hand_over(std::move(recording.phase_t));
  d["dt"] = hand_over(std::move(recording.phase_dt));
  d["persistent"] = persistent;
  return d;
}

namespace {

// Number of Pinocchio's joint that this joint of the engine is, or is a part of.
int source_of(const Tree& tree, int joint) {
  const std::vector<int>& bodies = tree.body_of_source;
  return static_cast<int>(std::find_if(bodies.begin(), bodies.end(), [joint](int b) { return b >= joint; }) -
                          bodies.begin());
}

}  // namespace

std::optional<Dict> dense_steps(const Scene& s, const Recording& recording) {
  const std::size_t n = recording.dense.size();
  if (n == 0) return std::nullopt;
  using Field = double DenseRecord::*;
  const std::pair<const char*, Field> fields[] = {{"t", &DenseRecord::time},
                                                  {"h", &DenseRecord::h},
                                                  {"residual", &DenseRecord::residual},
                                                  {"gap", &DenseRecord::gap},
                                                  {"energy_rise", &DenseRecord::energy_rise},
                                                  {"energy_loss", &DenseRecord::energy_loss},
                                                  {"energy_error", &DenseRecord::energy_error}};
  Dict d;
  for (const auto& [name, field] : fields) {
    std::vector<double> values(n);
    for (std::size_t i = 0; i < n; ++i) values[i] = recording.dense[i].*field;
    d[name] = hand_over(std::move(values));
  }
  IntVec contacts(n), repaired(n), step(n), island(n);
  for (std::size_t i = 0; i < n; ++i) {
    contacts[i] = recording.dense[i].contacts;
    repaired[i] = recording.dense[i].repaired;
    step[i] = static_cast<int>(recording.dense[i].step);
    island[i] = source_of(s.tree, recording.dense[i].island);
  }
  d["island"] = island;
  d["contacts"] = contacts;
  d["repaired"] = repaired;
  d["step"] = step;
  return d;
}

void add_contact_stats(const EngineCounters& counters, const RunState& state, nb::dict& d) {
  const ContactStepCounters& c = counters.contact;
  d["contact_steps"] = c.steps;
  d["contact_iterations"] = c.contact_iterations;
  d["cone_problems"] = c.problems;
  d["cone_iterations"] = c.iterations;
  d["cone_fallbacks"] = c.fallbacks;
  d["contact_seconds"] = state.contact_seconds;
  d["dense_steps"] = state.dense_steps;
  const DenseStepCounters& dense = counters.dense;
  d["dense_passes"] = dense.passes;
  d["dense_problems"] = dense.problems;
  d["dense_sweeps"] = dense.sweeps;
  d["dense_factorizations"] = dense.factorizations;
  d["dense_gap_iterations"] = dense.gap_iterations;
}

}  // namespace contactvi
