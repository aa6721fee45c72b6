// The active set of one contact problem of a dense step, and the linear equations that its impulses obey along a
// direction: dw is the change of the rows' speeds, dw = base + rows dlambda.
//
//   constraints  dw = 0
//   normal     open: dlambda = 0;   closed: dw_n = 0;   at its bound: dlambda_n = dlow
//   friction   sticks: dw_t = 0;   slips: d(lambda_t + mu lambda_n w_t / |w_t|) = 0;   given: dlambda_t is known
//   joints     stick: dw = 0;   at the bound of their friction, or given: dlambda is known
#pragma once

#include <vector>

#include "contact/dense_step_record.hpp"
#include "sensitivity/shared_load.hpp"

namespace contactvi {

class DenseLaws {
 public:
  enum class Normal { kOpen, kClosed, kBound };
  enum class Friction { kNone, kStick, kSlip, kGiven };
  struct Contact {
    Normal normal;
    Friction friction;
    int row;
    double mu;
    Eigen::Vector2d along;  // of the slip
    double speed;           // of the slip [m/s]
  };

  // What impulses [N s] and speeds [m/s] are compared with: the largest of the step.
  struct Scale {
    double impulse, speed;
  };

  // The whole law at its solution: impulses, speeds of the rows, their matrix; low: bounds of the normal impulses, box:
  // of those of joints.
  void take_law(const DenseStepRecord& step, const VecX& lambda, const VecX& w, const MatX& rows, const VecX& low,
                const VecX& box, const Scale& scale);
  // The law of the gaps, with friction that is given: the gaps decide which contacts are closed.
  void take_gaps(const DenseStepRecord& step, const VecX& lambda, const std::vector<double>& gaps, const MatX& rows);

  // The changes of the impulses: base as above; known: of impulses that are given, (rows,), of the lower bounds in the
  // rows of normals and of the bounds of joint friction in theirs; mu: of the coefficients, or empty. size: of the
  // terms of base. False where the equations contradict each other.
  bool solve(const VecX& base, const VecX& known, const VecX& mu, const VecX& size, VecX& dlambda) const;
  // The transpose: from the gradient in dlambda to those in base, known and mu, which it sets.
  void solve_transposed(const VecX& l, VecX& lbase, VecX& lknown, VecX& lmu) const;
  // The solution with known impulses alone.
  VecX from_known(const VecX& known) const;

  const MatX& free() const { return system_.free(); }
  const std::vector<Contact>& contacts() const { return contacts_; }
  // Distance from the nearest change of the active set, of the largest impulse or the speeds.
  double margin() const { return margin_; }
  // Of what does not satisfy the law, of the same.
  double error() const { return error_; }

 private:
  void begin(const DenseStepRecord& step, const VecX& lambda);
  Eigen::Index row_of(std::size_t joint) const { return constraints_ + static_cast<Eigen::Index>(joint); }
  void set_system(const MatX& rows);
  Eigen::Matrix2d turn(const Contact& c) const;

  int constraints_ = 0;  // rows of constraints, which come first
  std::vector<Contact> contacts_;
  std::vector<Friction> joints_;
  std::vector<double> sign_;  // of joints at their bounds
  VecX lambda_;
  SharedLoad system_;
  double margin_ = 1.0, error_ = 0.0;
};

}  // namespace contactvi
