#include "step/lost_velocity.hpp"

#include <cmath>
#include <limits>

#include "model/coordinates.hpp"
#include "model/coupling.hpp"

namespace contactvi {

LostVelocity lost_velocity(StepEquations& equations, const VecX& q) {
  const Tree& tree = equations.tree();
  VecX w(tree.nv), p(tree.nv), G(tree.nv), back(tree.nv);
  for (int d = 0; d < tree.nv; ++d) w[d] = std::sin(1.0 + d);
  follow_velocity(tree, w);
  VecX v = w;
  public_to_engine(tree, q, v);
  equations.dynamics(q, v, p, G);
  if (!equations.node_velocity(q, p, back)) back.setConstant(std::numeric_limits<double>::quiet_NaN());
  engine_to_public(tree, q, back);
  LostVelocity most;
  for (int d = 0; d < tree.nv; ++d) {
    const double lost = std::abs(back[d] - w[d]);
    if (!(lost <= most.share)) most = {d, lost};
    if (std::isnan(lost)) break;
  }
  return most;
}

}  // namespace contactvi
