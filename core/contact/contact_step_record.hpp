// A contact step as it was taken, with all that its derivative needs. Engine coordinates.
#pragma once

#include <vector>

#include "contact/persistent_contact.hpp"

namespace contactvi {

// What a contact step ended with: the length that it was given, an impact of another guard, the release of a contact,
// a slip that came to rest.
enum class ContactStepEnd { kLength, kImpact, kRelease, kStick };

struct ContactStepRecord {
  // Of a nominal step: shorter steps use rates instead of differences of positions.
  static constexpr double kShortestDifference = 1e-5;
  // A contact: before the step, at its two ends, and its impulses.
  struct Contact {
    PersistentContact before;
    contactvi::Contact start, end;
    Vec3 t1_start, t1_end;  // tangents there, world
    ContactOutcome outcome;
    int row;       // its first row
    bool by_rate;  // its gap counts by its rate, because the step is too short for a difference of gaps
  };
  // A degree of freedom with joint friction. Their rows follow those of the constraints.
  struct Joint {
    int dof, iq;
    double limit;
    bool by_place;              // its slip is a displacement, not a speed,
    bool anchored;              // and that counts from an anchor
    bool slipped, slips;        // during the step, at its end
    bool keeps, freed, sticks;  // as of a ContactOutcome; sticks at the end
  };

  double t, h, nominal;  // start, length, nominal length [s]
  double share;          // h of what was left of the control step; 0: the length does not depend on it
  VecX q0, p_start;      // p_start: with the position impulse
  VecX q1, p_minus, p1;  // p_minus: before the velocity impulse
  VecX v, v1;            // of the stage, and at the end
  VecX lambda, lambda_end;
  MatX W0, W1;  // (nv, rows)
  std::vector<Joint> joints;
  std::vector<Contact> contacts;
  bool constrained;  // there are bilateral constraints, those of the scene
  // Files of older versions do not keep what friction that varies, moving surfaces and adhesion need.
  bool lacks_laws = false;
  ContactStepEnd ending;
  int ended;  // which contact is released, or which slip came to rest (as ContactStep numbers them); else -1

  bool constraints_by_rate() const { return h < kShortestDifference * nominal; }
};

}  // namespace contactvi
