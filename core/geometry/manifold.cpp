#include "geometry/manifold.hpp"

#include <algorithm>
#include <limits>

namespace contactvi {

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// A nearest point counts as one of a face's plane up to this [m]; coal's are that good.
constexpr double kOnFace = 1e-6;
// Of the noise of coal's distance: so much deeper than the held points counts as another feature.
constexpr double kBelow = 1.1;

// The face of o that contains x (its core's surface point, world) and looks most along n; -1 if none looks that way.
int facing_face(const ShapeFeatures& o, const Pose& pose, const Vec3& n_W, const Vec3& x_W) {
  if (o.is_unbounded()) return 0;
  const Vec3 n = pose.R.transpose() * n_W, x = pose.into(x_W);
  int best = -1, best_on = -1;
  double most = kFacing, most_on = kFacing;
  for (int f = 0; f < static_cast<int>(o.faces.size()); ++f) {
    const double along = o.faces[f].normal.dot(n);
    if (along > most) {
      most = along;
      best = f;
    }
    if (along > most_on && std::abs(o.faces[f].normal.dot(x) - o.faces[f].offset) < kOnFace) {
      most_on = along;
      best_on = f;
    }
  }
  return best_on >= 0 ? best_on : best;
}

class Collect final : public CandidateSink {
 public:
  Collect(double margin, std::vector<Candidate>& found) : found_(found) { limit = margin; }
  void add(const Candidate& c) override { found_.push_back(c); }

 private:
  std::vector<Candidate>& found_;
};

}  // namespace

// The least of the candidates that are not held.
class Manifolds::Least final : public CandidateSink {
 public:
  Least(const Manifolds& owner, const Placements& at, const ContactPoint* const* persistent, int count)
      : owner_(owner), at_(at), contact_step_(persistent), count_(count) {
    limit = kInfinity;
    supported_ = count >= std::min(3, owner.max_points_);
  }

  void add(const Candidate& c) override {
    double slack = supported_ ? kRestSlack : 0.0;
    const int rim = feature_rim(c.feature);
    for (int i = 0; i < count_; ++i) {
      const ContactPoint& h = *contact_step_[i];
      if (h.feature == c.feature) return;
      if (rim >= 0 && feature_rim(h.feature) == rim && feature_on_b(h.feature) == feature_on_b(c.feature))
        slack = kRestSlack;
    }
    if (c.gap + slack >= limit) return;
    for (int i = 0; i < count_; ++i) {
      if (contact_step_[i]->kind == PointKind::kLimit) continue;
      if (slack == 0.0 && is_same_place(*contact_step_[i], c)) return;
    }
    limit = c.gap + slack;
    best = c;
  }

  Candidate best{};

 private:
  // Two names of one point: corner upon corner.
  bool is_same_place(const ContactPoint& h, const Candidate& c) const {
    if (h.kind == PointKind::kWitness) return false;
    Contact contact;
    owner_.evaluate(h, at_, contact);
    Vec3 d = c.x_W - 0.5 * (contact.point_a + contact.point_b);
    d -= d.dot(contact.normal) * contact.normal;
    return d.squaredNorm() < kSamePlace * kSamePlace && c.gap > contact.gap - kSameGap;
  }

  const Manifolds& owner_;
  const Placements& at_;
  const ContactPoint* const* contact_step_;
  int count_;
  bool supported_;  // at points that fix the faces to each other
};

Manifolds::Manifolds(const Scene& scene, int max_points) : max_points_(std::max(1, max_points)) {
  std::vector<int> number(2 * scene.geometries.size(), -1);
  auto shape_features = [&](int geometry, bool rounded) {
    int& n = number[2 * geometry + rounded];
    if (n < 0) {
      n = static_cast<int>(shape_features_.size());
      shape_features_.push_back(make_shape_features(scene.geometries[geometry], rounded));
    }
    return n;
  };
  for (const Pair& pair : scene.pairs) {
    const int i = shape_features(pair.a, pair.rounded), j = shape_features(pair.b, pair.rounded);
    const ShapeFeatures &a = shape_features_[i], &b = shape_features_[j];
    auto is_empty = [](const ShapeFeatures& o) { return o.vertices.empty() && o.faces.empty(); };
    auto is_point = [](const ShapeFeatures& o) { return o.vertices.size() == 1; };
    bool single = is_empty(a) || is_empty(b) || (a.faces.empty() && b.faces.empty());
    single |= (is_point(a) && !b.is_unbounded()) || (is_point(b) && !a.is_unbounded());
    shapes_.push_back({i, j, single, (pair.curved ? 2e-8 : 1e-9) + a.roughness + b.roughness});
  }
}

PairView Manifolds::view(int pair, const Placements& at) const {
  const ShapeFeatures &a = shape_features_[shapes_[pair].a], &b = shape_features_[shapes_[pair].b];
  return {&a, &b, pose_of(a.body, at), pose_of(b.body, at)};
}

Sides Manifolds::sides_of_witness(const PairView& v, const Contact& witness) const {
  Sides s;
  s.n_W = witness.normal;
  if (v.a->is_unbounded()) s.n_W = v.pose_a.R * v.a->faces[0].normal;
  if (v.b->is_unbounded()) s.n_W = -(v.pose_b.R * v.b->faces[0].normal);
  const Vec3 x_a = witness.point_a - v.a->radius * s.n_W, x_b = witness.point_b + v.b->radius * s.n_W;
  // Nothing lies over a face of a convex body that a halfspace touches but the halfspace.
  if (!v.b->is_unbounded()) s.a = facing_face(*v.a, v.pose_a, s.n_W, x_a);
  if (!v.a->is_unbounded()) s.b = facing_face(*v.b, v.pose_b, -s.n_W, x_b);
  return s;
}

void Manifolds::find(int pair, const Placements& at, const Contact& witness, double margin,
                     std::vector<ContactPoint>& points, std::vector<ContactPoint>* others) const {
  if (!(witness.gap <= margin)) return;
  const PairView v = view(pair, at);
  found_.clear();
  const Candidate nearest{0, witness.gap, 0.5 * (witness.point_a + witness.point_b)};
  Vec3 n = witness.normal;
  if (!shapes_[pair].single) {
    const Sides sides = sides_of_witness(v, witness);
    n = sides.n_W;
    Collect sink(margin, found_);
    list_candidates(v, sides, false, edges_, sink);
    double least = kInfinity;
    for (const Candidate& c : found_) least = std::min(least, c.gap);
    // None of the features is the nearest: it is one that has no point of its own.
    if (witness.gap < least - shapes_[pair].noise) found_.insert(found_.begin(), nearest);
  } else {
    found_.push_back(nearest);
  }
  const std::vector<int>& chosen = selection_.choose(found_, n, max_points_);
  for (int i : chosen) points.push_back(make_point(pair, v, found_[i], n));
  if (others == nullptr || chosen.size() == found_.size()) return;
  for (int i = 0; i < static_cast<int>(found_.size()); ++i)
    if (found_[i].feature != 0 && !std::binary_search(chosen.begin(), chosen.end(), i))
      others->push_back(make_point(pair, v, found_[i], n));
}

double Manifolds::rest(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                       const Contact& witness, Contact& contact) const {
  if (shapes_[pair].single) return kInfinity;
  const PairView v = view(pair, at);
  const ContactPoint* known = nullptr;
  for (int i = 0; i < count && known == nullptr; ++i)
    if (persistent[i]->feature != 0) known = persistent[i];
  const Sides sides = known != nullptr ? sides_of_point(v, *known, at) : sides_of_witness(v, witness);
  Least least(*this, at, persistent, count);
  list_candidates(v, sides, true, edges_, least);
  double value = least.limit;
  if (value < kInfinity) evaluate(make_point(pair, v, least.best, sides.n_W), at, contact);
  for (int i = 0; i < count; ++i) {
    if (persistent[i]->kind != PointKind::kRim) continue;
    Contact far;
    const double gap = far_of_rim(*persistent[i], at, far);
    if (gap >= value) continue;
    value = gap;
    contact = far;
  }
  return count > 0 ? with_witness(pair, at, persistent, count, witness, value, contact) : value;
}

// Where coal sees the pair deeper than its held points are, a feature has come down that none of the faces lists.
double Manifolds::with_witness(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                               const Contact& witness, double value, Contact& contact) const {
  const double noise = shapes_[pair].noise;
  double least = 0.0;
  for (int i = 0; i < count; ++i) {
    if (persistent[i]->kind == PointKind::kWitness || persistent[i]->kind == PointKind::kLimit) return value;
    Contact c;
    evaluate(*persistent[i], at, c);
    least = std::min(least, c.gap);
  }
  const double deeper = witness.gap - least;
  if (!(deeper < -0.5 * noise) || deeper + kBelow * noise >= value) return value;
  contact = witness;
  return deeper + kBelow * noise;
}

bool Manifolds::nearest(int pair, const Placements& at, Contact& contact) const {
  const Shapes& s = shapes_[pair];
  if (s.single || !(shape_features_[s.a].is_unbounded() || shape_features_[s.b].is_unbounded())) return false;
  rest(pair, at, nullptr, 0, Contact{}, contact);
  return true;
}

}  // namespace contactvi
