#include "cone/block_factor.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>

#include "cone/inverse_cholesky.hpp"

namespace contactvi {

namespace {

template <int N>
using Block = SquareMap<N>;
template <int N>
using Column = Eigen::Map<Eigen::Matrix<double, N, 1>>;

// Exchanges row k of A with that of the largest pivot in its column; returns which one that was.
template <int N>
int take_pivot(Block<N>& A, int k) {
  const int n = static_cast<int>(A.rows());
  int pivot = k;
  for (int i = k + 1; i < n; ++i)
    if (std::abs(A(i, k)) > std::abs(A(pivot, k))) pivot = i;
  if (pivot != k)
    for (int j = 0; j < n; ++j) std::swap(A(k, j), A(pivot, j));
  return pivot;
}

// Inverse in place by elimination with pivots of the column. rows: workspace (n,).
template <int N>
bool invert_general(Block<N> A, int* rows) {
  const int n = static_cast<int>(A.rows());
  for (int k = 0; k < n; ++k) {
    rows[k] = take_pivot<N>(A, k);
    const double inverse = 1.0 / A(k, k);
    if (!std::isfinite(inverse)) return false;
    A(k, k) = 1.0;
    for (int j = 0; j < n; ++j) A(k, j) *= inverse;
    for (int j = 0; j < n; ++j) {
      if (j == k) continue;
      const double f = A(k, j);
      for (int i = 0; i < n; ++i) A(i, j) -= A(i, k) * f;
      A(k, j) = f;
    }
    for (int i = 0; i < n; ++i)
      if (i != k) A(i, k) *= -inverse;
  }
  for (int k = n - 1; k >= 0; --k)
    if (rows[k] != k) A.col(k).swap(A.col(rows[k]));
  return true;
}

// L U = A with its rows exchanged, in place. rows: workspace (n,), which solve_general takes.
bool factor_general(SquareMap<Eigen::Dynamic> A, int* rows) {
  const int n = static_cast<int>(A.rows());
  for (int k = 0; k < n; ++k) {
    rows[k] = take_pivot<Eigen::Dynamic>(A, k);
    const double inverse = 1.0 / A(k, k);
    if (!std::isfinite(inverse)) return false;
    for (int i = k + 1; i < n; ++i) A(i, k) *= inverse;
    for (int j = k + 1; j < n; ++j) subtract<Eigen::Dynamic>(&A(k, j) + 1, A(k, j), &A(k, k) + 1, n - k - 1);
  }
  return true;
}

// y <- A^-1 y
void solve_general(const SquareMap<Eigen::Dynamic>& A, const int* rows, double* y) {
  const int n = static_cast<int>(A.rows());
  for (int k = 0; k < n; ++k) std::swap(y[k], y[rows[k]]);
  for (int k = 0; k < n; ++k) subtract<Eigen::Dynamic>(y + k + 1, y[k], &A(k, k) + 1, n - k - 1);
  for (int k = n - 1; k >= 0; --k) {
    y[k] /= A(k, k);
    subtract<Eigen::Dynamic>(y, y[k], &A(0, k), k);
  }
}

// y <- A^-1 y with the factor of a positive definite A.
void solve_positive(const SquareMap<Eigen::Dynamic>& L, double* y) {
  const int n = static_cast<int>(L.rows());
  for (int k = 0; k < n; ++k) {
    y[k] /= L(k, k);
    subtract<Eigen::Dynamic>(y + k + 1, y[k], &L(k, k) + 1, n - k - 1);
  }
  for (int k = n - 1; k >= 0; --k)
    y[k] = (y[k] - Eigen::Map<const VecX>(&L(k, k) + 1, n - k - 1).dot(Eigen::Map<const VecX>(y + k + 1, n - k - 1))) /
           L(k, k);
}

using SixThree = Eigen::Matrix<double, 6, 3>;

// A += W_i^T K W_j; lower: of a symmetric A, whose lower triangle is enough. Of one row, or where K is that of one row
// as that of a normal, two thirds and more of the products are zero.
inline void add_product(double* A, const double* Wi, int ni, const double* Wj, int nj, const Mat3& K, int rows,
                        bool lower) {
  if (rows == 3 && ni == 6 && nj == 6) {
    const SixThree left = Eigen::Map<const SixThree>(Wi) * K;
    Block<6>(A).noalias() += left * Eigen::Map<const SixThree>(Wj).transpose();
    return;
  }
  const bool one = rows == 1 || (K.row(1).isZero(0.0) && K.row(2).isZero(0.0) && K(0, 1) == 0.0 && K(0, 2) == 0.0);
  for (int j = 0; j < nj; ++j) {
    const int first = lower ? j : 0, count = ni - first;
    Eigen::Map<VecX> column(A + static_cast<std::size_t>(j) * ni + first, count);
    const auto left = [&](int r) { return Eigen::Map<const VecX>(Wi + r * ni + first, count); };
    if (one) {
      const double f = K(0, 0) * Wj[j];
      if (f != 0.0) column += f * left(0);
      continue;
    }
    const Vec3 f = K * Vec3(Wj[j], Wj[nj + j], Wj[2 * nj + j]);
    if (!f.isZero(0.0)) column += f[0] * left(0) + f[1] * left(1) + f[2] * left(2);
  }
}

}  // namespace

void BlockFactor::order(const BlockProblem& problem) {
  const int blocks = problem.blocks();
  position_.assign(blocks, -1);
  if (static_cast<int>(near_.size()) < blocks) near_.resize(blocks);
  for (int b = 0; b < blocks; ++b) near_[b].clear();
  int count = 0;
  for (const BlockContact& c : problem.contacts) {
    for (const int b : {c.a, c.b}) {
      if (b < 0 || position_[b] == 0) continue;
      position_[b] = 0;
      ++count;
    }
    if (c.b < 0) continue;
    near_[c.a].push_back(c.b);
    near_[c.b].push_back(c.a);
  }
  for (int b = 0; b < blocks; ++b) {
    std::sort(near_[b].begin(), near_[b].end());
    near_[b].erase(std::unique(near_[b].begin(), near_[b].end()), near_[b].end());
  }
  // Least degree, of equal ones the first block; the neighbours of an eliminated block become neighbours.
  pivots_.resize(count);
  for (int k = 0; k < count; ++k) {
    int best = -1;
    for (int b = 0; b < blocks; ++b)
      if (position_[b] == 0 && (best < 0 || near_[b].size() < near_[best].size())) best = b;
    position_[best] = -2 - k;  // placed, and no longer looked for
    pivots_[k].block = best;
    pivots_[k].first = problem.start[best];
    pivots_[k].size = problem.size(best);
    for (const int u : near_[best]) {
      merged_.clear();
      std::set_union(near_[u].begin(), near_[u].end(), near_[best].begin(), near_[best].end(),
                     std::back_inserter(merged_));
      merged_.erase(std::remove_if(merged_.begin(), merged_.end(), [&](int b) { return b == u || b == best; }),
                    merged_.end());
      near_[u].assign(merged_.begin(), merged_.end());  // each list keeps its own storage
    }
  }
  for (int& position : position_) position = position == -1 ? -1 : -2 - position;
}

int BlockFactor::entry(int column, int row) const {
  const auto begin = rows_.begin() + pivots_[column].begin, end = rows_.begin() + pivots_[column].end;
  return static_cast<int>(std::lower_bound(begin, end, row) - rows_.begin());
}

void BlockFactor::layout() {
  rows_.clear();
  std::size_t on = 0, off = 0;
  int largest = 0, total = 0;
  only_six_ = true;
  places_.clear();
  for (Pivot& p : pivots_) {
    p.begin = static_cast<int>(rows_.size());
    for (const int b : near_[p.block]) rows_.push_back(position_[b]);
    p.end = static_cast<int>(rows_.size());
    std::sort(rows_.begin() + p.begin, rows_.end());
    p.diagonal = on;
    on += static_cast<std::size_t>(p.size) * p.size;
    for (int e = p.begin; e < p.end; ++e) {
      places_.push_back(off);
      off += static_cast<std::size_t>(p.size) * pivots_[rows_[e]].size;
    }
    p.start = total;
    total += p.size;
    largest = std::max(largest, p.size);
    only_six_ = only_six_ && p.size == 6;
  }
  updates_.clear();
  for (Pivot& p : pivots_) {
    p.table = updates_.size();
    for (int j = p.begin; j < p.end; ++j)
      for (int i = j + 1; i < p.end; ++i) updates_.push_back(entry(rows_[j], rows_[i]));
  }
  diagonal_.resize(on);
  lower_.resize(off);
  upper_.resize(off);
  y_.resize(total);
  scratch_.resize(static_cast<std::size_t>(largest) * largest);
  exchanged_.resize(total);
}

void BlockFactor::analyse(const BlockProblem& problem) {
  order(problem);
  layout();
}

// Of two contacts that act on the same blocks, with as many rows.
void BlockFactor::add_contact(const BlockProblem& problem, const BlockContact& left, const BlockContact& right,
                              const Mat3& K) {
  const int na = problem.size(left.a), a = position_[left.a], rows = left.rows;
  const double *La = problem.W.data() + left.column, *Ra = problem.W.data() + right.column;
  add_product(&diagonal_[pivots_[a].diagonal], La, na, Ra, na, K, rows, symmetric_);
  if (left.b < 0) return;
  const int nb = problem.size(left.b), b = position_[left.b];
  const double *Lb = La + rows * na, *Rb = Ra + rows * na;
  add_product(&diagonal_[pivots_[b].diagonal], Lb, nb, Rb, nb, K, rows, symmetric_);
  const std::size_t place = places_[entry(std::min(a, b), std::max(a, b))];
  if (a < b) {
    add_product(&lower_[place], Lb, nb, Ra, na, K, rows, false);
    if (!symmetric_) add_product(&upper_[place], La, na, Rb, nb, K, rows, false);
  } else {
    add_product(&lower_[place], La, na, Rb, nb, K, rows, false);
    if (!symmetric_) add_product(&upper_[place], Lb, nb, Ra, na, K, rows, false);
  }
}

void BlockFactor::assemble(const BlockProblem& problem, const std::vector<Mat3>& K) {
  std::fill(lower_.begin(), lower_.end(), 0.0);
  if (!symmetric_) std::fill(upper_.begin(), upper_.end(), 0.0);
  for (const Pivot& p : pivots_)
    std::copy_n(problem.M[p.block].data(), static_cast<std::size_t>(p.size) * p.size, &diagonal_[p.diagonal]);
  for (std::size_t i = 0; i < problem.contacts.size(); ++i)
    if (!K[i].isZero(0.0)) add_contact(problem, problem.contacts[i], problem.contacts[i], K[i]);
}

template <int N>
bool BlockFactor::eliminate() {
  for (const Pivot& p : pivots_) {
    Block<N> D(&diagonal_[p.diagonal], p.size, p.size);
    if (is_factor<N>(p)) {
      const SquareMap<Eigen::Dynamic> last(D.data(), p.size, p.size);
      if (!(symmetric_ ? factor_cholesky<Eigen::Dynamic>(last) : factor_general(last, &exchanged_[p.start])))
        return false;
      continue;
    }
    if (!(symmetric_ ? invert_cholesky<N>(D) : invert_general<N>(D, exchanged_.data()))) return false;
    for (int e = p.begin; e < p.end; ++e) {
      const int rows = pivots_[rows_[e]].size;
      Block<N> X(&lower_[places_[e]], rows, p.size), Y(scratch_.data(), rows, p.size);
      if (symmetric_)
        Y.noalias() = X * D.transpose();
      else
        Y.noalias() = X * D;
      X = Y;
    }
    std::size_t update = p.table;
    for (int j = p.begin; j < p.end; ++j) {
      const Pivot& column = pivots_[rows_[j]];
      const Block<N> Xj(&lower_[places_[j]], column.size, p.size);
      const Block<N> Uj(symmetric_ ? nullptr : &upper_[places_[j]], p.size, column.size);
      Block<N> Dj(&diagonal_[column.diagonal], column.size, column.size);
      if (symmetric_)
        Dj.noalias() -= Xj * Xj.transpose();
      else
        Dj.noalias() -= Xj * Uj;
      for (int i = j + 1; i < p.end; ++i, ++update) {
        const int rows = pivots_[rows_[i]].size;
        const std::size_t place = places_[updates_[update]];
        const Block<N> Xi(&lower_[places_[i]], rows, p.size);
        Block<N> L(&lower_[place], rows, column.size);
        if (symmetric_) {
          L.noalias() -= Xi * Xj.transpose();
        } else {
          L.noalias() -= Xi * Uj;
          Block<N>(&upper_[place], column.size, rows).noalias() -= Xj * Block<N>(&upper_[places_[i]], p.size, rows);
        }
      }
    }
  }
  return true;
}

bool BlockFactor::factor(const BlockProblem& problem, const std::vector<Mat3>& K, bool symmetric,
                         const std::vector<CrossWeight>& crosses) {
  symmetric_ = symmetric;
  assemble(problem, K);
  for (const CrossWeight& x : crosses) add_contact(problem, problem.contacts[x.left], problem.contacts[x.right], x.K);
  return only_six_ ? eliminate<6>() : eliminate<Eigen::Dynamic>();
}

template <int N>
void BlockFactor::substitute() {
  const auto part = [&](const Pivot& p) { return Column<N>(&y_[p.start], p.size); };
  for (const Pivot& p : pivots_) {
    const Block<N> D(&diagonal_[p.diagonal], p.size, p.size);
    auto y = part(p);
    if (symmetric_ && !is_factor<N>(p)) {
      Column<N> z(scratch_.data(), p.size);
      z.noalias() = D * y;
      y = z;
    }
    for (int e = p.begin; e < p.end; ++e) {
      const Pivot& q = pivots_[rows_[e]];
      part(q).noalias() -= Block<N>(&lower_[places_[e]], q.size, p.size) * y;
    }
  }
  for (auto p = pivots_.rbegin(); p != pivots_.rend(); ++p) {
    const Block<N> D(&diagonal_[p->diagonal], p->size, p->size);
    auto y = part(*p);
    for (int e = p->begin; e < p->end; ++e) {
      const Pivot& q = pivots_[rows_[e]];
      if (symmetric_)
        y.noalias() -= Block<N>(&lower_[places_[e]], q.size, p->size).transpose() * part(q);
      else
        y.noalias() -= Block<N>(&upper_[places_[e]], p->size, q.size) * part(q);
    }
    if (is_factor<N>(*p)) {
      const SquareMap<Eigen::Dynamic> factor(&diagonal_[p->diagonal], p->size, p->size);
      if (symmetric_)
        solve_positive(factor, y.data());
      else
        solve_general(factor, &exchanged_[p->start], y.data());
      continue;
    }
    Column<N> z(scratch_.data(), p->size);
    if (symmetric_)
      z.noalias() = D.transpose() * y;
    else
      z.noalias() = D * y;
    y = z;
  }
}

bool BlockFactor::solve(VecX& x) {
  for (const Pivot& p : pivots_) std::copy_n(x.data() + p.first, p.size, &y_[p.start]);
  if (only_six_)
    substitute<6>();
  else
    substitute<Eigen::Dynamic>();
  x.setZero();
  for (const Pivot& p : pivots_) std::copy_n(&y_[p.start], p.size, x.data() + p.first);
  return x.allFinite();
}

}  // namespace contactvi
