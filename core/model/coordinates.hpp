// Conversion between the public velocity and momentum (Pinocchio's) and the engine's, for split joints.
//
// Free-flyer: v_public = (R^T xdot, omega), v_engine = (xdot, omega); planar joints likewise in the plane. Momenta are
// dual: p_public . v_public = p_engine . v_engine, so their linear part rotates like the velocity's.
#pragma once

#include "model/tree.hpp"

namespace contactvi {

// Both work in place; w is a velocity, momentum or generalized force at q, shape (nv,).
void public_to_engine(const Tree& tree, const VecCRef& q, VecRef w);
void engine_to_public(const Tree& tree, const VecCRef& q, VecRef w);

// Axes of the body of a split joint in the world, displaced by X (nv,) from q0; of a planar joint in the plane.
Mat3 split_axes(const SplitJoint& split, const VecCRef& q0, const VecCRef& X);

// Derivatives of the two conversions along dq, a tangent vector at q in engine coordinates: dw is the derivative of w
// on entry and that of the result on return. w: before the conversion.
void public_to_engine_tangent(const Tree& tree, const VecCRef& q, const VecCRef& dq, const VecCRef& w, VecRef dw);
void engine_to_public_tangent(const Tree& tree, const VecCRef& q, const VecCRef& dq, const VecCRef& w, VecRef dw);

// The transposes of these: lw is a gradient in the result on entry and that in w on return, to which the gradient in q
// is added in lq (engine coordinates).
void public_to_engine_adjoint(const Tree& tree, const VecCRef& q, const VecCRef& w, VecRef lw, VecRef lq);
void engine_to_public_adjoint(const Tree& tree, const VecCRef& q, const VecCRef& w, VecRef lw, VecRef lq);

}  // namespace contactvi
