// Whether a step has met its constraints, and its motion what they prescribe.
#pragma once

#include "model/elements.hpp"

namespace contactvi {

// What a step has left of its constraints, shapes (m,).
struct ConstraintErrors {
  VecX start, end;      // residuals phi
  VecX rates;           // d phi/dt of the motion at the end
  double reach, speed;  // what places [m; rad] and speeds are compared with
  double remaining;     // share of the residuals at the start that the step leaves
};

// The constraint that is farthest from being met, -1: all are.
int find_violated(const Elements& elements, const ConstraintErrors& errors);

// The constraint whose prescribed motion jumps in a step of length h, so that its joint or body has moved otherwise
// than the rates d phi/dt tell; -1: none. moved: W^T v of the step's motion, (m,); rates: at some instants of it,
// (m, n), whose weights (n,) are those of a quadrature.
int find_jump(const Elements& elements, const VecX& moved, const MatX& rates, const VecX& weights, double h);
// With the rates at both ends.
int find_jump(const Elements& elements, const VecX& moved, const VecX& rate0, const VecX& rate1, double h);

// The coordinates of a configuration with which residuals are compared.
double constraint_reach(const VecX& q);

}  // namespace contactvi
