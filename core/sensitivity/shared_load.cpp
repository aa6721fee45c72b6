#include "sensitivity/shared_load.hpp"

#include <Eigen/QR>
#include <cmath>

namespace contactvi {

namespace {
// Of the scaled rows, whose largest entries are 1: singular values below are rounding, from rows that depend on each
// other. Rows of the points of one face are known to 1e-14.
constexpr double kDependent = 1e-10;
constexpr double kContradiction = 1e-8;  // residual of dependent rows, of the terms of their right sides
// Of constraints, as the step has them (base/reduction.cpp): the least pivot of the scaled matrix, and the share of its
// largest diagonal below which a row is rounding.
constexpr double kRedundant = 1e-9, kZeroRow = 1e-20;
}  // namespace

void SharedLoad::compute(MatX A, int constraints, int turns) {
  constraints_ = constraints;
  scale_turns(A, turns);
  if (A.size() == 0) {
    A_ = free_ = A;
    scale_.resize(0);
    rank_ = 0;
    return;
  }
  if (constraints == 0) {
    scale_ = A.rowwise().lpNorm<Eigen::Infinity>();
    for (double& s : scale_) s = s > 0.0 ? 1.0 / s : 1.0;
    A_ = scale_.asDiagonal() * A;
    factor();
    free_ = svd_.matrixV().rightCols(A.cols() - rank_);
    free_.bottomRows(turns) = turn_scale_.asDiagonal() * free_.bottomRows(turns);
    return;
  }
  eliminate(A);
  const Eigen::Index m = constraints_, rest = A.rows() - m, left = rest - rank_;
  const MatX K = A.topLeftCorner(m, m);
  free_.setZero(A.rows(), left + (redundant_ ? m : 0));
  if (left > 0) {
    free_.bottomLeftCorner(rest, left) = svd_.matrixV().rightCols(left);
    free_.topLeftCorner(m, left) = -across_ * free_.bottomLeftCorner(rest, left);
  }
  if (redundant_) free_.topRightCorner(m, m) = MatX::Identity(m, m) - inverse_ * K;
  free_.bottomRows(turns) = turn_scale_.asDiagonal() * free_.bottomRows(turns);
}

// A turn of one unit does as much as the largest impulse.
void SharedLoad::scale_turns(MatX& A, int turns) {
  turn_scale_.setOnes(turns);
  const Eigen::Index others = A.cols() - turns;
  const double largest = others > 0 && A.rows() > 0 ? A.leftCols(others).cwiseAbs().maxCoeff() : 1.0;
  for (Eigen::Index k = 0; k < turns; ++k) {
    const double size = A.col(others + k).cwiseAbs().maxCoeff();
    if (size > 0.0 && largest > 0.0) turn_scale_[k] = largest / size;
    A.col(others + k) *= turn_scale_[k];
  }
}

void SharedLoad::factor() {
  rank_ = 0;
  if (A_.rows() == 0) return;
  svd_.compute(A_, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const VecX& values = svd_.singularValues();
  while (rank_ < values.size() && values[rank_] > kDependent * values[0]) ++rank_;
}

void SharedLoad::eliminate(const MatX& A) {
  const Eigen::Index m = constraints_, rest = A.rows() - m;
  const double zero = kZeroRow * A.diagonal().head(m).cwiseAbs().maxCoeff();
  VecX scale(m);
  for (Eigen::Index k = 0; k < m; ++k) scale[k] = std::abs(A(k, k)) > zero ? 1.0 / std::sqrt(std::abs(A(k, k))) : 0.0;
  Eigen::CompleteOrthogonalDecomposition<MatX> kernel;
  kernel.setThreshold(kRedundant);
  kernel.compute(scale.asDiagonal() * A.topLeftCorner(m, m) * scale.asDiagonal());
  redundant_ = kernel.rank() < m;
  inverse_ = scale.asDiagonal() * kernel.pseudoInverse() * scale.asDiagonal();
  across_.noalias() = inverse_ * A.topRightCorner(m, rest);
  behind_.noalias() = A.bottomLeftCorner(rest, m) * inverse_;
  A_ = A.bottomRightCorner(rest, rest);
  A_.noalias() -= A.bottomLeftCorner(rest, m) * across_;
  // What the constraints leave of a row whose motion they determine is rounding: its impulse stays as it is.
  scale_.resize(rest);
  for (Eigen::Index k = 0; k < rest; ++k) {
    const double left = A_.row(k).lpNorm<Eigen::Infinity>(), all = A.row(m + k).lpNorm<Eigen::Infinity>();
    scale_[k] = left > kDependent * all ? 1.0 / left : 0.0;
  }
  A_ = scale_.asDiagonal() * A_;
  factor();
}

bool SharedLoad::solve(const VecX& c, const VecX& size, VecX& x) const {
  const Eigen::Index m = constraints_, rest = c.size() - m, turns = turn_scale_.size();
  bool agree = true;
  if (m == 0) {
    agree = solve_rest(c, size, x);
  } else {
    VecX last;
    agree = solve_rest(c.tail(rest) - behind_ * c.head(m), size.tail(rest) + behind_.cwiseAbs() * size.head(m), last);
    x.resize(c.size());
    x.tail(rest) = last;
    x.head(m) = -inverse_ * c.head(m) - across_ * last;
  }
  x.tail(turns).array() *= turn_scale_.array();
  return agree;
}

bool SharedLoad::solve_rest(const VecX& c, const VecX& size, VecX& x) const {
  if (c.size() == 0) {
    x.resize(0);
    return true;
  }
  const VecX right = -scale_.cwiseProduct(c);
  const VecX along =
      (svd_.matrixU().leftCols(rank_).transpose() * right).cwiseQuotient(svd_.singularValues().head(rank_));
  x = svd_.matrixV().leftCols(rank_) * along;
  return rank_ == A_.rows() || (A_ * x - right).norm() <= kContradiction * scale_.cwiseProduct(size).norm();
}

VecX SharedLoad::solve_transposed(const VecX& gradient) const {
  VecX lx = gradient;
  lx.tail(turn_scale_.size()).array() *= turn_scale_.array();
  if (constraints_ == 0) return solve_rest_transposed(lx);
  const Eigen::Index m = constraints_, rest = lx.size() - m;
  const VecX lc = solve_rest_transposed(lx.tail(rest) - across_.transpose() * lx.head(m));
  VecX all(lx.size());
  all.tail(rest) = lc;
  all.head(m) = -inverse_.transpose() * lx.head(m) - behind_.transpose() * lc;
  return all;
}

VecX SharedLoad::solve_rest_transposed(const VecX& lx) const {
  if (lx.size() == 0) return lx;
  const VecX along = (svd_.matrixV().leftCols(rank_).transpose() * lx).cwiseQuotient(svd_.singularValues().head(rank_));
  return -scale_.cwiseProduct(svd_.matrixU().leftCols(rank_) * along);
}

}  // namespace contactvi
