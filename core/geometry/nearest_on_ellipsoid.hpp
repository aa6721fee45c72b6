// The nearest points of an ellipsoid and another shape from those that coal has found, to rounding.
//
// The ellipsoid's point is a smooth function x(n) of its outward unit normal n. The other core's point y is the one
// with the normal -n where that is an ellipsoid too, and else the one that is nearest to x(n) (core_projection.hpp).
// Nearest points are those whose difference has no part across n: two equations for the two turns of n, which Newton's
// method solves. With the radii of curvature R of the ellipsoid at x, P = dy/dx and g = n.(y - x),
//
//   tangential part of (y - x) = [(1 - P) R + g] dn,      of two ellipsoids   [R + R_other + g] dn.
//
// R is positive and P lies between 0 and 1, so that the matrix is regular wherever the cores are apart (g > 0), also
// where the other point changes its feature, and dn makes the distance of x(n) from the other core smaller (of two
// ellipsoids: makes g larger, which is a lower bound on their distance). Steps are halved until it does. Two convex
// cores that are apart have only one solution: an ellipsoid is strictly convex, there is no flat on flat.
#pragma once

#include "geometry/candidates.hpp"
#include "geometry/contact.hpp"

namespace contactvi {

// Gap, normal and points of `contact`, whose normal points from a to b, from those of coal. One of the shapes or both
// are ellipsoids, the other one is bounded. False, and the contact stays as it is, where the cores meet (the shapes
// overlap by more than their rounding, or a ball's centre lies in the ellipsoid) and where Newton's method fails.
bool refine_on_ellipsoid(const ShapeFeatures& a, const Pose& pose_a, const ShapeFeatures& b, const Pose& pose_b,
                         Contact& contact);

}  // namespace contactvi
