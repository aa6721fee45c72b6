// Products that make Delassus matrices.
#pragma once

#include "base/numerics.hpp"

namespace contactvi {

// G = S^T X of two matrices of m columns each, shape (m, m). Eigen's product packs both into blocks first, which takes
// longer than the sums of a few rows do: 24 of them are eight points with friction.
inline void delassus(const MatX& S, const MatX& X, MatX& G) {
  constexpr Eigen::Index kFew = 24;
  if (S.cols() <= kFew)
    G.noalias() = S.transpose().lazyProduct(X);
  else
    G.noalias() = S.transpose() * X;
}

}  // namespace contactvi
