"""Directions in all that a run depends on, by name, and the change of a run along them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.inputs import array, short
from contactvi.keywords import meant
from contactvi.trajectory import parameters
from contactvi.trajectory.compiled import CompiledScene
from contactvi.trajectory.gradient import number_of_steps
from contactvi.trajectory.sensitivity import Laws, Recorded, check_parameter, not_differentiable, recorded_run, wanted

Array = NDArray[np.float64]

EXACT = ("q0", "v0", "control", "target", "target_velocity")
GAINS = {"target": 0, "target_velocity": 1}  # rows of the servos' gains


class Direction:
    """A direction by name, and the rows of results."""

    def __init__(self, traj: Recorded, compiled: CompiledScene, w: Mapping[str, Any]) -> None:
        if not isinstance(w, Mapping) or not w:
            raise InputError(
                "This is no direction", name="w", expected="a dict of arrays by name, as a gradient", got=short(w),
                remedy="For example w={'q0': dq, 'control': du}",
            )  # fmt: skip
        self.names = wanted(tuple(w))
        self._traj, self._compiled = traj, compiled
        model = compiled.built.model
        self._servos = [model.idx_vs[model.getJointId(joint)] for joint in compiled.built.servo_joints]
        self._gains = compiled.built.arrays.servo[:2]
        self._w = {name: array(f"w[{name!r}]", w[name], self.shape(name), "a direction") for name in self.names}

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of the part of a name; InputError where nothing has it."""
        nv, steps = self._compiled.states.nv, number_of_steps(self._traj)
        kind = name.partition(":")[0]
        if kind in ("restitution", "friction"):
            return (1,)
        if parameters.is_parameter(name):
            check_parameter(self._traj, name)
            return (len(parameters.directions_of(self._compiled.built.model, name)),)
        shapes: dict[str, tuple[int, ...]] = {"q0": (nv,), "v0": (nv,), "control": (steps, nv)}
        shapes |= dict.fromkeys(GAINS, (steps, len(self._servos)))
        if name not in shapes:
            known = (*EXACT, *parameters.CONTACT_NAMES, *parameters.NAMES)
            raise InputError(
                "Nothing of the run has this name", name="w", expected=f"some of {', '.join(known)}", got=name,
                remedy=meant(kind, known),
            )  # fmt: skip
        return shapes[name]

    def exact(self) -> dict[str, Array]:
        """Return the engine's direction in the start and the inputs: a reference of a servo acts as its torque."""
        nv = self._compiled.states.nv
        tau = np.zeros((number_of_steps(self._traj), nv))
        if "control" in self._w:
            tau += self._w["control"]
        for name, row in GAINS.items():
            if name in self._w:
                tau[:, self._servos] += self._gains[row, self._servos] * self._w[name]
        none = np.zeros(nv)
        return {"q": self._w.get("q0", none), "v": self._w.get("v0", none), "tau": tau}

    def engine(self, run: Any) -> dict[str, Any]:
        """Return the engine's direction of everything, as one column."""
        own = self.exact()
        found: dict[str, Any] = {"count": 1, "q": own["q"][:, None], "v": own["v"][:, None], "inputs": own["tau"]}
        laws = Laws(self._traj, run, self._compiled)
        sums: parameters.Direction = {}
        for name, values in self._w.items():
            kind, _, pair = name.partition(":")
            if kind in ("restitution", "friction"):
                entry = "e" if kind == "restitution" else "mu"
                found[entry] = found.get(entry, 0.0) + laws.column(entry, pair) * values[0]
            elif parameters.is_parameter(name):
                for part, number in zip(
                    parameters.directions_of(self._compiled.built.model, name), values, strict=True
                ):
                    for entry, numbers in part.items():
                        sums[entry] = sums.get(entry, np.zeros_like(numbers)) + number * numbers
        if sums:
            found["parameters"] = [sums]
        return found

    def rows(self, name: str, found: dict[str, Array]) -> Array:
        """Return the rows of a name from the engine's in the start and the inputs."""
        if name in ("q0", "v0"):
            return np.asarray(found[name[0]])
        tau = np.asarray(found["tau"])
        return tau if name == "control" else self._gains[GAINS[name], self._servos] * tau[:, self._servos]


def change_along(traj: Recorded, compiled: CompiledScene, direction: Direction, taken: bool) -> Array:
    """Return the derivative of (q, v) at the nodes along a direction, (N, 2 nv); taken: at kinks of what the run did.

    Raises:
        NotDifferentiable: where there is none.
    """
    run = recorded_run(traj, compiled)
    found = run.tangent(direction.engine(run), list(map(float, traj.t)), taken)
    if "fact" in found:
        raise not_differentiable(traj, found)
    return np.array(found["nodes"])[:, :, 0]
