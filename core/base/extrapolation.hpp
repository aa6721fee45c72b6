// Predicts the next vector of a series of which each belongs to the middle of a step: the polynomial through the last
// ones, of the degree that would have predicted the last one best.
//
// High degrees pay where the motion is smooth and are worse than none right after a kink, where a contact comes to
// rest or a force jumps; which of both it is shows in the last prediction.
#pragma once

#include "base/numerics.hpp"

namespace contactvi {

class Extrapolation {
 public:
  // What it knows of `count` vectors, the newest one first: the lengths of their steps, and the divided differences of
  // Newton's polynomial, of which column k is that of the first k + 1 vectors.
  struct History {
    int count = 0, degree = 0;
    VecX lengths;
    MatX differences;
  };

  bool empty() const { return known_.count == 0; }
  void clear() { known_.count = known_.degree = 0; }
  // Adds the vector x of a step of length h > 0 that follows the one of the last call.
  void push(const VecX& x, double h);
  // The vector in the middle of the next step, of length h; not to be called while empty.
  void predict(double h, VecX& x) const;

  History history() const;
  void recall(const History& history);

 private:
  static constexpr int kMost = 6;  // vectors kept
  // Vectors that lie closer together than this part of their distance to what is predicted are used as one: after steps
  // that were cut short the polynomial through them would multiply what they are off by.
  static constexpr double kApart = 0.1;

  // The times of the vectors kept, from the middle of the next step of length h on [steps backwards, negative].
  void times(double h, double* t) const;

  History known_;             // arrays of kMost entries, of which `count` are used
  VecX off_, newer_, older_;  // workspace of push
};

}  // namespace contactvi
