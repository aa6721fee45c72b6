// Third derivatives of gaps that are closed: of a gap between a point of one body (a vertex, the centre of a ball or of
// a capsule's end) and a point or a face of the other, and of a joint limit. With y a constant motion of the joints it
// gives the gradient of W . y, W the gradient of the gap, and what both change by along a direction.
#pragma once

#include "geometry/contact_tangent.hpp"
#include "model/element_curvature.hpp"

namespace contactvi {

class GapCurvature {
 public:
  explicit GapCurvature(const Scene& scene);

  // Takes the contact of a guard that was taken at q. False where the gap is that of other features; why() names them.
  bool take(const VecCRef& q, int guard, const ContactTangent& contact, const VecCRef& W);
  const char* why() const { return why_.c_str(); }
  // Along dq (nv,): W, and the gradient of W . y for a y whose derivative is along dq too.
  void along(const VecCRef& dq, const DualX& y, DualX& W, DualX& of_q);

 private:
  struct Side {
    int body;
    Vec3 p_B;  // the point, or one of the face, in the body's frame
  };
  void between_points(DualX& W, DualX& of_q);
  void from_face(DualX& W, DualX& of_q);

  const Scene* scene_;
  MovingBodies bodies_;
  std::string why_;
  VecX q_, fixed_;       // fixed_: the gradient of a joint limit
  Side first_, second_;  // points; or the face and the point over it
  Vec3 normal_B_;        // of the face, outward, in its body's frame
  bool is_limit_ = false, has_face_ = false;
  DualX none_, unused_;
};

}  // namespace contactvi
