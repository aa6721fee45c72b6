#include "model/compliance.hpp"

namespace contactvi {

double signed_power(double d, double n) {
  if (n == 1.0) return d;
  return std::copysign(std::pow(std::abs(d), n), d);
}

DualNumber signed_power(const DualNumber& d, double n) {
  return {signed_power(d.x, n), n == 1.0 ? d.d : n * std::pow(std::abs(d.x), n - 1.0) * d.d};
}

double compliance_energy(const ComplianceLaw& law, double gap) {
  return gap < 0.0 ? law.stiffness / (law.exponent + 1.0) * std::pow(-gap, law.exponent + 1.0) : 0.0;
}

double touch_size(const CompliantContact& contact, const Touch<double>& touch) {
  const double other = contact.shapes->b.bound;
  return touch.point.norm() + std::abs(touch.gap) + contact.shapes->a.bound + (std::isfinite(other) ? other : 0.0);
}

double compliance_slope(const ComplianceLaw& law, double gap) {
  const double n = law.exponent;
  return law.stiffness * (n == 1.0 ? 1.0 : n * std::pow(std::abs(gap), n - 1.0));
}

TouchPose<double> touch_pose(const Placements& at, int body) {
  if (body < 0) return {};
  return {at.R_W[body], at.p_W[body]};
}

Touch<double> touch_of(const CompliantContact& contact, const Placements& at) {
  const TouchPose<double> A = touch_pose(at, contact.body_a), B = touch_pose(at, contact.body_b);
  const NearestFeatures nearest = nearest_touch(*contact.shapes, A, B);
  return touch(nearest.a, nearest.b, A, B);
}

}  // namespace contactvi
