#include "model/dof_pattern.hpp"

#include <algorithm>

namespace contactvi {

namespace {

// Whether body a carries body b or the reverse.
bool on_one_path(const Tree& tree, int a, int b) {
  const int low = std::min(a, b);
  int at = std::max(a, b);
  while (at > low) at = tree.joints[at].parent;
  return at == low;
}

// Whether a force acts between branches: on bodies of which neither carries the other, or in a way that is not known.
bool couples_branches(const Tree& tree) {
  const Elements& e = tree.elements;
  if (!e.forces.empty() || !e.potentials.empty()) return true;
  for (const PathSpring& spring : e.path_springs)
    for (const BodyFrame& a : spring.points)
      for (const BodyFrame& b : spring.points)
        if (a.body >= 0 && b.body >= 0 && !on_one_path(tree, a.body, b.body)) return true;
  for (const CompliantContact& c : e.compliances)
    if (c.body_a >= 0 && c.body_b >= 0 && !on_one_path(tree, c.body_a, c.body_b)) return true;
  return false;
}

}  // namespace

DofPattern::DofPattern(const Tree& tree) : level_(tree.nv), first_(tree.nv), place_(tree.nv) {
  // Coupled joints may be on different branches, and what acts on the one acts on the other.
  const bool coupled = couples_branches(tree) || !tree.followers.empty();
  std::vector<int> component(tree.nv);
  for (int d = 0; d < tree.nv; ++d) {
    const int parent = coupled ? d - 1 : tree.dof_parent[d];
    level_[d] = parent < 0 ? 0 : level_[parent] + 1;
    depth_ = std::max(depth_, level_[d] + 1);
    first_[d] = entries();
    for (int g = 0; g < level_[d]; ++g) path_.push_back(path_[first_[parent] + g]);
    path_.push_back(d);
    if (parent < 0) components_.emplace_back();
    component[d] = parent < 0 ? static_cast<int>(components_.size()) - 1 : component[parent];
    std::vector<int>& own = components_[component[d]];
    place_[d] = static_cast<int>(own.size());
    own.push_back(d);
  }
}

}  // namespace contactvi
