"""The compiled scenes of the runs of a batch: one for all runs of equal parameters.

The engine changes most parameters in copies of one scene that it makes for its runs, which costs microseconds. Scenes
are compiled for the other ones, and where a run is asked for more than its states.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi.batch.plan import Plan
from contactvi.errors import ContactviError
from contactvi.options import Options
from contactvi.scene.parameter_places import ParameterPlaces
from contactvi.scene.parameter_values import check_distinct
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.trajectory.compiled import CompiledScene, compile_scene

_MOST = 256  # scenes that are kept, the last ones used: a sweep over two parameters comes back to each value of one


class ChangedScenes(NamedTuple):
    """A compiled scene of which the engine makes copies, one for each run: places and rows of their numbers.

    usable: whether a copy can be made for a run.
    """

    compiled: CompiledScene
    places: ParameterPlaces
    rows: NDArray[np.float64]
    usable: NDArray[np.bool_]


class SceneCache:
    """Compiled scenes by the values of the parameters, checked with the options of the runs."""

    def __init__(self, options: Options) -> None:
        self._options, self._lock = options, threading.Lock()
        self._known: OrderedDict[bytes, CompiledScene] = OrderedDict()
        self._base: tuple[CompiledScene, ParameterPlaces] | None = None

    def changed(self, plan: Plan) -> ChangedScenes | None:
        """Return the scene of which the engine makes copies for the runs of a plan; None where it cannot.

        It cannot where the parameters decide more than numbers of the engine's scene: whether the impact map has an
        answer, and a start at rest on constraints. Errors are left to `of`, which has those of the single runs.
        """
        names = list(plan.parameters)
        decides = self._options.impact != "ctec" and any(name.startswith(("restitution", "damping")) for name in names)
        if not names or decides:
            return None
        if self._base is None:
            try:
                check_distinct([*names, *plan.common])
                places = ParameterPlaces(plan.scene.built(), names)
                common = plan.scene.with_parameters(plan.common) if plan.common else plan.scene
                self._base = self._checked(compile_scene(common)), places
            except ContactviError:
                return None
        compiled, places = self._base
        at_rest = plan.scene.v0 is None and "v0" not in plan.rows and "v0" not in plan.shared
        if at_rest and compiled.constraint_rows:
            return None
        return ChangedScenes(compiled, places, *places.rows(plan.parameters))

    def of(self, plan: Plan, k: int) -> CompiledScene:
        """Return the scene of run k; ContactviError where there is none, or where it cannot be run."""
        key = plan.key(k)
        with self._lock:
            if key not in self._known:
                self._known[key] = self._compiled(plan, k)
                if len(self._known) > _MOST:
                    self._known.popitem(last=False)
            self._known.move_to_end(key)
            return self._known[key]

    def _compiled(self, plan: Plan, k: int) -> CompiledScene:
        return self._checked(compile_scene(plan.scene_of(k)))

    def _checked(self, compiled: CompiledScene) -> CompiledScene:
        options = self._options
        if not options.auto:
            check_map(compiled, options)
            check_elements(compiled, options)
            if options.record == "gradient":
                compiled.check_differentiable()
        return compiled
