#include "model/tree.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

void set_body(Joint& joint, double mass, const Vec3& centre, const Mat3& about_com, const Mat3& A) {
  const Mat3 turned = A.transpose() * about_com * A;
  const Vec3 c = A.transpose() * centre;
  joint.mass = mass;
  joint.first_moment = mass * c;
  joint.inertia = turned + mass * (c.squaredNorm() * Mat3::Identity() - c * c.transpose());
}

void find_springs_and_damping(Tree& tree) {
  tree.has_damping = !tree.damping.isZero(0);
  tree.has_springs = false;
  for (const Joint& joint : tree.joints) tree.has_springs |= joint.stiffness != 0;
}

void integrate_joint(const Joint& joint, const VecCRef& q, const double* w, VecRef q1) {
  const int iq = joint.iq;
  switch (joint.type) {
    case JointType::kRevolute:
    case JointType::kPrismatic:
    case JointType::kHelical:
      q1[iq] = q[iq] + w[0];
      break;
    case JointType::kTranslation:
      for (int d = 0; d < 3; ++d) q1[iq + d] = q[iq + d] + w[d];
      break;
    case JointType::kContinuous: {
      const double c = std::cos(w[0]), s = std::sin(w[0]);
      const double c1 = q[iq] * c - q[iq + 1] * s, s1 = q[iq] * s + q[iq + 1] * c;
      const double scale = 1 / std::sqrt(c1 * c1 + s1 * s1);
      q1[iq] = scale * c1;
      q1[iq + 1] = scale * s1;
      break;
    }
    case JointType::kSpherical: {
      const Quat quat(q[iq + 3], q[iq], q[iq + 1], q[iq + 2]);
      const Quat turned = (quat * so3_exp(Vec3(w[0], w[1], w[2]))).normalized();
      q1.segment<4>(iq) = turned.coeffs();
      break;
    }
  }
}

void integrate(const Tree& tree, const VecCRef& q, const VecCRef& w, double factor, VecRef q1) {
  for (const Joint& joint : tree.joints) {
    double scaled[3];
    for (int d = 0; d < joint.nv; ++d) scaled[d] = factor * w[joint.iv + d];
    integrate_joint(joint, q, scaled, q1);
  }
}

double configuration_distance(const Tree& tree, const VecCRef& a, const VecCRef& b) {
  double square = 0.0;
  for (const Joint& joint : tree.joints) {
    double near = 0.0;  // square of the chord
    for (int d = joint.iq; d < joint.iq + joint.nq; ++d) near += (b[d] - a[d]) * (b[d] - a[d]);
    if (joint.type == JointType::kContinuous || joint.type == JointType::kSpherical) {
      const bool quaternion = joint.type == JointType::kSpherical;
      // q and -q are one rotation, and the chord belongs to half its angle.
      if (quaternion) near = std::min(near, std::max(0.0, 4.0 - near));
      const double angle = (quaternion ? 4.0 : 2.0) * std::asin(std::min(1.0, 0.5 * std::sqrt(near)));
      near = angle * angle;
    }
    square += near;
  }
  return std::sqrt(square);
}

double joint_error(const Joint& joint, const VecCRef& q, double value) {
  if (joint.type != JointType::kContinuous) return value - q[joint.iq];
  return std::remainder(value - std::atan2(q[joint.iq + 1], q[joint.iq]), kTwoPi);
}

Vec3 spring_deflection(const Tree& tree, const Joint& joint, const VecCRef& q) {
  const int iq = joint.iq;
  const VecX& rest = tree.rest;
  switch (joint.type) {
    case JointType::kTranslation:
      return q.segment<3>(iq) - rest.segment<3>(iq);
    case JointType::kSpherical: {
      const Quat at_rest(rest[iq + 3], rest[iq], rest[iq + 1], rest[iq + 2]);
      return so3_log(at_rest.conjugate() * Quat(q[iq + 3], q[iq], q[iq + 1], q[iq + 2]));
    }
    case JointType::kContinuous:
      return Vec3(std::atan2(q[iq + 1] * rest[iq] - q[iq] * rest[iq + 1], q[iq] * rest[iq] + q[iq + 1] * rest[iq + 1]),
                  0, 0);
    default:
      return Vec3(q[iq] - rest[iq], 0, 0);
  }
}

double spring_potential(const Tree& tree, const VecCRef& q) {
  double energy = 0;
  if (!tree.has_springs) return energy;
  for (const Joint& joint : tree.joints)
    if (joint.stiffness != 0) energy += 0.5 * joint.stiffness * spring_deflection(tree, joint, q).squaredNorm();
  return energy;
}

void add_spring_forces(const Tree& tree, const VecCRef& q, VecRef dV) {
  if (!tree.has_springs) return;
  for (const Joint& joint : tree.joints) {
    if (joint.stiffness == 0) continue;
    // On SO(3) the gradient of |log R|^2/2 is log R itself, because log R is an eigenvector of its Jacobian.
    const Vec3 deflection = spring_deflection(tree, joint, q);
    for (int d = 0; d < joint.nv; ++d) dV[joint.iv + d] += joint.stiffness * deflection[d];
  }
}

}  // namespace contactvi
