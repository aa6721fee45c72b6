// The forces of compliant contacts (elements.hpp): a normal force that is a potential's of the gap, with the damping of
// Hunt and Crossley ("Coefficient of restitution interpreted as damping in vibroimpact", Journal of Applied Mechanics
// 42, 1975), and Coulomb's friction with a small speed below which it is viscous. Hertz ("Über die Berührung fester
// elastischer Körper", Journal für die reine und angewandte Mathematik 92, 1882) has the exponent 3/2. Normal force and
// bound on friction may be functions of the user.
#pragma once

#include <cmath>
#include <vector>

#include "model/contact_function.hpp"
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

// What the functions of a law give for a contact; by_first and by_second are those of ContactFunction.
struct GivenPress {
  double elastic = 0.0;  // the force at this depth and at rest [N], 0 without an energy
  double at_rest = 0.0;  // the force at this depth and at rest [N]
  ContactValue force, bound;
};

// A contact whose law has functions, with the numbers that they are asked for: depth, rate of the gap, speed of the
// slip.
struct AskedPress {
  const ComplianceLaw* law;
  double depth, along, slip;
  GivenPress given = {};
};
AskedPress asked_press(const ComplianceLaw& law, const Touch<double>& touch, const Vec3& velocity);
// Asks the functions of contacts, each function once for all of them.
void ask(std::vector<AskedPress>& contacts, bool derivatives);
inline bool asks(const ComplianceLaw& law) { return law.force != nullptr || law.bound != nullptr; }

inline double followed(const ContactValue& at, double, double) { return at.value; }
inline DualNumber followed(const ContactValue& at, const DualNumber& first, const DualNumber& second) {
  return {at.value, at.by_first * first.d + at.by_second * second.d};
}

// given: of a law with functions, asked at this depth and velocity.
template <class T>
PressOf<T> press_of(const ComplianceLaw& law, const Touch<T>& touch, const Eigen::Matrix<T, 3, 1>& v,
                    const GivenPress& given) {
  using V = Eigen::Matrix<T, 3, 1>;
  using std::sqrt;
  const T along = touch.normal.dot(v);
  const T elastic = law.force ? T(given.elastic) : T(law.stiffness) * signed_power(T(-touch.gap), law.exponent);
  const T normal =
      law.force ? followed(given.force, T(-touch.gap), T(-along)) : elastic * (T(1.0) - T(law.damping) * along);
  V force = touch.normal * normal;
  if (law.rubs()) {
    const V slip = v - touch.normal * along;
    const T square = slip.dot(slip);
    // At rest the bound changes by the square of the slip, and so the friction does not.
    const T bound = law.bound ? followed(given.bound, normal, square == T(0.0) ? T(0.0) : T(sqrt(square)))
                              : T(T(law.friction) * normal);
    force -= V(slip * T(bound / T(sqrt(square + T(law.slip_speed * law.slip_speed)))));
  }
  return {elastic, normal, force};
}

// Energy of the potential at a gap [J], and the force of that [N].
double compliance_energy(const ComplianceLaw& law, double gap);
double compliance_elastic(const ComplianceLaw& law, double gap);
// An energy that is as large as that of the overlap [J], whether the law has one or not.
double compliance_scale(const ComplianceLaw& law, double gap);
// Whether a contact presses by itself: it overlaps, and its damper does not pull more than its spring pushes. along:
// the rate of the gap [m/s].
inline bool presses(const ComplianceLaw& law, double gap, double along, const GivenPress& given) {
  return gap < 0.0 && (law.force ? given.force.value > 0.0 : law.damping * along < 1.0);
}
// How far the damper is from pulling as much as the spring pushes, as a share of what the spring or both do.
double pull_share(const ComplianceLaw& law, double along, const GivenPress& given);

TouchPose<double> touch_pose(const Placements& at, int body);
// Where the bodies of a contact are placed.
Touch<double> touch_of(const CompliantContact& contact, const Placements& at);

// The sizes of the terms of a gap [m], whose rounding is 1e-16 of them.
double touch_size(const CompliantContact& contact, const Touch<double>& touch);
// d elastic / d depth [N/m]; of a force of the user what it is for a power of the depth.
double compliance_slope(const ComplianceLaw& law, double gap, const GivenPress& given);

// A contact at a state.
struct Press {
  Touch<double> touch;
  PressOf<double> acts;
  Vec3 velocity;  // of the point of a against that of b
  GivenPress given;
};

}  // namespace contactvi
