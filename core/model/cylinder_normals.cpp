#include "model/cylinder_normals.hpp"

#include <algorithm>
#include <cmath>

#include "base/numerics.hpp"
#include "model/distance_search.hpp"

namespace contactvi {

namespace {

using namespace cylinder_part;  // NOLINT: the parts are named all over
using Vec2 = Eigen::Vector2d;

// Times the reach of a cell: beyond this way another cell has searches of its own.
constexpr double kFarthestFromCell = 2.0;
constexpr int kBoundRoundsOfCylinder = 8;
// [rad] By how much a normal may lie beyond those of a rim, and [m] a place beyond the border of a part.
constexpr double kBeyondCone = 1e-9, kBeyondPart = 6e-9;
// Sine of the tilt from which on the other side of a rim cannot come down before the points are found again; and up to
// which a rim may lie flat: then its distances, by which that is decided, differ by less than this [m].
constexpr double kAboutFlat = 0.1, kMayBeFlat = 1e-9, kFlatRim = 4e-11;
// [m] A rim that lies flat to this, as found before, has become one that touches by its fixed points.
constexpr double kLiesFlat = 1e-11;

}  // namespace

double CylinderNormals::size() const { return std::min({surface_->size(), cylinder_.radius, cylinder_.half}); }

double CylinderNormals::distance(const Vec3& point) const {
  const Vec3 x = local(point);
  return std::hypot(std::max(0.0, x.head<2>().norm() - cylinder_.radius),
                    std::max(0.0, std::abs(x[2]) - cylinder_.half));
}

double CylinderNormals::inside(const Vec3& point) const {
  const Vec3 x = local(point);
  return std::min(cylinder_.radius - x.head<2>().norm(), cylinder_.half - std::abs(x[2]));
}

// On one part, which goes on beyond its borders.
class CylinderNormals::Search : public DistanceSearch {
 public:
  // From a place p near the surface and x near the part, each in its own frame; no farther from p than this.
  Search(const CylinderNormals& of, int part, const Vec3& p, const Vec3& x, double farthest)
      : DistanceSearch(of.size()), of_(of), part_(part) {
    if (!p.allFinite() || !x.allFinite() || !set(p, x)) return;
    choose();
    slide([&](const Vec2& step) { return set(p_.at, x_ + T_ * step); }, [&] { choose(); },
          [&] { return (p_.at - p).norm() > farthest; });
  }

  Vec3 beside(double sign) const { return x_ + T_ * to_beside(sign); }
  const Place& place() const { return p_; }
  const Vec3& at() const { return x_; }
  int part() const { return part_; }
  // The outward normal that the cylinder needs there, in its frame.
  Vec3 outward() const { return -(of_.R_.transpose() * p_.normal); }
  // Of the signed distance of the surface, in the frame of the cylinder.
  Mat3 hessian() const { return of_.R_.transpose() * curvature_at(p_.bend, f()) * of_.R_; }
  CommonNormal result() const { return {f(), p_.normal, p_.at, x_, is_flat(), part_}; }

 private:
  Vec3 onto(const Vec3& x) const {
    if (is_end(part_)) return {x[0], x[1], of_.height(part_)};
    if (is_rim_point(part_)) return x;
    const double scale = of_.cylinder_.radius / x.head<2>().norm();
    return {scale * x[0], scale * x[1], part_ == kLateral ? x[2] : of_.height(part_)};
  }

  bool set(const Vec3& p, const Vec3& near_x) {
    const Vec3 x = onto(near_x), y = of_.placed(x);
    Place foot;
    if (!x.allFinite() || !of_.surface_->foot_place(y, p, foot) || !falls_to(foot.normal.dot(y - foot.at)))
      return false;
    p_ = foot;
    x_ = x;
    return true;
  }

  void choose() {
    const Vec3 m = outward(), radial(x_[0] / of_.cylinder_.radius, x_[1] / of_.cylinder_.radius, 0.0);
    // Along the circle, and across it; of what is one place or one line alone nothing across it.
    const bool round = !is_end(part_);
    T_.col(0) = round ? Vec3(-radial[1], radial[0], 0.0) : Vec3(Vec3::UnitX());
    T_.col(1) = round ? Vec3(Vec3::UnitZ()) : Vec3(Vec3::UnitY());
    const int ways = is_rim_point(part_) ? 0 : is_rim(part_) ? 1 : 2;
    Vec2 gradient = -T_.transpose() * m;
    Mat2 second = T_.transpose() * hessian() * T_;
    if (round) second(0, 0) += m.dot(radial) / of_.cylinder_.radius;
    for (int k = ways; k < 2; ++k) {
      gradient[k] = second(0, 1) = second(1, 0) = 0.0;
      second(k, k) = kHeld * (std::abs(second(0, 0)) + kFlatOfSize / of_.size());
    }
    choose_step(gradient, second);
  }

  static constexpr double kHeld = 1e3;  // of the other curvature: that of a way that is none

  const CylinderNormals& of_;
  int part_;
  Place p_{};
  Vec3 x_ = Vec3::Zero();
  Ways T_ = Ways::Zero();
};

// Whether both places lie in the other solid, where the gap is negative: a side of one that is seen through it has such
// a gap, too.
bool CylinderNormals::is_overlap(const CommonNormal& c) const {
  if (c.gap > -kSideRounding) return true;
  return surface_->is_inside(placed(c.second)) && inside(c.first) > 0.0;
}

bool CylinderNormals::near(const CommonNormal& known, CommonNormal& found) const {
  if (!t_.allFinite() || !R_.allFinite()) return false;
  const Search s(*this, known.part, known.first, known.second, kInfinity);
  if (s.found()) found = s.result();
  return s.found();
}

bool CylinderNormals::bend(const CommonNormal& at, Mat3& first) const {
  const Search s(*this, at.part, at.first, at.second, kInfinity);
  if (s.found()) first = s.place().bend;
  return s.found();
}

std::array<CylinderNormals::Border, 2> CylinderNormals::borders(const Search& s) const {
  const Vec3 m = s.outward(), axis(0.0, 0.0, height(s.part()) > 0.0 ? 1.0 : -1.0),
             radial(s.at()[0] / cylinder_.radius, s.at()[1] / cylinder_.radius, 0.0);
  // A place that leaves the rim keeps to where the distance is least along it.
  const Mat3 hessian = s.hessian();
  const Vec3 along = hessian * Vec3(-radial[1], radial[0], 0.0);
  const double least = std::max(s.least(), kFlatOfSize / size());
  const auto bend = [&](const Vec3& inward) {
    return inward.dot(hessian * inward) - inward.dot(along) * inward.dot(along) / least;
  };
  return {{{m.dot(axis), bend(axis)}, {m.dot(radial), bend(radial)}}};
}

double CylinderNormals::depth(const CommonNormal& c) const {
  if (c.part == kLateral) return cylinder_.half - std::abs(c.second[2]);
  if (is_end(c.part)) return cylinder_.radius - c.second.head<2>().norm();
  const double tilt = cylinder_.radius * (R_.transpose() * c.normal).head<2>().norm();
  if (is_rim_point(c.part)) return tilt <= kFlatRim ? kInfinity : -kInfinity;
  if (c.is_flat && tilt <= kLiesFlat) return -kInfinity;
  const Search s(*this, c.part, c.first, c.second, kInfinity);
  if (!s.found()) return -kInfinity;
  double depth = kInfinity;
  for (const Border& border : borders(s))
    if (border.bend > kFlatOfSize / size()) depth = std::min(depth, border.inside * size());
  return depth;
}

// Whether a place is beyond the border of its part; of one on a rim, whether the distance falls from it to one on the
// side or the end nearby.
bool CylinderNormals::is_beyond(const Search& s) const {
  if (!is_rim(s.part())) return depth(s.result()) < -kBeyondPart;
  const auto borders = this->borders(s);
  return std::any_of(borders.begin(), borders.end(), [this](const Border& b) {
    return b.bend > kFlatOfSize / size() && b.inside < -kBeyondCone && -b.inside < kOneFlat * size() * b.bend;
  });
}

bool CylinderNormals::across(const CommonNormal& of_rim, CommonNormal& found) const {
  const Vec3 m = R_.transpose() * of_rim.normal;
  if (m.head<2>().norm() > kAboutFlat) return false;
  const Vec3 x(-of_rim.second[0], -of_rim.second[1], of_rim.second[2]);
  const Vec3 y = placed(x);
  Place foot;
  if (!surface_->foot_place(y, y - of_rim.gap * of_rim.normal, foot)) return false;
  found = {foot.normal.dot(y - foot.at), foot.normal, foot.at, x, false, of_rim.part};
  return true;
}

// An upper bound on the distance from the surface: that of a place in one of its cells.
double CylinderNormals::distance_bound() const {
  Vec3 x = t_;
  double least = kInfinity;
  for (int round = 0; round < kBoundRoundsOfCylinder; ++round) {
    double nearest = kInfinity;
    Vec3 place = x;
    surface_->tree().near(x, kInfinity, [&](int k) {
      const Vec3& p = surface_->parts()[static_cast<std::size_t>(k)].place;
      const double away = (p - x).norm();
      if (away < nearest) place = p;
      return nearest = std::min(nearest, away);
    });
    const double away = distance(place);
    if (!(away < least)) break;
    least = away;
    const Vec3 own = local(place);
    const double out = own.head<2>().norm(), scale = out > cylinder_.radius ? cylinder_.radius / out : 1.0;
    x = placed({scale * own[0], scale * own[1], std::clamp(own[2], -cylinder_.half, cylinder_.half)});
  }
  return least * (1.0 + kSquareRounding);
}

// Where it is positive, a lower bound on the gaps of common normals with a cell: of one from q to x with the normal
// n(q) there is n . (x - q) = gap n . n(q), no more than a positive gap and no less than a negative one; x is in the
// cylinder, and q no farther than the sag from the plane through the middle of the cell.
double CylinderNormals::least_gap(const Part& cell) const {
  const Vec3 n = R_.transpose() * cell.normal;
  const double lowest = -cylinder_.radius * n.head<2>().norm() - cylinder_.half * std::abs(n[2]);
  return cell.normal.dot(t_ - cell.place) + lowest - cell.sag();
}

// Places on a part from which the distance may fall to a common normal with a cell: none where its normals, or how far
// it is, leave none.
void CylinderNormals::starts_at(int part, const Part& cell, double limit, std::vector<Vec3>& starts) const {
  starts.clear();
  const Vec3 w = local(cell.place), n = R_.transpose() * cell.normal;
  const Vec2 aside = w.head<2>(), away = n.head<2>();
  const double out = aside.norm(), along = std::abs(w[2]), R = cylinder_.radius, H = cylinder_.half;
  const double spread = std::min(1.0, cell.spread), room = cell.reach + limit;
  const Vec2 toward = out > 0.0 ? Vec2(aside / out) : Vec2(Vec2::UnitX());
  // By how much a place in the cell may lie beside the plane of the axis and its normal.
  const double beside = std::abs(w[0] * n[1] - w[1] * n[0]), most = cell.reach + (out + cell.reach) * spread;
  if (part == kLateral) {
    if (std::abs(n[2]) > spread || along > H + room || std::abs(out - R) > room || beside > most) return;
    const Vec2 u = away.norm() > 0.1 ? Vec2(-away.normalized()) : toward;
    starts.emplace_back(R * u[0], R * u[1], std::clamp(w[2], -H, H));
  } else if (is_end(part)) {
    const double z = height(part);
    if (away.norm() > spread || n[2] * z > spread * H || out > R + room || std::abs(w[2] - z) > room) return;
    const double scale = out > R ? R / out : 1.0;
    starts.emplace_back(scale * w[0], scale * w[1], z);
  } else {
    const double z = height(part);
    if (std::hypot(out - R, w[2] - z) > room || beside > most) return;
    starts.emplace_back(R * toward[0], R * toward[1], z);
    if (out < cell.reach + 0.5 * R || limit > R) starts.emplace_back(-R * toward[0], -R * toward[1], z);
    if (cell.reach > R)
      for (const double sign : {1.0, -1.0}) starts.emplace_back(-sign * R * toward[1], sign * R * toward[0], z);
    if (away.norm() > 0.1 && -away.normalized().dot(toward) < 0.7) {
      const Vec2 u = -away.normalized();
      starts.emplace_back(R * u[0], R * u[1], z);
    }
  }
}

bool CylinderNormals::rim_point(int rim, int k, const CommonNormal& next_to, CommonNormal& found) const {
  const double angle = kTwoPi * k / kRimPointsOfPart;
  const Vec3 x(cylinder_.radius * std::cos(angle), cylinder_.radius * std::sin(angle),
               rim == 0 ? -cylinder_.half : cylinder_.half);
  const Vec3 y = placed(x);
  const Search s(*this, kFirstRimPoint + rim * kRimPointsOfPart + k, y - next_to.gap * next_to.normal, x, kInfinity);
  if (s.found()) found = s.result();
  return s.found();
}

// A rim on which the distance is the same all around touches by fixed points.
void CylinderNormals::replace_flat_rims(FoundNormals& list) const {
  const std::vector<CommonNormal>& found = list.found();
  for (int rim = 0; rim < 2; ++rim) {
    const auto on_rim = [rim](const CommonNormal& c) { return is_rim(c.part) && rim_of(c.part) == rim; };
    const auto one = std::find_if(found.begin(), found.end(), [&](const CommonNormal& c) {
      return on_rim(c) &&
             (R_.transpose() * c.normal).head<2>().norm() <= std::max(kMayBeFlat, kFlatRim / cylinder_.radius);
    });
    if (one == found.end()) continue;
    const CommonNormal start = *one;
    std::vector<CommonNormal> points(kRimPointsOfPart);
    double least = kInfinity, most = -kInfinity;
    for (int k = 0; k < kRimPointsOfPart && !(most - least > kFlatRim); ++k) {
      if (!rim_point(rim, k, start, points[static_cast<std::size_t>(k)])) {
        most = kInfinity;
        break;
      }
      least = std::min(least, points[static_cast<std::size_t>(k)].gap);
      most = std::max(most, points[static_cast<std::size_t>(k)].gap);
    }
    if (!(most - least <= kFlatRim)) continue;
    list.keep([&](std::size_t k) { return rim_of(found[k].part) != rim; });
    for (const CommonNormal& c : points) list.put(c, -1);
  }
}

// Whether a place on the side, or on an end, that is as near as all around it lies between such places on rims.
bool CylinderNormals::is_spanned(const CommonNormal& c, const std::vector<CommonNormal>& found) const {
  if (!c.is_flat || is_rim(c.part)) return false;
  if (is_end(c.part))
    return std::any_of(found.begin(), found.end(), [&](const CommonNormal& o) {
      return is_rim_point(o.part) && rim_of(o.part) == c.part - kLowEnd && o.gap <= c.gap + kFlatRim;
    });
  const auto ends_at = [&](int rim) {
    return std::any_of(found.begin(), found.end(), [&](const CommonNormal& o) {
      return o.part == rim && std::abs(o.gap - c.gap) <= kFlatRim &&
             (o.second - c.second).head<2>().norm() <= kOneFlat * size();
    });
  };
  return c.part == kLateral && ends_at(kLowRim) && ends_at(kHighRim);
}

void CylinderNormals::all(const std::vector<CommonNormal>& known, double reach, std::vector<CommonNormal>& found,
                          std::vector<int>& number) const {
  const double own = size();
  const bool finite = t_.allFinite() && R_.allFinite();
  FoundNormals list(found, number, own, finite ? distance_bound() : kInfinity);
  if (!finite) return;
  const auto limit = [&] { return std::max({list.nearest(), reach, kDeepest * own}); };
  const auto add = [&](const Search& s, int which) {
    if (!s.found()) return;
    const CommonNormal c = s.result();
    // Of the side and the ends the surface is on their outer side.
    const Vec3 m = s.outward();
    if (c.part == kLateral && !(m.head<2>().dot(c.second.head<2>()) > 0.0)) return;
    if (is_end(c.part) && !(m[2] * c.second[2] > 0.0)) return;
    if (is_overlap(c) && !is_beyond(s)) list.add(c, which);
  };
  for (std::size_t k = 0; k < known.size(); ++k)
    add(Search(*this, known[k].part, known[k].first, known[k].second, kInfinity), static_cast<int>(k));
  std::vector<Vec3> starts;
  const auto look = [&](const Part& cell) {
    for (int part = kLowRim; part <= kHighEnd; ++part) {
      starts_at(part, cell, limit(), starts);
      for (const Vec3& x : starts) {
        const bool is_known = std::any_of(found.begin(), found.end(), [&](const CommonNormal& c) {
          return c.part == part && (c.first - cell.place).norm() <= cell.reach &&
                 (c.second - x).norm() <= (c.is_flat ? kOneFlat * own : cell.reach + own);
        });
        if (is_known) continue;
        const Search s(*this, part, cell.place, x, kFarthestFromCell * cell.reach);
        add(s, -1);
        if (!s.at_saddle()) continue;
        for (const double sign : {1.0, -1.0})
          add(Search(*this, part, s.place().at, s.beside(sign), kFarthestFromCell * cell.reach), -1);
      }
    }
  };
  surface_->tree().where(
      [&](const BoxTree::Box& box) { return distance(box.center()) - 0.5 * box.diagonal().norm() <= limit(); },
      [&](int k) {
        const Part& cell = surface_->parts()[static_cast<std::size_t>(k)];
        const double wanted = std::max(list.nearest(), reach);
        if (distance(cell.place) - cell.reach <= limit() && !(least_gap(cell) > std::max(wanted, 0.0))) look(cell);
      });
  replace_flat_rims(list);
  const std::vector<CommonNormal> all_found = found;
  list.keep_within(reach);
  list.keep([&](std::size_t k) { return number[k] >= 0 || !is_spanned(found[k], all_found); });
}

}  // namespace contactvi
