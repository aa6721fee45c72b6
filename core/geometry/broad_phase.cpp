#include "geometry/broad_phase.hpp"

#include <coal/broadphase/broadphase_dynamic_AABB_tree.h>

#include <algorithm>
#include <cstdint>

namespace contactvi {

namespace {

// A fat box has room for so many steps like the present one: a box is renewed about every 25 steps.
constexpr double kSteps = 32.0;
// Up to so many pairs are looked at one by one where a box is renewed: a box in the tree, put there and asked for its
// partners, costs as much as some fifty of them.
constexpr std::size_t kFewPairs = 64;
// And for this part of the geometry's radius, so that what hardly moves is never renewed.
constexpr double kLeastRoom = 0.1;
// But not for more than this part of the radius, or what is fast would be near to everything,
constexpr double kMostRoom = 2.0;
// as long as it lasts for so many steps: it must for three.
constexpr double kFewestSteps = 4.0;
// Where boxes are renewed, or a clear span has ended, those with less left than this part of the room that they would
// get are renewed: else each would end a span of its own. More renews boxes that last, less makes spans shorter.
constexpr double kRenewed = 0.5;
// Of the room: what is left for rounding.
constexpr double kRoomRounding = 1e-3;

double room_for(const Geometry& g, double motion) {
  const double size = g.box_half.norm();
  return std::max({std::min(kSteps * motion, kMostRoom * size), kFewestSteps * motion, kLeastRoom * size});
}

bool is_number(const Box& box) { return !box.center.hasNaN() && !box.half.hasNaN() && box.center.allFinite(); }

bool is_before(const BroadPhase::NearPair& s, const BroadPhase::NearPair& t) { return s.guard < t.guard; }

}  // namespace

// The fat boxes in coal's tree, which answers which of them a box meets. The boxes in it may be larger than those that
// were entered, and only those count.
struct BroadPhase::BoxTree {
  using Tree = coal::detail::HierarchyTree<coal::AABB>;
  Tree tree;
  std::vector<Tree::Node*> leaves;  // per geometry; null: not in the tree
  std::vector<const Tree::Node*> open;

  static coal::AABB converted(const Box& box) { return {box.center - box.half, box.center + box.half}; }

  void enter(int geometry, const Box& box) {
    const coal::AABB aabb = converted(box);
    if (leaves[geometry] != nullptr)
      tree.update(leaves[geometry], aabb);
    else
      leaves[geometry] = tree.insert(aabb, reinterpret_cast<void*>(static_cast<std::intptr_t>(geometry)));
  }

  void clear() {
    tree.clear();
    std::fill(leaves.begin(), leaves.end(), nullptr);
  }

  template <class Look>
  void each_overlap(const Box& box, Look look) {
    const coal::AABB aabb = converted(box);
    open.clear();
    if (!tree.empty()) open.push_back(tree.getRoot());
    while (!open.empty()) {
      const Tree::Node* node = open.back();
      open.pop_back();
      if (!node->bv.overlap(aabb)) continue;
      if (node->isLeaf()) {
        look(static_cast<int>(reinterpret_cast<std::intptr_t>(node->data)));
      } else {
        open.push_back(node->children[0]);
        open.push_back(node->children[1]);
      }
    }
  }
};

BroadPhase::BroadPhase(const Scene& scene)
    : scene_(&scene),
      few_(scene.pairs.size() <= kFewPairs),
      pairs_(scene.pair_table ? scene.pair_table
                              : std::make_shared<const PairTable>(scene.pairs, scene.geometries.size())),
      boxes_(scene.geometries.size()),
      limits_(scene.geometries.size(), -kInfinity),
      is_leaving_(scene.geometries.size(), 0),
      tree_(new BoxTree) {
  tree_->leaves.assign(scene.geometries.size(), nullptr);
  for (std::size_t g = 0; g < scene.geometries.size(); ++g)
    if (scene.geometries[g].unbounded) planes_.push_back(static_cast<int>(g));
}

BroadPhase::~BroadPhase() = default;

void BroadPhase::invalidate() { std::fill(limits_.begin(), limits_.end(), -kInfinity); }

bool BroadPhase::is_outdated(const std::vector<double>& odometer, const std::vector<double>& motion, bool early) {
  leaving_.clear();
  for (std::size_t g = 0; g < limits_.size(); ++g)
    if (!(odometer[g] + 2.0 * motion[g] <= limits_[g])) leaving_.push_back(static_cast<int>(g));
  if (leaving_.empty() && !early) return false;
  leaving_.clear();
  for (std::size_t g = 0; g < limits_.size(); ++g) {
    const double needed = std::max(2.0 * motion[g], kRenewed * room_for(scene_->geometries[g], motion[g]));
    if (!(odometer[g] + needed <= limits_[g])) leaving_.push_back(static_cast<int>(g));
  }
  return !leaving_.empty();
}

void BroadPhase::renew(const Placements& at, const std::vector<double>& odometer, const std::vector<double>& motion) {
  for (int g : leaving_) {
    const Geometry& geometry = scene_->geometries[g];
    if (geometry.body < 0) {
      limits_[g] = kInfinity;
      if (!geometry.unbounded) boxes_[g] = box_of(geometry, at);
    } else if (!geometry.unbounded) {
      // The step may end before the place where the box is made, by at most its motion.
      const double room = room_for(geometry, motion[g]);
      limits_[g] = odometer[g] + (1.0 - kRoomRounding) * room - motion[g];
      boxes_[g] = box_of(geometry, at).fattened(room);
      if (!is_number(boxes_[g])) {  // the step failed: near to everything, until a step has a finite end
        limits_[g] = -kInfinity;
        boxes_[g] = {Vec3::Zero(), Vec3::Constant(kInfinity)};
      }
    }
    if (!geometry.unbounded && !few_) tree_->enter(g, boxes_[g]);
  }
  if (few_) return look_at_all(at);
  for (int g : leaving_) is_leaving_[g] = 1;
  near_.erase(std::remove_if(near_.begin(), near_.end(),
                             [&](const NearPair& p) { return is_leaving_[p.a] != 0 || is_leaving_[p.b] != 0; }),
              near_.end());
  added_.clear();
  for (int g : leaving_) find_partners(g, at);
  for (int g : leaving_) is_leaving_[g] = 0;
  std::sort(added_.begin(), added_.end(), is_before);
  merged_.resize(near_.size() + added_.size());
  std::merge(near_.begin(), near_.end(), added_.begin(), added_.end(), merged_.begin(), is_before);
  near_.swap(merged_);
}

void BroadPhase::look_at_all(const Placements& at) {
  near_.clear();
  for (std::size_t k = 0; k < scene_->pairs.size(); ++k) {
    const int a = std::min(scene_->pairs[k].a, scene_->pairs[k].b),
              b = std::max(scene_->pairs[k].a, scene_->pairs[k].b);
    const bool plane_a = scene_->geometries[a].unbounded, plane_b = scene_->geometries[b].unbounded;
    const bool meet = plane_a   ? plane_b || may_meet(b, a, at)
                      : plane_b ? may_meet(a, b, at)
                                : !(separation(boxes_[a], boxes_[b]) > 0.0);
    if (meet) near_.push_back({static_cast<int>(k), a, b});
  }
}

// Of two geometries that both have new boxes the smaller one finds the pair.
void BroadPhase::find_partners(int g, const Placements& at) {
  const auto is_first = [&](int other) { return other != g && (is_leaving_[other] == 0 || g < other); };
  for (int plane : planes_)
    if (is_first(plane) && (scene_->geometries[g].unbounded || may_meet(g, plane, at))) add_near(g, plane);
  if (scene_->geometries[g].unbounded) {
    for (int other = 0; other < static_cast<int>(boxes_.size()); ++other)
      if (!scene_->geometries[other].unbounded && is_first(other) && may_meet(other, g, at)) add_near(g, other);
    return;
  }
  tree_->each_overlap(boxes_[g], [&](int other) {
    if (is_first(other) && !(separation(boxes_[g], boxes_[other]) > 0.0)) add_near(g, other);
  });
}

// A halfspace that moves has no bound on its motion: it is near to all.
bool BroadPhase::may_meet(int g, int plane, const Placements& at) const {
  const Geometry& halfspace = scene_->geometries[plane];
  return halfspace.body >= 0 || !(separation(boxes_[g], halfspace, at) > 0.0);
}

void BroadPhase::add_near(int a, int b) {
  pairs_->each(a, b, [&](int guard) { added_.push_back({guard, std::min(a, b), std::max(a, b)}); });
}

void BroadPhase::recall(const Memory& memory) {
  boxes_ = memory.boxes;
  limits_ = memory.limits;
  near_ = memory.near;
  if (few_) return;
  tree_->clear();
  for (std::size_t g = 0; g < boxes_.size(); ++g)
    if (!scene_->geometries[g].unbounded && limits_[g] > -kInfinity) tree_->enter(static_cast<int>(g), boxes_[g]);
}

}  // namespace contactvi
