"""Configurations and velocities that satisfy the constraints of a scene, and checks of given ones.

Residuals phi(q, t), shape (m,), are in m and rad; J (m, nv) is their derivative along the tangent of q, phi_t (m,) at
fixed q. `core` is the engine's scene, `rows` name and count them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import ConstraintError, SceneError
from contactvi.scene.element_rows import ConstraintRow
from contactvi.scene.engine import EngineScene

Array = NDArray[np.float64]
START_TOLERANCE = 1e-8  # [m, rad] residual of a start; for its velocity relative to the speeds
_SOLVED = 1e-13  # [m, rad] residual at which Newton's iteration stops
_GOOD = 1e-10  # [m, rad] largest residual of a solution, where the iteration cannot reduce it further
_RANK = 1e-9  # relative singular value below which constraints count as dependent on others
_ITERATIONS, _TRIES = 60, 8


def check_configuration(core: EngineScene, rows: Sequence[ConstraintRow], q: Array, t: float) -> None:
    """Raise ConstraintError where |phi| > 1e-8 at q (nq,), t [s]."""
    phi = np.asarray(core.constraint_residual(q, t))
    bad = by_name(rows, np.where(np.abs(phi) > START_TOLERANCE, phi, 0.0))
    if bad:
        raise ConstraintError(
            f"The start does not satisfy {_listed(bad)}",
            residuals=bad,
            expected=f"residuals of at most {START_TOLERANCE:g} m or rad",
            got=_numbers(bad),
            remedy="Take the start from scene.assemble(q), which puts it on the constraints",
        )


def _broken_rates(core: EngineScene, rows: Sequence[ConstraintRow], q: Array, v: Array, t: float) -> dict[str, float]:
    """Return by name the entries of J v + phi_t that are not 0 to 1e-8 of the speeds in them, or to rounding."""
    J, rate = np.asarray(core.constraint_jacobian(q, t)), np.asarray(core.constraint_rate(q, t))
    speed = J @ v + rate
    allowed = START_TOLERANCE * (np.abs(J) @ np.abs(v) + np.abs(rate)) + 1e-12
    return by_name(rows, np.where(np.abs(speed) > allowed, speed, 0.0))


def check_velocity(core: EngineScene, rows: Sequence[ConstraintRow], q: Array, v: Array, t: float) -> None:
    """Raise ConstraintError where J v + phi_t is not 0 to 1e-8 of the speeds in it, at q (nq,), v (nv,), t [s]."""
    bad = _broken_rates(core, rows, q, v, t)
    if bad:
        raise ConstraintError(
            f"The initial velocity does not satisfy {_listed(bad)}",
            residuals=bad,
            expected=f"J v + dphi/dt = 0 to {START_TOLERANCE:g} of the speeds",
            got=_numbers(bad, "m/s or rad/s"),
            remedy="Take it from scene.consistent_velocity(q, v, t), or leave v0 out",
        )


def assemble(
    core: EngineScene, model: pin.Model, rows: Sequence[ConstraintRow], q: Array, fixed: Sequence[int], t: float
) -> Array:
    """Return a configuration (nq,) on the constraints near q, dofs `fixed` and the limits of joints kept.

    Gauss-Newton with steps of least length in the tangent space, shortened until they help; where it stalls it starts
    again near q. Joints that would pass their limits are kept there like fixed ones.

    Raises:
        ConstraintError: no such configuration was found; the error names the constraints that remain violated.
    """
    q, kept = q.copy(), list(fixed)
    for _ in range(model.nv + 1):
        found, worst = _solve(core, model, q, kept, t)
        if worst > _GOOD:
            break
        over = [dof for dof in _beyond_limits(model, found) if dof not in kept]
        if not over:
            return found
        for dof in over:
            k = _q_of_dof(model, dof)
            q[k] = np.clip(found[k], model.lowerPositionLimit[k], model.upperPositionLimit[k])
        kept += over
    phi = np.asarray(core.constraint_residual(found, t))
    bad = by_name(rows, np.where(np.abs(phi) > _GOOD, phi, 0.0)) or by_name(rows, phi)
    fixed_too = f", with {len(kept)} degrees of freedom fixed" if kept else ""
    raise ConstraintError(
        f"No configuration near the given one satisfies {_listed(bad)}{fixed_too}",
        residuals=bad,
        expected="loops that can be closed, lengths and motions that can be reached",
        got=f"{_numbers(bad)} at best",
        remedy="Start from another q, fix fewer joints, or correct lengths, points and prescribed motions",
    )


def consistent_velocity(
    core: EngineScene, rows: Sequence[ConstraintRow], q: Array, v: Array, t: float, fixed: Sequence[int] = ()
) -> Array:
    """Return the velocity (nv,) with J v + phi_t = 0 that is nearest to v in the metric of the mass.

    Args:
        fixed: dofs that keep their velocities.

    Raises:
        ConstraintError: there is none, because constraints need different speeds.
    """
    nv = len(v)
    mass = np.asarray(core.momentum(np.repeat(q[None], nv, axis=0), np.eye(nv)))
    J, rate = np.asarray(core.constraint_jacobian(q, t)), np.asarray(core.constraint_rate(q, t))
    # Links without a mass of their own may be coupled. What is added does not change where the velocity ends: how far
    # it goes across the couplings is given.
    at = np.cumsum([0, *(row.rows for row in rows)])
    coupled = J[[at[k] for k, row in enumerate(rows) if row.coupled]]
    mass = mass + np.trace(mass) / max(nv, 1) * (coupled.T @ coupled)
    free = np.setdiff1d(np.arange(nv), fixed)
    v = v.copy()
    try:
        lower = np.linalg.cholesky(0.5 * (mass + mass.T)[np.ix_(free, free)])
        scaled = np.linalg.solve(lower, J[:, free].T).T
        for _ in range(2):  # The second projection removes the rounding of the first.
            v[free] -= np.linalg.solve(lower.T, np.linalg.lstsq(scaled, J @ v + rate, rcond=_RANK)[0])
    except np.linalg.LinAlgError as error:
        raise SceneError(
            "No velocity can be computed here",
            expected="masses and constraints of finite numbers, and a mass behind every motion",
            got=str(error),
            remedy="Look for masses near zero, and for points and positions that are very far",
        ) from error
    bad = _broken_rates(core, rows, q, v, t)
    fixed_too = f", with {len(fixed)} degrees of freedom fixed" if len(fixed) else ""
    if bad:
        raise ConstraintError(
            f"No velocity satisfies {_listed(bad)}{fixed_too}",
            residuals=bad,
            expected="constraints whose rates agree",
            got=_numbers(bad, "m/s or rad/s"),
            remedy="Fix fewer joints, correct the rates of prescribed motions and lengths, or start where they agree",
        )
    return v


def by_name(rows: Sequence[ConstraintRow], values: Array) -> dict[str, float]:
    """Return the largest |value| of each constraint that has one above zero, largest first."""
    found: dict[str, float] = {}
    first = 0
    for row in rows:
        found[row.name] = float(np.abs(values[first : first + row.rows]).max(initial=0.0))
        first += row.rows
    return {name: value for name, value in sorted(found.items(), key=lambda item: -item[1]) if value > 0.0}


def _solve(core: EngineScene, model: pin.Model, q: Array, kept: Sequence[int], t: float) -> tuple[Array, float]:
    """Return the best configuration of several starts near q, and its largest residual."""
    free = np.setdiff1d(np.arange(model.nv), kept)
    best, worst = q, np.inf
    random = np.random.default_rng(0)
    for attempt in range(_TRIES):
        start = q
        if attempt:  # At q the gradients of the constraints may depend on each other.
            away = np.zeros(model.nv)
            away[free] = random.standard_normal(len(free)) * 0.02 * 2.0**attempt
            start = pin.integrate(model, q, away)
        found, size = _newton(core, model, start, free, t)
        if size < worst:
            best, worst = found, size
        if worst <= _GOOD:
            break
    return best, worst


def _newton(core: EngineScene, model: pin.Model, q: Array, free: NDArray[np.int64], t: float) -> tuple[Array, float]:
    phi = np.asarray(core.constraint_residual(q, t))
    for _ in range(_ITERATIONS):
        if np.abs(phi).max(initial=0.0) <= _SOLVED or len(free) == 0:
            break
        step = np.zeros(model.nv)
        J = np.asarray(core.constraint_jacobian(q, t))[:, free]
        step[free] = np.linalg.lstsq(J, -phi, rcond=_RANK)[0]
        length = float(np.linalg.norm(step))
        factor = min(1.0, 1.0 / length) if length > 0.0 else 0.0  # at most a radian or a metre
        while factor > 1e-4:
            trial = pin.integrate(model, q, factor * step)
            value = np.asarray(core.constraint_residual(trial, t))
            if np.linalg.norm(value) < np.linalg.norm(phi) * (1.0 - 1e-4 * factor):
                break
            factor *= 0.5
        else:
            break
        q, phi = trial, value
    return q, float(np.abs(phi).max(initial=0.0))


def _q_of_dof(model: pin.Model, dof: int) -> int:
    return next(int(model.idx_qs[i]) for i in range(1, model.njoints) if model.idx_vs[i] == dof)


def _beyond_limits(model: pin.Model, q: Array) -> list[int]:
    """Return the dofs of joints that are beyond their limits at q."""
    found = []
    for i in range(1, model.njoints):
        k = model.idx_qs[i]
        if model.nqs[i] == 1 and not model.lowerPositionLimit[k] <= q[k] <= model.upperPositionLimit[k]:
            found.append(int(model.idx_vs[i]))
    return found


def _listed(residuals: dict[str, float]) -> str:
    names = [repr(name) for name in residuals]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"the constraint{'s' if len(names) > 1 else ''} {', '.join(names[:3])}{more}"


def _numbers(residuals: dict[str, float], unit: str = "m or rad") -> str:
    values = [f"{value:.3g}" for value in residuals.values()]
    return ", ".join(values[:3]) + (", ..." if len(values) > 3 else "") + f" {unit}"
