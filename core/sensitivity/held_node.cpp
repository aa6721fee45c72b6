#include "sensitivity/held_node.hpp"

namespace contactvi {

HeldNode::HeldNode(const Scene& scene)
    : chart_(scene.tree),
      constraints_(scene.tree),
      twists_(scene.tree),
      scene_(&scene),
      bend_(scene.tree.nv, scene.tree.nv) {}

bool HeldNode::take(const VecX& q, double t, const VecX& X, const VecX& lambda,
                    const std::vector<PersistentContact>& contacts, PersistentRows& phase, int number) {
  const Eigen::Index n = bend_.rows(), fixed = constraints_.rows(), held = phase.count();
  q_ = q;
  X_ = X;
  chart_.take(X);
  constraints_.take(q, t);
  twists_.place(q);
  gradients_.resize(n, fixed + held);
  gradients_.leftCols(fixed) = constraints_.gradients();
  VecX phi(held);
  MatX none(n, 0);
  phase.place(number, q, phi, gradients_.rightCols(held), none);
  rates_.setZero(fixed + held);
  rates_.head(fixed) = constraints_.rates();
  accelerations_.setZero(fixed + held);
  accelerations_.head(fixed) = constraints_.accelerations();
  while (contacts_.size() < contacts.size()) contacts_.emplace_back(*scene_);
  first_.clear();
  count_.clear();
  t1_.clear();
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    const PersistentRows::Site& site = phase.site(number, i);
    const ContactPoint& point = contacts[i].point;
    if (!contacts_[i].take(q, point.guard, site.contact, &point)) {
      why_ = contacts_[i].why();
      refused_ = point.guard;
      return false;
    }
    first_.push_back(static_cast<int>(fixed) + phase.row(i));
    count_.push_back(contacts[i].rows());
    t1_.push_back(site.t1);
  }
  set_displacements(contacts);
  force_ = gradients_ * lambda;
  for (Eigen::Index k = 0; k < n; ++k) {
    change(VecX::Unit(n, k));
    bend_.col(k) = change_ * lambda;
  }
  return true;
}

// The displacement of a material point counts along tangents that are fixed to its plane.
void HeldNode::set_displacements(const std::vector<PersistentContact>& contacts) {
  displacements_ = gradients_.transpose();
  for (std::size_t i = 0; i < contacts.size(); ++i) {
    if (!contacts[i].keeps_place()) continue;
    const int r = first_[i];
    displacements_.middleRows(r + 1, 2) = tangents(contacts[i]) * place_change(contacts[i].point);
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

// Sets change_ to that of the gradients along dq. How tangents turn about the normal changes no motion where all three
// components of an impulse are free.
void HeldNode::change(const VecX& dq) {
  change_.resize(gradients_.rows(), gradients_.cols());
  constraints_.change(dq, change_.leftCols(constraints_.rows()));
  for (std::size_t i = 0; i < first_.size(); ++i)
    contacts_[i].change(dq, t1_[i], change_.middleCols(first_[i], count_[i]));
}

MatX HeldNode::speed_change(const VecX& v) {
  MatX found(rows(), v.size());
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    change(VecX::Unit(v.size(), k));
    found.col(k) = change_.transpose() * v;
  }
  return found;
}

}  // namespace contactvi
