"""Impacts between Gauss steps, slow and obvious, and problem B in long double as a check of oracles.problem_b.

An event is bracketed on exact partial steps (no dense output); the map then works on the partial steps of its step:
  CTEC  lambda = -(1 + e) gamma / G_c
  DTEC  E_d of the step after the impact = E_d of the one before - loss,  E_d = sum b_i E(q_i, v_i)
  MHC   H at the end of the step = H at its start - losses  (one stage: the modified energy)
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import ctec_oracle, dtec_mhc
from .gauss_step import GaussStep
from .modified_energy import modified_energy

METHODS = ("ctec", "dtec", "mhc")
SAMPLES = 3  # partial steps looked at per step, for a gap that closes and opens again inside of it


@dataclass(frozen=True)
class Hit:
    """An impact: step, parts of the step before and after it [s], state, gamma_minus [m/s], impulse [N s], loss [J]."""

    step: int
    before: float
    after: float
    q: np.ndarray
    p_minus: np.ndarray
    p_plus: np.ndarray
    gamma_minus: float
    impulse: float
    loss: float


def crossing(gauss: GaussStep, gap: Callable, q, p, h: float) -> float | None:
    """Length of the exact partial step [s] to the first zero of the gap (gap(q) >= 0), None if it stays open."""

    def after(part: float) -> float:
        return gap(gauss.step(q, p, part)[0])

    low = 0.0
    for high in h * np.arange(1, SAMPLES + 1) / SAMPLES:
        if after(high) < 0.0:
            if low == 0.0:  # right after an impact the gap is zero to rounding: start where it is surely open
                low = next(x for x in high * 2.0 ** -np.arange(1, 30) if after(x) > 0.0)
            return dtec_mhc.find_root(lambda x: -after(x), low, high, high - low)
        low = high
    return None


def conserved(gauss: GaussStep, q, p, h: float) -> float:
    """The scalar MHC keeps: H(q, p) [J], for one stage the modified energy of the step h."""
    return modified_energy(gauss.system, q, p, h) if gauss.s == 1 else dtec_mhc.energy(gauss.system, q, p)


def apply(gauss: GaussStep, method: str, gradient, e: float, start, part: float, after: float, h: float, reference):
    """(Hit without its step, discrete energy or H to go on with) at the end of the partial step `part` from `start`."""
    system = gauss.system
    done = gauss.solve(*start, part)
    q, p = done.q1, system.split.tangent_map(done.q1).T @ done.p1
    w = gradient(q)
    plain = ctec_oracle.impact(system.split.original, q, p, w, e)
    loss = (1.0 - e * e) * plain.gamma_minus**2 / (2.0 * plain.inverse_inertia)
    impulse, p_plus = plain.impulse, plain.p_plus
    if method != "ctec":
        if method == "dtec":
            reference = gauss.energy_of_stages(done)

            def scalar(momentum):
                return gauss.discrete_energy(q, momentum, after)
        else:

            def scalar(momentum):
                return conserved(gauss, *gauss.step(q, momentum, after), h)

        solved = dtec_mhc._solve(system, q, p, w, e, scalar, reference)
        impulse, p_plus = solved.impulse, solved.p_plus
    return Hit(-1, part, after, q, p, p_plus, plain.gamma_minus, impulse, loss), reference - loss


def run(gauss: GaussStep, gap: Callable, gradient: Callable, q, p, h: float, steps: int, method: str, e: float = 1.0):
    """(q (steps + 1, nq), p, list of Hit) in Pinocchio coordinates; one contact: gap(q) [m], gradient(q) (nv,)."""
    qs, ps, hits = [q], [p], []
    for k in range(steps):
        left, reference = h, conserved(gauss, q, p, h) if method == "mhc" else 0.0
        for _ in itertools.count():
            part = crossing(gauss, gap, q, p, left)
            if part is None:
                q, p = gauss.step(q, p, left)
                break
            hit, reference = apply(gauss, method, gradient, e, (q, p), part, left - part, h, reference)
            hits.append(Hit(k, *list(vars(hit).values())[1:]))
            q, p, left = hit.q, hit.p_plus, left - part
        qs.append(q)
        ps.append(p)
    return np.array(qs), np.array(ps), hits


# --- problem B in long double -------------------------------------------------------------------------------------
def _rates(y):
    a, b, u, w = y
    s, c = np.sin(a - b), np.cos(a - b)
    gravity = np.longdouble(981) / 100
    f, g = -s * w * w - 2 * gravity * np.sin(a), s * u * u - gravity * np.sin(b)
    return np.array([u, w, (f - c * g) / (2 - c * c), (2 * g - c * f) / (2 - c * c)])


def _extrapolate(y, h, columns=8):
    """One step of Gragg's method, extrapolated to order 2 * columns (Hairer, Norsett, Wanner, II.9)."""
    row: list = []
    for j in range(1, columns + 1):
        old, new = y, y + h / (2 * j) * _rates(y)
        for _ in range(2 * j - 1):
            old, new = new, old + h / j * _rates(new)
        last, row = row, [(old + new + h / (2 * j) * _rates(new)) / 2]
        for i in range(1, j):
            row.append(row[-1] + (row[-1] - last[i - 1]) / ((np.longdouble(j) / (j - i)) ** 2 - 1))
    return row[-1]


def precise_problem_b(duration=3, h=0.02):
    """(state (4,), impact times) of problem B, elastic, absolute angles, in np.longdouble: good to some 1e-17."""
    y, t, times = np.array([3, 5, 0, 0], dtype=np.longdouble) / 10, np.longdouble(0), []
    while t < duration:
        step = min(np.longdouble(h), duration - t)
        new = _extrapolate(y, step)
        if np.sin(new[:2]).sum() < 0:
            for _ in range(10):
                new = _extrapolate(y, step)
                step -= np.sin(new[:2]).sum() / (np.cos(new[:2]) @ new[2:])
            y, w, c = _extrapolate(y, step), np.cos(new[:2]), np.cos(new[0] - new[1])
            response = np.array([w[0] - c * w[1], 2 * w[1] - c * w[0]]) / (2 - c * c)
            y[2:] -= 2 * (w @ y[2:]) / (w @ response) * response
            t += step
            times.append(t)
            step = min(np.longdouble(h) / 8, duration - t)  # off the wall
            new = _extrapolate(y, step)
        y, t = new, t + step
    return y, np.array(times)
