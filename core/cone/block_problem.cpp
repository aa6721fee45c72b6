#include "cone/block_problem.hpp"

#include "cone/inverse_cholesky.hpp"

namespace contactvi {

namespace {
constexpr Eigen::Index kSmall = 12;  // blocks whose masses cost little beside their factor
}  // namespace

void BlockMasses::set_inverse(int block, const Eigen::Ref<const MatX>& inverse) {
  Block& b = blocks_[block];
  b.inverse = inverse;
  b.has_masses = b.has_factor = false;
}

void BlockMasses::set(int block, const Eigen::Ref<const MatX>& masses) {
  Block& b = blocks_[block];
  b.masses = masses;
  invert_positive(b.masses, b.inverse);
  b.has_masses = true;
  b.has_factor = false;
}

void BlockMasses::copy(int block, const BlockMasses& other, int from) { blocks_[block] = other.blocks_[from]; }

const MatX& BlockMasses::operator[](int block) const {
  Block& b = blocks_[block];
  if (!b.has_masses) invert_positive(b.inverse, b.masses);
  b.has_masses = true;
  return b.masses;
}

const Eigen::LLT<MatX>& BlockMasses::factor(int block) const {
  Block& b = blocks_[block];
  if (!b.has_factor) b.factor.compute(b.inverse);
  b.has_factor = true;
  return b.factor;
}

// By what is made for the products anyway.
bool BlockMasses::positive(int block) const {
  const MatX& inverse = blocks_[block].inverse;
  if (inverse.size() == 0 || !inverse.allFinite()) return inverse.size() == 0;
  return inverse.rows() > kSmall ? factor(block).info() == Eigen::Success : (*this)[block].allFinite();
}

double BlockMasses::product(int block, const VecCRef& x, const VecCRef& y) const {
  const Eigen::Index n = x.size();
  if (!blocks_[block].has_masses && n > kSmall) {
    const auto C = factor(block).matrixL();
    return VecX(C.solve(x)).dot(VecX(C.solve(y)));
  }
  const MatX& M = (*this)[block];
  double sum = 0.0;
  for (Eigen::Index j = 0; j < n; ++j) sum += y[j] * M.col(j).dot(x);
  return sum;
}

}  // namespace contactvi
