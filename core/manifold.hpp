// Manifolds: the points at which the two shapes of a collision pair touch, each
// with a gap function of its own.
//
// A shape is a core swept by a sphere (outline.hpp); pairs that coal measures
// between rounded shapes are taken rounded here too, so that the least gap of
// the points is the distance of the pair. n points from a to b.
//
//   a / b        halfspace                box, convex              cylinder
//   capsule   sphere, ellipsoid halfspace    -                        vertices
//   rims (*)           2 ends    sphere: 1 vertex box, convex  vertices faces
//   and edges (**)     rims, edges (*)    (**)      witness cylinder     rims
//   (*)                 rims, edges (*)          discs, edges (*)   (**)
//   witness capsule      2 ends                   (**)                     (**)
//   witness   witness sphere       1 vertex                 witness witness
//   witness   witness ellipsoid    witness                  witness witness
//   witness   witness
//
//   (*)  A rim touches a plane in its lowest point, which rolls (kRim). Where
//   it lies flat, R sin(tilt) <= 2e-11 m, that
//        point is ill-defined: then points of the rim that are fixed to the
//        cylinder stand for it (kVertex). They span the whole disc, or what of
//        it lies over the face; corners of the face under the disc are points
//        too.
//   (**) Vertices of either body over a face of the other (kVertex), and
//   crossings of an edge of one with an edge of
//        the other (kEdge), all on the flat sides that face each other where
//        the pair is nearest. A lying cylinder or capsule is its axis, swept by
//        its radius, as one more edge.
//
// Where the nearest features are none of these (vertex against edge or vertex
// of rounded shapes, rim against edge, the last column) the pair has the single
// point that coal finds (kWitness).
//
// Which body's plane: a vertex's gap is measured from the face that it lies
// over, never from a common plane. The shapes need not be parallel: a pair that
// tips has one or two points with a gap near zero, the others above.
#pragma once

#include <cstdint>

#include "candidates.hpp"
#include "contact.hpp"

namespace contactvi {

enum class PointKind : std::uint8_t { kWitness, kVertex, kRim, kLimit, kEdge };

struct ContactPoint {
  int guard;
  PointKind kind;
  std::int64_t feature; // identity within the guard, the same from step to
                        // step; 0: witness, limit
  bool material; // a point fixed to a sharp body: slip is a displacement; else
                 // the points move over both bodies
  // kVertex: sphere of radius `radius` about a point fixed in one body, against
  // a plane fixed in the other. Frames are those of point_body (center_B,
  // axis_B) and plane_body (normal_B, origin_B); -1: world.
  bool on_b; // the vertex belongs to geometry b and the plane to a, else the
             // other way round
  int point_body, plane_body;
  Vec3 center_B;
  double radius;
  Vec3 normal_B; // outward: gap = normal.center - offset - radius
  double offset;
  // kRim: the circle of radius rim_radius about center_B with the unit axis
  // axis_B, swept by `radius`, against the plane; far_B: the circle's point
  // farthest from the plane when the point was found, point_body's frame.
  Vec3 axis_B;
  double rim_radius;
  Vec3 far_B;
  // kEdge: a line of b through center_B along axis_B (on_b is true), swept by
  // `radius`, against a line of a through origin_B along normal_B, swept by
  // `offset`; directed so that normal_B x axis_B points from a to b.
  Vec3 origin_B;
};

class Manifolds {
public:
  Manifolds(const Scene &scene, int max_points);

  // Appends the points of the pair with gap <= margin, at most max_points of
  // them: the deepest, then those that span the largest area. Always the same
  // for the same input. witness: the pair's contact by coal there; at least one
  // point if its gap is <= margin.
  void find(int pair, const Placements &at, const Contact &witness,
            double margin, std::vector<ContactPoint> &) const;

  // The point of a known feature (not one where a rim crosses a side), whether it touches or not.
  ContactPoint point(int pair, const Placements& at, const Contact& witness, std::int64_t feature) const;

  // Gap, normal, points and bodies, world frame. Not for kWitness and kLimit.
  void evaluate(const ContactPoint &point, const Placements &at,
                Contact &contact) const;

  // False where another feature has taken over: a vertex slid off its face, an
  // edge off its edge, a flat rim tilted.
  bool valid(const ContactPoint &point, const Placements &at) const;

  // Least gap [m] over the features of the pair that may touch next while
  // `held` touch; +infinity if there are none. contact: of that feature.
  // Features that touch as well only because the held ones do (further corners
  // of a face that is held at three points, a rim held at points of it) count
  // from kRestSlack on, so that they do not flicker about zero: the contact's
  // own gap is then lower than the result by that much.
  double rest(int pair, const Placements &at, const ContactPoint *const *held,
              int count, const Contact &witness, Contact &contact) const;

private:
  struct Shapes {
    int a, b;     // in outlines_
    bool single;  // coal's point is the only one
    double noise; // of the pair's distance by coal
  };
  PairView view(int pair, const Placements &at) const;
  class Least;
  ContactPoint make_point(int pair, const PairView &v, const Candidate &c,
                          const Vec3 &n_W) const;
  Sides sides_of_witness(const PairView &v, const Contact &witness) const;
  static double far_of_rim(const ContactPoint &point, const Placements &at,
                           Contact &contact);
  Sides sides_of_point(const PairView &v, const ContactPoint &point,
                       const Placements &at) const;

  int max_points_;
  std::vector<Outline> outlines_;
  std::vector<Shapes> shapes_;
  mutable std::vector<Candidate> found_;
  mutable std::vector<int> chosen_;
  mutable EdgeLists edges_;
};

// See Manifolds::rest [m].
constexpr double kRestSlack = 3e-11;

} // namespace contactvi
