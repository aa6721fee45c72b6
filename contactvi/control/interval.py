"""A few steps of a scene with constant inputs as one map (q, v, u) -> (q, v), with its derivatives."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.control.drives import Drives
from contactvi.errors import ApproximateDerivativeWarning, InputError, SimulationError
from contactvi.inputs import count, positive, real
from contactvi.scene.scene import Scene
from contactvi.simulation.compatibility import check_elements, check_map
from contactvi.simulation.messages import remedy
from contactvi.simulation.run import Run
from contactvi.simulation.settings import settings_of
from contactvi.simulation.targets import Targets
from contactvi.trajectory.compiled import compile_scene
from contactvi.trajectory.sensitivity import check_on_kink, dense_report, not_differentiable, recorded_run
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]


class Interval:
    """The steps of one interval of a control problem, event-driven: impacts and contacts lie where they lie.

    Args:
        scene: taken as it is now; later edits do not reach the map.
        dt: step [s]. steps: their number. t: time at the start of the interval [s], for what depends on it.
        drives: what u does. Servos that it does not drive go where `set_servo` told them, else stay where the scene
            starts (scene.q0).
        on_kink: as for Sensitivity.
        options: of the run, as for `simulate`.

    Attributes:
        nq, nv: of the scene. span: length [s]. model: of the scene (pin.Model).

    Raises:
        InputError, DerivativeError: for bad settings, and for elements without derivatives.
    """

    def __init__(
        self, scene: Scene, dt: float, drives: Drives, *, steps: int = 1, t: float = 0.0, on_kink: str = "raise",
        **options: Any,
    ) -> None:  # fmt: skip
        check_on_kink(on_kink)
        step = positive("dt", dt, "the step in seconds, > 0, for example 1e-2")
        self._steps, self._t = count("steps", steps), real("t", t)
        chosen = {**options, "dt": step, "duration": step * self._steps, "record": "gradient", "start": "given"}
        self._options = settings_of(scene, chosen, forced=True)
        self._compiled = compiled = compile_scene(scene).at_start(None)  # one set of pairs, whatever is asked for
        check_map(compiled, self._options)
        check_elements(compiled, self._options)
        compiled.check_differentiable()
        self._drives, self._taken = drives, on_kink == "taken"
        start = compiled.states.configuration(compiled.q0)
        times: Array = self._t + step * np.arange(self._steps, dtype=np.float64)
        self._others = Targets(compiled, start).rows(None, times)
        self.nq, self.nv, self.span = compiled.states.nq, compiled.states.nv, step * self._steps
        self.model = compiled.built.model

    def run(self, q: Array, v: Array, u: Array) -> Trajectory:
        """Make the steps from (q, v) with u (nu,) and return the run.

        Raises:
            PenetrationError, SimulationError: where it cannot start, and where it ends before its time.
        """
        run = self.start(q, v)
        self.advance(run, u)
        return run.trajectory()

    def start(self, q: Array, v: Array) -> Run:
        """Return a run at (q, v), at the start of the interval; errors as those of `run`."""
        run = Run(self._compiled, self._options, q, v, self._t)
        if run.refused is not None:
            raise run.refused
        return run

    def advance(self, run: Run, u: Array) -> None:
        """Make the steps of the interval with u (nu,) in a run of this scene; errors as those of `run`."""
        rows = np.broadcast_to(u, (self._steps, self._drives.nu))
        status = run.advance(self._steps, self._drives.control(rows), self._drives.references(rows, self._others))
        if not status.ok:
            options = self._options
            raise SimulationError(
                f"The interval ended before its time with the status {status.code.name}: {status.message}",
                expected=f"{self.span:.9g} s", got=f"an end at t = {status.time:.9g} s",
                remedy=remedy(status.code, options.contact_mode, options.zeno, options.impact), status=status,
                trajectory=run.trajectory(),
            )  # fmt: skip

    def continues(self, other: Interval) -> bool:
        """Return whether the steps of both can be those of one run."""
        settings = (replace(part._options, duration=None) for part in (self, other))
        return self._compiled.built is other._compiled.built and next(settings) == next(settings)

    def nodes(self, traj: Trajectory) -> tuple[Array, Array]:
        """Return the states (n + 1, nq + nv) and inputs (n, nu) of a run that is n such intervals.

        Raises:
            InputError: for a run of other steps, without its inputs, or with inputs that change within an interval.
        """
        kept, steps = traj.inputs, self._steps
        count = len(traj.t) - 1
        if kept is None or count % steps or abs(traj.options.fixed_dt - self._options.fixed_dt) > 1e-12:
            raise InputError(
                "The run is not made of such intervals", name="traj",
                expected=f"a run with record='gradient' of a multiple of {steps} steps of {self._options.fixed_dt:g} s",
                got=f"{count} steps of {traj.options.fixed_dt:g} s{'' if kept else ', without its inputs'}",
                remedy="simulate(..., record='gradient') with this dt",
            )  # fmt: skip
        rows = self._drives.inputs(kept.control, kept.target)
        rows = np.zeros((count, self._drives.nu)) if not len(rows) else rows
        blocks = rows.reshape(-1, steps, self._drives.nu)
        if np.any(blocks != blocks[:, :1]):
            raise InputError(
                "The inputs of the run change within an interval", name="traj",
                expected=f"inputs held for {steps} steps",
                got="others", remedy="Repeat every input so often, or make the intervals shorter",
            )  # fmt: skip
        return np.hstack([traj.q, traj.v])[::steps], blocks[:, 0]

    def derivatives(self, traj: Trajectory) -> tuple[Array, Array]:
        """Return A (2 nv, 2 nv) and B (2 nv, nu) of a run of this interval: d(q1, v1) = A d(q0, v0) + B du.

        Changes of configurations are Pinocchio's tangent vectors.

        Raises:
            NotDifferentiable: see Sensitivity.

        Warns:
            ApproximateDerivativeWarning: for dense steps whose derivative is approximate.
        """
        n, nu = self.nv, self._drives.nu
        state = np.eye(n, n + n + nu), np.eye(n, n + n + nu, n)
        forces = np.hstack([np.zeros((n, 2 * n)), self._drives.forces])
        directions = {"count": 2 * n + nu, "q": state[0], "v": state[1], "tau": forces}
        found = recorded_run(traj, self._compiled).tangent(directions, [float(traj.t[-1])], self._taken)
        if "fact" in found:
            raise not_differentiable(traj, found)
        approximate = [step for step in dense_report(found) if step.reason]
        if approximate:
            warnings.warn(
                f"The derivative of an interval is approximate: {len(approximate)} dense steps, the first at"
                f" t = {approximate[0].time:.9g} s ({approximate[0].reason})",
                ApproximateDerivativeWarning,
                stacklevel=2,
            )
        end = np.asarray(found["nodes"][0])
        return end[:, : 2 * n], end[:, 2 * n :]
