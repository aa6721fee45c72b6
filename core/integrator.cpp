#include "integrator.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
// Contraction per iteration above which a new factorisation pays: it costs about as much as one iteration.
constexpr double kRefreshRate = 0.02;
}  // namespace

Integrator::Integrator(const Tree& tree, double tol, int max_iterations)
    : tree_(&tree),
      tol_(tol),
      max_iterations_(max_iterations),
      ws_(tree),
      matrix_(tree.dof_parent),
      mass_(tree.dof_parent),
      v_(tree.nv),
      dv_(tree.nv) {}

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

bool Integrator::solve(const VecCRef& q0, const VecCRef& p0, const VecX& guess, double h, const VecX& tau) {
  v_ = guess;
  double previous = 0.0;
  bool fresh = false;
  iterations_ = 0;
  why_ = "";
  for (int k = 0; k <= max_iterations_; ++k) {
    contactvi::residual(*tree_, q0, p0, v_, h, tau, ws_);
    ++counters.residuals;
    // A factorisation for another step length is still good while h/2 |A| is small beside M; the rate tells.
    if (matrix_h_ < 0.0) {
      if (!refresh(h)) return false;
      fresh = true;
    }
    dv_ = ws_.residual;
    matrix_.solve(dv_);
    // Kinetic-energy norm of the residual against that of the motion; what cancels in the force sets a floor to it.
    const double error2 = std::abs(ws_.residual.dot(dv_));
    double floor2 = 0.0;
    for (int i = 0; i < tree_->nv; ++i) {
      const double kick = h * ws_.magnitude[i];
      floor2 += kick * kick / std::abs(matrix_.diagonal(i));
    }
    const double scale2 = std::max(std::abs(ws_.P.dot(v_)), floor2);
    if (!std::isfinite(error2) || !std::isfinite(scale2)) {
      why_ = "a number is not finite";
      matrix_h_ = -1.0;
      return false;
    }
    residual_norm_ = std::sqrt(error2);
    if (error2 <= tol_ * tol_ * scale2) return true;
    ++iterations_;
    const double rate = k > 0 ? residual_norm_ / previous : 0.0;
    if (k > 0 && rate > kRefreshRate && (!fresh || rate > 0.5)) {
      if (!refresh(h)) return false;
      fresh = true;
      dv_ = ws_.residual;
      matrix_.solve(dv_);
    }
    previous = residual_norm_;
    v_ += dv_;
  }
  why_ = "no convergence";
  matrix_h_ = -1.0;
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
    case 1: v = *a; break;
    case 2: v = 2 * *a - *b; break;
    case 3: v = 3 * (*a - *b) + *c; break;
    default: v = 4 * (*a + *c) - 6 * *b - *d; break;
  }
}

}  // namespace contactvi
