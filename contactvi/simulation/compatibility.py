"""Combinations of a scene and options that are refused before a run, and bouncing that DTEC cannot end.

DTEC has no answer without rebound, and the global reference of MHC none with losses.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.options import Options
from contactvi.records.events import EventLog
from contactvi.trajectory.compiled import CompiledScene

if TYPE_CHECKING:
    from contactvi.simulation.results import EngineStatus

UNFORCED_TOLERANCES = (
    *("discrete_energy", "discrete_energy_jump", "modified_energy_jump"),
    *("energy_rise", "impulse_balance"),
)
_REMADE_TOLERANCES = ("discrete_energy", "discrete_energy_jump", "modified_energy_jump")
NO_ANSWER_DTEC = (  # accumulating impacts end a run of DTEC with zeno="hold" too
    "DTEC cannot answer there: the energy it shifts at an impact, m g h times a part of the step, does not shrink with "
    "the flights"
)


_STALL_HITS = 32  # in a row; by chance 2^-32
_STALL_FLIGHT = 2.0  # steps


class Stall:
    """Finds the bouncing that DTEC keeps alive for ever.

    Where the flights of a bouncing body get as short as the step, the energy that DTEC shifts at an impact balances
    what restitution takes, and the body goes on bouncing once per step instead of coming to rest: at one contact,
    flight after flight of less than two steps, each impact loses less than half of what its restitution asks for.
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._last: dict[tuple[int, int], tuple[float, int]] = {}  # guard -> time of its last impact, hits in a row

    def find(self, events: EventLog) -> EngineStatus | None:
        """Return the status where the bouncing stalls in these next events of the run, else None."""
        columns: list[NDArray[Any]] = [events.array(name) for name in ("time", "kind", "index")]
        kept = (events.array("restitution") < 1.0) & (events.energy_change > -0.5 * events.loss)
        for time, kind, index, alive in zip(*columns, kept, strict=True):
            guard = int(kind), int(index)
            last, hits = self._last.get(guard, (-np.inf, 0))
            hits = hits + 1 if alive and time - last < _STALL_FLIGHT * self._dt else 0
            if hits >= _STALL_HITS:
                return _accumulation(float(time), *guard)
            self._last[guard] = float(time), hits
        return None


def _accumulation(time: float, kind: int, index: int) -> EngineStatus:
    from contactvi import _core

    return {
        "code": _core.StatusCode.ZENO, "message": "", "time": time, "guard_kind": _core.GuardKind(kind),
        "guard_index": index, "accumulation_time": time, "depth": math.nan,
    }  # fmt: skip


def check_map(compiled: CompiledScene, options: Options) -> None:
    """Raise InputError where the impact map or the contact mode of the options has no answer on this scene."""
    if options.impact == "dtec":
        _check_rebound(compiled)
    if _carries_reference(options) and np.any(compiled.damping > 0):
        model = compiled.scene().model
        joint = next(name for name, j in zip(model.names, model.joints, strict=True)
                     if j.nv and np.any(compiled.damping[j.idx_v : j.idx_v + j.nv] > 0))  # fmt: skip
        _refuse_global("damping", f"joint {joint!r} is damped", "Use mhc_reference='local', or damping 0")


def check_unforced(options: Options) -> None:
    """Raise InputError where inputs spoil the impact map (it carries an energy) or a tolerance of the ledger."""
    _refuse_blind(options, UNFORCED_TOLERANCES, "inputs")
    if _carries_reference(options):
        _refuse_global("control", "forces put in from outside", "Use mhc_reference='local'")


def check_elements(compiled: CompiledScene, options: Options) -> None:
    """Raise InputError where elements of the scene spoil the impact map or a tolerance of the ledger.

    Potentials and the damping of joints do not.
    """
    if compiled.driven is not None:
        _refuse_blind(options, UNFORCED_TOLERANCES, compiled.driven)
    elif compiled.forced:
        _refuse_blind(options, _REMADE_TOLERANCES, "constraints, dampers or joint friction")
    if compiled.built.elements.any:
        _refuse_blind(options, ("impulse_balance",), "forces or constraints on bodies")
    what = compiled.driven or ("dampers or joint friction" if compiled.dissipates else None)
    if what is not None and _carries_reference(options):
        _refuse_global(what, f"a scene with {what}", "Use mhc_reference='local'")


def _refuse_blind(options: Options, names: Collection[str], what: str) -> None:
    blind = [name for name in options.ledger or () if name in names]
    if blind:
        raise InputError(
            f"The ledger cannot hold {blind[0]} in a run with {what}",
            name="ledger",
            expected=f"tolerances that need to know no {what}",
            got=", ".join(blind),
            remedy="Leave it out; own_jump and energy_balance are known with inputs too",
        )


def _carries_reference(options: Options) -> bool:
    return options.impact == "mhc" and options.mhc_reference == "global"


def _refuse_global(name: str, got: str, remedy: str) -> None:
    raise InputError(
        "MHC's global reference needs a conservative scene",
        name="mhc_reference",
        expected=f"a run without {name}: every impact would put back what it took since the start",
        got=got,
        remedy=remedy,
    )


def _check_rebound(compiled: CompiledScene) -> None:
    built = compiled.built
    plastic = [f"{a!r} and {b!r}" for (a, b), e in zip(built.pairs, built.restitution, strict=True) if e == 0.0]
    limited = zip(built.model.names, built.arrays.limits, built.arrays.limit_restitution, strict=True)
    plastic += [f"the limits of joint {name!r}" for name, used, e in limited if used and e == 0.0]
    if not plastic:
        return
    more = f" and {len(plastic) - 1} more" if len(plastic) > 1 else ""
    raise InputError(
        "DTEC has no answer for an impact without rebound",
        name="impact",
        expected="restitution > 0 at every pair and joint limit: at 0 its energy equation has no root",
        got=f"restitution 0 of {plastic[0]}{more}",
        remedy="Use impact='ctec' or 'mhc', or a restitution above 0",
    )
