// The nearest features of two shapes from the nearest points that coal has found, to rounding.
//
// Where a shape is curved GJK iterates: distances of cylinders are wrong by up to 2e-8 m near contact, of polytopes
// by 1e-9 m. And normals that are differences of points lose digits as the cores come near to each other. Its points
// tell which features are nearest: a vertex, an edge, a face, the rim or the side of a cylinder. The nearest points of
// two features are known in closed form or by Newton's method. Every answer is checked by a bound that does not depend
// on how it was found: two convex shapes are at least as far from each other as along any unit vector n (Boyd,
// Vandenberghe, "Convex Optimization", 2004, section 8.2.1), and at most as far as two of their points. Pairs with an
// ellipsoid have equations of their own (nearest_on_ellipsoid.hpp).
#pragma once

#include "geometry/candidates.hpp"
#include "geometry/contact.hpp"

namespace contactvi {

// Gap, normal and points of `contact`, whose normal points from a to b, from those of coal. False where no pair of
// features gives a distance that is the bound to rounding, and over a halfspace: the contact stays as it is.
bool refine_nearest(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                    Contact& contact);

// A lower bound on the gap of two shapes: how far they are from each other along the unit vector n_W from a to b, along
// its own normal over a halfspace; minus infinity with an ellipsoid.
double gap_along(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                 const Vec3& n_W);

}  // namespace contactvi
