// Where the surfaces of two solids are nearest to each other, or overlap most: their common normals.
#pragma once

#include <vector>

#include "model/common_normal.hpp"
#include "model/implicit_surface.hpp"

namespace contactvi {

// The first surface: of a solid or a height field, or null: the plane normal . x = offset.
struct FirstSurface {
  const SearchedSurface* surface;
  Vec3 normal;
  double offset;
};

// Local minima of the signed distance f of the first surface over the second one. With the curvatures A and B of the
// two (FunctionSurface::bend), both in one frame, f has the Hessian A (1 + f A)^-1 + B in the common tangent plane: it
// is that of the distance between the surfaces over f where they are apart, and goes on where they touch and overlap.
// Newton's method in the tangent plane of the second surface, with the eigenvalues of the Hessian made positive
// (Nocedal, Wright, "Numerical optimization", 2006, section 3.4), each step followed by a return onto that surface and
// a search for the foot on the first one. Searches begin at the pairs of cells that are near enough, whose normals may
// be opposite to each other (Johnson, Cohen, "Spatialized normal cone hierarchies", Symposium on Interactive 3D
// Graphics 2001), and in whose neighbourhood the quadratic surfaces through their middles have a common normal.
class CommonNormals {
 public:
  CommonNormals(const FirstSurface& first, const ImplicitSurface& second, const Mat3& R, const Vec3& t)
      : first_(first), second_(&second), R_(R), t_(t) {}

  // The least one, and those with a gap up to `reach` [m]. Those that `known` ones have become come first and in that
  // order, and only once; number: which of the known ones each of them is, -1: none. Empty: none is found.
  void all(const std::vector<CommonNormal>& known, double reach, std::vector<CommonNormal>& found,
           std::vector<int>& number) const;
  // That to which the distance falls from a known one. False: it falls to none.
  bool near(const CommonNormal& known, CommonNormal& found) const;

  // In the frame of the first surface, how both normals turn, as FunctionSurface::bend.
  bool bends(const CommonNormal& at, Mat3& first, Mat3& second) const;

 private:
  class Search;
  using Place = SearchedSurface::Place;

  double size() const {
    return first_.surface == nullptr ? second_->size() : std::min(first_.surface->size(), second_->size());
  }
  bool foot(const Vec3& point, const Vec3& start, Place& place) const;
  Vec3 placed(const Vec3& x) const { return R_ * x + t_; }
  bool is_overlap(const CommonNormal& c) const;
  bool may_hold(const SearchedSurface::Part& a, const SearchedSurface::Part& b, double limit) const;
  double least_gap(const SearchedSurface::Part& a, const SearchedSurface::Part& b) const;
  // Over the plane that is the first surface: of a place on the second one, and of a box in its frame at least.
  double height(const Vec3& x) const;
  double lowest(const BoxTree::Box& box) const;
  double distance_bound() const;
  bool may_face(std::size_t node, std::size_t other) const;
  enum class Guess : std::uint8_t { kNone, kKnown, kPossible };
  Guess guess(const SearchedSurface::Part& a, const SearchedSurface::Part& b,
              const std::vector<CommonNormal>& found) const;

  FirstSurface first_;
  const ImplicitSurface* second_;
  Mat3 R_;  // the second frame in the first one
  Vec3 t_;
};

}  // namespace contactvi
