"""A ball that spins, slides and rolls on a plane, with drilling friction and with a bound on the rolling torque.

The ball has mass 1, radius r and inertia k r^2; all forces below are for each unit of mass, with N = g.

Drilling friction of radius r_s: the pair (F, tau / r_s) of friction force and torque about the normal lies in the disc
of radius mu N, opposite to (slip, r_s omega_n) while that is not zero (the ellipsoid of Leine, Glocker 2003). A ball
that only spins is slowed by mu N r_s. A ball that slides and spins obeys s' = -c1 s / p and w' = -c2 w / p, with
w = r_s omega_n, p = |(s, w)|, c1 = mu g (1 + 1 / k), c2 = mu g r_s^2 / (k r^2): with dt = p dtau both decay
exponentially, and time is an integral. The two come to zero at the same instant, in the direction of the slower one.

Rolling friction: a torque of at most rho N (rho in metres) against the rolling. On a line every force is constant
between events, so the motion is exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad

from .event_ode import leg

GRAVITY = 9.81


def spin_down(
    spin: float, mu: float, drill: float, radius: float, k: float = 0.4, gravity: float = GRAVITY
) -> tuple[float, float, float]:
    """(deceleration [rad/s^2], time to stop, angle turned) of a ball that only spins about the vertical."""
    rate = mu * gravity * drill / (k * radius**2)
    return rate, abs(spin) / rate, spin * abs(spin) / (2.0 * rate)


class SlidingSpin:
    """A ball on a plane with velocity v (2,) and angular velocity omega (3,), under drilling friction."""

    def __init__(
        self,
        v: np.ndarray,
        omega: np.ndarray,
        mu: float,
        drill: float,
        radius: float,
        k: float = 0.4,
        gravity: float = GRAVITY,
    ):
        self.v, self.omega = np.asarray(v, float), np.asarray(omega, float)
        self.mu, self.drill, self.radius, self.k, self.g = mu, drill, radius, k, gravity
        self.slip = self.v + radius * np.array([-self.omega[1], self.omega[0]])
        self.w = drill * self.omega[2]
        self.c1 = mu * gravity * (1.0 + 1.0 / k)
        self.c2 = mu * gravity * drill**2 / (k * radius**2)

    def speeds(self, tau: float) -> tuple[np.ndarray, float, float]:
        """(slip, w, p) at tau."""
        s, w = self.slip * math.exp(-self.c1 * tau), self.w * math.exp(-self.c2 * tau)
        return s, w, math.hypot(float(np.linalg.norm(s)), w)

    def stop_time(self) -> float:
        """Time at which both slip and spin end, by quadrature; closed where only one of them is there."""
        size = float(np.linalg.norm(self.slip))
        if size == 0.0 or self.w == 0.0:
            return abs(self.w) / self.c2 if size == 0.0 else size / self.c1
        # Over u = exp(-slow tau): p / (slow u) is bounded, and steep only near u = 1.
        slow, fast = min(self.c1, self.c2), max(self.c1, self.c2)
        a, b = (size, abs(self.w)) if self.c1 > self.c2 else (abs(self.w), size)  # fast and slow
        n = fast / slow

        def part(u: float) -> float:
            return math.hypot(a * u ** (n - 1.0), b) / slow

        edges = [0.0, *(1.0 - np.geomspace(0.5, 1e-12, 30)), 1.0]
        return sum(quad(part, x, y, epsabs=0.0, epsrel=1e-13)[0] for x, y in zip(edges[:-1], edges[1:], strict=True))

    def state(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(displacement (2,), v (2,), omega (3,)) at time t; a rolling ball goes on for ever after the stop."""

        def rhs(tau: float, y: np.ndarray) -> np.ndarray:
            s, _, p = self.speeds(tau)
            v = self.v + (s - self.slip) / (1.0 + 1.0 / self.k)
            return p * np.array([1.0, v[0], v[1]])

        slow = [c for c, x in ((self.c1, np.linalg.norm(self.slip)), (self.c2, self.w)) if x != 0.0]
        if not slow:
            return self.v * t, self.v.copy(), self.omega.copy()
        done = leg(rhs, 0.0, np.zeros(3), 40.0 / min(slow), [(lambda tau, y: y[0] - t, 1)])
        s, w, _ = self.speeds(done.t)
        if done.event is None:
            s, w = np.zeros(2), 0.0
        v = self.v + (s - self.slip) / (1.0 + 1.0 / self.k)
        x = done.y[1:] + v * (t - done.y[0])
        spin = np.array([(s[1] - v[1]) / self.radius, (v[0] - s[0]) / self.radius, w / self.drill])
        return x, v, spin

    def direct_stop(self) -> float:
        """The same time of the stop by a plain integration of (s, w) over time, up to p = 1e-9 and on in a line."""

        def rhs(t: float, y: np.ndarray) -> np.ndarray:
            return -np.array([self.c1, self.c1, self.c2]) * y / np.linalg.norm(y)

        y0 = np.array([*self.slip, self.w])
        done = leg(rhs, 0.0, y0, 1e6, [(lambda t, y: float(np.linalg.norm(y)) - 1e-9, -1)], rtol=1e-12)
        return done.t + 1e-9 / (self.c2 if abs(done.y[2]) > 1e-10 else self.c1)


# --- rolling on a line ----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Piece:
    """Constant rates from time t on: x, v of the centre, angle and angular rate w; v = r w is rolling."""

    t: float
    x: float
    v: float
    angle: float
    w: float
    dv: float
    dw: float

    def at(self, t: float) -> tuple[float, float, float, float]:
        """(x, v, angle, w) at a time of this piece."""
        d = t - self.t
        x, angle = self.x + self.v * d + 0.5 * self.dv * d * d, self.angle + self.w * d + 0.5 * self.dw * d * d
        return x, self.v + self.dv * d, angle, self.w + self.dw * d


def _rates(
    v: float, w: float, mu: float, rho: float, radius: float, k: float, along: float, normal: float
) -> tuple[float, float]:
    """(v', w') by the first consistent combination of friction and rolling torque, those that hold first."""
    s, sign = v - radius * w, lambda x: math.copysign(1.0, x)
    for f in [None, 1.0, -1.0] if s == 0.0 else [-sign(s)]:
        for torque in [None, 1.0, -1.0] if w == 0.0 else [sign(w)]:
            if f is None and torque is None:
                force, turn = -along, radius * along
            elif f is None:
                turn = torque * rho * normal
                force = -(k * along + turn / radius) / (1.0 + k)
            elif torque is None:
                force = f * mu * normal
                turn = -radius * force
            else:
                force, turn = f * mu * normal, torque * rho * normal
            dv, dw = along + force, (-radius * force - turn) / (k * radius**2)
            ds = dv - radius * dw
            good = abs(force) <= mu * normal * (1.0 + 1e-14) and abs(turn) <= rho * normal * (1.0 + 1e-14)
            if s == 0.0 and f is not None:
                good = good and ds * f < 0.0
            if w == 0.0 and torque is not None:
                good = good and dw * torque > 0.0
            if good:
                return (dv if w or s or torque else 0.0 if f is None else dv), (0.0 if torque is None else dw)
    raise ArithmeticError("no consistent rates")


def roll_line(
    v: float,
    w: float,
    mu: float,
    rho: float,
    radius: float,
    k: float = 0.4,
    slope: float = 0.0,
    gravity: float = GRAVITY,
) -> list[Piece]:
    """Pieces of the motion down a slope (x downwards); the last one goes on for ever."""
    along, normal = gravity * math.sin(slope), gravity * math.cos(slope)
    t = x = angle = 0.0
    pieces: list[Piece] = []
    while True:
        dv, dw = _rates(v, w, mu, rho, radius, k, along, normal)
        piece = Piece(t, x, v, angle, w, dv, dw)
        pieces.append(piece)
        s, ds = v - radius * w, dv - radius * dw
        rolling = s == 0.0 and abs(ds) <= 1e-12 * gravity
        slip_ends = -s / ds if s * ds < 0.0 else math.inf
        turn_ends = -w / dw if w * dw < 0.0 else math.inf
        if rolling:
            slip_ends = math.inf
        step = min(slip_ends, turn_ends)
        if math.isinf(step):
            return pieces
        t = t + step
        x, v, angle, w = piece.at(t)
        if turn_ends <= step * (1.0 + 1e-14):
            w = 0.0
        if rolling or slip_ends <= step * (1.0 + 1e-14):
            v = radius * w


def rolling_stop(
    v: float, rho: float, radius: float, k: float = 0.4, gravity: float = GRAVITY
) -> tuple[float, float, float]:
    """(deceleration, time, distance) of a ball or wheel that rolls to its stop: (1 + k) a = rho g / r."""
    a = rho * gravity / (radius * (1.0 + k))
    return a, abs(v) / a, v * abs(v) / (2.0 * a)


if __name__ == "__main__":
    print("spins down", spin_down(30.0, 0.3, 0.002, 0.05))
    ball = SlidingSpin([1.0, 0.3], [0.0, 4.0, 30.0], 0.3, 0.01, 0.05)
    print("slides and spins until", ball.stop_time(), ball.direct_stop(), ball.state(0.2))
    print("rolls", rolling_stop(1.0, 0.001, 0.05), roll_line(1.0, 20.0, 0.3, 0.001, 0.05)[-1])
