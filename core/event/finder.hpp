// The first event of a step: which guard, when, and the state there.
//
// The step's exact path is that of partial steps: at alpha it is the end of the step of length alpha h. The search
// follows a polynomial along the step (StepPath), which costs geometry alone, and knows a bound on its error; what it
// finds is located on exact partial steps to |gap| <= 1e-12, and where the gap comes nearer to zero than that error the
// exact path decides.
#pragma once

#include <algorithm>
#include <vector>

#include "event/gap_path.hpp"
#include "step/stepper.hpp"
#include "step/steps_ahead.hpp"

namespace contactvi {

struct Event {
  int guard = -1;
  double alpha = 0;           // fraction of the step
  double gap = 0;             // at the place found, zero to the tolerance
  bool stays_closed = false;  // the guard was touching and has not separated
  VecX q, p;                  // state there, before the impact; engine coordinates
};

enum class Search { kNone, kFound, kNewtonFailed, kUnresolved };

class EventFinder {
 public:
  EventFinder(const Scene& scene, Stepper& stepper, Guards& guards);

  // The method that makes the steps searched from now on.
  void set_stepper(Stepper& stepper) {
    if (&stepper != stepper_) memory_.h = 0.0;
    stepper_ = &stepper;
  }
  // The step of the last search was not taken to its end, but to this part of it.
  void cut(double part);
  // The next step begins elsewhere than the last search expects.
  void forget_step();
  // Leaves a guard out until the next step has been taken: a contact that has just separated.
  void exempt(int guard) {
    guards_->end_span();
    memory_.exempt.push_back(guard);
  }
  // A guard that has had an impact is searched again.
  void end_exemption(int guard) {
    memory_.exempt.erase(std::remove(memory_.exempt.begin(), memory_.exempt.end(), guard), memory_.exempt.end());
  }
  const std::vector<int>& exempted() const { return memory_.exempt; }
  // Where the guards are placed, inside of the step of the last search, which a change of the contacts has cut: whether
  // a guard is below zero there, which the path of the whole step did not show. One that is left out is so no more.
  bool closes_before_cut();

  // Searches the step of length h from (q0, p0) to (q1, p1); path: its collocation polynomial, which is raised if
  // some guard may reach zero. On kFound event() is filled, and the integrator holds the partial step to it.
  Search search(const VecX& q0, const VecX& p0, const VecX& q1, const VecX& p1, double h, const VecX& tau,
                StepPath& path);
  // Whether a step is known to have no event before anything is known of its path, since no guard can be near in it; it
  // is taken then. rate: of its only stage, (nv,); null: there are several.
  bool passes(const VecX& q0, const VecX& p0, const VecX& q1, const VecX& p1, double h, const double* rate);
  const Event& event() const { return event_; }
  // In how many of the steps of length h from (q0, p0) on, at most `most`, which were solved in advance, no guard can
  // be near: they pass, one after the other. pass_foreseen() makes the last search one of that number of them.
  int foresee(const VecX& q0, const VecX& p0, double h, const StepsAhead& steps, int most);
  void pass_foreseen(const StepsAhead& steps, int count);
  int failed_guard() const { return failed_guard_; }
  double failed_gap() const { return failed_gap_; }

  // Whether a guard is closed, within tolerance, at the start of the next step.
  bool touching(int guard) const { return memory_.touching[guard]; }
  // False: no guard is.
  bool any_touching() const { return any_touching_; }
  void list_touching(std::vector<int>& guards) const;  // ascending
  void set_touching(int guard, bool value) {
    guards_->end_span();
    memory_.touching[guard] = value;
    any_touching_ |= value;
  }
  void forget_touching() {
    std::fill(memory_.touching.begin(), memory_.touching.end(), 0);
    any_touching_ = false;
  }
  // What the next search uses of the last one.
  struct Memory {
    std::vector<char> touching;  // per guard: closed, within tolerance, at the start of the next step
    std::vector<int> exempt;     // guards that the next search leaves out
    // Rate, end state and length of the last step: with one stage the velocities are bounded by the change of the rate
    // from a step of equal length. h = 0: the last step does not lead to the next one.
    VecX rate, q, p;
    double h = 0.0;
  };
  const Memory& memory() const { return memory_; }
  void recall(const Memory& memory) {
    memory_ = memory;
    any_touching_ = std::find(memory_.touching.begin(), memory_.touching.end(), 1) != memory_.touching.end();
  }
  const Stepper* stepper() const { return stepper_; }
  // Guards that might have reached zero in the last search, touching ones included: they may be hit at one time.
  const std::vector<int>& active() const { return active_; }

 private:
  using Point = GapPath::Point;
  // A guard that may reach zero in the step, and what the search has found about it.
  struct Suspect {
    int guard;
    Point end;   // its gap is exact
    Point from;  // the gap is positive there and has not been zero before; at the end of the step: nor will be
    bool crosses, stays_closed;
    Point lo, hi;           // ends of a crossing: gap > 0 and <= 0 on the path
    bool lo_sure, hi_sure;  // whether these signs hold on the exact path too
    double root;
    bool started = false;  // whether `from` is the start of the step
    bool held = false;     // whether a persistent point over a halfspace touches at the end of the step
  };

  bool bound_step();
  bool is_clear(const double* rate, double h);
  const VecX& bound_of(const double* rate, const double* before);
  bool raise_path();
  bool plainly_clear();
  bool stays_open(Suspect& s);
  bool bound_again();
  void forget_last();
  bool collect();
  bool collect(int guard);
  void look_at_start(Suspect& s);
  Search start(Suspect& s);
  Search separate_touching(Suspect& s, Point a);
  Search close(Suspect& s, const Point& a, const Point& below);
  Search find_first(Suspect*& first);
  Search advance(Suspect& s, double limit);
  Search exact_dip(Suspect& s, const Point& a, const Point& b);
  Search resume(Suspect& s, const Point& from);
  Search locate(Suspect& s, bool& exists);
  Search find_open(Suspect& s);
  Search polish(Suspect& s, bool lo_seen, bool& exists);
  bool someone_is_earlier(Suspect& first, bool coarse);
  bool exact_at(int guard, double tau, Point& point);  // false: no convergence
  bool closes(int guard);
  bool exempted_closes();
  void cross(Suspect& s, const Point& lo, const Point& hi, double offset);
  Search accept(int guard, const Point& at, bool stays_closed);
  void settle();
  bool follows(const VecX& q0, const VecX& p0, double h) const;
  void remember();
  Search fail(Search why, int guard, double gap);

  const Scene* scene_;
  Stepper* stepper_;
  Guards* guards_;
  GapPath gaps_;
  Event event_;
  std::vector<int> active_, pass_;
  std::vector<Suspect> suspects_;
  VecX v0_, v1_, bound_, doubt_, W_;
  Memory memory_;
  bool any_touching_ = false;  // whether one may
  bool settled_ = false;       // the odometers have advanced by the whole step of the last search
  Contact contact_;
  const VecX *q0_ = nullptr, *p0_ = nullptr, *q1_ = nullptr, *p1_ = nullptr, *tau_ = nullptr;
  StepPath* path_ = nullptr;
  double h_ = 0;
  int failed_guard_ = -1;
  double failed_gap_ = 0;
};

}  // namespace contactvi
