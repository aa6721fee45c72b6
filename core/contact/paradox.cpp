// ContactStep: Painleve's paradox, in which rigid bodies with friction have no answer without an impulse.
#include <cmath>

#include "contact/contact_step.hpp"
#include "step/energy.hpp"

namespace contactvi {

namespace {
// Of what forces and the turning of bodies change the velocities by: what persistent contacts change is of that size
// (Gauss's principle, see energy_error), as long as friction leaves it one answer.
constexpr double kJump = 10.0;
constexpr double kStopped = 0.5;  // of a slip: jumps end or reverse slips, what is left of others is more
constexpr double kSlow = 1e-6;    // of 1 m/s and the velocities: slips below it may end in no time
}  // namespace

// The slip of contact i at the start of the step, along its tangents.
Eigen::Vector2d ContactStep::slip_before(std::size_t i) const {
  return node0_.W.middleCols(row_[i] + 1, 2).transpose() * v_start_ + node0_.rate.segment<2>(row_[i] + 1);
}

// A (ContactOutcome::paradox) of the contacts that slip at the start of the step; only of pairs with one point, because
// several points share their load, and without friction against spinning or rolling.
void ContactStep::find_paradox() {
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    const int r = row_[i];
    paradox_[i] = INFINITY;
    bool single = contacts_[i].rows() == 3 && !contacts_[i].sticks;
    for (std::size_t j = 0; j < contacts_.size() && single; ++j)
      single = j == i || contacts_[j].point.guard != contacts_[i].point.guard;
    if (!single) continue;
    const Eigen::Vector2d slip = slip_before(i);
    const double speed = slip.norm();
    if (speed > 0.0)
      paradox_[i] = contact_matrix(r, r) -
                    contacts_[i].mu * (contact_matrix(r, r + 1) * slip[0] + contact_matrix(r, r + 2) * slip[1]) / speed;
  }
}

// The momentum p1 - p0 without what contacts and constraints do, as the square of a velocity times mass [J].
double ContactStep::free_change(const VecCRef& p0, const VecCRef& p1) {
  change_ = p1 - p0 - node0_.W * lambda_ - node1_.W * lambda_end_;
  dv_ = change_;
  integrator_.solve_mass(dv_);
  return change_.dot(dv_);
}

// Which impulses of the step just solved do not go to zero with its length: they end slips by far more than forces can,
// and their contacts are in the paradox. What prescribed motions ask for is not bounded so.
void ContactStep::find_jumps() {
  const double slow = kSlow * (1.0 + v_start_.cwiseAbs().maxCoeff());
  bool any = false;
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    ContactOutcome& out = outcomes_[i];
    out.jumps = false;
    if (contacts_[i].rows() != 3 || contacts_[i].sticks) continue;
    const Eigen::Vector2d before = slip_before(i), after = w_end_.segment<2>(row_[i] + 1);
    out.jumps = before.norm() > slow && before.dot(after) < kStopped * before.squaredNorm() &&
                lambda_[row_[i]] + lambda_end_[row_[i]] > 0.0;
    any |= out.jumps;
  }
  if (!any) return;
  const bool driven = bilateral_ > 0 && node0_.rate.head(bilateral_).cwiseAbs().maxCoeff() > 0.0;
  const double turn = largest_turn(scene_->tree, v_, h_), turned = turn * turn * p1_.dot(v1_);
  const double jump = (p1_ - p_given_).dot(v1_ - v_start_);
  const bool jumps = !driven && jump > kJump * kJump * (free_change(p_given_, p1_) + turned);
  for (std::size_t i = 0; i < contacts_.size(); ++i) {
    ContactOutcome& out = outcomes_[i];
    out.jumps &= jumps;
    if (!out.jumps) continue;
    // It may come to be the paradox in the step, in which bodies turn by that angle.
    out.paradox = paradox_among_others(i);
    out.jumps = out.paradox <= turn * contact_matrix(row_[i], row_[i]);
  }
}

// A of contact i with what the other contacts that carry impulses answer: the Schur complement of their rows, in which
// those that slip at the start have friction against that.
double ContactStep::paradox_among_others(std::size_t i) const {
  std::vector<int> rows;
  std::vector<VecX> columns;
  Eigen::Index place = 0;
  for (std::size_t j = 0; j < contacts_.size(); ++j) {
    const int r = row_[j];
    if (lambda_[r] + lambda_end_[r] <= 0.0) continue;
    if (j == i) place = static_cast<Eigen::Index>(rows.size());
    const bool slips = contacts_[j].mu > 0.0 && !contacts_[j].sticks;
    const Eigen::Vector2d slip = slips ? slip_before(j).stableNormalized() : Eigen::Vector2d::Zero();
    for (int k = 0; k < (slips ? 1 : contacts_[j].rows()); ++k) {
      columns.emplace_back(VecX::Zero(rows_));
      columns.back()[r + k] = 1.0;
      if (slips) columns.back().segment<2>(r + 1) = -contacts_[j].mu * slip;
      rows.push_back(r + k);
    }
  }
  const Eigen::Index n = static_cast<Eigen::Index>(rows.size());
  MatX A = MatX::Zero(n, n);
  for (Eigen::Index a = 0; a < n; ++a)
    for (Eigen::Index c = 0; c < n; ++c)
      for (int k = bilateral_; k < rows_; ++k)
        if (columns[c][k] != 0.0) A(a, c) += contact_matrix(rows[a], k) * columns[c][k];
  const VecX answer = A.completeOrthogonalDecomposition().solve(VecX::Unit(n, place));
  return 1.0 / answer[place];
}

}  // namespace contactvi
