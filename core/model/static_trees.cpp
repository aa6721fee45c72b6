#include "model/static_trees.hpp"

#include <algorithm>
#include <numeric>

#include "base/disjoint_sets.hpp"
#include "model/coupling.hpp"

namespace contactvi {

namespace {

void join_constraint(DisjointSets& sets, const Constraint& c) {
  if (c.kind == ConstraintKind::kEquality) {
    sets.join(c.joint_a, c.joint_b);
  } else if (c.kind != ConstraintKind::kPrescribed) {
    sets.join(c.a.body, c.b.body);
  }
}

// New number of each old one; -1: left out.
std::vector<int> inverse(const std::vector<int>& list, std::size_t size) {
  std::vector<int> found(size, -1);
  for (std::size_t i = 0; i < list.size(); ++i) found[list[i]] = static_cast<int>(i);
  return found;
}

VecX slice(const VecX& values, const std::vector<int>& chosen) {
  if (values.size() == 0) return values;
  VecX part(static_cast<Eigen::Index>(chosen.size()));
  for (std::size_t i = 0; i < chosen.size(); ++i) part[static_cast<Eigen::Index>(i)] = values[chosen[i]];
  return part;
}

// Numbers of the whole in those of a part; -1 is the world.
struct NewNumbers {
  std::vector<int> joint, q, v;
  int of_joint(int j) const { return j < 0 ? -1 : joint[j]; }
};

bool inside(const NewNumbers& now, const BodyFrame& frame) { return frame.body >= 0 && now.joint[frame.body] >= 0; }

void restrict_tree(const Tree& whole, const SubScene& sub, const NewNumbers& now, Tree& tree) {
  tree.nq = static_cast<int>(sub.q.size());
  tree.nv = static_cast<int>(sub.v.size());
  tree.gravity = whole.gravity;
  for (int j : sub.joints) {
    Joint joint = whole.joints[j];
    joint.parent = now.of_joint(joint.parent);
    joint.iq = now.q[joint.iq];
    joint.iv = now.v[joint.iv];
    tree.has_springs |= joint.stiffness != 0.0;
    tree.joints.push_back(std::move(joint));
  }
  for (int d : sub.v) {
    tree.dof_joint.push_back(now.joint[whole.dof_joint[d]]);
    tree.dof_parent.push_back(whole.dof_parent[d] < 0 ? -1 : now.v[whole.dof_parent[d]]);
  }
  tree.armature = slice(whole.armature, sub.v);
  tree.lent_armature = slice(whole.lent_armature, sub.v);
  std::vector<Follower> followers;
  for (Follower f : whole.followers) {
    f.joint = now.of_joint(f.joint);
    if (f.joint < 0) continue;
    for (Follower::Leader& leader : f.leaders) leader.joint = now.of_joint(leader.joint);
    followers.push_back(std::move(f));
  }
  set_followers(tree, std::move(followers));
  tree.damping = slice(whole.damping, sub.v);
  tree.rest = slice(whole.rest, sub.q);
  tree.has_damping = whole.has_damping && (tree.damping.array() != 0.0).any();
  for (SplitJoint split : whole.split) {
    if (now.v[split.iv] < 0) continue;
    split.iq = now.q[split.iq];
    split.iv = now.v[split.iv];
    tree.split.push_back(split);
  }
}

void restrict_forces(const Elements& whole, const NewNumbers& now, Elements& part) {
  for (JointPotential potential : whole.joint_potentials) {
    potential.joint = now.of_joint(potential.joint);
    if (potential.joint >= 0) part.joint_potentials.push_back(std::move(potential));
  }
  for (PathSpring spring : whole.path_springs) {
    bool any = false;
    for (const BodyFrame& point : spring.points) any |= inside(now, point);
    for (BodyFrame& point : spring.points) point.body = now.of_joint(point.body);
    if (any) part.path_springs.push_back(std::move(spring));
  }
  for (CompliantContact contact : whole.compliances) {
    const int a = now.of_joint(contact.body_a), b = now.of_joint(contact.body_b);
    if (a < 0 && b < 0) continue;
    contact.body_a = a;
    contact.body_b = b;
    part.compliances.push_back(std::move(contact));
  }
  for (AppliedWrench wrench : whole.wrenches) {
    if (!inside(now, wrench.at)) continue;
    wrench.at.body = now.of_joint(wrench.at.body);
    part.wrenches.push_back(std::move(wrench));
  }
}

void restrict_constraints(const Elements& whole, const NewNumbers& now, SubScene& sub, Elements& part) {
  for (Constraint c : whole.constraints) {
    const bool joints = c.kind == ConstraintKind::kEquality || c.kind == ConstraintKind::kPrescribed;
    const int body = joints ? c.joint_b : c.a.body >= 0 ? c.a.body : c.b.body;
    if (now.of_joint(body) < 0) continue;
    c.a.body = now.of_joint(c.a.body);
    c.b.body = now.of_joint(c.b.body);
    c.joint_a = now.of_joint(c.joint_a);
    c.joint_b = now.of_joint(c.joint_b);
    for (int k = 0; k < c.rows; ++k) sub.constraint_rows.push_back(c.row + k);
    c.row = part.constraint_rows;
    part.constraint_rows += c.rows;
    part.constraints.push_back(std::move(c));
  }
}

void restrict_elements(const Elements& whole, const NewNumbers& now, SubScene& sub, Elements& part) {
  part.joint_friction = slice(whole.joint_friction, sub.v);
  for (std::size_t k = 0; k < whole.friction_dofs.size(); ++k) {
    if (now.v[whole.friction_dofs[k]] < 0) continue;
    part.friction_dofs.push_back(now.v[whole.friction_dofs[k]]);
    sub.friction.push_back(static_cast<int>(k));
  }
  const auto any = [](const VecX& values) { return values.size() > 0 && (values.array() != 0.0).any(); };
  part.servo_kp = slice(whole.servo_kp, sub.v);
  part.servo_kd = slice(whole.servo_kd, sub.v);
  part.servo_effort = slice(whole.servo_effort, sub.v);
  if (!any(part.servo_kp) && !any(part.servo_kd)) part.servo_kp = part.servo_kd = part.servo_effort = VecX();
  part.effort = slice(whole.effort, sub.v);
  part.speed = slice(whole.speed, sub.v);
  const auto finite = [](const VecX& values) { return values.size() > 0 && values.array().isFinite().any(); };
  if (!finite(part.effort)) part.effort = VecX();
  if (!finite(part.speed)) part.speed = VecX();
  part.functions = whole.functions;
  restrict_forces(whole, now, part);
  restrict_constraints(whole, now, sub, part);
  part.forces = whole.forces;  // functions of the whole state: then there is one static tree
  part.potentials = whole.potentials;
}

void restrict_geometry(const Scene& whole, const StaticTrees& trees, const std::vector<int>& chosen,
                       const NewNumbers& now, SubScene& sub) {
  std::vector<int> pairs;
  for (int t : chosen) {
    pairs.insert(pairs.end(), trees.own_pairs(t).begin(), trees.own_pairs(t).end());
    for (const StaticTrees::CrossPair& cross : trees.cross_pairs(t))
      if (cross.tree > t && std::binary_search(chosen.begin(), chosen.end(), cross.tree)) pairs.push_back(cross.pair);
  }
  std::sort(pairs.begin(), pairs.end());
  for (int t : chosen)
    sub.geometries.insert(sub.geometries.end(), trees.geometries(t).begin(), trees.geometries(t).end());
  for (int k : pairs)
    for (int g : {whole.pairs[k].a, whole.pairs[k].b})
      if (trees.of_geometry(g) < 0) sub.geometries.push_back(g);
  std::sort(sub.geometries.begin(), sub.geometries.end());
  sub.geometries.erase(std::unique(sub.geometries.begin(), sub.geometries.end()), sub.geometries.end());
  for (int g : sub.geometries) {
    Geometry geometry = whole.geometries[g];
    geometry.body = now.of_joint(geometry.body);
    sub.scene.geometries.push_back(std::move(geometry));
  }
  const auto number = [&](int g) {
    const auto at = std::lower_bound(sub.geometries.begin(), sub.geometries.end(), g);
    return static_cast<int>(at - sub.geometries.begin());
  };
  sub.scene.laws = whole.laws;
  sub.scene.surface_motions = whole.surface_motions;
  sub.scene.body_pulls = whole.body_pulls;
  for (int k : pairs) {
    Pair pair = whole.pairs[k];
    pair.a = number(pair.a);
    pair.b = number(pair.b);
    sub.scene.pairs.push_back(pair);
    sub.guards.push_back(k);
  }
}

}  // namespace

StaticTrees::StaticTrees(const Scene& scene) {
  const Tree& tree = scene.tree;
  const Elements& e = tree.elements;
  DisjointSets sets(static_cast<int>(tree.joints.size()));
  for (std::size_t j = 0; j < tree.joints.size(); ++j) sets.join(static_cast<int>(j), tree.joints[j].parent);
  for (const Constraint& c : e.constraints) join_constraint(sets, c);
  for (const Follower& f : tree.followers)
    for (const Follower::Leader& leader : f.leaders) sets.join(f.joint, leader.joint);
  for (const PathSpring& spring : e.path_springs) {
    int first = -1;
    for (const BodyFrame& point : spring.points) {
      sets.join(first, point.body);
      if (first < 0) first = point.body;
    }
  }
  for (const CompliantContact& contact : e.compliances) sets.join(contact.body_a, contact.body_b);
  if (!e.forces.empty() || !e.potentials.empty())
    for (std::size_t j = 0; j < tree.joints.size(); ++j) sets.join(0, static_cast<int>(j));
  of_joint_.assign(tree.joints.size(), -1);
  for (std::size_t j = 0; j < tree.joints.size(); ++j) {
    const int root = sets.root(static_cast<int>(j));
    if (root == static_cast<int>(j)) {
      of_joint_[j] = static_cast<int>(joints_.size());
      joints_.emplace_back();
    } else {
      of_joint_[j] = of_joint_[root];
    }
    joints_[of_joint_[j]].push_back(static_cast<int>(j));
  }
  own_pairs_.resize(joints_.size());
  cross_pairs_.resize(joints_.size());
  geometries_.resize(joints_.size());
  for (std::size_t g = 0; g < scene.geometries.size(); ++g) {
    of_geometry_.push_back(of_joint(scene.geometries[g].body));
    if (of_geometry_[g] >= 0) geometries_[of_geometry_[g]].push_back(static_cast<int>(g));
  }
  for (std::size_t k = 0; k < scene.pairs.size(); ++k) {
    const int a = of_geometry_[scene.pairs[k].a], b = of_geometry_[scene.pairs[k].b], pair = static_cast<int>(k);
    if (a == b || a < 0 || b < 0) {
      if (std::max(a, b) >= 0) own_pairs_[std::max(a, b)].push_back(pair);
    } else {
      cross_pairs_[a].push_back({b, pair});
      cross_pairs_[b].push_back({a, pair});
    }
  }
}

std::pair<int, int> StaticTrees::of_guard(const Scene& scene, int guard) const {
  if (scene.is_pair(guard)) return {of_geometry_[scene.pairs[guard].a], of_geometry_[scene.pairs[guard].b]};
  return {of_joint(scene.tree.limits[guard - scene.pairs.size()].joint), -1};
}

std::unique_ptr<SubScene> restrict_scene(const Scene& whole, const StaticTrees& trees, const std::vector<int>& chosen) {
  auto sub = std::make_unique<SubScene>();
  for (int t : chosen) sub->joints.insert(sub->joints.end(), trees.joints(t).begin(), trees.joints(t).end());
  std::sort(sub->joints.begin(), sub->joints.end());
  for (int j : sub->joints) {
    const Joint& joint = whole.tree.joints[j];
    for (int k = 0; k < joint.nq; ++k) sub->q.push_back(joint.iq + k);
    for (int k = 0; k < joint.nv; ++k) sub->v.push_back(joint.iv + k);
  }
  std::sort(sub->q.begin(), sub->q.end());
  std::sort(sub->v.begin(), sub->v.end());
  const NewNumbers now{inverse(sub->joints, whole.tree.joints.size()), inverse(sub->q, whole.tree.nq),
                       inverse(sub->v, whole.tree.nv)};
  restrict_tree(whole.tree, *sub, now, sub->scene.tree);
  restrict_elements(whole.tree.elements, now, *sub, sub->scene.tree.elements);
  sub->reactions = sub->constraint_rows;
  for (const Follower& f : sub->scene.tree.followers) {
    const int joint = sub->joints[f.joint];
    const auto same = [joint](const Follower& other) { return other.joint == joint; };
    const auto found = std::find_if(whole.tree.followers.begin(), whole.tree.followers.end(), same);
    sub->reactions.push_back(whole.tree.elements.constraint_rows +
                             static_cast<int>(found - whole.tree.followers.begin()));
  }
  restrict_geometry(whole, trees, chosen, now, *sub);
  for (std::size_t k = 0; k < whole.tree.limits.size(); ++k) {
    JointLimit limit = whole.tree.limits[k];
    limit.joint = now.joint[limit.joint];
    if (limit.joint < 0) continue;
    sub->scene.tree.limits.push_back(limit);
    sub->guards.push_back(static_cast<int>(whole.pairs.size() + k));
  }
  return sub;
}

std::unique_ptr<SubScene> whole_scene_numbers(const Scene& whole) {
  auto sub = std::make_unique<SubScene>();
  const auto count = [](std::vector<int>& list, std::size_t size) {
    list.resize(size);
    std::iota(list.begin(), list.end(), 0);
  };
  count(sub->joints, whole.tree.joints.size());
  count(sub->q, whole.tree.nq);
  count(sub->v, whole.tree.nv);
  count(sub->geometries, whole.geometries.size());
  count(sub->guards, whole.guard_count());
  count(sub->constraint_rows, whole.tree.elements.constraint_rows);
  count(sub->reactions, whole.tree.elements.constraint_rows + whole.tree.followers.size());
  count(sub->friction, whole.tree.elements.friction_dofs.size());
  return sub;
}

}  // namespace contactvi
