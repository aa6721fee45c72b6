// Surfaces whose feet are searched for in the cells of a grid.
#pragma once

#include <cmath>
#include <utility>
#include <vector>

#include "model/box_tree.hpp"
#include "model/function_surface.hpp"

namespace contactvi {

class SearchedSurface : public FunctionSurface {
 public:
  // size: of a cell, across [m].
  SearchedSurface(double size, Lost lost) : FunctionSurface(std::move(lost)), size_(size), tree_({}) {}

  double reliable_share() const override { return 1.0; }
  bool knows_all_feet() const override { return true; }

  // A place on the surface, its outward normal, and how that turns along the surface, as bend().
  struct Place {
    Vec3 at, normal;
    Mat3 bend;
  };
  // The foot of a point to which the distance falls from a start near the surface. False: none is found.
  virtual bool foot_place(const Vec3& point, const Vec3& start, Place& foot) const = 0;
  // Whether a point lies in the solid. Not where that is not known.
  virtual bool is_inside(const Vec3& point) const = 0;

  // The part of the surface in a cell: no farther than `reach` from a place next to it, where it turns by `bend`, and
  // with normals that differ from `normal` by no more than an angle, of which `spread` is a bound on the sine;
  // infinite: none is known.
  struct Part {
    Vec3 place, normal;
    Mat3 bend;
    double reach, spread;

    // How far it may be from the plane through the place, across the normal [m]; infinite: not known.
    double sag() const { return spread < 1.0 ? reach * spread / std::sqrt(1.0 - spread * spread) : spread; }
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

 protected:
  // Of normals that differ by more than this nothing is concluded: the sine of an angle.
  static constexpr double kMostSpread = 0.7;
  void set_parts(const std::vector<BoxTree::Box>& boxes, std::vector<Part> parts);

 private:
  double size_;
  std::vector<Part> parts_;
  BoxTree tree_;
  std::vector<Cone> cones_;
};

// The Hessian of the signed distance, at the distance f from a surface that turns by A at the foot.
inline Mat3 curvature_at(const Mat3& A, double f) { return A * (Mat3::Identity() + f * A).inverse(); }

}  // namespace contactvi
