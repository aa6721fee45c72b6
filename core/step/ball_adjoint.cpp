#include "step/ball_adjoint.hpp"

#include <algorithm>

namespace contactvi {

namespace {

#include "lanes/lane_math.hpp"

using Vector = V3<double>;

Vector to_lane(const Vec3& x) { return {x[0], x[1], x[2]}; }
Vec3 from_lane(Vector x) { return {x.x, x.y, x.z}; }
V3<Dual<double>> constant(Vector x) { return {{x.x, 0.0}, {x.y, 0.0}, {x.z, 0.0}}; }

Vector unit(int d) { return {d == 0 ? 1.0 : 0.0, d == 1 ? 1.0 : 0.0, d == 2 ? 1.0 : 0.0}; }

// The matrix of a linear function.
template <class F>
Mat3 matrix(F f) {
  Mat3 A;
  for (int d = 0; d < 3; ++d) A.col(d) = from_lane(f(unit(d)));
  return A;
}

// Rotations about X with their derivatives in its three numbers, and the derivative of f(rotation).
using Turn = Rotation<Dual<double>>;
struct Turns {
  Turn along[3];
  explicit Turns(Vector X) {
    for (int d = 0; d < 3; ++d) {
      const Vector e = unit(d);
      along[d] = rotation(V3<Dual<double>>{{X.x, e.x}, {X.y, e.y}, {X.z, e.z}});
    }
  }
  template <class F>
  Mat3 derivative(F f) const {
    Mat3 A;
    for (int d = 0; d < 3; ++d) {
      const V3<Dual<double>> y = f(along[d]);
      A.col(d) = Vec3(y.x.d, y.y.d, y.z.d);
    }
    return A;
  }
};

}  // namespace

BallAdjoint::BallAdjoint(int dof, int stages) : dof_(dof), at_(stages), hb_(stages), system_(3 * stages, 3 * stages) {}

Vec3 BallAdjoint::get(const double* array, int i) const { return {array[i], array[S_ + i], array[2 * S_ + i]}; }

// Padding lanes repeat the last stage.
void BallAdjoint::put(double* array, int i, const Vec3& x) const {
  const int s = static_cast<int>(at_.size());
  for (int k = i; k < (i + 1 == s ? S_ : i + 1); ++k)
    for (int d = 0; d < 3; ++d) array[d * S_ + k] = x[d];
}

void BallAdjoint::take(const Stages& stages, const VecX& p0) {
  S_ = stages.padded();
  const int s = stages.count(), row = dof_ * S_;
  const double h = stages.length();
  const GaussTable& table = stages.table();
  Vec3 X1 = Vec3::Zero(), total = p0.segment<3>(dof_), start = Vec3::Zero();
  std::vector<Turns> turns;
  turns.reserve(s);
  for (int i = 0; i < s; ++i) {
    Stage& at = at_[i];
    hb_[i] = h * table.b[i];
    const Vector X = to_lane(get(stages.X() + row, i)), v = to_lane(get(stages.v() + row, i));
    const Vector P = to_lane(get(stages.P() + row, i)), G = to_lane(get(stages.G() + row, i));
    const Turns& moving = turns.emplace_back(X);
    const Rotation<double> k = rotation(X);
    const Vector rate = jacobian_inverse(k, v), force = G + cross(P, v);
    at.J = matrix([&](Vector e) { return jacobian_transpose(k, e); }).transpose();
    at.J_inverse = matrix([&](Vector e) { return jacobian_inverse(k, e); });
    at.turn = matrix([&](Vector e) { return exp_apply(k, e); });
    at.force_P =
        matrix([&](Vector e) { return jacobian_transpose(k, cross(e, v)) + jacobian_rate_transpose(k, rate, e); });
    at.force_v = matrix([&](Vector e) {
      return jacobian_transpose(k, cross(P, e)) + jacobian_rate_transpose(k, jacobian_inverse(k, e), P);
    });
    at.rate_X = moving.derivative([&](const Turn& t) { return jacobian_inverse(t, constant(v)); });
    at.Y_X = moving.derivative([&](const Turn& t) { return exp_apply(t, constant(G)); });
    at.force_X = moving.derivative([&](const Turn& t) {
      return jacobian_transpose(t, constant(force)) +
             jacobian_rate_transpose(t, jacobian_inverse(t, constant(v)), constant(P));
    });
    at.rate = from_lane(rate);
    at.Y = at.turn * from_lane(G);
    at.px_rate = from_lane(jacobian_transpose(k, force) + jacobian_rate_transpose(k, rate, P));
    X1 += hb_[i] * at.rate;
    total += hb_[i] * at.Y;
    start -= hb_[i] * at.px_rate;
  }
  const Rotation<double> k = rotation(to_lane(X1));
  end_J_ = matrix([&](Vector e) { return jacobian_transpose(k, e); }).transpose();
  end_turn_ = matrix([&](Vector e) { return exp_apply(k, e); });
  p1_ = end_turn_.transpose() * total;
  start_X_ =
      Turns(to_lane(X1)).derivative([&](const Turn& t) { return jacobian_transpose(t, constant(to_lane(p1_))); });
  start += end_J_.transpose() * p1_;
  system_.setIdentity();
  for (int i = 0; i < s; ++i) {
    Vec3 px = start;
    for (int j = 0; j < s; ++j) px += h * table.A[i][j] * at_[j].px_rate;
    at_[i].p_X =
        turns[i].derivative([&](const Turn& t) { return jacobian_inverse_transpose(t, constant(to_lane(px))); });
    for (int j = 0; j < s; ++j) system_.block<3, 3>(3 * i, 3 * j) -= h * table.A[j][i] * at_[i].rate_X.transpose();
  }
  charts_.compute(system_);
}

void BallAdjoint::chart_momenta(const double* mu, double* px_bar) const {
  for (std::size_t i = 0; i < at_.size(); ++i) put(px_bar, i, at_[i].J_inverse * get(mu, i));
}

void BallAdjoint::forces(const double* mu, const double* px_bar, const double* sums, const Vec3& lq, const Vec3& lp,
                         double* P_bar, double* G_bar) {
  Vec3 start_bar = Vec3::Zero();
  for (std::size_t i = 0; i < at_.size(); ++i) start_bar += get(px_bar, i);
  const Vec3 p1_bar = lp + end_J_ * start_bar;
  total_bar_ = end_turn_ * p1_bar;
  X1_bar_ = end_J_.transpose() * (lq + p1_bar.cross(p1_)) + start_X_.transpose() * start_bar;
  for (std::size_t i = 0; i < at_.size(); ++i) {
    Stage& at = at_[i];
    const Vec3 m = get(mu, i), Y_bar = hb_[i] * total_bar_, bar = get(sums, i) - hb_[i] * start_bar;
    at.px_rate_bar = bar;
    at.v_bar = at.force_v.transpose() * bar;
    at.X_bar = at.force_X.transpose() * bar + at.Y_X.transpose() * Y_bar + at.p_X.transpose() * m;
    put(P_bar, i, at.force_P.transpose() * bar - m);
    put(G_bar, i, at.J * bar + at.turn.transpose() * Y_bar);
  }
}

void BallAdjoint::into_chart(const double* turn, double* X) const {
  for (std::size_t i = 0; i < at_.size(); ++i) put(X, i, at_[i].J_inverse * get(turn, i));
}

void BallAdjoint::charts(const double* turn_bar, double* X_bar) const {
  VecX bar(system_.rows());
  for (std::size_t i = 0; i < at_.size(); ++i)
    bar.segment<3>(3 * i) =
        at_[i].X_bar + at_[i].J.transpose() * get(turn_bar, i) + at_[i].rate_X.transpose() * (hb_[i] * X1_bar_);
  bar = charts_.solve(bar).eval();
  for (std::size_t i = 0; i < at_.size(); ++i) put(X_bar, i, bar.segment<3>(3 * i));
}

void BallAdjoint::velocities(const double* sums, double* v_bar) const {
  for (std::size_t i = 0; i < at_.size(); ++i) {
    const Stage& at = at_[i];
    put(v_bar, i, get(v_bar, i) + at.v_bar + at.J_inverse.transpose() * (get(sums, i) + hb_[i] * X1_bar_));
  }
}

void BallAdjoint::start(const double* turn_bar, const Vec3& lq, Vec3& lq0, Vec3& lp0) const {
  lq0 = end_turn_ * lq;
  for (std::size_t i = 0; i < at_.size(); ++i) lq0 += at_[i].turn * get(turn_bar, i);
  lp0 = total_bar_;
}

double BallAdjoint::length(const double* sums) const {
  double total = 0.0;
  for (std::size_t i = 0; i < at_.size(); ++i) {
    const Stage& at = at_[i];
    total +=
        (get(sums, i) + hb_[i] * X1_bar_).dot(at.rate) + at.px_rate_bar.dot(at.px_rate) + hb_[i] * total_bar_.dot(at.Y);
  }
  return total;
}

}  // namespace contactvi
