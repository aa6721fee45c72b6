// One Gauss-Seidel sweep: each contact without turning friction solved exactly while the others are fixed.
#pragma once

#include "cone/block_law.hpp"

namespace contactvi {

// System: BlockSystem or DenseSystem. point: impulses of the cones, and the velocity that belongs to them.
template <class System>
void sweep(const System& system, ConePoint& point) {
  for (int c = 0; c < system.contacts(); ++c) {
    const BlockContact& law = system.contact(c);
    if (!is_alone(law)) continue;
    Vec3& lambda = point.lambda[c];
    const Vec3 w = system.velocity(c, point.v);
    if (w[0] > 0.0 && lambda[0] == 0.0 && law.lower == 0.0 && !is_box(law)) continue;
    const ContactMatrix& m = system.matrix(c);
    const Vec3 next = solve_contact(law, m, w - m.G * lambda, lambda), change = next - lambda;
    if (change.isZero(0.0)) continue;
    system.push(c, change, point.v);
    lambda = next;
  }
}

}  // namespace contactvi
