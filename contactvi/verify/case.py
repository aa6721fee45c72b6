"""A case of `contactvi verify`, and the runs that it makes."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import DenseStepWarning, SimulationError
from contactvi.records.contacts import ContactChange
from contactvi.reproduce.check import Check, same
from contactvi.scene.scene import Scene
from contactvi.simulation.simulation import simulate
from contactvi.status import StatusCode
from contactvi.trajectory.compiled import compile_scene
from contactvi.trajectory.contact_ledger import adhesion_of
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]

GAP, COMPLEMENTARITY = -1e-10, 1e-12  # bounds for every run: least gap [m; rad], gap times impulse [N m s]
LIMIT = 30.0  # [s] of a processor for a case, whatever else the machine does: several times what any of them takes
# Nodes of a run at which the gaps are measured: measuring all nodes of a stack takes longer than its simulation.
_NODES = 400


@dataclass(frozen=True)
class Case:
    """One case: its name, what it is, and the function that measures it.

    Attributes:
        name: by which the case is chosen.
        title: what it is, in a few words.
        run: called with a `Runs`; returns the checks.
        excuse: why the case cannot be expressed, then run is None and the case is listed as not applicable, neither
            passed nor failed.
        former: name that the case had before, still accepted in this release; "" where it had no other.
    """

    name: str
    title: str
    run: Callable[[Runs], Sequence[Check]] | None
    excuse: str = ""
    former: str = ""


class Runs:
    """Makes the runs of a case, and checks what holds for every run: gaps, impulses, complementarity, its end."""

    def __init__(self, limit: float = LIMIT) -> None:
        """Take the time of the processor [s] that all runs of the case together may need."""
        self.count, self._end = 0, time.process_time() + limit
        self._gap, self._impulse, self._complementarity = np.inf, np.inf, 0.0
        self._messages: list[str] = []

    def simulate(
        self,
        scene: Scene,
        q: ArrayLike | None,
        v: ArrayLike | None,
        duration: float,
        dt: Any = None,
        **options: Any,
    ) -> Trajectory:
        """Run a scene as contactvi.simulate does; a run that ends early is returned as it is, and fails the case.

        Raises:
            SimulationError: where the case takes too long.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DenseStepWarning)  # what such steps did is measured
            traj = simulate(scene, q, v, duration, dt, throw=False, progress=self._in_time, **options)
        self.count += 1
        if traj.status.code == StatusCode.INTERRUPTED:
            raise KeyboardInterrupt
        if not traj.status.ok:
            self._messages.append(str(traj.status))
        gap, impulse, product = kept(traj)
        self._gap, self._impulse = np.fmin(self._gap, gap), np.fmin(self._impulse, impulse)
        self._complementarity = np.fmax(self._complementarity, product)
        return traj

    def _in_time(self, t: float, impacts: int) -> None:
        """Stop a run that hangs: the engine calls this about ten times a second."""
        if time.process_time() > self._end:
            raise SimulationError(
                "The case takes too long",
                expected="an end of its runs",
                got=f"t = {t:.6g} s after {impacts} impacts",
                remedy="Run this case alone; if it takes as long, report it as a bug",
            )

    def laws(self) -> list[Check]:
        """Return the checks that hold for every run, of all runs made."""
        if not self.count:
            return []
        runs = f"{self.count} run{'s' if self.count > 1 else ''}"
        gap, impulse, product = float(self._gap), float(self._impulse), float(self._complementarity)
        good = gap >= GAP and (impulse >= 0.0) and product <= COMPLEMENTARITY
        return [
            same("runs that ended early", "none", "; ".join(self._messages) or "none", runs),
            Check(
                "phi; lambda; |phi lambda|",
                f">= {GAP:g}; >= 0; <= {COMPLEMENTARITY:g}",
                f"{gap:.2g}; {impulse:.2g}; {product:.2g}",
                "bounds",
                f"every run keeps them; {runs}",
                bool(good),
            ),
        ]


def kept(traj: Trajectory) -> tuple[float, float, float]:
    """Return the least gap [m; rad], the least impulse [N s] and the largest |gap * impulse| of a run.

    Gaps of all pairs and limits at the nodes (some 400 of them), at all impacts, and of all persistent contacts.
    """
    scene = traj.scene
    built = compile_scene(scene).built
    core, model = scene.core(), built.model
    gaps = [np.array([np.inf])]
    chosen = np.unique(np.linspace(0, len(traj.t) - 1, _NODES).astype(int))
    if core.npairs:
        gaps += [np.asarray(core.gaps(traj.q[k])[0]) for k in chosen]
    for index in np.flatnonzero(built.arrays.limits):
        at = model.joints[int(index)].idx_q
        gaps += [traj.q[:, at] - model.lowerPositionLimit[at], model.upperPositionLimit[at] - traj.q[:, at]]
    events, contacts = traj.events, traj.contacts
    at_impacts = events.array("gap"), events.array("impulse")
    pulls = adhesion_of(built.laws, contacts)
    in_contact = contacts.array("gap"), contacts.normal_impulse + (0.0 if pulls is None else pulls)
    gaps += [at_impacts[0], in_contact[0]]
    impulses = np.concatenate([[0.0], at_impacts[1], in_contact[1]])
    products = np.concatenate([[0.0], at_impacts[0] * at_impacts[1], in_contact[0] * in_contact[1]])
    return float(np.concatenate(gaps).min()), float(impulses.min()), float(np.abs(products).max())


def largest(values: ArrayLike) -> float:
    """Return the largest absolute value; inf where there is none."""
    return float(np.abs(values).max()) if np.size(values) else np.inf


def changes_of(traj: Trajectory, change: str) -> list[ContactChange]:
    """Return the changes of contacts of one kind, in the order of time."""
    return [found for found in traj.contact_changes if found.change == change]
