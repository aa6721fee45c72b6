// The surface of a level set, with its true distances.
#pragma once

#include <memory>
#include <vector>

#include "model/box_tree.hpp"
#include "model/function_surface.hpp"
#include "model/level_set.hpp"

namespace contactvi {

// A foot of a point x is a place p on the surface where |p - x|^2 / 2 is least: Newton's method with damping in the
// tangent plane, each step followed by one of Newton's method back onto the surface along the gradient (Absil, Mahony,
// Sepulchre, "Optimization algorithms on matrix manifolds", 2008, chapters 4 and 6). Searches begin in each cell of a
// grid that the surface passes through and that is near enough to matter: what is thinner than a cell may be missed.
class ImplicitSurface final : public FunctionSurface {
 public:
  // Inverse: the solid is where the level set is positive.
  ImplicitSurface(std::unique_ptr<const LevelSet> level, bool inverse, const BoxTree::Box& box,
                  const Eigen::Vector3i& cells, Lost lost);

  Mat3 bend(const Vec3& point, const Vec3& place) const override;
  double reliable_share() const override { return 1.0; }
  bool knows_all_feet() const override { return true; }
  void all_feet(const Vec3& point, double reach, std::vector<SurfaceFoot>& feet) const override;
  SurfaceFoot foot_near(const Vec3& point, const Vec3& place) const override;

  // A place on the surface, its outward normal, and how that turns along the surface, as bend().
  struct Place {
    Vec3 at, normal;
    Mat3 bend;
  };
  // The foot of a point to which the distance falls from a start near the surface. False: none is found.
  bool foot_place(const Vec3& point, const Vec3& start, Place& foot) const;
  // The place on the surface next to a point, along the gradient. False: none is found.
  bool onto(const Vec3& point, Place& place) const;
  // Not where the level set is not known.
  bool is_inside(const Vec3& point) const { return value(point).f < 0.0; }

  // The part of the surface in a cell: no farther than `reach` from a place next to it, where it turns by `bend`, and
  // with normals that differ from `normal` by no more than an angle, of which `spread` is a bound on the sine;
  // infinite: none is known.
  struct Part {
    Vec3 place, normal;
    Mat3 bend;
    double reach, spread;
  };
  const std::vector<Part>& parts() const { return parts_; }
  const BoxTree& tree() const { return tree_; }  // of the boxes of the parts
  // Of each node of the tree: normals of its parts differ from the axis by no more than the angle [rad].
  struct Cone {
    Vec3 axis;
    double angle, cosine, sine;
  };
  const std::vector<Cone>& cones() const { return cones_; }
  double size() const { return size_; }

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
  double sign_, size_;  // size: of a cell, across [m]
  std::vector<BoxTree::Box> boxes_;
  std::vector<Part> parts_;
  BoxTree tree_;
  std::vector<Cone> cones_;
};

}  // namespace contactvi
