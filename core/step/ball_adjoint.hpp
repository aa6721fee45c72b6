// The equations of one spherical joint in a step (lanes/lane_iteration.hpp), transposed.
//
// From the multipliers mu_i of the stage equations and the gradient (lq, lp) at the end of the step to the gradients
// in the momentum P, the force G, the velocity v and the chart X at each stage, by 3x3 matrices that are made once per
// step. A gradient in a turn is dual to body-fixed rotations. Arrays are those of the stages, [dof * S + stage], and
// begin at the joint's first dof.
#pragma once

#include <Eigen/LU>
#include <vector>

#include "base/dual_number.hpp"
#include "step/stages.hpp"

namespace contactvi {

// What the joint has at the stages of a solved step of length h: its rows of X, v, P and of G with all its forces.
template <class T>
struct BallStages {
  const GaussTable& table;
  int padded;
  T h;
  const T *X, *v, *P, *G;
  Eigen::Matrix<T, 3, 1> p0;  // its momentum at the start
};

// T: double, or DualNumber for the derivatives of all of it along a direction.
template <class T>
class BallAdjointOf {
 public:
  using Vec3T = Eigen::Matrix<T, 3, 1>;
  using Mat3T = Eigen::Matrix<T, 3, 3>;

  BallAdjointOf(int dof, int stages);

  int dof() const { return dof_; }
  void take(const BallStages<T>& step);

  // Gradients in the chart momenta of the stages.
  void chart_momenta(const T* mu, T* px_bar) const;
  // Gradients in P and G; sums: h sum_i a_ij px_bar_i. Those in v and X that do not go through P and G are kept.
  void forces(const T* mu, const T* px_bar, const T* sums, const Vec3T& lq, const Vec3T& lp, T* P_bar, T* G_bar);
  // The charts' displacements of body-fixed rotations.
  void into_chart(const T* turn, T* X) const;
  // Gradients in X, from those in the bodies' turns at the stages.
  void charts(const T* turn_bar, T* X_bar) const;
  // Adds to the gradients in v what does not go through P and G; sums: h sum_i a_ij X_bar_i.
  void velocities(const T* sums, T* v_bar) const;

  // Gradients in the start, dual to its turn and momentum, and the share of the gradient in h, times h.
  void start(const T* turn_bar, const Vec3T& lq, Vec3T& lq0, Vec3T& lp0) const;
  T length(const T* sums) const;

 private:
  struct Stage {
    Mat3T J, J_inverse, turn;         // J(X) and exp(X)
    Mat3T rate_X, Y_X, p_X;           // d(X')/dX, d(exp(X) G)/dX, d(J^-T px)/dX
    Mat3T force_P, force_v, force_X;  // of px', the rate of the chart momentum; that in G is J^T
    Vec3T rate, Y, px_rate;           // X', exp(X) G, px'
    Vec3T px_rate_bar, v_bar, X_bar;  // gradients
  };
  Vec3T get(const T* array, int i) const;
  void put(T* array, int i, const Vec3T& x) const;

  int dof_, S_ = 0;
  std::vector<Stage> at_;
  std::vector<T> hb_;
  Mat3T end_J_, end_turn_, start_X_;                         // at X_1; d(J(X_1)^T p_1)/dX_1
  Vec3T p1_, total_bar_, X1_bar_;                            // gradients in exp(X_1) p_1 and in X_1
  Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic> system_;  // the equations of X_bar
  Eigen::PartialPivLU<MatX> charts_;                         // of their values
};

using BallAdjoint = BallAdjointOf<double>;

}  // namespace contactvi
