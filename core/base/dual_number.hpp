// Numbers with a derivative along one direction, x + d eps with eps^2 = 0, as a scalar of Eigen: functions written for
// any scalar give with them their values and their derivatives. The stage kernel has its own, of vectors of lanes
// (lanes/lane_dual.hpp).
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace contactvi {

struct DualNumber {
  double x = 0.0, d = 0.0;

  DualNumber() = default;
  DualNumber(double value) : x(value) {}  // a constant; implicit, as numbers are where scalars are mixed
  DualNumber(double value, double derivative) : x(value), d(derivative) {}

  DualNumber& operator+=(const DualNumber& b) {
    x += b.x;
    d += b.d;
    return *this;
  }
  DualNumber& operator-=(const DualNumber& b) {
    x -= b.x;
    d -= b.d;
    return *this;
  }
  DualNumber& operator*=(const DualNumber& b) {
    d = d * b.x + x * b.d;
    x *= b.x;
    return *this;
  }
  DualNumber& operator/=(const DualNumber& b) {
    x /= b.x;
    d = (d - x * b.d) / b.x;
    return *this;
  }
};

inline DualNumber operator-(const DualNumber& a) { return {-a.x, -a.d}; }
inline DualNumber operator+(DualNumber a, const DualNumber& b) { return a += b; }
inline DualNumber operator-(DualNumber a, const DualNumber& b) { return a -= b; }
inline DualNumber operator*(DualNumber a, const DualNumber& b) { return a *= b; }
inline DualNumber operator/(DualNumber a, const DualNumber& b) { return a /= b; }
inline bool operator==(const DualNumber& a, const DualNumber& b) { return a.x == b.x && a.d == b.d; }
inline bool operator!=(const DualNumber& a, const DualNumber& b) { return !(a == b); }
inline DualNumber sqrt(const DualNumber& a) {
  const double root = std::sqrt(a.x);
  return {root, a.d / (2.0 * root)};
}

using Dual3 = Eigen::Matrix<DualNumber, 3, 1>;
using DualMat3 = Eigen::Matrix<DualNumber, 3, 3>;
using DualX = Eigen::Matrix<DualNumber, Eigen::Dynamic, 1>;
using DualMatX = Eigen::Matrix<DualNumber, Eigen::Dynamic, Eigen::Dynamic>;

// From values and derivatives, and the two of them again.
template <class X, class D>
auto dual(const Eigen::MatrixBase<X>& x, const Eigen::MatrixBase<D>& d) {
  using Plain = Eigen::Matrix<DualNumber, X::RowsAtCompileTime, X::ColsAtCompileTime>;
  Plain a(x.rows(), x.cols());
  for (Eigen::Index i = 0; i < x.rows(); ++i)
    for (Eigen::Index k = 0; k < x.cols(); ++k) a(i, k) = DualNumber(x(i, k), d(i, k));
  return a;
}
template <class A>
auto value(const Eigen::MatrixBase<A>& a) {
  Eigen::Matrix<double, A::RowsAtCompileTime, A::ColsAtCompileTime> x(a.rows(), a.cols());
  for (Eigen::Index i = 0; i < a.rows(); ++i)
    for (Eigen::Index k = 0; k < a.cols(); ++k) x(i, k) = a(i, k).x;
  return x;
}
template <class A>
auto derivative(const Eigen::MatrixBase<A>& a) {
  Eigen::Matrix<double, A::RowsAtCompileTime, A::ColsAtCompileTime> d(a.rows(), a.cols());
  for (Eigen::Index i = 0; i < a.rows(); ++i)
    for (Eigen::Index k = 0; k < a.cols(); ++k) d(i, k) = a(i, k).d;
  return d;
}

}  // namespace contactvi

namespace Eigen {
template <>
struct NumTraits<contactvi::DualNumber> : NumTraits<double> {
  using Real = contactvi::DualNumber;
  using NonInteger = contactvi::DualNumber;
  using Nested = contactvi::DualNumber;
  using Literal = double;
  enum {
    RequireInitialization = 1,
    ReadCost = 2,
    AddCost = 2,
    MulCost = 6,
    IsComplex = 0,
    IsInteger = 0,
    IsSigned = 1
  };
};
template <class Op>
struct ScalarBinaryOpTraits<contactvi::DualNumber, double, Op> {
  using ReturnType = contactvi::DualNumber;
};
template <class Op>
struct ScalarBinaryOpTraits<double, contactvi::DualNumber, Op> {
  using ReturnType = contactvi::DualNumber;
};
}  // namespace Eigen
