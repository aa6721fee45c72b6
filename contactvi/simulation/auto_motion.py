"""What a search of dt = "auto" runs, again and again: a scene from its start, or a part of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.options import Options
from contactvi.scene.separation import Separation
from contactvi.simulation import engine
from contactvi.simulation.auto_runs import AutoRun
from contactvi.simulation.recorder import Record
from contactvi.simulation.targets import Targets
from contactvi.trajectory.compiled import CompiledScene

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]
References = Array | Callable[[float], Array] | None


class Motion(Protocol):
    """What a search runs."""

    def started(self, options: Options, slack: float, dt_contact: float) -> _core.Simulator:
        """Return a simulator at the start; slack, dt_contact: as those of `engine.make`."""
        ...

    def references(self) -> References:
        """Return the references of the servos, (1, 2 nv) or a function of time (2 nv,); None without servos."""
        ...

    def told(self, run: AutoRun, options: Options) -> str:
        """Return in words how a run has ended before its time; the run is handed over."""
        ...

    def release(self, simulator: _core.Simulator, options: Options, slack: float, dt_contact: float) -> None:
        """Give a simulator to later calls."""
        ...


class WholeMotion:
    """A scene from a start (q0, v0), those of the scene where None, with the target of its servos.

    Attributes:
        compiled: the scene.
        separation: what was moved for the start.
        refused: the record of a start that the engine refuses.
    """

    def __init__(self, compiled: CompiledScene, q0: ArrayLike | None, v0: ArrayLike | None, target: Any) -> None:
        self.compiled, self._given, self._target = compiled, (q0, v0), target
        self._start: tuple[Array, Array, float] | None = None
        self.separation: Separation | None = None
        self.refused: Record | None = None

    def start(self, options: Options, simulator: _core.Simulator | None = None) -> tuple[Array, Array, float]:
        """Return q, v and t of the start, which is looked at the first time; errors as those of `engine.start`."""
        if self._start is None:
            begun = engine.checked_start(self.compiled, options, *self._given, 0.0, simulator)
            self._start, self.separation = begun
        return self._start

    def started(self, options: Options, slack: float, dt_contact: float) -> _core.Simulator:
        """As that of Motion; raise the error of a start that is refused."""
        simulator = engine.reuse(self.compiled, options, slack, dt_contact)
        start = self.start(options, simulator)
        if not engine.accepts(simulator, *start):
            self.refused, error = engine.start_checked(simulator, self.compiled, options, *start)
            assert error is not None
            raise error
        return simulator

    def references(self) -> References:
        """As that of Motion."""
        assert self._start is not None
        targets = Targets(self.compiled, self._start[0])
        moving = targets.moving(self._target)
        return targets.rows(self._target, np.zeros(1)) if moving is None else moving

    def told(self, run: AutoRun, options: Options) -> str:
        """As that of Motion."""
        return str(engine.record_of(run.run, self.compiled, options).status)

    def release(self, simulator: _core.Simulator, options: Options, slack: float, dt_contact: float) -> None:
        """As that of Motion."""
        engine.release(simulator, self.compiled, options, slack, dt_contact)


class NotApart(Exception):
    """A part of a scene cannot be run apart from the rest."""


class PartMotion:
    """Some static trees of a scene, alone.

    Attributes:
        trees: their numbers. part: the engine's.
    """

    def __init__(self, whole: WholeMotion, options: Options, trees: Sequence[int], part: _core.ScenePart) -> None:
        self.trees, self.part = tuple(trees), part
        q, v, t = whole.start(options)
        self._q, self._v = part.q, part.v
        self._start = q[self._q], v[self._v], t
        self._of_whole = whole.references()

    def started(self, options: Options, slack: float, dt_contact: float) -> _core.Simulator:
        """As that of Motion."""
        simulator = engine.make_of(self.part.scene, options, slack, dt_contact)
        if not engine.accepts(simulator, *self._start):
            raise NotApart("The start of a part is refused")
        return simulator

    def references(self) -> References:
        """As that of Motion."""
        given = self._of_whole
        if given is None:
            return None
        if callable(given):
            whole = given
            return lambda t: self._own(whole(t)[None])[0]
        return self._own(given)

    def _own(self, rows: Array) -> Array:
        width = rows.shape[1] // 2
        return np.ascontiguousarray(rows[:, [*self._v, *(width + i for i in self._v)]])

    def told(self, run: AutoRun, options: Options) -> str:
        """As that of Motion."""
        raise NotApart("The run of a part ended early")

    def release(self, simulator: _core.Simulator, options: Options, slack: float, dt_contact: float) -> None:
        """As that of Motion: nobody else can use it."""
