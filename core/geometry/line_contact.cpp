#include "geometry/line_contact.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

// Lines at an angle with a smaller sine lie along each other, and so do a line and the plane of a rim.
constexpr double kAlong = 0.1;
// How far a normal may lie outside of those of an edge or a rim [rad]: the error of the gap is of the order of its
// square.
constexpr double kOutsideCone = 1e-6;
// Of features that would touch next.
constexpr double kOutsideConeNext = 0.1;
// How much nearer lines may come between the ends of the segment in common than at its ends [m]: well below what gaps
// of persistent contacts are kept to.
constexpr double kFlatSag = 2e-11;
constexpr int kTurnNewton = 12;
constexpr double kMostTurn = 0.3;    // of a point on a rim in one step of Newton's method [rad]
constexpr double kTurned = 1e-15;    // such a turn is rounding
constexpr double kLeastBend = 1e-3;  // of the second derivative of the distance along the rim

// One of the two lines with its shape, and the other one.
struct Lying {
  const ShapeFeatures* shape;
  const Pose* pose;
  const Line *line, *other;
  int edge, other_edge;
  bool on_b;
};

double along(const Line& line, const Vec3& x) { return (x - line.start).dot(line.direction); }

bool is_over(const Line& line, double s) { return s >= -kBorder && s <= line.length + kBorder; }

// Adds the point x of the core of one shape, which is swept by `sweep`, over the line of the other. from_line: from
// that line to x.
void add(const PairView& v, const Lying& l, Feature kind, int i, const Vec3& x, const Vec3& from_line, double sweep,
         CandidateSink& sink) {
  const double distance = from_line.norm(), gap = distance - sweep - l.other->radius;
  if (!(distance > 0.0) || gap > sink.limit || !is_over(*l.other, along(*l.other, x))) return;
  const Vec3 n = (l.on_b ? 1.0 : -1.0) / distance * from_line;  // from a to b
  const int edge_a = l.on_b ? l.other_edge : l.edge, edge_b = l.on_b ? l.edge : l.other_edge;
  if (outside_cone(v, edge_a, edge_b, n) > kOutsideCone) return;
  sink.add({feature_number(kind, i, l.other_edge), gap, x - 0.5 * from_line});
}

void add_ends(const PairView& v, const Lying& l, CandidateSink& sink) {
  for (int end : {0, 1}) {
    const Vec3 x = l.line->start + (end == 0 ? 0.0 : l.line->length) * l.line->direction;
    const Vec3 from_line = x - l.other->start - along(*l.other, x) * l.other->direction;
    add(v, l, l.on_b ? Feature::kEndB : Feature::kEndA, 2 * l.edge + end, x, from_line, l.line->radius, sink);
  }
}

// Of the rim of a cylinder: the side of a lying cylinder ends there, or a chord of its end does.
void add_rims(const PairView& v, const Lying& l, bool upcoming, CandidateSink& sink) {
  const Feature kind = l.on_b ? Feature::kRimLineB : Feature::kRimLineA;
  const double outside = upcoming ? kOutsideConeNext : kOutsideCone;
  for (int r = 0; r < static_cast<int>(l.shape->rims.size()); ++r) {
    const ShapeFeatures::Rim& rim = l.shape->rims[r];
    const Vec3 c = l.pose->point(rim.center), axis = l.pose->R * rim.axis;
    const Vec3 &o = l.other->start, &d = l.other->direction;
    const double sine = std::abs(d.dot(axis));
    Vec3 start[2];
    int count = 0;
    if (axis.cross(d).squaredNorm() <= kAlong * kAlong) {
      const Vec3 to_line = o + (c - o).dot(d) * d - c, across = to_line - to_line.dot(axis) * axis;
      if (across.norm() > 0.0) start[count++] = c + rim.radius * across.normalized();
    } else if (sine <= kAlong) {
      // Where the line passes over the rim, in the view along the axis.
      const Vec3 flat = (d - d.dot(axis) * axis).normalized(), from = o - c, p = from - from.dot(axis) * axis;
      const double middle = -p.dot(flat), square = rim.radius * rim.radius - (p + middle * flat).squaredNorm();
      for (int k = 0; k < 2 && square > 0.0; ++k)
        start[count++] = c + p + (middle + (k == 0 ? -1.0 : 1.0) * std::sqrt(square)) * flat;
    }
    for (int k = 0; k < count; ++k) {
      const Vec3 from_line = nearest_on_rim(c, axis, rim.radius, o, d, start[k]);
      const Vec3 out = -from_line.normalized();
      if (out.dot(axis) < -outside || out.dot(start[k] - c) < -outside * rim.radius) continue;
      add(v, l, kind, 2 * r + k, start[k], from_line, l.shape->radius, sink);
    }
  }
}

}  // namespace

void nearest_on_lines(const Line& a, const Line& b, Vec3& on_a, Vec3& on_b) {
  double least = INFINITY;
  auto take = [&](double s, double t) {
    const Vec3 x = a.start + s * a.direction, y = b.start + t * b.direction;
    const double square = (y - x).squaredNorm();
    if (!(square < least)) return;
    least = square;
    on_a = x;
    on_b = y;
  };
  for (double s : {0.0, a.length}) take(s, std::clamp(along(b, a.start + s * a.direction), 0.0, b.length));
  for (double t : {0.0, b.length}) take(std::clamp(along(a, b.start + t * b.direction), 0.0, a.length), t);
  // Between the ends the nearest points are those of the infinite lines. Where rounding places them badly, since the
  // lines are nearly parallel, an end is as near.
  const Vec3 cross = a.direction.cross(b.direction), d = b.start - a.start;
  const double square = cross.squaredNorm();
  if (!(square > 0.0)) return;
  const double s = d.cross(b.direction).dot(cross) / square, t = d.cross(a.direction).dot(cross) / square;
  if (s > 0.0 && s < a.length && t > 0.0 && t < b.length) take(s, t);
}

bool are_flat(const Line& a, const Line& b) {
  const Vec3 cross = a.direction.cross(b.direction);
  if (a.radius + b.radius < kLeastSweep || cross.squaredNorm() > kAlong * kAlong) return false;
  double first = INFINITY, last = -INFINITY, nearest = INFINITY;
  auto take = [&](const Line& of, const Line& over, bool on_a) {
    for (double end : {0.0, of.length}) {
      const Vec3 x = of.start + end * of.direction;
      const double s = along(over, x);
      if (!is_over(over, s)) continue;
      first = std::min(first, on_a ? end : s);
      last = std::max(last, on_a ? end : s);
      nearest = std::min(nearest, (x - over.start - s * over.direction).norm());
    }
  };
  take(a, b, true);
  take(b, a, false);
  if (!(last > first)) return false;
  // The distance D of a point of a from b has D'' = (g sin)^2 / D^3 along a, g the distance of the two infinite lines
  // and sin the sine of their angle.
  const double g_sin = (b.start - a.start).dot(cross), length = last - first;
  return g_sin * g_sin * length * length <= 8.0 * nearest * nearest * nearest * kFlatSag;
}

Vec3 nearest_on_rim(const Vec3& center, const Vec3& axis, double radius, const Vec3& origin, const Vec3& direction,
                    Vec3& x) {
  Vec3 apart;
  for (int k = 0;; ++k) {
    const Vec3 from = x - origin;
    apart = from - from.dot(direction) * direction;
    if (k == kTurnNewton) return apart;
    // Along the circle, with the angle as parameter.
    const Vec3 e = x - center, t = axis.cross(e);
    const double along_t = t.dot(direction), first = apart.dot(t),
                 second = t.squaredNorm() - along_t * along_t - apart.dot(e);
    const double bend = std::max(second, kLeastBend * radius * (radius + apart.norm()));
    const double turn = std::clamp(-first / bend, -kMostTurn, kMostTurn);
    if (std::abs(turn) <= kTurned) return apart;
    x = center + std::cos(turn) * e + std::sin(turn) * t;
  }
}

void list_line_ends(const PairView& v, int i, const Line& a, int j, const Line& b, bool upcoming, CandidateSink& sink) {
  if (a.radius + b.radius < kLeastSweep) return;
  const bool along_each_other = a.direction.cross(b.direction).squaredNorm() <= kAlong * kAlong;
  for (bool on_b : {false, true}) {
    const Lying l = on_b ? Lying{v.b, &v.pose_b, &b, &a, j, i, true} : Lying{v.a, &v.pose_a, &a, &b, i, j, false};
    if (!l.shape->rims.empty())
      add_rims(v, l, upcoming, sink);
    else if (along_each_other)
      add_ends(v, l, sink);
  }
}

}  // namespace contactvi
