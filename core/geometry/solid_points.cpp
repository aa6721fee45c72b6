// Manifolds: the points at which solids, height fields, cylinders and halfspaces touch, which are their common normals.
#include <algorithm>
#include <cmath>

#include "geometry/manifold.hpp"
#include "geometry/solid_pair.hpp"

namespace contactvi {

// The least common normal, and those within the limit of the sink. They begin with those of persistent points.
void Manifolds::list_common_normals(int pair, const Placements& at, CandidateSink& sink) {
  const SolidPair solids(*scene_, pair, at);
  const Feature kind = solids.second_is_b() ? Feature::kSolidsB : Feature::kSolidsA;
  std::vector<int> taken;
  known_normals_.clear();
  for (const KnownFoot& known : known_feet_) {
    if (known.pair != pair) continue;
    taken.push_back(feature_j(known.feature));
    known_normals_.push_back({0.0, Vec3::Zero(), known.place, known.second, false, feature_i(known.feature)});
  }
  // Beside persistent points the next one is looked for within a cell where nothing says how far it matters.
  const double unsaid = known_normals_.empty() ? 0.0 : solids.size();
  const double reach = std::isfinite(sink.limit) ? std::max(sink.limit, 0.0) : unsaid;
  solids.all(known_normals_, reach, common_normals_, known_numbers_);
  feet_.clear();
  common_features_.clear();
  listed_pair_ = pair;
  int free = 0;
  for (std::size_t k = 0; k < common_normals_.size(); ++k) {
    const CommonNormal& c = common_normals_[k];
    while (std::find(taken.begin(), taken.end(), free) != taken.end()) ++free;
    // A point of a rim is the only one of its part.
    const int number = cylinder_part::is_rim_point(c.part) ? 0
                       : known_numbers_[k] < 0             ? free++
                                                           : taken[static_cast<std::size_t>(known_numbers_[k])];
    common_features_.push_back(feature_number(kind, c.part, number));
    if (!(c.gap > sink.limit)) sink.add({common_features_.back(), c.gap, solids.second_pose().point(c.second)});
  }
  beside_.gap = kInfinity;
  const bool is_beside = solids.beside(beside_);
  if (is_beside ? std::isnan(beside_.gap) || (common_normals_.empty() && !(beside_.gap > 0.0))
                : common_normals_.empty())
    feet_.push_back({kNaN, Vec3::UnitZ()});
}

ContactPoint Manifolds::make_solids_point(int pair, const SolidPair& solids, std::int64_t feature,
                                          const CommonNormal& c) const {
  ContactPoint p{};
  p.guard = pair;
  p.feature = feature;
  p.kind = PointKind::kSolids;
  p.on_b = solids.second_is_b();
  p.point_body = solids.second().body;
  p.plane_body = solids.first().body;
  p.center_B = in_body(solids.second(), c.second);
  p.origin_B = in_body(solids.first(), c.first);
  return p;
}

void Manifolds::solids_gap(const ContactPoint& p, const Placements& at, Contact& contact) const {
  const SolidPair solids(*scene_, p.guard, at);
  CommonNormal c = solids.known(p.origin_B, p.center_B, feature_i(p.feature));
  if (!solids.near(c, c)) c.gap = kNaN;
  set_contact(p, solids.first_pose().R * c.normal, solids.second_pose().point(c.second), c.gap, contact);
}

// That of a common normal which was listed last, or belongs to a persistent point.
ContactPoint Manifolds::listed_point(int pair, const Placements& at, std::int64_t feature) const {
  const SolidPair solids(*scene_, pair, at);
  const auto listed = std::find(common_features_.begin(), common_features_.end(), feature);
  if (pair == listed_pair_ && listed != common_features_.end())
    return make_solids_point(pair, solids, feature,
                             common_normals_[static_cast<std::size_t>(listed - common_features_.begin())]);
  CommonNormal c{kNaN, Vec3::UnitZ(), Vec3::Constant(kNaN), Vec3::Constant(kNaN), false};
  for (const KnownFoot& known : known_feet_)
    if (known.pair == pair && known.feature == feature) c = {0.0, Vec3::Zero(), known.place, known.second, false};
  return make_solids_point(pair, solids, feature, c);
}

// Whether a persistent point of two solids has come to where another one is, which has a lower number.
bool Manifolds::has_merged(const ContactPoint& point, const Placements& at) const {
  Contact own;
  evaluate(point, at, own);
  const SolidPair solids(*scene_, point.guard, at);
  return std::any_of(known_feet_.begin(), known_feet_.end(), [&](const KnownFoot& known) {
    if (known.pair != point.guard || known.feature >= point.feature) return false;
    CommonNormal c{};
    if (!solids.near({0.0, Vec3::Zero(), known.place, known.second, false, feature_i(known.feature)}, c)) return false;
    const Vec3& x = point.on_b ? own.point_b : own.point_a;
    return (solids.second_pose().point(c.second) - x).norm() < kSamePlace;
  });
}

double Manifolds::depth_in_part(const ContactPoint& point, const Placements& at) const {
  const SolidPair solids(*scene_, point.guard, at);
  CommonNormal c = solids.known(point.origin_B, point.center_B, feature_i(point.feature));
  return solids.near(c, c) ? solids.depth(c) : -kInfinity;
}

// Of the other side of a rim that falls flat; infinite where it does not. As far_of_rim.
double Manifolds::far_on_surface(const ContactPoint& point, const Placements& at, Contact& contact) const {
  const SolidPair solids(*scene_, point.guard, at);
  CommonNormal c = solids.known(point.origin_B, point.center_B, feature_i(point.feature)), far{};
  if (!cylinder_part::is_rim(c.part) || !solids.near(c, c) || !solids.across(c, far)) return kInfinity;
  set_contact(point, solids.first_pose().R * far.normal, solids.second_pose().point(far.second), far.gap, contact);
  return far.gap - kFarSlack;
}

void Manifolds::move_on_solids(ContactPoint& point, const Placements& at) {
  const SolidPair solids(*scene_, point.guard, at);
  CommonNormal c = solids.known(point.origin_B, point.center_B, feature_i(point.feature));
  if (!solids.near(c, c)) return;
  point = make_solids_point(point.guard, solids, point.feature, c);
  for (KnownFoot& known : known_feet_)
    if (known.pair == point.guard && known.feature == point.feature)
      known = {known.pair, known.feature, c.first, c.second};
}

}  // namespace contactvi
