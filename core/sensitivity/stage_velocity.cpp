#include "sensitivity/stage_velocity.hpp"

#include "base/numerics.hpp"
#include "step/path.hpp"

namespace contactvi {

void fold_velocity(const Tree& tree, double h, const VecX& v, const VecX& lv, VecX& lq0, VecX& lq1, double& lh) {
  lh -= v.dot(lv) / h;
  for (const Joint& joint : tree.joints) {
    const int iv = joint.iv;
    if (joint.type != JointType::kSpherical) {
      lq1.segment(iv, joint.nv) += lv.segment(iv, joint.nv) / h;
      lq0.segment(iv, joint.nv) -= lv.segment(iv, joint.nv) / h;
      continue;
    }
    const Vec3 X = h * v.segment<3>(iv);
    const So3Coefficients k = so3_coefficients(X.squaredNorm());
    Mat3 J, back;
    for (int c = 0; c < 3; ++c) {
      J.col(c) = so3_apply(-X, k.cos_t, k.cub_t, Vec3::Unit(c));
      back.col(c) = so3_apply(-X, k.sin_t, k.cos_t, Vec3::Unit(c));
    }
    const Vec3 l = J.transpose().inverse() * lv.segment<3>(iv) / h;
    lq1.segment<3>(iv) += l;
    lq0.segment<3>(iv) -= back.transpose() * l;
  }
}

}  // namespace contactvi
