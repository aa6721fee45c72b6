"""Motions in lasting contact with known answers: closed forms, and few coordinates integrated by DOP853.

Written from mechanics, without the engine. Each function or method `states` returns rows of a state at given times
[s], (n, k); which numbers a row holds is said there. Masses that cancel are left out; balls are solid, 2/5 m r^2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from .switched_modes import Change, Guard, motion

Array = NDArray[np.float64]

GRAVITY = 9.81
UP = np.array([0.0, 0.0, 1.0])


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    return float(brentq(function, low, high, xtol=1e-16, rtol=4.0 * np.finfo(float).eps))


# --- balls on planes --------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class SlidingBall:
    """A ball that slides on a level plane and then rolls.

    The slip u = v - r w x n keeps its direction d: v' = -mu g d, r w' = 5/2 mu g n x d, hence u' = -7/2 mu g d.
    A row holds the centre (x, y), its velocity and the spin (3,) in world axes.
    """

    radius: float
    friction: float
    velocity: tuple[float, float]
    spin: tuple[float, float, float]

    def slip(self) -> Array:
        return np.array(self.velocity) - self.radius * np.array([self.spin[1], -self.spin[0]])

    def rolls_from(self) -> float:
        """The time when the slip ends [s]; infinite without friction."""
        return 2.0 * float(np.linalg.norm(self.slip())) / (7.0 * self.friction * GRAVITY) if self.friction else math.inf

    def states(self, times: Array) -> Array:
        slip = self.slip()
        along = slip / np.linalg.norm(slip)
        velocity, spin, force = np.array(self.velocity), np.array(self.spin), self.friction * GRAVITY
        rows = []
        for t in times:
            slid = min(t, self.rolls_from())
            v = velocity - force * slid * along
            x = velocity * slid - 0.5 * force * slid**2 * along + v * (t - slid)
            turned = 2.5 * force * slid / self.radius * np.array([-along[1], along[0], 0.0])
            rows.append(np.concatenate([x, v, spin + turned]))
        return np.array(rows)


def rolling_down(radius: float, slope: float, start: Sequence[float], times: Array) -> Array:
    """Return the motion of a ball that rolls on a slope [rad] from the velocity `start` (down, across).

    Gravity acts down the slope by 5/7. A row holds what one of `TurningSlip` holds.
    """
    t, down = np.asarray(times)[:, None], 5.0 / 7.0 * GRAVITY * math.sin(slope) * np.array([1.0, 0.0])
    v = np.array(start) + down * t
    spin = np.stack([-v[:, 1], v[:, 0], np.zeros(len(v))], axis=1) / radius
    return np.concatenate([np.array(start) * t + 0.5 * down * t**2, v, spin], axis=1)


@dataclass(frozen=True)
class TurningSlip:
    """A ball that slides on a slope [rad] across the line of fall: its slip turns to that line, and ends there.

    With the slip u at the angle theta to the line of fall, a = g sin(slope) and b = 7/2 mu g cos(slope),

        |u|' = a cos theta - b,    |u| theta' = -a sin theta,

    of which w = tan(theta/2) is the natural coordinate: with k = b/a and a constant c

        u = c (w^(k-1) (1 - w^2) / 2, w^k),    time left = c/(2a) (w^(k-1)/(k-1) + w^(k+1)/(k+1)).

    So w is as the (k-1)th root of the time left. The motion is smooth up to the end of the slip where 1/(k-1) is a
    whole number, k = 2, 3/2, 4/3, ...; for other k > 1 the acceleration has a root of the time left in it there.
    Then the ball rolls, v' = 5/7 a.

    A row holds the centre (down, across), its velocity and the spin about (down, across, normal).
    """

    radius: float
    slope: float
    k: float
    velocity: tuple[float, float]
    slip: tuple[float, float]  # the second number > 0

    @property
    def friction(self) -> float:
        return self.k * 2.0 / 7.0 * math.tan(self.slope)

    def _left(self, w: float) -> tuple[float, Array, Array]:
        """Return the time left, the slip and the way that the contact point slips until the end of the slip."""
        k, a = self.k, GRAVITY * math.sin(self.slope)
        start = self._start()
        c = self.slip[1] / start**k
        time = 0.5 * c / a * (w ** (k - 1) / (k - 1) + w ** (k + 1) / (k + 1))
        slip = c * np.array([0.5 * w ** (k - 1) * (1.0 - w * w), w**k])
        down = 0.25 * c * c / a * (w ** (2 * k - 2) / (2 * k - 2) - w ** (2 * k + 2) / (2 * k + 2))
        across = 0.5 * c * c / a * (w ** (2 * k - 1) / (2 * k - 1) + w ** (2 * k + 1) / (2 * k + 1))
        return time, slip, np.array([down, across])

    def _at(self, left: float) -> float:
        """Return w at this time before the end of the slip."""
        return _root(lambda w: self._left(w)[0] - left, 0.0, self._start())

    def _start(self) -> float:
        return math.tan(0.5 * math.atan2(self.slip[1], self.slip[0]))

    def rolls_from(self) -> float:
        return self._left(self._start())[0]

    def states(self, times: Array) -> Array:
        """The friction has the direction of (a e - u') / b, so that its impulse follows from the slip."""
        a, end = GRAVITY * math.sin(self.slope) * np.array([1.0, 0.0]), self.rolls_from()
        _, slip0, way0 = self._left(self._start())
        velocity, rows = np.array(self.velocity), []
        for t in times:
            slid = min(t, end)
            w = self._at(end - slid) if t < end else 0.0
            _, slip, way = self._left(w)
            v = velocity + 5.0 / 7.0 * a * t + 2.0 / 7.0 * (slip - slip0)
            x = velocity * t + 5.0 / 14.0 * a * t * t + 2.0 / 7.0 * (way0 - way - slip0 * t)
            across = (v - slip) / self.radius
            rows.append(np.concatenate([x, v, [-across[1], across[0], 0.0]]))
        return np.array(rows)


def on_turntable(rate: float, start: Sequence[float], velocity: Sequence[float], times: Array) -> Array:
    """Return the centre of a ball that rolls on a level turntable with the angular velocity `rate` [rad/s], (n, 2).

    It goes on a circle with 2/7 of that rate, wherever it is: v' = 2/7 rate n x v.
    """
    turn = 2.0 / 7.0 * rate
    angle = turn * np.asarray(times)
    x, y = velocity
    sine, cosine = np.sin(angle) / turn, (1.0 - np.cos(angle)) / turn
    return np.stack([start[0] + x * sine - y * cosine, start[1] + x * cosine + y * sine], axis=1)


# --- on a sphere ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class PointOnSphere:
    """A point mass that slides on a sphere of this radius about the origin, and flies where the normal force ends.

    With the outward normal n and N/m = g n_z - v^2/radius: x'' = -g e_z + (N/m) (n - mu v/|v|).
    A row holds its place and velocity, (6,).
    """

    radius: float
    friction: float

    def load(self, y: Array) -> float:
        """N/m [m/s^2]."""
        return float(GRAVITY * y[2] / self.radius - y[3:] @ y[3:] / self.radius)

    def rate(self, mode: str, _t: float, y: Array) -> Array:
        acceleration = -GRAVITY * UP
        if mode == "slides":
            speed = float(np.linalg.norm(y[3:]))
            along = y[3:] / speed if speed else np.zeros(3)
            acceleration = acceleration + self.load(y) * (y[:3] / self.radius - self.friction * along)
        return np.concatenate([y[3:], acceleration])

    def guards(self, mode: str) -> list[Guard]:
        return [lambda _t, y: self.load(y)] if mode == "slides" else []

    def after(self, _mode: str, _guard: int, _t: float, _y: Array) -> str:
        return "flies"

    def states(self, start: Array, times: Array) -> tuple[Array, list[Change]]:
        return motion(self, "slides", start, times)


@dataclass(frozen=True)
class BallOffSphere:
    """A ball that rolls down a fixed sphere in a plane, then slides, then flies.

    theta: angle of the centre from the top, at the distance `length` (both radii); spin: about the axis in whose sense
    it rolls down; k: moment of inertia over m r^2. Rolling: (1 + k) theta'' = g sin(theta)/length, which needs the
    friction k/(1 + k) m g sin(theta). Sliding with the slip u = length theta' - r spin > 0: length theta'' = g
    sin(theta) - mu N/m, spin' = mu (N/m)/(k r), where N/m = g cos(theta) - length theta'^2.

    The integrated state is (theta, theta', spin, angle turned) on the sphere, and in flight (x, z, vx, vz, spin, angle)
    follows from it in closed form. A row holds the latter, (6,).
    """

    radius: float
    length: float
    friction: float
    inertia: float = 0.4

    @property
    def share(self) -> float:
        """Of the pull along the sphere, what friction takes while it rolls."""
        return self.inertia / (1.0 + self.inertia)

    def load(self, y: Array) -> float:
        return float(GRAVITY * math.cos(y[0]) - self.length * y[1] ** 2)

    def rate(self, mode: str, _t: float, y: Array) -> Array:
        if mode == "flies":
            return np.zeros(4)
        pull = GRAVITY * math.sin(y[0])
        force = self.share * pull if mode == "rolls" else self.friction * self.load(y)
        return np.array([y[1], (pull - force) / self.length, force / (self.inertia * self.radius), y[2]])

    def guards(self, mode: str) -> list[Guard]:
        if mode == "rolls":
            return [lambda _t, y: self.friction * self.load(y) - self.share * GRAVITY * math.sin(y[0])]
        return [lambda _t, y: self.load(y)] if mode == "slides" else []

    def after(self, mode: str, _guard: int, _t: float, _y: Array) -> str:
        return "slides" if mode == "rolls" else "flies"

    def _row(self, y: Array, time: float = 0.0) -> Array:
        """Return the row `time` after the ball has left the sphere in this state."""
        out, along = np.array([math.sin(y[0]), math.cos(y[0])]), np.array([math.cos(y[0]), -math.sin(y[0])])
        fall = np.array([0.0, -GRAVITY])
        v = self.length * y[1] * along
        return np.concatenate([
            self.length * out + v * time + 0.5 * fall * time**2, v + fall * time, [y[2], y[3] + y[2] * time],
        ])  # fmt: skip

    def states(self, theta: float, rate: float, times: Array) -> tuple[Array, list[Change]]:
        start = np.array([theta, rate, self.length * rate / self.radius, 0.0])
        _, changes = motion(self, "rolls", start, np.array([times[0], times[-1]]))
        leaves = next((c.t for c in changes if c.mode == "flies"), math.inf)
        held = np.append(times[times < leaves], min(leaves, times[-1]))
        rows, _ = motion(self, "rolls", start, held)
        last = rows[-1]
        return np.array(
            [self._row(rows[k]) if t < leaves else self._row(last, t - leaves) for k, t in enumerate(times)]
        ), changes


def ball_over_edge(ball: BallOffSphere, speed: float, start: float, times: Array) -> tuple[Array, list[Change]]:
    """Return rows of a ball that rolls along a level line, from x = start < 0, and at x = 0 over a round edge.

    The radius of the edge is ball.length - ball.radius, 0 where it is sharp; its centre is the origin of the rows, as
    in BallOffSphere. While the ball rolls along the line nothing acts on it.
    """
    edge, spin = -start / speed, speed / ball.radius
    after = np.append(edge, times[times > edge]) - edge
    rows, changes = ball.states(0.0, speed / ball.length, after)
    level = [[start + speed * t, ball.length, speed, 0.0, spin, spin * t] for t in times[times <= edge]]
    rows[:, 5] += spin * edge
    return np.array([*level, *rows[1:]]), [Change(change.t + edge, change.mode) for change in changes]


# --- a rod with friction at its tip -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class RodOnTip:
    """A uniform rod in the plane whose lower end, a ball of radius `tip`, touches the ground z = 0.

    x: place of its centre, theta: angle above the horizontal of the rod, seen from the lower end, which is behind;
    the centre is at z = tip + l/2 sin(theta). The contact point slips with u = x' + (l/2 sin(theta) + tip) theta'. With
    the normal force N and the friction F along x

        m x'' = F,    I theta'' = (l/2 sin(theta) + tip) F - l/2 cos(theta) N,    z'' = N/m - g,

    where F = -mu N sign(u), or where it sticks what keeps u = 0. A row holds (x, theta, x', theta').
    """

    friction: float
    tip: float
    length: float = 1.0  # [m]; the mass is 1 kg

    @property
    def inertia(self) -> float:
        return self.length**2 / 12.0

    def slip(self, y: Array) -> float:
        return float(y[2] + (0.5 * self.length * math.sin(y[1]) + self.tip) * y[3])

    def forces(self, mode: str, y: Array) -> tuple[float, float]:
        """Return N and F from the equations of the constraints; z'' is that of the held tip."""
        half, inertia = 0.5 * self.length, self.inertia
        sine, cosine = math.sin(y[1]), math.cos(y[1])
        high, beside = half * sine + self.tip, half * cosine
        # unknowns theta'', N, F
        turn = [inertia, beside, -high]
        lift, lifted = [beside, -1.0, 0.0], half * sine * y[3] ** 2 - GRAVITY  # beside theta'' - N = lifted
        if mode == "sticks":
            last, value = [high, 0.0, 1.0], -half * cosine * y[3] ** 2  # F + high theta'' + high' theta' = 0
        else:
            last, value = [0.0, self.friction * (1.0 if mode == "forward" else -1.0), 1.0], 0.0
        _, normal, tangential = np.linalg.solve([turn, lift, last], [0.0, lifted, value])
        return float(normal), float(tangential)

    def rate(self, mode: str, _t: float, y: Array) -> Array:
        normal, tangential = self.forces(mode, y)
        high, beside = 0.5 * self.length * math.sin(y[1]) + self.tip, 0.5 * self.length * math.cos(y[1])
        return np.array([y[2], y[3], tangential, (high * tangential - beside * normal) / self.inertia])

    def guards(self, mode: str) -> list[Guard]:
        if mode == "sticks":

            def spare(_t: float, y: Array) -> float:
                normal, tangential = self.forces("sticks", y)
                return self.friction * normal - abs(tangential)

            return [spare]
        sign = 1.0 if mode == "forward" else -1.0
        return [lambda _t, y: sign * self.slip(y)]

    def after(self, mode: str, _guard: int, _t: float, y: Array) -> str:
        normal, tangential = self.forces("sticks", y)
        if mode != "sticks" and abs(tangential) <= self.friction * normal:
            return "sticks"
        return "forward" if tangential < 0.0 else "backward"

    def states(self, start: Array, times: Array) -> tuple[Array, list[Change]]:
        slip = self.slip(start)
        return motion(self, "forward" if slip > 0.0 else "backward" if slip < 0.0 else "sticks", start, times)


# --- a block with a spring on a moving belt ---------------------------------------------------------------------------
@dataclass(frozen=True)
class BlockOnBelt:
    """A block of 1 kg with a spring to the world on a belt that moves as V t + A sin(w t): it sticks and slips.

    Slipping, x'' = -k x + s mu g with the sign s of the belt's velocity seen from the block, is a piece of a harmonic
    motion; sticking, x - belt is constant, while |belt'' + k x| <= mu g. Where a piece ends is a root of a function in
    closed form. Where static and sliding friction are one, a belt of constant speed lets the block go for good: it
    begins to slip at x = mu g/k, and swings about that place and meets the belt's speed once a period, without load to
    spare. A row holds (x, x').
    """

    stiffness: float
    friction: float
    speed: float
    amplitude: float = 0.0
    rate: float = 1.0

    def belt(self, t: float) -> tuple[float, float, float]:
        """Return place, velocity and acceleration of the belt."""
        sine, cosine = self.amplitude * math.sin(self.rate * t), self.amplitude * math.cos(self.rate * t)
        return self.speed * t + sine, self.speed + self.rate * cosine, -(self.rate**2) * sine

    def pieces(self, x: float, v: float, duration: float) -> list[tuple[float, int, float, float]]:
        """Return (start, sign of the friction or 0 where it sticks, x, v at the start) of the pieces.

        A change is looked for on a grid, on which no two of them share an interval. Where the guard only touches zero,
        but for rounding, nothing changes.
        """
        grid, t, found = 1e-3, 0.0, []
        sign = self._sign(t, x, v)
        while True:
            found.append((t, sign, x, v))
            guard, low = self._stays(found[-1]), t
            while low < duration and guard(low + grid) > -1e-13:
                low += grid
            if low >= duration:
                return found
            t = _root(guard, max(low, t + 1e-9), low + grid)
            x, v = self._state(found[-1], t)
            if sign:
                sign = self._sign(t, x, self.belt(t)[1])
            else:
                sign = 1 if self.belt(t)[2] + self.stiffness * x > 0.0 else -1

    def _sign(self, t: float, x: float, v: float) -> int:
        relative = self.belt(t)[1] - v
        if abs(relative) > 1e-12:
            return 1 if relative > 0.0 else -1
        needed = self.belt(t)[2] + self.stiffness * x
        return 0 if abs(needed) <= self.friction * GRAVITY else 1 if needed > 0.0 else -1

    def _stays(self, piece: tuple[float, int, float, float]) -> Callable[[float], float]:
        if piece[1]:
            return lambda t: piece[1] * (self.belt(t)[1] - self._state(piece, t)[1])
        return lambda t: self.friction * GRAVITY - abs(self.belt(t)[2] + self.stiffness * self._state(piece, t)[0])

    def _state(self, piece: tuple[float, int, float, float], t: float) -> tuple[float, float]:
        start, sign, x, v = piece
        if not sign:
            place, speed, _ = self.belt(t)
            return x + place - self.belt(start)[0], speed
        w, centre = math.sqrt(self.stiffness), sign * self.friction * GRAVITY / self.stiffness
        sine, cosine = math.sin(w * (t - start)), math.cos(w * (t - start))
        return centre + (x - centre) * cosine + v / w * sine, v * cosine - (x - centre) * w * sine

    def states(self, x: float, v: float, times: Array) -> Array:
        pieces = self.pieces(x, v, float(times[-1]))
        starts = np.array([piece[0] for piece in pieces])
        return np.array([self._state(pieces[int(np.searchsorted(starts, t, "right")) - 1], t) for t in times])


# --- a box on a plane that tilts --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class BoxOnTiltingPlane:
    """A box on a plane through the origin whose angle grows as `rate` t: it slips when the plane is steep enough.

    s: its place along the plane, c: half its height. In the axes of the plane, down and normal, its centre (s, c) has
    the acceleration (s'' - s w^2, -2 s' w - c w^2). So

        N/m = g cos(phi) - 2 s' w - c w^2,    s'' = s w^2 + g sin(phi) - mu N/m,

    and it sticks while s w^2 + g sin(phi) <= mu N/m. A row holds (s, s').
    """

    friction: float
    turning: float
    half_height: float

    def load(self, t: float, speed: float) -> float:
        w = self.turning
        return GRAVITY * math.cos(w * t) - 2.0 * speed * w - self.half_height * w * w

    def rate(self, mode: str, t: float, y: Array) -> Array:
        if mode == "sticks":
            return np.zeros(2)
        return np.array([y[1], self.pull(t, y) - self.friction * self.load(t, y[1])])

    def pull(self, t: float, y: Array) -> float:
        return float(y[0] * self.turning**2 + GRAVITY * math.sin(self.turning * t))

    def guards(self, mode: str) -> list[Guard]:
        return [lambda t, y: self.friction * self.load(t, 0.0) - self.pull(t, y)] if mode == "sticks" else []

    def after(self, _mode: str, _guard: int, _t: float, _y: Array) -> str:
        return "slides"

    def states(self, s: float, times: Array) -> tuple[Array, list[Change]]:
        return motion(self, "sticks", np.array([s, 0.0]), times)


# --- joint friction ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class RubbingPendulum:
    """A pendulum with Coulomb friction in its joint: inertia theta'' = -weight sin(theta) - friction sign(theta').

    weight: mass times gravity times the distance of its centre [N m]. A row holds (theta, theta').
    """

    inertia: float
    weight: float
    friction: float

    def rate(self, mode: str, _t: float, y: Array) -> Array:
        if mode == "rests":
            return np.zeros(2)
        sign = 1.0 if mode == "forward" else -1.0
        return np.array([y[1], -(self.weight * math.sin(y[0]) + sign * self.friction) / self.inertia])

    def guards(self, mode: str) -> list[Guard]:
        if mode == "rests":
            return []
        sign = 1.0 if mode == "forward" else -1.0
        return [lambda _t, y: sign * y[1]]

    def after(self, _mode: str, _guard: int, _t: float, y: Array) -> str:
        pull = -self.weight * math.sin(y[0])
        if abs(pull) <= self.friction:
            y[1] = 0.0
            return "rests"
        return "forward" if pull > 0.0 else "backward"

    def states(self, theta: float, times: Array) -> tuple[Array, list[Change]]:
        start = np.array([theta, 0.0])
        return motion(self, self.after("", 0, 0.0, start), start, times)


# --- a coin that rolls on its rim -------------------------------------------------------------------------------------
@dataclass(frozen=True)
class RollingCoin:
    """A cylinder of 1 kg that rolls without slip on the rim of one of its ends, on a level plane.

    a: its axis, directed away from the rim that touches. The place of contact seen from the centre is
    rho = -h/2 a - r (e_z - a_z a) / |e_z - a_z a|. Rolling, v + w x rho = 0; the force f follows from that:

        v' = -w' x rho - w x rho',    f = m (v' + g e_z),    (I w)' = rho x f.

    A row holds the centre (3,), the axis (3,) and the spin (3,) in world axes.
    """

    radius: float
    height: float

    @property
    def inertias(self) -> tuple[float, float]:
        """About the axis, and across it [kg m^2]."""
        return 0.5 * self.radius**2, self.radius**2 / 4.0 + self.height**2 / 12.0

    def arm(self, axis: Array) -> Array:
        out = UP - axis[2] * axis
        return np.asarray(-0.5 * self.height * axis - self.radius * out / np.linalg.norm(out))

    def _arm_rate(self, axis: Array, turned: Array) -> Array:
        """Return rho' for a' = turned."""
        out = UP - axis[2] * axis
        rate, size = -turned[2] * axis - axis[2] * turned, np.linalg.norm(out)
        return np.asarray(-0.5 * self.height * turned - self.radius * (rate / size - out * (out @ rate) / size**3))

    def force(self, axis: Array, spin: Array) -> tuple[Array, Array]:
        """Return the force on the coin [N] and w'."""
        about, across = self.inertias
        rho, turned = self.arm(axis), np.cross(spin, axis)
        tensor = across * np.eye(3) + (about - across) * np.outer(axis, axis)
        # (I w)' = I w' + (about - across) (a' (a.w) + a (a'.w)), and a'.w = 0
        bent = (about - across) * turned * (axis @ spin)
        known = -np.cross(spin, self._arm_rate(axis, turned)) + GRAVITY * UP  # f = known - w' x rho
        cross = np.array([[0.0, -rho[2], rho[1]], [rho[2], 0.0, -rho[0]], [-rho[1], rho[0], 0.0]])
        change = np.linalg.solve(tensor - cross @ cross, cross @ known - bent)  # rho x (-(w' x rho)) = rho x (rho x w')
        return known - np.cross(change, rho), change

    def states(self, axis: Array, spin: Array, times: Array) -> Array:
        """Return the rows from the centre above the origin."""

        def rate(_t: float, y: Array) -> Array:
            a, w = y[3:6], y[6:9]
            return np.concatenate([-np.cross(w, self.arm(a)), np.cross(w, a), self.force(a, w)[1]])

        start = np.concatenate([[0.0, 0.0, -self.arm(axis)[2]], axis, spin])
        run = solve_ivp(rate, (times[0], times[-1]), start, "DOP853", rtol=1e-13, atol=1e-13, t_eval=times)
        return np.asarray(run.y.T)

    def steady(self, tilt: float, precession: float) -> tuple[Array, Array]:
        """Return axis and spin of the motion at a constant angle `tilt` [rad] of the axis from the vertical.

        The coin precesses with w = precession e_z + sigma a: the contact goes round a circle. In the axes that turn
        with it v = -w x rho and the angular momentum are constant, so that rho x (precession e_z x v + g e_z) is
        precession e_z x I w: both are across the plane of axis and vertical, and linear in sigma.
        """
        axis = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
        about, across = self.inertias
        rho = self.arm(axis)

        def missing(sigma: float) -> float:
            spin = precession * UP + sigma * axis
            momentum = across * spin + (about - across) * (axis @ spin) * axis
            force = precession * np.cross(UP, -np.cross(spin, rho)) + GRAVITY * UP
            return float((np.cross(rho, force) - precession * np.cross(UP, momentum))[1])

        base = missing(0.0)
        return axis, precession * UP - base / (missing(1.0) - base) * axis


def circling(coin: RollingCoin, tilt: float, precession: float, times: Array) -> Array:
    """Return the steady motion of `RollingCoin.steady` in closed form: its centre goes round, axis and spin turn."""
    axis, spin = coin.steady(tilt, precession)
    velocity, rows = -np.cross(spin, coin.arm(axis)), []
    middle = np.array([0.0, 0.0, -coin.arm(axis)[2]]) + np.cross(UP, velocity) / precession
    for t in times:
        sine, cosine = math.sin(precession * t), math.cos(precession * t)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        rows.append(np.concatenate([middle - turn @ np.cross(UP, velocity) / precession, turn @ axis, turn @ spin]))
    return np.array(rows)
