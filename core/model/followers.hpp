// Coupled joints: a joint with one number in q that follows others, q = offset + sum ratio q_leader, and v without the
// offset. They are no constraints with reactions but a change of coordinates v = S u (lanes/lane_coupled.hpp).
//
// Configurations, velocities and momenta keep the numbers of all joints. Those of followers in q and v are what their
// leaders give them; of a momentum or a force only S^T p has a meaning: what acts on a follower acts on its leaders.
#pragma once

#include <vector>

namespace contactvi {

struct Follower {
  struct Leader {
    int joint;
    double ratio;
    int iq = 0, iv = 0;
  };
  int joint;                    // engine joint
  double offset;                // [rad; m]
  std::vector<Leader> leaders;  // which follow no others
  int iq = 0, iv = 0;
};

// Followers whose trees belong together, and the range of joints in which these trees lie.
struct Coupling {
  int first, count;  // of Tree::followers
  int joint, joint_end;
};

}  // namespace contactvi
