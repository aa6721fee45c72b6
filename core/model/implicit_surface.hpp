// The surface of a level set, with its true distances.
#pragma once

#include <memory>
#include <vector>

#include "model/level_set.hpp"
#include "model/searched_surface.hpp"

namespace contactvi {

// A foot of a point x is a place p on the surface where |p - x|^2 / 2 is least: Newton's method with damping in the
// tangent plane, each step followed by one of Newton's method back onto the surface along the gradient (Absil, Mahony,
// Sepulchre, "Optimization algorithms on matrix manifolds", 2008, chapters 4 and 6). Searches begin in each cell of a
// grid that the surface passes through and that is near enough to matter: what is thinner than a cell may be missed.
class ImplicitSurface final : public SearchedSurface {
 public:
  // Inverse: the solid is where the level set is positive.
  ImplicitSurface(std::unique_ptr<const LevelSet> level, bool inverse, const BoxTree::Box& box,
                  const Eigen::Vector3i& cells, Lost lost);

  Mat3 bend(const Vec3& point, const Vec3& place) const override;
  void all_feet(const Vec3& point, double reach, std::vector<SurfaceFoot>& feet) const override;
  SurfaceFoot foot_near(const Vec3& point, const Vec3& place) const override;

  bool foot_place(const Vec3& point, const Vec3& start, Place& foot) const override;
  // The place on the surface next to a point, along the gradient. False: none is found.
  bool onto(const Vec3& point, Place& place) const;
  bool is_inside(const Vec3& point) const override { return value(point).f < 0.0; }

 private:
  class Search;

  LevelSet::Value value(const Vec3& x) const;
  bool back(Vec3& p, LevelSet::Value& v) const;
  Part part_in(const BoxTree::Box& cell) const;
  // Whether a point may have a foot in a cell that is nearer than the limit.
  bool may_hold(const Part& part, const Vec3& point, double limit) const;
  void find(const Vec3* points, int count, double ball, SurfaceFoot* feet) const override;
  std::vector<BoxTree::Box> passed(const BoxTree::Box& box, const Eigen::Vector3i& cells) const;

  std::unique_ptr<const LevelSet> level_;
  double sign_;
  std::vector<BoxTree::Box> boxes_;
};

}  // namespace contactvi
