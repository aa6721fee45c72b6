// One contact point that is held, and what is known of it from step to step.
#pragma once

#include "geometry/manifold.hpp"

namespace contactvi {

struct PersistentContact {
  ContactPoint point;
  double mu = 0;             // 0: one row, no friction
  bool sticks = true;        // at the node: its points do not slip on each other
  Vec3 slip = Vec3::Zero();  // there [m/s], world
  bool anchored = false;
  Vec3 anchor;                // of a material point that sticks: its place in the plane's body frame
  Vec3 tangent;               // t1; of a vertex in the plane's body frame, else world, carried along with the normal
  Vec3 force = Vec3::Zero();  // (n, t1, t2) in the last step [N], to start from

  int rows() const { return mu > 0.0 ? 3 : 1; }
};

// What a step did to a held contact.
struct ContactOutcome {
  Contact contact;       // at the end
  Vec3 t1, t2;           // world, at the end
  Vec3 start_W, end_W;   // impulses on b of the two kicks [N s], world
  Vec3 start, end;       // the same as (n, t1, t2)
  Vec3 slip_W;           // relative velocity of the points along the tangent plane at the end [m/s]
  double w_n = 0;        // normal speed at the end
  bool slipped = false;  // during the step
  bool slips = false;    // at its end
  bool turned = false;   // the step's slip is against that at its start
  double reversed = 0;   // w_t . d of a contact that slipped along d, if its friction had gone on; else 0
  bool active = false;   // took part in the end kick
  double paradox = 0;    // A = W_n M^-1 (W_n - mu W_t^T d)^T of a slipping contact: <= 0 is Painleve's
};

}  // namespace contactvi
