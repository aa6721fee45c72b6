#include "base/reduction.hpp"

#include <cmath>

namespace contactvi {

namespace {
constexpr double kRedundant = 1e-9;      // relative pivot of the scaled matrix below which rows depend on each other
constexpr double kZeroDiagonal = 1e-20;  // share of the largest diagonal below which a row is rounding
constexpr double kIdle = 1e-12;  // share of a row's diagonal that the equations leave it, below which it has none
}  // namespace

void Reduction::set(const Eigen::Ref<const MatX>& G, int equations, int checked) {
  equations_ = equations;
  const Eigen::Index rest = G.rows() - equations;
  scale_.resize(equations);
  const double zero = kZeroDiagonal * G.diagonal().head(equations).maxCoeff();
  for (int k = 0; k < equations; ++k) scale_[k] = G(k, k) > zero ? 1.0 / std::sqrt(G(k, k)) : 0.0;
  A_ = scale_.asDiagonal() * G.topLeftCorner(equations, equations) * scale_.asDiagonal();
  factor_.setThreshold(kRedundant);
  factor_.compute(A_);
  if (rest > 0) {
    across_ = scale_.asDiagonal() * factor_.solve(MatX(scale_.asDiagonal() * G.topRightCorner(equations, rest)));
    G_ = G.bottomRightCorner(rest, rest);
    G_.noalias() -= G.bottomLeftCorner(rest, equations) * across_;
  } else {
    across_.resize(equations, 0);
    G_.resize(0, 0);
  }
  A_ = G.bottomLeftCorner(rest, equations);  // used by right_side()
  idle_.clear();
  for (int k = 0; k < checked; ++k) {
    const double own = G(equations + k, equations + k);
    if (!(G_(k, k) <= kIdle * own)) continue;
    idle_.push_back(k);
    G_.row(k).setZero();
    G_.col(k).setZero();
    G_(k, k) = own > 0.0 ? own : 1.0;
  }
}

const VecX& Reduction::right_side(const VecCRef& b) {
  first_ = scale_.asDiagonal() * factor_.solve(VecX(scale_.asDiagonal() * b.head(equations_)));
  b_ = b.tail(b.size() - equations_);
  if (b_.size() > 0) b_.noalias() -= A_ * first_;
  idle_speed_.clear();
  for (int k : idle_) {
    idle_speed_.push_back(b_[k]);
    b_[k] = 0.0;
  }
  return b_;
}

void Reduction::complete(const VecCRef& rest, VecRef all) {
  all.tail(rest.size()) = rest;
  all.head(equations_) = -first_;
  if (rest.size() > 0) all.head(equations_).noalias() -= across_ * rest;
}

}  // namespace contactvi
