#include "sensitivity/recorded_run.hpp"

#include "base/gauss.hpp"

namespace contactvi {

MatX stage_velocities(const Tree& tree, const MatX& rates, double h) {
  const int s = static_cast<int>(rates.cols());
  const GaussTable& table = gauss_table(s);
  MatX v = rates;
  for (const Joint& joint : tree.joints) {
    if (joint.type != JointType::kSpherical) continue;
    for (int i = 0; i < s; ++i) {
      Vec3 X = Vec3::Zero();
      for (int j = 0; j < s; ++j) X += h * table.A[i][j] * rates.block<3, 1>(joint.iv, j);
      const So3Coefficients k = so3_coefficients(X.squaredNorm());
      v.block<3, 1>(joint.iv, i) = so3_apply(-X, k.cos_t, k.cub_t, rates.block<3, 1>(joint.iv, i));
    }
  }
  return v;
}

}  // namespace contactvi
