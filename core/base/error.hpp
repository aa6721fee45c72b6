// Outcome of a run and the one exception type of the engine.
#pragma once

#include <stdexcept>
#include <string>

namespace contactvi {

// The numbers are part of the Python API (StatusCode) and of stored trajectories: append, never renumber.
enum class StatusCode : int {
  kSuccess = 0,
  kZeno = 1,             // impacts accumulate, or a contact stays closed
  kNewtonFailed = 2,     // the discrete Euler-Lagrange equation could not be solved
  kNotFinite = 3,        // NaN or infinity in state or forces
  kEventUnresolved = 4,  // a guard crossed zero but its root could not be located
  kTooManyImpacts = 5,
  kPenetration = 6,  // the start state has a negative gap
  kInterrupted = 7,
  // 8 is LEDGER of the Python API, which alone keeps the energy balance.
  kConstraint = 9,     // the constraints cannot be met
  kTooManySteps = 10,  // steps of the length that an accuracy needs are too many to be kept
  // 11 is REFUSED of the Python API, of a run that never began.
  kImpactUnsolved = 12,  // no impulses were found that satisfy the law of an impact
};

struct Status {
  StatusCode code = StatusCode::kSuccess;
  std::string message;
  double time = 0.0;               // time reached [s]
  int guard = -1;                  // guard index (contact pairs first, then joint limits), -1: none
  double accumulation_time = 0.0;  // Zeno time [s], NaN where it does not apply
  double depth = 0.0;              // penetration depth [m] or [rad], NaN where it does not apply
  bool ok() const { return code == StatusCode::kSuccess; }
};

// A fault of the engine or of the Python API, a bug to the user; what the user can mend is a Refusal (refusal.hpp).
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// What is wrong with an argument, where it is.
inline void need(bool condition, const char* what) {
  if (!condition) throw Error(what);
}

}  // namespace contactvi
