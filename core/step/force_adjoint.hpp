// The transposed derivatives of the forces in G besides gravity, at the stages of a solved step: linear forces, springs
// of spherical joints, inputs on split joints, and the elements. Engine coordinates; arrays over dofs and stages.
#pragma once

#include <vector>

#include "model/force_tangent.hpp"
#include "step/solved_step.hpp"

namespace contactvi {

class ForceAdjoint {
 public:
  ForceAdjoint(const Tree& tree, int stages);

  // Makes the matrices of the forces that are not linear, once per step.
  void take(SolvedStep& step);
  // v_bar += F_v^T G_bar and q_bar += F_q^T G_bar at all stages.
  void add(const double* G_bar, double* v_bar, double* q_bar);
  // The gradient in the inputs, public coordinates, (nv,).
  void inputs(const double* G_bar, VecRef ltau) const;

 private:
  struct Spring {
    int dof;
    std::vector<Mat3> slope;  // dG/d(turn of the body) per stage
  };
  struct Input {
    int dof, turn_dof, size;  // linear dofs, first dof of the turn, number of linear dofs
    Vec3 tau;
    std::vector<Mat3> axes;  // of the body in the world, per stage
  };
  void take_springs(SolvedStep& step);
  void take_inputs(SolvedStep& step);
  void take_elements(SolvedStep& step);
  Vec3 get(const double* array, int dof, int stage) const;
  void add_to(double* array, int dof, int stage, double x) const;

  const Tree* tree_;
  ForceTangent field_;
  const double *stiffness_ = nullptr, *damping_ = nullptr;
  int s_, S_ = 0;
  std::vector<Spring> springs_;
  std::vector<Input> inputs_;
  std::vector<MatX> slope_q_, slope_v_;  // of the elements, per stage
  VecX q_, v_, dq_, dv_, df_, bar_;
};

}  // namespace contactvi
