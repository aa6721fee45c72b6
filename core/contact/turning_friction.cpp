// ContactStep: friction against spinning and rolling, the rows of a contact beside (n, t1, t2).
#include <algorithm>
#include <cmath>

#include "base/tolerances.hpp"
#include "contact/contact_step.hpp"

namespace contactvi {

// What contact i did in the step, from its position impulses: whether it slipped with the spin as a third component of
// the slip, and whether it rolled. Its velocity impulses keep these directions.
void ContactStep::classify_turning(std::size_t i, double speed) {
  const PersistentContact& persistent = contacts_[i];
  ContactOutcome& out = outcomes_[i];
  ConeContact& cone = cones_[friction_rows_ + i];
  const int r = row_[i], rows = persistent.rows(), count = persistent.friction_rows();
  const VecX s = y_.segment(r, rows) + G_.middleRows(r, rows) * change_;
  const Vec3 t1 = node1_.t1[i], t2 = node1_.at[i].normal.cross(t1);
  const auto moves = [&](int first, int size, double bound) {
    return has_slipped(r + first, s.segment(first, size), bound, speed);
  };
  out.turning_slip.setZero();
  out.slipped = moves(1, count, persistent.mu * lambda_[r]);
  if (out.slipped) {
    const VecX d = s.segment(1, count).normalized();
    out.slip = s.segment<2>(1);
    if (cone.spins) out.turning_slip[0] = s[3];
    cone.d = d.head<2>();
    cone.d_spin = cone.spins ? d[2] : 0.0;
    out.turned = persistent.slip.dot(s[1] * t1 + s[2] * t2) + (cone.spins ? persistent.spin * s[3] : 0.0) < 0.0;
  }
  out.rolled = out.roll_turned = false;
  out.roll_reversed = 0.0;
  if (!(cone.rolling > 0.0)) return;
  const int roll = persistent.rolling_row();
  out.rolled = moves(roll, 2, lambda_[r]);
  if (!out.rolled) return;
  out.turning_slip.tail<2>() = s.segment<2>(roll);
  cone.d_rolling = s.segment<2>(roll).normalized();
  out.roll_turned = persistent.roll.dot(s[roll] * t1 + s[roll + 1] * t2) < 0.0;
}

// The result of the step for contact i in its rows of spinning and rolling, of which the work of friction is a part.
void ContactStep::set_turning_outcome(std::size_t i, double speed) {
  const PersistentContact& persistent = contacts_[i];
  ContactOutcome& out = outcomes_[i];
  const int r = row_[i], turning = persistent.turning_rows(), roll = r + persistent.rolling_row();
  out.position_turning.setZero();
  out.velocity_turning.setZero();
  out.position_turning.head(turning) = lambda_.segment(r + 3, turning);
  out.velocity_turning.head(turning) = lambda_end_.segment(r + 3, turning);
  const auto work = [&](int row) {
    const double before = node0_.W.col(row).dot(v_start_) + node0_.rate[row],
                 during = 0.5 * ((node0_.W.col(row) + node1_.W.col(row)).dot(v_) + node0_.rate[row] + node1_.rate[row]);
    return 0.5 * (lambda_[row] * (before + during) + lambda_end_[row] * (during + w_end_[row]));
  };
  out.spin = persistent.spinning > 0.0 ? w_end_[r + 3] : 0.0;
  out.slips = std::hypot(out.slip_W.norm(), out.spin) > kStill * speed;
  out.friction_work = 0.0;
  if (!persistent.sticks || out.slipped || out.slips)
    for (int k = 1; k <= persistent.friction_rows(); ++k) out.friction_work += work(r + k);
  out.roll_W.setZero();
  out.rolls = false;
  if (!(persistent.rolling > 0.0)) return;
  const Vec3 rolling = w_end_[roll] * out.t1 + w_end_[roll + 1] * out.t2;
  out.rolls = rolling.norm() > kStill * speed;
  if (out.rolls) out.roll_W = rolling;
  if (!persistent.roll.isZero(0.0) || out.rolled || out.rolls) out.friction_work += work(roll) + work(roll + 1);
}

bool ContactStep::roll_ends(std::size_t i) const {
  const PersistentContact& persistent = contacts_[i];
  const ContactOutcome& out = outcomes_[i];
  const bool turns = out.rolls && (out.roll_turned || out.roll_W.dot(persistent.roll) < 0.0);
  return !persistent.roll.isZero(0.0) && out.active && (!out.rolls || turns);
}

}  // namespace contactvi
