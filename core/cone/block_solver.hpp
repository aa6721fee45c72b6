// Solver of the contact problem of many bodies (block_problem.hpp) with a bounded budget and an admissible answer.
//
// Stages, each from the best answer so far:
//   A  Gauss-Seidel sweeps with the exact solution of one contact
//   B  semismooth Newton steps on the natural map of the whole law
//   C  an interior point method for the whole law, then B again; not with turning friction
//   D  where gaps are not kept: the normal impulses anew for tangential impulses that stay, a convex problem
//   E  where the answer gains energy: the one between it and a safe one that just does not
// D and E bound what is returned, not how far it is from the law, which `residual` says.
#pragma once

#include <memory>

#include "cone/block_problem.hpp"

namespace contactvi {

struct BlockOptions {
  double tolerance = 1e-8;  // residual at which the solver stops, relative to the largest free speed of a contact
  double accept = 1e-6;     // residual from which the interior point is not worth its time, and gaps that count as kept
  int sweeps = 50, newton_steps = 8, factors = 60;  // stage A, B, and of B and C together
};

struct BlockResult {
  enum class Stage { kSweeps, kNewton, kInteriorPoint, kRepaired, kBlended, kFailed };
  Stage stage = Stage::kFailed;
  double residual = 0.0;                   // natural map of the law, over the scale of speeds
  double scale = 0.0;                      // of speeds [m/s], block_system.hpp (scale)
  double violation = 0.0;                  // -min(w_n) where that is positive [m/s]
  double energy = 0.0, free_energy = 0.0;  // T(v), T(v_free) [J]
  double blend = 1.0;                      // share of the repaired answer in the returned one
  int sweeps = 0, factors = 0;
  bool admissible() const { return stage != Stage::kFailed; }
};

class BlockSolver {
 public:
  BlockSolver();
  ~BlockSolver();
  BlockSolver(const BlockSolver&) = delete;
  BlockSolver& operator=(const BlockSolver&) = delete;

  // Factors the masses and the contacts' own matrices. The problem must stay; v_free, offset, lower, mu and box may
  // change between solves, W and M and the contacts' blocks may not.
  void prepare(const BlockProblem& problem);
  // lambda (rows,): start on entry [N s], projected onto the cone; the answer on return. v (nv,): v_free + M^-1 W
  // lambda. bound: the kinetic energy that v may have [J]; it is raised to that of the safe answer of stage E if that
  // has more.
  BlockResult solve(const BlockProblem& problem, double bound, const BlockOptions& options, VecRef lambda, VecRef v);
  // Stage D alone: tangential impulses and box rows stay as in lambda, the normal ones become the solution of
  //   lambda_n >= max(lower, |lambda_t|/mu), w_n >= 0, complementary.
  // A warm start with few changes costs some sweeps and no factorization.
  BlockResult solve_normals(const BlockProblem& problem, double tolerance, VecRef lambda, VecRef v);
  // The free velocity from which the impulses lambda lead to v, with the solver's own masses to the last bit: those of
  // light and heavy bodies in one block differ from others by much rounding.
  void free_velocity(const BlockProblem& problem, VecCRef lambda, VecCRef v, VecRef v_free) const;

 private:
  struct Work;
  std::unique_ptr<Work> work_;
};

}  // namespace contactvi
