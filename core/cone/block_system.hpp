// A prepared block problem: M^-1 W^T of each contact, the contacts' own matrices, and the products that the stages of
// the solver need.
#pragma once

#include <vector>

#include "cone/block_law.hpp"
#include "cone/block_problem.hpp"
#include "cone/turning_law.hpp"

namespace contactvi {

class BlockSystem {
 public:
  // Reads masses, contacts and W; false if they are not finite, a mass is not positive or the rows do not fit together.
  bool prepare(const BlockProblem& problem);
  // Reads what may change between solves, and the scale of speeds; false if it is not finite.
  bool start(const BlockProblem& problem);

  int contacts() const { return static_cast<int>(matrices_.size()); }
  int dofs() const { return static_cast<int>(problem_->v_free.size()); }
  const BlockProblem& problem() const { return *problem_; }
  const BlockContact& contact(int c) const { return problem_->contacts[c]; }
  const ContactMatrix& matrix(int c) const { return matrices_[c]; }
  double largest(int c) const { return matrices_[c].largest; }  // of the diagonal of a contact's own matrix [1/kg]
  // Scale of speeds [m/s], positive: the largest |W^T v_free| in a row, which is g h at rest; where something is asked
  // for, overlaps (-offset) and what lower bounds of impulses move.
  double scale() const { return scale_; }
  bool bounded() const { return bounded_; }  // some contact has a lower bound of its normal impulse

  // Points with friction against spinning and rolling: their numbers, and of the k-th its six rows.
  const std::vector<int>& turning_points() const { return turning_points_; }
  const TurningMatrix& turning_matrix(std::size_t k) const { return turning_matrices_[k]; }
  Vec6 turning_impulse(int c, const ConePoint& point) const;
  void set_turning_impulse(int c, const Vec6& lambda, ConePoint& point) const;
  Vec6 turning_velocity(int c, const VecX& v) const;
  void sweep_turning(ConePoint& point) const;  // as sweep.hpp does the others

  // W^T v and W^T v + offset of one contact.
  Vec3 speed(int c, const VecX& v) const;
  Vec3 velocity(int c, const VecX& v) const;
  double normal_speed(int c, const VecX& v) const;  // their first rows
  double normal_velocity(int c, const VecX& v) const;
  // v += M^-1 W^T d, and f += W^T d, for one contact.
  void push(int c, const Vec3& d, VecX& v) const;
  void push_normal(int c, double d, VecX& v) const;
  void pull(int c, const Vec3& d, VecX& f) const;

  void update(ConePoint& point) const;   // v = v_free + M^-1 W^T lambda
  void project(ConePoint& point) const;  // lambda onto the cone, and update
  double residual(const ConePoint& point) const;
  double energy(const VecX& v) const { return 0.5 * product(v, v); }  // kinetic [J]
  double product(const VecX& x, const VecX& y) const;                 // x.M y [J]
  double worst_gap(const VecX& v) const;  // least normal velocity of a contact, at most 0 [m/s]

 private:
  struct Place {
    int a = 0, size_a = 0, b = 0, size_b = 0;  // first degree of freedom and their number, of both blocks
    int rows = 0, row = 0, column = 0;
  };
  static bool check_masses(const BlockProblem& problem);
  bool place(const BlockProblem& problem);
  void mobility(const BlockProblem& problem);
  void turning_mobility(const BlockProblem& problem, double floor);
  void add(const double* values, int c, int rows, const Vec3& d, VecX& x) const;

  const BlockProblem* problem_ = nullptr;
  std::vector<Place> places_;
  std::vector<double> response_;  // M^-1 W^T, laid out as W
  std::vector<ContactMatrix> matrices_;
  std::vector<int> turning_points_;
  std::vector<TurningMatrix> turning_matrices_;
  double scale_ = 1.0;
  bool bounded_ = false;
};

}  // namespace contactvi
