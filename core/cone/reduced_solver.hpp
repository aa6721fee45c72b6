// The contact problem of many bodies (block_problem.hpp) in the velocities that contacts can change,
//
//   v = S u + held     with the masses S^T M S and the rows S^T W in u; held is orthogonal to S by the masses.
//
// Equations, W_e^T v = W_e^T v_free for multipliers of their own, leave a basis of velocities, W_e^T S = 0, per group
// of blocks that they join. They may be redundant. Of a large block on which few rows act, as of a robot on its feet,
// the velocities that these do not reach are held as well: S is then a basis of M^-1 W with S^T M S = 1, and the
// problem is no larger than its rows. Where neither is so it is the BlockSolver itself.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <array>
#include <vector>

#include "cone/block_solver.hpp"

namespace contactvi {

class ReducedSolver {
 public:
  // Takes the equations, rows as the columns of W (nv, m), and the masses of the problem. m = 0: none.
  void set_equations(const BlockProblem& problem, const Eigen::Ref<const MatX>& W);
  // v <- the velocity next to v, by the masses, with W^T v = rate.
  void project(const VecCRef& rate, VecRef v) const;
  // The least impulses mu of the equations with W mu = p, as far as there are any.
  VecX multipliers(const VecCRef& p) const;

  // As those of BlockSolver, with the velocities of the whole problem. The masses are those of set_equations.
  void prepare(const BlockProblem& problem);
  BlockResult solve(const BlockProblem& problem, double bound, const BlockOptions& options, VecRef lambda, VecRef v);
  BlockResult solve_normals(const BlockProblem& problem, double tolerance, VecRef lambda, VecRef v);
  void free_velocity(const BlockProblem& problem, VecCRef lambda, VecCRef v, VecRef v_free);

 private:
  // Blocks that equations join.
  struct Group {
    std::vector<int> blocks, dofs, equations;
    // Of the equations: their rows scaled to length one, (dofs, equations), and a basis N of the velocities that they
    // leave, with M N, N^T M N and its factor. Without equations N is the unit matrix.
    VecX scale;
    MatX rows, N, MN, NMN;
    Eigen::CompleteOrthogonalDecomposition<MatX> decomposed;
    Eigen::LLT<MatX> masses;
    int touching = 0;           // rows of contacts
    int first = 0, block = -1;  // in the reduced problem; -1: nothing there can change
    bool few = false;           // S = N C Q with C C^T = (N^T M N)^-1, C^T N^T W = Q R; else S = N
    Eigen::LLT<MatX> inverse;   // C
    Eigen::HouseholderQR<MatX> reached;
    bool free() const { return equations.empty(); }
    bool whole() const { return free() && !few; }  // S is the unit matrix
    VecX coordinates(const VecX& v) const;         // u
    VecX velocity(const VecX& u) const;            // S u
  };
  struct Side {  // of a contact: its group and rows there, in the basis N
    int group = -1;
    MatX rows;
    int column = 0;  // first of them among all rows of contacts there
  };
  bool any() const { return equations_ > 0; }
  void find_groups(const BlockProblem& problem, const Eigen::Ref<const MatX>& W);
  void find_basis(const BlockProblem& problem, const Eigen::Ref<const MatX>& W, Group& group);
  MatX times_masses(const BlockProblem& problem, const Group& group, const MatX& X) const;
  bool find_sides(const BlockProblem& problem, const BlockContact& c, Side (&sides)[2]) const;
  void choose(const BlockProblem& problem, Group& group, int number);
  void add_contact(const BlockContact& c, int number);
  void split(const VecCRef& v);
  void join(VecRef v) const;
  void begin(const BlockProblem& problem, const VecCRef& lambda, const VecCRef& v);
  void finish(const BlockProblem& problem, VecRef lambda, VecRef v) const;
  double held_energy(const BlockProblem& problem) const;

  BlockSolver solver_;
  int equations_ = 0;
  bool reduces_ = false;
  std::vector<Group> groups_;
  std::vector<int> group_of_;               // of each block of the problem
  std::vector<std::array<Side, 2>> sides_;  // of the contacts that are kept
  BlockProblem reduced_;
  std::vector<int> kept_, idle_;  // contacts of the reduced problem; joint friction that moves nothing
  VecX held_, u_, lambda_;        // v = S u + held; impulses of the reduced problem
};

}  // namespace contactvi
