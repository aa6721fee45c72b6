// Gradients in the parameters of a scene, in the numbers of the Python API.
#pragma once

#include "bindings/arrays.hpp"
#include "step/step_parameters.hpp"

namespace contactvi {

using Parameters = nanobind::typed<nanobind::dict, nanobind::str, nanobind::object>;

// Inertias and stiffnesses in the order of the public model's joints, whose frames the inertias take.
Parameters parameters_of(const Tree& tree, const StepParameters& sums);

// A direction of the parameters from such numbers; entries that are not given do not change.
StepParameters parameter_direction(const Tree& tree, const nanobind::dict& given);

}  // namespace contactvi
