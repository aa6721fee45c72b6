#include "sensitivity/held_node.hpp"

#include <cmath>

namespace contactvi {

HeldNode::HeldNode(const Scene& scene)
    : chart_(scene.tree),
      constraints_(scene.tree),
      twists_(scene.tree),
      scene_(&scene),
      bend_(scene.tree.nv, scene.tree.nv) {}

bool HeldNode::take(const VecX& q, double t, const VecX& X, const Acting& acting, const HeldStepRecord& step,
                    PersistentRows& phase, int number) {
  const Eigen::Index n = bend_.rows(), fixed = constraints_.rows(), rows = fixed + phase.count(),
                     slides = static_cast<Eigen::Index>(phase.slides().size());
  q_ = q;
  X_ = X;
  chart_.take(X);
  constraints_.take(q, t);
  twists_.place(q);
  VecX phi(phase.count()), rate(phase.count()), drift(2 * slides), pull(phase.count());
  MatX W(n, phase.count()), T(n, 2 * slides);
  phase.place(number, q, t, {phi, W, T, rate, drift, pull});
  rates_.setZero(rows);
  rates_.head(fixed) = constraints_.rates();
  // Beside its normal a sliding contact has two columns that are no rows: its tangents.
  columns_.resize(n, rows + 2 * slides);
  columns_.leftCols(fixed) = constraints_.gradients();
  column_of_.clear();
  for (int r = 0; r < fixed; ++r) column_of_.push_back(r);
  int column = static_cast<int>(fixed), row = 0;
  const auto add_row = [&] {
    columns_.col(column) = W.col(row++);
    column_of_.push_back(column++);
  };
  first_.clear();
  count_.clear();
  for (std::size_t i = 0; i < step.contacts.size(); ++i) {
    first_.push_back(column);
    count_.push_back(step.contacts[i].rows());
    add_row();
    if (const int j = phase.slide(i); j >= 0) {
      columns_.middleCols<2>(column) = T.middleCols<2>(2 * j);
      column += 2;
    } else if (count_.back() == 3) {
      add_row();
      add_row();
    }
  }
  while (row < phase.count()) add_row();
  if (!take_contacts(step.contacts, phase, number, t)) return false;
  take_pulls(step.contacts, phase, number, t);
  lambda_ = acting.lambda;
  weight_ = acting.weight;
  combine(acting, phase);
  set_displacements(step.contacts);
  load_ = columns_ * pulls_;
  if (phase.load() != nullptr) load_ += *phase.load();
  force_ = columns_ * (weights_ - weight_ * pulls_) + weight_ * load_;
  for (Eigen::Index k = 0; k < n; ++k) {
    change(VecX::Unit(n, k));
    bend_.col(k) = change_ * weights_;
  }
  return true;
}

bool HeldNode::take_contacts(const std::vector<PersistentContact>& contacts, const PersistentRows& phase, int number,
                             double t) {
  while (contacts_.size() < contacts.size()) contacts_.emplace_back(*scene_);
  t1_.clear();
  surfaces_.resize(contacts.size());
  own_.setZero(columns_.cols());
  own_rates_ = own_;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const PersistentRows::Site& site = phase.site(number, i);
    const ContactPoint& point = contacts[i].point;
    contacts_[i].prefer(i < preferred_.size() ? preferred_[i] : std::array<int, 2>{-1, -1});
    if (!contacts_[i].take(q_, point.guard, site.contact, &point)) {
      why_ = contacts_[i].why();
      refused_ = point.guard;
      return false;
    }
    t1_.push_back(site.frame.t1);
    surfaces_[i] = SurfaceVelocityTangent();
    if (count_[i] == 1) continue;
    surfaces_[i].take(*scene_, point.guard, contacts_[i], site.frame.t1, t);
    own_.segment<2>(first_[i] + 1) = surfaces_[i].velocity();
    own_rates_.segment<2>(first_[i] + 1) = surfaces_[i].rate();
  }
  return true;
}

void HeldNode::take_pulls(const std::vector<PersistentContact>& contacts, const PersistentRows& phase, int number,
                          double t) {
  pulls_.setZero(columns_.cols());
  pull_rates_ = pulls_;
  if (!phase.any_adheres()) return;
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const double pull = phase.site(number, i).pull;
    if (pull == 0.0) continue;
    pulls_[first_[i]] = -pull;
    pull_rates_[first_[i]] = -adhesion_rate(*scene_, contacts[i], t);
  }
}

void HeldNode::combine(const Acting& acting, const PersistentRows& phase) {
  const VecX &lambda = acting.lambda, &angles = acting.angles;
  const auto rows = static_cast<Eigen::Index>(column_of_.size()), slides = angles.size(), all = columns_.cols();
  const bool varies = acting.slopes.size() > 0;
  watch_.setZero(all, rows + (varies ? 2 : 1) * slides);
  lead_.setZero(all, slides);
  for (Eigen::Index r = 0; r < rows; ++r) watch_(column_of_[static_cast<std::size_t>(r)], r) = 1.0;
  give_ = watch_;
  MatX by_friction = MatX::Zero(all, slides);
  for (std::size_t i = 0; i < first_.size(); ++i) {
    const int j = phase.slide(i), normal = first_[i];
    if (j < 0) continue;
    const Eigen::Index r = constraints_.rows() + phase.row(i);
    const double mu = acting.mu[j];
    const Eigen::Vector2d d(std::cos(angles[j]), std::sin(angles[j])), across(-d[1], d[0]);
    lead_.block<2, 1>(normal + 1, j) = d;
    watch_.block<2, 1>(normal + 1, rows + j) = across;
    give_.block<2, 1>(normal + 1, r) = -mu * d;
    give_.block<2, 1>(normal + 1, rows + j) = -mu * lambda[r] * across;
    by_friction.block<2, 1>(normal + 1, j) = -lambda[r] * d;
    if (!varies) continue;
    watch_.block<2, 1>(normal + 1, rows + slides + j) = -acting.slopes[j] * d;
    give_.col(rows + slides + j) = by_friction.col(j);
  }
  weights_ = give_.leftCols(rows) * lambda + weight_ * pulls_;
  friction_loads_.setZero(all);
  friction_rates_.setZero(all);
  for (std::size_t i = 0; i < first_.size() && acting.by_normal.size() > 0; ++i) {
    const int j = phase.slide(i), normal = first_[i];
    if (j < 0) continue;
    const Eigen::Index r = constraints_.rows() + phase.row(i);
    const double force = lambda[r] / weight_;
    const Eigen::Vector2d d = lead_.block<2, 1>(normal + 1, j);
    give_.block<2, 1>(normal + 1, r) -= acting.by_normal[j] * force * d;
    friction_loads_.segment<2>(normal + 1) = acting.by_normal[j] * force * force * d;
    friction_rates_.segment<2>(normal + 1) = -acting.by_time[j] * lambda[r] * d;
  }
  gradients_ = columns_ * watch_.leftCols(rows);
  watched_ = columns_ * watch_;
  along_ = columns_ * lead_;
  given_ = columns_ * give_;
  by_friction_ = columns_ * by_friction;
}

// The displacement of a material point counts along tangents that are fixed to its plane.
void HeldNode::set_displacements(const std::vector<PersistentContact>& contacts) {
  displacements_ = gradients_.transpose();
  Eigen::Index r = constraints_.rows();
  for (const PersistentContact& c : contacts) {
    if (c.keeps_place()) displacements_.middleRows(r + 1, 2) = tangents(c) * place_change(c.point);
    r += c.slides() ? 1 : c.rows();
  }
}

Eigen::Matrix<double, 2, 3> HeldNode::tangents(const PersistentContact& contact) {
  const double sign = contact.point.on_b ? 1.0 : -1.0;
  Eigen::Matrix<double, 2, 3> found;
  found.row(0) = sign * contact.tangent;
  found.row(1) = contact.point.normal_B.cross(contact.tangent);
  return found;
}

MatX HeldNode::place_change(const ContactPoint& point) {
  const Eigen::Index n = bend_.rows();
  const Vec3 x = pose_of(point.point_body, twists_.placements()).point(point.center_B);
  const Mat3 back = pose_of(point.plane_body, twists_.placements()).R.transpose();
  MatX found(3, n);
  for (Eigen::Index k = 0; k < n; ++k) {
    twists_.move(VecX::Unit(n, k));
    found.col(k) = back * (twists_.velocity(point.point_body, x) - twists_.velocity(point.plane_body, x));
  }
  return found;
}

MatX HeldNode::frame_turns(const std::vector<PersistentContact>& contacts, const PersistentRows& phase) {
  const Eigen::Index n = bend_.rows();
  MatX found = MatX::Zero(lead_.cols(), n);
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const int j = phase.slide(i);
    if (j < 0 || contacts[i].point.kind != PointKind::kVertex || contacts_[i].has_axis()) continue;
    for (Eigen::Index k = 0; k < n; ++k) {
      twists_.move(VecX::Unit(n, k));
      found(j, k) = twists_.turn(contacts[i].point.plane_body).dot(contacts_[i].contact().normal);
    }
  }
  return found;
}

// Sets change_ to that of the columns along dq. How tangents turn about the normal changes no motion where all three
// components of an impulse are free, or the direction of the slip is.
void HeldNode::change(const VecX& dq) {
  change_.setZero(columns_.rows(), columns_.cols());
  constraints_.change(dq, 0.0, change_.leftCols(constraints_.rows()));
  own_change_.setZero(columns_.cols());
  for (std::size_t i = 0; i < first_.size(); ++i) {
    contacts_[i].change(dq, t1_[i], change_.middleCols(first_[i], count_[i]));
    if (surfaces_[i].moves()) own_change_.segment<2>(first_[i] + 1) = surfaces_[i].change(contacts_[i]);
  }
}

void HeldNode::change_speeds(const VecX& v, MatX& watched, MatX& along) {
  watched.resize(watch_.cols(), v.size());
  along.resize(lead_.cols(), v.size());
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    change(VecX::Unit(v.size(), k));
    const VecX speeds = change_.transpose() * v + own_change_;
    watched.col(k) = watch_.transpose() * speeds;
    along.col(k) = lead_.transpose() * speeds;
  }
  watched.topRows(constraints_.rows()) += constraints_.gradient_rates().transpose();
}

VecX HeldNode::speed_rates(const VecX& v) const {
  VecX found = watch_.transpose() * own_rates_;
  found.head(constraints_.rows()) += constraints_.speed_rate(v);
  return found;
}

VecX HeldNode::force_rate() const {
  return constraints_.gradient_rates() * lambda_.head(constraints_.rows()) +
         columns_ * (weight_ * pull_rates_ + friction_rates_);
}

}  // namespace contactvi
