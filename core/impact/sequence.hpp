// The impacts at the instant of an event: a sequence of single impacts, one pair (with all its points) after the other,
// until no closed contact has a closing speed.
//
// Order (deterministic): the elastic contact that closes fastest, the lowest guard on ties; when none closes, all
// plastic contacts together as one problem with e = 0, the limit of their endless sequence; again until none closes. A
// persistent contact takes part with its own e, or, as an option, as a support of infinite stiffness.
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "contact/persistent_contact.hpp"
#include "event/finder.hpp"
#include "impact/impact_block.hpp"
#include "impact/impact_block_record.hpp"
#include "impact/impact_law.hpp"
#include "record/recording.hpp"
#include "step/projection.hpp"

namespace contactvi {

struct ImpactOptions {
  ImpactMap map = ImpactMap::kCtec;
  bool stiff_support = false;
  long max_impacts_per_step = 0;
  bool record_contacts = true;
  bool keep_blocks = false;  // impacts of several points are kept for derivatives
};

// The instant of an event: its time, the lengths of the partial step that ends there, of the rest of the step and of
// the whole of it [s]. An implicit map has its equation over the rest, which `rest` makes; null: persistent contacts
// act in it, and the scalar that the map conserves is not known.
struct Instant {
  double time, before, after, dt;
  const VecX& tau;
  long step;
  Stepper* rest;
};

class ImpactSequence {
 public:
  ImpactSequence(const Scene& scene, Integrator& integrator, Guards& guards, const ImpactOptions& options);

  // The contacts closed at q and the time t [s]: of the guards `active` those within tolerance, `first` in any case,
  // and the persistent ones. False if the mass matrix is not positive, or if constraints run into what cannot give way.
  bool collect(const VecX& q, const VecX& p, double t, const std::vector<int>& active, int first,
               const std::vector<PersistentContact>& persistent);
  // Takes these guards as closed at q and the time t [s], whatever their gaps are. margin: a pair's points within its
  // least gap, or within this [m] where that is more, belong to the contact. False if the mass matrix is not positive.
  bool collect_given(const VecX& q, const VecX& p, double t, const std::vector<int>& guards, double margin);
  // Takes these points as closed at q, contact after contact. False if the mass matrix is not positive.
  bool collect_block(const VecX& q, const VecX& p, const ImpactBlockRecord& block);
  int count() const { return count_; }
  // Whether constraints hold all points of a guard that were closed at the last collection.
  bool holds(int guard) const { return std::find(held_.begin(), held_.end(), guard) != held_.end(); }
  ClosedGuard& closed(int i) { return closed_[i]; }
  const ClosedGuard& closed(int i) const { return closed_[i]; }
  // Largest normal speed of a closed contact at p.
  double largest_speed(const VecX& p) const;
  // The limit of max_impacts_per_step counts from here.
  void begin_step() { impacts_in_step_ = 0; }
  // Nothing is closed until the next collection.
  void forget() { count_ = 0; }
  // Impacts until nothing closes: p changes, and the losses are subtracted from the reference. Otherwise code(),
  // message() and guard() tell why not. plastic: guards whose e counts as zero.
  bool run(const Instant& at, const std::vector<char>& plastic, ImpactReference& reference, VecX& p,
           Recording& recording);
  // Impacts of the last run.
  int impacts() const { return impacts_; }
  // Impulses that impacts have caused in the rows of the constraints, and the work [J] of constraints with a prescribed
  // motion in them, both summed up over the last run.
  const VecX& constraint_impulses() const { return constraint_impulses_; }
  double driven_work() const { return driven_work_; }
  // The impacts of several points since the last call, with keep_blocks.
  std::vector<ImpactBlockRecord> take_blocks() { return std::exchange(blocks_, {}); }
  StatusCode code() const { return code_; }
  const char* message() const { return message_; }
  int guard() const { return guard_; }

 private:
  static constexpr double kSolved = 1e-11;  // of all speeds of the closed points: a smaller closing speed is zero

  bool place(const VecX& q, const VecX& p, double t);
  void begin_guard(int guard);
  bool add_guard(int guard, const std::vector<PersistentContact>& persistent, double margin);
  void add_rows(ClosedGuard& closed);
  bool drop_held_points(ClosedGuard& closed, const VecX& p);
  bool is_mobile(const ClosedGuard& closed, int point);
  bool add_unused_point(const VecX& p);
  bool find_fastest(const VecX& p, const std::vector<char>& plastic, double scale, bool elastic, ClosedGuard*& worst);
  double restitution(const ClosedGuard& closed, const VecX& p) const;
  bool impact_at_point(ClosedGuard& closed, double e, const Instant& at, VecX& p, Recording& recording);
  bool is_rounding(const ClosedGuard& closed, const VecX& lambda) const;
  bool impact_of_contact(ClosedGuard& closed, double e, const Instant& at, VecX& p, Recording& recording);
  bool plastic_impact(const std::vector<char>& plastic, bool all, const Instant& at, double scale, VecX& p, bool& any,
                      Recording& recording);
  ImpactResult correct_impulse(const ClosedGuard& closed, const ImpactBlockResult& block, double e, const Instant& at,
                               VecX& p);
  bool leaves_friction_cone(const ClosedGuard& closed, const VecX& lambda, double normal) const;
  void carry_over(const ImpactResult& result);
  void keep_block(const std::vector<BlockMember>& members, std::size_t first, const Recording& recording);
  void record(const ClosedGuard& closed, const VecX& lambda, const VecX& p_minus, const VecX& p_plus,
              const ImpactResult& result, double e, double loss, double gamma_minus, double gamma_plus,
              const Instant& at, Recording& recording);
  // Whether an implicit map has an equation at this instant.
  bool is_implicit(const Instant& at) const { return law_->implicit() && at.rest != nullptr && !any_persistent_; }
  bool fail_unsolved(const char* message, int guard);
  bool fail(StatusCode code, const char* message, int guard);

  const Scene* scene_;
  Integrator* integrator_;
  Guards* guards_;
  ImpactOptions options_;
  const ImpactLaw* law_;
  std::vector<ClosedGuard> closed_;
  int count_ = 0;
  std::vector<int> held_;  // guards with closed points, all of which constraints hold
  bool any_persistent_ = false;
  ImpactReference* reference_ = nullptr;  // of the run under way
  int impacts_ = 0;
  long impacts_in_step_ = 0;
  VecX constraint_impulses_;
  double driven_work_ = 0;
  double time_ = 0;  // at which the contacts are closed [s]
  double speeds_ =
      0;  // largest sum of the absolute terms of a closed point's speed before the event: the scale of its rounding
  Projection projection_;
  VecX q_, v_;
  ImpactBlock impact_block_;
  std::vector<ImpactBlockRecord> blocks_;
  StatusCode code_ = StatusCode::kSuccess;
  const char* message_ = "";
  int guard_ = -1;
};

}  // namespace contactvi
