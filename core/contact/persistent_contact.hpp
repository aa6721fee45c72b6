// A persistent contact: one point that stays closed over steps, and its state from step to step.
#pragma once

#include <cmath>
#include <vector>

#include "geometry/manifold.hpp"
#include "model/scene.hpp"

namespace contactvi {

struct PersistentContact {
  ContactPoint point;
  double mu = 0;                // Coulomb's coefficient as it sticks or slides now; 0: one row, no friction
  bool sticks = true;           // at the node: the two material points have no relative tangential velocity
  Vec3 heading = Vec3::Zero();  // unit, world: where the slip goes that begins at the node; zero: nowhere
  Vec3 slip = Vec3::Zero();     // relative tangential velocity at the node [m/s], world
  bool anchored = false;        // whether `anchor` is set
  Vec3 anchor;                  // position at which a material point sticks [m], in the plane's body frame
  Vec3 tangent;                 // t1; of a vertex in the plane's body frame, else in the world, turned with the normal
  Vec3 force = Vec3::Zero();    // (n, t1, t2) in the last step [N]: start values of the next one
  bool is_new = false;          // while an event is resolved: the contact was not closed before it
  double pull_share = 1.0;      // of the adhesion of its pair: one over the most points that have touched at once
  Eigen::Vector2d body_shares = Eigen::Vector2d::Ones();  // of those of its bodies (ContactLaw::body_pulls), likewise
  // Its slip is a velocity also where a material point touches: a surface moves along itself, or friction depends
  // on the direction.
  bool by_velocity = false;
  // Friction against spinning and rolling: radii [m]; 0: none.
  double spinning = 0, rolling = 0;
  double spin = 0;                    // at the node: radius times relative angular velocity about the normal [m/s],
  Vec3 roll = Vec3::Zero();           // and about the tangents, world; both 0 without radii
  Vec3 turning_force = Vec3::Zero();  // (spin, roll1, roll2) in the last step, over the radii [N]

  int turning_rows() const { return (spinning > 0.0 ? 1 : 0) + (rolling > 0.0 ? 2 : 0); }
  int rows() const { return mu > 0.0 ? 3 + turning_rows() : 1; }
  int friction_rows() const { return spinning > 0.0 ? 3 : 2; }  // of the slip with the spin
  int rolling_row() const { return 1 + friction_rows(); }
  // Whether its slip is the displacement of a material point, and not a velocity: surfaces that roll on each other, or
  // move along themselves, have none.
  bool counts_by_place() const { return point.material && !by_velocity; }
  bool keeps_place() const { return mu > 0.0 && sticks && counts_by_place(); }
  bool slides() const { return mu > 0.0 && !sticks; }  // with friction
};

// Adhesion at the time t [s]: its part of what its pair and its bodies pull with [N], and its derivative by the time.
double adhesion(const Scene& scene, const PersistentContact& contact, double t);
double adhesion_rate(const Scene& scene, const PersistentContact& contact, double t);
bool any_adhesion(const Scene& scene, const std::vector<PersistentContact>& contacts);

// The result of a step for one persistent contact.
struct ContactOutcome {
  Contact contact;                              // at the end of the step
  Vec3 t1, t2;                                  // tangents there, world
  Vec3 position_impulse_W, velocity_impulse_W;  // on geometry b [N s], world
  Vec3 position_impulse, velocity_impulse;      // as (n, t1, t2) [N s]
  Vec3 slip_W;                                  // relative velocity of the points in the tangent plane at the end [m/s]
  double friction_work = 0;  // of both impulses [J], each with the mean of the slips before and after it
  double w_n = 0;            // normal speed at the end [m/s]
  bool slipped = false;      // during the step
  bool slips = false;        // at its end
  bool turned = false;       // the slip of the step is opposite to that at its start
  double reversed = 0;       // w_t . d at the end of a contact that slipped along d if its friction had gone on; else 0
  bool active = false;       // took part in the velocity impulse
  // Whether its velocity impulse keeps the direction of the slip of the step; whether it would have reversed the slip
  // beside others that all keep theirs.
  bool keeps = false, freed = false;
  Eigen::Vector2d slip = Eigen::Vector2d::Zero();  // over the step, along t1 and t2 at its end [m/s]; 0 if not slipped
  // A = W_n M^-1 (W_n - mu W_t^T d)^T of a contact that slips at the start [1/kg], <= 0 in Painleve's paradox; of a
  // step that jumps with what the other contacts answer; infinite where it does not apply.
  double paradox = INFINITY;
  bool jumps = false;  // its impulse does not go to zero with the step
  // Of spinning and rolling: impulses (spin, roll1, roll2) over the radii [N s], speeds at the end times the radii
  // [m/s]. The spin counts as a third component of the slip.
  Vec3 position_turning = Vec3::Zero(), velocity_turning = Vec3::Zero();
  double spin = 0;
  Vec3 roll_W = Vec3::Zero();
  bool rolled = false, rolls = false, roll_turned = false;  // as slipped, slips, turned
  bool roll_keeps = false, roll_freed = false;
  Vec3 turning_slip = Vec3::Zero();  // (spin, roll1, roll2) over the step, as slip; 0 where it did not slip or roll
  double roll_reversed = 0;
};

}  // namespace contactvi
