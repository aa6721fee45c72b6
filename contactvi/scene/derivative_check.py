"""Derivatives that the user gives, compared with central differences of the functions they belong to.

Differences have five points, 1e-4 [rad, m, rad/s, m/s, s] apart, in the tangent space at q: column j belongs to the
motion of q along degree of freedom j. An entry is wrong where it differs by more than the tolerance, relative to
itself, and by more than the errors of the differences from rounding and from the third derivative.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.elements.constraints import PrescribedJoint, PrescribedPose
from contactvi.elements.element import Element
from contactvi.elements.forces import UserForce, UserPotential
from contactvi.elements.pose_signals import PoseSignal
from contactvi.elements.signals import Signal
from contactvi.elements.user_functions import checked_force, checked_force_derivatives, checked_of_q, entry_name
from contactvi.errors import DerivativeError, InputError
from contactvi.inputs import real, short, vector
from contactvi.scene.element_rows import dof_names
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]
Move = Callable[[Array, Array], Array]
TOLERANCE = 1e-5
_STEP = 1e-4
_ROUNDING = 1e3 * float(np.finfo(float).eps) / _STEP
_NOISE = 1e-11  # absolute and relative to the largest entry, for cancellation inside the user's function
GENERIC = 0.1  # [rad, m] displacement from neutral, where much vanishes, to a generic configuration


def check_derivatives(
    item: Any,
    q: Any = None,
    v: Any = None,
    t: float = 0.0,
    *,
    scene: Scene | None = None,
    tolerance: float = TOLERANCE,
) -> None:
    """Compare the derivatives that the user gave with central differences at one state.

    Args:
        item: a Scene, of which all potentials, forces and motions are checked; or an object with value(q), gradient(q)
            and perhaps hessian(q); a pair of functions (force, derivatives) of (t, q, v); or a motion as in
            `Scene.prescribe`.
        q, v: (nq,), (nv,), Pinocchio's numbers; by default near neutral, and a velocity without zeros.
        t: [s].
        scene: whose tangent space it is; without one q is a vector and v has its size.
        tolerance: relative, of an entry.

    Raises:
        DerivativeError: names the derivative and its worst entry (row, column, names of the joints, expected, got).
        UserFunctionError: a function that fails, or returns another shape.
    """
    time, tolerance = real("t", t), real("tolerance", tolerance, 0.0)
    if scene is not None and not isinstance(scene, Scene):
        raise InputError(
            "Argument scene",
            name="scene",
            expected="a Scene or None",
            got=short(scene),
            remedy="Give scene=scene for a function of its q, or leave scene out for a plain vector",
        )
    if isinstance(item, Scene):
        model = item.model
        dofs, move = dof_names(model), mover(model)
        q, v = _state(item, q, v)
        for element in item.elements:
            check_element(element, dofs, move, q, v, time, tolerance)
        for goal in item.built().arrays.targets.values():
            _check_signal(goal, time, tolerance)
        return
    if scene is not None:
        dofs, move = dof_names(scene.model), mover(scene.model)
        q, v = _state(scene, q, v)
    else:
        q = np.zeros(0) if q is None else vector("q", q, np.size(q))
        dofs, move = [f"q[{k}]" for k in range(len(q))], lambda at, by: at + by
        v = np.sin(1.0 + np.arange(len(q))) if v is None else vector("v", v, len(q))
    check_element(_element(item), dofs, move, q, v, time, tolerance)


def check_element(
    element: Element, dofs: Sequence[str], move: Move, q: Array, v: Array, t: float, tolerance: float = TOLERANCE
) -> None:
    """Check the derivatives of an element; dofs (nv,): names, move(q, w): q displaced by w (nv,)."""
    if isinstance(element, UserPotential):
        value = checked_of_q(element.value, f"value of {element.name!r}", dofs, 0)
        gradient = checked_of_q(element.gradient, f"gradient of {element.name!r}", dofs, 1)
        _compare(f"gradient of {element.name!r}", lambda w: np.array(value(move(q, w))), gradient(q), dofs, tolerance)
        if element.hessian is not None:
            hessian = checked_of_q(element.hessian, f"hessian of {element.name!r}", dofs, 2)
            _compare(f"hessian of {element.name!r}", lambda w: gradient(move(q, w)), hessian(q), dofs, tolerance)
    elif isinstance(element, UserForce) and element.derivatives is not None:
        force = checked_force(element.function, repr(element.name), dofs)
        given = checked_force_derivatives(element.derivatives, f"the derivatives of {element.name!r}", dofs)(t, q, v)
        _compare(f"df_dq of {element.name!r}", lambda w: force(t, move(q, w), v), given[0], dofs, tolerance)
        _compare(f"df_dv of {element.name!r}", lambda w: force(t, q, v + w), given[1], dofs, tolerance)
    if isinstance(element, PrescribedPose):
        _check_pose_signal(element.motion, t, tolerance)
    for name in ("motion", "length"):
        if isinstance(getattr(element, name, None), Signal):
            _check_signal(getattr(element, name), t, tolerance)


def _check_signal(signal: Signal, t: float, tolerance: float) -> None:
    """Check rate and acceleration of a function that returns them."""
    if signal.storable:
        return
    time = t + 3.0 * _STEP  # A table may begin at t, so all points lie behind it.
    given = signal(time)
    for k, what in ((0, "rate"), (1, "acceleration")):
        if len(signal.given(time)) > k + 1:
            _compare(
                f"{what} of {signal.name}",
                lambda w, k=k: np.array(signal(time + float(w[0]))[k]),  # type: ignore[misc]
                np.array([given[k + 1]]),
                ["t"],
                tolerance,
            )


def _check_pose_signal(signal: PoseSignal, t: float, tolerance: float) -> None:
    """Check the velocity of a function that returns one."""
    time = t + 3.0 * _STEP
    if not signal.gives_velocity(time):
        return
    given = signal(time)

    def moved(w: Array) -> Array:
        there = signal(time + float(w[0]))
        return np.concatenate([there.position, pin.log3(there.rotation @ given.rotation.T)])

    for k, what in enumerate(f"{kind} velocity along {axis}" for kind in ("linear", "angular") for axis in "xyz"):
        own = np.concatenate([given.velocity, given.angular_velocity])[k : k + 1]
        _compare(f"{what} of {signal.name}", lambda w, k=k: np.array(moved(w)[k]), own, ["t"], tolerance)  # type: ignore[misc]


def _compare(
    name: str, function: Callable[[Array], Array], given: Array, dofs: Sequence[str], tolerance: float
) -> None:
    """Compare `given`, (n,) or (m, n), with the derivative of `function` of n displacements at zero."""
    n = len(dofs)
    expected, slack = np.zeros(given.shape), np.zeros(given.shape)
    for j in range(n):
        w = np.zeros(n)
        values = []
        for k in (-2, -1, 1, 2):
            w[j] = k * _STEP
            values.append(function(w.copy()))
        far, near, ahead, away = values
        coarse = (ahead - near) / (2.0 * _STEP)
        fine = (far - 8.0 * near + 8.0 * ahead - away) / (12.0 * _STEP)
        expected[..., j] = fine
        slack[..., j] = _ROUNDING * np.max(np.abs(values), axis=0) + 0.01 * np.abs(fine - coarse)
    error, size = np.abs(given - expected), np.maximum(np.abs(given), np.abs(expected))
    excess = error - tolerance * size - slack - _NOISE * (1.0 + size.max(initial=0.0))
    if not np.any(excess > 0.0):
        return
    worst = np.unravel_index(int(np.argmax(excess)), excess.shape)
    index = tuple(int(i) for i in worst)
    count = int(np.sum(excess > 0.0))
    more = f" ({count} of {excess.size} entries are wrong)" if count > 1 else ""
    raise DerivativeError(
        f"The {name} is wrong {entry_name(index, dofs)}{more}",
        function=name,
        row=index[0] if len(index) == 2 else None,
        column=index[-1],
        dof=tuple(dofs[i] for i in index),
        error=float(error[index]),
        expected=f"{expected[index]:.9g} by central differences",
        got=f"{given[index]:.9g}",
        remedy="Correct it; derivatives are taken along the tangent of q (Pinocchio's v)",
    )


def _element(item: Any) -> Element:
    if hasattr(item, "value") and hasattr(item, "gradient"):
        return UserPotential("potential", item.value, item.gradient, getattr(item, "hessian", None))
    if isinstance(item, (tuple, list)) and len(item) == 2 and all(callable(part) for part in item):
        return UserForce("force", *item)
    if callable(item):
        return PrescribedJoint("motion", "motion", item)
    raise InputError(
        "The item has no derivatives",
        name="item",
        expected="a Scene, an object with value and gradient, a pair (force, derivatives), or a motion",
        got=repr(item),
        remedy="Give what was handed to add_potential, add_force or prescribe, with its derivatives",
    )


def mover(model: pin.Model) -> Move:
    """Return the motion q (+) w of a model."""
    return lambda q, w: np.asarray(pin.integrate(model, q, w))


def _state(scene: Scene, q: Any, v: Any) -> tuple[Array, Array]:
    """Return a checked state; where none is given, one near neutral and without zeros."""
    generic = np.sin(1.0 + np.arange(scene.nv))
    near = np.asarray(pin.integrate(scene.model, scene.neutral(), GENERIC * generic))
    configuration = near if q is None else scene.built().states.configuration(q, "q")
    return configuration, generic if v is None else vector("v", v, scene.nv)
