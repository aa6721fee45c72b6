"""Targets of servos: references of position and velocity for a run, from what the user gives.

n servo joints in the order of v (Scene.servo_joints). A target is one of

- an array (n,) of positions [rad or m], or (2 n,) of positions and then velocities [rad/s or m/s]: constant;
- an array (steps, n) or (steps, 2 n): one row per step, not with dt="auto";
- a function t -> (n,) or (2 n,);
- a mapping joint -> motion as in `Scene.prescribe`, whose rate is the reference of the velocity; other joints keep
  their default.

By default the target is that of `set_servo(target=)`, else the position at the start of the run. Steps of one length
take what a function or a motion gives at the start of each step, and steps of dt="auto" what it gives at their stages:
smooth functions then keep the order of the method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.elements.signals import Signal
from contactvi.elements.user_functions import at, called, checked
from contactvi.errors import InputError, UserFunctionError
from contactvi.inputs import real_numbers, shape_of
from contactvi.trajectory.compiled import CompiledScene

Array = NDArray[np.float64]


MOST_TARGETS = 10**8  # positions of a run: they are made before it, with their rates in 1.6 GB


def by_steps(target: Any) -> bool:
    """Return whether a target gives references for each step, and is no function of time."""
    return target is not None and not isinstance(target, Mapping) and not callable(target) and len(shape_of(target)) > 1


class Targets:
    """The references of a run that starts at q0 (nq,), as rows of (2 nv,): positions by dof, then velocities."""

    def __init__(self, compiled: CompiledScene, q0: Array) -> None:
        self._compiled, self._start = compiled, q0
        self.joints = compiled.built.servo_joints
        if not self.joints:
            return
        model = compiled.built.model
        ids = [model.getJointId(name) for name in self.joints]
        self._dofs = np.array([model.idx_vs[i] for i in ids], dtype=int)
        self._hold = np.array([_place(model, i, q0) for i in ids], dtype=float)
        self._nv = int(model.nv)
        self._motions = {name: motion for name, motion in compiled.built.arrays.targets.items() if name in self.joints}

    def __deepcopy__(self, memo: Any) -> Targets:
        return self  # nothing in it ever changes

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle keeps: what they were made of."""
        return Targets, (self._compiled, self._start)

    def check_count(self, steps: int) -> None:
        """Raise InputError where the targets of so many steps take too much memory."""
        count = len(self.joints)
        if steps * count > MOST_TARGETS:
            raise InputError(
                "The targets of all steps take too much memory", name="target",
                expected=f"at most {MOST_TARGETS:g} positions", got=f"{count} joints for {steps} steps",
                remedy="Run in pieces: Simulator.run(steps, target=...)",
            )  # fmt: skip

    def rows(self, target: Any, times: Array) -> Array | None:
        """Return the references of steps that start at times (steps,) [s], shape (steps, 2 nv); None without servos.

        Raises:
            InputError: for a target of the wrong shape, UserFunctionError for a function that returns one.
        """
        count, steps = len(self.joints), len(times)
        if count == 0:
            if target is None:
                return None
            raise InputError(
                "There is nothing that follows a target", name="target", expected="a scene with servos", got="none",
                remedy="Call scene.set_servo(joint, kp, kd) first",
            )  # fmt: skip
        if target is None or isinstance(target, Mapping):
            return self._full(self._followed(self._chosen(target or {}), times))
        if callable(target):
            return self._full(np.array([self._asked(target, float(t)) for t in times]).reshape(steps, 2 * count))
        return self._full(self._array(target, steps))

    def moving(self, target: Any) -> Callable[[float], Array] | None:
        """Return the references as a function t -> (2 nv,), for a target that changes in time; else None.

        Raises:
            InputError: for a target of the wrong kind. The function raises UserFunctionError.
        """
        if not self.joints:
            return None
        if target is None or isinstance(target, Mapping):
            motions = self._chosen(target or {})
            if all(motion.constant is not None for motion in motions.values()):
                return None
            return lambda t: self._full(self._followed(motions, np.array([t])))[0]
        if not callable(target):
            return None
        width = 2 * len(self.joints)
        return lambda t: self._full(self._asked(target, t).reshape(1, width))[0]

    def _chosen(self, target: Mapping[Any, Any]) -> dict[str, Signal]:
        motions = dict(self._motions)
        scene = self._compiled.scene() if target else None
        for selector, motion in target.items():
            assert scene is not None
            for name in scene.names.select_joints(selector):
                if name not in self.joints:
                    raise InputError(
                        f"Joint {name!r} has no servo", name="target", expected="one of scene.servo_joints",
                        got=repr(name), remedy="Call scene.set_servo first",
                    )  # fmt: skip
                motions[name] = Signal(motion, f"target of joint {name!r}")
        return motions

    def _followed(self, motions: Mapping[str, Signal], times: Array) -> Array:
        count = len(self.joints)
        values = np.zeros((len(times), 2 * count))
        for k, name in enumerate(self.joints):
            motion = motions.get(name)
            if motion is None or motion.constant is not None:
                values[:, k] = self._hold[k] if motion is None else motion.constant
            else:
                values[:, [k, count + k]] = np.array([motion(float(t))[:2] for t in times]).reshape(-1, 2)
        return values

    def _asked(self, target: Any, t: float) -> Array:
        value = called(target, "target", t, t)
        count = len(self.joints)
        try:
            shape = np.shape(value)
        except ValueError:  # lists of several lengths
            shape = ()
        size = shape[0] if len(shape) == 1 else 0
        if size not in (count, 2 * count):
            raise UserFunctionError(
                f"target returned the wrong shape{at(t)}", function="target", time=t,
                expected=f"shape ({count},) or ({2 * count},), one number per servo joint",
                got=f"shape {shape}", remedy=f"Return the {count} positions, then, if known, the velocities"
            )  # fmt: skip
        return _with_rates(checked(value, "target", t, (size,), "positions of servo joints", self.joints), count)

    def _array(self, target: Any, steps: int) -> Array:
        count = len(self.joints)
        found = real_numbers(target)
        values = np.zeros((0, 0, 0)) if found is None else found
        good = values.ndim in (1, 2) and values.shape[-1] in (count, 2 * count)
        if not good or (values.ndim == 2 and len(values) != steps):
            raise InputError(
                "target has the wrong shape",
                name="target",
                expected=f"({count},), ({2 * count},), ({steps}, {count}) or ({steps}, {2 * count}) for the {count} "
                "servo joints, a function of t or a mapping",
                got=type(target).__name__ if values.ndim == 3 else f"shape {values.shape}",
                remedy=f"Give the positions in the order {', '.join(self.joints[:6])}, or {{joint: value}}",
            )
        if not np.isfinite(values).all():
            raise InputError(
                "target is not finite",
                name="target",
                expected="finite numbers",
                got="nan or inf",
                remedy="Fill the gaps of the target, for example with the position before",
            )
        return np.broadcast_to(_with_rates(values, count), (steps, 2 * count))

    def _full(self, values: Array) -> Array:
        count = len(self.joints)
        rows = np.zeros((len(values), 2 * self._nv))
        rows[:, self._dofs] = values[:, :count]
        rows[:, self._nv + self._dofs] = values[:, count:]
        return rows


def _with_rates(values: Array, count: int) -> Array:
    if values.shape[-1] == 2 * count:
        return values
    return np.concatenate([values, np.zeros_like(values)], axis=-1)


def _place(model: Any, joint: int, q: Array) -> float:
    """Return the position of a joint with one degree of freedom at q (nq,): an angle [rad] or [m]."""
    first = model.idx_qs[joint]
    return float(q[first] if model.nqs[joint] == 1 else np.arctan2(q[first + 1], q[first]))
