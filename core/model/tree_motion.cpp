#include "model/tree_motion.hpp"

namespace contactvi {

namespace {

using Mat6 = Eigen::Matrix<double, 6, 6>;

// Of twists x x y, of a twist and a force x x* f, and the matrices of x x and of y -> y x* f.
Vec6 cross(const Vec6& x, const Vec6& y) {
  Vec6 result;
  result << x.tail<3>().cross(y.head<3>()) + x.head<3>().cross(y.tail<3>()), x.tail<3>().cross(y.tail<3>());
  return result;
}

Vec6 cross_dual(const Vec6& x, const Vec6& f) {
  Vec6 result;
  result << x.tail<3>().cross(f.head<3>()), x.head<3>().cross(f.head<3>()) + x.tail<3>().cross(f.tail<3>());
  return result;
}

Mat6 cross_matrix(const Vec6& x) {
  Mat6 result;
  result << skew(x.tail<3>()), skew(x.head<3>()), Mat3::Zero(), skew(x.tail<3>());
  return result;
}

Mat6 force_matrix(const Vec6& f) {
  Mat6 result;
  result << Mat3::Zero(), -skew(f.head<3>()), -skew(f.head<3>()), -skew(f.tail<3>());
  return result;
}

// The vector (linear, angular) of a point at x.
Vec3 linear_at(const Vec3& x, const Vec6& y) { return y.head<3>() + Vec3(y.tail<3>()).cross(x); }

Mat6 inertia_in_world(const PublicJoint& joint, const JointMotion& at) {
  const Mat3 c = skew(at.R_WJ * joint.centre + at.p_WJ);
  Mat6 result;
  result << joint.mass * Mat3::Identity(), -joint.mass * c, joint.mass * c,
      at.R_WJ * joint.inertia * at.R_WJ.transpose() - joint.mass * c * c;
  return result;
}

}  // namespace

TreeMotion::TreeMotion(const PublicModel& model, const VecCRef& q, const VecCRef& v, const VecCRef& a)
    : model_(model), places_(joint_places(model, q)) {
  const int n = static_cast<int>(model.joints.size());
  twists_.setZero(6, n);
  accelerations_.setZero(6, n);
  for (Mat6X* of_dofs : {&S_, &psi_, &psi_rate_, &S_rate_}) of_dofs->setZero(6, model.nv);
  for (int k = 1; k < n; ++k) {
    const PublicJoint& joint = model.joints[k];
    const Vec6 V = twists_.col(joint.parent), A = accelerations_.col(joint.parent);
    Vec6 own = V;
    joint_of_dof_.insert(joint_of_dof_.end(), joint.nv, k);
    for (int i = joint.iv; i < joint.iv + joint.nv; ++i) {
      const Twist axis = joint_axis(joint, i - joint.iv);
      const Vec3 turn = places_[k].R_WJ * axis.ang;
      S_.col(i) << places_[k].R_WJ * axis.lin + places_[k].p_WJ.cross(turn), turn;
      own += v[i] * S_.col(i);
    }
    Vec6 rate = A;
    for (int i = joint.iv; i < joint.iv + joint.nv; ++i) {
      S_rate_.col(i) = cross(own, S_.col(i));
      rate += a[i] * S_.col(i) + v[i] * S_rate_.col(i);
      psi_.col(i) = cross(V, S_.col(i));
      psi_rate_.col(i) = cross(A, S_.col(i)) + cross(V, psi_.col(i));
    }
    twists_.col(k) = own;
    accelerations_.col(k) = rate;
  }
}

std::vector<int> TreeMotion::dofs_below(int joint) const {
  std::vector<int> dofs;
  for (int k = joint; k > 0; k = model_.joints[k].parent)
    for (int i = model_.joints[k].iv; i < model_.joints[k].iv + model_.joints[k].nv; ++i) dofs.push_back(i);
  return dofs;
}

PointMotion TreeMotion::point(int joint, const Vec3& x) const {
  const Mat3X none = Mat3X::Zero(3, model_.nv);
  const Vec3 still = Vec3::Zero();
  PointMotion result{x, still, still, none, none, none, none};
  if (joint == 0) return result;
  const Vec6 V = twists_.col(joint), A = accelerations_.col(joint);
  const Vec3 place = places_[joint].R_WJ * x + places_[joint].p_WJ, w = V.tail<3>(), turn = A.tail<3>();
  const Vec3 velocity = linear_at(place, V);
  result.place = place;
  result.velocity = velocity;
  result.acceleration = linear_at(place, A) + w.cross(velocity);
  for (int i : dofs_below(joint)) {
    const Vec6 S = S_.col(i), psi = psi_.col(i);
    const Vec6 V_q = psi - cross(V, S), A_q = psi_rate_.col(i) - cross(A, S) - cross(V, psi);
    const Vec6 A_v = V_q + S_rate_.col(i);
    const Vec3 J = linear_at(place, S);
    const Vec3 velocity_q = linear_at(place, V_q) + w.cross(J);
    result.J.col(i) = J;
    result.velocity_q.col(i) = velocity_q;
    result.acceleration_q.col(i) =
        linear_at(place, A_q) + turn.cross(J) - velocity.cross(V_q.tail<3>()) + w.cross(velocity_q);
    result.acceleration_v.col(i) = linear_at(place, A_v) - velocity.cross(S.tail<3>()) + w.cross(J);
  }
  return result;
}

MatX TreeMotion::turned_force(int joint, const Vec3& x, const Vec3& force) const {
  MatX T = MatX::Zero(model_.nv, model_.nv);
  const Vec3 place = places_[joint].R_WJ * x + places_[joint].p_WJ;
  Vec6 wrench;
  wrench << force, place.cross(force);
  const std::vector<int> chain = dofs_below(joint);
  for (int k : chain) {
    const Vec3 arm = force.cross(Vec3(S_.col(k).tail<3>()));
    for (int i : chain) {
      // Of the displacement of the point along S_i; and of S_i x S_k, where dof i moves the subspace of dof k.
      T(k, i) = arm.dot(linear_at(place, S_.col(i)));
      if (joint_of_dof_[i] <= joint_of_dof_[k]) T(k, i) -= S_.col(k).dot(cross_dual(S_.col(i), wrench));
    }
  }
  return T;
}

void TreeMotion::force_derivatives(MatX& by_q, MatX& by_v) const {
  const int n = static_cast<int>(model_.joints.size());
  by_q.setZero(model_.nv, model_.nv);
  by_v.setZero(model_.nv, model_.nv);
  Vec6 gravity = Vec6::Zero();
  gravity.head<3>() = -model_.gravity;  // the world accelerates against it
  Mat6X psi_rate = psi_rate_;
  for (int i = 0; i < model_.nv; ++i) psi_rate.col(i) += cross(gravity, S_.col(i));
  const Mat6X by_speed = psi_ + S_rate_;
  std::vector<Mat6> inertias(n, Mat6::Zero()), bodies(n, Mat6::Zero());
  Mat6X forces = Mat6X::Zero(6, n);
  for (int k = n - 1; k > 0; --k) {
    const PublicJoint& joint = model_.joints[k];
    const Mat6 own = inertia_in_world(joint, places_[k]), V = cross_matrix(twists_.col(k));
    const Vec6 momentum = own * twists_.col(k);
    inertias[k] += own;
    bodies[k] += force_matrix(momentum) - V.transpose() * own - own * V;
    forces.col(k) += own * (accelerations_.col(k) + gravity) - V.transpose() * momentum;
    const Mat6 &I = inertias[k], &B = bodies[k];
    const std::vector<int> chain = dofs_below(k);
    for (int i = joint.iv; i < joint.iv + joint.nv; ++i) {
      const Vec6 S = S_.col(i), IS = I * S, BS = B.transpose() * S;
      const Vec6 turned = I * psi_rate.col(i) + B * psi_.col(i) + cross_dual(S, forces.col(k));
      const Vec6 sped = I * by_speed.col(i) + B * S;
      for (int j : chain) {
        by_q(i, j) = IS.dot(psi_rate.col(j)) + BS.dot(psi_.col(j));
        by_v(i, j) = IS.dot(by_speed.col(j)) + BS.dot(S_.col(j));
        if (j >= joint.iv) continue;  // one of its own
        by_q(j, i) = S_.col(j).dot(turned);
        by_v(j, i) = S_.col(j).dot(sped);
      }
    }
    inertias[joint.parent] += I;
    bodies[joint.parent] += B;
    forces.col(joint.parent) += forces.col(k);
  }
}

}  // namespace contactvi
