"""The tippe top of Leine and Glocker: smooth sliding with located events, and Moreau's steps for comparison.

Leine, Glocker, "A set-valued force law for spatial Coulomb-Contensou friction", Eur. J. Mech. A/Solids 22 (2003).

Geometry. The unit vector e is the axis of the top, from the body to the stem; theta is its angle to the vertical and
S the centre of mass. The body's sphere (radius r1) has its centre at S + a1 e and the stem's sphere (radius r2) at
S + a2 e, both on the side of the stem: upright, S lies a1 below the centre of the large sphere. The plane is z = 0, and
the gaps to it are g_i = z + a_i cos(theta) - r_i with z the height of S. Moments of inertia about S: I1 across, I3
along e. The contact point of sphere i is at a_i e - r_i e_z from S, and slips with s_i = v + omega x (a_i e - r_i e_z).

Friction. In each contact (F_x, F_y, tau / r_s) lies in the ball of radius mu N, opposite to (s_x, s_y, r_s omega_z)
with r_s = 3 pi / 16 * 5e-4 m: the ellipsoid, of which the published numbers come. There is no rolling torque. At the
start S rests at z = 0.012015 (the sphere touches to 1e-7 m: here it touches exactly) with theta = 0.1 and a spin of 180
rad/s about e; the velocity of S is zero, so that the contact slips.

The top is symmetric about e, so (position of S, v, e, angular momentum about S) is all its state, and nowhere singular.
While contacts slip or spin, p_i = |(s_i, r_s omega_z)| > 0, the friction of each is N_i times a smooth function, and
the normal forces of those that touch are solutions of linear equations. An impact (e = 0) is one complementarity
problem of the contacts that touch.

At 1.3710432514 s the stem touches and takes over at once; at 4.5505 s the slower top has sunk back on the body, and
rocks from one sphere to the other in an endless sequence of impacts that ends at about 4.676 s: `run` stops before it.
The published inclinations are those of Moreau's steps of 1e-4 s in Euler angles, which are nearly singular where theta
has its least value, 0.025: at 0.25 s such steps are wrong by 0.03, and those of `moreau` by 0.003.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import fsolve

from .event_ode import leg

GRAVITY = 9.81


@dataclass(frozen=True)
class Top:
    """Mass, moments of inertia, eccentricities, radii, friction, drilling radius (3 pi / 16 of the contact's)."""

    mass: float = 6e-3
    i1: float = 8e-7
    i3: float = 7e-7
    a: tuple[float, float] = (0.003, 0.016)
    r: tuple[float, float] = (0.015, 0.005)
    mu: float = 0.3
    drill: float = 3.0 * math.pi / 16.0 * 5e-4

    def start(self, theta: float = 0.1, spin: float = 180.0) -> np.ndarray:
        """State (position, v, e, L) of a top that touches, inclined by a turn about x, and spins about its axis."""
        e = np.array([0.0, -math.sin(theta), math.cos(theta)])
        return np.array([0.0, 0.0, self.r[0] - self.a[0] * e[2], 0.0, 0.0, 0.0, *e, *(self.i3 * spin * e)])

    def omega(self, y: np.ndarray) -> np.ndarray:
        """Angular velocity in the frame of the plane."""
        e, momentum = y[6:9], y[9:]
        return momentum / self.i1 + (1.0 / self.i3 - 1.0 / self.i1) * (momentum @ e) * e

    def gap(self, y: np.ndarray, i: int) -> float:
        return float(y[2] + self.a[i] * y[8] - self.r[i])

    def rows(self, y: np.ndarray, i: int) -> np.ndarray:
        """(4, 6) on (v, omega): normal speed, slip along x and y, r_s omega_z."""
        r = self.a[i] * y[6:9] - np.array([0.0, 0.0, self.r[i]])
        turn = np.array([[0.0, r[2], -r[1]], [-r[2], 0.0, r[0]], [r[1], -r[0], 0.0]])  # omega x r = turn omega
        w = np.zeros((4, 6))
        w[0, 2], w[1, 0], w[2, 1] = 1.0, 1.0, 1.0
        w[0, 3:], w[1, 3:], w[2, 3:] = turn[2], turn[0], turn[1]
        w[3, 5] = self.drill
        return w

    def inverse(self, y: np.ndarray) -> np.ndarray:
        """Inverse of the mass matrix on (v, omega)."""
        e, out = y[6:9], np.zeros((6, 6))
        out[:3, :3] = np.eye(3) / self.mass
        out[3:, 3:] = np.eye(3) / self.i1 + (1.0 / self.i3 - 1.0 / self.i1) * np.outer(e, e)
        return out

    def velocity(self, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:6], self.omega(y)])

    def energy(self, y: np.ndarray) -> float:
        v, omega = y[3:6], self.omega(y)
        return 0.5 * float(self.mass * v @ v + omega @ y[9:]) + self.mass * GRAVITY * float(y[2])

    def forces(self, y: np.ndarray, touching: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
        """(force on (v, omega) of the contacts, their normal forces); the touching ones stay in touch and slip."""
        u, inverse, omega, e = self.velocity(y), self.inverse(y), self.omega(y), y[6:9]
        if not touching:
            return np.zeros(6), np.zeros(0)
        # without contact: gravity; e' = omega x e, L' = 0
        de = np.cross(omega, e)
        domega = (1.0 / self.i3 - 1.0 / self.i1) * ((y[9:] @ de) * e + (y[9:] @ e) * de)
        free = np.array([0.0, 0.0, -GRAVITY, *domega])
        columns, normals, rest = [], [], []
        for i in touching:
            w = self.rows(y, i)
            s = w[1:] @ u
            columns.append(w[0] - self.mu * w[1:].T @ (s / np.linalg.norm(s)))
            normals.append(w[0])
            # g'' = a_z + a_i e_z'' has beside w[0] u' the part a_i (omega x (omega x e))_z
            rest.append(w[0] @ free + self.a[i] * np.cross(omega, de)[2])
        a, b = np.array(normals), np.array(columns)
        n = np.linalg.solve(a @ inverse @ b.T, -np.array(rest))
        return b.T @ n, n

    def rhs(self, y: np.ndarray, touching: tuple[int, ...]) -> np.ndarray:
        force, _ = self.forces(y, touching)
        weight = np.array([0.0, 0.0, -GRAVITY])
        return np.concatenate([y[3:6], force[:3] / self.mass + weight, np.cross(self.omega(y), y[6:9]), force[3:]])

    def project(self, y: np.ndarray, touching: tuple[int, ...]) -> np.ndarray:
        """Rounding removed: |e| = 1, gaps zero. One contact: by the height; two: the axis has one inclination."""
        y = y.copy()
        e = y[6:9] / np.linalg.norm(y[6:9])
        if len(touching) == 2:
            c = (self.r[0] - self.r[1]) / (self.a[0] - self.a[1])
            e = np.array([*(e[:2] * math.sqrt(1.0 - c * c) / math.hypot(*e[:2])), c])
        y[6:9] = e
        if touching:
            i = touching[0]
            y[2] = self.r[i] - self.a[i] * e[2]
        u = self.velocity(y)
        if touching:
            w = np.array([self.rows(y, i)[0] for i in touching])
            inverse = self.inverse(y)
            u = u - inverse @ w.T @ np.linalg.solve(w @ inverse @ w.T, w @ u)
        return self.with_velocity(y, u)

    def with_velocity(self, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        y = y.copy()
        y[3:6] = u[:3]
        y[9:] = self.i1 * u[3:] + (self.i3 - self.i1) * (u[3:] @ y[6:9]) * y[6:9]
        return y

    def impact(self, y: np.ndarray, touching: tuple[int, ...]) -> tuple[np.ndarray, tuple[int, ...]]:
        """(state, contacts with an impulse) after a plastic impact with the ellipsoid law on the slip after it."""
        u, inverse = self.velocity(y), self.inverse(y)
        w = {i: self.rows(y, i) for i in touching}
        for count in range(1, len(touching) + 1):
            for active in itertools.combinations(touching, count):

                def after(n: np.ndarray, s: np.ndarray, active: tuple[int, ...] = active) -> np.ndarray:
                    push = sum(
                        n[k] * (w[i][0] - self.mu * w[i][1:].T @ (s[k] / np.linalg.norm(s[k])))
                        for k, i in enumerate(active)
                    )
                    return u + inverse @ push

                def miss(x: np.ndarray, active: tuple[int, ...] = active) -> np.ndarray:
                    m = len(active)
                    n, s = x[:m] * self.mass, x[m:].reshape(m, 3)
                    now = after(n, s, active)
                    return np.concatenate(
                        [[w[i][0] @ now for i in active], *(w[i][1:] @ now - s[k] for k, i in enumerate(active))]
                    )

                guess = np.concatenate([np.zeros(len(active)), *(w[i][1:] @ u for i in active)])
                x, _, flag, _ = fsolve(miss, guess, xtol=1e-15, full_output=True)
                if np.abs(miss(x)).max() > 1e-12:
                    continue
                m = len(active)
                now = after(x[:m] * self.mass, x[m:].reshape(m, 3), active)
                if x[:m].min() >= 0.0 and all(w[i][0] @ now >= -1e-12 for i in touching):
                    return self.with_velocity(y, now), active
        raise ArithmeticError("no impulse found; does a contact stop slipping?")


@dataclass
class Motion:
    """[(t, state, text)] of the events and the smooth pieces (t0, t1, contacts, state as a function of time)."""

    log: list[tuple[float, np.ndarray, str]] = field(default_factory=list)
    pieces: list[tuple[float, float, tuple[int, ...], object]] = field(default_factory=list)

    def state(self, t: float) -> np.ndarray:
        return next(dense(t) for start, end, _, dense in self.pieces if start <= t <= end)

    def theta(self, t: float) -> float:
        e = self.state(t)[6:9]
        return math.atan2(math.hypot(e[0], e[1]), e[2])


def run(t_end: float, top: Top = Top(), y: np.ndarray | None = None, rtol: float = 1e-12, most: int = 40) -> Motion:
    """Located events: contacts that end (N = 0) and begin (a plastic impact), `most` of them.

    Every contact must slip or spin all the time.
    """
    t, y, touching, motion = 0.0, top.start() if y is None else y, (0,), Motion()
    motion.log.append((t, y, "start"))
    for _ in range(most):
        y = top.project(y, touching)
        events = [(lambda t, y, k=k, a=touching: top.forces(y, a)[1][k], -1) for k in range(len(touching))]
        other = [i for i in range(2) if i not in touching]
        events += [(lambda t, y, i=i: top.gap(y, i) + 1e-15, -1) for i in other]
        done = leg(lambda t, y, a=touching: top.rhs(y, a), t, y, t_end, events, rtol=rtol, atol=1e-18)
        motion.pieces.append((t, done.t, touching, done.dense))
        t, y = done.t, done.y
        if done.event is None:
            motion.log.append((t, y, "end"))
            return motion
        if done.event < len(touching):
            gone = touching[done.event]
            touching = tuple(i for i in touching if i != gone)
            motion.log.append((t, y, f"{gone} opens"))
            continue
        new = other[done.event - len(touching)]
        motion.log.append((t, y, f"{new} closes"))
        y = top.project(y, touching) if touching else y
        hit = tuple(sorted([*touching, new]))
        y, _ = top.impact(y, hit)
        u = top.velocity(y)
        closed = tuple(i for i in hit if abs(top.rows(y, i)[0] @ u) <= 1e-10)
        while closed and top.forces(y, closed)[1].min() < 0.0:
            worst = closed[int(np.argmin(top.forces(y, closed)[1]))]
            closed = tuple(i for i in closed if i != worst)
        touching = closed
        motion.log.append((t, y, f"in touch: {touching}"))
    raise ArithmeticError("too many events: an endless sequence of impacts?")


def moreau(t_end: float, dt: float, top: Top = Top(), y: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(times, states) by Moreau's midpoint steps, e = 0, contacts with a gap <= 0 at the middle of the step.

    Momenta are what a step changes, and the axis turns with the angular velocity of its ends for half a step each. The
    directions of friction are iterated to those of the slip after the step.
    """

    def half(y: np.ndarray) -> np.ndarray:
        y, omega = y.copy(), top.omega(y)
        y[:3] += 0.5 * dt * y[3:6]
        rate = float(np.linalg.norm(omega))
        if rate > 0.0:
            axis, angle = omega / rate, 0.5 * dt * rate
            e = y[6:9]
            e = e * math.cos(angle) + np.cross(axis, e) * math.sin(angle) + axis * (axis @ e) * (1.0 - math.cos(angle))
            y[6:9] = e / np.linalg.norm(e)
        return y

    y = top.start() if y is None else y
    states = [y]
    for _ in range(round(t_end / dt)):
        old = top.velocity(y)
        y = half(y)
        y[5] -= GRAVITY * dt
        closed = [i for i in range(2) if top.gap(y, i) <= 0.0]
        u, inverse, w = top.velocity(y), top.inverse(y), [top.rows(y, i) for i in range(2)]
        sets = [active for n in range(len(closed) + 1) for active in itertools.combinations(closed, n)]
        for active in sets:
            now, good = u, True
            slips = np.array([w[i][1:] @ old for i in active])
            for _ in range(200 if active else 0):
                units = slips / np.linalg.norm(slips, axis=1)[:, None]
                push = np.array([w[i][0] - top.mu * w[i][1:].T @ s for i, s in zip(active, units, strict=True)])
                a = np.array([w[i][0] for i in active])
                n = np.linalg.solve(a @ inverse @ push.T, -a @ u)
                now, last, good = u + inverse @ push.T @ n, slips, bool(n.min() >= 0.0)
                slips = np.array([w[i][1:] @ now for i in active])
                if np.abs(slips - last).max() <= 1e-13:
                    break
            if good and all(w[i][0] @ now >= -1e-10 for i in closed):
                break
        y = half(top.with_velocity(y, now))
        states.append(y)
    return dt * np.arange(len(states)), np.array(states)


if __name__ == "__main__":
    done = run(3.0)
    for t, y, text in done.log[:60]:
        print(f"{t:.10f} {text:20s} theta {math.acos(y[8]):.10f} energy {Top().energy(y):.10e}")
    for t in (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0):
        print(t, f"theta {done.theta(t):.10f}", done.state(t))
