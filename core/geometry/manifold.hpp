// Manifolds: the points at which the two shapes of a collision pair touch, each with a gap function of its own.
//
// A shape is a core swept by a sphere (shape_features.hpp); pairs that coal measures between rounded shapes are taken
// rounded here too, so that the least gap of the points is the distance of the pair. Normals point from a to b.
//
//   a / b         halfspace   box, convex       cylinder           capsule        sphere            ellipsoid
//   halfspace     -           vertices          rims (1)           2 ends         1 vertex          witness
//   box, convex   vertices    polytopes (2)     rims (1) and (2)   polytopes (2)  witness           witness
//   cylinder      rims (1)    rims (1) and (2)  rims (1) and (2)   polytopes (2)  witness           witness
//   capsule       2 ends      polytopes (2)     polytopes (2)      lines (3)      witness           witness
//   sphere        1 vertex    witness           witness            witness        witness           witness
//   ellipsoid     witness     witness           witness            witness        witness           witness
//
// (1) A rim touches a plane in its lowest point, which rolls (kRim). Where it lies flat, R sin(tilt) <= 2e-11 m, that
//     point is ill-defined, and material points of the rim take its place (kVertex). They span the disc, or the part of
//     it over the face, together with the corners of the face under the disc (kVertex).
// (2) Vertices of either body over a face of the other (kVertex), and crossings of an edge of one with an edge of the
//     other (kEdge), on the flat sides that face each other where the pair is nearest. The axis of a lying capsule or
//     cylinder, swept by its radius, is one more edge. Steeply inclined pairs have one such point, which is exact.
// (3) Lines that lie along each other, edges or axes swept by a radius, touch at both ends of the segment that they
//     have in common, ends of lines (kEnd) or rims (kRimLine); so do they in all pairs of polytopes, cylinders and
//     capsules (line_contact.hpp).
// A surface that a function gives (model/function_surface.hpp) stands in the place of a halfspace: vertices, the ends
// of a capsule and the centre of a ball, each against its own foot on the surface (kSurface). Where all feet are known
// a ball has a point at each of them, which goes with its foot: feet that belong to persistent points have their
// numbers, the others the lowest numbers that are left.
//
// Two solids, a solid and a halfspace, an ellipsoid or a height field, and a cylinder and a solid or a height field
// touch at their common normals (kSolids), whose numbers are given as those of feet. Where the surfaces lie along each
// other there are places all over; a few of them, which span the area, become points. A cylinder has them on each rim,
// on its side and on its ends; of a rim that lies flat, material points of it (model/cylinder_normals.hpp).
//
// witness: the single point that coal finds (kWitness). Also where the nearest features of another pair have no point
//     of their own: vertex against edge or vertex of rounded shapes, rim against a steep edge, the sides of two
//     capsules.
//
// The gap of a vertex is its distance from the face that it lies over, not from a common plane: when a body tips, one
// or two points keep a gap of zero, and the gaps of the others grow.
#pragma once

#include <cstdint>
#include <vector>

#include "geometry/candidates.hpp"
#include "geometry/contact.hpp"
#include "geometry/contact_point.hpp"
#include "geometry/point_selection.hpp"
#include "geometry/seams.hpp"
#include "model/common_normal.hpp"
#include "model/function_surface.hpp"

namespace contactvi {

// The contact of a point: n from the plane's side, `lowest` the place of the point's core next to it, world.
void set_contact(const ContactPoint& p, const Vec3& n, const Vec3& lowest, double gap, Contact& contact);

class SolidPair;
struct Behind;

class Manifolds {
 public:
  Manifolds(const Scene& scene, int max_points);

  int most_points() const { return max_points_; }  // of a pair
  // Appends the points of the pair with gap <= margin, at most max_points of them: the deepest, then those that span
  // the largest area; points that add no area are left out. Equal input gives equal points. witness: the contact of the
  // pair that coal gives there; at least one point is found if its gap is <= margin. others: if given, the points
  // within the margin that were not chosen are appended to it. left: if given, features that are not to be chosen;
  // then those of them that are within the margin.
  void find(int pair, const Placements& at, const Contact& witness, double margin, std::vector<ContactPoint>&,
            std::vector<ContactPoint>* others = nullptr, std::vector<std::int64_t>* left = nullptr);

  // The point of a known feature (not one where a rim crosses a side), whether it touches or not.
  ContactPoint point(int pair, const Placements& at, const Contact& witness, std::int64_t feature) const;

  // The nearest feature of a pair with a halfspace and the nearest points of two capsules, without coal; false for
  // other pairs and for ellipsoids. Coal makes cylinders 1e-10 of their size larger where they stand or lie exactly
  // along the normal, and takes a wrong point of capsules at an angle below 1e-4 rad, up to 4e-7 m too far.
  bool nearest(int pair, const Placements& at, Contact& contact);

  // A lower bound on the gap of the pair: how far its shapes are from each other along n_W (nearest_features.hpp).
  double gap_along(int pair, const Placements& at, const Vec3& n_W) const;
  // Coal's contact of the pair, to rounding (nearest_features.hpp). False where it stays as it is.
  bool refine(int pair, const Placements& at, Contact& contact) const;

  // Sets the farthest point of a rim, the point where it is nearest to a line, and the foot on a surface, which move as
  // the body rolls, to those of these placements.
  void update_moving(ContactPoint& point, const Placements& at);
  // Whether a ball of the pair, or of any, may touch in several feet of a surface that a function gives.
  bool any_feet() const { return any_feet_; }
  // Whether a pair touches at common normals (solid_pair.hpp).
  bool has_common_normals(int pair) const;
  bool has_feet(int pair) const;
  // The points of a pair that persist from now on. Of no concern where the pair has no several feet.
  void set_persistent(int pair, const std::vector<const ContactPoint*>& points);
  // Appends the ends of two axes that lie over the other one with gap <= margin, also of those that would touch next.
  void find_ends(int pair, const Placements& at, double margin, std::vector<ContactPoint>& points);

  // The point as one that moves with the bodies, where these are placed: the lowest point of a rim, the witness of
  // shapes with edges, and the crossing of edges that become parallel where the bodies turn by `turn` [rad], become a
  // point of one body over a plane of the other; points of an axis that run along it, where the bodies turn like this
  // or an end of the axis moves by `moved` [m], points over the other axis. Other points stay what they are.
  ContactPoint frozen(const ContactPoint& point, const Placements& at, const Contact& witness, double turn,
                      double moved) const;
  // Where the one point of two lines lies along that of a and that of b [m]: zero for other points. Lines that are
  // nearly parallel turn little for it to run far.
  Eigen::Vector2d place_along(const ContactPoint& point, const Placements& at, const Contact& contact) const;
  // From one such place to another, as a part of the shorter line.
  double run(const ContactPoint& point, const Eigen::Vector2d& from, const Eigen::Vector2d& to) const;
  // Direction from the centre of a rim to its contact point, unit, world frame; zero for other points.
  static Vec3 side_of_rim(const ContactPoint& point, const Placements& at);

  // Gap, normal, points and bodies, world frame. Not for kWitness and kLimit.
  void evaluate(const ContactPoint& point, const Placements& at, Contact& contact) const;

  // False where another feature touches instead: a vertex slid off its face, an edge off its edge, a flat rim tilted.
  bool valid(const ContactPoint& point, const Placements& at) const;
  // How far a vertex or the lowest point of a rim is from the border of its face [m], negative beyond it; infinite
  // over a halfspace, and for other points.
  double inside_face(const ContactPoint& point, const Placements& at) const;
  // Whether a vertex or the lowest point of a rim lies over the face of its feature, touching or not.
  bool is_over_face(const ContactPoint& point, const Placements& at) const;

  // Least gap [m] over the features of the pair that may touch next while the `persistent` points touch; +infinity if
  // there are none. contact: of that feature. To features that touch merely because the persistent points do (further
  // corners of a face with three persistent points, the rim of such points) kNextGapSlack is added, so that their gaps
  // do not change sign by rounding: contact.gap is lower than the result by that much. The far side of a rim that falls
  // flat closes 5e-12 m early. witness: null where none_deeper(). Gaps of features above `enough` count as infinite.
  double next_gap(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                  const Contact* witness, double enough, Contact& contact);
  // Whether the pair is no deeper than its persistent points, seen without its distance: from how far its shapes are
  // from each other along the normal of one of these.
  bool none_deeper(int pair, const Placements& at, const ContactPoint* const* persistent, int count) const;

  // Whether the rest of the shapes stays behind the persistent points (other_features.hpp).
  double crossing_of(int pair, const Placements& at, const ContactPoint* const* persistent, int count) const;
  bool others_behind(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                     const Behind& by) const;
  // The contact of the pair if it is that of a persistent point for it. False: that is not known.
  bool nearest_of_points(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                         Contact& contact) const;

  // Whether both shapes are capsules or cylinders, whose axes are lines; whether both are capsules.
  bool has_lines(int pair) const;
  // Whether one of the shapes has rims, which touch in other points as they tilt.
  bool has_rims(int pair) const;
  bool has_capsules(int pair) const { return is_capsule_[scene_->pairs[pair].a] && is_capsule_[scene_->pairs[pair].b]; }

  // Where the shapes of one body form one surface.
  const Seams& seams() const { return seams_; }

  // Largest error of coal's distance of the pair, against that of its features [m].
  double noise(int pair) const;

 private:
  // Least gap of points with features of their own, at most 0; infinite with another point among them.
  double deepest(const ContactPoint* const* points, int count, const Placements& at) const;
  double next_gap_on_surface(int pair, const Placements& at, const PairView& v, const ContactPoint* const* persistent,
                             int count, double enough, Contact& contact);
  double include_witness(int pair, const Placements& at, const ContactPoint* const* persistent, int count,
                         const Contact& witness, double value, Contact& contact) const;
  const ShapeFeatures& features(int pair, int geometry) const;
  bool is_single(int pair) const;
  // The geometry of a pair that is a surface given by a function, null: none.
  const Geometry* surface_of(int pair) const;
  void list_on_surface(int pair, const PairView& v, const Placements& at, CandidateSink& sink);
  void list_feet(int pair, const PairView& v, const Placements& at, CandidateSink& sink);
  int number_of_foot(const FunctionSurface& surface, int pair, int vertex, const Vec3& point, const Vec3& place) const;
  void list_common_normals(int pair, const Placements& at, CandidateSink& sink);
  void move_on_solids(ContactPoint& point, const Placements& at);
  double depth_in_part(const ContactPoint& point, const Placements& at) const;
  double far_on_surface(const ContactPoint& point, const Placements& at, Contact& contact) const;
  ContactPoint make_solids_point(int pair, const SolidPair& solids, std::int64_t feature, const CommonNormal& c) const;
  void solids_gap(const ContactPoint& p, const Placements& at, Contact& contact) const;
  ContactPoint listed_point(int pair, const Placements& at, std::int64_t feature) const;
  bool has_merged(const ContactPoint& point, const Placements& at) const;
  void surface_gap(const ContactPoint& p, const Placements& at, Contact& contact) const;
  class Least;
  class OfUnion;
  bool take_out(std::vector<std::int64_t>& features);
  PairView view(int pair, const Placements& at) const;
  ContactPoint make_point(int pair, const PairView& v, const Candidate& c, const Vec3& n_W) const;
  ContactPoint frozen_on_lines(const ContactPoint& point, const Placements& at, const Contact& contact, double turn,
                               double moved) const;
  static double far_of_rim(const ContactPoint& point, const Placements& at, Contact& contact);
  Sides sides_of_witness(const PairView& v, const Contact& witness) const;
  Sides sides_of_point(const PairView& v, const ContactPoint& point, const Placements& at) const;

  const Scene* scene_;
  Seams seams_;
  int max_points_;
  bool any_feet_ = false;         // whether a surface of the scene may touch a ball in several feet
  std::vector<bool> is_capsule_;  // per geometry
  // Workspace, which grows to the largest manifold found.
  std::vector<Candidate> found_;
  Selection selection_;
  NearFeatures near_;
  std::vector<Vec3> over_surface_;
  std::vector<SurfaceFoot> feet_;
  // Of persistent points on surfaces where a ball may have several feet: where their feet are, in the surface's frame.
  struct KnownFoot {
    int pair;
    std::int64_t feature;
    Vec3 place;
    Vec3 second;  // of two solids: the place on the second one
  };
  std::vector<KnownFoot> known_feet_;
  // The common normals of the pair that was listed last, and their features.
  std::vector<CommonNormal> known_normals_, common_normals_;
  std::vector<std::int64_t> common_features_;
  int listed_pair_ = -1;
  CommonNormal beside_{};  // of that pair; an infinite gap: the shape is not beside a height field
  std::vector<int> known_numbers_;
};

// See Manifolds::next_gap [m].
constexpr double kNextGapSlack = 3e-11;
// The far side of a rim counts as closed this much early [m]; less than the touch tolerance, or it would not be found.
constexpr double kFarSlack = 5e-12;

}  // namespace contactvi
