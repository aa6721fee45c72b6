"""What the runs of a batch are made of: the scene, the options, and the inputs of every run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.batch.shapes import leading_of, size_of
from contactvi.errors import InputError
from contactvi.inputs import check_signature, mapping, real_numbers, shape_of, short
from contactvi.options import Options
from contactvi.scene.scene import Scene
from contactvi.simulation.simulator import Simulator
from contactvi.trajectory.compiled import compile_scene

Array = NDArray[np.float64]
Report = Callable[[int], object]  # is told how many runs were made


@dataclass(frozen=True, eq=False)
class Plan:
    """The runs of a batch; the numbers in it are not checked, because a bad run does not end the others.

    Attributes:
        scene: of all runs. options: of all runs.
        keep: "ends", "nodes" or "runs".
        runs: number of runs.
        rows: by name, inputs with a row for each run: "q0", "v0", "control", "target".
        shared: by name, inputs that are the same in all runs.
        parameters: values of parameters by name, with a row for each run. common: those that are the same in all runs.
        start: from whose present state all runs go on; None: from q0 and v0.
    """

    scene: Scene
    options: Options
    keep: str
    runs: int
    rows: Mapping[str, Array]
    shared: Mapping[str, Any]
    parameters: Mapping[str, Array]
    common: Mapping[str, Any]
    start: Simulator | None = None

    @property
    def bytes_of_a_run(self) -> float:
        """About the memory of the states that are kept of a run; with "auto" and without samples that of the ends."""
        nodes = 1.0 if self.keep == "ends" else (self.nodes or 1.0)
        return float(nodes * (self.scene.model.nq + self.scene.model.nv + 1) * 8.0)

    @property
    def nodes(self) -> float | None:
        """Number of nodes of a run that reaches its end, at most; None where it is not known before the run."""
        options = self.options
        if options.sample_dt is not None:
            return options.span / options.sample_dt + 2.0
        return None if options.auto else options.steps / options.record_every + 2.0

    def part(self, first: int, last: int) -> Plan:
        """Return the runs from first to last - 1."""
        rows, own = (
            {name: values[first:last] for name, values in group.items()} for group in (self.rows, self.parameters)
        )
        return replace(self, runs=last - first, rows=rows, parameters=own)

    @property
    def given(self) -> dict[str, Array]:
        """Starts and parameters of all runs as they were given, by name, (runs, ...); without those that were not."""
        starts = {name: values for name, values in self.shared.items() if name in ("q0", "v0")} | {
            name: values for name, values in self.rows.items() if name in ("q0", "v0")
        }
        once = {name: values for name, values in {**starts, **self.common}.items() if name not in self.rows}
        several = {name: values for name, values in starts.items() if name in self.rows} | dict(self.parameters)
        return {
            name: np.broadcast_to(values, (self.runs, *np.shape(values))) for name, values in once.items()
        } | several

    def input(self, name: str, k: int) -> Any:
        """Return an input of run k; None where it was not given."""
        return self.rows[name][k] if name in self.rows else self.shared.get(name)

    def key(self, k: int) -> bytes:
        """Return what is equal for runs of equal parameters."""
        return b"".join(np.ascontiguousarray(values[k]).tobytes() for values in self.parameters.values())

    def scene_of(self, k: int) -> Scene:
        """Return the scene of run k; InputError for parameters that no scene has."""
        values = {name: rows[k] for name, rows in self.parameters.items()}
        return self.scene.with_parameters({**self.common, **values}) if values or self.common else self.scene


def plan_of(
    scene: Scene, options: Options, keep: str, inputs: Mapping[str, Any], parameters: Mapping[str, Any] | None
) -> Plan:
    """Return the plan of a batch.

    Args:
        inputs: "q0", "v0", "control" and "target", None where they are not given.

    Raises:
        InputError: for shapes that do not fit the scene, or each other.
    """
    states = compile_scene(scene).states
    steps = 0 if options.auto else options.steps
    single = {"q0": (states.nq,), "v0": (states.nv,), "control": (steps, states.nv)}
    given = {name: value for name, value in inputs.items() if value is not None}
    values = dict(mapping("parameters", {} if parameters is None else parameters, "name: value"))
    single |= {name: tuple(scene.parameter(name).shape) for name in values}
    shared = {name: given.pop(name) for name in ("control", "target") if _is_function(given.get(name))}
    if callable(shared.get("control")):
        check_signature("control", shared["control"], ("t", "q", "v"))
    if "target" in given and np.ndim(_numbers("target", given["target"])) < 3:
        shared["target"] = given.pop("target")  # of the shapes that a single run takes
    arrays = {name: _numbers(name, value) for name, value in {**given, **values}.items()}
    if "target" in arrays:
        single["target"] = arrays["target"].shape[1:]
    leading = {name: leading_of(name, shape_of(value), single[name]) for name, value in arrays.items()}
    runs = size_of(leading) or 1
    several = {name: np.broadcast_to(value, (runs, *single[name])) for name, value in arrays.items() if leading[name]}
    once = {name: value for name, value in arrays.items() if not leading[name]}
    return Plan(
        scene, options, keep, runs,
        {name: value for name, value in several.items() if name in given},
        shared | {name: value for name, value in once.items() if name in given},
        {name: value for name, value in several.items() if name in values},
        {name: value for name, value in once.items() if name in values},
    )  # fmt: skip


def plan_from(
    simulator: Simulator, options: Mapping[str, Any], keep: str, inputs: Mapping[str, Any], others: Mapping[str, Any]
) -> Plan:
    """Return the plan of a batch whose runs go on from the present state of a simulator.

    Args:
        options: that were given; inputs: as for plan_of. others: arguments that such a batch has not, by name.

    Raises:
        InputError: for what such runs have not, and as plan_of. SimulationError: the simulator was not started.
    """
    status = simulator.status
    given = [name for name, value in {**others, **options}.items() if value is not None and name != "duration"]
    functions = callable(inputs["control"]) or compile_scene(simulator.scene).core.calls_functions
    ended = status is not None and not status.ok
    if given or keep == "runs" or functions or ended or simulator.options.impact == "dtec":
        got = given[0] if given else "keep='runs'" if keep == "runs" else "functions" if functions else repr(
            status.code.name if status is not None and ended else "dtec"
        )  # fmt: skip
        raise InputError(
            "Runs cannot go on like this from the state of a simulator", name=given[0] if given else "scene",
            expected="control and target as arrays, duration, keep='ends' or 'nodes', a run that can go on", got=got,
            remedy="Leave it out, or go on with sim.copy().run(...)",
        )  # fmt: skip
    settings = replace(simulator.options, duration=options.get("duration"), record="states")
    _ = settings.span
    return replace(plan_of(simulator.scene, settings, keep, inputs, None), start=simulator)


def _is_function(value: Any) -> bool:
    return callable(value) or isinstance(value, Mapping)


def _numbers(name: str, value: Any) -> Array:
    """Return real numbers as an array; they may be NaN, which is the fault of their run alone."""
    found = real_numbers(value)
    if found is None:
        raise InputError(
            f"{name} is not an array of numbers", name=name, expected="one run, or one row for each run",
            got=short(value), remedy="Give plain numbers in a list or a NumPy array, in rows of one length",
        )  # fmt: skip
    return found
