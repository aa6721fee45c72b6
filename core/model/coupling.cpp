#include "model/coupling.hpp"

#include <Eigen/Cholesky>
#include <algorithm>

#include "base/disjoint_sets.hpp"

namespace contactvi {

void set_followers(Tree& tree, std::vector<Follower> followers) {
  const int joints = static_cast<int>(tree.joints.size());
  DisjointSets trees(joints);
  for (int j = 0; j < joints; ++j) trees.join(j, tree.joints[j].parent);
  for (Follower& f : followers) {
    f.iq = tree.joints[f.joint].iq;
    f.iv = tree.joints[f.joint].iv;
    for (Follower::Leader& leader : f.leaders) {
      leader.iq = tree.joints[leader.joint].iq;
      leader.iv = tree.joints[leader.joint].iv;
      trees.join(f.joint, leader.joint);
    }
  }
  std::stable_sort(followers.begin(), followers.end(),
                   [&](const Follower& a, const Follower& b) { return trees.root(a.joint) < trees.root(b.joint); });
  tree.couplings.clear();
  for (int k = 0; k < static_cast<int>(followers.size()); ++k) {
    const int root = trees.root(followers[k].joint);
    if (k > 0 && trees.root(followers[k - 1].joint) == root) {
      ++tree.couplings.back().count;
      continue;
    }
    Coupling coupling{k, 1, joints, 0};
    for (int j = 0; j < joints; ++j) {
      if (trees.root(j) != root) continue;
      coupling.joint = std::min(coupling.joint, j);
      coupling.joint_end = j + 1;
    }
    tree.couplings.push_back(coupling);
  }
  tree.followers = std::move(followers);
}

void follow_configuration(const Tree& tree, VecRef q) {
  for (const Follower& f : tree.followers) {
    double value = f.offset;
    for (const Follower::Leader& leader : f.leaders) value += leader.ratio * q[leader.iq];
    q[f.iq] = value;
  }
}

void follow_velocity(const Tree& tree, VecRef v) {
  for (const Follower& f : tree.followers) {
    double value = 0.0;
    for (const Follower::Leader& leader : f.leaders) value += leader.ratio * v[leader.iv];
    v[f.iv] = value;
  }
}

void fold_momentum(const Tree& tree, VecRef p) {
  for (const Follower& f : tree.followers) {
    for (const Follower::Leader& leader : f.leaders) p[leader.iv] += leader.ratio * p[f.iv];
    p[f.iv] = 0.0;
  }
}

MatX complement(const Tree& tree) {
  MatX C = MatX::Zero(tree.nv, static_cast<Eigen::Index>(tree.followers.size()));
  for (std::size_t k = 0; k < tree.followers.size(); ++k) {
    const Follower& f = tree.followers[k];
    C(f.iv, static_cast<Eigen::Index>(k)) = 1.0;
    for (const Follower::Leader& leader : f.leaders) C(leader.iv, static_cast<Eigen::Index>(k)) -= leader.ratio;
  }
  return C;
}

void project_rows(const Tree& tree, Eigen::Ref<MatX> W) {
  if (tree.followers.empty()) return;
  const MatX C = complement(tree);
  W -= C * (C.transpose() * C).llt().solve(C.transpose() * W);
}

}  // namespace contactvi
