#include "cone/single_contact.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <limits>

#include "cone/slip_directions.hpp"

namespace contactvi {

namespace {

using Vec2 = Eigen::Vector2d;
using Mat2 = Eigen::Matrix2d;

constexpr double kExact = 64.0 * std::numeric_limits<double>::epsilon();  // relative residual of a mode that is right
constexpr double kSmallestPivot = 1e-7;  // of the largest diagonal: below it a contact counts as singular
constexpr double kImmobile = 1e-4;       // of the largest singular value: below it a contact may be unable to move
constexpr double kAgree = 1e-9;          // of the terms: by which the rows of a singular contact may disagree

class OneContact {
 public:
  OneContact(const ConeContact& c, const Mat3& A, const Vec3& b, double noise, double rough)
      : c_(c), A_(A), b_(b), noise_(noise), rough_(rough) {
    scale_ = std::max(A.diagonal().cwiseAbs().maxCoeff(), std::numeric_limits<double>::min());
  }

  bool solve() { return open() || stick() || slip() || stick_open() || slip_open(); }
  const Vec3& best() const { return best_; }
  bool immobile() const { return immobile_; }

 private:
  // Keeps lambda if it obeys the law better than the best so far; true if it obeys it to rounding.
  bool keep(const Vec3& lambda) {
    const Vec3 w = b_ + A_ * lambda;
    const double size = (b_.cwiseAbs() + A_.cwiseAbs() * lambda.cwiseAbs()).maxCoeff();
    const double z_n = lambda[0] - w[0] / scale_, rho = std::max(c_.lower, z_n), radius = c_.mu * rho;
    const Vec2 z = (lambda - w / scale_).tail<2>();
    const double length = z.norm();
    const Vec2 target = length <= radius ? z : Vec2(radius / length * z);
    const double error = std::max(std::abs(lambda[0] - rho), (lambda.tail<2>() - target).cwiseAbs().maxCoeff());
    const double relative = size > 0.0 ? error * scale_ / size : 0.0;
    if (!(relative < error_)) return false;
    error_ = relative;
    best_ = lambda;
    return relative <= kExact;
  }
  bool open() { return c_.lower == 0.0 && b_[0] >= 0.0 && keep(Vec3::Zero()); }
  bool stick() {
    const Eigen::PartialPivLU<Mat3> lu(A_);
    if (lu.matrixLU().diagonal().cwiseAbs().minCoeff() > kSmallestPivot * scale_) return keep(lu.solve(-b_));
    return stick_immobile();
  }
  // Joints or constraints keep the contact from moving in some direction: of the impulses within the cone that keep it
  // at rest, this finds the least, which is at the edge of the cone where the least of all is outside.
  bool stick_immobile() {
    const Eigen::JacobiSVD<Mat3> svd(A_, Eigen::ComputeFullU | Eigen::ComputeFullV);
    // No more directions than are needed: one that is singular but for rounding would need huge impulses.
    Vec3 lambda = Vec3::Zero();
    for (int rank = 1; rank <= 3 && svd.singularValues()[rank - 1] > 0.0; ++rank) {
      lambda = Vec3::Zero();
      for (int k = 0; k < rank; ++k)
        lambda -= svd.matrixU().col(k).dot(b_) / svd.singularValues()[k] * svd.matrixV().col(k);
      if (rank == 1 && !in_cone(lambda)) lambda = edge_on_plane(svd.matrixV().col(0), svd.matrixV().col(0).dot(lambda));
      if (rank == 2 && !in_cone(lambda)) lambda = edge_on_line(lambda, svd.matrixV().col(2));
      const Vec3 w = b_ + A_ * lambda;
      const double size = (b_.cwiseAbs() + A_.cwiseAbs() * lambda.cwiseAbs()).maxCoeff();
      // While the contact iterations of a step go on, the rows of a singular contact agree only roughly.
      const bool last = rank < 3 && svd.singularValues()[rank] < kImmobile * svd.singularValues()[0];
      const double off = w.cwiseAbs().maxCoeff();
      if (!(off <= std::max(noise_, (last ? std::max(rough_, kAgree) : kAgree) * size)) || !in_cone(lambda)) continue;
      best_ = lambda;
      error_ = 0.0;
      return immobile_ = true;
    }
    return keep(lambda);
  }
  bool in_cone(const Vec3& lambda) const {
    return lambda[0] >= c_.lower && lambda.tail<2>().norm() <= c_.mu * lambda[0] * (1.0 + kExact);
  }
  // Least point of the cone's edge on the plane g.lambda = value.
  Vec3 edge_on_plane(const Vec3& g, double value) const {
    const double across = g.tail<2>().norm();
    const Vec2 u = across > 0.0 ? Vec2(g.tail<2>() / across) : Vec2(Vec2::Zero());
    Vec3 best = Vec3::Zero();
    for (const double side : {1.0, -1.0}) {
      const double lambda_n = value / (g[0] + side * c_.mu * across);
      if (!(lambda_n > 0.0) || (best[0] > 0.0 && lambda_n >= best[0])) continue;
      best = Vec3(lambda_n, side * c_.mu * lambda_n * u[0], side * c_.mu * lambda_n * u[1]);
    }
    return best;
  }
  // Point with the least |s| at which the line from + s n enters the cone.
  Vec3 edge_on_line(const Vec3& from, const Vec3& n) const {
    const double mu2 = c_.mu * c_.mu, a = n.tail<2>().squaredNorm() - mu2 * n[0] * n[0];
    const double b = from.tail<2>().dot(n.tail<2>()) - mu2 * from[0] * n[0];
    const double c = from.tail<2>().squaredNorm() - mu2 * from[0] * from[0], root = b * b - a * c;
    Vec3 best = from;
    double least = std::numeric_limits<double>::infinity();
    if (!(root >= 0.0)) return from;
    const double q = -(b + std::copysign(std::sqrt(root), b));
    for (const double s : {q / a, c / q}) {
      if (!std::isfinite(s) || std::abs(s) >= least || from[0] + s * n[0] < 0.0) continue;
      least = std::abs(s);
      best = from + s * n;
    }
    // Friction beyond the edge by rounding is cut to what the normal impulse allows.
    const double length = best.tail<2>().norm();
    if (length > c_.mu * best[0] && length > 0.0) best.tail<2>() *= c_.mu * best[0] / length;
    return best;
  }
  // w_n = 0 with lambda = lambda_n (1, -mu u): lambda_n = -b_n/(A_nn - mu A_nt u), w_t parallel to u.
  bool slip() {
    const Vec2 across = A_.block<1, 2>(0, 1).transpose(), along = A_.block<2, 1>(1, 0), b_t = b_.tail<2>();
    SlipDirections f;
    f.k = A_(0, 0) * b_t - b_[0] * along;
    f.Q = c_.mu * (b_t * across.transpose() - b_[0] * A_.block<2, 2>(1, 1));
    return f.roots([&](const Vec2& u) {
      const double lambda_n = -b_[0] / (A_(0, 0) - c_.mu * across.dot(u));
      return lambda_n >= c_.lower && std::isfinite(lambda_n) && keep_slip(lambda_n, u);
    });
  }
  // At the lower bound friction is within the disc of radius mu lower.
  bool stick_open() {
    if (!(c_.lower > 0.0)) return false;
    const Eigen::PartialPivLU<Mat2> lu(A_.block<2, 2>(1, 1));
    if (!(lu.matrixLU().diagonal().cwiseAbs().minCoeff() > kSmallestPivot * scale_)) return false;
    const Vec2 l_t = lu.solve(-b_.tail<2>() - A_.block<2, 1>(1, 0) * c_.lower);
    return keep(Vec3(c_.lower, l_t[0], l_t[1]));
  }
  bool slip_open() {
    if (!(c_.lower > 0.0)) return false;
    SlipDirections f;
    f.k = b_.tail<2>() + A_.block<2, 1>(1, 0) * c_.lower;
    f.Q = c_.mu * c_.lower * A_.block<2, 2>(1, 1);
    return f.roots([&](const Vec2& u) { return keep_slip(c_.lower, u); });
  }
  bool keep_slip(double lambda_n, const Vec2& u) {
    const double friction = c_.mu * lambda_n;
    return keep(Vec3(lambda_n, -friction * u[0], -friction * u[1]));
  }

  const ConeContact& c_;
  const Mat3& A_;
  const Vec3& b_;
  double noise_;
  double rough_;
  double scale_;
  bool immobile_ = false;
  double error_ = std::numeric_limits<double>::infinity();
  Vec3 best_ = Vec3::Zero();
};

// lambda = lambda_n ray with a given ray, from one equation.
bool solve_ray(const ConeContact& c, double slope, double b_n, const Vec2& ray, Vec3& lambda) {
  const double lambda_n = slope > 0.0 ? std::max(c.lower, -b_n / slope) : c.lower;
  lambda = Vec3(lambda_n, lambda_n * ray[0], lambda_n * ray[1]);
  return slope > 0.0 || b_n + slope * c.lower >= 0.0;
}

}  // namespace

bool solve_one_contact(const ConeContact& c, const Mat3& A, const Vec3& b, Vec3& lambda, double noise, double rough,
                       bool* immobile) {
  if (c.box > 0.0) {
    lambda.setZero();
    if (c.frozen || !(A(0, 0) > 0.0)) {
      lambda[0] = c.frozen ? -c.box * c.d[0] : b[0] == 0.0 ? 0.0 : -std::copysign(c.box, b[0]);
    } else {
      lambda[0] = std::min(c.box, std::max(-c.box, -b[0] / A(0, 0)));
    }
    return true;
  }
  if (c.rows == 1) return solve_ray(c, A(0, 0), b[0], Vec2::Zero(), lambda);
  if (c.frozen || !(c.mu > 0.0)) {
    const Vec2 ray = c.frozen ? Vec2(-c.mu * c.d) : Vec2(Vec2::Zero());
    return solve_ray(c, A(0, 0) + A.block<1, 2>(0, 1).dot(ray), b[0], ray, lambda);
  }
  OneContact one(c, A, b, noise, rough);
  const bool solved = one.solve();
  lambda = one.best();
  if (immobile != nullptr) *immobile = one.immobile();
  return solved;
}

}  // namespace contactvi
