#include "integrator.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
// Nanoseconds per degree of freedom at depth d, measured once on Allegro and a chain of 100 (x86-64, -O3); only their
// ratio is used, so another machine's answer is little worse.
double factor_cost(double d) { return 68.0 + 15.0 * d + 0.4 * d * d; }
double iteration_cost(double d) { return 62.0 + 1.4 * d; }
// A new factorisation serves later steps as well.
constexpr double kAmortisation = 2.0;
}  // namespace

Integrator::Integrator(const Tree& tree, double tol, int max_iterations)
    : tree_(&tree),
      tol_(tol),
      max_iterations_(max_iterations),
      ws_(tree),
      matrix_(tree.dof_parent),
      mass_(tree.dof_parent),
      v_(tree.nv),
      dv_(tree.nv) {
  double factor = 0, iteration = 0;
  for (int k = 0; k < matrix_.size(); ++k) {
    factor += factor_cost(matrix_.depth(k));
    iteration += iteration_cost(matrix_.depth(k));
  }
  refresh_cost_ = iteration > 0 ? factor / iteration : 1.0;
}

bool Integrator::refresh(double h) {
  ++counters.factorizations;
  if (!newton_matrix(*tree_, h, ws_, matrix_)) {
    matrix_h_ = -1.0;
    why_ = "the Newton matrix is not positive definite";
    return false;
  }
  matrix_h_ = h;
  return true;
}

bool Integrator::refresh_pays(double rate, double digits) const {
  if (rate >= 0.5) return true;
  const double with = digits / -std::log(std::min(fresh_rate_, rate)), without = digits / -std::log(rate);
  return kAmortisation * (without - with) > refresh_cost_;
}

bool Integrator::measure(const TreeLu& matrix, double h, double& error2, double& scale2) {
  dv_ = ws_.residual;
  matrix.solve(dv_);
  // Kinetic-energy norm of the residual against that of the motion; what cancels in the force sets a floor to it.
  error2 = std::abs(ws_.residual.dot(dv_));
  double floor2 = 0.0;
  for (int i = 0; i < tree_->nv; ++i) {
    const double kick = h * ws_.magnitude[i];
    floor2 += kick * kick / std::abs(matrix.diagonal(i));
  }
  scale2 = std::max(std::abs(ws_.P.dot(v_)), floor2);
  residual_norm_ = std::sqrt(error2);
  if (std::isfinite(error2) && std::isfinite(scale2)) return true;
  why_ = "a number is not finite";
  return false;
}

bool Integrator::solve(const VecCRef& q0, const VecCRef& p0, const VecX& guess, double h, const VecX& tau) {
  v_ = guess;
  double previous = 0.0, error2 = 0.0, scale2 = 0.0;
  bool fresh = false;
  iterations_ = 0;
  why_ = "";
  for (int k = 0; k <= max_iterations_; ++k) {
    contactvi::residual(*tree_, q0, p0, v_, h, tau, ws_);
    ++counters.residuals;
    // A factorisation for another step length is still good while h/2 |A| is small beside M; the rate tells.
    if (matrix_h_ < 0.0) {
      if (!refresh(h)) break;
      fresh = true;
    }
    if (!measure(matrix_, h, error2, scale2)) break;
    if (error2 <= tol_ * tol_ * scale2) {
      // The correction is there already: taken, it costs nothing, and extrapolated noise cannot build up below tol.
      v_ += dv_;
      return true;
    }
    ++iterations_;
    const double rate = k > 0 ? residual_norm_ / previous : 0.0;
    if (k > 0 && fresh) fresh_rate_ = 0.5 * (fresh_rate_ + std::min(rate, 0.5));
    if (k > 3 && rate > 0.9) break;
    const double digits = 0.5 * std::log(std::max(error2 / (tol_ * tol_ * scale2), 1.0));
    if (k > 0 && refresh_pays(rate, digits) && (!fresh || rate > 0.5)) {
      if (!refresh(h)) break;
      fresh = true;
      dv_ = ws_.residual;
      matrix_.solve(dv_);
    }
    previous = residual_norm_;
    v_ += dv_;
  }
  matrix_h_ = -1.0;
  return solve_carefully(q0, p0, h, tau);
}

bool Integrator::solve_carefully(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau) {
  const int n = tree_->nv;
  MatX jacobian(n, n);
  VecX base(n), start(n);
  if (!node_velocity(q0, p0, v_)) {
    why_ = "the mass matrix is not positive definite";
    return false;
  }
  double error2 = 0.0, scale2 = 0.0, slack = 1.0;
  for (int k = 0; k < max_iterations_; ++k) {
    contactvi::residual(*tree_, q0, p0, v_, h, tau, ws_);
    ++counters.residuals;
    // The quick way's matrix may be indefinite here; M at the start of the step measures as well.
    if (!measure(mass_, h, error2, scale2)) return false;
    if (error2 <= tol_ * tol_ * scale2) return true;
    ++iterations_;
    base = ws_.residual;
    start = v_;
    const double before = base.squaredNorm(), reach = 1e-7 * (1.0 + v_.cwiseAbs().maxCoeff());
    for (int j = 0; j < n; ++j) {
      v_[j] += reach;
      contactvi::residual(*tree_, q0, p0, v_, h, tau, ws_);
      jacobian.col(j) = (base - ws_.residual) / reach;
      v_[j] = start[j];
    }
    counters.residuals += n;
    const VecX step = jacobian.partialPivLu().solve(base);
    for (slack = 1.0; slack > 1e-3; slack *= 0.5) {
      v_ = start + slack * step;
      contactvi::residual(*tree_, q0, p0, v_, h, tau, ws_);
      ++counters.residuals;
      if (ws_.residual.squaredNorm() < before || before < 1e-24) break;
    }
  }
  why_ = "no convergence";
  return false;
}

void Integrator::finish(const VecCRef& q0, const VecCRef& p0, double h, VecRef q1, VecRef p1) {
  integrate(*tree_, q0, v_, h, q1);
  end_momentum(*tree_, p0, v_, h, ws_, p1);
  ++counters.steps;
}

bool Integrator::node_velocity(const VecCRef& q, const VecCRef& p, VecRef v) {
  local_placements(*tree_, q, ws_.kernel);
  assemble_mass(*tree_, ws_.kernel, mass_);
  if (!mass_.factor()) return false;
  v = p;
  mass_.solve(v);
  return true;
}

Extrapolation::Extrapolation(int nv) {
  for (VecX& v : history_) v = VecX::Zero(nv);
}

void Extrapolation::push(const VecX& v, double h) {
  if (h != h_) count_ = 0;
  h_ = h;
  for (int i = kDepth - 1; i > 0; --i) history_[i].swap(history_[i - 1]);
  history_[0] = v;
  count_ = std::min(count_ + 1, kDepth);
}

void Extrapolation::guess(VecX& v) const {
  const VecX *a = &history_[0], *b = &history_[1], *c = &history_[2], *d = &history_[3];
  switch (count_) {
    case 1:
      v = *a;
      break;
    case 2:
      v = 2 * *a - *b;
      break;
    case 3:
      v = 3 * (*a - *b) + *c;
      break;
    default:
      v = 4 * (*a + *c) - 6 * *b - *d;
      break;
  }
}

}  // namespace contactvi
