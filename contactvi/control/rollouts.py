"""Batches of runs with their gradients, for libraries that differentiate programs.

A batch takes arrays and gives the states of all nodes; gradients at the nodes go back to the start, the inputs of every
step and the parameters of the scene, by the adjoint of every run. Runs are independent of each other and are made in
several threads, with equal bits whatever their number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypedDict, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.batch.blocks import joined
from contactvi.batch.plan import Plan
from contactvi.batch.runs import blocks_of
from contactvi.batch.scenes import SceneCache
from contactvi.batch.shapes import OF_RUNS, Batch, batch_of
from contactvi.control.tangents import in_numbers, in_tangents
from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import array, mapping, positive, real_numbers, shape_of
from contactvi.options import ContactSteps, ImpactMap, MhcReference, Support, Zeno
from contactvi.simulation.settings import settings_of as run_settings_of
from contactvi.simulation.simulation import warn_of_dense_steps
from contactvi.threads import Workers
from contactvi.trajectory.compiled import CompiledScene, compile_scene
from contactvi.trajectory.gradient import RunGradients
from contactvi.trajectory.sensitivity import check_on_kink
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]


class RolloutOptions(TypedDict, total=False):
    """The options of the runs of a batch; `Options` describes them."""

    order: int
    tol: float
    solver_tol: float
    impact: ImpactMap
    mhc_reference: MhcReference
    contact_mode: ContactSteps
    dt_contact: float
    support: Support
    zeno: Zeno
    contact_points: int
    max_iterations: int
    max_impacts_per_step: int
    record_contacts: bool


OPTIONS = tuple(RolloutOptions.__annotations__)


class Rollouts:
    """A batch of B runs of one scene.

    Every input may have a leading dimension B; those that have none are the same in all runs.

    Args:
        scene: the scene.
        q0: starts, Pinocchio's numbers, (B, nq) or (nq,). v0: their velocities, (B, nv) or (nv,).
        control: generalized forces in every step [N, N m], (B, steps, nv) or (steps, nv).
        target: references of the n servos in every step, (B, steps, n) or (steps, n); with those of their velocities
            2 n numbers. Scenes with servos need it.
        dt: time step [s]. steps: number of steps, where neither control nor target tells it.
        parameters: values of the scene's parameters by the names of contactvi.gradient, such as "mass:box", (B, width)
            or (width,).
        workers: number of threads; None for one per core.
        on_kink: as for contactvi.gradient.
        **options: order, solver_tol, impact, contact_mode, ...: those of `simulate` that a batch of runs may have.

    Attributes:
        batch: the shapes of the inputs (contactvi.batch.shapes).
        q: configurations at all nodes, (B, steps + 1, nq). v: velocities there, (B, steps + 1, nv).

    Raises:
        InputError: for inputs that are not usable. Errors of a run have its index in the batch in their message:
            PenetrationError, SimulationError, NotDifferentiable and others, see `simulate`.
    """

    def __init__(
        self,
        scene: Scene,
        q0: ArrayLike,
        v0: ArrayLike,
        control: ArrayLike | None = None,
        target: ArrayLike | None = None,
        *,
        dt: float,
        steps: int | None = None,
        parameters: Mapping[str, ArrayLike] | None = None,
        workers: int | None = None,
        on_kink: str = "raise",
        **options: Unpack[RolloutOptions],
    ) -> None:
        check_on_kink(on_kink)
        self._on_kink, self._workers = on_kink, Workers(workers)
        self._settings = settings_of(dt, options)
        given = inputs_of(scene, q0, v0, control, target, parameters)
        self.batch: Batch = batch_of(scene, {name: _shape(name, value) for name, value in given.items()}, steps)
        self._inputs = {name: _filled(name, value, self.batch.full[name]) for name, value in given.items()}
        self._adjoints: dict[tuple[str, ...], list[RunGradients]] = {}
        self._plan = self._planned(compile_scene(scene).scene())  # as it is now
        self._scenes = SceneCache(self._plan.options)
        self._block = joined(list(blocks_of(self._plan, self._workers.number, None, self._scenes)))
        self._raise_errors()
        self.q: Array = self._block.columns["q"]
        self.v: Array = self._block.columns["v"]
        self._warn_of_dense_steps()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the inputs that were given."""
        return tuple(self._inputs)

    def gradients(
        self, gq: ArrayLike, gv: ArrayLike, wrt: Sequence[str] | None = None, of: ArrayLike | None = None
    ) -> dict[str, Array]:
        """Return the gradients of a cost in the inputs from those in the states at the nodes.

        Args:
            gq: in the numbers of q, (B, steps + 1, nq). gv: in v, (B, steps + 1, nv).
            wrt: names of inputs, by default all that were given.
            of: indices of runs (K,): for K gradients at the nodes of these runs, in the place of one of each.

        Returns:
            By name, one row for each gradient at the nodes: (B, ...) or (K, ...). Of parameters that are the same in
            all runs the gradient is the sum of the rows. That in q0 is in its numbers, without a part along changes of
            the norm of quaternions and of pairs (cos, sin), which have none on the states.

        Raises:
            InputError: for arrays of the wrong shape. NotDifferentiable: where a run has no derivative.

        Warns:
            ApproximateDerivativeWarning: where runs have dense steps whose derivative is approximate.
        """
        names = self.names if wrt is None else tuple(wrt)
        picked = list(range(self.batch.runs)) if of is None else [int(k) for k in np.asarray(of)]
        nodes = (len(picked), self.batch.steps + 1)
        lq = array("gq", gq, (*nodes, self.q.shape[2]), "gradients in q at the nodes")
        lv = array("gv", gv, (*nodes, self.v.shape[2]), "gradients in v at the nodes")
        adjoints = self._adjoints_of(names)

        def gradient(k: int, _: object) -> dict[str, Array]:
            return self._gradient(adjoints[picked[k]], picked[k], lq[k], lv[k])

        found = self._workers.each(len(picked), gradient)
        shapes = self.batch.single
        return {name: np.reshape([row[name] for row in found], (len(picked), *shapes[name])) for name in names}

    @cached_property
    def runs(self) -> tuple[Trajectory, ...]:
        """The runs, with what they recorded."""
        trajectories = self._block.trajectories or []
        return tuple(cast(Trajectory, of()) for of in trajectories)

    def forget(self) -> None:
        """Let go of the runs: there are no gradients afterwards."""
        self.runs = ()
        self._compiled = []
        self._adjoints.clear()
        for name in ("_plan", "_scenes", "_block"):
            vars(self).pop(name, None)

    @cached_property
    def _compiled(self) -> list[CompiledScene]:
        """The scene of every run; one for all where they have the same parameters, and test the same pairs."""
        plan, scenes = self._plan, self._scenes
        return [scenes.of(plan, k).at_start(plan.input("q0", k)) for k in range(self.batch.runs)]

    def _planned(self, scene: Scene) -> Plan:
        """Return the runs as a batch of them takes them."""
        steps = self.batch.steps
        chosen = {**self._settings, "duration": steps * self._settings["dt"], "record": "gradient", "record_every": 1}
        rows = {name: value for name, value in self._inputs.items() if name in OF_RUNS}
        values = {name: value for name, value in self._inputs.items() if name not in OF_RUNS}
        own = [name for name in values if self.batch.full[name] != self.batch.single[name]]
        return Plan(
            scene, run_settings_of(scene, chosen, forced=True), "runs", self.batch.runs, rows, {},
            {name: values[name] for name in own}, {name: value for name, value in values.items() if name not in own},
        )  # fmt: skip

    def _raise_errors(self) -> None:
        """Raise the error of the first run that did not reach its end."""
        for k in sorted(self._block.errors):
            error = self._block.errors[k]
            if self.batch.runs > 1:
                error.put_in(f"Run {k} of the batch")
            raise error

    def _warn_of_dense_steps(self) -> None:
        if self._plan.options.contact_mode == "auto" and self._block.trajectories is not None:
            for k in np.flatnonzero(self._block.columns["dense_steps"]):
                warn_of_dense_steps(self.runs[k], stacklevel=4)

    def _adjoints_of(self, names: tuple[str, ...]) -> list[RunGradients]:
        """Return the adjoints of all runs, which are made once."""
        wanted = [name for name in names if name != "target"]
        if "target" in names:
            joints = self.batch.single["target"][-1]
            both = joints == 2 * len(self._compiled[0].built.servo_joints)
            wanted += ["target", "target_velocity"] if both else ["target"]
        if names in self._adjoints:
            return self._adjoints[names]

        def made(k: int, _: object) -> RunGradients:
            return RunGradients(self.runs[k], self._compiled[k], wanted, self._on_kink)

        self._adjoints[names] = self._workers.each(len(self.runs), made)
        for adjoint in self._adjoints[names]:
            adjoint.warn(stacklevel=4)
        return self._adjoints[names]

    def _gradient(self, adjoint: RunGradients, k: int, gq: Array, gv: Array) -> dict[str, Array]:
        model, q = self._compiled[k].built.model, self.q[k]
        found = adjoint.of(in_tangents(model, q, gq), gv)
        if "q0" in found:
            found["q0"] = in_numbers(model, q[0], found["q0"])
        if "target_velocity" in found:
            found["target"] = np.concatenate([found["target"], found.pop("target_velocity")], axis=1)
        return found


def rollouts_of(
    scene: Scene, inputs: Mapping[str, Any], steps: int, workers: int | None, on_kink: str, settings: Any
) -> Rollouts:
    """Return the batch of inputs by name, those of parameters among them, and of settings with dt."""
    own: dict[str, Any] = {name: inputs.get(name) for name in OF_RUNS}
    parameters = {name: value for name, value in inputs.items() if name not in OF_RUNS}
    return Rollouts(scene, **own, steps=steps, parameters=parameters, workers=workers, on_kink=on_kink, **settings)


def inputs_of(
    scene: Scene, q0: Any, v0: Any, control: Any, target: Any, parameters: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the inputs that were given by name; InputError where a scene with servos has no target."""
    if target is None and scene.servo_joints:
        raise InputError(
            "The servos have no target: what they hold by default depends on the start", name="target",
            expected=f"references of {', '.join(scene.servo_joints[:6])} in every step", got="none",
            remedy="Give target=..., of shape (steps, n)",
        )  # fmt: skip
    values = mapping("parameters", {} if parameters is None else parameters, "name: value")
    given = {"q0": q0, "v0": v0, "control": control, "target": target}
    return {name: value for name, value in given.items() if value is not None} | dict(values)


def settings_of(dt: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of the runs; InputError for what a batch of runs has not."""
    for name in options:
        if name not in OPTIONS:
            raise InputError(
                f"A batch of runs has no option {name!r}", name=name, expected=f"one of {', '.join(OPTIONS)}",
                got=name, remedy=did_you_mean(name, OPTIONS),
            )  # fmt: skip
    return {"dt": positive("dt", dt, "the time step in seconds, > 0, for example 1e-3"), **options}


def _shape(name: str, value: Any) -> tuple[int, ...]:
    if real_numbers(value) is None:
        array(name, value, (), "numbers")  # raises
    return shape_of(value)


def _filled(name: str, value: Any, full: tuple[int, ...]) -> Array:
    numbers = np.asarray(value, dtype=float)
    shaped = numbers.reshape(full) if numbers.size == np.prod(full) else np.broadcast_to(numbers, full)
    return array(name, shaped, full, "numbers of every run")
