// The contact problem of problem.hpp for the interior point method: unknown are the velocities of the rows.
#pragma once

#include <vector>

#include "base/small_linear.hpp"
#include "cone/block_law.hpp"
#include "cone/problem.hpp"

namespace contactvi {

// Contacts whose impulse is given (joint friction in a frozen direction) are not among its contacts; those that slip in
// a frozen direction have one impulse, which acts along the normal and against the slip.
class DenseSystem {
 public:
  void reserve(int rows);
  void start(const ConeProblem& problem);

  int contacts() const { return static_cast<int>(laws_.size()); }
  int dofs() const { return static_cast<int>(problem_->b.size()); }
  const ConeProblem& problem() const { return *problem_; }
  const BlockContact& contact(int c) const { return laws_[c]; }
  const ContactMatrix& matrix(int c) const { return matrices_[c]; }  // its symmetric part
  double largest(int c) const { return matrices_[c].largest; }
  double scale() const { return scale_; }  // largest speed of a row without impulses [m/s]

  Vec3 speed(int c, const VecX& w) const;  // the rows of one contact
  Vec3 velocity(int c, const VecX& w) const { return speed(c, w); }
  // What an impulse of a contact is in the rows of the problem: impulses += d, w += G d.
  void pull(int c, const Vec3& d, VecX& impulses) const;
  void push(int c, const Vec3& d, VecX& w) const;
  Vec3 in_rows(int c, const Vec3& d) const;
  int rows(int c) const { return rows_[c]; }  // of the problem
  void update(ConePoint& point) const;        // v = b + G lambda
  void project(ConePoint& point) const;       // lambda onto the cones, and update
  double residual(const ConePoint& point) const;

  // Impulses of all rows (rows,) to those of the contacts and back; given ones stay.
  void read(const double* impulses, ConePoint& point) const;
  void write(const ConePoint& point, double* impulses) const;

 private:
  const ConeProblem* problem_ = nullptr;
  std::vector<BlockContact> laws_;
  std::vector<ContactMatrix> matrices_;
  std::vector<int> rows_;
  std::vector<Vec3> rays_;  // of the normal impulse in the rows
  VecX free_;               // velocity of the rows at the given impulses
  mutable VecX impulses_;
  double scale_ = 1.0;
};

// LU of I + G K, K a 3 x 3 matrix per contact.
class DenseFactor {
 public:
  void reserve(int rows) { linear_.reserve(rows); }
  // False if it is singular or the numbers are not finite.
  bool factor(const DenseSystem& system, const std::vector<Mat3>& K, bool symmetric);
  // x (rows,): impulses on entry; on return the velocities that they make, (I + G K)^-1 G x. False if not finite.
  bool solve(VecX& x);

 private:
  const ConeProblem* problem_ = nullptr;
  SmallLinear linear_;
  VecX right_;
};

}  // namespace contactvi
