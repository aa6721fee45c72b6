#include "cone/projected_sweeps.hpp"

#include <algorithm>
#include <cmath>

namespace contactvi {

namespace {

double speed(const ConeProblem& problem, int row, const Eigen::Map<VecX>& lambda) {
  return problem.b[row] + problem.G.row(row).dot(lambda);
}

// Friction of one kind in `count` rows from `first` on, at its radius.
void project(const ConeProblem& problem, int first, int count, double radius, double scale, const double* frozen,
             Eigen::Map<VecX>& lambda) {
  Vec3 z = Vec3::Zero();
  for (int k = 0; k < count; ++k)
    z[k] = frozen != nullptr ? -radius * frozen[k] : lambda[first + k] - speed(problem, first + k, lambda) / scale;
  const double length = z.norm();
  if (frozen == nullptr && length > radius) z *= radius / length;
  lambda.segment(first, count) = z.head(count);
}

}  // namespace

void projected_sweeps(const ConeProblem& problem, const NaturalMap& map, int sweeps, double* start) {
  Eigen::Map<VecX> lambda(start, problem.b.size());
  for (int k = 0; k < sweeps; ++k) {
    for (int i = 0; i < static_cast<int>(problem.contacts.size()); ++i) {
      const ConeContact& c = problem.contacts[static_cast<std::size_t>(i)];
      const double z = lambda[c.row] - speed(problem, c.row, lambda) / map.normal_scale(i);
      if (c.box > 0.0)
        lambda[c.row] = c.frozen ? -c.box * c.d[0] : std::clamp(z, -c.box, c.box);
      else
        lambda[c.row] = std::max(c.lower, z);
      if (c.rows == 1) continue;
      const double d[3] = {c.d[0], c.d[1], c.d_spin};
      project(problem, c.row + 1, c.friction_rows(), c.mu * lambda[c.row], map.tangent_scale(i), c.frozen ? d : nullptr,
              lambda);
      if (c.rolling > 0.0)
        project(problem, c.row + c.rolling_row(), 2, c.rolling * lambda[c.row], map.rolling_scale(i),
                c.frozen_rolling ? c.d_rolling.data() : nullptr, lambda);
    }
  }
}

}  // namespace contactvi
