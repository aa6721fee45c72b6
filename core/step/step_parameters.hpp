// Gradients in the parameters of a tree and of its servos, from those that a step's transposed derivative gives in the
// momenta P and forces G: a parameter pi adds P_bar . dP/dpi + G_bar . dG/dpi at each stage. Engine coordinates.
#pragma once

#include "model/body_twists.hpp"
#include "step/stages.hpp"

namespace contactvi {

// Gradients summed over steps, or a direction of all parameters.
struct StepParameters {
  explicit StepParameters(const Tree& tree);

  // Per joint, of the body that it moves and in that body's frame: mass, first moment (3), rotational inertia about
  // the frame's origin (xx xy xz yy yz zz).
  Eigen::Matrix<double, Eigen::Dynamic, 10> inertia;
  VecX armature, damping, rest;     // nv; rest: dual to turns and displacements of the springs' rest configuration
  VecX stiffness;                   // of the springs, per joint
  VecX kp, kd, q_ref, v_ref, feed;  // of the servos, nv
  Vec3 gravity;
};

class ParameterAdjoint {
 public:
  explicit ParameterAdjoint(const Tree& tree);

  // At a state (q, v): what P and the gradient of the Lagrangian have of inertias and gravity.
  void add_state(const VecCRef& q, const VecCRef& v, const VecCRef& P_bar, const VecCRef& G_bar, StepParameters& sums);
  // What the forces at stage i of a step from q0 have of springs, damping and servos.
  void add_forces(const Stages& stages, const VecCRef& q0, int i, const VecCRef& G_bar, StepParameters& sums) const;

 private:
  const Tree* tree_;
  BodyTwists bodies_;
};

// The derivatives along a direction of the parameters.
class ParameterTangent {
 public:
  explicit ParameterTangent(const Tree& tree);

  // Adds those of the momenta P = M v and of the Lagrangian's gradient G at a state, (nv,) each.
  void add_state(const VecCRef& q, const VecCRef& v, const StepParameters& direction, VecRef dP, VecRef dG);
  // Adds those of the forces at stage i of a step from q0.
  void add_forces(const Stages& stages, const VecCRef& q0, int i, const StepParameters& direction, VecRef dG) const;

 private:
  const Tree* tree_;
  BodyTwists bodies_;
  std::vector<Wrench> momentum_, weight_;  // of a body with all that it carries, about the world's origin
};

}  // namespace contactvi
