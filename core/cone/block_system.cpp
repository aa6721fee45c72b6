#include "cone/block_system.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {

// Least diagonal of a contact's own matrix, a share of the largest of all: keeps what nothing can move finite.
constexpr double kLeastMobility = 1e-12;

using Six = Eigen::Matrix<double, 6, 1>;
using SixMap = Eigen::Map<Six>;
using SixCMap = Eigen::Map<const Six>;
using AnyMap = Eigen::Map<VecX>;
using AnyCMap = Eigen::Map<const VecX>;

inline double dot(const double* x, const double* y, int n) {
  return n == 6 ? SixCMap(x).dot(SixCMap(y)) : AnyCMap(x, n).dot(AnyCMap(y, n));
}

// w += the rows of coefficients (rows, n) times v. Free bodies have six degrees of freedom: their size is known to the
// compiler.
inline void add_rates(const double* coefficients, int rows, int n, const double* v, Vec3& w) {
  if (n == 6) {
    for (int r = 0; r < rows; ++r) w[r] += SixCMap(coefficients + 6 * r).dot(SixCMap(v));
  } else if (rows == 3) {
    using Pair = Eigen::Map<const Eigen::Vector2d>;
    Eigen::Matrix<double, 2, 3> sums = Eigen::Matrix<double, 2, 3>::Zero();
    int i = 0;
    for (; i + 1 < n; i += 2)
      for (int r = 0; r < 3; ++r) sums.col(r) += Pair(coefficients + n * r + i).cwiseProduct(Pair(v + i));
    for (int r = 0; r < 3; ++r) w[r] += sums(0, r) + sums(1, r) + (i < n ? coefficients[n * r + i] * v[i] : 0.0);
  } else {
    w[0] += AnyCMap(coefficients, n).dot(AnyCMap(v, n));
  }
}

// v += d times the rows of coefficients (rows, n).
inline void add_columns(const double* coefficients, int rows, int n, const double* d, double* v) {
  if (n == 6) {
    if (rows == 3)
      SixMap(v) += d[0] * SixCMap(coefficients) + d[1] * SixCMap(coefficients + 6) + d[2] * SixCMap(coefficients + 12);
    else
      SixMap(v) += d[0] * SixCMap(coefficients);
  } else if (rows == 3) {
    AnyMap(v, n) +=
        d[0] * AnyCMap(coefficients, n) + d[1] * AnyCMap(coefficients + n, n) + d[2] * AnyCMap(coefficients + 2 * n, n);
  } else {
    AnyMap(v, n) += d[0] * AnyCMap(coefficients, n);
  }
}

bool finite(const std::vector<double>& x) {
  return std::all_of(x.begin(), x.end(), [](double value) { return std::isfinite(value); });
}

}  // namespace

bool BlockSystem::place(const BlockProblem& problem) {
  const int blocks = problem.blocks(), values = static_cast<int>(problem.W.size());
  places_.resize(problem.contacts.size());
  int row = 0;
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const BlockContact& c = problem.contacts[i];
    if (c.a < 0 || c.a >= blocks || c.b < -1 || c.b >= blocks || c.a == c.b) return false;
    if (c.row != row || (c.rows != 1 && c.rows != 3)) return false;
    if (c.of >= 0 || c.turning >= 0) {
      const std::size_t other = static_cast<std::size_t>(std::max(c.of, c.turning));
      if (c.rows != 3 || other >= places_.size()) return false;
      const BlockContact& with = problem.contacts[other];
      if (with.a != c.a || with.b != c.b || (c.of >= 0 ? with.turning : with.of) != static_cast<int>(i)) return false;
    }
    Place& p = places_[i];
    p = {problem.start[c.a], problem.size(c.a), 0, 0, c.rows, c.row, c.column};
    if (c.b >= 0) {
      p.b = problem.start[c.b];
      p.size_b = problem.size(c.b);
    }
    if (c.column < 0 || c.column + c.rows * (p.size_a + p.size_b) > values) return false;
    row += c.rows;
  }
  return row == problem.rows();
}

void BlockSystem::mobility(const BlockProblem& problem) {
  matrices_.resize(places_.size());
  double largest = 0.0;
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const Place& p = places_[i];
    Mat3& G = matrices_[i].G;
    G.setZero();
    const int second = p.column + p.rows * p.size_a;
    for (int r = 0; r < p.rows; ++r) {
      for (int s = 0; s <= r; ++s) {
        const int a = p.column, n = p.size_a;
        G(r, s) = dot(&problem.W[a + r * n], &response_[a + s * n], n);
        if (p.size_b > 0)
          G(r, s) += dot(&problem.W[second + r * p.size_b], &response_[second + s * p.size_b], p.size_b);
        G(s, r) = G(r, s);
      }
    }
    largest = std::max(largest, G.diagonal().maxCoeff());
  }
  const double floor = std::max(kLeastMobility * largest, kLeastDivisor);
  for (std::size_t i = 0; i < places_.size(); ++i) matrices_[i].finish(floor, places_[i].rows == 1);
  turning_mobility(problem, floor);
}

void BlockSystem::turning_mobility(const BlockProblem& problem, double floor) {
  turning_points_.clear();
  turning_matrices_.clear();
  for (std::size_t i = 0; i < places_.size(); ++i) {
    if (problem.contacts[i].turning < 0) continue;
    const Place &p = places_[i], &q = places_[problem.contacts[i].turning];
    TurningMatrix m;
    const auto column = [](const Place& place, int r, bool second) {
      return place.column + (second ? 3 * place.size_a + r * place.size_b : r * place.size_a);
    };
    for (int r = 0; r < 6; ++r) {
      for (int s = 0; s <= r; ++s) {
        const Place &row = r < 3 ? p : q, &other = s < 3 ? p : q;
        for (const bool second : {false, true})
          m.G(r, s) += dot(&problem.W[column(row, r % 3, second)], &response_[column(other, s % 3, second)],
                           second ? p.size_b : p.size_a);
        m.G(s, r) = m.G(r, s);
      }
    }
    m.finish(floor);
    turning_points_.push_back(static_cast<int>(i));
    turning_matrices_.push_back(m);
  }
}

bool BlockSystem::check_masses(const BlockProblem& problem) {
  if (problem.M.count() != problem.blocks()) return false;
  for (int block = 0; block < problem.blocks(); ++block) {
    const MatX& inverse = problem.M.inverse(block);
    if (inverse.rows() != problem.size(block) || inverse.cols() != problem.size(block)) return false;
    if (!problem.M.positive(block)) return false;
  }
  return true;
}

bool BlockSystem::prepare(const BlockProblem& problem) {
  problem_ = nullptr;
  matrices_.clear();
  if (problem.start.empty() || !finite(problem.W) || !check_masses(problem) || !place(problem)) return false;
  response_.resize(problem.W.size());
  for (std::size_t i = 0; i < places_.size(); ++i) {
    const Place& p = places_[i];
    int column = p.column;
    for (const int block : {problem.contacts[i].a, problem.contacts[i].b}) {
      if (block < 0) continue;
      const int n = problem.size(block);
      for (int r = 0; r < p.rows; ++r, column += n) {
        if (n == 6)
          SixMap(&response_[column]).noalias() =
              Eigen::Map<const Eigen::Matrix<double, 6, 6>>(problem.M.inverse(block).data()) *
              SixCMap(&problem.W[column]);
        else
          AnyMap(&response_[column], n).noalias() = problem.M.inverse(block) * AnyCMap(&problem.W[column], n);
      }
    }
  }
  mobility(problem);
  problem_ = &problem;
  return true;
}

bool BlockSystem::start(const BlockProblem& problem) {
  if (problem_ == nullptr || problem.contacts.size() != places_.size()) return false;
  problem_ = &problem;
  if (!problem.v_free.allFinite() || !problem.offset.allFinite() || problem.v_free.size() != problem.start.back())
    return false;
  scale_ = 0.0;
  bounded_ = false;
  for (int c = 0; c < contacts(); ++c) {
    const BlockContact& law = contact(c);
    if (!std::isfinite(law.mu) || !std::isfinite(law.lower) || !std::isfinite(law.box)) return false;
    if (law.mu < 0.0 || law.lower < 0.0 || law.box < 0.0 || (law.box > 0.0 && law.rows != 1)) return false;
    bounded_ = bounded_ || (law.lower > 0.0 && !is_box(law));
    const Vec3 w = speed(c, problem.v_free);
    scale_ = std::max({scale_, w.cwiseAbs().maxCoeff(), is_box(law) ? std::abs(problem.offset[law.row]) : 0.0,
                       law.of < 0 ? -problem.offset[law.row] : 0.0, law.lower * matrix(c).largest});
  }
  scale_ = std::max(scale_, kLeastDivisor);
  return std::isfinite(scale_);
}

Vec3 BlockSystem::speed(int c, const VecX& v) const {
  const Place& p = places_[c];
  const double* W = problem_->W.data() + p.column;
  Vec3 w = Vec3::Zero();
  add_rates(W, p.rows, p.size_a, v.data() + p.a, w);
  if (p.size_b > 0) add_rates(W + p.rows * p.size_a, p.rows, p.size_b, v.data() + p.b, w);
  return w;
}

Vec3 BlockSystem::velocity(int c, const VecX& v) const {
  const Place& p = places_[c];
  Vec3 w = speed(c, v);
  for (int r = 0; r < p.rows; ++r) w[r] += problem_->offset[p.row + r];
  return w;
}

double BlockSystem::normal_velocity(int c, const VecX& v) const {
  return problem_->offset[places_[c].row] + normal_speed(c, v);
}

double BlockSystem::normal_speed(int c, const VecX& v) const {
  const Place& p = places_[c];
  const double* W = problem_->W.data() + p.column;
  Vec3 w = Vec3::Zero();
  add_rates(W, 1, p.size_a, v.data() + p.a, w);
  if (p.size_b > 0) add_rates(W + p.rows * p.size_a, 1, p.size_b, v.data() + p.b, w);
  return w[0];
}

void BlockSystem::add(const double* values, int c, int rows, const Vec3& d, VecX& x) const {
  const Place& p = places_[c];
  add_columns(values + p.column, rows, p.size_a, d.data(), x.data() + p.a);
  if (p.size_b > 0) add_columns(values + p.column + p.rows * p.size_a, rows, p.size_b, d.data(), x.data() + p.b);
}

void BlockSystem::push(int c, const Vec3& d, VecX& v) const { add(response_.data(), c, places_[c].rows, d, v); }
void BlockSystem::push_normal(int c, double d, VecX& v) const { add(response_.data(), c, 1, Vec3(d, 0.0, 0.0), v); }
void BlockSystem::pull(int c, const Vec3& d, VecX& f) const { add(problem_->W.data(), c, places_[c].rows, d, f); }

void BlockSystem::update(ConePoint& point) const {
  point.v = problem_->v_free;
  for (int c = 0; c < contacts(); ++c)
    if (!point.lambda[c].isZero(0.0)) push(c, point.lambda[c], point.v);
}

Vec6 BlockSystem::turning_impulse(int c, const ConePoint& point) const {
  Vec6 x;
  x << point.lambda[c], point.lambda[contact(c).turning];
  return x;
}

void BlockSystem::set_turning_impulse(int c, const Vec6& lambda, ConePoint& point) const {
  point.lambda[c] = lambda.head<3>();
  point.lambda[contact(c).turning] = lambda.tail<3>();
}

Vec6 BlockSystem::turning_velocity(int c, const VecX& v) const {
  Vec6 w;
  w << velocity(c, v), velocity(contact(c).turning, v);
  return w;
}

void BlockSystem::sweep_turning(ConePoint& point) const {
  for (std::size_t k = 0; k < turning_points_.size(); ++k) {
    const int c = turning_points_[k];
    const BlockContact& law = contact(c);
    const Vec6 lambda = turning_impulse(c, point), w = turning_velocity(c, point.v);
    if (w[0] > 0.0 && lambda[0] == 0.0 && law.lower == 0.0) continue;
    const TurningMatrix& m = turning_matrices_[k];
    const Vec6 next = solve_turning_contact(law, m, w - m.G * lambda, lambda), change = next - lambda;
    if (change.isZero(0.0)) continue;
    push(c, change.head<3>(), point.v);
    push(law.turning, change.tail<3>(), point.v);
    set_turning_impulse(c, next, point);
  }
}

void BlockSystem::project(ConePoint& point) const {
  for (int c = 0; c < contacts(); ++c)
    if (is_alone(contact(c))) point.lambda[c] = project_impulse(contact(c), point.lambda[c]);
  for (const int c : turning_points_)
    set_turning_impulse(c, project_turning(contact(c), turning_impulse(c, point)), point);
  update(point);
}

double BlockSystem::residual(const ConePoint& point) const {
  double worst = 0.0;
  for (int c = 0; c < contacts(); ++c) {
    if (!is_alone(contact(c))) continue;
    const double error = law_error(contact(c), matrix(c).largest, point.lambda[c], velocity(c, point.v));
    if (!(error <= worst)) worst = error;  // also if it is not a number
  }
  for (std::size_t k = 0; k < turning_points_.size(); ++k) {
    const int c = turning_points_[k];
    const Vec6 map =
        turning_map(contact(c), turning_matrices_[k], turning_impulse(c, point), turning_velocity(c, point.v));
    const double error = map.cwiseAbs().maxCoeff();
    if (!(error <= worst)) worst = error;
  }
  return worst / scale_;
}

double BlockSystem::product(const VecX& x, const VecX& y) const {
  double sum = 0.0;
  for (int block = 0; block < problem_->blocks(); ++block) {
    const int first = problem_->start[block], n = problem_->size(block);
    if (n > 0) sum += problem_->M.product(block, AnyCMap(x.data() + first, n), AnyCMap(y.data() + first, n));
  }
  return sum;
}

double BlockSystem::worst_gap(const VecX& v) const {
  double worst = 0.0;
  for (int c = 0; c < contacts(); ++c)
    if (has_gap(contact(c))) worst = std::min(worst, normal_velocity(c, v));
  return worst;
}

}  // namespace contactvi
