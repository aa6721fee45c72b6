#include "run/meetings.hpp"

#include <algorithm>
#include <cmath>
#include <memory>

#include "base/disjoint_sets.hpp"
#include "geometry/guard.hpp"
#include "step/segment_paths.hpp"

namespace contactvi {

namespace {
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

}  // namespace contactvi
