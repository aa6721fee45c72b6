#include "cone/slip_directions.hpp"

#include <limits>

#include "base/numerics.hpp"

namespace contactvi {

const SlipDirections::Samples& SlipDirections::samples() {
  static const Samples circle = [] {
    Samples u;
    for (int i = 0; i <= kSamples; ++i) {
      const double angle = kTwoPi * i / kSamples;
      u[static_cast<std::size_t>(i)] = Vec2(std::cos(angle), std::sin(angle));
    }
    u.back() = u.front();  // to the last bit: a root may lie there
    return u;
  }();
  return circle;
}

Eigen::Vector2d SlipDirections::refine(Vec2 low, Vec2 high, double f_low, double f_high) const {
  Vec2 u = (low * std::abs(f_high) + high * std::abs(f_low)).normalized();
  for (int step = 0; step < 60; ++step) {
    const double f = value(u);
    if (f == 0.0) break;
    ((f <= 0.0) == (f_low <= 0.0) ? low : high) = u;
    const double df = slope(u), angle = df != 0.0 ? -f / df : 1.0;
    Vec2 next = std::abs(angle) < 0.5 ? (u + angle * Vec2(-u[1], u[0])).normalized() : low;
    if (low[0] * next[1] - low[1] * next[0] <= 0.0 || next[0] * high[1] - next[1] * high[0] <= 0.0)
      next = (low + high).normalized();
    const double moved = (next - u).cwiseAbs().maxCoeff();
    u = next;
    if (moved <= 2.0 * std::numeric_limits<double>::epsilon()) break;
  }
  return u;
}

}  // namespace contactvi
