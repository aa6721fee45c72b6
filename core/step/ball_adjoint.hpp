// The equations of one spherical joint in a step (lanes/lane_iteration.hpp), transposed.
//
// From the multipliers mu_i of the stage equations and the gradient (lq, lp) at the end of the step to the gradients
// in the momentum P, the force G, the velocity v and the chart X at each stage, by 3x3 matrices that are made once per
// step. A gradient in a turn is dual to body-fixed rotations. Arrays are those of the stages, [dof * S + stage], and
// begin at the joint's first dof.
#pragma once

#include <Eigen/LU>
#include <vector>

#include "step/stages.hpp"

namespace contactvi {

class BallAdjoint {
 public:
  BallAdjoint(int dof, int stages);

  int dof() const { return dof_; }
  // Takes a solved step, G with all its forces.
  void take(const Stages& stages, const VecX& p0);

  // Gradients in the chart momenta of the stages.
  void chart_momenta(const double* mu, double* px_bar) const;
  // Gradients in P and G; sums: h sum_i a_ij px_bar_i. Those in v and X that do not go through P and G are kept.
  void forces(const double* mu, const double* px_bar, const double* sums, const Vec3& lq, const Vec3& lp, double* P_bar,
              double* G_bar);
  // The charts' displacements of body-fixed rotations.
  void into_chart(const double* turn, double* X) const;
  // Gradients in X, from those in the bodies' turns at the stages.
  void charts(const double* turn_bar, double* X_bar) const;
  // Adds to the gradients in v what does not go through P and G; sums: h sum_i a_ij X_bar_i.
  void velocities(const double* sums, double* v_bar) const;

  // Gradients in the start, dual to its turn and momentum, and the share of the gradient in h, times h.
  void start(const double* turn_bar, const Vec3& lq, Vec3& lq0, Vec3& lp0) const;
  double length(const double* sums) const;

 private:
  struct Stage {
    Mat3 J, J_inverse, turn;         // J(X) and exp(X)
    Mat3 rate_X, Y_X, p_X;           // d(X')/dX, d(exp(X) G)/dX, d(J^-T px)/dX
    Mat3 force_P, force_v, force_X;  // of px', the rate of the chart momentum; that in G is J^T
    Vec3 rate, Y, px_rate;           // X', exp(X) G, px'
    Vec3 px_rate_bar, v_bar, X_bar;  // gradients
  };
  Vec3 get(const double* array, int i) const;
  void put(double* array, int i, const Vec3& x) const;

  int dof_, S_ = 0;
  std::vector<Stage> at_;
  std::vector<double> hb_;
  Mat3 end_J_, end_turn_, start_X_;  // at X_1; d(J(X_1)^T p_1)/dX_1
  Vec3 p1_, total_bar_, X1_bar_;     // gradients in exp(X_1) p_1 and in X_1
  MatX system_;
  Eigen::PartialPivLU<MatX> charts_;  // of the equations of X_bar
};

}  // namespace contactvi
