"""Checks of the states and forces of one model: each returns the clean array or raises an InputError that names it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, UserFunctionError
from contactvi.inputs import UNIT_TOLERANCE, array, shape_of, usable

Array = NDArray[np.float64]


class States:
    """Checks of the states and forces of one model."""

    def __init__(self, model: pin.Model) -> None:
        self.nq, self.nv = int(model.nq), int(model.nv)
        self._units: list[tuple[slice, str]] = []  # entries of q that are a rotation, name of the joint
        for index in range(1, model.njoints):
            part = _unit_part(model, index)
            if part.stop > part.start:
                self._units.append((part, str(model.names[index])))

    def configuration(self, q: Any, name: str = "q0") -> Array:
        """Return q as an array of shape (nq,), unit complex numbers and quaternions normalised.

        Raises:
            InputError: for a wrong shape, numbers that are not finite, and a norm further than 1e-6 from one.
        """
        remedy = (
            "Start from scene.neutral() and set joints with scene.configuration({...}); a free body takes 7 numbers"
        )
        result = array(name, q, (self.nq,), "one configuration", remedy)
        for part, joint in self._units:
            values = result[part]
            norm = math.hypot(*values)
            if abs(norm - 1.0) > UNIT_TOLERANCE:
                what = "quaternion (x, y, z, w)" if part.stop - part.start == 4 else "pair (cos, sin)"
                raise InputError(
                    f"{name} has a {what} of joint {joint!r} that is not a rotation",
                    name=name,
                    expected="norm 1",
                    got=f"{np.array2string(values, precision=6)} with norm {norm:.6g}",
                    remedy=f"Normalise {name}[{part.start}:{part.stop}], or start from scene.neutral()",
                )
            values /= norm
        return result

    def configurations(self, rows: Array) -> Array | None:
        """Return (N, nq) as `configuration` returns each row; None where they have to be looked at one by one."""
        return None if self._units else usable(rows)

    def distance(self, a: Array, b: Array) -> Array:
        """Return the norm of the tangent difference of configurations (N, nq) or (1, nq), shape (N,) [m, rad].

        Angles follow from the chords of unit quaternions and (cos, sin), which lose no digits where they are small.
        Free and planar bodies as R^3 x SO(3) and R^2 x SO(2).
        """
        apart = b - a
        square = np.einsum("ij,ij->i", apart, apart)
        for part, _ in self._units:
            near = np.einsum("ij,ij->i", apart[:, part], apart[:, part])
            if part.stop - part.start == 4:  # q and -q are one rotation, and the chord belongs to half its angle.
                angle = 4.0 * np.arcsin(np.minimum(1.0, 0.5 * np.sqrt(np.minimum(near, 4.0 - near))))
            else:
                angle = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.sqrt(near)))
            square += angle**2 - near
        return np.asarray(np.sqrt(np.maximum(square, 0.0)))

    def velocity(self, v: Any, name: str = "v0") -> Array:
        """Return v as an array of shape (nv,); None is rest."""
        if v is None:
            return np.zeros(self.nv)
        meaning = "one velocity (a free body takes 6 numbers: linear, angular, body frame)"
        return array(name, v, (self.nv,), meaning, "Set joints by name with scene.velocity({...}), or leave it out")

    def force(self, tau: Any, name: str = "tau") -> Array:
        """Return one generalized force as an array of shape (nv,)."""
        remedy = f"Start from np.zeros({self.nv}), and set the entries of the joints that are driven"
        return array(name, tau, (self.nv,), "one generalized force", remedy)

    def controlled(self, tau: Any, t: float) -> Array:
        """Return what a control function returned at t [s] as one generalized force, shape (nv,).

        Raises UserFunctionError with the time.
        """
        try:
            return self.force(tau)
        except InputError as error:
            raise UserFunctionError(
                f"The control returned what cannot be used at t = {t:.9g} s, {error.what}",
                function="control",
                time=t,
                expected=error.expected,
                got=error.got,
                remedy=f"Correct what the control returns. {error.remedy}",
            ) from None

    def forces(self, tau: Any, steps: int, name: str = "control") -> Array:
        """Return the generalized forces of all steps as an array of shape (steps, nv); one (nv,) is that of each."""
        if shape_of(tau) == (self.nv,):
            return np.tile(self.force(tau, name), (steps, 1))
        meaning = f"one generalized force, shape ({self.nv},), or one per step"
        return array(name, tau, (steps, self.nv), meaning)


def _unit_part(model: pin.Model, index: int) -> slice:
    """Return the entries of q that are the unit quaternion or (cos, sin) of a joint; empty for other joints."""
    joint = model.joints[index]
    start, offset = joint.idx_q, 0
    count = {(7, 6): 4, (4, 3): 4, (2, 1): 2}.get((joint.nq, joint.nv), 0)
    if joint.nq == 7:
        offset = 3
    if joint.shortname() == "JointModelPlanar":
        offset, count = 2, 2
    return slice(start + offset, start + offset + count)
