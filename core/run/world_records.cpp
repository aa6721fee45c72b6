// World: what the islands have recorded in an interval becomes the record of the world, in the order of time and in the
// numbers of the whole scene.
#include <algorithm>

#include "run/part_records.hpp"
#include "run/world.hpp"

namespace contactvi {

namespace {
// The N numbers of a circle or a sphere from i on, between two configurations at the fraction x.
template <int N>
void interpolate_unit(const VecX& q0, const VecX& q1, double x, int i, VecX& q) {
  const Eigen::Matrix<double, N, 1> a = q0.segment<N>(i), b = q1.segment<N>(i);
  const double share = a.dot(b) < 0.0 ? -x : x;
  q.segment<N>(i) = ((1.0 - x) * a + share * b).normalized();
}

// Between two configurations, at the fraction x: along each coordinate, normalised on circles and spheres.
void interpolate(const Tree& tree, const VecX& q0, const VecX& q1, double x, VecX& q) {
  q = (1.0 - x) * q0 + x * q1;
  for (const Joint& joint : tree.joints) {
    if (joint.nq == joint.nv) continue;
    if (joint.nq == 4)
      interpolate_unit<4>(q0, q1, x, joint.iq, q);
    else
      interpolate_unit<2>(q0, q1, x, joint.iq, q);
  }
}
}  // namespace

// Calls put(entry) for the entries of a kind of all islands in the order of time, those of one time in the order of the
// islands.
template <class Count, class Time, class Put>
void World::merge(Count count, Time time, Put put) {
  entries_.clear();
  for (Island* island : awake_)
    for (std::size_t row = 0; row < count(island->recording()); ++row)
      entries_.push_back({time(island->recording(), row), island, row});
  const auto earlier = [](const Entry& a, const Entry& b) { return a.time < b.time; };
  if (!std::is_sorted(entries_.begin(), entries_.end(), earlier))
    std::stable_sort(entries_.begin(), entries_.end(), earlier);
  for (const Entry& entry : entries_) put(entry);
}

// An impact with the state of the whole scene: of the bodies of other islands that between the ends of the interval,
// or, where it has to obey constraints, that at the end of a shorter step.
void World::add_impact(const Entry& entry, double t, double length, Recording& recording) {
  const ImpactRecord& impact = entry.island->recording().impacts[entry.row];
  const double x = length > 0.0 ? std::clamp((impact.time - t) / length, 0.0, 1.0) : 0.0;
  VecX q(state_.q.size()), p = (1.0 - x) * state_.p + x * p1_;
  interpolate(scene_->tree, state_.q, q1_, x, q);
  for (Island* island : awake_) {
    if (x == 0.0 || !island->constrained() || island == entry.island) continue;
    if (!graph_.measured()) tell_motion();  // the island makes a step more, which is not of the motion
    island->gather_at(state_.q, state_.p, state_.step, t, x * length, island_progress_, q, p);
  }
  append_impact(entry.island->numbers(), impact, q, p, recording.impacts);
}

// The kind of the world's steps is the highest one of its islands.
void World::merge_phases(double t, Recording& recording) {
  const auto free = [](Island* island) { return island->recording().phase_t.empty(); };
  int kind = static_cast<int>(still_.kind());
  const bool still_free = still_.kind() == StepKind::kFree;
  if (recording.phase_t.empty() && still_free && std::all_of(awake_.begin(), awake_.end(), free)) return;
  double begins = t, dt = still_free ? options_.dt : still_.kind_dt();
  for (Island* island : awake_) {
    const Recording& part = island->recording();
    for (std::size_t k = 0; k < part.phase_t.size(); ++k) {
      if (part.phase_kind[k] < kind || (part.phase_kind[k] == kind && part.phase_t[k] >= begins)) continue;
      kind = part.phase_kind[k];
      begins = part.phase_t[k];
      dt = part.phase_dt[k];
    }
  }
  if (kind == static_cast<int>(StepKind::kFree) && recording.phase_t.empty()) return;
  if (begins > t && !recording.phase_t.empty()) recording.enter_phase(t, options_.dt, StepKind::kFree, options_.dt);
  recording.enter_phase(begins, dt, static_cast<StepKind>(kind), options_.dt);
}

void World::merge_recordings(double t, double length, Recording& recording) {
  if (length > 0.0) still_.record(state_.step, state_.start_time, options_.dt, t, length, recording);
  if (std::none_of(awake_.begin(), awake_.end(), [](Island* island) { return island->recording().any_entry(); })) {
    merge_phases(t, recording);
    return;
  }
  merge([](const Recording& r) { return r.impacts.size(); },
        [](const Recording& r, std::size_t i) { return r.impacts[i].time; },
        [&](const Entry& entry) { add_impact(entry, t, length, recording); });
  merge([](const Recording& r) { return r.contacts.size(); },
        [](const Recording& r, std::size_t i) { return r.contacts[i].t; },
        [&](const Entry& entry) {
          append_contact(entry.island->numbers(), entry.island->recording().contacts[entry.row], recording.contacts);
        });
  merge([](const Recording& r) { return r.changes.size(); },
        [](const Recording& r, std::size_t i) { return r.changes[i].time; },
        [&](const Entry& entry) {
          append_change(entry.island->numbers(), entry.island->recording().changes[entry.row], recording.changes);
        });
  merge([](const Recording& r) { return r.dense.size(); },
        [](const Recording& r, std::size_t i) { return r.dense[i].time; },
        [&](const Entry& entry) {
          append_dense(entry.island->numbers(), entry.island->recording().dense[entry.row], recording.dense);
        });
  merge_phases(t, recording);
}

}  // namespace contactvi
