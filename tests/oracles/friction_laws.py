"""Sliding under other laws of friction: a stick-slip oscillator, an ellipse of friction, conveyors, a suction cup.

Stick-slip: a block on a belt of speed v_b, held by a spring. It sticks while the spring's force is at most mu_s N and
slides with mu(v) N, v the relative speed; with Stribeck's curve mu(v) = mu_d + (mu_s - mu_d) exp(-(v / v_s)^2).

Ellipse: friction f maximizes the dissipation over (f1 / mu1)^2 + (f2 / mu2)^2 <= N^2, so f_i = -N mu_i^2 v_i / p with
p = |(mu1 v1, mu2 v2)|; with dt = p dtau the velocities decay exponentially, v_i exp(-g mu_i^2 tau), and time and path
are integrals. The point comes to rest in the direction of the smaller coefficient.

Conveyor: heat is the work of friction on the relative motion, the belt's work is the force on the box times the belt's
velocity; their difference is the box's kinetic energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad

from .event_ode import leg

GRAVITY = 9.81


# --- stick-slip -----------------------------------------------------------------------------------------------------
def stribeck(static: float, dynamic: float, speed: float) -> Callable[[float], float]:
    """mu(v) for a relative speed v >= 0."""
    return lambda v: dynamic + (static - dynamic) * math.exp(-((v / speed) ** 2))


@dataclass(frozen=True)
class Oscillator:
    """Block of mass m on a spring k, normal force N, belt speed v_b > 0, static mu_s, sliding mu(v)."""

    mass: float
    stiffness: float
    normal: float
    belt: float
    static: float
    sliding: Callable[[float], float]

    def run(
        self, t0: float, x: float, v: float, t_end: float, most: int = 100_000
    ) -> list[tuple[float, float, float, str, object]]:
        """Pieces (t, x, v, "stick" or "slip", the state after it as a function) from (x, v) to t_end; a last node."""
        t, pieces, hold = t0, [], self.static * self.normal
        side = math.copysign(1.0, self.belt - v)
        stick = v == self.belt and abs(self.stiffness * x) < hold
        if v == self.belt and not stick:
            side = math.copysign(1.0, x)
        for _ in range(most):
            if t >= t_end:
                break
            if stick:
                end = min(t + (hold / self.stiffness - x) / self.belt, t_end)
                pieces.append((t, x, v, "stick", lambda s, t=t, x=x: np.array([x + self.belt * (s - t), self.belt])))
                x, t, stick, side = (
                    (x + self.belt * (end - t) if end == t_end else hold / self.stiffness),
                    end,
                    False,
                    1.0,
                )
                continue

            def rhs(t: float, y: np.ndarray, side: float = side) -> np.ndarray:
                push = side * self.normal * self.sliding(max(side * (self.belt - y[1]), 0.0))
                return np.array([y[1], (push - self.stiffness * y[0]) / self.mass])

            done = leg(rhs, t, [x, v], t_end, [(lambda t, y, side=side: side * (self.belt - y[1]), -1)])
            pieces.append((t, x, v, "slip", done.dense))
            t, x, v = done.t, float(done.y[0]), float(done.y[1])
            if done.event is not None:
                v, stick = self.belt, abs(self.stiffness * x) <= hold
                side = -side
        return [*pieces, (t, x, v, "end", None)]

    def cycle(self) -> dict[str, float]:
        """The limit cycle from the start of slip: times of slip and stick, period, where it sticks again, extremes."""
        x = self.static * self.normal / self.stiffness
        long = 100.0 * 2.0 * math.pi * math.sqrt(self.mass / self.stiffness)

        def rhs(t: float, y: np.ndarray) -> np.ndarray:
            push = self.normal * self.sliding(max(self.belt - y[1], 0.0))
            return np.array([y[1], (push - self.stiffness * y[0]) / self.mass, push, push * (self.belt - y[1])])

        start = np.array([x, self.belt, 0.0, 0.0])
        caught = leg(rhs, 0.0, start, long, [(lambda t, y: self.belt - y[1], -1)])
        if caught.event is None or abs(self.stiffness * caught.y[0]) > self.static * self.normal:
            raise ArithmeticError("no limit cycle with stick")
        top = leg(rhs, 0.0, start, long, [(lambda t, y: y[1], -1)])
        low = leg(rhs, top.t, top.y, long, [(lambda t, y: y[1], 1)])
        stick = (x - float(caught.y[0])) / self.belt
        return {
            "slip": caught.t,
            "stick": stick,
            "period": caught.t + stick,
            "x_slip": x,
            "x_stick": float(caught.y[0]),
            "x_max": float(top.y[0]),
            "x_min": float(low.y[0]),
            "heat": float(caught.y[3]),  # of one cycle; sticking gives none
            "belt_work": self.belt
            * (float(caught.y[2]) + 0.5 * self.stiffness * (x**2 - caught.y[0] ** 2) / self.belt),
        }


def constant_cycle(
    mass: float, stiffness: float, normal: float, belt: float, static: float, dynamic: float
) -> tuple[float, float]:
    """(time of slip, time of stick) where sliding friction is constant: the slip is a piece of a harmonic motion."""
    rate, start = math.sqrt(stiffness / mass), (static - dynamic) * normal / stiffness
    return (math.pi + 2.0 * math.atan2(belt / rate, start)) / rate, 2.0 * start / belt


# --- an ellipse of friction -----------------------------------------------------------------------------------------
class Ellipse:
    """A point sliding on a horizontal plane with coefficients mu1 >= mu2 along x and y."""

    def __init__(self, v: np.ndarray, mu1: float, mu2: float, gravity: float = GRAVITY):
        if mu1 < mu2:
            raise ValueError("mu1 is the larger one")
        self.v, self.mu1, self.mu2, self.g = np.asarray(v, float), mu1, mu2, gravity
        self.n = (mu1 / mu2) ** 2

    def velocity(self, u: float) -> np.ndarray:
        """Velocity where that along y has fallen to u times its start, 1 >= u >= 0."""
        return self.v * [u**self.n, u]

    def _integral(self, f: Callable[[float], float], u: float) -> float:
        """Integral over time from the start to u: dt = p / (g mu2^2 u) du, and p / u is bounded."""

        def part(x: float) -> float:
            rate = math.hypot(self.mu1 * self.v[0] * x ** (self.n - 1.0), self.mu2 * self.v[1])
            return f(x) * rate / (self.g * self.mu2**2)

        edges = [u, *(u + (1.0 - u) * np.array([0.01, 0.1, 0.5, 0.9, 0.99])), 1.0]
        pairs = zip(edges[:-1], edges[1:], strict=True)
        return sum(quad(part, a, b, epsabs=1e-15, epsrel=1e-13, limit=200)[0] for a, b in pairs)

    def time(self, u: float = 0.0) -> float:
        """Time at u; u = 0 is the stop. Needs some velocity along y, else see `straight`."""
        return self._integral(lambda x: 1.0, u)

    def position(self, u: float = 0.0) -> np.ndarray:
        """Displacement at u."""
        return np.array([self._integral(lambda x, i=i: float(self.velocity(x)[i]), u) for i in range(2)])

    def straight(self, axis: int) -> tuple[float, float]:
        """(time, distance) of the stop along one axis alone."""
        mu, speed = (self.mu1, self.mu2)[axis], abs(float(self.v[axis]))
        return speed / (mu * self.g), speed**2 / (2.0 * mu * self.g)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """(displacement, velocity) at time t by DOP853 over tau."""

        def rhs(tau: float, y: np.ndarray) -> np.ndarray:
            v = self.v * np.exp(-self.g * np.array([self.mu1**2, self.mu2**2]) * tau)
            return math.hypot(self.mu1 * v[0], self.mu2 * v[1]) * np.array([1.0, v[0], v[1]])

        done = leg(rhs, 0.0, np.zeros(3), 40.0 / (self.g * self.mu2**2), [(lambda tau, y: y[0] - t, 1)])
        rest = done.event is None
        v = self.v * np.exp(-self.g * np.array([self.mu1**2, self.mu2**2]) * done.t) * (0.0 if rest else 1.0)
        return done.y[1:], v


def ellipse_holds(force: np.ndarray, mu1: float, mu2: float, normal: float) -> bool:
    """Whether a point at rest stays there under a tangential force."""
    return (force[0] / mu1) ** 2 + (force[1] / mu2) ** 2 <= normal**2


def ellipse_incline(
    v: np.ndarray, drive: np.ndarray, mu1: float, mu2: float, normal: float, t_end: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """(time, displacement, velocity) at t_end or the stop, unit mass under a constant tangential force `drive`.

    Over tau, dt = p dtau: a stop is reached as tau goes to infinity, and is one where the drive is held there.
    """

    def rhs(tau: float, y: np.ndarray) -> np.ndarray:
        p = math.hypot(mu1 * y[3], mu2 * y[4])
        return np.array([p, p * y[1 + 2], p * y[4], *(p * np.asarray(drive) - normal * y[3:] * [mu1**2, mu2**2])])

    y0, small = np.array([0.0, 0.0, 0.0, *v]), 1e-15 * float(np.linalg.norm(v))
    stops = [(lambda tau, y: y[0] - t_end, 1), (lambda tau, y: float(np.linalg.norm(y[3:])) - small, -1)]
    done = leg(rhs, 0.0, y0, 1e6 / (normal * min(mu1, mu2) ** 2), stops)
    return float(done.y[0]), done.y[1:3], done.y[3:] * (0.0 if done.event == 1 else 1.0)


# --- conveyors ------------------------------------------------------------------------------------------------------
def conveyor(
    v: np.ndarray, belt: np.ndarray, mu: float, mass: float = 1.0, gravity: float = GRAVITY
) -> tuple[float, np.ndarray, float, float]:
    """(time until it sticks, displacement then, heat, work of the belt): constant belt velocity, v and belt (2,)."""
    v, belt = np.asarray(v, float), np.asarray(belt, float)
    relative = belt - v
    size = float(np.linalg.norm(relative))
    t = size / (mu * gravity)
    return t, 0.5 * (v + belt) * t, 0.5 * mass * size**2, mass * float(relative @ belt)


def conveyor_moving(
    belt: Callable[[float], float],
    rate: Callable[[float], float],
    v: float,
    mu: float,
    t_end: float,
    mass: float = 1.0,
    gravity: float = GRAVITY,
) -> tuple[np.ndarray, list[tuple[float, str]]]:
    """((x, v, heat, work of the belt) at t_end, [(time, "slip" or "stick" from then on)]): a belt along a line.

    belt(t) is the belt's velocity and rate(t) its derivative. A stick ends where |rate| passes mu g.
    """
    t, y, log, grip = 0.0, np.array([0.0, v, 0.0, 0.0]), [], mu * gravity
    while True:
        relative = belt(t) - y[1]
        if relative == 0.0 and abs(rate(t)) < grip * (1.0 - 1e-12):
            log.append((t, "stick"))
            done = leg(
                lambda t, y: np.array([belt(t), rate(t), 0.0, mass * rate(t) * belt(t)]),
                t,
                y,
                t_end,
                [(lambda t, y: grip - abs(rate(t)), -1)],
                max_step=0.02 * t_end,
            )
            side = 0.0
        else:
            side = math.copysign(1.0, relative if relative != 0.0 else rate(t))
            log.append((t, "slip"))

            def rhs(t: float, y: np.ndarray, side: float = side) -> np.ndarray:
                force = side * mass * grip
                return np.array([y[1], force / mass, force * (belt(t) - y[1]), force * belt(t)])

            events = [(lambda t, y, side=side: side * (belt(t) - y[1]), -1)]
            done = leg(rhs, t, y, t_end, events, max_step=0.02 * t_end)
        if done.event is None:
            return done.y, log
        t, y = done.t, done.y.copy()
        y[1] = belt(t)


# --- a suction cup --------------------------------------------------------------------------------------------------
def suction_release(mass: float, pull: float, load: float, rate: float, gravity: float = GRAVITY) -> float:
    """Time at which a hanging box lets go: m g + load + rate t = pull, the largest pull of the contact [N]."""
    return max(0.0, (pull - mass * gravity - load) / rate)


def suction_fall(
    t: float, mass: float, pull: float, load: float, rate: float, gravity: float = GRAVITY
) -> tuple[float, float]:
    """(fall below the ceiling, speed) at time t, the load pulling on after the release."""
    start = suction_release(mass, pull, load, rate, gravity)
    d = max(0.0, t - start)
    a, b = gravity + (load + rate * start) / mass, rate / mass
    return 0.5 * a * d**2 + b * d**3 / 6.0, a * d + 0.5 * b * d**2


if __name__ == "__main__":
    print(Oscillator(1.0, 100.0, 10.0, 0.1, 0.6, stribeck(0.6, 0.3, 0.2)).cycle())
    slide = Ellipse([1.0, 1.0], 0.5, 0.2)
    print("ellipse", slide.time(), slide.position())
    print("conveyor", conveyor([0.0, 0.3], [1.0, 0.0], 0.4))
    print(conveyor_moving(lambda t: math.sin(4.0 * t), lambda t: 4.0 * math.cos(4.0 * t), 0.0, 0.3, 3.0))
    print("suction cup", suction_release(0.5, 20.0, 1.0, 4.0))
