// A dense step as it was taken, with all that its derivative needs. Engine coordinates.
//
// Rows of impulses: those of the constraints of the scene (constraints.hpp), one per degree of freedom with joint
// friction, then those of the contacts, 3 or 1 each.
#pragma once

#include <vector>

#include "contact/dense_candidates.hpp"

namespace contactvi {

struct DenseStepRecord {
  // A point that had an impulse in the step.
  struct Contact {
    ContactPoint point, law;  // as it was found, and as the step saw it
    double mu, restitution;
    double allowed;  // what its gap may be at the end, at most 0 [m]
    contactvi::Contact start, end;
    Vec3 t1_start, t1_end;  // tangents there, world
    bool closed, expands;   // took part in the velocity impulse, in the expansion
    int row;                // its first row
    int found;              // the place at whose end it was found; -1: at the start of the step
    // Whether its adhesion is known, as DenseContact has it.
    bool knows_pull = false;
    Eigen::Vector2d pull = Eigen::Vector2d::Zero(), pull_rate = pull;
  };
  // The end of a motion of the step, about which the law was linearised, or which the gap iterations have led to.
  struct Place {
    VecX q, v;                            // end, and velocity of the stage
    VecX lambda;                          // with these impulses; of constraints also in the step without others
    std::vector<contactvi::Contact> end;  // of the contacts
    std::vector<Vec3> t1;
    MatX W;  // (nv, rows)
  };
  // One solution of the whole law, and the gap iterations after it, which led to the next place.
  struct Round {
    int about;                           // the place about which gaps were linearised
    bool anew;                           // velocities change from those of the step without impulses, not of that place
    int slips;                           // the place with which the slips of lasting contacts were made
    std::vector<char> present, lasting;  // of the contacts
    // Of the law, before the gap iterations. Impulses of constraints: those of the place from which velocities change
    // and what the law adds to them; without the former where they change from those of the step without impulses.
    VecX lambda, v;
  };
  struct Joint {
    int dof;
    double limit;  // of its friction [N; N m]
  };

  double t, h;          // start and length [s]
  double share;         // h of what was left of the control step; 0: the length does not depend on it
  double allowed_rate;  // of what overlaps may be left, in the length [m/s]
  VecX q0, p0;
  int constraints = 0;  // rows of constraints: all that the scene has
  std::vector<Joint> joints;
  std::vector<Contact> contacts;
  MatX W0, W1;                // at the start and the end, (nv, rows)
  MatX D;                     // the masses of the law of the position impulse, (nv, nv)
  std::vector<Place> places;  // the first one is that of the step without impulses, the last one its end
  std::vector<Round> rounds;  // round k led to place k + 1
  VecX lambda;                // position impulse
  VecX p_minus, p1;           // before the velocity impulse, at the end
  VecX plastic, v_plastic;    // velocity impulse without restitution, and the velocity after it
  VecX expansion;             // of restitution; empty: none
  VecX v_expansion;           // the velocity with the whole of it
  double expanded;            // the share of it that was taken
  VecX v1;
  double gap_solved;  // [m] to which gaps of loaded contacts are zero
  double residual;    // of Coulomb's law (DenseReport)
  int repaired;       // problems whose answer is not the law's
  bool keeps_energy;  // points were pushed no further than they would be at rest

  // Row of a joint.
  Eigen::Index row_of(std::size_t joint) const { return constraints + static_cast<Eigen::Index>(joint); }
};

}  // namespace contactvi
