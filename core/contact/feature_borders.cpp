#include "contact/feature_borders.hpp"

#include <cmath>

namespace contactvi {

namespace {
constexpr double kOnBorder = 1e-11;  // [m] as far as the end of a step may be from the border at which it was to end
}

const ShapeFeatures& FeatureBorders::shape(const Feature& feature) const {
  const Scene& scene = guards_->scene();
  const Pair& pair = scene.pairs[guard(feature)];
  const Geometry &own = scene.geometries[feature.of_b ? pair.b : pair.a],
                 &other = scene.geometries[feature.of_b ? pair.a : pair.b];
  const ShapeFeatures& features = shape_features_of(own, pair.rounded);
  return shape_features_of(other, pair.rounded).ellipsoid ? features_for_ellipsoid(features) : features;
}

// The centre of a ball, or a point on the normal of the shape at its nearest point, which is in the same region.
Vec3 FeatureBorders::nearest(const Feature& feature) {
  const Scene& scene = guards_->scene();
  const int g = guard(feature);
  const Pair& pair = scene.pairs[g];
  const Geometry &own = scene.geometries[feature.of_b ? pair.b : pair.a],
                 &other = scene.geometries[feature.of_b ? pair.a : pair.b];
  const ShapeFeatures& others = shape_features_of(other, pair.rounded);
  const Placements& at = guards_->placements(g);
  const Pose pose = pose_of(own.body, at);
  if (others.edges.empty() && others.faces.empty() && !others.ellipsoid)
    return pose.into(pose_of(other.body, at).point(others.vertices[0]));
  Contact contact;
  guards_->evaluate_witness(g, contact);
  const Vec3 outward = feature.of_b ? Vec3(-contact.normal) : contact.normal;
  const double away = others.radius > 0.0 ? others.radius : feature.size;
  return pose.into((feature.of_b ? contact.point_b : contact.point_a) + away * outward);
}

double FeatureBorders::inside_face(const Feature& feature) const {
  const ContactPoint& point = (*contacts_)[feature.contact].point;
  return guards_->manifolds().inside_face(point, guards_->placements(point.guard));
}

void FeatureBorders::begin(const std::vector<PersistentContact>& contacts) {
  contacts_ = &contacts;
  features_.clear();
  const Scene& scene = guards_->scene();
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const ContactPoint& point = contacts[i].point;
    if (!scene.is_pair(point.guard)) continue;
    const Pair& pair = scene.pairs[point.guard];
    for (bool of_b : {false, true}) {
      Feature feature{i, of_b, scene.geometries[of_b ? pair.b : pair.a].radius, {}, Vec3::Zero(), 0.0};
      if (point.kind != PointKind::kWitness) {
        if (of_b == point.on_b) continue;  // the face is of the other shape
        feature.start_depth = inside_face(feature);
        if (std::isfinite(feature.start_depth)) features_.push_back(feature);
      } else if (NearestRegion::has_regions(shape(feature))) {
        feature.start = nearest(feature);
        feature.region = NearestRegion::of(shape(feature), feature.start);
        if (feature.region.any()) features_.push_back(feature);
      }
    }
  }
}

void FeatureBorders::settle() {
  for (Feature& feature : features_) {
    if (!feature.region.any() || feature.region.depth(feature.start) > kOnBorder) continue;
    const NearestRegion next = NearestRegion::of(shape(feature), nearest(feature));
    if (next.any() && next.depth(feature.start) >= -kOnBorder) feature.region = next;
  }
}

double FeatureBorders::depth(int k) {
  const Feature& feature = features_[static_cast<std::size_t>(k)];
  return (ends_point(k) ? inside_face(feature) : feature.region.depth(nearest(feature))) / feature.size;
}

double FeatureBorders::start_depth(int k) const {
  const Feature& feature = features_[static_cast<std::size_t>(k)];
  return (ends_point(k) ? feature.start_depth : feature.region.depth(feature.start)) / feature.size;
}

}  // namespace contactvi
