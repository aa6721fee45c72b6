// A block with vertical sides whose top is a smooth height field.
#pragma once

#include <vector>

#include "model/searched_surface.hpp"

namespace contactvi {

// z = f(x, y) over a rectangle, a bicubic spline: a sum of products of cubic B-splines, twice continuously
// differentiable, within the range of its coefficients in each cell (de Boor, "A practical guide to splines", 2001,
// chapters IX and XVII). The solid lies below, down without end.
//
// The feet of a point on the top are where |(u, f(u)) - x|^2 / 2 is least within the rectangle: by Newton's method with
// damping, held to the rectangle (Bertsekas, "Projected Newton methods", SIAM J. Control Optim. 20, 1982), from the
// middle of each cell whose box is near enough to matter and whose slopes may hold a foot. A foot on the border of the
// top is one of an edge. Beside the block, and lower than its border there, the foot is on the side.
class HeightField final : public SearchedSurface {
 public:
  using Vec2 = Eigen::Vector2d;
  using Mat2 = Eigen::Matrix2d;

  // coefficients: of B-spline (i, j) centred at corner + ((i - 1) spacing_x, (j - 1) spacing_y), two more along each
  // axis than there are samples.
  HeightField(MatX coefficients, const Vec2& corner, const Vec2& spacing, Lost lost);

  Mat3 bend(const Vec3& point, const Vec3& place) const override;
  void all_feet(const Vec3& point, double reach, std::vector<SurfaceFoot>& feet) const override;
  SurfaceFoot foot_near(const Vec3& point, const Vec3& place) const override;
  // Of feet on the top, not on its border.
  bool foot_place(const Vec3& point, const Vec3& start, Place& foot) const override;
  bool is_inside(const Vec3& point) const override { return !is_outside(point); }
  // The rectangle of the top, and places all along its border.
  const Vec2& low() const { return low_; }
  const Vec2& high() const { return high_; }
  const std::vector<Vec3>& border() const { return border_; }
  double highest() const { return tree().nodes()[0].max()[2]; }

  struct Height {
    double f;
    Vec2 slope;
    Mat2 bend;
  };
  // At a place within the rectangle.
  Height at(const Vec2& u) const;

 private:
  class Search;
  struct Slopes {
    Vec2 least, most;
  };

  void find(const Vec3* points, int count, double ball, SurfaceFoot* feet) const override;
  Vec2 held(const Vec2& u) const { return u.cwiseMax(low_).cwiseMin(high_); }
  bool is_outside(const Vec3& point) const;
  // Whether the foot of a point is on a vertical side.
  bool beside(const Vec3& point, SurfaceFoot& foot) const;
  SurfaceFoot nearest_side(const Vec3& point) const;
  bool holds(int cell, const Vec2& u) const;
  // Whether a point may have a foot in a cell, by the ranges of height and slope there.
  bool may_hold(int cell, const Vec3& point) const;
  Vec2 middle_of(int cell) const;
  // Places in the cell from which feet on the border are searched for, near a place; none within the rectangle.
  std::vector<Vec2> border_starts(int cell, const Vec2& u) const;
  std::vector<BoxTree::Box> boxes() const;
  std::vector<Slopes> slopes() const;
  Part part_in(int cell) const;
  std::vector<Vec3> places_on_border() const;

  MatX coefficients_;
  Vec2 low_, high_, spacing_;
  int cells_x_, cells_y_;
  std::vector<Slopes> slopes_;  // of each cell
  std::vector<BoxTree::Box> boxes_;
  std::vector<Vec3> border_;
};

}  // namespace contactvi
