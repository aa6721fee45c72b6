// What the equations of motion at an instant have of the parameters of the scene.
//
// With the momentum P(q, v) and the gradient G of the Lagrangian, dP/dt + [v, P] = G + forces, where [v, P] = omega x P
// on spherical joints and zero on others. All of them are linear in the parameters: at a fixed (q, p) a change of the
// parameters acts like one of p by -dP, and one of the generalized force by dG + dforces - d(dP/dt + [v, P]), all at
// the velocity v and the acceleration a that belong to (q, p) with all forces. dP/dt is taken by fourth-order
// differences along the motion.
#pragma once

#include "step/step_parameters.hpp"

namespace contactvi {

class MotionParameters {
 public:
  explicit MotionParameters(const Tree& tree);

  // Takes an instant; the servo is to stay alive. Engine coordinates.
  void take(const VecX& q, const VecX& v, const VecX& a, const Servo* servo);
  // The changes of the momentum and of the generalized force that a change of the parameters acts like, (nv,) each.
  void change(const StepParameters& direction, VecX& dp, VecX& dforce);
  // The transpose: adds the gradient in the parameters to that of sums.
  void add_gradient(const VecX& lp, const VecX& lforce, StepParameters& sums);

 private:
  struct Moment {
    VecX q, v;
    double weight;  // of its momentum in dP/dt [1/s]
  };

  const Tree* tree_;
  FlatModel model_;
  Stages node_;
  ParameterTangent tangent_;
  ParameterAdjoint adjoint_;
  VecX q_, v_;
  std::vector<Moment> around_;
};

}  // namespace contactvi
