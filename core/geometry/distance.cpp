#include "geometry/distance.hpp"

#include <coal/distance_func_matrix.h>
#include <coal/narrowphase/support_functions.h>
#include <coal/shape/geometric_shapes.h>

#include <limits>

namespace contactvi {

namespace {

// Coal's function for each pair of kinds of shapes.
const coal::DistanceFunctionMatrix& functions() {
  static const coal::DistanceFunctionMatrix table;
  return table;
}

}  // namespace

void settle_box_support() {
  const coal::Box box(1, 1, 1);
  int hint = 0;
  coal::details::getSupport<coal::details::SupportOptions::NoSweptSphere>(&box, coal::Vec3s(1, 2, 3), hint);
  coal::details::getSupport<coal::details::SupportOptions::WithSweptSphere>(&box, coal::Vec3s(1, 2, 3), hint);
}

struct ShapeDistance::Workspace {
  coal::GJKSolver solver;
  coal::DistanceRequest request;
  coal::DistanceResult result;
};

ShapeDistance::ShapeDistance() : workspace_(new Workspace) {
  workspace_->request.enable_signed_distance = true;
  workspace_->request.gjk_tolerance =
      1e-10;  // the default 1e-6 is the error of the gap; EPA's default stays, below it NaN
}

ShapeDistance::~ShapeDistance() = default;

void ShapeDistance::evaluate(const coal::CollisionGeometry& a, const Mat3& R_a, const Vec3& p_a,
                             const coal::CollisionGeometry& b, const Mat3& R_b, const Vec3& p_b, Contact& contact) {
  Workspace& w = *workspace_;
  w.result.clear();
  w.solver.set(w.request);
  w.solver.support_func_cached_guess.setZero();
  functions().distance_matrix[a.getNodeType()][b.getNodeType()](
      &a, coal::Transform3s(R_a, p_a), &b, coal::Transform3s(R_b, p_b), &w.solver, w.request, w.result);
  contact.gap = w.result.min_distance;
  contact.normal = w.result.normal;
  contact.point_a = w.result.nearest_points[0];
  contact.point_b = w.result.nearest_points[1];
  if (!contact.normal.allFinite()) contact.gap = std::numeric_limits<double>::quiet_NaN();
}

}  // namespace contactvi
