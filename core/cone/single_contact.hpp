// One contact by itself, solved directly.
#pragma once

#include "cone/problem.hpp"

namespace contactvi {

// lambda (3,) with the law of problem.hpp for w = b + A lambda, A (3, 3), not necessarily symmetric. Of several
// solutions (A far from symmetric positive) the first of: open, sticking, slipping. False if there is none, or if
// rounding is not small beside A's smallest pivot; lambda is then the best that was found. immobile: joints or
// constraints let the contact not move in some direction, A is singular, and lambda is the least of the impulses that
// keep it at rest. noise, rough: see ConeProblem.
bool solve_one_contact(const ConeContact& contact, const Mat3& A, const Vec3& b, Vec3& lambda, double noise = 0.0,
                       double rough = 0.0, bool* immobile = nullptr);

}  // namespace contactvi
