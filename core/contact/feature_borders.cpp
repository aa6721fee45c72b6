#include "contact/feature_borders.hpp"

#include <cmath>

namespace contactvi {

namespace {
constexpr double kOnBorder = 1e-11;  // [m] as far as the end of a step may be from the border at which it was to end
}

const Geometry& FeatureBorders::geometry(const Feature& feature, bool of_b) const {
  const Scene& scene = guards_->scene();
  const Pair& pair = scene.pairs[guard(feature)];
  return scene.geometries[of_b ? pair.b : pair.a];
}

const ShapeFeatures& FeatureBorders::others(const Feature& feature) const {
  return shape_features_of(geometry(feature, !feature.of_b), guards_->scene().pairs[guard(feature)].rounded);
}

const ShapeFeatures& FeatureBorders::shape(const Feature& feature) const {
  const bool rounded = guards_->scene().pairs[guard(feature)].rounded;
  const ShapeFeatures& own = shape_features_of(geometry(feature, feature.of_b), rounded);
  return others(feature).ellipsoid ? features_for_ellipsoid(own) : own;
}

// The centre of a ball, or a point on the normal of the shape at its nearest point, which is in the same region.
Vec3 FeatureBorders::nearest(const Feature& feature) {
  const ShapeFeatures& other = others(feature);
  const Placements& at = guards_->placements(guard(feature));
  const Pose pose = pose_of(geometry(feature, feature.of_b).body, at);
  if (other.edges.empty() && other.faces.empty() && !other.ellipsoid)
    return pose.into(pose_of(geometry(feature, !feature.of_b).body, at).point(other.vertices[0]));
  Contact contact;
  guards_->evaluate_witness(guard(feature), contact);
  const Vec3 outward = feature.of_b ? Vec3(-contact.normal) : contact.normal;
  const double away = other.radius > 0.0 ? other.radius : feature.size;
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
    for (bool of_b : {false, true}) {
      Feature feature{i, of_b, 0.0, {}, Vec3::Zero(), 0.0};
      // A surface that is given by a function may have no size.
      feature.size = geometry(feature, point.kind == PointKind::kSolids ? point.on_b : of_b).radius;
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
