#include "cone/dense_system.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {
constexpr double kLeastDenseMobility = 1e-12;  // of the largest diagonal: keeps what nothing can move finite
}

void DenseSystem::reserve(int rows) {
  laws_.reserve(rows);
  matrices_.reserve(rows);
  rows_.reserve(rows);
  rays_.reserve(rows);
  if (free_.size() >= rows) return;
  free_.resize(rows);
  impulses_.resize(rows);
}

void DenseSystem::start(const ConeProblem& problem) {
  problem_ = &problem;
  laws_.clear();
  matrices_.clear();
  rows_.clear();
  rays_.clear();
  free_ = problem.b;
  impulses_.setZero(problem.b.size());
  const auto& G = problem.G;
  const double most = G.rows() > 0 ? G.diagonal().cwiseAbs().maxCoeff() : 0.0;
  const double floor = most > 0.0 ? kLeastDenseMobility * most : 1.0;
  scale_ = kLeastDivisor;
  for (const ConeContact& c : problem.contacts) {
    if (c.frozen && c.box > 0.0) {
      impulses_[c.row] = -c.box * c.d[0];
      free_.noalias() += G.col(c.row) * impulses_[c.row];
      continue;
    }
    const bool frozen = c.frozen && c.rows == 3;
    BlockContact law;
    law.a = 0;
    law.row = c.row;
    law.rows = frozen ? 1 : c.rows;
    law.mu = frozen ? 0.0 : c.mu;
    law.lower = c.lower;
    law.box = c.box;
    laws_.push_back(law);
    rows_.push_back(c.rows);
    rays_.push_back(frozen ? Vec3(1.0, -c.mu * c.d[0], -c.mu * c.d[1]) : Vec3(1.0, 0.0, 0.0));
    ContactMatrix m;
    for (int k = 0; k < law.rows; ++k)
      for (int j = 0; j < law.rows; ++j) m.G(k, j) = 0.5 * (G(c.row + k, c.row + j) + G(c.row + j, c.row + k));
    for (int j = 1; frozen && j < 3; ++j) m.G(0, 0) += G(c.row, c.row + j) * rays_.back()[j];
    m.finish(floor, law.rows == 1);
    matrices_.push_back(m);
    scale_ = std::max({scale_, problem.b.segment(c.row, law.rows).cwiseAbs().maxCoeff(), c.lower * m.largest});
  }
}

Vec3 DenseSystem::speed(int c, const VecX& w) const {
  const BlockContact& law = laws_[c];
  Vec3 x = Vec3::Zero();
  for (int r = 0; r < law.rows; ++r) x[r] = w[law.row + r];
  return x;
}

Vec3 DenseSystem::in_rows(int c, const Vec3& d) const { return rows_[c] == laws_[c].rows ? d : Vec3(d[0] * rays_[c]); }

void DenseSystem::pull(int c, const Vec3& d, VecX& impulses) const {
  const Vec3 x = in_rows(c, d);
  for (int r = 0; r < rows_[c]; ++r) impulses[laws_[c].row + r] += x[r];
}

void DenseSystem::push(int c, const Vec3& d, VecX& w) const {
  const Vec3 x = in_rows(c, d);
  for (int r = 0; r < rows_[c]; ++r) w.noalias() += problem_->G.col(laws_[c].row + r) * x[r];
}

void DenseSystem::update(ConePoint& point) const {
  impulses_.setZero();
  for (int c = 0; c < contacts(); ++c) pull(c, point.lambda[c], impulses_);
  point.v = free_;
  point.v.noalias() += problem_->G * impulses_;
}

void DenseSystem::project(ConePoint& point) const {
  for (int c = 0; c < contacts(); ++c) point.lambda[c] = project_impulse(laws_[c], point.lambda[c]);
  update(point);
}

double DenseSystem::residual(const ConePoint& point) const {
  double worst = 0.0;
  for (int c = 0; c < contacts(); ++c) {
    const double error = law_error(laws_[c], largest(c), point.lambda[c], velocity(c, point.v));
    if (!(error <= worst)) worst = error;  // also if it is not a number
  }
  return worst / scale_;
}

void DenseSystem::read(const double* impulses, ConePoint& point) const {
  point.lambda.resize(laws_.size());
  for (int c = 0; c < contacts(); ++c) {
    point.lambda[c].setZero();
    for (int r = 0; r < laws_[c].rows; ++r) point.lambda[c][r] = impulses[laws_[c].row + r];
  }
}

void DenseSystem::write(const ConePoint& point, double* impulses) const {
  for (const ConeContact& c : problem_->contacts)
    if (c.frozen && c.box > 0.0) impulses[c.row] = -c.box * c.d[0];
  for (int c = 0; c < contacts(); ++c) {
    const Vec3 x = in_rows(c, point.lambda[c]);
    for (int r = 0; r < rows_[c]; ++r) impulses[laws_[c].row + r] = x[r];
  }
}

bool DenseFactor::factor(const DenseSystem& system, const std::vector<Mat3>& K, bool) {
  problem_ = &system.problem();
  const int m = system.dofs();
  linear_.resize(m);
  const auto& G = problem_->G;
  for (int j = 0; j < m; ++j)
    for (int i = 0; i < m; ++i) linear_.at(i, j) = 0.0;
  for (int c = 0; c < system.contacts(); ++c) {
    const BlockContact& law = system.contact(c);
    for (int k = 0; k < law.rows; ++k) {
      const Vec3 f = system.in_rows(c, K[c].col(k));
      double* to = &linear_.at(0, law.row + k);
      for (int s = 0; s < system.rows(c); ++s) {
        if (f[s] == 0.0) continue;
        const double* column = G.data() + (law.row + s) * G.outerStride();
        for (int i = 0; i < m; ++i) to[i] += f[s] * column[i];
      }
    }
  }
  for (int j = 0; j < m; ++j) linear_.at(j, j) += 1.0;
  return linear_.factor(0.0);
}

bool DenseFactor::solve(VecX& x) {
  right_.noalias() = problem_->G * x;
  linear_.substitute(right_.data());
  x = right_;
  return x.allFinite();
}

}  // namespace contactvi
