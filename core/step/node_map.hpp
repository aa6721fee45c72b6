// Changes of the momentum at a state (q, v) as changes of its velocity: dv = M^-1 (dp - B dq), B = d(M v)/dq. Engine
// coordinates.
#pragma once

#include "step/local_tangent.hpp"
#include "step/tree_blocks.hpp"

namespace contactvi {

class NodeMap {
 public:
  explicit NodeMap(const Tree& tree);

  // False where elimination in the mass matrix loses too many digits.
  bool take(const VecX& q, const VecX& v);
  // dp, (nv, count), becomes dv; dq: of the same shape.
  void to_velocities(const MatX& dq, MatX& dp);

 private:
  void fold_masses();

  const Tree* tree_;
  FlatModel model_;
  DofPattern pattern_;
  LocalTangent local_;
  TreeBlocks mass_;
  AlignedArray panel_;
};

}  // namespace contactvi
