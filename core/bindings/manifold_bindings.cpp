// Contact points of a pair at one configuration, and the pairs that a sequence of steps looks at, for tests.
#include <nanobind/eigen/dense.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <limits>
#include <tuple>
#include <utility>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "bindings/user_calls.hpp"
#include "geometry/candidates.hpp"
#include "geometry/distance_bounds.hpp"
#include "geometry/guard.hpp"
#include "geometry/manifold.hpp"
#include "geometry/other_features.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

// A pair placed at a configuration, with its witness contact.
struct ManifoldTouch {
  ManifoldTouch(const Scene& scene, const VecX& q, int pair, int max_points)
      : at(scene.tree), guards(scene), manifolds(scene, max_points) {
    if (q.size() != scene.tree.nq) throw Error("expected shape (nq,)");
    if (pair < 0 || pair >= static_cast<int>(scene.pairs.size())) throw Error("there is no such pair");
    place(scene.tree, q, at);
    guards.place(q);
    guards.evaluate(pair, witness);
    scene.tree.elements.forget_failure();
    UserErrors::raise();
  }

  void evaluate(const ContactPoint& p, Contact& contact) const {
    contact = witness;
    if (p.kind != PointKind::kWitness) manifolds.evaluate(p, at, contact);
  }

  Placements at;
  Guards guards;
  Manifolds manifolds;
  Contact witness;
};

Dict describe(const ManifoldTouch& touch, const std::vector<ContactPoint>& points) {
  const auto n = static_cast<Eigen::Index>(points.size());
  std::vector<std::int64_t> feature;
  std::vector<PointKind> kind;
  std::vector<bool> material, valid;
  VecX gap(n);
  Rows a(n, 3), b(n, 3), normal(n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    const ContactPoint& p = points[i];
    Contact c;
    touch.evaluate(p, c);
    feature.push_back(p.feature);
    kind.push_back(p.kind);
    material.push_back(p.material);
    valid.push_back(touch.manifolds.valid(p, touch.at));
    gap[i] = c.gap;
    a.row(i) = c.point_a;
    b.row(i) = c.point_b;
    normal.row(i) = c.normal;
  }
  Dict d;
  d["kind"] = kind;
  d["feature"] = feature;
  d["material"] = material;
  d["valid"] = valid;
  d["gap"] = hand_over(std::move(gap));
  d["point_a"] = hand_over(std::move(a));
  d["point_b"] = hand_over(std::move(b));
  d["normal"] = hand_over(std::move(normal));
  return d;
}

Dict contact_points(const Scene& s, const VecX& q, int pair, double margin, int max_points) {
  ManifoldTouch touch(s, q, pair, max_points);
  std::vector<ContactPoint> points;
  touch.manifolds.find(pair, touch.at, touch.witness, margin, points);
  return describe(touch, points);
}

std::vector<ContactPoint> points_of(const ManifoldTouch& touch, int pair, const std::vector<std::int64_t>& features) {
  std::vector<ContactPoint> points;
  for (std::int64_t f : features) points.push_back(touch.manifolds.point(pair, touch.at, touch.witness, f));
  return points;
}

Dict points_of_features(const Scene& s, const VecX& q, int pair, const std::vector<std::int64_t>& features) {
  ManifoldTouch touch(s, q, pair, 4);
  return describe(touch, points_of(touch, pair, features));
}

std::tuple<double, double, Vec3, Vec3> rest_gap(const Scene& s, const VecX& q, int pair,
                                                const std::vector<std::int64_t>& features, int max_points,
                                                double enough) {
  ManifoldTouch touch(s, q, pair, max_points);
  const std::vector<ContactPoint> points = points_of(touch, pair, features);
  std::vector<const ContactPoint*> persistent;
  for (const ContactPoint& p : points) persistent.push_back(&p);
  Contact c{};
  const double gap = touch.manifolds.next_gap(pair, touch.at, persistent.data(), static_cast<int>(persistent.size()),
                                              &touch.witness, enough, c);
  return {gap, c.gap, c.normal, 0.5 * (c.point_a + c.point_b)};
}

// Whether the pair is known to be no deeper than these points, and coal's gap less theirs.
std::pair<bool, double> none_deeper(const Scene& s, const VecX& q, int pair, const std::vector<std::int64_t>& features,
                                    int max_points) {
  ManifoldTouch touch(s, q, pair, max_points);
  const std::vector<ContactPoint> points = points_of(touch, pair, features);
  std::vector<const ContactPoint*> persistent;
  double least = 0.0;
  for (const ContactPoint& p : points) {
    persistent.push_back(&p);
    Contact c{};
    touch.manifolds.evaluate(p, touch.at, c);
    least = std::min(least, c.gap);
  }
  const bool known = touch.manifolds.none_deeper(pair, touch.at, persistent.data(), static_cast<int>(points.size()));
  return {known, touch.witness.gap - least};
}

std::tuple<double, bool, double> rest_behind(const Scene& s, const VecX& q, int pair,
                                             const std::vector<std::int64_t>& features, double per_distance,
                                             double slack) {
  ManifoldTouch touch(s, q, pair, 4);
  const std::vector<ContactPoint> points = points_of(touch, pair, features);
  std::vector<const ContactPoint*> persistent;
  for (const ContactPoint& p : points) persistent.push_back(&p);
  const int count = static_cast<int>(points.size());
  const double crossing = touch.manifolds.crossing_of(pair, touch.at, persistent.data(), count);
  Contact c{};
  const bool nearest = touch.manifolds.nearest_of_points(pair, touch.at, persistent.data(), count, c);
  return {
      crossing,
      crossing > 0.0 && touch.manifolds.others_behind(pair, touch.at, persistent.data(), count, {per_distance, slack}),
      nearest ? c.gap : std::numeric_limits<double>::quiet_NaN()};
}

// Per direction, (k, 3), the farthest vertex, and the vertices that miss it by at most the depth.
std::vector<std::pair<int, std::vector<int>>> far_vertices(const std::vector<Vec3>& vertices, const Rows& directions,
                                                           double depth) {
  if (directions.cols() != 3) throw Error("expected shape (k, 3)");
  const VertexTree tree(vertices);
  if (tree.none()) return {};
  std::vector<std::pair<int, std::vector<int>>> found;
  for (Eigen::Index k = 0; k < directions.rows(); ++k) {
    const Vec3 m = directions.row(k);
    const int farthest = tree.farthest(m);
    const double least = m.dot(vertices[farthest]) - depth;
    found.emplace_back(farthest, std::vector<int>());
    tree.each(
        m, [&](const VertexTree::Bound& bound) { return bound.reach(m) >= least; },
        [&](int i) {
          if (m.dot(vertices[i]) >= least) found.back().second.push_back(i);
        });
    std::sort(found.back().second.begin(), found.back().second.end());
  }
  return found;
}

double nearest_gap(const Scene& s, const VecX& q, int pair) {
  ManifoldTouch touch(s, q, pair, 4);
  Contact c{};
  return touch.manifolds.nearest(pair, touch.at, c) ? c.gap : std::numeric_limits<double>::quiet_NaN();
}

// A sharp shape of a scene as placed.
PosedShape posed(const Geometry& g, const Placements& at) {
  const Pose body = pose_of(g.body, at);
  return {g.sharp.get(), body.R * g.R_BG, body.point(g.p_BG)};
}

// In rows, of two sharp shapes whose distance was evaluated at `known`, at each of these places: a lower bound, the
// distance, an upper bound.
Rows distance_bounds(const Scene& s, const VecX& known, const Rows& places, int a, int b) {
  if (known.size() != s.tree.nq || places.cols() != s.tree.nq) throw Error("expected shapes (nq,) and (N, nq)");
  ShapeDistance distance;
  DistanceBounds bounds(1);
  Placements at(s.tree);
  Contact contact{};
  const auto evaluate = [&](const PosedShape& x, const PosedShape& y) {
    distance.evaluate(*x.shape, x.R, x.p, *y.shape, y.R, y.p, contact);
    return contact.gap;
  };
  place(s.tree, known, at);
  const PosedShape first = posed(s.geometries.at(a), at), second = posed(s.geometries.at(b), at);
  evaluate(first, second);
  bounds.keep(0, first, second, contact);
  Rows found(places.rows(), 3);
  for (Eigen::Index k = 0; k < places.rows(); ++k) {
    place(s.tree, VecX(places.row(k)), at);
    const PosedShape x = posed(s.geometries.at(a), at), y = posed(s.geometries.at(b), at);
    const DistanceBounds::Bounds bound = bounds.find(0, x, y);
    found.row(k) << bound.lower, evaluate(x, y), bound.upper;
  }
  return found;
}

// Whether a gap is larger at the end of the step than the motion in it, as the event search finds out.
bool stays_open(Guards& guards, int guard) {
  Contact contact{};
  if (guards.skip(guard) || guards.separated_at_end(guard)) return true;
  const double gap = guards.evaluate(guard, contact);
  if (!(gap > guards.motion(guard))) return false;
  guards.mark(guard, gap);
  return true;
}

std::vector<std::tuple<std::vector<int>, VecX, bool>> near_pairs(const Scene& s, const Rows& start, const Rows& end,
                                                                 const Rows& bound, double h, bool spans) {
  if (start.cols() != s.tree.nq || end.cols() != s.tree.nq || bound.cols() != s.tree.nv || start.rows() != end.rows() ||
      start.rows() != bound.rows())
    throw Error("expected shapes (N, nq), (N, nq) and (N, nv)");
  Guards guards(s), step(s);
  std::vector<std::tuple<std::vector<int>, VecX, bool>> found;
  for (Eigen::Index k = 0; k < bound.rows(); ++k) {
    const VecX q0 = start.row(k), q1 = end.row(k), most = bound.row(k);
    if (k > 0 && start.row(k) != end.row(k - 1)) {  // the step before was cut
      guards.end_span();
      for (int g : std::get<0>(found.back())) guards.unmark(g);
    }
    step.bound_motion(q0, most, h);
    VecX motion(static_cast<Eigen::Index>(s.pairs.size()));
    for (int g = 0; g < static_cast<int>(s.pairs.size()); ++g) motion[g] = step.motion(g);
    std::vector<int> near;
    const bool looks = !spans || !guards.pass(most, h);
    if (looks) {
      guards.bound_motion(q0, most, h);
      guards.place(q1);
      for (const BroadPhase::NearPair& pair : guards.near_pairs()) near.push_back(pair.guard);
      bool clear = true;
      for (int g : near) clear &= !spans || stays_open(guards, g);
      guards.commit();
      if (spans && clear) guards.begin_span(q1, most, h);
    }
    found.emplace_back(std::move(near), std::move(motion), looks);
  }
  return found;
}

}  // namespace

void expose_manifold(nb::module_& m) {
  m.def("contact_points", &contact_points, "scene"_a, "q"_a, "pair"_a, "margin"_a, "max_points"_a = 4,
        "Points at which a collision pair touches at q: dict of kind, feature, material, valid (lists), gap (n,), "
        "point_a, point_b, normal (n, 3), world frame.");
  m.def("contact_points_of", &points_of_features, "scene"_a, "q"_a, "pair"_a, "features"_a,
        "Points of a pair at known features, wherever they are at q; entries as those of contact_points.");
  m.def(
      "distance_bounds",
      [](const Scene& s, const VecX& known, const Rows& places, int a, int b) {
        return hand_over(distance_bounds(s, known, places, a, b));
      },
      "scene"_a, "known"_a, "places"_a, "a"_a, "b"_a,
      "Bounds (N, 3) on the distance of two geometries at places (N, nq), from that at the configuration `known`: a "
      "lower bound, the distance itself, an upper bound.");
  m.def(
      "near_pairs", &near_pairs, "scene"_a, "start"_a, "end"_a, "bound"_a, "h"_a, "spans"_a = false,
      "For steps of length h that begin at start and were to end at end (N, nq), with velocities within bound (N, nv) "
      "of the engine: [(pairs that are looked at, bound on each pair's motion (npairs,), whether the step looks at "
      "all)]."
      " spans: steps after one in which no pair comes near may look at none.");
  m.def(
      "distance_noise",
      [](const Scene& s, const VecX& q, int pair) { return ManifoldTouch(s, q, pair, 1).manifolds.noise(pair); },
      "scene"_a, "q"_a, "pair"_a, "How far the distance of a pair may be from the gap of its lowest point [m].");
  m.def("nearest_gap", &nearest_gap, "scene"_a, "q"_a, "pair"_a,
        "Distance [m] of a pair with a halfspace by its own features, NaN for other pairs.");
  m.def(
      "none_deeper", &none_deeper, "scene"_a, "q"_a, "pair"_a, "features"_a, "max_points"_a = 4,
      "Whether a pair is seen to be no deeper than the points of these features without its distance, and by how much "
      "its distance is larger than their least gap.");
  m.def(
      "rest_behind", &rest_behind, "scene"_a, "q"_a, "pair"_a, "features"_a, "per_distance"_a, "slack"_a,
      "(sine of the angle at which the edges of these features cross, 1 for vertices on a face, 0 for others; whether "
      "the rest of both shapes lies behind them by more than so much of its distance less a slack [m]; the gap of the "
      "pair if it is theirs, else NaN).");
  m.def("far_vertices", &far_vertices, "vertices"_a, "directions"_a, "depth"_a,
        "Of many vertices, (n, 3): per unit direction, (k, 3), the farthest one, the first of several, and those that "
        "miss it by at most a depth [m]. Empty for few vertices.");
  m.def("rest_gap", &rest_gap, "scene"_a, "q"_a, "pair"_a, "features"_a, "max_points"_a = 4,
        "enough"_a = std::numeric_limits<double>::infinity(),
        "(least gap over all features but these, slack included; that feature's gap, normal and point). Infinite where "
        "it "
        "is above `enough`, or where there is none.");
}

}  // namespace contactvi
