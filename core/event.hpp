// The first event of a step: which guard, when, and the state there.
//
// The step's path is that of exact partial steps: q(alpha) = q0 (+) alpha h v(alpha), v(alpha) the solution of the
// discrete Euler-Lagrange equation for alpha h. The search for a sign change looks at a model of it,
// v(alpha) quadratic through v0, v(1/2) and v1, error O(h^4), by conservative advancement: an interval is free of
// contact if its two gaps add up to more than the bodies can move in it. What it finds is located on exact partial
// steps to |gap| <= 1e-12.
#pragma once

#include <vector>

#include "guard.hpp"
#include "integrator.hpp"

namespace contactvi {

struct Event {
  int guard = -1;
  double alpha = 0;         // fraction of the step
  double gap = 0;           // left over
  bool persistent = false;  // the guard was touching and did not separate
  VecX q, p;                // state there, before the impact; engine coordinates
};

enum class Search { kNone, kFound, kNewtonFailed, kUnresolved };

class EventFinder {
 public:
  EventFinder(const Scene& scene, Integrator& integrator, Guards& guards);

  // Look through the step of length h from (q0, p0) whose solution is v1, end q1. previous: midpoint velocity of the
  // step before if that was a neighbour of equal length, else null. On kFound event() is filled.
  Search search(const VecX& q0, const VecX& p0, const VecX& v1, const VecX& q1, double h, const VecX& tau,
                const VecX* previous);
  const Event& event() const { return event_; }
  int failed_guard() const { return failed_guard_; }
  double failed_gap() const { return failed_gap_; }

  // Guards that are closed at the placed configuration of guards(): touching or not, within tolerance.
  bool touching(int guard) const { return touching_[guard]; }
  void set_touching(int guard, bool value) { touching_[guard] = value; }
  // Guards that came into question in the last search, touching ones included: candidates for simultaneous contact.
  const std::vector<int>& active() const { return active_; }

 private:
  struct Candidate {
    int guard;
    double lo, hi;  // gap > 0 at lo, <= 0 at hi
    double estimate;
    bool touching;  // lo has to be found first
  };
  Search check(int guard, double end_gap);
  Search check_touching(int guard, double end_gap);
  bool find_dip(int guard, double lo, double gap_lo, double hi, double gap_hi, int depth, Candidate& found);
  Search locate(Candidate& candidate, bool& exists);
  bool start_velocity();
  bool prepare_model();
  double model_rate(double alpha) const;
  bool exact_dip(int guard, double lo, double hi, Candidate& found);
  double model_gap(int guard, double alpha);             // on the model path
  bool exact_gap(int guard, double alpha, double& gap);  // on the exact path; false: no convergence
  double gap_rate(int guard);                            // d(gap)/d(alpha) of the last exact_gap
  Search fail(Search why, int guard, double gap);

  const Scene* scene_;
  Integrator* integrator_;
  Guards* guards_;
  Event event_;
  std::vector<char> touching_;
  std::vector<int> active_, pass_;
  std::vector<Candidate> candidates_;
  VecX q_, p_, v_, v0_, bound_, guess_, bend_, W_;
  Contact contact_;
  const VecX *q0_ = nullptr, *p0_ = nullptr, *v1_ = nullptr, *tau_ = nullptr;
  double h_ = 0;
  bool have_v0_ = false, have_bend_ = false;
  double slack_ = 0;  // doubt about the model path, as a fraction of the motion
  int failed_guard_ = -1;
  double failed_gap_ = 0;
};

}  // namespace contactvi
