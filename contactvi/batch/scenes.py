"""The compiled scenes of the runs of a batch: one for all runs of equal parameters."""

from __future__ import annotations

import threading
from collections import OrderedDict

from contactvi.batch.plan import Plan
from contactvi.options import Options
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.trajectory.compiled import CompiledScene, compile_scene

_MOST = 256  # scenes that are kept, the last ones used: a sweep over two parameters comes back to each value of one


class SceneCache:
    """Compiled scenes by the values of the parameters, checked with the options of the runs."""

    def __init__(self, options: Options) -> None:
        self._options, self._lock = options, threading.Lock()
        self._known: OrderedDict[bytes, CompiledScene] = OrderedDict()

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
        compiled, options = compile_scene(plan.scene_of(k)), self._options
        if not options.auto:
            check_map(compiled, options)
            check_elements(compiled, options)
            if options.record == "gradient":
                compiled.check_differentiable()
        return compiled
