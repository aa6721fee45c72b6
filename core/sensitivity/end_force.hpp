// The continuous force that ends a phase of contact at the end of a step, as a function of the state there; its zero is
// the time of that end. It is the normal force of a contact that is released, or what is left of the friction that what
// sticks can have, of a contact or of a joint, where it begins to slip.
//
// With the contacts that carry load, and stick or slip: G f + W^T a + dW^T v + d2phi/dt2 = 0 in the rows of the
// constraints, of the normals and of what sticks, f_t = -mu f_n d of what slips, f_t = 0 of the contact that sticks and
// is released, and the same of what rolls with friction against it; a is the acceleration without contacts, with
// adhesion, and dW the change of the rows along v (ContactTangent, ConstraintTangent), to which surfaces that move
// along themselves add the rate of their velocities.
// Its derivative would need the third derivatives of gaps and constraints: it is taken by fourth-order differences,
// which are right to 1e-10.
#pragma once

#include "geometry/contact_tangent.hpp"
#include "geometry/guard.hpp"
#include "geometry/surface_velocity_tangent.hpp"
#include "model/constraint_tangent.hpp"
#include "model/friction_state.hpp"
#include "sensitivity/friction_rows.hpp"
#include "sensitivity/motion_parameters.hpp"
#include "sensitivity/recorded_run.hpp"
#include "sensitivity/shared_load.hpp"
#include "step/integrator.hpp"

namespace contactvi {

// The end of a step that a force ends.
struct PhaseEnd {
  struct Contact {
    PersistentContact before;
    Vec3 t1, normal;  // at the end, world
    bool slips;       // there
    int row;
    bool rolls = false;  // with friction against it
  };
  struct Joint {
    int dof;
    double limit;
  };
  double time;  // of the end [s]
  VecX q, p, v;
  int rows;
  std::vector<Joint> joints;  // their rows follow those of the constraints
  std::vector<Contact> contacts;
  int ended;      // contact, or joint, which count after the contacts
  bool releases;  // a contact; else it begins to slip
};
// Of a contact step that ends with a release.
PhaseEnd release_of(const ContactStepRecord& step);

class EndForce {
 public:
  EndForce(const Scene& scene, const RecordedRun& run);

  // Takes the end of a step with its inputs, which are to stay alive. Throws NoDerivative.
  void take(PhaseEnd end, const VecX& tau, const Servo* servo);
  const PhaseEnd& end() const { return end_; }
  const Scene& scene() const { return *scene_; }
  // The derivative of the force [N] along a change of (q1, p1), and of the inputs and the coefficients of friction of
  // the contacts, which may be empty.
  double change(const VecX& dq, const VecX& dp, const VecX& dtau, const VecX& dmu);
  // That along a change of the parameters of the scene.
  double change(const StepParameters& parameters);
  // Adds its gradient in the parameters to sums, from that in p1 and the one in the inputs.
  void add_parameters(const VecX& lp, const VecX& ltau, StepParameters& sums);
  // Its derivative by time, along the motion with the rates fq, fp of (q1, p1): prescribed motions go on.
  double rate(const VecX& fq, const VecX& fp);

 private:
  // A contact by its number, with a coefficient that depends on its force.
  using Loaded = std::pair<std::size_t, FrictionState>;
  double follow_forces(std::vector<Loaded>& states) const;
  double settle_loads();
  double rate_in_time(double rest);
  double force(const VecX& q, const VecX& p, const VecX& tau, const VecX& mu);
  void set_weights(const std::vector<Vec3>& t1, const std::vector<Vec3>& normals, const VecX& mu);
  void refuse(const std::string& got) const;

  const Scene* scene_;
  double t0_;  // of the run [s]
  Integrator masses_;
  Guards guards_;
  ContactTangent tangent_;
  SurfaceVelocityTangent surface_;
  ConstraintTangent constraints_;
  double time_ = 0.0;  // [s] at which prescribed motions and forces are taken
  MotionParameters parameters_;
  PhaseEnd end_;
  const VecX* tau_ = nullptr;
  std::vector<char> loaded_;  // which contacts carry load
  bool any_adhesion_ = false;
  VecX weights_;  // of the forces of the rows in the force
  VecX mu_;
  // Of the rows, at the last evaluation; measured_: the forces, where something sticks with a coefficient that depends
  // on its force the bound on its friction in the place of that.
  VecX forces_, accelerations_, measured_;
  MatX W_, dW_, A_;
  VecX v_, a_;
  SharedLoad system_;
  double size_ = 0.0;  // of the terms of the forces at the last evaluation [N]
};

}  // namespace contactvi
