// The dense step: all impacts and contacts inside one step, without their times. It is taken where events accumulate.
//
// It is the step of persistent contact (contact_step.hpp) with impacts inside of it instead of located. Over the step h
// from q0 the candidates are the points of all pairs that may close within it; they keep their features over the step.
//   1. position impulse   p0 + W0^T L1 = smooth equation of v, q1 = q0 (+) h v,   0 <= L1_n _|_ phi(q1) >= 0, Coulomb
//   2. velocity impulse   over the closed ones, plastic: 0 <= L2_n _|_ w_n >= 0 at q1, Coulomb
//   3. restitution        contacts that closed fast: Poisson's expansion, an impulse of at least e (L1 + L2)_n
// Moreau, "Unilateral contact and dry friction in finite freedom dynamics", 1988; Acary, Brogliato, "Numerical methods
// for nonsmooth dynamical systems", 2008; nonsmooth RATTLE: Breuling, Capobianco, Eugster, Leine, 2024. It is of first
// order where impacts lie inside the step, of second where none do.
//
// Promised at every node, whatever the solver reached: impulses in the cone, gaps >= -1e-9 m against the simulated
// shapes, and an energy that rises by no more than the error of the step. A step that does not keep this is to be made
// again shorter (keeps_promises). The residual of Coulomb's law is reported.
#pragma once

#include <string>
#include <vector>

#include "base/error.hpp"
#include "cone/block_solver.hpp"
#include "geometry/guard.hpp"
#include "step/impulse_step.hpp"

namespace contactvi {

// A point that may touch in the step, and the result of the step for it.
struct DenseContact {
  ContactPoint point;
  ContactPoint law;  // the point as the step sees it (DenseStep::frozen)
  double mu, restitution;
  Contact at0, at1;         // at the start and the end of the step
  Vec3 t1_0, t1_1;          // tangents there, world
  Vec3 position, velocity;  // impulses (n, t1, t2) [N s]: with the rows of the start, of the end
  double closing;           // normal speed before the step [m/s], negative: closing
  double slip_speed;        // at the end [m/s]
  Vec3 slip_W;
  bool closed;   // takes part in the velocity impulse
  bool expands;  // restitution acts
  int rows() const { return mu > 0.0 ? 3 : 1; }
  Vec3 position_W() const;
  Vec3 velocity_W() const;
};

// What a dense step has reached.
struct DenseReport {
  double residual = 0.0;      // of Coulomb's law, over the largest free speed of a contact (block_solver.hpp)
  double gap = 0.0;           // least gap at the end [m]
  double gap_noise = 0.0;     // what of it is the error of the distance [m]
  double energy_rise = 0.0;   // how far the energy rose beyond energy_error and the works of inputs and damping [J]
  double energy_loss = 0.0;   // what contacts took: restitution and friction [J]
  double energy_error = 0.0;  // how much the energy may rise: the error of the step [J]
  int contacts = 0;           // that carried an impulse
  int repaired = 0;           // problems whose answer was repaired or blended
};

class DenseStep {
 public:
  DenseStep(const Scene& scene, Guards& guards);
  DenseStep(const DenseStep&) = delete;
  DenseStep& operator=(const DenseStep&) = delete;

  // False for scenes with constraints, whose rows the dense step does not have.
  bool available() const { return scene_->tree.elements.constraint_rows == 0; }
  void set_time(double t) { integrator_.set_time(t); }
  void set_servo(const Servo* servo) { integrator_.set_servo(servo); }
  // Forgets the impulses of the last step, from which the next one starts.
  void restart();

  // The step from (q0, p0). False only if the smooth equation is not solved or a number is not finite: why().
  bool solve(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau);
  void finish(VecRef q1, VecRef p1) const;
  // The step is taken: its impulses are the start values of the next one.
  void commit();

  // Results of the step just solved.
  const std::vector<DenseContact>& contacts() const { return contacts_; }
  const DenseReport& report() const { return report_; }
  const VecX& end_configuration() const { return q1_; }
  const VecX& stage_velocity() const { return v_; }
  const VecX& end_velocity() const { return v1_; }
  // Whether gaps and energy are within what is promised.
  bool keeps_promises() const;
  double h() const { return h_; }
  double joint_friction_loss() const { return joint_friction_loss_; }
  double work() const { return integrator_.work() - joint_friction_loss_; }
  const StepEquations& integrator() const { return integrator_; }
  const char* why() const { return why_; }

  // All that the next step depends on.
  struct Impulse {
    int guard;
    std::int64_t feature;
    Vec3 position_force, velocity_force;  // world frame [N]
  };
  struct Memory {
    std::vector<Impulse> impulses;
    VecX joint_friction;      // mean over the step [N; N m]
    std::vector<int> closed;  // guards of points that were closed at its end
    VecX change;              // of the velocity in the last step; empty: not known
    double h = 1.0;
  };
  const Memory& memory() const { return memory_; }
  void recall(const Memory& memory) { memory_ = memory; }

 private:
  // A pair that may close in the step, or a joint limit.
  struct Near {
    int guard;
    double gap0, reach;  // reach: how much nearer its bodies may come [m]
    Contact witness0;
    double gap1;
  };

  bool solve_smooth(const VecCRef& q0, const VecCRef& p0, double h, const VecX& tau);
  bool iterate_stage();
  void make_step_blocks();
  void make_node_blocks();
  void invert_blocks();
  void collect(const VecCRef& q0);
  void set_start_impulses(DenseContact& c) const;
  void add_rims(const Near& near);
  ContactPoint frozen(const ContactPoint& point, const Contact& witness) const;
  bool add_point(const ContactPoint& point, const ContactPoint& law, const Contact& witness0);
  void evaluate(const ContactPoint& point, const Contact* witness, Contact& contact);
  void set_rows(bool at_end);
  void write_row(int column, int size, int first_dof, int body, const Vec3& x, const Vec3& n, double sign);
  void set_mobilities();
  bool position_problem();
  bool gap_iterations(double h);
  double place_end(double h);
  bool add_violated();
  bool velocity_problem(double bound_energy);
  void restitution_problem(double bound_energy);
  double expansion_share(const VecX& plastic, double bound_energy) const;
  double smooth_contact_error() const;
  double fastest_turn() const;
  void account(const BlockResult& result);

  const Scene* scene_;
  Guards* guards_;
  ImpulseStep integrator_;
  BlockSolver solver_;
  BlockProblem problem_;
  std::vector<int> tree_of_joint_;
  std::vector<Near> near_;
  std::vector<int> candidates_;
  std::vector<DenseContact> contacts_;
  std::vector<int> active_;       // contacts of the present problem
  std::vector<double> mobility_;  // of each of them along the normal [1/kg]
  std::vector<ContactPoint> points_, laws_;
  Memory memory_;
  VecX q0_, p0_, v0_, v_free_, v_, v1_, q1_, p1_, p_start_, lambda_, lambda_v_, joint_friction_, bound_, w_;
  MatX columns_;
  DenseReport report_;
  double h_ = 0.0, joint_friction_loss_ = 0.0, solver_error_ = 0.0;
  const char* why_ = "";
};

}  // namespace contactvi
