#include "contact/held_impulses.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {
constexpr double kAdmitted = 1e-9;  // of the largest impulse: by how much others may leave their cones
}  // namespace

void HeldImpulses::take(const std::vector<PersistentContact>& contacts, const PersistentRows& rows,
                        const StageConstraints& step) {
  contacts_ = &contacts;
  rows_ = &rows;
  rounding_ = (step.table().s + 1) * step.impulse_rounding();
  impulses_.assign(contacts.size(), Impulse());
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    Impulse& sum = impulses_[i];
    const int r = rows.row(i), j = rows.slide(i);
    for (int k = 0; k <= step.table().s; ++k) {
      Vec3 impulse(step.phase_impulses()(r, k), 0.0, 0.0);
      if (j >= 0) {
        const double angle = step.slip_angles()(j, k), friction = step.slide_friction()(j, k) * impulse[0];
        impulse.tail<2>() = -friction * Eigen::Vector2d(std::cos(angle), std::sin(angle));
        sum.work -= friction * step.slips()(j, k);
        if (rows.friction_by_state(i)) sum.least = std::min(sum.least, impulse[0]);
      } else if (contacts[i].mu > 0.0) {
        impulse.tail<2>() = step.phase_impulses().block(r + 1, k, 2, 1);
        if (rows.friction_by_state(i)) {
          const double normal = impulse[0] / step.impulse_of(k, 1.0);
          sum.bound += rows.friction(i, 0.0, normal, step.time_of(k), contacts[i].mu, false).mu * impulse[0];
        }
      }
      const PersistentRows::Site& site = rows.site(k, i);
      const Vec3 normal = (impulse[0] - step.impulse_of(k, site.pull)) * site.contact.normal;
      sum.local += impulse;
      sum.normal += normal;
      sum.world += normal + site.frame.force(impulse.tail<2>());
    }
  }
  if (step.shares_load()) share_friction();
}

// Of contacts of one pair that stick and share a load, each has the part of the friction that it has of the load.
void HeldImpulses::share_friction() {
  const std::vector<PersistentContact>& contacts = *contacts_;
  std::vector<std::size_t> of_pair;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const int guard = contacts[i].point.guard;
    of_pair.clear();
    for (std::size_t k = 0; k < contacts.size(); ++k)
      if (contacts[k].point.guard == guard) of_pair.push_back(k);
    if (of_pair.front() != i) continue;  // seen before
    Vec3 local = Vec3::Zero(), world = Vec3::Zero();
    double most = 0.0;
    bool shares = true;
    for (const std::size_t k : of_pair) {
      shares = shares && contacts[k].mu > 0.0 && contacts[k].sticks && impulses_[k].local[0] >= 0.0;
      local += impulses_[k].local;
      most += bound(k);
      world += impulses_[k].world - impulses_[k].normal;
    }
    if (!shares || !(local[0] > 0.0)) continue;
    for (const std::size_t k : of_pair) {
      const double part = rows_->friction_by_state(k) ? bound(k) / most : impulses_[k].local[0] / local[0];
      impulses_[k].local.tail<2>() = part * local.tail<2>();
      impulses_[k].world = impulses_[k].normal + part * world;
    }
  }
}

// Of the friction of contact i that sticks.
double HeldImpulses::bound(std::size_t i) const {
  return rows_->friction_by_state(i) ? impulses_[i].bound : (*contacts_)[i].mu * impulses_[i].local[0];
}

double HeldImpulses::slack() const {
  double largest = 0.0;
  for (const Impulse& impulse : impulses_) largest = std::max(largest, impulse.local.norm());
  return std::max(kAdmitted * largest, rounding_);
}

bool HeldImpulses::are_admissible() const {
  const double slack = this->slack();
  for (std::size_t i = 0; i < impulses_.size(); ++i) {
    const Vec3& impulse = impulses_[i].local;
    if (impulse[0] < -slack) return false;
    // What slides is on its cone.
    if ((*contacts_)[i].sticks && impulse.tail<2>().norm() > std::max(0.0, bound(i)) + slack) return false;
  }
  return !some_node_pulls();
}

bool HeldImpulses::some_node_pulls() const {
  const double slack = this->slack();
  return std::any_of(impulses_.begin(), impulses_.end(), [slack](const Impulse& i) { return i.least < -slack; });
}

double HeldImpulses::friction_work() const {
  double work = 0.0;
  for (const Impulse& impulse : impulses_) work += impulse.work;
  return work;
}

Vec3 HeldImpulses::mean_normal(std::size_t i, const Vec3& normal) const {
  const Impulse& impulse = impulses_[i];
  const double size = impulse.world.norm();
  if (!(size > 0.0) || !(impulse.normal.dot(normal) > 0.0)) return normal;
  const Vec3 n = impulse.normal.normalized(), all = impulse.world / size;
  const Vec3 across = n - n.dot(all) * all;
  const double angle = std::atan((*contacts_)[i].mu), turned = std::atan2(across.norm(), n.dot(all));
  if (turned <= angle || across.norm() == 0.0) return n;
  return std::cos(angle) * all + std::sin(angle) * across.normalized();
}

}  // namespace contactvi
