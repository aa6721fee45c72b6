// What a step makes of a spherical joint at its two ends.
#pragma once

#include "base/numerics.hpp"

namespace contactvi {

using RowMat3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

// The rotation from which the joint's chart starts; C: of the flat model's joint, row-major; quat: x y z w.
inline void start_ball(const double* C, const Quat& quat, double* base) {
  Eigen::Map<RowMat3> B(base);
  const Eigen::Map<const RowMat3> turn(C);
  B.noalias() = turn * quat.toRotationMatrix();
}

// The joint's quaternion where its chart has come to X1.
inline Quat end_ball(const Quat& start, const Vec3& X1) { return (start * so3_exp(X1)).normalized(); }

// Its momentum there: of `total`, which is that of the start and all impulses in the frame of the start.
inline Vec3 end_ball_momentum(const Vec3& X1, const Vec3& total) {
  const So3Coefficients k = so3_coefficients(X1.squaredNorm());
  return so3_apply(-X1, k.sin_t, k.cos_t, total);
}

}  // namespace contactvi
