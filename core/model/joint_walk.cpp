#include "model/joint_walk.hpp"

#include <utility>

#include "model/body_twists.hpp"

namespace contactvi {

namespace {

Wrench sum(const Wrench& a, const Wrench& b) { return {a.ang + b.ang, a.lin + b.lin}; }

Wrench cross_dual(const Twist& v, const Wrench& f) {
  return {v.ang.cross(f.ang) + v.lin.cross(f.lin), v.ang.cross(f.lin)};
}

// A twist of the parent's frame in that of the joint, and back.
Twist in_joint(const JointMotion& at, const Twist& v) {
  return {at.R_PJ.transpose() * v.ang, at.R_PJ.transpose() * (v.lin + v.ang.cross(at.p_PJ))};
}

Wrench in_parent(const JointMotion& at, const Wrench& f) {
  const Vec3 force = at.R_PJ * f.lin;
  return {at.R_PJ * f.ang + at.p_PJ.cross(force), force};
}

// Several bodies that are held together.
struct Body {
  double mass;
  Vec3 centre;
  Mat3 inertia;  // about the centre

  explicit Body(const PublicJoint& joint) : mass(joint.mass), centre(joint.centre), inertia(joint.inertia) {}

  Wrench momentum(const Twist& v) const {
    const Vec3 linear = mass * (v.lin + v.ang.cross(centre));
    return {inertia * v.ang + centre.cross(linear), linear};
  }

  void move_to_parent(const JointMotion& at) {
    centre = at.R_PJ * centre + at.p_PJ;
    inertia = at.R_PJ * inertia * at.R_PJ.transpose();
  }

  void add(const Body& other) {
    const double total = mass + other.mass, share = total > 0 ? other.mass / total : 0.0;
    const Mat3 apart = skew(other.centre - centre);
    inertia += other.inertia - (mass * share) * apart * apart;
    centre += share * (other.centre - centre);
    mass = total;
  }
};

void place_in_world(const std::vector<JointMotion>& all, int parent, JointMotion& at) {
  const JointMotion& below = all[parent];
  at.R_WJ = below.R_WJ * at.R_PJ;
  at.p_WJ = below.p_WJ + below.R_WJ * at.p_PJ;
}

JointMotion world_at_rest() {
  const Vec3 none = Vec3::Zero();
  const Mat3 unit = Mat3::Identity();
  return {unit, none, unit, none, {none, none}, {none, none}};
}

}  // namespace

std::vector<JointMotion> joint_places(const PublicModel& model, const VecCRef& q) {
  std::vector<JointMotion> all(model.joints.size(), world_at_rest());
  for (std::size_t k = 1; k < all.size(); ++k) {
    const PublicJoint& joint = model.joints[k];
    place_joint(joint, q, all[k].R_PJ, all[k].p_PJ);
    place_in_world(all, joint.parent, all[k]);
  }
  return all;
}

std::vector<JointMotion> joint_motions(const PublicModel& model, const VecCRef& q, const VecCRef& v,
                                       const Vec3& world) {
  std::vector<JointMotion> all = joint_places(model, q);
  all[0].acceleration.lin = world;
  for (std::size_t k = 1; k < all.size(); ++k) {
    const PublicJoint& joint = model.joints[k];
    const JointMotion& below = all[joint.parent];
    JointMotion& at = all[k];
    const Twist own = joint_twist(joint, v.data() + joint.iv);
    at.twist = sum(in_joint(at, below.twist), own);
    at.acceleration = sum(in_joint(at, below.acceleration), cross(at.twist, own));
  }
  return all;
}

Mat6X joint_jacobian(const PublicModel& model, const std::vector<JointMotion>& places, int joint) {
  Mat6X J = Mat6X::Zero(6, model.nv);
  const JointMotion& end = places[joint];
  for (int k = joint; k > 0; k = model.joints[k].parent) {
    const PublicJoint& carrier = model.joints[k];
    const Mat3 R = end.R_WJ.transpose() * places[k].R_WJ;
    const Vec3 p = end.R_WJ.transpose() * (places[k].p_WJ - end.p_WJ);
    for (int d = 0; d < carrier.nv; ++d) {
      const Twist S = joint_axis(carrier, d);
      const Vec3 turn = R * S.ang;
      J.col(carrier.iv + d) << R * S.lin + p.cross(turn), turn;
    }
  }
  return J;
}

VecX bias_forces(const PublicModel& model, const VecCRef& q, const VecCRef& v) {
  const std::vector<JointMotion> all = joint_motions(model, q, v, -model.gravity);
  std::vector<Wrench> forces(all.size());
  for (std::size_t k = 0; k < all.size(); ++k) {
    const Body body(model.joints[k]);
    forces[k] = sum(body.momentum(all[k].acceleration), cross_dual(all[k].twist, body.momentum(all[k].twist)));
  }
  VecX b(model.nv);
  for (std::size_t k = all.size() - 1; k > 0; --k) {
    const PublicJoint& joint = model.joints[k];
    for (int d = 0; d < joint.nv; ++d) b[joint.iv + d] = dot(forces[k], joint_axis(joint, d));
    forces[joint.parent] = sum(forces[joint.parent], in_parent(all[k], forces[k]));
  }
  return b;
}

MatX mass_matrix(const PublicModel& model, const VecCRef& q) {
  const std::vector<JointMotion> all = joint_places(model, q);
  std::vector<Body> bodies(model.joints.begin(), model.joints.end());
  MatX M = model.armature.head(model.nv).asDiagonal();
  for (std::size_t k = all.size() - 1; k > 0; --k) {
    const PublicJoint& joint = model.joints[k];
    for (int d = 0; d < joint.nv; ++d) {
      // The force that moves all that the joint carries, felt by the joint and by those that carry it.
      Wrench force = bodies[k].momentum(joint_axis(joint, d));
      for (int e = 0; e <= d; ++e) {
        const double entry = dot(force, joint_axis(joint, e));
        M(joint.iv + e, joint.iv + d) += entry;
        if (e < d) M(joint.iv + d, joint.iv + e) += entry;
      }
      for (int at = static_cast<int>(k); model.joints[at].parent > 0;) {
        force = in_parent(all[at], force);
        at = model.joints[at].parent;
        const PublicJoint& carrier = model.joints[at];
        for (int e = 0; e < carrier.nv; ++e)
          M(carrier.iv + e, joint.iv + d) = M(joint.iv + d, carrier.iv + e) = dot(force, joint_axis(carrier, e));
      }
    }
    bodies[k].move_to_parent(all[k]);
    bodies[joint.parent].add(bodies[k]);
  }
  return M;
}

}  // namespace contactvi
