#include "step/ball_chart.hpp"

namespace contactvi {

namespace {

// a = (1 - cos theta)/theta^2 and b = (theta - sin theta)/theta^3 with their derivatives by t = theta^2, as power
// series that are good to theta = 4: the last term is below 1e-20 of the first there.
struct Coefficients {
  double a[3], b[3];
};

constexpr int kTerms = 20;

struct InverseFactorials {
  double of[2 * kTerms + 2] = {1.0};
  InverseFactorials() {
    for (int k = 1; k < 2 * kTerms + 2; ++k) of[k] = of[k - 1] / k;
  }
};

Coefficients coefficients(double t) {
  static const InverseFactorials inverse_factorial;
  Coefficients c = {};
  const int terms = t < 1.0 ? kTerms / 2 : kTerms;  // to theta = 1 half of them leave out no more
  for (int k = terms - 1; k >= 0; --k) {
    const double sign = k % 2 == 0 ? 1.0 : -1.0;
    const auto horner = [t](double* value, double coefficient) {
      value[2] = 2.0 * value[1] + t * value[2];
      value[1] = value[0] + t * value[1];
      value[0] = coefficient + t * value[0];
    };
    horner(c.a, sign * inverse_factorial.of[2 * k + 2]);
    horner(c.b, sign * inverse_factorial.of[2 * k + 3]);
  }
  return c;
}

// d(y + sign a X x y + b X x (X x y))/dX
Mat3 change(const Coefficients& c, double sign, const Vec3& X, const Vec3& y) {
  const Vec3 once = X.cross(y), twice = X.cross(once);
  Mat3 sum = -sign * c.a[0] * skew(y) + (2.0 * sign * c.a[1]) * once * X.transpose();
  sum += c.b[0] * (X.dot(y) * Mat3::Identity() + X * y.transpose() - 2.0 * y * X.transpose());
  sum += (2.0 * c.b[1]) * twice * X.transpose();
  return sum;
}

Mat3 jacobian(const Coefficients& c, const Vec3& X) {
  const Mat3 turn = skew(X);
  return Mat3::Identity() - c.a[0] * turn + c.b[0] * turn * turn;
}

// d2(P . J u)/dX2: P . J u = u.P - a X.(u x P) + b ((X.u)(X.P) - |X|^2 u.P)
Mat3 second(const Coefficients& c, const Vec3& X, const Vec3& u, const Vec3& P) {
  const Vec3 w = u.cross(P), g = u * X.dot(P) + P * X.dot(u) - 2.0 * u.dot(P) * X;
  const double along = X.dot(w), form = X.dot(u) * X.dot(P) - X.squaredNorm() * u.dot(P);
  const Mat3 I = Mat3::Identity(), XX = X * X.transpose(), Xw = X * w.transpose(), Xg = X * g.transpose();
  const Mat3 uP = u * P.transpose();
  Mat3 sum = -4.0 * c.a[2] * along * XX - 2.0 * c.a[1] * (along * I + Xw + Xw.transpose());
  sum += 4.0 * c.b[2] * form * XX + 2.0 * c.b[1] * (form * I + Xg + Xg.transpose());
  sum += c.b[0] * (uP + uP.transpose() - 2.0 * u.dot(P) * I);
  return sum;
}

}  // namespace

BallChart::BallChart(const Vec3& X, const Vec3& v, const Vec3& P, const Vec3& G) {
  const Coefficients c = coefficients(X.squaredNorm());
  J = jacobian(c, X);
  u = so3_right_jacobian_inverse(X) * v;
  R = so3_exp(X).toRotationMatrix();
  E = change(c, -1.0, X, u);
  H = change(c, 1.0, X, P);
  N = change(c, 1.0, X, G) + second(c, X, u, P);
  P_x = J.transpose() * P;
  G_x = J.transpose() * G + E.transpose() * P;
}

Mat3 so3_right_jacobian(const Vec3& X) { return jacobian(coefficients(X.squaredNorm()), X); }

Mat3 so3_right_jacobian_change(const Vec3& X, const Vec3& y) {
  return change(coefficients(X.squaredNorm()), -1.0, X, y);
}

}  // namespace contactvi
