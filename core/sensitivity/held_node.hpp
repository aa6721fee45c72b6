// The rows of a held step at one of its nodes, and how they change with the configuration there: those of the
// constraints, then those of the contacts and of the joints with friction that stick (contact/persistent_rows.hpp).
//
// All of them are combinations of columns: the gradients of the constraints, those of the normal and of both tangents
// of each contact, and those of the joints. A row has an impulse, which acts along its column, but that of a sliding
// contact along n - mu d, d the direction of its slip. This is an angle between its tangents, which acts as well: a
// turn of it by -mu times the impulse, across the slip. Where friction depends on the speed of the slip the
// coefficients are unknown numbers beside the angles: they act by minus the impulse along the slip, and the equation of
// each is d mu - mu' d(slip) = 0, mu' its slope. The numbers of the slips are the angles and then these coefficients.
//
// Surfaces that move along themselves have speeds in the rows and slips beside those of the bodies. Adhesion is a
// force along a normal, a given function of the time.
#pragma once

#include <array>
#include <vector>

#include "contact/held_step_record.hpp"
#include "contact/persistent_rows.hpp"
#include "geometry/contact_tangent.hpp"
#include "geometry/surface_velocity_tangent.hpp"
#include "model/constraint_tangent.hpp"
#include "step/node_chart.hpp"

namespace contactvi {

class HeldNode {
 public:
  explicit HeldNode(const Scene& scene);

  // What acts at a node: impulses (rows,) along the rows, and of constant forces those of this time [s]; of the slips
  // the angles, the coefficients of friction and, where any depends on a speed, their slopes [s/m], (slides,) each.
  struct Acting {
    VecX lambda;
    double weight;
    VecX angles, mu, slopes;
    // How the coefficients depend on the normal forces and the time; without slides that do so none.
    VecX by_normal = {}, by_time = {};
  };
  // The rows at q and t [s], at the displacement X from the start of the step. phase: set to the contacts and joints of
  // the step; number: of the node, or of a stage, among its places. False where the gap of a contact has no second
  // derivative; why() says it.
  bool take(const VecX& q, double t, const VecX& X, const Acting& acting, const HeldStepRecord& step,
            PersistentRows& phase, int number);
  const char* why() const { return why_; }
  // Of each contact: see ContactTangent.
  void prefer(const std::vector<std::array<int, 2>>& features) { preferred_ = features; }
  int refused() const { return refused_; }  // guard of that contact
  int rows() const { return static_cast<int>(gradients_.cols()); }
  const VecX& configuration() const { return q_; }
  const NodeChart& chart() const { return chart_; }
  int numbers() const { return static_cast<int>(watched_.cols() - gradients_.cols()); }  // of the slips
  // Gradients W of the rows, (nv, rows); and of the speeds in the equations, (nv, rows + numbers): of the rows, of the
  // slips across their directions, which are zero, and of -mu' times the slips. Those of the slips along their
  // directions, (nv, slides).
  const MatX& gradients() const { return gradients_; }
  const MatX& watched() const { return watched_; }
  const MatX& along() const { return along_; }
  // The slips along their directions at the velocity v, (slides,); and the watched speeds but those of the rows.
  VecX slips(const VecX& v) const { return along_.transpose() * v + lead_.transpose() * own_; }
  VecX watched_slips(const VecX& v) const {
    return watched_.rightCols(numbers()).transpose() * v + watch_.rightCols(numbers()).transpose() * own_;
  }
  // The force of all impulses, (nv,); what it changes by with the impulses and the numbers, (nv, rows + numbers), with
  // the coefficients of friction, (nv, slides), and with the configuration.
  const VecX& force() const { return force_; }
  const MatX& given() const { return given_; }
  const MatX& by_friction() const { return by_friction_; }
  const MatX& force_change() const { return bend_; }
  // Derivatives by the configuration, at a constant v, of the watched speeds, (rows + numbers, nv), and of those
  // along the slips, (slides, nv).
  void change_speeds(const VecX& v, MatX& watched, MatX& along);
  // Derivatives of the rows' displacements: by the configuration, (rows, nv); and by time at a fixed one, (rows,), of
  // which only constraints have any.
  const MatX& displacements() const { return displacements_; }
  const VecX& rates() const { return rates_; }
  // Constant forces, with adhesion [N]; and these with what the length of the step, of which the impulses are forces,
  // changes of the friction.
  const VecX& load() const { return load_; }
  VecX length_change() const { return load_ + columns_ * friction_loads_; }
  // Derivatives by time, at a fixed configuration, of the force, of the watched speeds at a constant v, and of the
  // slips along their directions.
  VecX force_rate() const;
  VecX speed_rates(const VecX& v) const;
  VecX slip_rates() const { return lead_.transpose() * own_rates_; }
  // Of a material point: the derivative of its position in the frame of the plane's body, (3, nv); and the tangents
  // there along which its displacement counts, (2, 3).
  MatX place_change(const ContactPoint& point);
  static Eigen::Matrix<double, 2, 3> tangents(const PersistentContact& contact);
  // By how much the tangents of sliding contacts turn about their normals with the configuration, where they are fixed
  // to a plane, (slides, nv): no other derivative here has that, but along the axis of friction.
  MatX frame_turns(const std::vector<PersistentContact>& contacts, const PersistentRows& phase);

 private:
  bool take_contacts(const std::vector<PersistentContact>& contacts, const PersistentRows& phase, int number, double t);
  void take_pulls(const std::vector<PersistentContact>& contacts, const PersistentRows& phase, int number, double t);
  void combine(const Acting& acting, const PersistentRows& phase);
  void set_displacements(const std::vector<PersistentContact>& contacts);
  void change(const VecX& dq);

  NodeChart chart_;
  ConstraintTangent constraints_;
  BodyTwists twists_;
  std::vector<ContactTangent> contacts_;
  const Scene* scene_;
  std::vector<int> first_, count_;  // columns of each contact
  std::vector<int> column_of_;      // of each row
  std::vector<Vec3> t1_;
  VecX q_, X_, force_, rates_, load_;
  MatX columns_, change_;  // and their change along a direction
  // Speeds that surfaces have of themselves along the columns, by the time, and along the direction of change_.
  std::vector<SurfaceVelocityTangent> surfaces_;
  VecX own_, own_rates_, own_change_;
  // Weights of the columns, for what is named like them.
  MatX watch_, give_, lead_;
  VecX weights_;  // of the force
  VecX friction_loads_, friction_rates_;
  VecX pulls_, pull_rates_;  // of the forces of adhesion [N], and their rates
  VecX lambda_;
  double weight_ = 0.0;
  MatX gradients_, watched_, along_, given_, by_friction_, displacements_, bend_;
  const char* why_ = "";
  std::vector<std::array<int, 2>> preferred_;
  int refused_ = -1;
};

}  // namespace contactvi
