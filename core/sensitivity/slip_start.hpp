// The directions of slips that begin at the start of a held step, as functions of the state there.
//
// What begins to slide has no slip yet whose direction it could have: it goes along its acceleration. With the forces f
// of the phase that begins, along the rows W and the directions F = W_n - mu W_t d of what slides (held_node.hpp),
//   W^T (a + M^-1 F f) + dW^T v + d2phi/dt2 = 0,
// a the acceleration without contacts and dW the change of the rows along v, the acceleration of such a slip across its
// direction is zero. That holds where a force of sticking has just come to its cone, too, where the slip does not
// accelerate yet. Its derivative would need the third derivatives of gaps: it is taken by fourth-order differences,
// which are right to 1e-10.
#pragma once

#include "sensitivity/contact_step_tangent.hpp"
#include "sensitivity/held_node.hpp"
#include "sensitivity/motion_parameters.hpp"
#include "sensitivity/shared_load.hpp"
#include "step/integrator.hpp"

namespace contactvi {

class SlipStart {
 public:
  explicit SlipStart(const Scene& scene);

  // Takes the start of a step with its inputs; begins: the slides that have no slip there. phase: set to its contacts
  // and joints. False where a gap near it has no second derivative.
  bool take(const HeldStepRecord& step, PersistentRows& phase, std::vector<int> begins, const VecX& tau,
            const Servo* servo);
  const std::vector<int>& begins() const { return begins_; }
  // Adds to turns, the changes of all directions, (slides,), those of the slips that begin. dmu: of the coefficients of
  // friction of the slides.
  void add_turns(const ContactStepDirection& direction, const VecX& dmu, VecX& turns);
  // Adds what the gradients in their directions, of lturns, make of the gradients in the other ones, in the
  // coefficients of friction, (slides,) or none, and in parameters.
  void pass(VecX& lturns, VecX& lmu, StepParameters& sums);

 private:
  // What the accelerations across the directions are functions of.
  struct Place {
    VecX q, p, tau, mu, angles;
    double t = 0.0;  // of motions and forces [s]
  };
  void set_time_rates(double step_length);
  VecX across(const Place& place);
  template <class Size, class Move>
  MatX differences(Eigen::Index count, Size size, Move move);
  double follow_forces(const Place& at, const VecX& f, VecX& mu) const;
  void solve_turns(const MatX& mobility);

  const Scene* scene_;
  Integrator masses_;
  HeldNode node_;
  MotionParameters parameters_;
  const HeldStepRecord* record_ = nullptr;
  PersistentRows* phase_ = nullptr;
  std::vector<int> begins_;
  std::vector<Eigen::Index> rows_of_slides_;
  VecX v_, a_;
  Place start_;
  SharedLoad system_;
  bool known_ = true;
  // Of the directions that begin, by what the others are named after; turn_: of the frames of all slides about their
  // normals, (slides, nv).
  MatX by_q_, by_p_, by_tau_, by_mu_, by_others_, by_t_, turn_;
};

}  // namespace contactvi
