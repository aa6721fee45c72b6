"""Pendulums, strings and springs with known answers. Angles from the downward vertical [rad], g [m/s^2]."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.special import ellipj, ellipk

from .constraints import PrescribedMotion

GRAVITY = 9.81


@dataclass(frozen=True)
class Pendulum:
    """Point mass on a massless rod, released at rest at theta0, by Jacobi's functions.

    Energy: (theta'/2)^2 = w0^2 (k^2 - sin^2(theta/2)), k = sin(theta0/2), w0^2 = g/l, hence sin(theta/2) = k sn(u) with
    u = w0 t + K(k): a quarter period on at the start.
    """

    theta0: float
    length: float = 1.0
    mass: float = 1.0
    gravity: float = GRAVITY

    def period(self) -> float:
        """4 sqrt(l/g) K(k) [s]."""
        return 4.0 * math.sqrt(self.length / self.gravity) * float(ellipk(math.sin(0.5 * self.theta0) ** 2))

    def angle(self, t: float) -> tuple[float, float]:
        """(theta, theta'): theta' cos(theta/2) / 2 = k w0 cn dn, and cos(theta/2) = dn."""
        k, w0 = math.sin(0.5 * self.theta0), math.sqrt(self.gravity / self.length)
        sn, cn, _, _ = ellipj(w0 * t + float(ellipk(k * k)), k * k)
        return 2.0 * math.asin(k * float(sn)), 2.0 * k * w0 * float(cn)

    def tension(self, t: float) -> float:
        """m g cos theta + m l theta'^2 = m g (3 cos theta - 2 cos theta0) [N]."""
        return self.mass * self.gravity * (3.0 * math.cos(self.angle(t)[0]) - 2.0 * math.cos(self.theta0))

    def energy(self) -> float:
        """Potential zero at the pivot's height [J]."""
        return -self.mass * self.gravity * self.length * math.cos(self.theta0)


def _integrate(rhs: object, times: Sequence[float], y0: Sequence[float]) -> np.ndarray:
    """States at the times, (n, len(y0)): DOP853 from each to the next, no interpolation."""
    states = [np.asarray(y0, float)]
    for a, b in zip(times[:-1], times[1:], strict=True):
        states.append(solve_ivp(rhs, (a, b), states[-1], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1])
    return np.array(states)


@dataclass(frozen=True)
class DampedPendulum:
    """I theta'' = -d theta' - m g l sin theta, I = inertia about the pivot, l = distance of the centre."""

    mass: float
    length: float
    inertia: float
    damping: float
    gravity: float = GRAVITY

    def motion(self, times: Sequence[float], theta0: float, omega0: float = 0.0) -> np.ndarray:
        """theta, theta', energy dissipated since times[0] (n, 3)."""
        stiffness = self.mass * self.gravity * self.length

        def rhs(_t: float, y: np.ndarray) -> list[float]:
            force = -self.damping * y[1] - stiffness * math.sin(y[0])
            return [y[1], force / self.inertia, self.damping * y[1] ** 2]

        return _integrate(rhs, times, [theta0, omega0, 0.0])

    def energy(self, theta: float, omega: float) -> float:
        return 0.5 * self.inertia * omega**2 - self.mass * self.gravity * self.length * math.cos(theta)

    def small(self, t: float, theta0: float) -> float:
        """theta for small angles, underdamped, released at rest: e^(-s t) theta0 (cos w t + s/w sin w t)."""
        s = 0.5 * self.damping / self.inertia
        w = math.sqrt(self.mass * self.gravity * self.length / self.inertia - s * s)
        return theta0 * math.exp(-s * t) * (math.cos(w * t) + s / w * math.sin(w * t))


@dataclass(frozen=True)
class CartPendulum:
    """Point mass m on a rod of length l, hung from a cart M that is moved along x by x(t) (A sin(w t), say).

    The mass is at (x + l sin theta, -l cos theta); across the rod: l theta'' + x'' cos theta = -g sin theta. Horizontal
    force on the cart: F = (M + m) x'' + m l (theta'' cos theta - theta'^2 sin theta).
    """

    path: PrescribedMotion
    length: float = 1.0
    mass: float = 1.0
    cart: float = 1.0
    gravity: float = GRAVITY

    def angular_acceleration(self, t: float, theta: float) -> float:
        return -(self.gravity * math.sin(theta) + self.path(t)[2] * math.cos(theta)) / self.length

    def force(self, t: float, theta: float, omega: float) -> float:
        """Force on the cart that prescribes its motion [N]."""
        turn = self.angular_acceleration(t, theta) * math.cos(theta) - omega**2 * math.sin(theta)
        return (self.cart + self.mass) * self.path(t)[2] + self.mass * self.length * turn

    def lift(self, t: float, theta: float, omega: float) -> float:
        """The rail's vertical force [N]: (M + m) g + m l (theta'' sin theta + theta'^2 cos theta)."""
        turn = self.angular_acceleration(t, theta) * math.sin(theta) + omega**2 * math.cos(theta)
        return (self.cart + self.mass) * self.gravity + self.mass * self.length * turn

    def motion(self, times: Sequence[float], theta0: float, omega0: float = 0.0) -> np.ndarray:
        """theta, theta', work of the prescribed motion since times[0] (n, 3)."""

        def rhs(t: float, y: np.ndarray) -> list[float]:
            return [y[1], self.angular_acceleration(t, y[0]), self.force(t, y[0], y[1]) * self.path(t)[1]]

        return _integrate(rhs, times, [theta0, omega0, 0.0])

    def energy(self, t: float, theta: float, omega: float) -> float:
        speed, turn = self.path(t)[1], self.length * omega
        kinetic = 0.5 * (self.cart + self.mass) * speed**2 + 0.5 * self.mass * turn**2
        kinetic += self.mass * speed * turn * math.cos(theta)
        return kinetic - self.mass * self.gravity * self.length * math.cos(theta)


@dataclass(frozen=True)
class DrivenString:
    """Point mass on a string of prescribed length l(t) about a fixed point, no gravity, in a plane.

    The string's force is central, so l^2 w is conserved; radially T = m (l w^2 - l''). The work
    of -T l' over time is the change of m (l'^2 + l^2 w^2) / 2.
    """

    length: PrescribedMotion
    omega0: float
    mass: float = 1.0

    def omega(self, t: float) -> float:
        return self.length(0.0)[0] ** 2 * self.omega0 / self.length(t)[0] ** 2

    def angle(self, t: float) -> float:
        """Integral of omega; for l = l0 - s t it is l0 omega0 t / (l0 - s t)."""
        return float(quad(self.omega, 0.0, t, epsabs=1e-13, epsrel=1e-13)[0])

    def tension(self, t: float) -> float:
        l, _, second = self.length(t)  # noqa: E741
        return self.mass * (l * self.omega(t) ** 2 - second)

    def work(self, t: float) -> float:
        def kinetic(s: float) -> float:
            l, speed, _ = self.length(s)  # noqa: E741
            return 0.5 * self.mass * (speed**2 + (l * self.omega(s)) ** 2)

        return kinetic(t) - kinetic(0.0)


def atwood(
    m1: float, m2: float, inertia: float = 0.0, radius: float = 1.0, gravity: float = GRAVITY
) -> tuple[float, float, float]:
    """(a, T1, T2): acceleration of m1 downwards, tensions [N] on both sides of a pulley (massless: equal).

    m1 g - T1 = m1 a, T2 - m2 g = m2 a, (T1 - T2) radius = inertia a / radius. A tape over a smooth nail has no inertia.
    """
    a = (m1 - m2) * gravity / (m1 + m2 + inertia / radius**2)
    return a, m1 * (gravity - a), m2 * (gravity + a)


@dataclass(frozen=True)
class SpringChain:
    """n equal masses in a row, joined by equal springs; `ends`: "fixed" both, "mixed" the first fixed, or "free".

    -m w^2 u_j = k (u_(j+1) - 2 u_j + u_(j-1)) with u = sin or cos of (phase j + shift): w = 2 sqrt(k/m) sin(phase/2).
    The ends choose the phase: r pi/(n+1); (2r-1) pi/(2n+1); (r-1) pi/n, r = 1..n.
    """

    n: int
    stiffness: float = 1.0
    mass: float = 1.0
    ends: str = "fixed"

    def _phases(self) -> np.ndarray:
        r = np.arange(1, self.n + 1)
        by_end = {
            "fixed": r * math.pi / (self.n + 1),
            "mixed": (2 * r - 1) * math.pi / (2 * self.n + 1),
            "free": (r - 1) * math.pi / self.n,
        }
        return by_end[self.ends]

    def frequencies(self) -> np.ndarray:
        """[rad/s], ascending."""
        return 2.0 * math.sqrt(self.stiffness / self.mass) * np.sin(0.5 * self._phases())

    def modes(self) -> np.ndarray:
        """Orthonormal columns, (n, n)."""
        j = np.arange(1, self.n + 1)[:, None]
        shapes = np.cos(self._phases() * (j - 0.5)) if self.ends == "free" else np.sin(self._phases() * j)
        return shapes / np.linalg.norm(shapes, axis=0)

    def motion(self, t: float, u0: np.ndarray, v0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(displacements, velocities) at time t, mode by mode."""
        w, shapes = self.frequencies(), self.modes()
        a, b = shapes.T @ u0, shapes.T @ v0
        # the free chain's drift, whose sine is rounding of 0 too
        sine = np.where(w * t < 1e-12, t, np.sin(w * t) / np.maximum(w, 1e-300))
        u = a * np.cos(w * t) + b * sine
        v = -a * w * np.sin(w * t) + b * np.cos(w * t)
        return shapes @ u, shapes @ v
