// The points that may touch in a dense step: those of all pairs that may close within it, and joint limits.
#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "geometry/guard.hpp"

namespace contactvi {

// A point that may touch in the step, and the result of the step for it.
struct DenseContact {
  ContactPoint point;
  ContactPoint law;  // the point as the step sees it (Manifolds::frozen)
  double mu, restitution;
  double allowed;           // what its gap may be at the end, at most 0 [m]
  Contact at0, at1;         // at the start and the end of the step
  Vec3 t1_0, t1_1;          // tangents there, world
  Vec3 position, velocity;  // impulses (n, t1, t2) [N s]: with the rows of the start, of the end
  double closing;           // normal speed before the step [m/s], negative: closing
  double slip_speed;        // at the end [m/s]
  Vec3 slip_W;
  bool closed;   // takes part in the velocity impulse
  bool expands;  // restitution acts
  bool joined;   // found where it overlaps at the end of a motion, not at the start of the step
  // Of surfaces that move along themselves, the velocities of the tangential rows at the start and the end [m/s].
  Eigen::Vector2d drift0, drift1;
  // Friction against spinning and rolling: radii [m], 0: none; as (spin, roll1, roll2), with the radii in the rows, its
  // impulses [N s] and what surfaces that turn add to its speeds [m/s].
  double spinning, rolling;
  Vec3 position_turning, velocity_turning, turning_drift0, turning_drift1;
  Vec3 turning_speed;  // at the end, radii times angular velocities [m/s]
  // Impulses of adhesion at the start and at the end [N s], and how they change with the time there [N].
  Eigen::Vector2d pull, pull_rate;
  Eigen::Vector2d shares;  // of friction along the tangents (TangentFrame)
  int rows() const { return mu > 0.0 ? 3 : 1; }
  bool turns() const { return spinning > 0.0 || rolling > 0.0; }
  TangentFrame frame(bool at_end) const {
    return at_end ? TangentFrame{t1_1, at1.normal.cross(t1_1), shares}
                  : TangentFrame{t1_0, at0.normal.cross(t1_0), shares};
  }
  bool loaded() const { return position[0] + velocity[0] > 0.0; }
  Vec3 turning_W(const Vec3& turning, bool at_end) const;  // world frame
  Vec3 position_W() const;
  Vec3 velocity_W() const;
};

// What a point carried in the last step, from which the next one starts.
struct DenseImpulse {
  int guard;
  std::int64_t feature;
  Vec3 position_force, velocity_force;  // world frame [N]; of a joint limit the first number
  // Of turning friction over its radii, as vectors: about the normal that of spinning, across it that of rolling [N].
  Vec3 position_turning = Vec3::Zero(), velocity_turning = Vec3::Zero();
};

class DenseCandidates {
 public:
  static constexpr double kGapPromised = 1e-10;  // [m] overlap at the end from which on a point joins the candidates

  DenseCandidates(const Scene& scene, Guards& guards) : scene_(&scene), guards_(&guards) {
    for (const Geometry& g : scene.geometries)
      if (!g.unbounded) thinnest_ = std::min(thinnest_, g.box_half.minCoeff());
  }

  // For a step of length h from q0; nominal_h: that of a whole step.
  void begin(const VecCRef& q0, double h, double nominal_h);
  // Adds the points of the pairs that may close with velocities within bound, shape (nv,), as far as they are not known
  // yet, where they are loaded or nearly close at q_free, the end of the step without impulses; those of others join
  // where they overlap in the end. impulses: of the last step.
  void collect(const VecX& bound, const VecX& q_free, const std::vector<DenseImpulse>& impulses);
  // Looks at the pairs at the end q1 of the step. Points that overlap there and are none of the first `known` contacts
  // join, and crossings that have run off their edges there become a point of one body over a plane of the other. True
  // if there were any: then the step is to be solved again with them.
  bool add_overlapping(const VecX& q1, std::size_t known, const std::vector<DenseImpulse>& impulses);

  std::vector<DenseContact>& contacts() { return contacts_; }
  const std::vector<DenseContact>& contacts() const { return contacts_; }
  // Gap, normal and points where the guards are placed.
  void evaluate(const ContactPoint& law, Contact& contact) { evaluate(law, nullptr, contact); }
  // Least gap at the last end looked at, at most 0 [m].
  double gap() const { return gap_; }
  // The guard of that gap, -1: nothing overlaps there.
  int deepest() const { return deepest_; }
  // Whether two bodies have come to the other sides of each other on the way to the last end looked at, where they move
  // farther than they are thick.
  bool passes_through() const { return passes_; }
  // How what overlaps may be left changes with the length of the step [m/s].
  double allowed_rate() const;
  // [m; rad] Error of the gap of a guard: features of a rough hull overlap by less than its distance does, and shorter
  // steps do not change that.
  double noise(int guard) const;
  // Whether no gap there is below what is allowed by more than the error of its distance.
  bool keeps_gaps() const { return excess_ >= -gap_noise_; }

 private:
  // A pair that may close in the step, or a joint limit.
  struct Near {
    int guard;
    double gap0, reach;  // reach: how much nearer its bodies may come [m]
    double allowed;      // as of a contact
    Contact witness0;
    bool watched;  // its points are no candidates, and gap0 and witness0 are not known
  };

  double allowed(double gap0) const;
  void find_passages(const VecX& q1);
  bool stays_open(int guard, const std::vector<DenseImpulse>& impulses);
  bool is_near(Near& near);
  void add_points(const Near& near, const std::vector<DenseImpulse>& impulses);
  void add_ends(const Near& near, const std::vector<DenseImpulse>& impulses);
  void add_loaded(const Near& near, const std::vector<DenseImpulse>& impulses);
  void add_rims(const Near& near, const std::vector<DenseImpulse>& impulses);
  void evaluate(const ContactPoint& point, const Contact* witness, Contact& contact);
  ContactPoint frozen(const ContactPoint& point, const Contact& witness) const {
    return guards_->manifolds().frozen(point, guards_->placements(), witness, guards_->turn(point.guard),
                                       scene_->tree.gravity.norm() * h_ * h_);
  }
  bool add(const ContactPoint& point, const ContactPoint& law, const Near& near,
           const std::vector<DenseImpulse>& impulses, bool joined = false);
  void set_law(DenseContact& c, const ContactPoint& law, const Near& near);
  const Near& near_of(int guard) const;
  void find_run_off(std::size_t known);
  void set_start_impulses(DenseContact& c, const std::vector<DenseImpulse>& impulses) const;

  const Scene* scene_;
  Guards* guards_;
  std::vector<Near> near_;
  std::vector<int> guards_to_look_at_;
  std::vector<DenseContact> contacts_;
  std::vector<ContactPoint> points_, laws_;
  std::vector<std::size_t> run_off_;
  std::vector<std::ptrdiff_t> closing_;  // pairs that are watched and overlap at the end
  VecX q0_;
  double h_ = 0.0, share_ = 1.0, gap_ = 0.0, gap_noise_ = 0.0;
  int deepest_ = -1;
  bool passes_ = false;
  double thinnest_ = std::numeric_limits<double>::infinity();  // half of the least width of a box [m]
  double excess_ = 0.0;                                        // of the gap that is furthest below what is allowed
};

}  // namespace contactvi
