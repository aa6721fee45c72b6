// The slip speeds of De Saxce's correction, frozen while a convex problem is solved and then extrapolated (Anderson
// mixing; Walker and Ni, "Anderson acceleration for fixed-point iterations", 2011).
#pragma once

#include <vector>

#include "cone/block_system.hpp"

namespace contactvi {

class SlipSpeeds {
 public:
  const std::vector<double>& speeds() const { return speeds_; }  // per contact, not negative [m/s]
  void clear(const BlockSystem& system);                         // all zero
  void restart(const BlockSystem& system, const VecX& v);        // those of v, without a past
  // From the speeds of v, the answer of the convex problem with the present ones.
  void extrapolate(const BlockSystem& system, const VecX& v);

 private:
  static constexpr int kDepth = 5;
  std::vector<double> speeds_;
  VecX now_, present_;                // |w_t| of v; the speeds as a vector
  MatX answers_, changes_;            // (contacts, kDepth + 1): the last answers, and what they changed
  MatX answer_steps_, change_steps_;  // their differences
  int count_ = 0;
};

}  // namespace contactvi
