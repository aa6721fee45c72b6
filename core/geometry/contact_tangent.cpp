#include "geometry/contact_tangent.hpp"

#include <algorithm>
#include <cmath>

#include "geometry/nearest_features.hpp"
#include "geometry/solid_pair.hpp"
#include "model/function_surface.hpp"

namespace contactvi {

namespace {

// Least pivot of the scaled system, whose entries are at most 1, against the largest one: the sine of the angle between
// two edges, or the distance of the cores and their radii against the size of the bodies. With less, the rounding of
// that angle or distance (1e-16) is felt in the seventh digit of the derivative.
constexpr double kLeastPivot = 1e-9;
// Newton's method doubles the digits with each step: what is left after a step below this [rad, and of the size of the
// bodies] is rounding. From nearest points with 3 digits that are three steps.
constexpr double kFeatureConverged = 1e-9;
constexpr int kTangentNewton = 20;
constexpr double kLeastAcross = 1e-9;  // the part of an axis in the tangent plane: with less it has no direction there

}  // namespace

ContactTangent::ContactTangent(const Scene& scene) : scene_(&scene), twists_(scene.tree) {}

bool ContactTangent::refuse(const std::string& why) {
  why_ = why;
  return false;
}

std::string ContactTangent::names() const { return std::string(surface_[0].name()) + " against " + surface_[1].name(); }

bool ContactTangent::take(const VecCRef& q, int guard, const Contact& contact, const ContactPoint* point) {
  twists_.place(q);
  contact_ = contact;
  law_ = nullptr;
  is_limit_ = !scene_->is_pair(guard);
  if (is_limit_) return true;
  if (!std::isfinite(contact.gap)) return refuse("the distance of the shapes is not known");
  const Pair& pair = scene_->pairs[guard];
  turning_.setZero();
  if (pair.law >= 0) turning_ << scene_->laws[pair.law].spinning, scene_->laws[pair.law].rolling;
  const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b];
  const auto size = [](const Geometry& g) { return g.radius > 0.0 ? g.radius : kInfinity; };
  scale_ = std::min(size(a), size(b));
  const bool is_known = point != nullptr && point->kind != PointKind::kWitness && point->kind != PointKind::kLimit;
  return (is_known ? take_point(*point) : take_witness(guard)) && take_axis(pair);
}

bool ContactTangent::take_axis(const Pair& pair) {
  if (pair.law < 0 || scene_->laws[pair.law].axis_of < 0) return true;
  law_ = &scene_->laws[pair.law];
  const Geometry& g = scene_->geometries[law_->axis_of == 0 ? pair.a : pair.b];
  axis_body_ = g.body;
  axis_ = pose_of(g.body, twists_.placements()).R * (g.R_BG * law_->axis);
  const double across = axis_.cross(contact_.normal).norm();
  return across > kLeastAcross || refuse("the axis of its friction is along the normal");
}

// About the normal, of the tangents along the axis of friction that depends on the direction.
double ContactTangent::turn_about_normal(const Vec3& t1, const Vec3& axis_change, const Vec3& dn) const {
  const Vec3& n = contact_.normal;
  const double height = axis_.dot(n);
  const Vec3 moved = axis_change - height * dn;
  return n.cross(t1).dot(moved) / (axis_ - height * n).norm();
}

bool ContactTangent::take_point(const ContactPoint& p) {
  const Placements& at = twists_.placements();
  const Pose own = pose_of(p.point_body, at), other = pose_of(p.plane_body, at);
  const int side = p.on_b ? 1 : 0;
  const Vec3 n = contact_.normal, point = side == 1 ? contact_.point_b : contact_.point_a;
  const Vec3 across = side == 1 ? contact_.point_a : contact_.point_b;
  if (p.kind == PointKind::kEdge) {
    surface_[0] = ContactSurface::line("edge", across - p.offset * n, other.R * p.normal_B, p.offset);
    surface_[1] = ContactSurface::line("edge", point + p.radius * n, own.R * p.axis_B, p.radius);
    return set_system();
  }
  if (p.kind == PointKind::kEnd || p.kind == PointKind::kRimLine) {
    surface_[1 - side] =
        ContactSurface::line("side", across - p.offset * outward(1 - side), other.R * p.normal_B, p.offset);
    surface_[side] = p.kind == PointKind::kEnd ? ContactSurface::point("end of a line", own.point(p.center_B), p.radius)
                                               : ContactSurface::rim(own.point(p.center_B), own.R * p.axis_B,
                                                                     p.rim_radius, outward(side), p.radius);
    return set_system();
  }
  if (p.kind == PointKind::kSurface) {
    const Pair& pair = scene_->pairs[p.guard];
    const Geometry& g = scene_->geometries[side == 1 ? pair.a : pair.b];
    const Mat3 R = other.R * g.R_BG;
    const Vec3 center = own.point(p.center_B), origin = other.point(g.p_BG);
    const Mat3 B = g.surface->bend(R.transpose() * (center - origin), R.transpose() * (across - origin));
    if (!B.allFinite()) return refuse("the curvature of a surface given by a function is not known");
    surface_[1 - side] = ContactSurface::curved("surface given by a function", across, R * B * R.transpose());
    surface_[side] = ContactSurface::point("vertex", center, p.radius);
    return set_system();
  }
  if (p.kind == PointKind::kSolids) return take_solids(p);
  surface_[1 - side] = ContactSurface::plane("face", across, other.R * p.normal_B, 0.0);
  if (p.kind == PointKind::kVertex) {
    surface_[side] = ContactSurface::point("vertex", own.point(p.center_B), p.radius);
    return set_system();
  }
  const Vec3 axis = own.R * p.axis_B;
  if (rim_tilt(p.rim_radius, axis, n) <= kUpright) return refuse("the nearest features are a rim flat on a face");
  surface_[side] = ContactSurface::rim(own.point(p.center_B), axis, p.rim_radius, outward(side), p.radius);
  return set_system();
}

bool ContactTangent::take_solids(const ContactPoint& p) {
  const SolidPair solids(*scene_, p.guard, twists_.placements());
  ContactSurface found[2];
  if (!solids.surfaces(solids.known(p.origin_B, p.center_B, feature_i(p.feature)), found))
    return refuse("the curvature of two solids is not known");
  for (int k = 0; k < 2; ++k) surface_[(k == 1) == p.on_b ? 1 : 0] = found[k];
  return set_system();
}

bool ContactTangent::take_witness(int guard) {
  const Pair& pair = scene_->pairs[guard];
  const Placements& at = twists_.placements();
  const Geometry &a = scene_->geometries[pair.a], &b = scene_->geometries[pair.b];
  const Pose pose[2] = {pose_of(a.body, at), pose_of(b.body, at)};
  if (scene_->has_surface(guard)) return refuse("the nearest vertex over a surface given by a function is not known");
  // Over a halfspace the nearest point is known in closed form.
  const bool exact = a.unbounded || b.unbounded ||
                     refine_nearest(shape_features_of(a, pair.rounded), pose[0], shape_features_of(b, pair.rounded),
                                    pose[1], contact_);
  return approach(pair, pose, !exact) && set_system();
}

bool ContactTangent::find(const Pair& pair, const Pose (&pose)[2], bool nearby, ContactSurface (&found)[2]) {
  const ShapeFeatures* shape[2] = {&shape_features_of(scene_->geometries[pair.a], pair.rounded),
                                   &shape_features_of(scene_->geometries[pair.b], pair.rounded)};
  for (int side = 0; side < 2; ++side) {
    const ShapeFeatures& o = shape[1 - side]->ellipsoid ? features_for_ellipsoid(*shape[side]) : *shape[side];
    const Vec3 x = (side == 0 ? contact_.point_a : contact_.point_b) - o.radius * outward(side);
    const char* why = ContactSurface::find(o, pose[side], x, outward(side), nearby, found[side]);
    if (why == nullptr) continue;
    if (const int number = preferred_[static_cast<std::size_t>(side)]; number >= 0) {
      found[side] =
          ContactSurface::of(o, pose[side], number, pose[side].into(x), pose[side].R.transpose() * outward(side));
      continue;
    }
    return refuse("the nearest point of the " + std::string(side == 0 ? "first" : "second") + " shape lies between " +
                  why);
  }
  return true;
}

bool ContactTangent::approach(const Pair& pair, const Pose (&pose)[2], bool nearby) {
  if (!find(pair, pose, nearby, surface_) || !polish()) return false;
  ContactSurface exact[2];
  if (!find(pair, pose, false, exact)) return false;
  if (exact[0].number() != surface_[0].number() || exact[1].number() != surface_[1].number())
    return refuse("the nearest points lie beyond the ends of the features: " + names());
  return true;
}

// Newton's method for the nearest points on the two features. Its matrix is that of the derivative.
bool ContactTangent::polish() {
  bool converged = false;
  for (int k = 0; !converged; ++k) {
    if (k == kTangentNewton) return refuse("no nearest points are found on the features: " + names());
    if (!set_system()) return false;
    const Vec3 apart = surface_[1].x() - surface_[0].x(), n = contact_.normal;
    Vec6 c = Vec6::Zero();
    for (int i = 0; i < 2; ++i) c[i] = -points_weight_ * tangent_[i].dot(apart) / scale_;
    for (int side = 0; side < 2; ++side)
      for (int i = 0; i < 2; ++i) {
        const Bend& b = bend_[side];
        if (!b.flat[i]) continue;
        const double sign = side == 0 ? 1.0 : -1.0;
        c[2 + 2 * side + i] = sign * surface_[side].missing_turn(outward(side), b.e[i]);
      }
    const Vec6 z = system_.solve(c);
    const Vec3 s[2] = {scale_ * (z[2] * tangent_[0] + z[3] * tangent_[1]),
                       scale_ * (z[4] * tangent_[0] + z[5] * tangent_[1])};
    contact_.normal = (n + z[0] * tangent_[0] + z[1] * tangent_[1]).normalized();
    for (int side = 0; side < 2; ++side) surface_[side].move(s[side], outward(side));
    converged = z.lpNorm<Eigen::Infinity>() <= kFeatureConverged;
  }
  contact_.point_a = surface_[0].x() + surface_[0].sweep() * contact_.normal;
  contact_.point_b = surface_[1].x() - surface_[1].sweep() * contact_.normal;
  contact_.gap = (contact_.point_b - contact_.point_a).dot(contact_.normal);
  return true;
}

// Rows: the tangential part of the points' motion along both tangents, and both principal directions of a and of b.
bool ContactTangent::set_system() {
  const Vec3 n = contact_.normal;
  tangent_[0] = any_tangent(n);
  tangent_[1] = n.cross(tangent_[0]);
  const double apart = (surface_[1].x() - surface_[0].x()).dot(n) / scale_;
  Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
  points_weight_ = 1.0 / std::max(1.0, std::abs(apart));
  for (int i = 0; i < 2; ++i) {
    A(i, i) = -points_weight_ * apart;
    A(i, 2 + i) = -points_weight_;
    A(i, 4 + i) = points_weight_;
  }
  for (int side = 0; side < 2; ++side) {
    bend_[side] = surface_[side].bend(outward(side));
    const double sign = side == 0 ? 1.0 : -1.0;
    for (int i = 0; i < 2; ++i) {
      const int row = 2 + 2 * side + i;
      const Bend& b = bend_[side];
      const double radius = b.radius[i] / scale_;
      const double weight = weight_[side][i] = 1.0 / std::max(1.0, radius);
      for (int j = 0; j < 2; ++j) {
        const double along = b.e[i].dot(tangent_[j]);
        A(row, j) = b.flat[i] ? along : -sign * weight * radius * along;
        A(row, 2 + 2 * side + j) = b.flat[i] ? -sign * b.curvature[i] * scale_ * along : weight * along;
      }
    }
  }
  if (!A.allFinite()) return refuse("the nearest points are not unique: " + names());
  system_.setThreshold(kLeastPivot);
  system_.compute(A);
  return system_.isInvertible() || refuse("the nearest points are not unique: " + names());
}

void ContactTangent::change(const VecCRef& dq, const Vec3& t1, Eigen::Ref<MatX> dW) {
  dW.setZero();
  dn_ = dx_[0] = dx_[1] = dt_[0] = dt_[1] = Vec3::Zero();
  if (is_limit_) return;
  twists_.move(dq);
  const Vec3 n = contact_.normal;
  Vec3 moved[2], turned[2];
  for (int side = 0; side < 2; ++side) {
    moved[side] = twists_.velocity(body(side), surface_[side].x());
    turned[side] = twists_.turn(body(side)).cross(n);
  }
  Vec6 c;
  for (int i = 0; i < 2; ++i) c[i] = points_weight_ * tangent_[i].dot(moved[0] - moved[1]) / scale_;
  for (int side = 0; side < 2; ++side)
    for (int i = 0; i < 2; ++i) {
      const Bend& b = bend_[side];
      const double sign = side == 0 ? 1.0 : -1.0, turn = b.e[i].dot(turned[side]);
      const double weight = weight_[side][i];
      c[2 + 2 * side + i] = b.flat[i] ? turn : -sign * weight * b.radius[i] / scale_ * turn;
    }
  const Vec6 z = system_.solve(c);
  dn_ = z[0] * tangent_[0] + z[1] * tangent_[1];
  for (int side = 0; side < 2; ++side) {
    const Vec3 slide = scale_ * (z[2 + 2 * side] * tangent_[0] + z[3 + 2 * side] * tangent_[1]);
    const double sign = side == 0 ? 1.0 : -1.0;
    dx_[side] = moved[side] + slide + sign * surface_[side].sweep() * dn_;
  }
  const Vec3 none = Vec3::Zero(), t2 = n.cross(t1);
  const double about = law_ != nullptr ? turn_about_normal(t1, twists_.turn(axis_body_).cross(axis_), dn_) : 0.0;
  dt_[0] = about * t2 - dn_.dot(t1) * n;
  dt_[1] = dn_.cross(t1) - about * t1;
  const Eigen::Vector2d own = shares();
  const Vec3 rows[3] = {n, own[0] * t1, own[1] * t2}, changes[3] = {dn_, own[0] * dt_[0], own[1] * dt_[1]};
  for (int k = 0; k < std::min(3, static_cast<int>(dW.cols())); ++k) {
    const Vec3 &F = rows[k], &dF = changes[k];
    twists_.add_wrench(contact_.body_b, contact_.point_b, dx_[1], F, dF, none, none, dW.col(k));
    twists_.add_wrench(contact_.body_a, contact_.point_a, dx_[0], -F, -dF, none, none, dW.col(k));
  }
  if (dW.cols() <= 3) return;
  int k = 3;
  const auto add_turning = [&](double radius, const Vec3& axis, const Vec3& axis_change) {
    const Vec3 T = radius * axis, dT = radius * axis_change;
    twists_.add_wrench(contact_.body_b, contact_.point_b, none, none, none, T, dT, dW.col(k));
    twists_.add_wrench(contact_.body_a, contact_.point_a, none, none, none, -T, -dT, dW.col(k));
    ++k;
  };
  if (turning_[0] > 0.0) add_turning(turning_[0], n, dn_);
  if (!(turning_[1] > 0.0)) return;
  add_turning(turning_[1], t1, dt_[0]);
  add_turning(turning_[1], t2, dt_[1]);
}

}  // namespace contactvi
