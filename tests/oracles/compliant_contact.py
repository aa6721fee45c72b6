"""A sphere at a compliant plane: F = k d^n (1 + c d'), never below zero, d the penetration; n = 1 or Hertz's 3/2.

Hunt, Crossley, "Coefficient of restitution interpreted as damping in vibroimpact", J. Appl. Mech. 42 (1975). Masses: m
is the reduced mass of the pair. Without damping, energy gives the largest penetration and an integral the time of
contact. Without gravity the damped contact too: v dv / (1 + c v) = -(k / m) d^n dd, so that v / c - ln(1 + c v) / c^2
is a function of d, and equal at both ends: the restitution is that equation's other root, independent of k and n.
With gravity the motion is integrated, in units of the contact: lengths of the largest penetration, times of that over
the speed. What is computed there does not care whether k is 1e3 or 1e8.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import gamma as gamma_function

from .event_ode import leg

GRAVITY = 9.81


def penetration(mass: float, k: float, n: float, speed: float, gravity: float = 0.0) -> float:
    """Largest penetration without damping: m v^2 / 2 + m g d = k d^(n+1) / (n+1)."""
    free = ((n + 1.0) * mass * speed**2 / (2.0 * k)) ** (1.0 / (n + 1.0))
    if gravity == 0.0:
        return free
    still = ((n + 1.0) * mass * gravity / k) ** (1.0 / n)

    def miss(d: float) -> float:
        return k * d ** (n + 1.0) / (n + 1.0) - mass * gravity * d - 0.5 * mass * speed**2

    return brentq(miss, max(free, still), free + still, xtol=1e-300, rtol=1e-15) if speed > 0.0 else still


def contact_time(mass: float, k: float, n: float, speed: float, gravity: float = 0.0) -> float:
    """Time from touch to release without damping.

    Without gravity 2 d / v sqrt(pi) Gamma(1 + a) / Gamma(1/2 + a), a = 1 / (n+1): pi sqrt(m / k) for n = 1. With
    gravity by quadrature, with d = d_max (1 - s^2): the speed falls as s at the turn.
    """
    top = penetration(mass, k, n, speed, gravity)
    if gravity == 0.0:
        a = 1.0 / (n + 1.0)
        return 2.0 * top / speed * math.sqrt(math.pi) * gamma_function(1.0 + a) / gamma_function(0.5 + a)

    def part(s: float) -> float:
        """dd / v: v^2 = 2 k / (m (n+1)) (d_max^(n+1) - d^(n+1)) - 2 g (d_max - d), written without cancellation."""
        lost = -math.expm1((n + 1.0) * math.log1p(-s * s)) if s < 1.0 else 1.0
        square = 2.0 * k * top ** (n + 1.0) / (mass * (n + 1.0)) * lost - 2.0 * gravity * top * s * s
        return 2.0 * top * s / math.sqrt(square)

    return 2.0 * quad(part, 0.0, 1.0, epsabs=0.0, epsrel=1e-13, limit=200)[0]


def _potential(x: float) -> float:
    """x - ln(1 + x), also where x is small."""
    if abs(x) > 0.05:
        return x - math.log1p(x)
    return sum((-1.0) ** j * x**j / j for j in range(2, 16))


def restitution(speed: float, c: float) -> float:
    """Speed after the contact over the speed before, without gravity."""
    x = c * speed
    if x == 0.0:
        return 1.0
    if x < 0.9:
        return brentq(lambda e: _potential(-e * x) - _potential(x), 0.0, 1.0, xtol=1e-16)
    # with 1 - e x = exp(-z), which may be as small as it likes
    z = brentq(lambda z: z + math.expm1(-z) - _potential(x), 0.0, _potential(x) + 1.0, xtol=1e-16)
    return -math.expm1(-z) / x


def damped_penetration(mass: float, k: float, n: float, speed: float, c: float) -> float:
    """Largest penetration without gravity: k d^(n+1) / (m (n+1)) = (c v - ln(1 + c v)) / c^2."""
    if c == 0.0:
        return penetration(mass, k, n, speed)
    return ((n + 1.0) * mass / k * _potential(c * speed) / c**2) ** (1.0 / (n + 1.0))


@dataclass(frozen=True)
class Contact:
    """One contact: its time, speed at the release (over the start: the restitution), largest penetration, its time."""

    time: float
    speed: float
    deepest: float
    deepest_time: float
    released: bool  # False: it stays, and the numbers are those at the end of the run


def _in_its_units(
    mass: float, k: float, n: float, speed: float, c: float, gravity: float
) -> tuple[float, float, Callable[[float, np.ndarray], np.ndarray]]:
    """Length and time of a contact at this speed, and the rate of (penetration, its rate) in these units."""
    length = penetration(mass, k, n, speed, gravity)
    unit = length / speed
    g, stiff, damp = gravity * unit / speed, k * length**n * unit / (mass * speed), c * speed

    def rhs(t: float, y: np.ndarray) -> np.ndarray:
        d = max(y[0], 0.0)
        return np.array([y[1], g - max(stiff * d**n * (1.0 + damp * y[1]), 0.0)])

    return length, unit, rhs


def contact(
    mass: float,
    k: float,
    n: float,
    speed: float,
    c: float = 0.0,
    gravity: float = GRAVITY,
    longest: float = 50.0,
) -> Contact:
    """One contact from the touch to the release, by DOP853 in the units of the contact; `longest` contact times."""
    length, unit, rhs = _in_its_units(mass, k, n, speed, c, gravity)
    deep = leg(rhs, 0.0, [0.0, 1.0], longest, [(lambda t, y: y[1], -1)])
    free = leg(rhs, deep.t, deep.y, longest, [(lambda t, y: y[0], -1)])
    out = free.event == 0
    return Contact(free.t * unit, -float(free.y[1]) * speed, float(deep.y[0]) * length, deep.t * unit, out)


def rest_depth(mass: float, k: float, n: float, gravity: float = GRAVITY) -> float:
    """Penetration of a sphere at rest."""
    return (mass * gravity / k) ** (1.0 / n)


def drops(
    height: float, mass: float, k: float, n: float, c: float = 0.0, bounces: int = 5, gravity: float = GRAVITY
) -> list[tuple[float, float, float, float]]:
    """(touch, release, largest penetration, speed at the release) of the bounces of a sphere dropped from `height`."""
    t, speed, found = math.sqrt(2.0 * height / gravity), math.sqrt(2.0 * gravity * height), []
    for _ in range(bounces):
        one = contact(mass, k, n, speed, c, gravity)
        if not one.released:
            break
        found.append((t, t + one.time, one.deepest, one.speed))
        t, speed = t + one.time + 2.0 * one.speed / gravity, one.speed
    return found


def position(
    t: float, height: float, mass: float, k: float, n: float, c: float = 0.0, gravity: float = GRAVITY
) -> tuple[float, float]:
    """(gap, velocity upwards) at time t of a sphere dropped from `height`: gap < 0 is penetration."""
    touch, speed = math.sqrt(2.0 * height / gravity), math.sqrt(2.0 * gravity * height)
    if t <= touch:
        return height - 0.5 * gravity * t * t, -gravity * t
    while True:
        one = contact(mass, k, n, speed, c, gravity)
        if t <= touch + one.time or not one.released:
            break
        d, touch, speed = t - touch - one.time, touch + one.time + 2.0 * one.speed / gravity, one.speed
        if t <= touch:
            return speed * d - 0.5 * gravity * d * d, speed - gravity * d
    length, unit, rhs = _in_its_units(mass, k, n, speed, c, gravity)
    y = leg(rhs, 0.0, [0.0, 1.0], (t - touch) / unit).y
    return -float(y[0]) * length, -float(y[1]) * speed


if __name__ == "__main__":
    for n, k in ((1.0, 1e4), (1.0, 1e8), (1.5, 1e6), (1.5, 1e8)):
        print(
            f"n = {n}, k = {k:.0e}: undamped",
            penetration(0.1, k, n, 1.0, GRAVITY),
            contact_time(0.1, k, n, 1.0, GRAVITY),
        )
        print("   c = 0.3", contact(0.1, k, n, 1.0, 0.3), "restitution without gravity", restitution(1.0, 0.3))
