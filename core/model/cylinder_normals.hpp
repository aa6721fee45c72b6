// Where a surface and a cylinder are nearest to each other, or overlap most.
#pragma once

#include <array>
#include <vector>

#include "model/common_normal.hpp"
#include "model/searched_surface.hpp"

namespace contactvi {

// About the axis z of its frame, |z| <= half.
struct Cylinder {
  double radius, half;
};

class FoundNormals;

// What a common normal touches of a cylinder: numbers of its parts. Of a rim that lies flat on the surface, points that
// are fixed to it take its place: point k of rim r is part kFirstRimPoint + r * kRimPointsOfPart + k, from x to y.
namespace cylinder_part {
constexpr int kLowRim = 1, kHighRim = 2, kLateral = 3, kLowEnd = 4, kHighEnd = 5, kFirstRimPoint = 6;
constexpr int kRimPointsOfPart = 12;
inline bool is_rim(int part) { return part == kLowRim || part == kHighRim; }
inline bool is_end(int part) { return part == kLowEnd || part == kHighEnd; }
inline bool is_rim_point(int part) { return part >= kFirstRimPoint; }
// The rim to which a part belongs, 0 the low one; -1: to none.
inline int rim_of(int part) {
  return is_rim(part) ? part - kLowRim : is_rim_point(part) ? (part - kFirstRimPoint) / kRimPointsOfPart : -1;
}
}  // namespace cylinder_part

// Local minima of the signed distance f of the surface over the parts of the cylinder: along each rim, inside of its
// side, and inside of its ends. With the curvature A of the surface (FunctionSurface::bend) f has the Hessian
// A (1 + f A)^-1, to which a circle adds what it bends away. On a rim f is least along that alone: of a cylinder that
// lies or tips on a plane the far rim has a gap of its own, and of one that stands all around fixed points of the rim
// do. Newton's method as in CommonNormals, from each cell of the surface that is near enough and whose normals allow
// it, from a place on each part.
class CylinderNormals {
 public:
  // The cylinder at R x + t in the frame of the surface.
  CylinderNormals(const SearchedSurface& surface, const Cylinder& cylinder, const Mat3& R, const Vec3& t)
      : surface_(&surface), cylinder_(cylinder), R_(R), t_(t) {}

  // As those of CommonNormals; parts of the cylinder go on beyond their borders in near(), and not in all().
  void all(const std::vector<CommonNormal>& known, double reach, std::vector<CommonNormal>& found,
           std::vector<int>& number) const;
  bool near(const CommonNormal& known, CommonNormal& found) const;
  // In the frame of the surface, how its normal turns.
  bool bend(const CommonNormal& at, Mat3& first) const;
  double size() const;  // of a cell, across, and no more than that of the cylinder [m]
  const Cylinder& cylinder() const { return cylinder_; }
  // How far a common normal is from the border of its part, negative beyond it [m]. Beyond that of a rim the distance
  // falls on the side or the end, to a place there: infinite where these are too flat to have one.
  double depth(const CommonNormal& c) const;
  // The common normal at the other side of the cylinder than one on a rim: where that falls flat it is the last one to
  // touch. False: it does not fall flat.
  bool across(const CommonNormal& of_rim, CommonNormal& found) const;
  // How far a point in the frame of the surface is from the cylinder [m], 0 inside.
  double distance(const Vec3& point) const;
  // How far it lies within, negative outside [m].
  double inside(const Vec3& point) const;

 private:
  class Search;
  using Place = SearchedSurface::Place;
  using Part = SearchedSurface::Part;

  Vec3 placed(const Vec3& x) const { return R_ * x + t_; }
  Vec3 local(const Vec3& y) const { return R_.transpose() * (y - t_); }
  // The height of a rim or an end.
  double height(int part) const {
    return part == cylinder_part::kHighRim || part == cylinder_part::kHighEnd ? cylinder_.half : -cylinder_.half;
  }
  bool is_overlap(const CommonNormal& c) const;
  // Towards the side and the end from a place on a rim: how far the normal is inside of those of the rim, a sine, and
  // how the distance bends that way.
  struct Border {
    double inside, bend;
  };
  std::array<Border, 2> borders(const Search& s) const;
  bool is_beyond(const Search& s) const;
  double distance_bound() const;
  double least_gap(const Part& cell) const;
  void starts_at(int part, const Part& cell, double limit, std::vector<Vec3>& starts) const;
  bool rim_point(int rim, int k, const CommonNormal& next_to, CommonNormal& found) const;
  void replace_flat_rims(FoundNormals& list) const;
  bool is_spanned(const CommonNormal& c, const std::vector<CommonNormal>& found) const;

  const SearchedSurface* surface_;
  Cylinder cylinder_;
  Mat3 R_;  // the cylinder's frame in that of the surface
  Vec3 t_;
};

}  // namespace contactvi
