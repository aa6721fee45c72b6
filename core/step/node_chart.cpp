#include "step/node_chart.hpp"

#include <Eigen/LU>

#include "step/ball_chart.hpp"

namespace contactvi {

NodeChart::NodeChart(const Tree& tree) {
  for (const Joint& joint : tree.joints)
    if (joint.type == JointType::kSpherical)
      balls_.push_back({joint.iv, Vec3::Zero(), Mat3::Identity(), Mat3::Identity()});
}

void NodeChart::take(const VecCRef& X) {
  for (Ball& ball : balls_) {
    ball.X = X.segment<3>(ball.iv);
    ball.J = so3_right_jacobian(ball.X);
    ball.R = so3_exp(ball.X).toRotationMatrix();
  }
}

VecX NodeChart::turn(const VecX& dX, const VecX& dq0) const {
  VecX dq = dX + dq0;
  for (const Ball& ball : balls_)
    dq.segment<3>(ball.iv) = ball.J * dX.segment<3>(ball.iv) + ball.R.transpose() * dq0.segment<3>(ball.iv);
  return dq;
}

VecX NodeChart::by_chart(const VecX& g) const {
  VecX found = g;
  for (const Ball& ball : balls_) found.segment<3>(ball.iv) = ball.J.transpose() * g.segment<3>(ball.iv);
  return found;
}

// J(X)^T = J(-X).
VecX NodeChart::by_chart_change(const VecX& g, const VecX& dg, const VecX& dX) const {
  VecX found = dg;
  for (const Ball& ball : balls_)
    found.segment<3>(ball.iv) = ball.J.transpose() * dg.segment<3>(ball.iv) -
                                so3_right_jacobian_change(-ball.X, g.segment<3>(ball.iv)) * dX.segment<3>(ball.iv);
  return found;
}

VecX NodeChart::at_start(const VecX& g) const {
  VecX found = g;
  for (const Ball& ball : balls_) found.segment<3>(ball.iv) = ball.R * g.segment<3>(ball.iv);
  return found;
}

VecX NodeChart::at_start_change(const VecX& g, const VecX& dg, const VecX& dX) const {
  VecX found = dg;
  for (const Ball& ball : balls_) {
    const Vec3 turn = ball.J * dX.segment<3>(ball.iv), own = g.segment<3>(ball.iv);
    found.segment<3>(ball.iv) = ball.R * (dg.segment<3>(ball.iv) + turn.cross(own));
  }
  return found;
}

VecX NodeChart::velocity(const VecX& u) const {
  VecX v = u;
  for (const Ball& ball : balls_) v.segment<3>(ball.iv) = ball.J * u.segment<3>(ball.iv);
  return v;
}

VecX NodeChart::rate(const VecX& v) const {
  VecX u = v;
  for (const Ball& ball : balls_) u.segment<3>(ball.iv) = ball.J.inverse() * v.segment<3>(ball.iv);
  return u;
}

VecX NodeChart::rate_transposed(const VecX& lu) const {
  VecX lv = lu;
  for (const Ball& ball : balls_) lv.segment<3>(ball.iv) = ball.J.transpose().inverse() * lu.segment<3>(ball.iv);
  return lv;
}

VecX NodeChart::velocity_change(const VecX& u, const VecX& du, const VecX& dX) const {
  VecX dv = du;
  for (const Ball& ball : balls_)
    dv.segment<3>(ball.iv) = ball.J * du.segment<3>(ball.iv) +
                             so3_right_jacobian_change(ball.X, u.segment<3>(ball.iv)) * dX.segment<3>(ball.iv);
  return dv;
}

}  // namespace contactvi
