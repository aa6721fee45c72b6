#include "kernel.hpp"

#include <cmath>

namespace contactvi {

KernelWorkspace::KernelWorkspace(const Tree& tree)
    : bodies(tree.joints.size()), composites(tree.joints.size()), R_W(tree.joints.size()), p_W(tree.joints.size()) {}

namespace {

// R = R_PJ Rz(angle): only two columns change.
inline void turn_about_z(const Mat3& R_PJ, double c, double s, Mat3& R) {
  R.col(0) = c * R_PJ.col(0) + s * R_PJ.col(1);
  R.col(1) = c * R_PJ.col(1) - s * R_PJ.col(0);
  R.col(2) = R_PJ.col(2);
}

inline void place(const Joint& joint, const double* q, Mat3& R, Vec3& r) {
  switch (joint.type) {
    case JointType::kRevolute:
      turn_about_z(joint.R_PJ, std::cos(q[0]), std::sin(q[0]), R);
      r = joint.p_PJ;
      break;
    case JointType::kContinuous:
      turn_about_z(joint.R_PJ, q[0], q[1], R);
      r = joint.p_PJ;
      break;
    case JointType::kPrismatic:
      R = joint.R_PJ;
      r = joint.p_PJ + q[0] * joint.R_PJ.col(2);
      break;
    case JointType::kHelical:
      turn_about_z(joint.R_PJ, std::cos(q[0]), std::sin(q[0]), R);
      r = joint.p_PJ + (joint.pitch * q[0]) * joint.R_PJ.col(2);
      break;
    case JointType::kTranslation:
      R = joint.R_PJ;
      r = joint.p_PJ + joint.R_PJ * Vec3(q[0], q[1], q[2]);
      break;
    case JointType::kSpherical:
      R.noalias() = joint.R_PJ * Quat(q[3], q[0], q[1], q[2]).toRotationMatrix();
      r = joint.p_PJ;
      break;
  }
}

inline void add_joint_velocity(const Joint& joint, const double* v, Twist& velocity) {
  switch (joint.type) {
    case JointType::kRevolute:
    case JointType::kContinuous:
      velocity.ang.z() += v[0];
      break;
    case JointType::kPrismatic:
      velocity.lin.z() += v[0];
      break;
    case JointType::kHelical:
      velocity.ang.z() += v[0];
      velocity.lin.z() += joint.pitch * v[0];
      break;
    case JointType::kTranslation:
      velocity.lin += Vec3(v[0], v[1], v[2]);
      break;
    case JointType::kSpherical:
      velocity.ang += Vec3(v[0], v[1], v[2]);
      break;
  }
}

// out = S^T wrench, one or three numbers.
inline void project(const Joint& joint, const Wrench& f, double sign, double* out) {
  switch (joint.type) {
    case JointType::kRevolute:
    case JointType::kContinuous:
      out[0] = sign * f.ang.z();
      break;
    case JointType::kPrismatic:
      out[0] = sign * f.lin.z();
      break;
    case JointType::kHelical:
      out[0] = sign * (f.ang.z() + joint.pitch * f.lin.z());
      break;
    case JointType::kTranslation:
      for (int d = 0; d < 3; ++d) out[d] = sign * f.lin[d];
      break;
    case JointType::kSpherical:
      for (int d = 0; d < 3; ++d) out[d] = sign * f.ang[d];
      break;
  }
}

inline Wrench to_parent(const BodyState& body, const Wrench& f) {
  const Vec3 lin = body.R * f.lin;
  return {body.R * f.ang + body.r.cross(lin), lin};
}

inline Wrench cross_dual(const Twist& v, const Wrench& f) {
  return {v.ang.cross(f.ang) + v.lin.cross(f.lin), v.ang.cross(f.lin)};
}

inline Wrench times(const Composite& I, const Twist& v) {
  return {I.inertia * v.ang + I.first_moment.cross(v.lin), I.mass * v.lin - I.first_moment.cross(v.ang)};
}

// Column d of the joint's motion subspace in the body frame.
inline Twist subspace(const Joint& joint, int d) {
  switch (joint.type) {
    case JointType::kPrismatic:
      return {Vec3::Zero(), Vec3::UnitZ()};
    case JointType::kHelical:
      return {Vec3::UnitZ(), joint.pitch * Vec3::UnitZ()};
    case JointType::kTranslation:
      return {Vec3::Zero(), Vec3::Unit(d)};
    case JointType::kSpherical:
      return {Vec3::Unit(d), Vec3::Zero()};
    default:
      return {Vec3::UnitZ(), Vec3::Zero()};
  }
}

void composite_inertias(const Tree& tree, KernelWorkspace& ws) {
  const int n = static_cast<int>(tree.joints.size());
  for (int i = 0; i < n; ++i)
    ws.composites[i] = {tree.joints[i].mass, tree.joints[i].first_moment, tree.joints[i].inertia};
  for (int i = n - 1; i >= 0; --i) {
    const int parent = tree.joints[i].parent;
    if (parent < 0) continue;
    const BodyState& body = ws.bodies[i];
    const Composite& c = ws.composites[i];
    const Vec3 moment = body.R * c.first_moment;
    // About the parent's origin: R I R^T - ([r][moment] + [moment][r]) - m [r][r], all symmetric.
    Composite& up = ws.composites[parent];
    const Vec3& r = body.r;
    Mat3 shifted = body.R * c.inertia * body.R.transpose();
    shifted -= r * moment.transpose() + moment * r.transpose() + c.mass * r * r.transpose();
    shifted.diagonal().array() += 2 * r.dot(moment) + c.mass * r.squaredNorm();
    up.inertia += shifted;
    up.first_moment += moment + c.mass * r;
    up.mass += c.mass;
  }
}

int joint_dofs(const Joint& joint) {
  return joint.type == JointType::kTranslation || joint.type == JointType::kSpherical ? 3 : 1;
}

// Entries of M between joint k and everything above it, column by column (F = I_k S_k carried towards the root).
template <class Visit>
inline void walk_up(const Tree& tree, const KernelWorkspace& ws, int k, Wrench& F, Wrench& B, Visit visit) {
  for (int j = k; tree.joints[j].parent >= 0;) {
    F = to_parent(ws.bodies[j], F);
    B = to_parent(ws.bodies[j], B);
    j = tree.joints[j].parent;
    visit(j, F, B);
  }
}

}  // namespace

void local_placements(const Tree& tree, const VecCRef& q, KernelWorkspace& ws) {
  for (std::size_t i = 0; i < tree.joints.size(); ++i)
    place(tree.joints[i], q.data() + tree.joints[i].iq, ws.bodies[i].R, ws.bodies[i].r);
}

void momentum_and_forces(const Tree& tree, const VecCRef& q, const VecCRef& v, KernelWorkspace& ws, VecRef P, VecRef dT,
                         VecRef dV) {
  const int n = static_cast<int>(tree.joints.size());
  for (int i = 0; i < n; ++i) {
    const Joint& joint = tree.joints[i];
    BodyState& body = ws.bodies[i];
    place(joint, q.data() + joint.iq, body.R, body.r);
    if (joint.parent < 0) {
      body.inherited = {Vec3::Zero(), Vec3::Zero()};
      body.gravity.noalias() = body.R.transpose() * tree.gravity;
    } else {
      const BodyState& parent = ws.bodies[joint.parent];
      body.inherited.ang.noalias() = body.R.transpose() * parent.velocity.ang;
      body.inherited.lin.noalias() = body.R.transpose() * (parent.velocity.lin + parent.velocity.ang.cross(body.r));
      body.gravity.noalias() = body.R.transpose() * parent.gravity;
    }
    body.velocity = body.inherited;
    add_joint_velocity(joint, v.data() + joint.iv, body.velocity);
    body.subtree_mass = joint.mass;
    body.subtree_moment = joint.first_moment;
    body.momentum.lin = joint.mass * body.velocity.lin - joint.first_moment.cross(body.velocity.ang);
    body.momentum.ang.noalias() = joint.inertia * body.velocity.ang + joint.first_moment.cross(body.velocity.lin);
  }
  for (int i = n - 1; i >= 0; --i) {
    const Joint& joint = tree.joints[i];
    BodyState& body = ws.bodies[i];
    project(joint, body.momentum, 1.0, P.data() + joint.iv);
    project(joint, {body.subtree_moment.cross(body.gravity), body.subtree_mass * body.gravity}, -1.0,
            dV.data() + joint.iv);
    if (joint.parent < 0) {
      project(joint, {Vec3::Zero(), Vec3::Zero()}, -1.0, dT.data() + joint.iv);
      continue;
    }
    project(joint, cross_dual(body.inherited, body.momentum), -1.0, dT.data() + joint.iv);
    BodyState& parent = ws.bodies[joint.parent];
    const Wrench up = to_parent(body, body.momentum);
    parent.momentum.ang += up.ang;
    parent.momentum.lin += up.lin;
    parent.subtree_mass += body.subtree_mass;
    parent.subtree_moment += body.R * body.subtree_moment + body.subtree_mass * body.r;
  }
  P += tree.armature.cwiseProduct(v);
}

void assemble_mass(const Tree& tree, KernelWorkspace& ws, TreeLu& matrix) {
  composite_inertias(tree, ws);
  for (int k = 0; k < static_cast<int>(tree.joints.size()); ++k) {
    const Joint& joint = tree.joints[k];
    for (int d = 0; d < joint_dofs(joint); ++d) {
      const int dof = joint.iv + d;
      double* row = matrix.row(dof);
      double* column = matrix.column(dof);
      Wrench F = times(ws.composites[k], subspace(joint, d)), unused{Vec3::Zero(), Vec3::Zero()};
      double own[3];
      project(joint, F, 1.0, own);
      matrix.diagonal(dof) = own[d] + tree.armature[dof];
      const int base = matrix.depth(joint.iv);  // ancestors outside of the joint
      for (int e = 0; e < d; ++e) row[base + e] = column[base + e] = own[e];
      walk_up(tree, ws, k, F, unused, [&](int j, const Wrench& f, const Wrench&) {
        const int at = matrix.depth(tree.joints[j].iv);
        project(tree.joints[j], f, 1.0, column + at);
        for (int e = 0; e < joint_dofs(tree.joints[j]); ++e) row[at + e] = column[at + e];
      });
    }
  }
}

void assemble_newton(const Tree& tree, double h, const VecCRef& P, KernelWorkspace& ws, TreeLu& matrix) {
  composite_inertias(tree, ws);
  const double half = 0.5 * h;
  for (int k = 0; k < static_cast<int>(tree.joints.size()); ++k) {
    const Joint& joint = tree.joints[k];
    const BodyState& body = ws.bodies[k];
    const int dofs = joint_dofs(joint), base = matrix.depth(joint.iv);
    const bool spherical = joint.type == JointType::kSpherical;
    const bool moving = joint.parent >= 0;
    Mat3 own_M, own_A;  // block of this joint, M_de and A_de
    for (int d = 0; d < dofs; ++d) {
      const int dof = joint.iv + d;
      double* row = matrix.row(dof);
      double* column = matrix.column(dof);
      const Twist S = subspace(joint, d);
      const Twist w = cross(S, body.inherited);
      Wrench F = times(ws.composites[k], S);
      const Wrench drag = times(ws.composites[k], w), turned = cross_dual(S, body.momentum);
      Wrench B = {turned.ang - drag.ang, turned.lin - drag.lin};
      project(joint, F, 1.0, own_M.col(d).data());
      if (moving) project(joint, drag, -1.0, own_A.col(d).data());
      walk_up(tree, ws, k, F, B, [&](int j, const Wrench& f, const Wrench& b) {
        const Joint& above = tree.joints[j];
        const int at = matrix.depth(above.iv);
        double M[3], A_above[3];
        project(above, f, 1.0, M);
        project(above, b, 1.0, A_above);
        for (int e = 0; e < joint_dofs(above); ++e) {
          const double A_below = above.parent < 0 ? 0.0 : -dot(f, cross(subspace(above, e), ws.bodies[j].inherited));
          column[at + e] = M[e] + half * (A_above[e] - A_below);
          row[at + e] = M[e] - half * (A_above[e] - A_below);
        }
        if (above.type == JointType::kSpherical) {
          const Vec3 omega = ws.bodies[j].velocity.ang - ws.bodies[j].inherited.ang;
          Eigen::Map<Vec3>(column + at) += half * omega.cross(Vec3(M[0], M[1], M[2]));
        }
      });
    }
    if (!moving) own_A.setZero();
    if (dofs == 1) {
      matrix.diagonal(joint.iv) = own_M(0, 0) + tree.armature[joint.iv];
      continue;
    }
    Mat3 block = own_M + half * (own_A - own_A.transpose());
    block.diagonal() += tree.armature.segment<3>(joint.iv);
    if (spherical) {
      // Jr(xi)^-1 in p_k = Jr^-1 P + ...: d(P + h/2 w x P) = dP + h/2 (w x dP - P x dw); w: the joint's own velocity.
      const Vec3 omega = body.velocity.ang - body.inherited.ang;
      block += half * (skew(omega) * block - skew(P.segment<3>(joint.iv)));
      for (int m = 0; m < base; ++m) {
        const Vec3 entries(matrix.row(joint.iv)[m], matrix.row(joint.iv + 1)[m], matrix.row(joint.iv + 2)[m]);
        const Vec3 turn = half * omega.cross(entries);
        for (int d = 0; d < 3; ++d) matrix.row(joint.iv + d)[m] += turn[d];
      }
    }
    for (int d = 0; d < 3; ++d) {
      matrix.diagonal(joint.iv + d) = block(d, d);
      for (int e = 0; e < d; ++e) {
        matrix.row(joint.iv + d)[base + e] = block(d, e);
        matrix.column(joint.iv + d)[base + e] = block(e, d);
      }
    }
  }
}

void world_placements(const Tree& tree, KernelWorkspace& ws) {
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const BodyState& body = ws.bodies[i];
    const int parent = tree.joints[i].parent;
    if (parent < 0) {
      ws.R_W[i] = body.R;
      ws.p_W[i] = body.r;
    } else {
      ws.R_W[i].noalias() = ws.R_W[parent] * body.R;
      ws.p_W[i] = ws.p_W[parent] + ws.R_W[parent] * body.r;
    }
  }
}

double gravity_potential(const Tree& tree, const KernelWorkspace& ws) {
  double potential = 0;
  for (std::size_t i = 0; i < tree.joints.size(); ++i) {
    const Joint& joint = tree.joints[i];
    potential -= tree.gravity.dot(joint.mass * ws.p_W[i] + ws.R_W[i] * joint.first_moment);
  }
  return potential;
}

}  // namespace contactvi
