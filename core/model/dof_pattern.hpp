// Which degrees of freedom (dofs) act on each other: entries (row, column) of the derivatives of forces and momenta.
//
// In a tree those are the pairs of which one dof carries the other: Featherstone's branch-induced sparsity (Rigid Body
// Dynamics Algorithms, 6.4). Elimination from the leaves to the roots fills nothing in. Forces between the branches
// couple all dofs: then the pattern is that of a single chain, which is a full matrix.
#pragma once

#include <vector>

#include "model/tree.hpp"

namespace contactvi {

class DofPattern {
 public:
  explicit DofPattern(const Tree& tree);

  int dofs() const { return static_cast<int>(level_.size()); }
  // Pairs (d, a) of a dof and one on its path to the root, itself included. Each has a number; that of (d, d) is the
  // last of its dof.
  int entries() const { return static_cast<int>(path_.size()); }
  // How many dofs the path of d has before d itself, and the one at a level of it.
  int level(int d) const { return level_[d]; }
  int on_path(int d, int level) const { return path_[first_[d] + level]; }
  int entry(int d, int level) const { return first_[d] + level; }
  int diagonal(int d) const { return first_[d] + level_[d]; }
  // Dofs on the longest path.
  int depth() const { return depth_; }
  // Where the pair of a row and a column is found: low: the row's dof is that of the entry.
  struct Pair {
    bool low;
    int entry;
  };
  Pair pair(int row, int column) const {
    const int r = level_[row], c = level_[column];
    return r >= c ? Pair{true, entry(row, c)} : Pair{false, entry(column, r)};
  }
  // Dofs that act on each other, directly or through others, ascending.
  const std::vector<std::vector<int>>& components() const { return components_; }
  // Number of a dof in its component.
  int place(int d) const { return place_[d]; }

 private:
  int depth_ = 0;
  std::vector<int> level_, first_, path_, place_;
  std::vector<std::vector<int>> components_;
};

}  // namespace contactvi
