"""dt = "auto": runs a scene with steps that make q as accurate as asked, and tells how accurate it is.

A search (contactvi.simulation.auto_search) makes a few runs with shorter and shorter steps and compares them. Where
islands of the scene do not meet, each is searched for by itself (contactvi.simulation.auto_apart): what happens in one
does not cut the steps of another. A run that cannot meet tol ends with an AccuracyWarning that says why.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from contactvi.errors import AccuracyWarning, PenetrationError
from contactvi.interrupts import CtrlC
from contactvi.options import Options
from contactvi.simulation import engine
from contactvi.simulation.auto_apart import Apart
from contactvi.simulation.auto_motion import WholeMotion
from contactvi.simulation.auto_search import CHAOS, Search
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.simulation.recorder import Record
from contactvi.simulation.tolerances import LedgerWatch
from contactvi.status import Status, StatusCode
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi import _core


def run(
    compiled: CompiledScene,
    options: Options,
    q0: ArrayLike | None,
    v0: ArrayLike | None,
    target: Any,
    progress: Callable[[float, int], object] | None,
    throw: bool,
    ctrl_c: CtrlC,
) -> Trajectory:
    """Run a scene with steps chosen for options.tol; the arguments as those of `simulate`.

    Raises:
        PenetrationError: where `throw`. Warns with AccuracyWarning where tol was not reached.
    """
    check_map(compiled, options)
    check_elements(compiled, options)
    kept = options if options.dense else replace(options, dense=True)
    motion = WholeMotion(compiled, q0, v0, target)
    try:
        found = _found(motion, kept, ctrl_c.watch(progress))
    except PenetrationError:
        if throw:
            raise
        assert motion.refused is not None
        return motion.refused.trajectory(None)
    record = found.record
    record.separation = motion.separation
    record.actuation.references = motion.references()
    if found.interrupted:
        record.status = Status.interrupted(float(record.t[-1][-1]))
    if not options.dense:  # the segments were needed for the comparison only
        record.options, record.segments, record.apart = options, [], None
    if options.ledger:
        _check_ledger(record)
    traj = record.trajectory(found.engine, found.estimate)
    if record.status.ok and not found.estimate <= options.tol:
        warnings.warn(
            f"The accuracy asked of q was not reached: tol = {options.tol:.3g}, estimated error {found.estimate:.3g}."
            f" {_reason(found.reason, traj.stats.held_branches)}",
            AccuracyWarning,
            stacklevel=4,
        )
    return traj


@dataclass
class _Found:
    """A run as accurate as could be, or one that was interrupted; engine: at its end, None where there are several."""

    record: Record
    estimate: float
    reason: str
    interrupted: bool
    engine: _core.Simulator | None = None


def _found(motion: WholeMotion, options: Options, progress: Callable[[float, int], object]) -> _Found:
    apart = Apart(motion, options, progress)
    parts = apart.search()
    if parts is not None:
        record = engine.record_of(parts.run, motion.compiled, options, apart.seconds)
        record.segments, record.apart = [], parts.segments
        return _Found(record, parts.estimate, parts.reason, parts.interrupted)
    search = Search(motion, options, progress)
    try:
        run, estimate = search.search()
    except KeyboardInterrupt:
        if search.last is None:
            raise
        run, estimate = search.last, math.nan
        run.interrupted = True
    record = engine.record_of(run.run, motion.compiled, options, apart.seconds + search.seconds)
    if record.status.ok and not run.interrupted:
        search.release()
    return _Found(record, estimate, search.reason, run.interrupted, run.engine)


def _reason(found: str, held: int) -> str:
    """Return why tol was not reached; held: parts of steps over which the law of an actuator or a rope was kept."""
    if not held:
        return found
    where = "one place" if held == 1 else f"{held} places"
    kept = (
        f"In {where} the branch of an actuator's or a rope's law was held to the end of a step, where it would change"
        " for ever, as at an actuator's largest speed (traj.stats.held_branches): that is of order 1 in the step,"
        " whatever the order. Give a short step, dt=..., a larger tol, or no limit of speed"
    )
    return kept if found == CHAOS else f"{kept}. {found}"


def _check_ledger(record: Record) -> None:
    """Check the run against the tolerances of its ledger; where one is exceeded the run ends there."""
    excess = LedgerWatch(record.options.ledger or {}).check(record.ledger())
    if excess is not None:
        record.status = Status(StatusCode.LEDGER, str(excess), excess.time)
        record.cut(excess.time)
