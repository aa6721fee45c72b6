// Parts of a scene that are run apart.
#include <nanobind/stl/pair.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <memory>
#include <utility>
#include <vector>

#include "base/error.hpp"
#include "bindings/arrays.hpp"
#include "bindings/expose.hpp"
#include "bindings/kept_run.hpp"
#include "geometry/prepare.hpp"
#include "model/static_trees.hpp"
#include "run/joined_runs.hpp"
#include "run/meetings.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace contactvi {

namespace {

struct Division {
  const Scene* scene;
  StaticTrees trees;
};

struct Part {
  std::unique_ptr<SubScene> numbers;
};

// The part has copies of all that it takes from the whole scene.
Part part_of(const Division& division, std::vector<int> chosen) {
  std::sort(chosen.begin(), chosen.end());
  const bool known = !chosen.empty() && chosen.front() >= 0 && chosen.back() < division.trees.count() &&
                     std::adjacent_find(chosen.begin(), chosen.end()) == chosen.end();
  if (!known) throw Error("expected different numbers of static trees");
  Part part{restrict_scene(*division.scene, division.trees, chosen)};
  prepare_geometry(part.numbers->scene);
  return part;
}

std::vector<PartRun> paired(const std::vector<const Part*>& parts, const std::vector<const OwnRun*>& runs) {
  if (parts.size() != runs.size() || parts.empty()) throw Error("expected a run of each part");
  std::vector<PartRun> found;
  for (std::size_t k = 0; k < parts.size(); ++k) {
    if (runs[k]->scene != &parts[k]->numbers->scene) throw Error("expected runs of these parts");
    found.push_back({parts[k]->numbers.get(), &runs[k]->compared()});
  }
  return found;
}

}  // namespace

void expose_runs_apart(nb::module_& m) {
  nb::class_<Part>(m, "ScenePart", "Some static trees of a scene, with all that is fixed to the world.")
      .def_prop_ro(
          "scene", [](const Part& part) -> const Scene& { return part.numbers->scene; },
          nb::rv_policy::reference_internal, "As a scene of its own.")
      .def_prop_ro(
          "q", [](const Part& part) { return part.numbers->q; }, "Its entries of a configuration of the whole scene.")
      .def_prop_ro(
          "v", [](const Part& part) { return part.numbers->v; }, "Its entries of a velocity of the whole scene.");
  nb::class_<Division>(m, "StaticTrees", "The trees of a scene that nothing but contacts couples.")
      .def(
          "__init__", [](Division* self, const Scene& scene) { new (self) Division{&scene, StaticTrees(scene)}; },
          "scene"_a, nb::keep_alive<1, 2>())
      .def_prop_ro("count", [](const Division& division) { return division.trees.count(); })
      .def_prop_ro(
          "guards", [](const Division& division) { return division.scene->guard_count(); },
          "Pairs and joint limits of the scene.")
      .def("part", &part_of, "trees"_a, "The scene restricted to these trees.")
      .def(
          "meetings",
          [](const Division& division, const std::vector<const Part*>& parts, const std::vector<const OwnRun*>& runs,
             double near) {
            const std::vector<PartRun> own = paired(parts, runs);
            nb::gil_scoped_release release;
            return meetings(*division.scene, division.trees, runs.front()->options, own, near);
          },
          "parts"_a, "runs"_a, "near"_a,
          "Pairs of parts, by their places in the list, that may have come nearer than this [m] in these runs of each"
          " alone; all others are certain to have stayed apart.")
      .def(
          "joined",
          [](const Division& division, const std::vector<const Part*>& parts, const std::vector<const OwnRun*>& runs,
             std::size_t leader) {
            OwnRun whole{KeptRun(), division.scene, runs.empty() ? SimulatorOptions() : runs.front()->options,
                         nb::find(*division.scene), false};
            const std::vector<PartRun> own = paired(parts, runs);
            if (leader >= own.size()) throw Error("expected the place of a run");
            nb::gil_scoped_release release;
            whole.run = joined(*division.scene, whole.options, own, leader);
            return whole;
          },
          "parts"_a, "runs"_a, "leader"_a,
          "The runs of parts that did not meet as one run of the scene, without polynomials. Its nodes are those of one"
          " of the runs, by its place in the list.");
}

}  // namespace contactvi
