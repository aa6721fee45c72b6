"""Closed forms: a bouncing ball, a pendulum at a wall, a rod that hits the ground, a fast ball at a plate."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ellipk

GRAVITY = 9.81


class BouncingBall:
    """Point falling from rest through `gap` [m] onto a plane, restitution e."""

    def __init__(self, gap: float = 1.0, restitution: float = 1.0, gravity: float = GRAVITY):
        self.gap, self.e, self.g = gap, restitution, gravity
        self.first = math.sqrt(2.0 * gap / gravity)

    def impact_times(self, n: int) -> np.ndarray:
        """Times of the first n impacts [s]: t_n = t1 (1 + 2 (e + .. + e^(n-1)))."""
        return self.first * (1.0 + 2.0 * np.concatenate([[0.0], np.cumsum(self.e ** np.arange(1, n))]))

    def approach_speeds(self, n: int) -> np.ndarray:
        """gamma_minus of the first n impacts [m/s], negative."""
        return -self.g * self.first * self.e ** np.arange(n)

    def apex(self, n: int) -> float:
        """Height of the gap at the top after impact n [m]."""
        return self.gap * self.e ** (2 * n)

    def zeno_time(self) -> float:
        """Time where the impacts accumulate [s], e < 1."""
        return self.first * (1.0 + self.e) / (1.0 - self.e)

    def height(self, t: float) -> float:
        """Gap at time t [m]."""
        if t <= self.first:
            return self.gap - 0.5 * self.g * t * t
        if self.e < 1.0 and t >= self.zeno_time():
            return 0.0
        start, speed = self.first, self.e * self.g * self.first
        while t > start + 2.0 * speed / self.g:
            start, speed = start + 2.0 * speed / self.g, self.e * speed
        return speed * (t - start) - 0.5 * self.g * (t - start) ** 2


def pendulum_wall_period(theta0: float, length: float = 1.0, gravity: float = GRAVITY) -> float:
    """Time between elastic impacts at theta = 0 of a pendulum released at theta0 [s]: 2 sqrt(l/g) K(k)."""
    return 2.0 * math.sqrt(length / gravity) * float(ellipk(math.sin(0.5 * theta0) ** 2))


def rod_impact(theta: float, restitution: float = 1.0) -> tuple[float, float, float]:
    """(P, v_com, omega) after a uniform rod m = l = 1 moving at v = -1 hits the ground with one end.

    theta: angle from the horizontal [rad]. The end is half a cos(theta) from the centre, inertia 1/12.
    """
    arm, inertia = 0.5 * math.cos(theta), 1.0 / 12.0
    impulse = (1.0 + restitution) / (1.0 + arm * arm / inertia)
    return impulse, -1.0 + impulse, arm * impulse / inertia


def ball_at_plate(gap: float, speed: float, t: float, restitution: float = 1.0) -> tuple[float, float, float]:
    """(hit time, gap, velocity) at time t of a ball meeting a fixed plate head on, no gravity; velocity > 0 leaves."""
    hit = gap / speed
    if t <= hit:
        return hit, gap - speed * t, -speed
    return hit, restitution * speed * (t - hit), restitution * speed
