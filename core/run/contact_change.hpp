// Changes of contact inside a contact step, located like events: the release of a contact, where its continuous force
// comes to zero, and the end of a slip.
#pragma once

#include "contact/contact_step.hpp"
#include "run/run_state.hpp"

namespace contactvi {

class ContactChangeFinder {
 public:
  // `path` is that of the contact step under way.
  ContactChangeFinder(const RunState& run, ContactStep& step, const StepPath& path)
      : run_(&run), step_(&step), path_(&path) {}

  // To be called at the start of an interval: only the first ends of slips in it are located.
  void begin_interval() { sticks_located_.clear(); }
  // The first release of a contact in the contact step just solved, which ends at alpha: alpha becomes the fraction of
  // the step at which the contact force comes to zero. at_start: the force is zero at the start of the step already.
  // False if the forces could not be found.
  bool find_release(const VecX& tau, double& alpha, bool& at_start);
  // The contact that is released, -1: none.
  int releasing() const { return releasing_; }
  void set_releasing(int i) { releasing_ = i; }
  // The first slip that comes to rest in the contact step just solved, which ends at alpha: alpha becomes the fraction
  // of the step at which it does. False if a partial step was not solved.
  bool find_stick(const VecX& tau, double& alpha);
  // The slip that it has located, -1: none.
  int stuck() const { return stuck_; }

 private:
  int slipping_part(int slip) const;
  bool release_force(const VecX& tau, double alpha, double& value);
  bool remaining_slip(const VecX& tau, double alpha, double& value);

  const RunState* run_;
  ContactStep* step_;
  const StepPath* path_;
  int stuck_ = -1;
  int releasing_ = -1, sticking_ = -1;  // contacts that the root searches look at; slips are numbered as the step does
  std::vector<int> sticks_located_;     // in the interval, each by the part that slipped
  double solved_ = 0.0;                 // the fraction of the step at which remaining_slip has solved it last
  std::vector<int> ending_slips_;       // slips that end in the step
  VecX forces_;
};

}  // namespace contactvi
