// The charts of spherical joints at a node of a step, at the displacement X from its start: how generalized forces and
// their changes there look from the start. Other joints have none: vectors stay what they are.
#pragma once

#include <vector>

#include "model/tree.hpp"

namespace contactvi {

class NodeChart {
 public:
  explicit NodeChart(const Tree& tree);

  void take(const VecCRef& X);
  // The tangent vector, body-fixed at the node, by which its configuration moves along dX and along dq0 of the start.
  VecX turn(const VecX& dX, const VecX& dq0) const;
  // A force g of the bodies' axes at the node, by the chart; and what that changes by along dX where g changes by dg.
  VecX by_chart(const VecX& g) const;
  VecX by_chart_change(const VecX& g, const VecX& dg, const VecX& dX) const;
  // As these, in the axes that the bodies have at the start of the step.
  VecX at_start(const VecX& g) const;
  VecX at_start_change(const VecX& g, const VecX& dg, const VecX& dX) const;
  // The velocity for the rate u of X; and its change, where these change by du and dX.
  VecX velocity(const VecX& u) const;
  // The other way round; and its transpose.
  VecX rate(const VecX& v) const;
  VecX rate_transposed(const VecX& lu) const;
  VecX velocity_change(const VecX& u, const VecX& du, const VecX& dX) const;

 private:
  struct Ball {
    int iv;
    Vec3 X;
    Mat3 J, R;  // right Jacobian and exponential
  };
  std::vector<Ball> balls_;
};

}  // namespace contactvi
