#include "cone/dense_system.hpp"

#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"

namespace contactvi {

namespace {
constexpr double kLeastMobility = 1e-12;  // of the largest diagonal: keeps what nothing can move finite
}

void DenseSystem::reserve(int rows) {
  laws_.reserve(rows);
  largest_.reserve(rows);
  if (free_.size() >= rows) return;
  free_.resize(rows);
  impulses_.resize(rows);
}

bool DenseSystem::start(const ConeProblem& problem) {
  problem_ = &problem;
  laws_.clear();
  largest_.clear();
  free_ = problem.b;
  impulses_.setZero(problem.b.size());
  const auto& G = problem.G;
  const double most = G.rows() > 0 ? G.diagonal().cwiseAbs().maxCoeff() : 0.0;
  const double floor = most > 0.0 ? kLeastMobility * most : 1.0;
  scale_ = kLeastDivisor;
  for (const ConeContact& c : problem.contacts) {
    if (c.frozen && c.box > 0.0) {
      impulses_[c.row] = -c.box * c.d[0];
      free_.noalias() += G.col(c.row) * impulses_[c.row];
      continue;
    }
    if (c.frozen && c.rows == 3) return false;
    BlockContact law;
    law.a = 0;
    law.row = c.row;
    law.rows = c.rows;
    law.mu = c.mu;
    law.lower = c.lower;
    law.box = c.box;
    laws_.push_back(law);
    largest_.push_back(std::max(G.diagonal().segment(c.row, c.rows).cwiseAbs().maxCoeff(), floor));
    scale_ = std::max({scale_, problem.b.segment(c.row, c.rows).cwiseAbs().maxCoeff(), c.lower * largest_.back()});
  }
  return true;
}

Vec3 DenseSystem::speed(int c, const VecX& w) const {
  const BlockContact& law = laws_[c];
  Vec3 x = Vec3::Zero();
  for (int r = 0; r < law.rows; ++r) x[r] = w[law.row + r];
  return x;
}

void DenseSystem::pull(int c, const Vec3& d, VecX& impulses) const {
  const BlockContact& law = laws_[c];
  for (int r = 0; r < law.rows; ++r) impulses[law.row + r] += d[r];
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
    const double error = law_error(laws_[c], largest_[c], point.lambda[c], velocity(c, point.v));
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
    if (c.frozen) impulses[c.row] = -c.box * c.d[0];
  for (int c = 0; c < contacts(); ++c)
    for (int r = 0; r < laws_[c].rows; ++r) impulses[laws_[c].row + r] = point.lambda[c][r];
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
      for (int s = 0; s < law.rows; ++s) {
        const double f = K[c](s, k);
        if (f == 0.0) continue;
        const double* column = G.data() + (law.row + s) * G.outerStride();
        double* to = &linear_.at(0, law.row + k);
        for (int i = 0; i < m; ++i) to[i] += f * column[i];
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
