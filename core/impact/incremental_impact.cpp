#include "impact/incremental_impact.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "base/root.hpp"
#include "cone/slip_directions.hpp"

namespace contactvi {

namespace {

using Vec2 = Eigen::Vector2d;
using Mat2 = Eigen::Matrix2d;

constexpr double kAccuracy = 5e-14;  // of the velocities, of one step
// Of the largest slip: one that is smaller has stopped. It falls by a constant share per unit of the path.
constexpr double kStopped = 1e-15;
constexpr double kStraight = 1e-13;   // of the mobility: by which the slip turns, where it goes straight
constexpr double kLeastShare = 1e-4;  // of the speed, that the slip counts for at least
constexpr double kFirstStep = 0.25, kLongestStep = 2.0;
constexpr int kSteps = 4000;  // of the path: about forty are needed
constexpr int kEvents = 200;  // evaluations that locate an event
// Columns of the extrapolation of the modified midpoint rule (Gragg, Bulirsch, Stoer; Hairer, Norsett, Wanner, "Solving
// ordinary differential equations I", II.9), whose order is twice their number.
constexpr int kColumns = 8;

// What the normal impulse has done: normal speed, logarithm and angle of the slip, impulse (n, t), work of the normal
// impulse. The slip is exact to its own last digits however small it becomes.
struct Course {
  double w_n, log_slip, angle;
  Vec3 lambda;
  double work;

  Course operator+(const Course& x) const {
    return {w_n + x.w_n, log_slip + x.log_slip, angle + x.angle, lambda + x.lambda, work + x.work};
  }
  Course operator*(double a) const { return {a * w_n, a * log_slip, a * angle, a * lambda, a * work}; }
  Vec2 direction() const { return Vec2(std::cos(angle), std::sin(angle)); }
};

class Impact {
 public:
  Impact(const Mat3& G, const Vec3& w, double mu, double e, RestitutionLaw law)
      : G_(G),
        mu_(mu),
        e_(e),
        law_(law),
        closing_(-w[0]),
        mobility_(G.diagonal().maxCoeff()),
        speed_(w.norm()),
        at_{w[0], std::log(w.tail<2>().norm()), std::atan2(w[2], w[1]), Vec3::Zero(), 0.0} {}

  bool run() {
    double largest = std::exp(at_.log_slip);
    if (largest <= kStopped * speed_) return finish_from_rest();
    double length = kFirstStep;
    for (int k = 0; k < kSteps; ++k) {
      const double slip = std::exp(at_.log_slip);
      largest = std::max(largest, slip);
      if (slip <= kStopped * largest) return finish_from_rest();
      const Vec2 d = at_.direction();
      const Vec3 impulse(1.0, -mu_ * d[0], -mu_ * d[1]), rate = G_ * impulse;
      // Where the slip no longer turns, all that follows is known.
      if (std::abs(d[0] * rate[2] - d[1] * rate[1]) <= kStraight * mobility_) {
        const double along = d.dot(rate.tail<2>());
        if (go_straight(impulse, along < 0.0 ? -slip / along : kInfinity)) return true;
        return finish_from_rest();
      }
      Course next;
      if (!step(length, next)) {
        length *= 0.5;
        continue;
      }
      if (!(event(next) >= 0.0)) {
        at_ = next;
        if (easy_) length = std::min(1.5 * length, kLongestStep);
        continue;
      }
      if (!locate(length)) return false;
      if (pass_event()) return true;
    }
    return false;
  }
  const Vec3& lambda() const { return at_.lambda; }
  const Vec3& compression() const { return compressed_.lambda; }
  const std::vector<char>& course() const { return course_; }

 private:
  // Per unit of a path along which the normal impulse grows by |w_t| / mobility: regular where the slip stops.
  Course rate(const Course& x) const {
    const Vec2 d = x.direction();
    const Vec3 impulse(1.0, -mu_ * d[0], -mu_ * d[1]), w = G_ * impulse / mobility_;
    const double growth = std::exp(x.log_slip);
    return {growth * w[0], d[0] * w[1] + d[1] * w[2], d[0] * w[2] - d[1] * w[1], growth / mobility_ * impulse,
            growth / mobility_ * x.w_n};
  }
  // From at_ along the path. False: not accurate enough.
  bool step(double length, Course& end) {
    std::array<Course, kColumns> row;
    for (int j = 0; j < kColumns; ++j) {
      const int parts = 2 * (j + 1);
      Course last = midpoint(length, parts);
      for (int k = 0; k < j; ++k) {
        const double ratio = static_cast<double>(parts) / (2 * (j - k));
        const Course better = last + (last + row[static_cast<std::size_t>(k)] * -1.0) * (1.0 / (ratio * ratio - 1.0));
        row[static_cast<std::size_t>(k)] = last;
        last = better;
      }
      row[static_cast<std::size_t>(j)] = last;
      if (j == 0) continue;
      // Neville's scheme from above: row[j - 1] is the value one column before.
      const Course& before = row[static_cast<std::size_t>(j - 1)];
      const double share = std::clamp(std::exp(last.log_slip) / speed_, kLeastShare, 1.0);
      const double slip =
          share * std::max(std::abs(last.log_slip - before.log_slip), std::abs(last.angle - before.angle));
      if (!(std::max(slip, std::abs(last.w_n - before.w_n) / (speed_ + std::abs(last.w_n))) <= kAccuracy)) continue;
      end = last;
      easy_ = j < kColumns - 2;
      return true;
    }
    return false;
  }
  Course midpoint(double length, int parts) const {
    const double h = length / parts;
    Course before = at_, now = at_ + rate(at_) * h;
    for (int k = 1; k < parts; ++k) {
      const Course next = before + rate(now) * (2.0 * h);
      before = now;
      now = next;
    }
    return (before + now + rate(now) * h) * 0.5;
  }
  // Negative before the end of the phase under way.
  double event(const Course& x) const {
    if (!expands_) return x.w_n;
    switch (law_) {
      case RestitutionLaw::kPoisson:
        return x.lambda[0] - (1.0 + e_) * compressed_.lambda[0];
      case RestitutionLaw::kNewton:
        return x.w_n - e_ * closing_;
      case RestitutionLaw::kEnergetic:
        return x.work - (1.0 - e_ * e_) * compressed_.work;
    }
    return 0.0;
  }
  // Moves at_ to where the event is within a step.
  bool locate(double length) {
    const Course start = at_;
    Course found = start;
    const double before = event(start);
    if (before >= 0.0) return true;
    const auto value = [&](double x, double& fx) {
      at_ = start;
      Course end;
      if (!step(x, end)) return false;
      found = end;
      fx = -event(end);
      return true;
    };
    double after = 0.0, root = 0.0;
    if (!value(length, after)) return false;
    const bool solved =
        after == 0.0 || root_by_value(-before, length, after, 0.0, kStopped * length, kEvents, value, root);
    at_ = found;
    return solved;
  }
  // At an event: true if it ends the impact.
  bool pass_event() {
    if (expands_) return true;
    at_.w_n = 0.0;
    course_.push_back(1);
    compressed_ = at_;
    expands_ = true;
    return e_ == 0.0;
  }
  // Along one direction of the impulse until the normal impulse has grown by `most`: true if that ends the impact.
  bool go_straight(const Vec3& direction, double most) {
    const Vec3 rate = G_ * direction;
    for (;;) {
      const double growth = std::max(0.0, until_event(rate[0]));
      const double taken = std::min(growth, most);
      if (!std::isfinite(taken)) {
        at_.lambda.setConstant(kInfinity);
        return true;
      }
      at_.work += taken * (at_.w_n + 0.5 * taken * rate[0]);
      at_.w_n += taken * rate[0];
      at_.lambda += taken * direction;
      if (most <= growth) return false;
      most -= taken;
      if (pass_event()) return true;
    }
  }
  // Growth of the normal impulse until the event, where the normal speed grows by `rate` per unit.
  double until_event(double rate) const {
    if (!expands_) return rate > 0.0 ? -at_.w_n / rate : kInfinity;
    switch (law_) {
      case RestitutionLaw::kPoisson:
        return -event(at_);
      case RestitutionLaw::kNewton:
        return rate > 0.0 ? -event(at_) / rate : kInfinity;
      case RestitutionLaw::kEnergetic: {
        const double missing = -event(at_), speed = at_.w_n, root = speed * speed + 2.0 * rate * missing;
        return root >= 0.0 && speed + std::sqrt(root) > 0.0 ? 2.0 * missing / (speed + std::sqrt(root)) : kInfinity;
      }
    }
    return kInfinity;
  }
  bool finish_from_rest() {
    course_.push_back(2);
    const Vec2 across = G_.block<2, 1>(1, 0);
    const Mat2 own = G_.block<2, 2>(1, 1);
    const Vec2 holds = own.ldlt().solve(-across);
    course_.push_back(holds.norm() <= mu_ ? 3 : 4);
    if (course_.back() == 3) return go_straight(Vec3(1.0, holds[0], holds[1]), kInfinity) && finite();
    bool leaves = false;
    Vec3 direction = Vec3::Zero();
    SlipDirections{across, mu_ * own}.roots([&](const Vec2& u) {
      leaves = u.dot(across - mu_ * own * u) > 0.0;
      direction = Vec3(1.0, -mu_ * u[0], -mu_ * u[1]);
      return leaves;
    });
    return leaves && go_straight(direction, kInfinity) && finite();
  }
  bool finite() const { return at_.lambda.allFinite() && std::isfinite(at_.w_n); }

  Mat3 G_;
  double mu_, e_;
  RestitutionLaw law_;
  double closing_, mobility_, speed_;
  Course at_, compressed_{0.0, 0.0, 0.0, Vec3::Zero(), 0.0};
  bool expands_ = false, easy_ = false;
  std::vector<char> course_;
};

}  // namespace

IncrementalImpact follow_impact(const Mat3& G, const Vec3& w, double mu, double e, RestitutionLaw law) {
  IncrementalImpact result;
  if (!G.allFinite() || !w.allFinite()) return result;
  if (!(w[0] < 0.0)) {
    result.ok = true;
    return result;
  }
  Impact impact(0.5 * (G + G.transpose()), w, mu, e, law);
  result.ok = impact.run() && impact.lambda().allFinite();
  result.lambda = impact.lambda();
  result.compression = impact.compression();
  result.course = impact.course();
  return result;
}

}  // namespace contactvi
