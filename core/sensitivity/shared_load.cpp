#include "sensitivity/shared_load.hpp"

namespace contactvi {

namespace {
// Of the scaled rows, whose largest entries are 1: singular values below are rounding, from rows that depend on each
// other. Rows of the points of one face are known to 1e-14.
constexpr double kDependent = 1e-10;
constexpr double kContradiction = 1e-8;  // residual of dependent rows, of the terms of their right sides
}  // namespace

void SharedLoad::compute(const MatX& A) {
  rank_ = 0;
  A_ = free_ = A;
  if (A.size() == 0) return;
  scale_ = A.rowwise().lpNorm<Eigen::Infinity>();
  for (double& s : scale_) s = s > 0.0 ? 1.0 / s : 1.0;
  A_ = scale_.asDiagonal() * A;
  svd_.compute(A_, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const VecX& values = svd_.singularValues();
  while (rank_ < values.size() && values[rank_] > kDependent * values[0]) ++rank_;
  free_ = svd_.matrixV().rightCols(A.cols() - rank_);
}

bool SharedLoad::solve(const VecX& c, const VecX& size, VecX& x) const {
  x = c;
  if (c.size() == 0) return true;
  const VecX right = -scale_.cwiseProduct(c);
  const VecX along =
      (svd_.matrixU().leftCols(rank_).transpose() * right).cwiseQuotient(svd_.singularValues().head(rank_));
  x = svd_.matrixV().leftCols(rank_) * along;
  return rank_ == A_.rows() || (A_ * x - right).norm() <= kContradiction * scale_.cwiseProduct(size).norm();
}

VecX SharedLoad::solve_transposed(const VecX& lx) const {
  if (lx.size() == 0) return lx;
  const VecX along = (svd_.matrixV().leftCols(rank_).transpose() * lx).cwiseQuotient(svd_.singularValues().head(rank_));
  return -scale_.cwiseProduct(svd_.matrixU().leftCols(rank_) * along);
}

}  // namespace contactvi
