"""The inputs of a run as few numbers: torques of joints and references of servos, constant or linear over intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.inputs import check_choice, count, short
from contactvi.scene.joints import dofs_of, file_limit
from contactvi.scene.scene import Scene
from contactvi.scene.selection import Selector

Array = NDArray[np.float64]
INTERPOLATIONS = ("constant", "linear")


class Inputs:
    """Which forces and references of a run are chosen, and on which grid.

    Args:
        scene: the scene.
        torques: joints, by name, handle or pattern, at which generalized forces act: all their degrees of freedom.
        targets: joints with servos whose references are chosen.
        hold: steps of an interval. The last interval may be shorter.
        interpolation: "constant": one row of numbers for each interval. "linear": one row for each knot, the ends of
            the intervals; a step has the value at its middle, and references of servos have the rate of the line as
            their velocity.

    Attributes:
        names: of the numbers of a row: "torque:joint" ("torque:joint[k]" of several degrees of freedom) and then
            "target:joint".
        torque_dofs: where the torques lie in v. target_joints: the joints of the references.
    """

    def __init__(
        self,
        scene: Scene,
        torques: Sequence[Selector] | Selector = (),
        targets: Sequence[Selector] | Selector = (),
        *,
        hold: int = 1,
        interpolation: str = "constant",
    ) -> None:
        check_choice("interpolation", interpolation, INTERPOLATIONS, "Unknown interpolation")
        self.hold, self.linear = count("hold", hold), interpolation == "linear"
        self._model = scene.model
        joints = select_joints(scene, "torques", torques)
        self.target_joints = select_joints(scene, "targets", targets)
        self._servos = scene.servo_joints
        for joint in self.target_joints:
            if joint not in self._servos:
                raise InputError(
                    f"Joint {joint!r} has no servo", name="targets", expected="joints of scene.servo_joints",
                    got=repr(joint), remedy=f"Call scene.set_servo({joint!r}, kp, kd) first",
                )  # fmt: skip
        dofs = [dofs_of(self._model, joint) for joint in joints]
        self.torque_dofs = [dof for own in dofs for dof in own]
        names = [
            f"torque:{joint}" + (f"[{k}]" if len(own) > 1 else "")
            for joint, own in zip(joints, dofs, strict=True)
            for k in range(len(own))
        ]
        self.names = names + [f"target:{joint}" for joint in self.target_joints]
        if not self.names:
            raise InputError(
                "There are no inputs", name="torques", expected="a joint, in torques or in targets", got="none",
                remedy="For example torques='*'; a problem without inputs has inputs=None",
            )  # fmt: skip

    def check(self, scene: Scene) -> None:
        """Raise InputError where a scene has not the joints and servos for which these inputs were made."""
        for had, has, what in (
            (list(self._model.names)[1:], list(scene.model.names)[1:], "joints"),
            (self._servos, scene.servo_joints, "servos"),
        ):
            if had != has:
                raise InputError(
                    "The inputs belong to another scene", name="inputs", expected=f"{what} of this one: {short(has)}",
                    got=short(had), remedy="Make them of the scene as it is run: inputs=Inputs(scene, torques='*')",
                )  # fmt: skip

    @property
    def columns(self) -> list[int]:
        """Where the references lie among the servo joints of the scene."""
        return [self._servos.index(joint) for joint in self.target_joints]

    def limits(self) -> tuple[Array, Array]:
        """Return the least and the largest number of a row that the model's limits of effort and position allow."""
        model = self._model
        effort = np.array([file_limit(model, dof, "effort") for dof in self.torque_dofs])
        q = [model.idx_qs[model.getJointId(joint)] for joint in self.target_joints]
        circle = np.array([model.nqs[model.getJointId(joint)] == 2 for joint in self.target_joints], dtype=bool)
        lower = np.where(circle, -np.inf, np.asarray(model.lowerPositionLimit)[q])
        upper = np.where(circle, np.inf, np.asarray(model.upperPositionLimit)[q])
        return np.concatenate([-effort, lower]), np.concatenate([effort, upper])

    def over(self, steps: int, dt: float) -> InputMap:
        """Return the map from the numbers to what acts in each of some steps of length dt [s]."""
        place = (np.arange(steps) + (0.5 if self.linear else 0.0)) / self.hold
        low = np.floor(place).astype(int)
        intervals = -(-steps // self.hold)
        rows = intervals + 1 if self.linear else intervals
        return InputMap(rows, low, place - low if self.linear else np.zeros(steps), self.hold * dt, len(self._servos),
                        self.linear, tuple(self.torque_dofs), tuple(self.columns), self._model.nv)  # fmt: skip


@dataclass(frozen=True)
class InputMap:
    """The linear map from rows of numbers u (rows, nu) to forces and references of each step, and its transpose.

    Attributes:
        rows: intervals, or knots. low, fraction: of each step the row before it, and how far it is on the way to the
            next one. interval: [s].
    """

    rows: int
    low: NDArray[np.int64]
    fraction: Array
    interval: float
    servos: int
    linear: bool
    dofs: tuple[int, ...]
    columns: tuple[int, ...]
    nv: int

    def control(self, u: Array) -> Array | None:
        """Return the generalized forces of the steps, shape (steps, nv); None without torques."""
        if not self.dofs:
            return None
        found = np.zeros((len(self.low), self.nv))
        found[:, list(self.dofs)] = self._at_steps(u[:, : len(self.dofs)])
        return found

    def target(self, u: Array, base: Array) -> Array | None:
        """Return positions and velocities of all servos in the steps; `base` (steps, 2 n) are those of the others."""
        if not self.columns:
            return base if self.servos else None
        found, own = base.copy(), u[:, len(self.dofs) :]
        found[:, list(self.columns)] = self._at_steps(own)
        found[:, [self.servos + k for k in self.columns]] = self._rates(own)
        return found

    def transposed(self, gradient: dict[str, Array]) -> Array:
        """Return the gradient (rows, nu) from those by the names of contactvi.gradient, of the steps."""
        found = np.zeros((self.rows, len(self.dofs) + len(self.columns)))
        if self.dofs:
            found[:, : len(self.dofs)] = self._to_rows(gradient["control"][:, list(self.dofs)])
        if self.columns:
            found[:, len(self.dofs) :] = self._to_rows(gradient["target"][:, list(self.columns)])
            if self.linear:
                rates = gradient["target_velocity"][:, list(self.columns)] / self.interval
                np.add.at(found[:, len(self.dofs) :], self.low + 1, rates)
                np.add.at(found[:, len(self.dofs) :], self.low, -rates)
        return found

    def names(self) -> list[str]:
        """Return the names of contactvi.gradient that `transposed` needs."""
        own = ["control"] if self.dofs else []
        return own + (["target"] + (["target_velocity"] if self.linear else []) if self.columns else [])

    def along(self, du: Array) -> dict[str, Array]:
        """Return the change of forces and references with u along du, by the names of contactvi.gradient."""
        found: dict[str, Array] = {}
        control = self.control(du)
        if control is not None:
            found["control"] = control
        if self.columns:
            target = self.target(du, np.zeros((len(self.low), 2 * self.servos)))
            assert target is not None
            found["target"] = target[:, : self.servos]
            if self.linear:
                found["target_velocity"] = target[:, self.servos :]
        return found

    def _at_steps(self, u: Array) -> Array:
        if not self.linear:
            return np.asarray(u[self.low])
        part = self.fraction[:, None]
        return np.asarray((1.0 - part) * u[self.low] + part * u[self.low + 1])

    def _rates(self, u: Array) -> Array | float:
        return np.asarray((u[self.low + 1] - u[self.low]) / self.interval) if self.linear else 0.0

    def _to_rows(self, of_steps: Array) -> Array:
        found = np.zeros((self.rows, of_steps.shape[1]))
        part = self.fraction[:, None]
        np.add.at(found, self.low, (1.0 - part) * of_steps)
        if self.linear:
            np.add.at(found, self.low + 1, part * of_steps)
        return found


def select_joints(scene: Scene, argument: str, given: Any) -> list[str]:
    """Return the names of the joints that were selected; InputError where one is selected twice."""
    several = given if isinstance(given, (list, tuple)) else (given,)
    found = [name for selector in several for name in scene.names.select_joints(selector)]
    twice = next((name for name in found if found.count(name) > 1), None)
    if twice is not None:
        raise InputError(
            f"Joint {twice!r} is named twice", name=argument, expected="joints that differ", got=repr(twice),
            remedy="Leave one of its selectors out",
        )  # fmt: skip
    return found
