// The geometry of persistent contacts: gaps, tangents, displacements of material points on the surfaces they touch.
#pragma once

#include "contact/persistent_contact.hpp"
#include "geometry/guard.hpp"

namespace contactvi {

// Cosine of the angle by which the contact point of a rim may run around in a step, or between two nodes.
constexpr double kSwing = 0.95;

// All functions are those of the configuration at which the guards are placed.
class PersistentGeometry {
 public:
  explicit PersistentGeometry(Guards& guards) : guards_(&guards) {}

  void evaluate(const ContactPoint& point, Contact& contact) const;
  // The first tangent at the start of a step; and later in it, turned with the normal from an earlier contact with the
  // tangent t1. Zero without friction.
  Vec3 start_tangent(const PersistentContact& persistent, const Contact& contact) const;
  Vec3 tangent(const PersistentContact& persistent, const Contact& contact, const Contact& before,
               const Vec3& t1) const;
  // Of a material point: its position in the plane's body frame [m], from where its displacement counts, and that
  // displacement along both tangents [m].
  Vec3 position_on_plane(const ContactPoint& point) const;
  Vec3 reference(const PersistentContact& persistent) const;
  Eigen::Vector2d displacement(const PersistentContact& persistent, const Vec3& reference) const;

 private:
  Vec3 vertex_tangent(const PersistentContact& persistent) const;

  Guards* guards_;
};

}  // namespace contactvi
