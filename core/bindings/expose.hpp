// One expose_* per engine concept; module.cpp only calls them.
#pragma once

#include <nanobind/nanobind.h>

namespace contactvi {

struct Scene;
class SteppedWorld;

void expose_enums(nanobind::module_& m);
void expose_model(nanobind::module_& m);
void expose_scene(nanobind::module_& m);
void expose_elements(nanobind::class_<Scene>& scene);
void expose_laws(nanobind::module_& m, nanobind::class_<Scene>& scene);
void expose_kept_runs(nanobind::module_& m, nanobind::class_<SteppedWorld>& simulator);
void expose_runs_apart(nanobind::module_& m);
void expose_posed_problems(nanobind::class_<SteppedWorld>& simulator);
void expose_simulator(nanobind::module_& m);
void expose_batch(nanobind::module_& m);
void expose_cone(nanobind::module_& m);
void expose_dense(nanobind::module_& m);
void expose_derivatives(nanobind::module_& m);
void expose_sensitivity(nanobind::module_& m);
void expose_hull(nanobind::module_& m);
void expose_kernel(nanobind::module_& m);
void expose_manifold(nanobind::module_& m);
void expose_sequence(nanobind::module_& m);

}  // namespace contactvi
