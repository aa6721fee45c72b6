// Start values of the stage velocities of a step, from the polynomials of the steps before it.
#pragma once

#include <vector>

#include "step/stages.hpp"

namespace contactvi {

class StartValues {
 public:
  StartValues(int nv, const Stages& stages);

  // Remembers a step of length h that was taken; its velocities are in stages.
  void push(const Stages& stages, double h) { push(stages.v(), h); }
  void push(const double* velocities, double h);
  void forget() { count_ = alike_ = 0; }
  int count() const { return count_; }
  // All that start values depend on: the steps that were remembered, newest first.
  struct History {
    std::vector<double> velocities;  // [step][dof][stage], without padding: alike on all instruction sets
    std::vector<double> lengths;     // [s]
  };
  History history() const;
  void recall(const History& history);

  // Continues the last steps' polynomial over the next step of length h; smoothed: that of the last step without its
  // two highest modes.
  void extrapolate(double h, Stages& stages);
  void extrapolate_smoothed(double h, Stages& stages);

  // Velocity at the end of the last step by its polynomial, (nv,).
  void end(const GaussTable& table, VecRef v) const;

  // Pieces of a ramp: the start values of one step from the velocities of shorter steps that cover it.
  void clear_pieces() { pieces_ = 0; }
  void add_piece(const Stages& stages, double start, double length);
  void assemble(double h, Stages& stages);

  static constexpr int kSteps = 4;  // kept at most
  // Whether as many are kept as there may be, of one stage each and this length.
  bool is_even(double h) const;

 private:
  friend class LaneFlight;           // extrapolates for several runs
  static constexpr int kPieces = 4;  // of a ramp
  struct Piece {
    AlignedArray v;
    double start, length;
  };
  int nodes_used() const;
  AlignedArray& history(int m) { return history_[(newest_ + m) % static_cast<int>(history_.size())]; }
  const AlignedArray& history(int m) const { return history_[(newest_ + m) % static_cast<int>(history_.size())]; }
  void weigh(double h);

  int nv_, s_, S_;
  std::vector<AlignedArray> history_;  // a ring; history(m): of the step so many before the newest
  int newest_ = 0;
  double h_[kSteps] = {};
  int count_ = 0;
  int alike_ = 0;            // of how many of the newest steps the length is known to be that of the newest
  std::vector<Piece> ramp_;  // empty until first used
  int pieces_ = 0;
  // Weights of extrapolate() for the step lengths of its last call.
  std::vector<AlignedArray> weight_;
  double weight_h_[kSteps + 1] = {};
  int weight_count_ = 0;
  bool weights_alike_ = false;  // all these lengths are the same, and as many as there may be
  AlignedArray smoothed_;
};

}  // namespace contactvi
