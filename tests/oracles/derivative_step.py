"""The variational integrator of order 2s with located impacts, in numbers of any kind, for derivatives by differences.

Joints of one degree of freedom only. A step of h from (q0, p0), with Gauss coefficients a_ij, b_i (design of the
integrator: Galerkin variational integrator with Gauss quadrature, Hairer, Lubich, Wanner, "Geometric Numerical
Integration", VI.6, equal to Gauss collocation of Hamilton's equations):
  q_i = q0 + h sum_j a_ij v_j       P(q_i, v_i) = p0 + h sum_j a_ij f_j       f_j = dL/dq(q_j, v_j) + F(q_j, v_j)
  q1  = q0 + h sum_i b_i v_i        p1 = p0 + h sum_i b_i f_i                 P = dL/dv
An impact inside of it: a partial step of length a to gap(q_c) = 0, the map of continuous-time energy conservation
  p+ = p- - (1 + e) (gamma / G_c) W,   W = dgap/dq,   gamma = W M^-1 p-,   G_c = W M^-1 W
and a step of h - a. P, dL/dq and W come from L(q, v) and the gap by dual numbers, M from P by its linearity in v.

A run is a function of one dict of inputs, `x`: q0 (n,) [rad], p0 (n,) momenta or v0 (n,) velocities, h [s], the
restitution e, and what the functions of `Motion` look up in it. All numbers of x are of one kind (oracles.precise).
"""

from __future__ import annotations

import decimal
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np
from scipy.optimize import brentq

from . import precise
from .precise import gradient, vector

SAMPLES = 2  # partial steps looked at per step, for a gap that closes and opens again inside of it


@dataclass(frozen=True)
class Motion:
    """A mechanical system as functions that take any kind of number: L(q, v, x), force(q, v, x), gap(q, x)."""

    lagrangian: Callable
    force: Callable
    gap: Callable | None = None


# --- systems --------------------------------------------------------------------------------------------------------
def chain(q, v, x):
    """Lagrangian [J] of a planar chain of links that hangs from the origin, relative joint angles from the vertical.

    x: masses, lengths [m], gravity [m/s^2]; where given, centres [m] (of mass, along the link; else its end) and
    inertias [kg m^2] (about the centre; else none). Link i points along (sin a_i, -cos a_i), a_i = q_1 + .. + q_i.
    """
    angle, rate, at, speed, total = 0, 0, [0, 0], [0, 0], 0
    for i, mass in enumerate(x["masses"]):
        angle, rate = angle + q[i], rate + v[i]
        s, c = precise.sin(angle), precise.cos(angle)
        arm = x["centres"][i] if "centres" in x else x["lengths"][i]
        inertia = x["inertias"][i] if "inertias" in x else 0
        u, w, height = speed[0] + arm * c * rate, speed[1] + arm * s * rate, at[1] - arm * c
        total = total + mass * (u * u + w * w) / 2 + inertia * rate * rate / 2 - mass * x["gravity"] * height
        at = [at[0] + x["lengths"][i] * s, at[1] - x["lengths"][i] * c]
        speed = [speed[0] + x["lengths"][i] * c * rate, speed[1] + x["lengths"][i] * s * rate]
    return total


def joint_forces(q, v, x) -> list:
    """tau - damping v - stiffness (q - rest) [N m]; each of the four (n,) where given in x, else zero."""
    force = [0] * len(q)
    for i in range(len(q)):
        if "tau" in x:
            force[i] = force[i] + x["tau"][i]
        if "damping" in x:
            force[i] = force[i] - x["damping"][i] * v[i]
        if "stiffness" in x:
            force[i] = force[i] - x["stiffness"][i] * (q[i] - x["rest"][i] if "rest" in x else q[i])
    return force


def tip_gap(q, x):
    """Horizontal distance of the chain's tip from a wall at x["wall"] [m]; the tip stays to the right of it."""
    angle, at = 0, -x["wall"]
    for length, turn in zip(x["lengths"], q, strict=True):
        angle = angle + turn
        at = at + length * precise.sin(angle)
    return at


PENDULUM = Motion(chain, joint_forces, tip_gap)  # double, with two links; problem B has masses, lengths 1 and wall 0


def _ball(q, v, x):
    return x["mass"] * (v[0] * v[0] / 2 - x["gravity"] * q[0])


def _oscillator(q, v, x):
    return (v[0] * v[0] - x["omega"] * x["omega"] * q[0] * q[0]) / 2


BALL = Motion(_ball, joint_forces, lambda q, x: q[0])  # height of a ball above the ground; mass, gravity
OSCILLATOR = Motion(_oscillator, joint_forces, lambda q, x: q[0] - x["wall"])  # unit mass; omega, wall


# --- Legendre's transformation --------------------------------------------------------------------------------------
def momentum_and_force(motion: Motion, q, v, x) -> tuple[np.ndarray, np.ndarray]:
    """P = dL/dv and dL/dq + F, both (n,)."""
    n = len(q)
    slope = gradient(lambda y: motion.lagrangian(y[:n], y[n:], x), [*q, *v])[1]
    return slope[n:], slope[:n] + vector(motion.force(q, v, x))


def mass_matrix(motion: Motion, q, x) -> np.ndarray:
    """M (n, n), of a Lagrangian that is quadratic in v: P is linear."""
    zero = q[0] - q[0]
    unit = [[zero + (1 if i == j else 0) for j in range(len(q))] for i in range(len(q))]
    return np.array([list(momentum_and_force(motion, q, e, x)[0]) for e in unit], dtype=object)


def momentum(motion: Motion, q, v, x) -> np.ndarray:
    """P(q, v), shape (n,)."""
    return momentum_and_force(motion, q, v, x)[0]


def velocity(motion: Motion, q, p, x) -> np.ndarray:
    """M^-1 p, shape (n,)."""
    return precise.solve_linear(mass_matrix(motion, q, x), p)


# --- Gauss coefficients ---------------------------------------------------------------------------------------------
def gauss_table(s: int, kind: type) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(c, b, A) of s Gauss points on [0, 1]: Decimal in the digits at hand, else floats; (s,), (s,), (s, s)."""
    if kind is Decimal:
        return _decimal_table(s, decimal.getcontext().prec)
    with decimal.localcontext() as context:
        context.prec = 30
        return tuple(x.astype(float) for x in _decimal_table(s, 30))  # type: ignore[return-value]


@functools.cache
def _decimal_table(s: int, _digits: int):
    """Roots of the Legendre polynomial on [0, 1] by Newton, weights by integrals of the Lagrange polynomials."""
    one, p = Decimal(1), [[Decimal(1)], [Decimal(-1), Decimal(2)]]  # coefficients, lowest first
    for k in range(1, s):  # (k+1) P_(k+1) = (2k+1) (2x-1) P_k - k P_(k-1)
        a, b = [Decimal(0), *p[k]], [*p[k], Decimal(0)]
        c = [*p[k - 1], Decimal(0), Decimal(0)]
        p.append([((2 * k + 1) * (2 * u - v) - k * w) / (k + 1) for u, v, w in zip(a, b, c, strict=True)])
    nodes = [Decimal(0.5 * (x + 1.0)) for x in np.polynomial.legendre.leggauss(s)[0]]
    for _ in range(8):
        nodes = [x - _value(p[s], x) / _value([k * u for k, u in enumerate(p[s])][1:], x) for x in nodes]
    a, b = np.empty((s, s), dtype=object), np.empty(s, dtype=object)
    for j in range(s):
        basis = [one]
        for i in set(range(s)) - {j}:  # times (x - c_i) / (c_j - c_i)
            shifted, same = [Decimal(0), *basis], [*basis, Decimal(0)]
            basis = [(u - nodes[i] * v) / (nodes[j] - nodes[i]) for u, v in zip(shifted, same, strict=True)]
        integral = [Decimal(0), *(u / (k + 1) for k, u in enumerate(basis))]
        a[:, j], b[j] = [_value(integral, x) for x in nodes], _value(integral, one)
    return vector(nodes), b, a


def _value(coefficients: Sequence, x):
    return sum((u * x**k for k, u in enumerate(coefficients) if k), coefficients[0])


# --- one step -------------------------------------------------------------------------------------------------------
def _stages(motion: Motion, x: dict, stages: int, h, v):
    """(residuals (s * n,), q1, p1) of the equations above for any stage velocities v (s, n) and any length h."""
    _, b, a = gauss_table(stages, type(x["q0"][0]))
    q0, p0 = x["q0"], x["p0"]
    q = [q0 + h * row @ v for row in a]
    stages_of = [momentum_and_force(motion, *y, x) for y in zip(q, v, strict=True)]
    p, f = (np.array(y, dtype=object) for y in zip(*stages_of, strict=True))
    residual = [p[i] - p0 - h * (a[i] @ f) for i in range(stages)]
    return np.concatenate(residual), q0 + h * (b @ v), p0 + h * (b @ f)


def step(motion: Motion, x: dict, stages: int):
    """(q1, p1) after x["h"]."""
    n = len(x["q0"])
    v = precise.refine(
        lambda z: _stages(motion, x, stages, x["h"], z.reshape(stages, n))[0],
        *_rough_step(motion, precise.frozen(x), stages),
        type(x["q0"][0]),
    )
    return _stages(motion, x, stages, x["h"], v.reshape(stages, n))[1:]


def step_to_gap(motion: Motion, x: dict, stages: int):
    """(q_c, p_minus, a): the first partial step of length a <= x["h"] [s] to gap = 0; None if the gap stays open."""
    rough = _rough_step_to_gap(motion, precise.frozen(x), stages)
    if rough is None:
        return None
    n = len(x["q0"])
    z = precise.refine(lambda z: _to_gap(motion, x, stages, z)[0], *rough, type(x["q0"][0]))
    return *_stages(motion, x, stages, z[-1], z[:-1].reshape(stages, n))[1:], z[-1]


def _to_gap(motion: Motion, x: dict, stages: int, z):
    residual, q1, _ = _stages(motion, x, stages, z[-1], np.reshape(z[:-1], (stages, len(x["q0"]))))
    return [*residual, motion.gap(q1, x)], q1


def _thawed(key: tuple) -> dict:
    return {name: vector(y) if isinstance(y, tuple) else y for name, y in key}


@functools.lru_cache(maxsize=10_000)
def _rough_step(motion: Motion, key: tuple, stages: int) -> tuple[np.ndarray, np.ndarray]:
    """Stage velocities (s * n,) good to some ten digits, and the inverse of the derivative of the equations."""
    x = _thawed(key)
    start = np.tile(np.array(velocity(motion, x["q0"], x["p0"], x), dtype=float), stages)
    return precise.newton(lambda z: _stages(motion, x, stages, x["h"], np.reshape(z, (stages, -1)))[0], start)


@functools.lru_cache(maxsize=10_000)
def _rough_step_to_gap(motion: Motion, key: tuple, stages: int):
    """The same for the stage velocities and the length of the partial step to the first zero of the gap."""
    x = _thawed(key)

    def after(length: float) -> float:
        return float(motion.gap(step(motion, {**x, "h": length}, stages)[0], x))

    low = 0.0
    for high in x["h"] * np.arange(1, SAMPLES + 1) / SAMPLES:
        if after(high) < 0.0:
            if low == 0.0:  # right after an impact the gap is zero to ten digits: start where it is surely open
                low = next(y for y in high * 2.0 ** -np.arange(1, 20) if after(y) > 0.0)
            length = float(brentq(after, low, high, xtol=1e-9))
            start = _rough_step(motion, precise.frozen({**x, "h": length}), stages)[0]
            return precise.newton(lambda z: _to_gap(motion, x, stages, z)[0], [*start, length])
        low = high
    return None


def impact(motion: Motion, q, p, x) -> np.ndarray:
    """p_plus of the map above."""
    w = gradient(lambda y: motion.gap(y, x), list(q))[1]
    response = precise.solve_linear(mass_matrix(motion, q, x), np.array([list(p), list(w)], dtype=object).T)
    return p - w * ((1 + x["e"]) * (w @ response[:, 0]) / (w @ response[:, 1]))


# --- runs -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class End:
    """State at the end of a run and the times of its impacts [s] with the states after them."""

    q: np.ndarray
    p: np.ndarray
    times: list


def run(motion: Motion, x: dict, stages: int, steps: int = 1) -> End:
    """`steps` steps of x["h"] from (q0, p0) with all their impacts; the rest of a step after one is a single step."""
    x, times = dict(x), []
    h = x["h"]
    for n in range(steps):
        left = h
        while motion.gap is not None:
            hit = step_to_gap(motion, {**x, "h": left}, stages)
            if hit is None:
                break
            q, p, a = hit
            times.append(n * h + (h - left) + a)
            x["q0"], x["p0"], left = q, impact(motion, q, p, x), left - a
        x["q0"], x["p0"] = step(motion, {**x, "h": left}, stages)
    return End(x["q0"], x["p0"], times)


def outcome(motion: Motion, stages: int, steps: int = 1) -> Callable[[dict], list]:
    """f(x) = [q1, p1, impact times] of a run: what oracles.precise differentiates.

    With "v0" in x instead of "p0" the state is (q, v): f(x) = [q1, v1, impact times], as in continuous time.
    """

    def f(x: dict) -> list:
        if "v0" not in x:
            end = run(motion, x, stages, steps)
            return [*end.q, *end.p, *end.times]
        end = run(motion, {**x, "p0": momentum(motion, x["q0"], x["v0"], x)}, stages, steps)
        return [*end.q, *velocity(motion, end.q, end.p, x), *end.times]

    return f
