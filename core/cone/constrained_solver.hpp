// The contact problem of many bodies (block_problem.hpp) whose velocities obey equations,
//
//   v = v_free + M^-1 (W lambda + W_e mu),   W_e^T v = W_e^T v_free,   the laws of block_problem.hpp for lambda
//
// by elimination: v = S u + held with a basis S of the velocities that the equations leave free, W_e^T S = 0, per group
// of blocks that equations join. In u it is a contact problem without equations, with the masses S^T M S and the rows
// S^T W; `held` is the part of v_free that is orthogonal to S by the masses, and moves the rows like a conveyor.
// Equations may be redundant. Without equations it is the BlockSolver itself.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <vector>

#include "cone/block_solver.hpp"

namespace contactvi {

class ConstrainedSolver {
 public:
  // Takes the equations, rows as the columns of W (nv, m), and the masses of the problem. m = 0: none.
  void set_equations(const BlockProblem& problem, const Eigen::Ref<const MatX>& W);
  // v <- the velocity next to v, by the masses, with W^T v = rate.
  void project(const VecCRef& rate, VecRef v) const;
  // The least impulses mu of the equations with W mu = p, as far as there are any.
  VecX multipliers(const VecCRef& p) const;

  // As those of BlockSolver, with the velocities of the whole problem. The masses are those of set_equations. bound: of
  // the energy of the velocities whose rows of equations are zero.
  void prepare(const BlockProblem& problem);
  BlockResult solve(const BlockProblem& problem, double bound, const BlockOptions& options, VecRef lambda, VecRef v);
  BlockResult solve_normals(const BlockProblem& problem, double tolerance, VecRef lambda, VecRef v);
  void free_velocity(const BlockProblem& problem, VecCRef lambda, VecCRef v, VecRef v_free);

 private:
  // Blocks that equations join: their degrees of freedom, and a basis of their free velocities.
  struct Group {
    std::vector<int> blocks, dofs, equations;
    int first = 0, block = -1;  // in the reduced problem; without free velocities it has no block there
    MatX S, MS;                 // (dofs, free velocities): basis; masses times it
    VecX scale;                 // of the equations
    MatX rows;                  // (dofs, equations), scaled
    Eigen::CompleteOrthogonalDecomposition<MatX> W;  // of them
    Eigen::LLT<MatX> masses;                         // S^T M S
  };
  bool any() const { return equations_ > 0; }
  void find_groups(const BlockProblem& problem, const Eigen::Ref<const MatX>& W);
  void find_basis(const BlockProblem& problem, const Eigen::Ref<const MatX>& W, Group& group);
  void split(const VecCRef& v);
  void join(VecRef v) const;
  void add_contact(const BlockProblem& problem, int i);
  void begin(const BlockProblem& problem, const VecCRef& lambda, const VecCRef& v);
  void finish(const BlockProblem& problem, VecRef lambda, VecRef v) const;

  BlockSolver solver_;
  int equations_ = 0;
  std::vector<Group> groups_;
  std::vector<int> group_of_;  // of each block of the problem
  BlockProblem reduced_;
  std::vector<int> kept_, idle_;  // contacts of the reduced problem; joint friction that moves nothing
  VecX held_, u_, lambda_;        // v = S u + held; impulses of the reduced problem
};

}  // namespace contactvi
