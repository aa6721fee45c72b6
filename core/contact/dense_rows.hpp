// The contact problem of a dense step: the rows of its contacts and of joint friction, and the masses, tree by tree.
//
// Of coupled joints (model/coupling.hpp), which hold their trees together as one block, the inverse masses are
// S (S^T M S)^-1 S^T + C c C^T with some c: positive, and with rows that are projected to the velocities v = S u they
// do the same as without the second term.
#pragma once

#include <vector>

#include "cone/block_problem.hpp"
#include "contact/dense_candidates.hpp"

namespace contactvi {

class DenseRows {
 public:
  // Throws Error if the degrees of freedom of a tree do not follow each other.
  explicit DenseRows(const Scene& scene);

  // Takes the masses from solve(X): X <- M^-1 X for X (nv, k).
  template <class Solve>
  void set_masses(Solve solve) {
    set_unit_columns();
    solve(inverse_);
    take_inverse();
  }
  // The rows of the contacts `active`, at the end of the step or its start, where the bodies are placed, and of joint
  // friction with the bound of one of the two impulses of a step of length h. Offsets become zero.
  void set(const std::vector<DenseContact>& contacts, const std::vector<int>& active, bool at_end, const Placements& at,
           double h);

  // No rows.
  void clear();

  BlockProblem& problem() { return problem_; }
  const BlockProblem& problem() const { return problem_; }
  const BlockContact& block(std::size_t k) const { return problem_.contacts[k]; }
  // First block of joint friction. Before it are those of the contacts, then those of their turning friction.
  std::size_t first_joint() const { return first_joint_; }
  // Velocity of row r of block k, without its offset.
  double velocity(std::size_t k, int r, const VecX& v) const { return row_velocity(problem_, block(k), r, v); }
  // p += W lambda.
  void add_impulses(const VecX& lambda, VecX& p) const;
  // W_n M^-1 W_n^T of block k [1/kg].
  double mobility(std::size_t k) const;

 private:
  void set_unit_columns();
  void take_inverse();
  void project(const BlockContact& c);
  BlockContact& add_block(int a, int b, int rows);
  void add_contact(const DenseContact& c, bool at_end, const Placements& at);
  void add_turning(const DenseContact& c, int of, bool at_end, const Placements& at);
  template <class Fill>
  void add_rows(const BlockContact& c, int body, const Fill& fill);

  const Scene* scene_;
  BlockProblem problem_;
  std::vector<int> tree_of_joint_;
  MatX inverse_;                    // (nv, largest block): the inverse masses, block under block
  MatX body_rows_;                  // (nv, 3)
  MatX spare_inverse_;              // C c C^T but for a factor, (nv, nv); empty: no joints are coupled
  std::vector<double> whole_rows_;  // as BlockProblem::W, before they were projected
  int rows_ = 0, columns_ = 0;
  std::size_t first_joint_ = 0;
};

}  // namespace contactvi
