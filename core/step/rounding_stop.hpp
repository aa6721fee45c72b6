// When iterations x += dx that contract have reached the solution to rounding, and when they do not contract.
//
// Complex eigenvalues make the changes rise and fall within a few iterations while they contract over many: no progress
// means none over kPatience iterations, and only close to rounding are two enough.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

namespace contactvi {

class RoundingStop {
 public:
  static constexpr int kMostIterations = 100;
  enum class Verdict { kGoOn, kSolved, kFailed };

  // After an iteration: the largest change of a number of x, and the largest of x.
  Verdict judge(double change, double largest) {
    if (!std::isfinite(change)) return Verdict::kFailed;
    if (change <= kExact * largest) return Verdict::kSolved;
    stagnant_ = change < kProgress * best_ ? 0 : stagnant_ + 1;
    best_ = std::min(best_, change);
    // Where the iterations diverge, x outgrows the least change: the present one has to be small, too.
    const bool small = change <= kAccept * largest;
    if (stagnant_ >= 2 && small && best_ <= kRounding * largest) return Verdict::kSolved;
    if (stagnant_ >= kPatience) return small ? Verdict::kSolved : Verdict::kFailed;
    return ++count_ < kMostIterations ? Verdict::kGoOn : Verdict::kFailed;
  }

 private:
  static constexpr double kExact = 4e-16;     // change, of the size of x, that is rounding
  static constexpr double kRounding = 1e-14;  // change that may be the rounding of the sums that x comes from
  static constexpr double kAccept = 1e-12;    // the same in equations of bad condition
  static constexpr double kProgress = 0.9;    // ratio of changes that counts as progress
  static constexpr int kPatience = 6;         // iterations without progress after which nothing more is gained

  double best_ = std::numeric_limits<double>::infinity();
  int stagnant_ = 0, count_ = 0;
};

}  // namespace contactvi
