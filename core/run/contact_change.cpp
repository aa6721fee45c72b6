#include "run/contact_change.hpp"

#include <algorithm>
#include <cmath>

#include "base/root.hpp"

namespace contactvi {

namespace {
constexpr double kAlpha = 1e-13;  // of a step: accuracy to which changes of contact are located
constexpr double kSmallForce = 1e-12, kSmallSlip = 1e-11;  // of the forces, of the speeds: accurate enough for a root
// Transitions to stick located per interval and pair or joint that may slip; the error of the others is O(h^2). The
// points of a pair slip and stick together, or by turns within what rounding decides.
constexpr int kLocatedSticks = 3;
constexpr int kMaxEvaluations = 60;      // partial steps to locate one change
constexpr double kSameInstant = 1e-6;    // of a step: slips that end closer together end at one instant
constexpr double kForceRounding = 1e-9;  // of the largest force: contact forces below it are rounding
}  // namespace

bool ContactChangeFinder::release_force(const VecX& tau, double alpha, double& value) {
  if (!step_->solve_part(*path_, alpha, run_->q, run_->p, tau) || !step_->persistent_forces(tau, forces_)) return false;
  value = forces_[releasing_];
  return true;
}

bool ContactChangeFinder::find_release(const VecX& tau, double& alpha, bool& at_start) {
  releasing_ = -1;
  at_start = false;
  if (!step_->may_release()) return true;
  if (!step_->persistent_forces(tau, forces_)) return false;
  const double largest = forces_.cwiseAbs().maxCoeff();
  Eigen::Index worst;
  if (!(forces_.minCoeff(&worst) < -kForceRounding * largest)) return true;
  const VecX at_end = forces_;
  if (!step_->persistent_forces_at(run_->q, run_->p, tau, forces_)) return false;
  const VecX before = forces_;
  double first = alpha;
  int found = -1;
  for (Eigen::Index i = 0; i < at_end.size(); ++i) {
    if (!(at_end[i] < -kForceRounding * largest)) continue;
    releasing_ = static_cast<int>(i);
    if (before[i] <= kForceRounding * largest) {
      // A contact that is released and closed again without progress stays: the step may also leave it without force.
      if (run_->control.stands_still()) {
        releasing_ = -1;
        continue;
      }
      at_start = true;
      return true;
    }
    double high_value = 0.0, root = first;
    if (first < alpha) {  // another contact is released at `first`: this one counts only if it is earlier
      if (!release_force(tau, first, high_value)) return false;
      if (high_value >= 0.0) continue;
    } else {
      high_value = at_end[i];
    }
    if (!root_by_value(
            before[i], first, high_value, kSmallForce * largest, kAlpha, kMaxEvaluations,
            [&](double x, double& f) { return release_force(tau, x, f); }, root))
      return false;
    first = root;
    found = static_cast<int>(i);
  }
  releasing_ = found;
  alpha = first;
  return step_->solve_part(*path_, alpha, run_->q, run_->p, tau);
}

// Slip speed of the contact sticking_ at alpha if its friction went on beyond the end of the slip.
bool ContactChangeFinder::remaining_slip(const VecX& tau, double alpha, double& value) {
  if (!step_->solve_part(*path_, alpha, run_->q, run_->p, tau)) return false;
  solved_ = alpha;
  value = step_->slip_left(sticking_);
  return true;
}

// The guard of a slip's contact, or its joint with friction, counted down from -1.
int ContactChangeFinder::slipping_part(int slip) const {
  const std::vector<PersistentContact>& contacts = step_->contacts();
  const int count = static_cast<int>(contacts.size()), joints = static_cast<int>(step_->friction_joints().size());
  if (slip >= count && slip < count + joints) return count - slip - 1;
  return contacts[slip < count ? slip : slip - count - joints].point.guard;
}

bool ContactChangeFinder::find_stick(const VecX& tau, double& alpha) {
  sticking_ = stuck_ = -1;
  const double small = kSmallSlip * (1.0 + step_->end_velocity().cwiseAbs().maxCoeff());
  ending_slips_.clear();
  for (int i = 0; i < step_->slips(); ++i)
    if (step_->slip_ends(i) &&
        std::count(sticks_located_.begin(), sticks_located_.end(), slipping_part(i)) < kLocatedSticks)
      ending_slips_.push_back(i);
  if (ending_slips_.empty()) return true;
  bool located = false;
  solved_ = alpha;
  for (int i : ending_slips_) {
    sticking_ = i;
    // The points of a face come to rest together: only a slip that clearly ends earlier is another one.
    const double high = located ? alpha * (1.0 - kSameInstant) : alpha;
    double high_value = step_->slip_left(i), root = high;
    if (high != solved_ && !remaining_slip(tau, high, high_value)) return false;
    if (high_value >= 0.0) continue;
    if (!root_from_before(
            step_->slip_at_start(i), high, high_value, small, kAlpha, kMaxEvaluations,
            [&](double x, double& f) { return remaining_slip(tau, x, f); }, root))
      return false;
    alpha = root;
    stuck_ = i;
    located = true;
  }
  if (located) sticks_located_.push_back(slipping_part(stuck_));
  return alpha == solved_ || step_->solve_part(*path_, alpha, run_->q, run_->p, tau);
}

}  // namespace contactvi
