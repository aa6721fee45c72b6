"""DTEC and MHC impacts in slow NumPy on the oracles of the step and of the modified energy.

p+ = p- + lambda W^T, one unknown lambda >= 0, loss = (1 - e^2) gamma-^2 / (2 G_c):
  DTEC  E_d of the partial step after the impact = E_d of the partial step before it - loss   (Fetecau et al. 2003)
  MHC   H~_h at the node after the impact = reference - loss                     (Pekarek and Murphey 2014)
Both scalars are parabolas of lambda up to O(h^2); the admissible root lies beyond the plastic impulse -gamma-/G_c.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .del_step import System
from .modified_energy import modified_energy


class NoRoot(ArithmeticError):
    """The scalar equation has no admissible root."""


@dataclass(frozen=True)
class Solved:
    """impulse [N s], p_plus (nv,), gamma_minus [m/s], G_c [1/kg], loss [J], jump [J]: residual of its scalar."""

    impulse: float
    p_plus: np.ndarray
    gamma_minus: float
    inverse_inertia: float
    loss: float
    jump: float


def discrete_energy(system: System, q: np.ndarray, p: np.ndarray, h: float) -> float:
    """E_d = T(q_m, v) + V(q_m) [J] of the step of h [s] from (q, p); h < 0: of the step of |h| that ended there."""
    if h == 0.0:
        return float(energy(system, q, p))
    split = system.split
    _, _, v = system.split_step(q, split.tangent_map(q) @ p, h)
    return float(system.energy(split.integrate(q, 0.5 * h * v), v).sum())


def energy(system: System, q: np.ndarray, p: np.ndarray) -> float:
    """H(q, p) [J], public coordinates."""
    momentum = system.split.tangent_map(q) @ p
    return float(system.energy(q, np.linalg.solve(system.mass_matrix(q), momentum)).sum())


def finish(system: System, q: np.ndarray, p: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """The step of h [s], which may be 0."""
    return (q, p) if h == 0.0 else system.step(q, p, h)


def find_root(f: Callable[[float], float], lower: float, start: float, width: float) -> float:
    """Root of f beyond `lower` (f(lower) < 0), next to `start`, to rounding: bracket by growth, then Illinois.

    Ends when the bracket is empty or f no longer gets smaller; NoRoot where f does not change its sign.
    """
    a, fa = lower, f(lower)
    if fa >= 0.0:
        raise NoRoot(f"f({lower}) = {fa} is not negative")
    b, fb = start, f(start)
    for _ in range(60):
        if fb >= 0.0:
            break
        a, fa, b = b, fb, b + width
        fb, width = f(b), 2.0 * width
    else:
        raise NoRoot("no sign change")
    low = max(lower, start - abs(width))  # mostly the root is close to start: a short bracket saves evaluations
    if a < low < b and (fl := f(low)) < 0.0:
        a, fa = low, fl
    best, f_best, idle, side = (b, fb, 0, 0) if abs(fb) < abs(fa) else (a, fa, 0, 0)
    for _ in range(200):
        c = (a * fb - b * fa) / (fb - fa)
        if not a < c < b:
            c = 0.5 * (a + b)
        if not a < c < b or f_best == 0.0 or idle >= 4:
            break
        fc = f(c)
        if abs(fc) < abs(f_best):
            best, f_best, idle = c, fc, 0
        else:
            idle += 1
        if fc < 0.0:
            a, fa, fb, side = c, fc, fb * (0.5 if side == -1 else 1.0), -1
        else:
            b, fb, fa, side = c, fc, fa * (0.5 if side == 1 else 1.0), 1
    return best


def _solve(
    system: System, q: np.ndarray, p: np.ndarray, gradient: np.ndarray, e: float, scalar: Callable, reference: float
) -> Solved:
    """lambda from scalar(p_plus) = reference - loss, next to the CTEC impulse."""
    t = system.split.tangent_map(q)
    response = np.linalg.solve(system.mass_matrix(q), np.column_stack([t @ p, t @ gradient]))
    gamma, inverse = (float((t @ gradient) @ response[:, k]) for k in (0, 1))
    loss = (1.0 - e * e) * gamma * gamma / (2.0 * inverse)
    plastic = -gamma / inverse

    def f(impulse: float) -> float:
        return scalar(p + impulse * gradient) - (reference - loss)

    impulse = find_root(f, plastic, (1.0 + e) * plastic, 1e-3 * plastic)
    if impulse < 0.0:
        raise NoRoot(f"lambda = {impulse}")
    return Solved(impulse, p + impulse * gradient, gamma, inverse, loss, f(impulse))


def dtec(system, q_c, p_minus, gradient, e: float, before: float, after: float, reference=None) -> Solved:
    """Discrete-time energy conserving impact; before, after: the parts of the step [s]; p, W in Pinocchio coordinates.

    reference: E_d of the step before, minus earlier losses, where it is not that of `before` from p_minus.
    """
    if reference is None:
        reference = discrete_energy(system, q_c, p_minus, -before)
    return _solve(system, q_c, p_minus, gradient, e, lambda p: discrete_energy(system, q_c, p, after), reference)


def mhc(system, q_c, p_minus, gradient, e: float, after: float, h: float, reference: float) -> Solved:
    """Modified-Hamiltonian conserving impact; reference: H~_h [J] at the start of the step or run, less losses."""

    def scalar(p: np.ndarray) -> float:
        return modified_energy(system, *finish(system, q_c, p, after), h)

    return _solve(system, q_c, p_minus, gradient, e, scalar, reference)
