// The set of persistent contacts: which closed points persist after an event, and when a contact is dropped.
#pragma once

#include <functional>

#include "contact/contact_step.hpp"
#include "contact/dense_step.hpp"
#include "event/finder.hpp"
#include "impact/sequence.hpp"
#include "run/run_state.hpp"

namespace contactvi {

// Part of the speeds: a persistent contact that separates faster is released, a point that closes faster has an impact.
constexpr double kSeparates = 1e-10;

void record_change(double time, const ContactPoint& point, Change change, double value, Recording& recording);

class ContactSet {
 public:
  // Works on the persistent contacts of `step` and on the separated points of `run`.
  ContactSet(const Scene& scene, RunState& run, Integrator& integrator, Guards& guards, EventFinder& finder,
             ContactStep& step, ImpactSequence& sequence);

  // The set after an event whose closed guards are in the sequence: points that neither close nor separate, and those
  // of the guard `forced` (-1: none).
  void close_contacts(int forced, double time, const VecX& tau, Recording& recording);
  // The set at the start of a run: guards that touch and do not separate. pay: whether so many rows and points are
  // worth steps with persistent contacts. False, with no contacts, if they are not.
  bool close_contacts_at_start(const std::function<bool(int, int)>& pay);
  // Finds the contact points again at a node, because those of faces change as bodies slide on each other. Returns a
  // guard whose points have changed, -1: none.
  int find_points(double time, Recording& recording);
  // Releases the contacts that have separated in the contact step just accepted; `releasing` is the one whose force has
  // come to zero (-1: none). at_event: only those that are open already, for the others take part in the event.
  void release_separated(int releasing, bool at_event, double time, const VecX& tau, Recording& recording);
  // The set after a dense step that ends at `time`: what it has left closed and loaded. True if a contact began, ended
  // or closed fast.
  bool follow(const DenseStep& step, double time, Recording& recording);
  // Releases contact `i` before a step.
  void release(int i, double time, const VecX& tau, Recording& recording);
  // Contact i is at the border of its feature and goes beyond it, with the velocities v. The features that touch there,
  // too, take its place.
  void leave(std::size_t i, const VecX& v, double time, Recording& recording);
  // Tells the guards which of their points are persistent contacts, after a change of the set.
  void update_persistent_guards();
  // Dense steps hold no points: the guards have none in them.
  void forget_persistent_guards();
  const std::vector<int>& guards_with_contacts() const { return persistent_guards_; }

 private:
  void set_turning(const ClosedGuard& c, int k, PersistentContact& persistent) const;
  void take_turning(const DenseContact& c, double h, PersistentContact& persistent) const;
  PersistentContact make_persistent(const ContactPoint& point, const Contact& contact, const Vec3& slip);
  bool persists(const ClosedGuard& c, int k, int forced, double slow);
  void keep_point(const ClosedGuard& c, int k);
  void release_unloaded(int forced, const VecX& tau);
  void release_guard(int guard, double time, Recording& recording);
  bool points_may_change(int guard);
  bool points_changed(int guard);
  void forget_separated(int guard);
  bool find_touching(int guard);
  void tell_guards();
  void share_adhesion();
  std::vector<char> letting_go(int i, const VecX& tau);

  const Scene* scene_;
  RunState* run_;
  Integrator* integrator_;
  Guards* guards_;
  EventFinder* finder_;
  ContactStep* step_;
  ImpactSequence* sequence_;
  std::vector<int> persistent_guards_;  // guards with persistent contacts, as guards_ knows them
  std::vector<PersistentContact> previous_;
  std::vector<ContactPoint> points_;  // of one guard, with the nearest points of its pair
  Contact witness_{};
  std::vector<std::int64_t> left_;  // features of that guard that were left and are near
  std::vector<int> lost_guards_;    // guards whose points are no longer closed
  VecX v_, forces_;
};

}  // namespace contactvi
