#include "run/runs_apart.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "base/disjoint_sets.hpp"
#include "run/part_records.hpp"
#include "run/states_between.hpp"

namespace contactvi {

namespace {
constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Looks at one pair of geometries. Each leads on by a good part of their distance, so that those of a pair that comes
// no nearer than `near` are few, unless it stays about that near for long: then it counts as one that meets.
constexpr int kMostLooks = 2000;
// Of `near`: what two geometries are certain to stay apart by between two looks.
constexpr double kCertain = 0.5;
// A distance of bounding balls above this part of their radii together leads far enough; below it the exact one is
// found.
constexpr double kFar = 0.5;

// Where the geometries of a part are in its run, and how far they have moved at most.
class PartMotion {
 public:
  PartMotion(const SubScene& part, const SimulatorOptions& options, const KeptRun& run)
      : part_(&part),
        run_(&run),
        guards_(part.scene),
        integrator_(part.scene.tree, options.stages, options.tol, options.max_iterations,
                    keeps_constraints(part.scene.tree, options)),
        paths_(part.scene.tree, options.stages, arrays_of(run.recording.segments)),
        geometries_(part.geometries.size()),
        low_(geometries_, Vec3::Constant(kInfinity)),
        high_(geometries_, Vec3::Constant(-kInfinity)),
        q_(part.scene.tree.nq) {
    travel();
  }

  double start() const { return run_->recording.t.front(); }
  double end() const { return run_->recording.t.back(); }
  const Vec3& low(int geometry) const { return low_[static_cast<std::size_t>(geometry)]; }
  const Vec3& high(int geometry) const { return high_[static_cast<std::size_t>(geometry)]; }
  Eigen::Index segment(double time) const { return paths_.at(time); }
  // Where the next one begins [s].
  double bend(Eigen::Index segment) const {
    return segment + 1 < paths_.count() ? paths_.start(segment + 1) : kInfinity;
  }
  // A bound on how far any point of a geometry has moved since the start, up to a time in a segment [m].
  double odometer(int geometry, double time, Eigen::Index segment) const {
    const std::size_t at = static_cast<std::size_t>(segment) * geometries_ + static_cast<std::size_t>(geometry);
    const double x = std::clamp((time - paths_.start(segment)) / paths_.length(segment), 0.0, 1.0);
    return odometers_[at] + x * (odometers_[at + geometries_] - odometers_[at]);
  }
  // The center of the bounding ball at the start of a segment, and how far it can have moved since, up to a time.
  const Vec3& center(int geometry, Eigen::Index segment) const {
    return centers_[static_cast<std::size_t>(segment) * geometries_ + static_cast<std::size_t>(geometry)];
  }
  double moved(int geometry, double time, Eigen::Index segment) const {
    return odometer(geometry, time, segment) - odometer(geometry, paths_.start(segment), segment);
  }
  // Enters the configuration at a time in that of the whole scene.
  bool place(double time, VecX& whole) {
    const Eigen::Index segment = paths_.at(time);
    const StepPath* path = paths_.path(segment, integrator_);
    if (path == nullptr) return false;
    path->configuration(std::clamp((time - paths_.start(segment)) / paths_.length(segment), 0.0, 1.0), q_);
    for (std::size_t i = 0; i < part_->q.size(); ++i) whole[part_->q[i]] = q_[static_cast<Eigen::Index>(i)];
    return true;
  }

 private:
  // Finds the odometers at the ends of all segments, and boxes that contain all that the geometries pass through.
  void travel() {
    const std::vector<Geometry>& all = part_->scene.geometries;
    odometers_.assign((static_cast<std::size_t>(paths_.count()) + 1) * geometries_, 0.0);
    centers_.assign(odometers_.size(), Vec3::Zero());
    VecX bound(part_->scene.tree.nv);
    for (Eigen::Index k = 0; k < paths_.count(); ++k) {
      const StepPath* path = paths_.path(k, integrator_);
      const std::size_t at = static_cast<std::size_t>(k) * geometries_;
      if (path != nullptr) {
        path->bound(bound);
        guards_.bound_motion(paths_.q(k), bound, paths_.length(k));
        guards_.place(paths_.q(k));
      }
      const Placements* placed = path != nullptr ? &guards_.placements() : nullptr;
      for (std::size_t g = 0; g < geometries_; ++g) {
        const double motion = placed != nullptr ? guards_.motion_of_geometry(static_cast<int>(g)) : kInfinity;
        odometers_[at + geometries_ + g] = odometers_[at + g] + motion;
        if (all[g].body < 0) continue;
        Vec3& center = centers_[at + g];
        center = placed == nullptr ? Vec3::Zero().eval()
                                   : Vec3(placed->p_W[all[g].body] + placed->R_W[all[g].body] * all[g].center_B);
        const Vec3 reach = Vec3::Constant(motion + (all[g].unbounded ? kInfinity : all[g].radius));
        low_[g] = low_[g].cwiseMin(center - reach);
        high_[g] = high_[g].cwiseMax(center + reach);
      }
    }
  }

  const SubScene* part_;
  const KeptRun* run_;
  Guards guards_;
  Integrator integrator_;
  SegmentPaths paths_;
  std::size_t geometries_;
  // At the starts of the segments and at the end, geometry by geometry; centers: of the bounding balls.
  std::vector<double> odometers_;
  std::vector<Vec3> centers_;
  std::vector<Vec3> low_, high_;
  VecX q_;
};

// A geometry of a part.
struct Traveller {
  PartMotion* motion;
  int geometry;  // in the part

  bool may_cross(const Traveller& other) const {
    const Vec3 apart = (motion->low(geometry) - other.motion->high(other.geometry))
                           .cwiseMax(other.motion->low(other.geometry) - motion->high(geometry));
    return !(apart.maxCoeff() > 0.0);
  }
};

class Meeting {
 public:
  Meeting(const Scene& whole, double near)
      : whole_(&whole), guards_(whole), near_(near), q_(VecX::Zero(whole.tree.nq)) {}

  // Whether the two geometries of a pair may have come nearer than `near`.
  bool may_be(int guard, const Traveller& a, const Traveller& b) {
    const double end = std::min(a.motion->end(), b.motion->end());
    double t = a.motion->start();
    for (int looks = 0; t < end; ++looks) {
      const double distance = looks < kMostLooks ? distance_at(guard, a, b, t) : -kInfinity;
      if (!(distance > near_)) return true;
      const double next = when_moved(a, b, t, distance - kCertain * near_, end);
      if (!(next > t)) return true;
      t = next;
    }
    return false;
  }

 private:
  // A lower bound on the distance at a time, that of the bounding balls where it is large, else the distance.
  double distance_at(int guard, const Traveller& a, const Traveller& b, double t) {
    const Pair& pair = whole_->pairs[static_cast<std::size_t>(guard)];
    const auto radius = [&](int g) {
      const Geometry& geometry = whole_->geometries[static_cast<std::size_t>(g)];
      return geometry.unbounded ? kInfinity : geometry.radius;
    };
    const double radii = radius(pair.a) + radius(pair.b);
    const Eigen::Index ka = a.motion->segment(t), kb = b.motion->segment(t);
    const double apart = (a.motion->center(a.geometry, ka) - b.motion->center(b.geometry, kb)).norm() - radii -
                         a.motion->moved(a.geometry, t, ka) - b.motion->moved(b.geometry, t, kb);
    if (apart > kFar * radii) return apart;
    if (!a.motion->place(t, q_) || !b.motion->place(t, q_)) return -kInfinity;
    guards_.place(q_);
    const Placements& at = guards_.placements(guard);
    const auto center = [&](int g) {
      const Geometry& geometry = whole_->geometries[static_cast<std::size_t>(g)];
      return Vec3(at.p_W[geometry.body] + at.R_W[geometry.body] * geometry.center_B);
    };
    const double balls = (center(pair.a) - center(pair.b)).norm() - radii;
    if (balls > kFar * radii) return balls;
    Contact contact;
    return guards_.evaluate_witness(guard, contact);
  }

  // The time after t at which both together have moved by a distance, at the latest the end.
  static double when_moved(const Traveller& a, const Traveller& b, double t, double distance, double end) {
    Eigen::Index ka = a.motion->segment(t), kb = b.motion->segment(t);
    const auto moved = [&](double time) {
      return a.motion->odometer(a.geometry, time, ka) + b.motion->odometer(b.geometry, time, kb);
    };
    const double goal = moved(t) + distance;
    while (t < end) {
      const double bend = std::min({a.motion->bend(ka), b.motion->bend(kb), end});
      const double here = moved(t), there = moved(bend);
      if (!(there < goal)) return there > here ? std::min(bend, t + (bend - t) * (goal - here) / (there - here)) : t;
      t = bend;
      if (a.motion->bend(ka) <= bend) ++ka;
      if (b.motion->bend(kb) <= bend) ++kb;
    }
    return end;
  }

  const Scene* whole_;
  Guards guards_;
  double near_;
  VecX q_;
};

// The values of a run that are sums since its start, in proportion between its nodes.
class Sums {
 public:
  // width: numbers of a node. mean: the values are means since the node before, of which the sums are made.
  Sums(const std::vector<double>& t, const std::vector<double>& values, std::size_t width, bool mean)
      : t_(&t), width_(width), known_(values.size() == width * t.size()) {
    if (!known_ || width == 0) return;
    sums_ = values;
    if (!mean) return;
    std::fill(sums_.begin(), sums_.begin() + static_cast<std::ptrdiff_t>(width), 0.0);
    for (std::size_t k = 1; k < t.size(); ++k)
      for (std::size_t i = 0; i < width; ++i)
        sums_[k * width + i] = sums_[(k - 1) * width + i] + values[k * width + i] * (t[k] - t[k - 1]);
  }

  bool known() const { return known_ && width_ > 0; }
  double at(double time, std::size_t i) const {
    const std::vector<double>& t = *t_;
    const std::size_t k = static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(
        std::lower_bound(t.begin(), t.end(), time) - t.begin(), 0, static_cast<std::ptrdiff_t>(t.size()) - 1));
    if (k == 0) return sums_[i];
    const double x = std::clamp((time - t[k - 1]) / (t[k] - t[k - 1]), 0.0, 1.0), before = sums_[(k - 1) * width_ + i];
    return x == 1.0 ? sums_[k * width_ + i] : before + x * (sums_[k * width_ + i] - before);
  }

 private:
  const std::vector<double>* t_;
  std::size_t width_;
  bool known_;
  std::vector<double> sums_;
};

// Runs of parts on the way to one run.
class Joining {
 public:
  Joining(const Scene& whole, const SimulatorOptions& options, const std::vector<PartRun>& runs, std::size_t leader)
      : whole_(&whole),
        options_(&options),
        runs_(&runs),
        leader_(leader),
        q_(VecX::Zero(whole.tree.nq)),
        p_(VecX::Zero(whole.tree.nv)) {
    for (const PartRun& own : runs) {
      states_.push_back(std::make_unique<StatesBetween>(own.part->scene, options, *own.run));
      end_ = std::min(end_, own.run->recording.t.back());
    }
  }

  KeptRun run() {
    set_nodes();
    set_work();
    set_events();
    set_phases();
    set_counts();
    return std::move(found_);
  }

 private:
  struct Entry {
    double time;
    std::size_t part, row;
  };

  // Enters the state of a part at a time in q_ and p_.
  void gather(std::size_t k, double time) {
    const PartRun& own = (*runs_)[k];
    const Recording& r = own.run->recording;
    const Tree& tree = own.part->scene.tree;
    const std::size_t nq = static_cast<std::size_t>(tree.nq), nv = static_cast<std::size_t>(tree.nv);
    const std::size_t node = static_cast<std::size_t>(std::lower_bound(r.t.begin(), r.t.end(), time) - r.t.begin());
    part_q_.resize(tree.nq);
    part_p_.resize(tree.nv);
    if (node == r.t.size() || r.t[node] == time || r.segments.t.empty() || !states_[k]->state(time, part_q_, part_p_)) {
      const std::size_t at = std::min(node, r.t.size() - 1);
      part_q_ = Eigen::Map<const VecX>(r.q.data() + at * nq, tree.nq);
      part_p_ = Eigen::Map<const VecX>(r.p.data() + at * nv, tree.nv);
    }
    for (std::size_t i = 0; i < nq; ++i) q_[own.part->q[i]] = part_q_[static_cast<Eigen::Index>(i)];
    for (std::size_t i = 0; i < nv; ++i) p_[own.part->v[i]] = part_p_[static_cast<Eigen::Index>(i)];
  }

  void set_nodes() {
    Recording& to = found_.recording;
    for (double t : (*runs_)[leader_].run->recording.t)
      if (t < end_) to.t.push_back(t);
    to.t.push_back(end_);
    for (double t : to.t) {
      for (std::size_t k = 0; k < runs_->size(); ++k) gather(k, t);
      to.q.insert(to.q.end(), q_.data(), q_.data() + q_.size());
      to.p.insert(to.p.end(), p_.data(), p_.data() + p_.size());
    }
    const Recording& from = (*runs_)[leader_].run->recording;
    to.adaptive_t = from.adaptive_t;
    to.adaptive_dt = from.adaptive_dt;
  }

  void set_work() {
    constexpr std::size_t kWorks = 4;
    Recording& to = found_.recording;
    const std::size_t n = to.t.size(), rows = static_cast<std::size_t>(whole_->tree.elements.constraint_rows) +
                                              whole_->tree.followers.size();
    to.work.assign(kWorks * n, 0.0);
    to.reactions.assign(rows * n, 0.0);
    for (const PartRun& own : *runs_) {
      const Recording& from = own.run->recording;
      const std::vector<int>& numbers = own.part->reactions;
      const Sums work(from.t, from.work, kWorks, false), reactions(from.t, from.reactions, numbers.size(), true);
      for (std::size_t k = 0; k < n && work.known(); ++k)
        for (std::size_t i = 0; i < kWorks; ++i) to.work[kWorks * k + i] += work.at(to.t[k], i);
      for (std::size_t k = 1; k < n && reactions.known(); ++k)
        for (std::size_t i = 0; i < numbers.size(); ++i)
          to.reactions[rows * k + static_cast<std::size_t>(numbers[i])] =
              (reactions.at(to.t[k], i) - reactions.at(to.t[k - 1], i)) / (to.t[k] - to.t[k - 1]);
    }
  }

  // Calls put(entry) for what all parts have recorded of a kind up to the end, in the order of time.
  template <class Count, class Time, class Put>
  void merge(Count count, Time time, Put put) {
    std::vector<Entry> entries;
    for (std::size_t k = 0; k < runs_->size(); ++k) {
      const Recording& r = (*runs_)[k].run->recording;
      for (std::size_t row = 0; row < count(r); ++row)
        if (time(r, row) <= end_) entries.push_back({time(r, row), k, row});
    }
    std::stable_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.time < b.time; });
    for (const Entry& entry : entries) put(*(*runs_)[entry.part].part, (*runs_)[entry.part].run->recording, entry);
  }

  void set_events() {
    Recording& to = found_.recording;
    merge([](const Recording& r) { return r.impacts.size(); },
          [](const Recording& r, std::size_t i) { return r.impacts[i].time; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            for (std::size_t k = 0; k < runs_->size(); ++k)
              if (k != entry.part) gather(k, entry.time);
            append_impact(part, r.impacts[entry.row], q_, p_, to.impacts);
          });
    merge([](const Recording& r) { return r.contacts.t.size(); },
          [](const Recording& r, std::size_t i) { return r.contacts.t[i]; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            append_contact(part, r.contacts, entry.row, to.contacts);
          });
    merge([](const Recording& r) { return r.changes.size(); },
          [](const Recording& r, std::size_t i) { return r.changes[i].time; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            append_change(part, r.changes[entry.row], to.changes);
          });
    merge([](const Recording& r) { return r.dense.size(); },
          [](const Recording& r, std::size_t i) { return r.dense[i].time; },
          [&](const SubScene& part, const Recording& r, const Entry& entry) {
            append_dense(part, r.dense[entry.row], to.dense);
          });
  }

  // The kind of the steps is at all times the highest one of a part.
  void set_phases() {
    struct Now {
      int kind;
      double dt;
    };
    const int free = static_cast<int>(StepKind::kFree);
    std::vector<Now> now(runs_->size(), {free, options_->dt});
    merge([](const Recording& r) { return r.phase_t.size(); },
          [](const Recording& r, std::size_t i) { return r.phase_t[i]; },
          [&](const SubScene&, const Recording& r, const Entry& entry) {
            now[entry.part] = {r.phase_kind[entry.row], r.phase_dt[entry.row]};
            const auto highest =
                std::max_element(now.begin(), now.end(), [](const Now& a, const Now& b) { return a.kind < b.kind; });
            Recording& to = found_.recording;
            if (!to.phase_t.empty() && to.phase_t.back() == entry.time) {  // several at one time
              to.phase_kind.back() = highest->kind;
              to.phase_dt.back() = highest->dt;
            } else {
              to.enter_phase(entry.time, highest->dt, static_cast<StepKind>(highest->kind), options_->dt);
            }
          });
  }

  void set_counts() {
    RunState& to = found_.state;
    for (const PartRun& own : *runs_) {
      const RunState& from = own.run->state;
      to.step += from.step;
      to.impacts += from.impacts;
      to.rejected += from.rejected;
      to.dense_steps += from.dense_steps;
      to.control.halved += from.control.halved;
      to.actuators.saturated += from.actuators.saturated;
      to.switches.located += from.switches.located;
      to.switches.jumps += from.switches.jumps;
      to.switches.held += from.switches.held;
      to.contact_seconds += from.contact_seconds;
      sum_up(own.run->counters, found_.counters);
      found_.seconds += own.run->seconds;
    }
    found_.status = (*runs_)[leader_].run->status;
    found_.status.time = end_;
  }

  const Scene* whole_;
  const SimulatorOptions* options_;
  const std::vector<PartRun>* runs_;
  std::size_t leader_;  // the part with the nodes
  std::vector<std::unique_ptr<StatesBetween>> states_;
  double end_ = kInfinity;
  VecX q_, p_, part_q_, part_p_;
  KeptRun found_;
};

}  // namespace

std::vector<std::pair<int, int>> meetings(const Scene& whole, const StaticTrees& trees, const SimulatorOptions& options,
                                          const std::vector<PartRun>& runs, double near) {
  std::vector<std::unique_ptr<PartMotion>> motions;
  std::vector<int> part_of(whole.geometries.size(), -1), number(whole.geometries.size(), -1);
  for (std::size_t k = 0; k < runs.size(); ++k) {
    motions.push_back(std::make_unique<PartMotion>(*runs[k].part, options, *runs[k].run));
    const std::vector<int>& geometries = runs[k].part->geometries;
    for (std::size_t i = 0; i < geometries.size(); ++i) {
      if (trees.of_geometry(geometries[i]) < 0) continue;  // fixed to the world
      part_of[static_cast<std::size_t>(geometries[i])] = static_cast<int>(k);
      number[static_cast<std::size_t>(geometries[i])] = static_cast<int>(i);
    }
  }
  const auto traveller = [&](int g) {
    const std::size_t at = static_cast<std::size_t>(g);
    return Traveller{motions[static_cast<std::size_t>(part_of[at])].get(), number[at]};
  };
  Meeting meeting(whole, near);
  DisjointSets sets(static_cast<int>(runs.size()));
  std::vector<std::pair<int, int>> found;
  for (std::size_t k = 0; k < whole.pairs.size(); ++k) {
    const Pair& pair = whole.pairs[k];
    const int a = part_of[static_cast<std::size_t>(pair.a)], b = part_of[static_cast<std::size_t>(pair.b)];
    if (a < 0 || b < 0 || sets.joined(a, b)) continue;
    const Traveller first = traveller(pair.a), second = traveller(pair.b);
    if (!first.may_cross(second) || !meeting.may_be(static_cast<int>(k), first, second)) continue;
    sets.join(a, b);
    found.emplace_back(a, b);
  }
  return found;
}

KeptRun joined(const Scene& whole, const SimulatorOptions& options, const std::vector<PartRun>& runs,
               std::size_t leader) {
  return Joining(whole, options, runs, leader).run();
}

}  // namespace contactvi
