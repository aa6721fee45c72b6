#pragma once

#include <string>
#include <utility>

#include "base/refusal.hpp"

namespace contactvi {

// Where a run has no derivative: a word for the reason (contactvi.errors.NotDifferentiable), the guard (-1: of none)
// and the time [s].
struct Obstacle {
  const char* reason;
  int guard;
  double time;
};

// Why a run has no derivative, or none that is known.
class NoDerivative : public Refusal {
 public:
  NoDerivative(const Obstacle& at, const std::string& fact, std::string expected_text, std::string got_text,
               std::string remedy_text)
      : Refusal(fact, std::move(expected_text), std::move(got_text), std::move(remedy_text)), where(at) {}
  const Obstacle where;
};

}  // namespace contactvi
