// What persistent contacts do in smooth steps: which of them stick and which slide, and where that ends.
//
// In a smooth step the contacts are rows that hold from its start to its end (contact/persistent_rows.hpp). A phase
// ends where the continuous force of a contact comes to zero, where it leaves its friction cone, or where a slip comes
// to rest. So does the part of it in which points touch at the same features. Continuous forces are those of
// accelerations (ContactStep::forces_at), which are exact at any state: impulses of a step tell forces to order s only,
// and where contacts share a load not at all.
#pragma once

#include <vector>

#include "contact/contact_step.hpp"
#include "contact/feature_borders.hpp"
#include "contact/held_impulses.hpp"
#include "contact/persistent_rows.hpp"
#include "event/switch_finder.hpp"
#include "record/recording.hpp"
#include "step/integrator.hpp"

namespace contactvi {

class ContactModes final : public SwitchFunctions {
 public:
  ContactModes(const Scene& scene, Guards& guards, ContactStep& step, Integrator& integrator);

  // The next smooth step starts at (q, v) at t [s]: it holds the contacts as they are there. False: it cannot; the
  // reason may be that forces were not found, or that no force keeps a sliding contact closed.
  bool begin_step(const VecX& q, const VecX& v, double t, const VecX& tau, Recording& recording);
  // The next smooth steps hold no contacts.
  void end_step() {
    if (active_) integrator_->hold(nullptr);
    active_ = watches_ = false;
  }
  bool active() const { return active_; }

  // Whether the contacts of the step just solved, to q1, are those of the features that touch there. beyond_borders: or
  // beyond the borders of their faces, at which the step is to end.
  bool fits(const VecX& q1, bool beyond_borders);
  // Whether it leaves open how sliding contacts share a load, which decides about the motion: contact steps do not.
  bool is_undetermined() const { return integrator_->constraints()->slides_share_load(); }
  // Looks from now on whether what they do ends in that step, of length h from a state with the velocity v0.
  void take_step(double h, const VecX& v0, const VecX& q1, const VecX& tau);
  const VecX& tau() const { return tau_; }  // of the step taken last
  double friction_work();                   // in the step just solved [J], <= 0

  int count() const override { return active_ && watches_ ? static_cast<int>(endings_.size()) : 0; }
  void evaluate(double at, const VecX& q, const VecX& v, VecRef values) override;
  bool may_stay_zero(int) const override { return true; }

  enum class End { kRelease, kSlip, kStick, kJointSlips, kJointSticks, kFeature };
  struct Ending {
    std::size_t contact;  // or joint with friction, or feature with a border
    End end;
  };
  const Ending& ending(int function) const { return endings_[static_cast<std::size_t>(function)]; }
  // Of an ending of the kind kFeature: whether its point ends, and which contact that is.
  bool ends_point(const Ending& ending) const { return borders_.ends_point(static_cast<int>(ending.contact)); }
  std::size_t point_of(const Ending& ending) const { return borders_.contact(static_cast<int>(ending.contact)); }
  // Contact i begins to slip, or comes to rest, at the state where evaluate() was called last, at this time [s]; with
  // it all others that are as far.
  void begin_slip(std::size_t i, double time, Recording& recording);
  void come_to_rest(std::size_t i, const VecX& v, double time, Recording& recording);
  void begin_joint_slip(std::size_t k);

  // Whether the impulses of the step, or the part of it that was solved last, are such as contacts may have.
  bool admits();
  // If not: whether shorter steps do not help, but contact steps do.
  bool needs_contact_steps() const { return shares_ || impulses_.some_node_pulls(); }
  // That step is taken: its forces are recorded, half of each impulse at either end with the mean of its normals, and
  // the contacts are where it ends. wanted: whether forces are wanted in the record.
  void commit(double time, long step, bool wanted, Recording& recording);

 private:
  bool find_modes(const VecX& q, const VecX& v, double t, const VecX& tau, Recording& recording);
  bool is_paradox(std::size_t i) const;
  bool stays_closed(std::size_t i, double slow) const;
  Vec3 direction(double at, std::size_t i) const;
  double stick_margin(std::size_t i) const;
  bool may_end() const;
  bool joints_may_end(const StageConstraints& rows) const;
  bool borders_may_be_crossed(const VecX& q1);

  const Scene* scene_;
  Guards* guards_;
  ContactStep* step_;
  Integrator* integrator_;
  PersistentRows rows_;
  FeatureBorders borders_;
  bool active_ = false;
  bool watches_ = false;      // what contacts do may end in the step
  bool shares_ = false;       // contacts share a load
  std::vector<char> begins_;  // per contact: its slip begins with the step
  std::vector<Ending> endings_;
  double t_ = 0.0, h_ = 0.0;
  VecX v0_, tau_;
  std::vector<std::vector<Vec3>> headings_;  // per node of the whole step, and contact
  std::vector<Vec3> directions_;
  VecX q_stage_, v_stage_, depths_, least_, largest_;
  ContactStep::Forces forces_;
  HeldImpulses impulses_;
};

}  // namespace contactvi
