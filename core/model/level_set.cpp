#include "model/level_set.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "model/cubic_splines.hpp"

namespace contactvi {

namespace {

// A function of a place with its first and second derivatives: rules of sums, products and chains.
struct Jet {
  double f = 0.0;
  Vec3 g = Vec3::Zero();
  Mat3 h = Mat3::Zero();

  static Jet coordinate(const Vec3& x, int axis) { return {x[axis], Vec3::Unit(axis), Mat3::Zero()}; }
  // u(f), of which u, u' and u'' are known.
  Jet chain(double u, double first, double second) const {
    return {u, first * g, second * g * g.transpose() + first * h};
  }
};

Jet operator+(const Jet& a, const Jet& b) { return {a.f + b.f, a.g + b.g, a.h + b.h}; }
Jet operator-(const Jet& a, double b) { return {a.f - b, a.g, a.h}; }
Jet operator*(double b, const Jet& a) { return {b * a.f, b * a.g, b * a.h}; }
Jet square(const Jet& a) { return a.chain(a.f * a.f, 2.0 * a.f, 2.0); }
Jet root(const Jet& a) {
  const double u = std::sqrt(a.f);
  return a.chain(u, 0.5 / u, -0.25 / (u * a.f));
}
Jet power(const Jet& a, double n) {
  const double size = std::abs(a.f), sign = a.f < 0.0 ? -1.0 : 1.0;
  return a.chain(std::pow(size, n), sign * n * std::pow(size, n - 1.0), n * (n - 1.0) * std::pow(size, n - 2.0));
}

class Torus final : public LevelSet {
 public:
  Torus(double ring, double tube) : ring_(ring), tube_(tube) {}

  Value at(const Vec3& p) const override {
    const Jet x = Jet::coordinate(p, 0), y = Jet::coordinate(p, 1), z = Jet::coordinate(p, 2);
    const Jet d = root(square(root(square(x) + square(y)) - ring_) + square(z)) - tube_;
    return {d.f, d.g, d.h};
  }

 private:
  double ring_, tube_;
};

class Superellipsoid final : public LevelSet {
 public:
  Superellipsoid(const Vec3& radii, double exponent) : radii_(radii), exponent_(exponent) {}

  Value at(const Vec3& p) const override {
    Jet sum;
    for (int axis = 0; axis < 3; ++axis) sum = sum + power((1.0 / radii_[axis]) * Jet::coordinate(p, axis), exponent_);
    const Jet d = radii_.minCoeff() * (power(sum, 1.0 / exponent_) - 1.0);
    return {d.f, d.g, d.h};
  }

 private:
  Vec3 radii_;
  double exponent_;
};

class Thread final : public LevelSet {
 public:
  Thread(double radius, double depth, double pitch) : radius_(radius), depth_(depth), pitch_(pitch) {}

  Value at(const Vec3& p) const override {
    const Jet x = Jet::coordinate(p, 0), y = Jet::coordinate(p, 1), z = Jet::coordinate(p, 2);
    const Jet out = root(square(x) + square(y));
    const double below = out.f * out.f, fourth = below * below;
    Jet angle{std::atan2(p[1], p[0]), Vec3(-p[1], p[0], 0.0) / below, Mat3::Zero()};
    angle.h(0, 0) = 2.0 * p[0] * p[1] / fourth;
    angle.h(1, 1) = -angle.h(0, 0);
    angle.h(0, 1) = angle.h(1, 0) = (p[1] * p[1] - p[0] * p[0]) / fourth;
    const Jet turn = angle + (-2.0 * M_PI / pitch_) * z;
    const double sine = std::sin(turn.f), cosine = std::cos(turn.f);
    const Jet d = out - radius_ + (-depth_) * turn.chain(cosine, -sine, -cosine);
    return {d.f, d.g, d.h};
  }

 private:
  double radius_, depth_, pitch_;
};

class SplineLevelSet final : public LevelSet {
 public:
  SplineLevelSet(std::vector<double> coefficients, const Eigen::Vector3i& counts, const Vec3& corner,
                 const Vec3& spacing)
      : coefficients_(std::move(coefficients)), counts_(counts), corner_(corner), spacing_(spacing) {}

  Value at(const Vec3& p) const override {
    const Vec3 place = (p - corner_).cwiseQuotient(spacing_);
    const Eigen::Vector3i cells = counts_.array() - 3;
    if (!(place.array() >= 0.0).all() || !(place.array() <= cells.cast<double>().array()).all())
      return {kNaN, Vec3::Constant(kNaN), Mat3::Constant(kNaN)};
    const Eigen::Vector3i cell = place.cast<int>().cwiseMin((cells.array() - 1).matrix());
    const CubicSplines x(place[0] - cell[0]), y(place[1] - cell[1]), z(place[2] - cell[2]);
    // Along z, then y, then x: rows of the derivatives that each of them has.
    Eigen::Matrix<double, 10, 1> sum = Eigen::Matrix<double, 10, 1>::Zero();
    for (int i = 0; i < 4; ++i) {
      Eigen::Matrix<double, 6, 1> plane = Eigen::Matrix<double, 6, 1>::Zero();  // f, y, z, yy, yz, zz
      for (int j = 0; j < 4; ++j) {
        const Eigen::Map<const Eigen::Vector4d> row(&coefficients_[row_at(cell[0] + i, cell[1] + j, cell[2])]);
        const double value = row.dot(z.value), first = row.dot(z.first), second = row.dot(z.second);
        plane[0] += y.value[j] * value;
        plane[1] += y.first[j] * value;
        plane[2] += y.value[j] * first;
        plane[3] += y.second[j] * value;
        plane[4] += y.first[j] * first;
        plane[5] += y.value[j] * second;
      }
      sum.head<6>() += x.value[i] * plane;
      sum.segment<3>(6) += x.first[i] * plane.head<3>();  // x, xy, xz
      sum[9] += x.second[i] * plane[0];                   // xx
    }
    const Vec3 s = spacing_.cwiseInverse();
    Value v;
    v.f = sum[0];
    v.gradient << s[0] * sum[6], s[1] * sum[1], s[2] * sum[2];
    v.hessian << s[0] * s[0] * sum[9], s[0] * s[1] * sum[7], s[0] * s[2] * sum[8],  //
        s[0] * s[1] * sum[7], s[1] * s[1] * sum[3], s[1] * s[2] * sum[4],           //
        s[0] * s[2] * sum[8], s[1] * s[2] * sum[4], s[2] * s[2] * sum[5];
    return v;
  }

 private:
  std::size_t row_at(int i, int j, int k) const {
    return (static_cast<std::size_t>(i) * static_cast<std::size_t>(counts_[1]) + static_cast<std::size_t>(j)) *
               static_cast<std::size_t>(counts_[2]) +
           static_cast<std::size_t>(k);
  }

  std::vector<double> coefficients_;
  Eigen::Vector3i counts_;
  Vec3 corner_, spacing_;
};

}  // namespace

std::unique_ptr<const LevelSet> torus(double ring, double tube) { return std::make_unique<Torus>(ring, tube); }

std::unique_ptr<const LevelSet> superellipsoid(const Vec3& radii, double exponent) {
  return std::make_unique<Superellipsoid>(radii, exponent);
}

std::unique_ptr<const LevelSet> thread(double radius, double depth, double pitch) {
  return std::make_unique<Thread>(radius, depth, pitch);
}

std::unique_ptr<const LevelSet> spline_level_set(std::vector<double> coefficients, const Eigen::Vector3i& counts,
                                                 const Vec3& corner, const Vec3& spacing) {
  return std::make_unique<SplineLevelSet>(std::move(coefficients), counts, corner, spacing);
}

}  // namespace contactvi
