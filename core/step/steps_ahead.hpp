// Steps of one stage that a run will make if nothing happens in them, solved in advance.
//
// They stand until the run takes another way: its next step starts elsewhere, is of another length or has forces that
// were not foreseen. So what is foreseen decides no digit of the run.
#pragma once

#include <cstring>

#include "base/aligned_array.hpp"
#include "base/numerics.hpp"

namespace contactvi {

class StepsAhead {
 public:
  static constexpr int kMost = 16;  // steps at a time: what a run has solved in vain at its end or at an event
  // What is kept of a step, each of the size of q: at its end, and at its stage. kRate: of trees with spherical joints;
  // else it is kV.
  enum Part { kQ, kP, kCarryQ, kCarryP, kV, kX, kMomentum, kForce, kCorrection, kRate, kParts };

  StepsAhead(int nq, int nv, bool balls) : nq_(nq), nv_(nv), kept_(balls ? kParts : kRate) {}

  // How many steps are to be solved next: twice as many as the last ones if all of those were made.
  int wanted() const { return wanted_; }
  // Whether to ask for some now. Where none could be solved, the next kMost steps are made without asking: they are
  // likely to need more than their first factor, too.
  bool is_worth_asking() const { return pause_ == 0; }
  void pause() { pause_ = kMost; }
  void count_step_alone() {
    if (pause_ > 0) --pause_;
  }
  // How many are solved now, from this state; their parts have to be written.
  void begin(const VecX& q0, const VecX& p0, double h, double tol) {
    if (parts_.size() == 0) parts_ = AlignedArray(static_cast<std::size_t>(kMost * kept_) * nq_);
    q0_ = q0;
    p0_ = p0;
    h_ = h;
    tol_ = tol;
    at_ = count_ = 0;
  }
  double* part(int step, Part part) { return parts_.data() + static_cast<std::size_t>(step * kept_ + part) * nq_; }
  // In all parts of a step.
  int numbers() const { return kept_ * nq_; }
  void add(int iterations, double error) {
    iterations_[count_] = iterations;
    errors_[count_] = error;
    ++count_;
  }

  bool any() const { return at_ < count_; }
  int left() const { return count_ - at_; }
  // Whether the next one is the step of length h from this state.
  bool is(const VecCRef& q0, const VecCRef& p0, double h, double tol) const {
    const auto same = [](const double* a, const double* b, Eigen::Index size) {
      return std::memcmp(a, b, sizeof(double) * static_cast<std::size_t>(size)) == 0;
    };
    return any() && h == h_ && tol == tol_ && same(q0.data(), q0_.data(), nq_) && same(p0.data(), p0_.data(), nv_);
  }
  // Where the next one begins.
  const VecX& q0() const { return q0_; }
  const VecX& p0() const { return p0_; }
  double length() const { return h_; }
  // Of the step that comes so many steps after the next one.
  const double* next(int after, Part which) const {
    const int part = which < kept_ ? which : static_cast<int>(kV);
    return parts_.data() + static_cast<std::size_t>((at_ + after) * kept_ + part) * nq_;
  }
  int iterations(int after) const { return iterations_[at_ + after]; }
  double error(int after) const { return errors_[at_ + after]; }
  // The next ones have been made.
  void advance(int steps) {
    std::memcpy(q0_.data(), next(steps - 1, kQ), sizeof(double) * static_cast<std::size_t>(nq_));
    std::memcpy(p0_.data(), next(steps - 1, kP), sizeof(double) * static_cast<std::size_t>(nv_));
    at_ += steps;
    if (at_ == count_) wanted_ = wanted_ < kMost ? 2 * wanted_ : kMost;
  }
  // The run goes another way.
  void drop() {
    if (any()) wanted_ = 1;
    at_ = count_ = 0;
  }

 private:
  int nq_, nv_, kept_;  // kept_: parts
  AlignedArray parts_{0};
  VecX q0_, p0_;
  double h_ = 0.0, tol_ = 0.0;
  int iterations_[kMost] = {};
  double errors_[kMost] = {};
  int at_ = 0, count_ = 0, wanted_ = 1, pause_ = 0;
};

}  // namespace contactvi
