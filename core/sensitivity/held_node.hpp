// The rows of a held step at one of its nodes, and how they change with the configuration there: those of the
// constraints, then those of the contacts (contact/persistent_rows.hpp), of which none slides with friction.
#pragma once

#include "contact/persistent_rows.hpp"
#include "geometry/contact_tangent.hpp"
#include "model/constraint_tangent.hpp"
#include "step/node_chart.hpp"

namespace contactvi {

class HeldNode {
 public:
  explicit HeldNode(const Scene& scene);

  // The rows at q and t [s], at the displacement X from the start of the step, with impulses lambda (rows,). phase: set
  // to the contacts of the step; number: of the node, or of a stage, among its places. False where the gap of a contact
  // has no second derivative; why() says it.
  bool take(const VecX& q, double t, const VecX& X, const VecX& lambda, const std::vector<PersistentContact>& contacts,
            PersistentRows& phase, int number);
  const char* why() const { return why_; }
  int refused() const { return refused_; }  // guard of that contact
  int rows() const { return static_cast<int>(gradients_.cols()); }
  const VecX& displacement() const { return X_; }
  const VecX& configuration() const { return q_; }
  const NodeChart& chart() const { return chart_; }
  // W (nv, rows), W lambda, and d(W lambda)/dq.
  const MatX& gradients() const { return gradients_; }
  const VecX& force() const { return force_; }
  const MatX& force_change() const { return bend_; }
  // d(W^T v)/dq at a constant v, (rows, nv).
  MatX speed_change(const VecX& v);
  // Derivatives of the rows' displacements: by the configuration, (rows, nv); by time at a fixed one, (rows,), of which
  // only constraints have any, and again by time.
  const MatX& displacements() const { return displacements_; }
  const VecX& rates() const { return rates_; }
  const VecX& accelerations() const { return accelerations_; }
  // Of a material point: the derivative of its position in the frame of the plane's body, (3, nv); and the tangents
  // there along which its displacement counts, (2, 3).
  MatX place_change(const ContactPoint& point);
  static Eigen::Matrix<double, 2, 3> tangents(const PersistentContact& contact);

 private:
  void set_displacements(const std::vector<PersistentContact>& contacts);
  void change(const VecX& dq);

  NodeChart chart_;
  ConstraintTangent constraints_;
  BodyTwists twists_;
  std::vector<ContactTangent> contacts_;
  const Scene* scene_;
  std::vector<int> first_, count_;  // rows of each contact
  std::vector<Vec3> t1_;
  VecX q_, X_, force_, rates_, accelerations_;
  MatX gradients_, displacements_, bend_, change_;
  const char* why_ = "";
  int refused_ = -1;
};

}  // namespace contactvi
