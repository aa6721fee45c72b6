// The forces of compliant contacts (elements.hpp): a normal force that is a potential's of the gap, with the damping of
// Hunt and Crossley ("Coefficient of restitution interpreted as damping in vibroimpact", Journal of Applied Mechanics
// 42, 1975), and Coulomb's friction with a small speed below which it is viscous. Hertz ("Über die Berührung fester
// elastischer Körper", Journal für die reine und angewandte Mathematik 92, 1882) has the exponent 3/2.
#pragma once

#include <cmath>

#include "model/elements.hpp"
#include "model/touching_shapes.hpp"

namespace contactvi {

// sign(d) |d|^n: the law goes on smoothly beyond the opening, in steps that end there.
double signed_power(double d, double n);
DualNumber signed_power(const DualNumber& d, double n);

// What acts on body a at the point, and against it on body b [N], where the shapes are d deep and the point of a moves
// by v against that of b.
template <class T>
struct PressOf {
  T elastic, normal;             // [N]; elastic: from the potential
  Eigen::Matrix<T, 3, 1> force;  // world
};

template <class T>
PressOf<T> press_of(const ComplianceLaw& law, const Touch<T>& touch, const Eigen::Matrix<T, 3, 1>& v) {
  using V = Eigen::Matrix<T, 3, 1>;
  using std::sqrt;
  const T along = touch.normal.dot(v);
  const T elastic = T(law.stiffness) * signed_power(T(-touch.gap), law.exponent);
  const T normal = elastic * (T(1.0) - T(law.damping) * along);
  V force = touch.normal * normal;
  if (law.friction > 0.0) {
    const V slip = v - touch.normal * along;
    force -= V(slip * T(T(law.friction) * normal / T(sqrt(slip.dot(slip) + T(law.slip_speed * law.slip_speed)))));
  }
  return {elastic, normal, force};
}

// Energy of the potential at a gap [J].
double compliance_energy(const ComplianceLaw& law, double gap);
// Whether a contact presses by itself: it overlaps, and its damper does not pull more than its spring pushes. along:
// the rate of the gap [m/s].
inline bool presses(const ComplianceLaw& law, double gap, double along) {
  return gap < 0.0 && law.damping * along < 1.0;
}

TouchPose<double> touch_pose(const Placements& at, int body);
// Where the bodies of a contact are placed.
Touch<double> touch_of(const CompliantContact& contact, const Placements& at);

// The sizes of the terms of a gap [m], whose rounding is 1e-16 of them.
double touch_size(const CompliantContact& contact, const Touch<double>& touch);
// d elastic / d depth [N/m].
double compliance_slope(const ComplianceLaw& law, double gap);

// A contact at a state.
struct Press {
  Touch<double> touch;
  PressOf<double> acts;
  Vec3 velocity;  // of the point of a against that of b
};

}  // namespace contactvi
