// What coupled joints (followers.hpp) make of configurations, velocities, momenta and rows.
#pragma once

#include <vector>

#include "model/tree.hpp"

namespace contactvi {

// Makes these the followers of the tree.
void set_followers(Tree& tree, std::vector<Follower> followers);

// Followers take the numbers of their leaders.
void follow_configuration(const Tree& tree, VecRef q);
void follow_velocity(const Tree& tree, VecRef v);
// p <- what S^T p is of the leaders, and 0 of the followers.
void fold_momentum(const Tree& tree, VecRef p);
// Each column w of W becomes the one of least norm with the same S^T w.
void project_rows(const Tree& tree, Eigen::Ref<MatX> W);
// The complement C, a column e_follower - sum ratio e_leader for each follower, (nv, followers).
MatX complement(const Tree& tree);

}  // namespace contactvi
