// Guards: one gap function per collision pair and one per joint limit, and the decision which of them a step may
// skip.
//
// Semantics. A guard that is > 0 at the start of a step and <= 0 at its end, or inside it, is an event in the
// half-open interval (0, 1] of the step. A guard that had an impact, or whose gap starts at zero, is "touching":
// it is excluded until it has separated, unless it closes again. A start below zero is an error, never projected away.
//
// Skipping. Each geometry has odometers: bounds on how far any of its points has moved in the world, and in the frames
// of bodies that it hangs on, which is what counts for pairs of one robot. A pair whose distance was
// d when it was last evaluated is skipped until the two odometers have nearly advanced by d; then its bounding spheres
// are compared, then the extents of its shapes along the direction of the shortest line of the last evaluation
// (distance_bounds.hpp), and their distance is evaluated only if they may touch. Pairs that are far from each other
// for several steps are not even looked at (broad_phase.hpp). Where a step finds no guard near, the ones after it look
// at none, until the motion since then may have brought some guard near (clear_span.hpp). Numbering: collision pairs
// first, then joint limits.
#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "geometry/broad_phase.hpp"
#include "geometry/clear_span.hpp"
#include "geometry/contact.hpp"
#include "geometry/distance.hpp"
#include "geometry/distance_bounds.hpp"
#include "geometry/manifold.hpp"
#include "geometry/motion_bounds.hpp"
#include "model/scene.hpp"

namespace contactvi {

struct GuardCounters {
  long evaluated = 0;  // exact gaps
  long skipped = 0;    // guards of a step settled without one
  long distances = 0;  // of the exact gaps, those that coal's general distance of convex shapes told
  double cost = 0.0;   // of the exact ones (model/step_costs.hpp)
};

class Guards {
 public:
  // contact_points: of a pair, at most.
  explicit Guards(const Scene& scene, int contact_points = 4);

  int count() const { return count_; }
  const Scene& scene() const { return *scene_; }

  // Configuration that evaluate, gradient and separated_at_end refer to. A body is placed when a pair first asks for
  // it.
  void place(const VecCRef& q);

  // Exact gap [m] or [rad] at the placed configuration, not finite if coal fails. For a guard with persistent contacts
  // it is the least gap of the other features, kNothingElse if no other feature can touch, or none is nearer than
  // `enough`.
  double evaluate(int guard, Contact& contact, double enough = std::numeric_limits<double>::infinity());
  static constexpr double kNothingElse = 1e9;
  // The bodies have been put to a new place: what is known about their distances and their motion is forgotten.
  void restart();
  // What is known about the distances is forgotten; the odometers go on.
  void forget_distances();
  // Guards that may be closed after a restart, where the bodies are placed, ascending: joint limits, and pairs whose
  // boxes meet.
  void list_meeting(std::vector<int>& guards);
  // Pairs that may touch in the step whose motion is bounded and at whose end the bodies are placed; the guards of all
  // others can be left out.
  const std::vector<BroadPhase::NearPair>& near_pairs();
  // The gap of the whole guard, with or without persistent contacts.
  double evaluate_witness(int guard, Contact& contact);
  // The same where only the gap is wanted; it is known if the pair was evaluated last where the bodies are placed.
  double gap(int guard);
  // Whether a bound on the distance of a pair shows that it does not overlap, where the bodies are placed.
  bool is_apart(int guard);
  // What gaps of pairs are kept to at every node [m], where the noise of their distances is less.
  static constexpr double kPromised = 1e-9;
  double promised(int guard) const { return std::max(kPromised, kNoises * depth_tolerance(guard)); }
  // A lower bound on the distance of a pair where the bodies are placed: `enough` or more, or not much less than the
  // distance.
  double distance_bound(int guard, double enough);
  // Of the gap of a pair, how much bounds the motion until it closes.
  double reliable(int guard, double gap) const;
  const Placements& placements() {
    place_bodies();
    return placements_;
  }
  // As placements, where only the two bodies of a pair matter.
  const Placements& placements(int guard) {
    if (guard < pairs_) place_pair(guard);
    return placements_;
  }
  // As placements, where only the body of a geometry matters.
  const Placements& placements_of(int geometry) {
    place_body(scene_->geometries[geometry].body);
    return placements_;
  }
  Manifolds& manifolds() { return manifolds_; }
  // Sets the persistent contacts of a guard. The pointers must stay valid.
  void set_persistent(int guard, std::vector<const ContactPoint*> points);
  bool is_persistent(int guard) const { return persistent_number_[guard] >= 0; }
  // Whether one of a pair's persistent points touches, where the bodies are placed.
  bool is_held(int guard);
  // Whether feet may appear beside persistent ones, at any gap: motion does not bound such a gap.
  bool gap_may_jump(int guard) const {
    return manifolds_.any_feet() && is_persistent(guard) && guard < pairs_ && manifolds_.has_feet(guard);
  }
  // W = d(gap)/dq, shape (nv,).
  void gradient(int guard, const Contact& contact, VecRef W) const;
  // The joints that a guard's gap depends on; one that moves both bodies of a pair may be named twice.
  void list_joints(int guard, std::vector<int>& joints) const;
  // Rows n, t1, t2 (or n alone) of the relative velocity at the contact as columns, (nv, 1 or 3), times the shares of
  // friction, and where there are Scene::contact_rows columns also those of spinning and rolling.
  void rows(int guard, const Contact& contact, const Vec3& t1, Eigen::Ref<MatX> W);
  // Whether the friction of a guard depends on its direction; a first tangent where the bodies are placed, then along
  // its axis; and the shares of the coefficient along the tangents.
  bool has_axis(int guard) const {
    const ContactLaw* law = scene_->law(guard);
    return law != nullptr && law->axis_of >= 0;
  }
  Vec3 tangent(int guard, const Vec3& normal);
  TangentFrame frame(int guard, const Contact& contact, const Vec3& t1) const {
    TangentFrame found{t1, contact.normal.cross(t1)};
    if (has_axis(guard)) found.shares = scene_->law(guard)->shares;
    return found;
  }
  // Whether a surface of a guard moves along itself. What that adds at the time t [s] to the velocities of the rows t1,
  // t2 = n x t1 [m/s]: the velocity of b's surface less that of a's.
  bool moves(int guard) const { return guard < pairs_ && scene_->pairs[guard].moves; }
  Eigen::Vector2d surface_velocity(int guard, const Contact& contact, const Vec3& t1, double t);
  // As this, of the rows of spinning and rolling.
  void surface_turning(int guard, const Contact& contact, const Vec3& t1, double t, VecRef rates);
  // How far from zero a gap may be and still count as touching [m; rad].
  static constexpr double kTouching = 1e-11;
  // How deep a gap may be at the start of a step: features of a face differ by rounding, coal's distances by theirs.
  double depth_tolerance(int guard) const;
  // To what a root is located [m; rad].
  static constexpr double kRoot = 1e-12;

  // Bounds on the motion over a step of length h whose velocities stay within bound, shape (nv,), from q; in all
  // three entries of a spherical joint the bound of the whole vector.
  void bound_motion(const VecCRef& q, const VecX& bound, double h);
  double motion(int guard) const;  // of the guard's two bodies together in that step
  double turn(int guard) const;    // rotation of the two bodies together in that step [rad]
  // As bound_motion, after it, for velocities that are known to within `doubt` only: doubt(guard) is the possible error
  // of a gap.
  void bound_doubt(const VecX& doubt, double h);
  double doubt(int guard) const;
  // Of a path whose rates change by no more than bend per time tau, shape (nv,), after bound_motion: bend(guard) bounds
  // d2/dtau2 of the distance between two points of the guard's bodies along any direction that their base keeps.
  void bound_bend(const VecX& bend, double h);
  double bend(int guard) const;
  // As bend(), and as doubt(), of a pair of a halfspace with a persistent point that does not move along its normal:
  // the others turn about that.
  double bend_about_points(int guard) const;
  double doubt_about_points(int guard) const;
  // Whether the gap is the least of such distances along one direction, of the same points whatever the motion: that of
  // a joint limit, and over a halfspace that its base holds.
  bool is_along_one_direction(int guard) const;
  // Whether gap_along() bounds the gap: that of a pair whose features all count.
  bool has_gap_along(int guard) const;
  // How far the shapes of a pair are from each other along a direction that their base keeps, where the bodies are
  // placed: a lower bound on the gap. And the direction of a contact there.
  double gap_along(int guard, const Vec3& direction);
  Vec3 direction(int guard, const Contact& contact) const;
  // Whether the rest of the shapes stays behind the persistent points of a pair, where the bodies are placed
  // (other_features.hpp). dip_of_others(): how far it may come in front of where it is at both ends of the step, per
  // metre of distance, where the sine of the crossing is at least so much.
  double crossing_of_points(int guard);
  bool others_behind(int guard, double per_distance);
  double dip_of_others(int guard, double crossing) const;
  // Whether the motion of the step alone shows that it does, where the bodies are placed at its end.
  bool others_stay_behind(int guard) {
    const double crossing = crossing_of_points(guard) - turn(guard);
    return crossing > 0.0 && others_behind(guard, turn(guard) / crossing);
  }
  // True if the odometers say that the gap stays open in the step and is larger than the step's motion at its end. A
  // guard whose gap is not is a suspect, so that suspects do not depend on when guards were last evaluated.
  bool skip(int guard) const;
  // True if cheap bounds on the distance at the placed end of the step say so; then also moves the pair's mark.
  bool separated_at_end(int guard);
  // True if odometers or cheap bounds say, where the bodies are placed at the start of the step, that the guard stays
  // open in it.
  bool stays_apart(int guard);
  void mark(int guard, double gap_at_end);  // gap at the end of the step
  void unmark(int guard) { marks_[guard] = -1.0; }
  // The step is taken to this part of it: odometers advance. take_back(): it was not taken to its end after all.
  void commit(double part = 1.0);
  void take_back(double rest) { commit(-rest); }
  // Of a step that was taken to its end q1, shape (nq,), without a suspect; bound, h: as of its bound_motion. The steps
  // after it may be passed.
  void begin_span(const VecCRef& q1, const VecX& bound, double h);
  // Takes a step of length h whose velocities stay within bound if no guard may be a suspect in it, without a look at
  // any. False: that is not known, and nothing was done.
  bool pass(const VecX& bound, double h) { return span_.take(bound, h); }
  // As this, for speeds within |rate| + |rate - before|, of all dofs.
  bool pass(const double* rate, const double* before, double h) { return span_.take(scene_->tree.nv, rate, before, h); }
  // Looks ahead: whether a step after those foreseen so far may be passed, too. Each is in an interval of its own;
  // pass_foreseen() takes the first ones, steps_in() is what steps_since() will be in the interval of one of them.
  void look_ahead() { span_.look_ahead(); }
  bool foresee(const VecX& bound, double h) { return span_.foresee(bound, h); }
  bool foresee(const double* rate, const double* before, double h) {
    return span_.foresee(scene_->tree.nv, rate, before, h);
  }
  double steps_in(int interval) const { return span_.used_after(interval + 1) - used_before(interval); }
  void pass_foreseen(int steps) {
    counters.skipped += static_cast<long>(steps) * count_;
    interval_used_ = used_before(steps - 1);
    any_look_ = false;
    span_.take_foreseen(steps);
  }
  // Guards may have become other ones: the next step looks at them.
  void end_span();
  // Bound on how far any point of a geometry has moved since an arbitrary instant [m].
  double odometer(int geometry) const { return odometer_[geometry] + span_.used() * expected_.geometry[geometry]; }
  // An interval begins; motion_since() is that of a geometry from here on [m].
  void begin_interval() {
    interval_used_ = span_.used();
    any_look_ = false;
  }
  double motion_since(int geometry) const {
    return odometer(geometry) - (any_look_ ? interval_start_[geometry]
                                           : odometer_[geometry] + interval_used_ * expected_.geometry[geometry]);
  }
  // Whether no step of the interval looked at guards; then motion_since() is that of steps_since() reference steps of
  // the span under way, which is the number span().
  bool passed_all() const { return !any_look_; }
  double steps_since() const { return span_.used() - interval_used_; }
  long span() const { return spans_; }
  double motion_of_reference(int geometry) const { return expected_.geometry[geometry]; }
  // As bound_motion found it, for one geometry [m].
  double motion_of_geometry(int geometry) const { return motion_.geometry[geometry]; }

  // The motion since the guards were last evaluated.
  struct Memory {
    std::vector<double> odometer, marks;
    BroadPhase::Memory broad_phase;
  };
  Memory memory() const;
  void recall(const Memory& memory) {
    keep_start();
    span_.end();
    odometer_ = memory.odometer;
    marks_ = memory.marks;
    broad_phase_.recall(memory.broad_phase);
  }

  GuardCounters counters;

 private:
  double used_before(int interval) const { return interval > 0 ? span_.used_after(interval) : span_.used(); }
  void place_body(int body);
  void place_pair(int guard);
  void place_bodies();
  double find_nearest(int guard, Contact& contact);
  bool nearest_of_points(int guard, Contact& contact) const;
  // Whether the nearest features of a pair are known without coal.
  bool has_closed_form(int guard) const;
  PosedShape posed(const Pair& pair, int geometry) const;
  DistanceBounds::Bounds known_bounds(int guard);
  double cheap_bound(int guard);
  double limit_gap(int guard, const VecCRef& q) const;
  void keep_start();
  double span_of_pairs(double enough);
  double span_of(const BroadPhase::NearPair& pair) const;
  bool refine(const BroadPhase::NearPair& pair);

  const Scene* scene_;
  int count_, pairs_;
  Manifolds manifolds_;
  // Per guard: the number of its list of persistent contacts, -1: it has none.
  std::vector<int> persistent_number_;
  std::vector<std::vector<const ContactPoint*>> persistent_points_;  // the lists
  std::vector<int> free_lists_;
  Placements placements_;
  VecX q_;
  std::vector<long> placed_for_;  // per body: the last configuration for which it was placed
  long configuration_ = 0;        // number of the configuration q_
  long all_placed_for_ = -1;      // the last configuration for which all bodies were placed
  ShapeDistance distance_;
  DistanceBounds distance_bounds_;
  MotionBounds bounds_;
  MotionBounds::Reach motion_, doubt_, bend_, expected_;  // expected: in a reference step of the span
  std::vector<double> odometer_;                          // as MotionBounds::Reach::geometry
  std::vector<double> interval_start_;    // as it was where the interval began, kept where it is about to change
  double interval_used_ = 0.0;            // of the span, where the interval began
  bool any_look_ = false;                 // whether a step of the interval looked at guards
  long spans_ = 0;                        // how many spans have begun
  static constexpr double kNoises = 4.0;  // tolerances of depth
  std::vector<double> gap_;               // of each guard at its last evaluation,
  std::vector<long> gap_for_;             // and the configuration of that
  std::vector<double> marks_;             // per guard: odometer sum up to which it may be skipped
  BroadPhase broad_phase_;
  ClearSpan span_;
  bool span_ended_ = false;  // whether the step whose motion is bounded follows one of a span
};

}  // namespace contactvi
