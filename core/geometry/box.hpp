// Bounding boxes along the axes of the world.
#pragma once

#include "model/placement.hpp"
#include "model/scene.hpp"

namespace contactvi {

struct Box {
  Vec3 center, half;  // [m]

  Box fattened(double margin) const { return {center, half + Vec3::Constant(margin)}; }
};

// How far two boxes are apart along the axis where they are farthest [m], negative if they overlap: a lower bound on
// the distance of what is in them.
inline double separation(const Box& a, const Box& b) {
  return ((a.center - b.center).cwiseAbs() - a.half - b.half).maxCoeff();
}

// The direction of that axis from a to b.
inline Vec3 separating_axis(const Box& a, const Box& b) {
  const Vec3 line = b.center - a.center;
  int axis = 0;
  (line.cwiseAbs() - a.half - b.half).maxCoeff(&axis);
  Vec3 direction = Vec3::Zero();
  direction[axis] = line[axis] < 0.0 ? -1.0 : 1.0;
  return direction;
}

// Of a geometry that is no halfspace, with its body as placed. Also of its rounded shape, which reaches as far along
// the axes of the geometry.
Box box_of(const Geometry& geometry, const Placements& at);

// Smallest distance of a box from a halfspace as placed [m], negative below its face.
double separation(const Box& box, const Geometry& halfspace, const Placements& at);

}  // namespace contactvi
