#include "step/ball_adjoint.hpp"

#include <algorithm>

namespace contactvi {

namespace {

#include "lanes/lane_math.hpp"

template <>
struct Lane<DualNumber> {
  static const int count = 1;
  static DualNumber all(double x) { return x; }
};

template <class T>
V3<T> to_lane(const Eigen::Matrix<T, 3, 1>& x) {
  return {x[0], x[1], x[2]};
}
template <class T>
Eigen::Matrix<T, 3, 1> from_lane(V3<T> x) {
  return {x.x, x.y, x.z};
}
template <class T>
V3<Dual<T>> constant(V3<T> x) {
  return {{x.x, T(0.0)}, {x.y, T(0.0)}, {x.z, T(0.0)}};
}
template <class T>
V3<T> unit(int d) {
  return {T(d == 0 ? 1.0 : 0.0), T(d == 1 ? 1.0 : 0.0), T(d == 2 ? 1.0 : 0.0)};
}

// The matrix of a linear function.
template <class T, class F>
Eigen::Matrix<T, 3, 3> matrix_of(F f) {
  Eigen::Matrix<T, 3, 3> A;
  for (int d = 0; d < 3; ++d) A.col(d) = from_lane<T>(f(unit<T>(d)));
  return A;
}

// Rotations about X with their derivatives in its three numbers, and the derivative of f(rotation).
template <class T>
struct Turns {
  Rotation<Dual<T>> along[3];
  explicit Turns(V3<T> X) {
    for (int d = 0; d < 3; ++d) {
      const V3<T> e = unit<T>(d);
      along[d] = rotation(V3<Dual<T>>{{X.x, e.x}, {X.y, e.y}, {X.z, e.z}});
    }
  }
  template <class F>
  Eigen::Matrix<T, 3, 3> derivative(F f) const {
    Eigen::Matrix<T, 3, 3> A;
    for (int d = 0; d < 3; ++d) {
      const V3<Dual<T>> y = f(along[d]);
      A.col(d) = Eigen::Matrix<T, 3, 1>(y.x.d, y.y.d, y.z.d);
    }
    return A;
  }
};

MatX values_of(const MatX& A) { return A; }
MatX values_of(const DualMatX& A) { return value(A); }

VecX solve_with(const Eigen::PartialPivLU<MatX>& lu, const MatX&, const VecX& b) { return lu.solve(b); }
// x' = A^-1 (b' - A' x)
DualX solve_with(const Eigen::PartialPivLU<MatX>& lu, const DualMatX& A, const DualX& b) {
  const VecX x = lu.solve(value(b));
  const VecX change = lu.solve(derivative(b) - derivative(A) * x);
  return dual(x, change);
}

}  // namespace

template <class T>
BallAdjointOf<T>::BallAdjointOf(int dof, int stages)
    : dof_(dof), at_(stages), hb_(stages), system_(3 * stages, 3 * stages) {}

template <class T>
auto BallAdjointOf<T>::get(const T* array, int i) const -> Vec3T {
  return {array[i], array[S_ + i], array[2 * S_ + i]};
}

// Padding lanes repeat the last stage.
template <class T>
void BallAdjointOf<T>::put(T* array, int i, const Vec3T& x) const {
  const int s = static_cast<int>(at_.size());
  for (int k = i; k < (i + 1 == s ? S_ : i + 1); ++k)
    for (int d = 0; d < 3; ++d) array[d * S_ + k] = x[d];
}

template <class T>
void BallAdjointOf<T>::take(const BallStages<T>& step) {
  S_ = step.padded;
  const int s = static_cast<int>(at_.size());
  const T h = step.h;
  const GaussTable& table = step.table;
  Vec3T X1 = Vec3T::Zero(), total = step.p0, start = Vec3T::Zero();
  std::vector<Turns<T>> turns;
  turns.reserve(s);
  for (int i = 0; i < s; ++i) {
    Stage& at = at_[i];
    hb_[i] = h * table.b[i];
    const V3<T> X = to_lane<T>(get(step.X, i)), v = to_lane<T>(get(step.v, i));
    const V3<T> P = to_lane<T>(get(step.P, i)), G = to_lane<T>(get(step.G, i));
    const Turns<T>& moving = turns.emplace_back(X);
    const Rotation<T> k = rotation(X);
    const V3<T> rate = jacobian_inverse(k, v), force = G + cross(P, v);
    at.J = matrix_of<T>([&](V3<T> e) { return jacobian_transpose(k, e); }).transpose();
    at.J_inverse = matrix_of<T>([&](V3<T> e) { return jacobian_inverse(k, e); });
    at.turn = matrix_of<T>([&](V3<T> e) { return exp_apply(k, e); });
    at.force_P =
        matrix_of<T>([&](V3<T> e) { return jacobian_transpose(k, cross(e, v)) + jacobian_rate_transpose(k, rate, e); });
    at.force_v = matrix_of<T>([&](V3<T> e) {
      return jacobian_transpose(k, cross(P, e)) + jacobian_rate_transpose(k, jacobian_inverse(k, e), P);
    });
    at.rate_X = moving.derivative([&](const Rotation<Dual<T>>& t) { return jacobian_inverse(t, constant(v)); });
    at.Y_X = moving.derivative([&](const Rotation<Dual<T>>& t) { return exp_apply(t, constant(G)); });
    at.force_X = moving.derivative([&](const Rotation<Dual<T>>& t) {
      return jacobian_transpose(t, constant(force)) +
             jacobian_rate_transpose(t, jacobian_inverse(t, constant(v)), constant(P));
    });
    at.rate = from_lane<T>(rate);
    at.Y = at.turn * from_lane<T>(G);
    at.px_rate = from_lane<T>(jacobian_transpose(k, force) + jacobian_rate_transpose(k, rate, P));
    X1 += hb_[i] * at.rate;
    total += hb_[i] * at.Y;
    start -= hb_[i] * at.px_rate;
  }
  const Rotation<T> k = rotation(to_lane<T>(X1));
  end_J_ = matrix_of<T>([&](V3<T> e) { return jacobian_transpose(k, e); }).transpose();
  end_turn_ = matrix_of<T>([&](V3<T> e) { return exp_apply(k, e); });
  p1_ = end_turn_.transpose() * total;
  start_X_ = Turns<T>(to_lane<T>(X1)).derivative([&](const Rotation<Dual<T>>& t) {
    return jacobian_transpose(t, constant(to_lane<T>(p1_)));
  });
  start += end_J_.transpose() * p1_;
  system_.setIdentity();
  for (int i = 0; i < s; ++i) {
    Vec3T px = start;
    for (int j = 0; j < s; ++j) px += h * table.A[i][j] * at_[j].px_rate;
    at_[i].p_X = turns[i].derivative(
        [&](const Rotation<Dual<T>>& t) { return jacobian_inverse_transpose(t, constant(to_lane<T>(px))); });
    for (int j = 0; j < s; ++j)
      system_.template block<3, 3>(3 * i, 3 * j) -= h * table.A[j][i] * at_[i].rate_X.transpose();
  }
  charts_.compute(values_of(system_));
}

template <class T>
void BallAdjointOf<T>::chart_momenta(const T* mu, T* px_bar) const {
  for (std::size_t i = 0; i < at_.size(); ++i) put(px_bar, i, at_[i].J_inverse * get(mu, i));
}

template <class T>
void BallAdjointOf<T>::forces(const T* mu, const T* px_bar, const T* sums, const Vec3T& lq, const Vec3T& lp, T* P_bar,
                              T* G_bar) {
  Vec3T start_bar = Vec3T::Zero();
  for (std::size_t i = 0; i < at_.size(); ++i) start_bar += get(px_bar, i);
  const Vec3T p1_bar = lp + end_J_ * start_bar;
  total_bar_ = end_turn_ * p1_bar;
  X1_bar_ = end_J_.transpose() * (lq + p1_bar.cross(p1_)) + start_X_.transpose() * start_bar;
  for (std::size_t i = 0; i < at_.size(); ++i) {
    Stage& at = at_[i];
    const Vec3T m = get(mu, i), Y_bar = hb_[i] * total_bar_, bar = get(sums, i) - hb_[i] * start_bar;
    at.px_rate_bar = bar;
    at.v_bar = at.force_v.transpose() * bar;
    at.X_bar = at.force_X.transpose() * bar + at.Y_X.transpose() * Y_bar + at.p_X.transpose() * m;
    put(P_bar, i, at.force_P.transpose() * bar - m);
    put(G_bar, i, at.J * bar + at.turn.transpose() * Y_bar);
  }
}

template <class T>
void BallAdjointOf<T>::into_chart(const T* turn, T* X) const {
  for (std::size_t i = 0; i < at_.size(); ++i) put(X, i, at_[i].J_inverse * get(turn, i));
}

template <class T>
void BallAdjointOf<T>::charts(const T* turn_bar, T* X_bar) const {
  Eigen::Matrix<T, Eigen::Dynamic, 1> bar(system_.rows());
  for (std::size_t i = 0; i < at_.size(); ++i)
    bar.template segment<3>(3 * i) =
        at_[i].X_bar + at_[i].J.transpose() * get(turn_bar, i) + at_[i].rate_X.transpose() * (hb_[i] * X1_bar_);
  bar = solve_with(charts_, system_, bar);
  for (std::size_t i = 0; i < at_.size(); ++i) put(X_bar, i, bar.template segment<3>(3 * i));
}

template <class T>
void BallAdjointOf<T>::velocities(const T* sums, T* v_bar) const {
  for (std::size_t i = 0; i < at_.size(); ++i) {
    const Stage& at = at_[i];
    put(v_bar, i, get(v_bar, i) + at.v_bar + at.J_inverse.transpose() * (get(sums, i) + hb_[i] * X1_bar_));
  }
}

template <class T>
void BallAdjointOf<T>::start(const T* turn_bar, const Vec3T& lq, Vec3T& lq0, Vec3T& lp0) const {
  lq0 = end_turn_ * lq;
  for (std::size_t i = 0; i < at_.size(); ++i) lq0 += at_[i].turn * get(turn_bar, i);
  lp0 = total_bar_;
}

template <class T>
T BallAdjointOf<T>::length(const T* sums) const {
  T total = 0.0;
  for (std::size_t i = 0; i < at_.size(); ++i) {
    const Stage& at = at_[i];
    total +=
        (get(sums, i) + hb_[i] * X1_bar_).dot(at.rate) + at.px_rate_bar.dot(at.px_rate) + hb_[i] * total_bar_.dot(at.Y);
  }
  return total;
}

template class BallAdjointOf<double>;
template class BallAdjointOf<DualNumber>;

}  // namespace contactvi
