"""How the inputs u (nu,) of a control problem act on a scene: as torques of joints and as references of servos."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.control.inputs import select_joints
from contactvi.errors import InputError
from contactvi.importing.joint_kinds import has_limits
from contactvi.scene.joints import file_limit
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]


class Drives:
    """What the entries of u do.

    Args:
        scene: the scene.
        torques: joints whose generalized forces are entries of u, in the order of v, one for each dof: names, patterns,
            parts or handles. None: all joints, or none where `targets` are given.
        targets: servo joints (Scene.set_servo) whose references of the position are entries of u, after the torques;
            other servos hold where they start.

    Attributes:
        nu: number of entries. names: of the entries, the joint, with a number where it has several dofs.
        forces: d tau / d u, shape (nv, nu): a reference acts as the torque kp times it.
        lower, upper: bounds by the model, shape (nu,): efforts and positions [N, N m; m, rad]; infinite without.

    Raises:
        InputError: for an unknown joint, one that is named twice, and a target of a joint without servo.
    """

    def __init__(self, scene: Scene, torques: Any = None, targets: Any = ()) -> None:
        built, model = scene.built(), scene.model
        servos = built.servo_joints
        followed = _selected(scene, targets, "targets")
        for name in followed:
            if name not in servos:
                raise InputError(
                    f"Joint {name!r} has no servo", name="targets", expected="some of scene.servo_joints",
                    got=repr(name), remedy="Call scene.set_servo(joint, kp, kd) first",
                )  # fmt: skip
        everything = [str(name) for name in list(model.names)[1:]]
        driven = ([] if followed else everything) if torques is None else _selected(scene, torques, "torques")
        dofs = [(name, model.idx_vs[i] + k) for name in driven for i in [model.getJointId(name)]
                for k in range(model.nvs[i])]  # fmt: skip
        self.nv = int(model.nv)
        self.torques, self.targets = len(dofs), len(followed)
        self.nu = self.torques + self.targets
        if self.nu == 0:
            raise InputError(
                "There are no inputs", name="torques", expected="at least one joint", got="none",
                remedy="Name joints: torques=['joint_1'] or targets=['joint_1']",
            )  # fmt: skip
        self.names = [_label(model, name, dof) for name, dof in dofs] + followed
        self._dofs = np.array([dof for _, dof in dofs], dtype=int)
        self._at = at = np.array([model.idx_vs[model.getJointId(name)] for name in followed], dtype=int)
        self.forces = np.zeros((self.nv, self.nu))
        self.forces[self._dofs, np.arange(self.torques)] = 1.0
        self.forces[at, np.arange(self.torques, self.nu)] = built.arrays.servo[0, at]
        self.lower, self.upper = self._bounds(model, followed)

    def control(self, u: Array) -> Array | None:
        """Return the generalized forces (steps, nv) of inputs u (steps, nu); None where u holds references alone."""
        if self.torques == 0:
            return None
        tau = np.zeros((len(u), self.nv))
        tau[:, self._dofs] = u[:, : self.torques]
        return tau

    def references(self, u: Array, others: Array | None) -> Array | None:
        """Return the references of the servos, (steps, 2 nv): positions by dof, then velocities; None without servos.

        Args:
            u: inputs, shape (steps, nu).
            others: the references without u, the same shape; None without servos.
        """
        if others is None or self.targets == 0:
            return others
        rows = np.array(others)
        rows[:, self._at] = u[:, self.torques :]
        rows[:, self.nv + self._at] = 0.0
        return rows

    def inputs(self, control: Array | None, references: Array | None) -> Array:
        """Return the u (steps, nu) that acts as generalized forces (steps, nv) and references (steps, 2 nv) do.

        None is zero.
        """
        steps = next((len(part) for part in (control, references) if part is not None), 0)
        u = np.zeros((steps, self.nu))
        if control is not None:
            u[:, : self.torques] = control[:, self._dofs]
        if references is not None:
            u[:, self.torques :] = references[:, self._at]
        return u

    def _bounds(self, model: Any, followed: Sequence[str]) -> tuple[Array, Array]:
        effort = np.array([file_limit(model, int(dof), "effort") for dof in self._dofs])
        joints = [model.getJointId(name) for name in followed]
        low, high = np.full(len(joints), -np.inf), np.full(len(joints), np.inf)
        for k, joint in enumerate(joints):
            if has_limits(model, joint):
                at = model.idx_qs[joint]
                low[k], high[k] = model.lowerPositionLimit[at], model.upperPositionLimit[at]
        return np.concatenate([-effort, low]), np.concatenate([effort, high])


def _selected(scene: Scene, selectors: Any, argument: str) -> list[str]:
    """Return the names of the selected joints in the order of v."""
    model = scene.model
    return sorted(select_joints(scene, argument, selectors), key=lambda name: int(model.idx_vs[model.getJointId(name)]))


def _label(model: Any, name: str, dof: int) -> str:
    joint = model.getJointId(name)
    return name if model.nvs[joint] == 1 else f"{name}[{dof - model.idx_vs[joint]}]"
