#include "run/stepped_world.hpp"

#include <chrono>
#include <cmath>

namespace contactvi {

namespace {

// Forces beyond are left to the checks of the Python API, which refuse those that overflow in products; none of a real
// model is that large [N; N m].
constexpr double kOrdinary = 1e30;

// True while a step is under way, also if it ends by an exception.
class Under {
 public:
  explicit Under(bool& flag) : flag_(flag) { flag_ = true; }
  ~Under() { flag_ = false; }
  Under(const Under&) = delete;
  Under& operator=(const Under&) = delete;

 private:
  bool& flag_;
};

}  // namespace

bool SteppedWorld::set_step_inputs(const double* tau, const double* target) {
  const int nv = scene().tree.nv;
  if (tau != nullptr) {
    const Eigen::Map<const Eigen::RowVectorXd> given(tau, nv);
    if (!(given.array().abs() <= kOrdinary).all()) return false;  // NaN is not <= anything
  }
  step_tau_.resize(tau == nullptr ? 0 : 1, tau == nullptr ? 0 : nv);
  if (tau != nullptr) step_tau_.row(0) = Eigen::Map<const Eigen::RowVectorXd>(tau, nv);
  step_target_.resize(target == nullptr ? 0 : 1, target == nullptr ? 0 : 2 * nv);
  if (target != nullptr) step_target_.row(0) = Eigen::Map<const Eigen::RowVectorXd>(target, 2 * nv);
  return true;
}

SteppedWorld::Outcome SteppedWorld::step_once(const Progress& progress) {
  using Clock = std::chrono::steady_clock;
  const Under under(stepping_);
  const Clock::time_point start = Clock::now();
  if (limit_ == 0) record_.recording.restart();
  before_.time = time();
  before_.q = q();
  before_.p = p();
  before_.known = true;
  record_.forced |= step_tau_.size() > 0 && (step_tau_.array() != 0.0).any();
  record_.status = advance(1, step_tau_, step_target_, 1, progress, record_.recording);
  record_.seconds += std::chrono::duration<double>(Clock::now() - start).count();
  const bool full = limit_ > 0 && record_.recording.t.size() >= limit_;
  return record_.status.ok() && !full ? Outcome::kOrdinary : Outcome::kNotable;
}

long SteppedWorld::step_while_ordinary(long most, const Progress& progress) {
  for (long made = 0; made < most; ++made)
    if (step_once(progress) != Outcome::kOrdinary) return made;
  return most;
}

void SteppedWorld::forget_steps() {
  record_ = Record();
  before_.known = false;
}

}  // namespace contactvi
