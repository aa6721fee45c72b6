// How a contact changes with the configuration: the normal, the nearest points, and so the rows of the relative
// velocity at the contact (contact.hpp). The change of the row n is the second derivative of the gap.
//
// With the unit normal n from a to b, the nearest points c_A, c_B of the two cores (contact_surface.hpp) and their
// distance g, c_B - c_A = g n. Along a motion of the bodies each point moves with its body and slides on its core by s:
//
//   tangential part of (v_B(c_B) + s_B - v_A(c_A) - s_A) = g dn,   dn.n = 0
//   s_A = R_A (dn - omega_A x n),   s_B = -R_B (dn - omega_B x n)
//
// where an infinite radius of curvature in R stands for: no turn of the normal in that direction, and a free slide.
// That is one linear system for dn, s_A and s_B, whatever features meet. It is singular where the nearest points are
// not unique.
//
// The tangents turn with the normal by the shortest turn; those of friction that depends on the direction stay along
// the axis of its law, which turns with its body.
#pragma once

#include <Eigen/LU>
#include <array>
#include <string>

#include "geometry/contact_surface.hpp"
#include "geometry/manifold.hpp"
#include "model/body_twists.hpp"

namespace contactvi {

class ContactTangent {
 public:
  explicit ContactTangent(const Scene& scene);

  // Takes the contact of a guard at q. point: the contact point whose gap it is; null: the nearest points of the pair,
  // or a joint limit. False where the nearest points are not unique, or lie where features meet; why() says it.
  bool take(const VecCRef& q, int guard, const Contact& contact, const ContactPoint* point);
  const char* why() const { return why_.c_str(); }
  // On which features of a and of b the nearest points of a pair lie where they are between two, by
  // ContactSurface::number(); -1: that is not known, and the contact is not taken.
  void prefer(const std::array<int, 2>& features) { preferred_ = features; }
  // The contact that was taken. Where coal's nearest points are iterated, they are here those of their features.
  const Contact& contact() const { return contact_; }
  // The features of a (0) and of b (1) at the nearest points; none of a joint limit.
  const ContactSurface& surface(int side) const { return surface_[side]; }

  // The derivative along dq, shape (nv,), of the rows n, t1, t2 (or n alone) as columns of dW, (nv, 1 or 3), and where
  // it has more of those of spinning and rolling; zero for a joint limit. Tangent vectors are body-fixed on spherical
  // joints, as dq and the rows are. t2 = n x t1. The rows of friction that depends on the direction have its shares
  // (TangentFrame).
  void change(const VecCRef& dq, const Vec3& t1, Eigen::Ref<MatX> dW);
  bool has_axis() const { return law_ != nullptr; }
  // By how much the tangents turn about the normal where that changes by dn against the bodies; 0 without an axis.
  double turn_by_normal(const Vec3& t1, const Vec3& dn) const {
    return has_axis() ? turn_about_normal(t1, Vec3::Zero(), dn) : 0.0;
  }
  const Eigen::Vector2d& turning() const { return turning_; }
  Eigen::Vector2d shares() const { return law_ != nullptr ? law_->shares : Eigen::Vector2d(1.0, 1.0); }
  // Derivatives of the normal and of the points of a and b along the last dq, world frame.
  const Vec3& normal_change() const { return dn_; }
  const Vec3& point_a_change() const { return dx_[0]; }
  const Vec3& point_b_change() const { return dx_[1]; }
  // And those of both tangents, the bodies' motion.
  const Vec3& tangent_change(int k) const { return dt_[k]; }
  const BodyTwists& twists() const { return twists_; }

 private:
  using Vec6 = Eigen::Matrix<double, 6, 1>;

  bool take_point(const ContactPoint& point);
  bool take_solids(const ContactPoint& p);
  bool take_witness(int guard);
  // Finds both features and the nearest points on them. nearby: those of the contact are known to some digits only.
  bool approach(const Pair& pair, const Pose (&pose)[2], bool nearby);
  bool find(const Pair& pair, const Pose (&pose)[2], bool nearby, ContactSurface (&found)[2]);
  bool polish();
  bool set_system();
  bool take_axis(const Pair& pair);
  double turn_about_normal(const Vec3& t1, const Vec3& axis_change, const Vec3& dn) const;
  bool refuse(const std::string& why);
  std::string names() const;
  int body(int side) const { return side == 0 ? contact_.body_a : contact_.body_b; }
  Vec3 outward(int side) const { return side == 0 ? contact_.normal : Vec3(-contact_.normal); }

  const Scene* scene_;
  BodyTwists twists_;
  std::string why_;
  std::array<int, 2> preferred_{-1, -1};
  Contact contact_{};
  bool is_limit_ = false;
  ContactSurface surface_[2];  // of a and of b
  double scale_ = 1.0;         // a length of the pair [m]
  // The system in (dn along the two tangents, s_A / scale, s_B / scale).
  Vec3 tangent_[2];
  Bend bend_[2];
  double points_weight_ = 1.0;  // of the rows of the points' motion
  double weight_[2][2];         // of the rows of the principal directions of a and of b
  Eigen::FullPivLU<Eigen::Matrix<double, 6, 6>> system_;
  Vec3 dn_{}, dx_[2], dt_[2];
  // Friction that depends on the direction: its law, null: it does not, with the axis in the world and its body.
  const ContactLaw* law_ = nullptr;
  Vec3 axis_{};
  int axis_body_ = -1;
  Eigen::Vector2d turning_ = Eigen::Vector2d::Zero();  // radii of friction against spinning and rolling [m]
};

}  // namespace contactvi
