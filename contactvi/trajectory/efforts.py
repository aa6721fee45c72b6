"""The efforts of servos and actuators at the nodes of a run: what they are asked for, within their limits.

It is the law of core/run/actuation.cpp at the start of the step that begins at a node. Where a limit is met inside of a
step the engine changes to it there, and the effort of the next node shows it.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.importing.joint_kinds import joint_kind
from contactvi.records.actuation import Actuation
from contactvi.scene.build import Built
from contactvi.scene.scene import Scene
from contactvi.trajectory import angles

Array = NDArray[np.float64]


class Efforts(NamedTuple):
    """Efforts at the nodes of a run: t (N,) [s], the joints with their units (N m or N), values (N, joints)."""

    t: Array
    joints: dict[str, str]
    values: Array


class Run(angles.Run, Protocol):
    """What efforts are computed from; contactvi.Trajectory has it."""

    @property
    def actuation(self) -> Actuation | None: ...


def efforts_known(traj: Run) -> bool:
    """Return whether the inputs of a run are known."""
    asked = traj.actuation
    if asked is None or not asked.known:
        return False
    return not asked.empty or not np.any(traj.scene.built().arrays.servo[:2])  # a run of no steps has no references


def computed_efforts(traj: Run) -> Array:
    """Return the effort of every degree of freedom at the nodes (N, nv) [N m or N].

    Raises:
        InputError: what was asked of the motors was not kept.
    """
    asked = traj.actuation
    if asked is None or not efforts_known(traj):
        raise InputError(
            "The inputs of the run were not kept", name="joint",
            expected="a run of simulate, or of a simulator that records all its steps",
            got="steps whose inputs are not known",
            remedy="Run it with simulate, or compute them from what was given: kp (q_ref - q) + kd (v_ref - v)",
        )  # fmt: skip
    built, v = traj.scene.built(), traj.v
    control, references = asked.rows(traj.t)
    wanted = np.zeros_like(v) if control is None else control.copy()
    kp, kd, servo_limit = built.arrays.servo
    driven = (kp != 0.0) | (kd != 0.0)
    for dof in np.flatnonzero(driven):
        error = _position_error(built, int(dof), traj.q, np.zeros(len(v)) if references is None else references[:, dof])
        rate = 0.0 if references is None else references[:, len(kp) + dof]
        wanted[:, dof] += kp[dof] * error + kd[dof] * (rate - v[:, dof])
    effort_limit, speed_limit = built.arrays.actuator
    most = np.minimum(effort_limit, np.where(driven, servo_limit, np.inf))
    given = np.clip(wanted, -most, most)
    cut = (np.abs(v) >= speed_limit) & (given * v > 0.0)  # a joint at its largest speed is not driven on
    return np.where(cut, 0.0, given)


def efforts_of(scene: Scene, t: Array, values: Array) -> Efforts:
    """Return those of the joints with one degree of freedom that have a servo, limits, or an input that is not zero."""
    built = scene.built()
    model, joints, dofs = built.model, {}, []
    limited = np.any(np.isfinite(built.arrays.actuator), axis=0)
    for index in range(1, model.njoints):
        dof = model.idx_vs[index]
        if model.nvs[index] != 1:
            continue
        if np.any(built.arrays.servo[:2, dof]) or limited[dof] or np.any(values[:, dof]):
            joints[str(model.names[index])] = "N" if joint_kind(model.joints[index]) == "prismatic" else "N m"
            dofs.append(dof)
    return Efforts(t, joints, values[:, dofs])


def effort_of(found: Efforts, scene: Scene, joint: Any) -> Array:
    """Return the effort of one joint (N,). Raises InputError."""
    name = scene.names.select_joint(joint)
    if name not in found.joints:
        raise InputError(
            f"Nothing drives joint {name!r}", name="joint", expected="a joint with a servo, limits or an input",
            got=repr(name), remedy=did_you_mean(name, found.joints) if found.joints else
            "Springs, dampers and friction of joints are no motors: scene.set_servo(joint, kp, kd) adds one",
        )  # fmt: skip
    return found.values[:, list(found.joints).index(name)]


def _position_error(built: Built, dof: int, q: Array, reference: Array) -> Array:
    """Return what a servo is away from its reference, (N,): of a continuous joint the shorter way."""
    model = built.model
    joint = int(np.flatnonzero(np.asarray(model.idx_vs)[1:] == dof)[0]) + 1
    first = model.idx_qs[joint]
    if model.nqs[joint] == 1:
        return np.asarray(reference - q[:, first])
    apart = reference - np.arctan2(q[:, first + 1], q[:, first])
    return np.asarray(apart - 2.0 * np.pi * np.rint(apart / (2.0 * np.pi)))
