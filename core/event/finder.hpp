// The first event of a step: which guard, when, and the state there.
//
// The step's exact path is that of partial steps: the end of the step of length alpha h. The search looks at a
// polynomial along the step (StepPath), for the price of geometry, and knows how far that may be off; what it finds
// is located on exact partial steps to |gap| <= 1e-12, and where it comes nearer to zero than it is true the exact
// path decides.
#pragma once

#include <vector>

#include "event/gap_path.hpp"
#include "step/stepper.hpp"

namespace contactvi {

struct Event {
  int guard = -1;
  double alpha = 0;           // fraction of the step
  double gap = 0;             // left over
  bool stays_closed = false;  // the guard was touching and did not separate
  VecX q, p;                  // state there, before the impact; engine coordinates
};

enum class Search { kNone, kFound, kNewtonFailed, kUnresolved };

class EventFinder {
 public:
  EventFinder(const Scene& scene, Stepper& stepper, Guards& guards);

  // What makes the steps that are searched from now on.
  void set_stepper(Stepper& stepper) {
    if (&stepper != stepper_) last_h_ = 0.0;
    stepper_ = &stepper;
  }
  // The step of the last search was not taken to its end.
  void cut();
  // A guard that is not looked at until the next step has been taken: a contact that has just left.
  void exempt(int guard) { exempt_.push_back(guard); }

  // Look through the step of length h from (q0, p0) to (q1, p1); path: its collocation polynomial, which is raised if
  // some guard comes into question. On kFound event() is filled, and the integrator holds the partial step to it.
  Search search(const VecX& q0, const VecX& p0, const VecX& q1, const VecX& p1, double h, const VecX& tau,
                StepPath& path);
  const Event& event() const { return event_; }
  int failed_guard() const { return failed_guard_; }
  double failed_gap() const { return failed_gap_; }

  // Guards that are closed at the placed configuration of guards(): touching or not, within tolerance.
  bool touching(int guard) const { return touching_[guard]; }
  void set_touching(int guard, bool value) { touching_[guard] = value; }
  // What the next search knows of the last one.
  struct Memory {
    std::vector<char> touching;
    std::vector<int> exempt;
    VecX rate, q, p;
    double h;
  };
  Memory memory() const { return {touching_, exempt_, last_rate_, last_q_, last_p_, last_h_}; }
  void recall(const Memory& memory) {
    touching_ = memory.touching;
    exempt_ = memory.exempt;
    last_rate_ = memory.rate;
    last_q_ = memory.q;
    last_p_ = memory.p;
    last_h_ = memory.h;
  }
  const Stepper* stepper() const { return stepper_; }
  // Guards that came into question in the last search, touching ones included: candidates for simultaneous contact.
  const std::vector<int>& active() const { return active_; }

 private:
  using Point = GapPath::Point;
  // A guard that may reach zero in the step, and what is known of it.
  struct Suspect {
    int guard;
    double end_gap;  // exact
    Point from;      // nothing happens before it, and the gap is positive there
    bool crosses, stays_closed;
    Point lo, hi;           // of a crossing: gap > 0 and <= 0 on the path
    bool lo_sure, hi_sure;  // so on the exact path too
    double root;
  };

  bool bound_step();
  bool raise_path();
  bool bound_grows();
  bool collect();
  Search start(Suspect& s);
  Search leave(Suspect& s, Point a);
  Search close(Suspect& s, const Point& a, const Point& below);
  Search find_first(Suspect*& first);
  Search advance(Suspect& s, double limit);
  Search exact_dip(Suspect& s, const Point& a, const Point& b);
  Search resume(Suspect& s, const Point& from);
  Search locate(Suspect& s, bool& exists);
  Search separate(Suspect& s);
  Search polish(Suspect& s, bool lo_seen, bool& exists);
  bool someone_is_earlier(const Suspect& first, bool coarse);
  bool exact_at(int guard, double tau, Point& point);  // false: no convergence
  void cross(Suspect& s, const Point& lo, const Point& hi, double offset);
  Search accept(int guard, const Point& at, bool stays_closed);
  void settle();
  Search fail(Search why, int guard, double gap);

  const Scene* scene_;
  Stepper* stepper_;
  std::vector<int> exempt_;
  Guards* guards_;
  GapPath gaps_;
  Event event_;
  std::vector<char> touching_;
  std::vector<int> active_, pass_;
  std::vector<Suspect> suspects_;
  VecX v0_, v1_, bound_, doubt_, W_;
  // Rate and end of the last step: one stage bounds its velocities by the change of rate from a neighbour.
  VecX last_rate_, last_q_, last_p_;
  double last_h_ = 0;
  Contact contact_;
  const VecX *q0_ = nullptr, *p0_ = nullptr, *q1_ = nullptr, *p1_ = nullptr, *tau_ = nullptr;
  StepPath* path_ = nullptr;
  double h_ = 0;
  int failed_guard_ = -1;
  double failed_gap_ = 0;
};

}  // namespace contactvi
