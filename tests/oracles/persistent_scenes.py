"""References for persistent contact: closed forms, else DOP853 at rtol 1e-12 with events.

SI units; g = 9.81 m/s^2 unless given. Every scene here can be built with the package's own shapes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

GRAVITY = 9.81
BALL, CYLINDER = 0.4, 0.5  # I / (m R^2) of solid bodies


# --- slopes ---------------------------------------------------------------------------------------------------------
def block_on_slope(slope: float, mu: float) -> float:
    """Acceleration of a block from rest on a slope [rad], down the slope [m/s^2]; 0 where it sticks."""
    return max(0.0, GRAVITY * (math.sin(slope) - mu * math.cos(slope)))


def round_body_on_slope(slope: float, mu: float, k: float) -> tuple[float, float, bool]:
    """(acceleration, R * angular acceleration, whether it rolls) of a ball or cylinder, I = k m R^2, from rest.

    Rolling needs the friction m g sin k / (1 + k); else it slides with the full mu m g cos.
    """
    rolling = GRAVITY * math.sin(slope) / (1.0 + k)
    if mu * math.cos(slope) >= k / (1.0 + k) * math.sin(slope):
        return rolling, rolling, True
    return GRAVITY * (math.sin(slope) - mu * math.cos(slope)), mu * GRAVITY * math.cos(slope) / k, False


def ball_in_groove(slope: float, opening: float) -> tuple[float, float, float]:
    """(acceleration, angular acceleration * R, normal force / weight of each side) of a ball rolling down a groove.

    The sides stand at the angle `opening` [rad] to the horizontal, on both sides of the line of fall; the points of
    contact are R cos(opening) below the centre, so v = omega R cos(opening).
    """
    c = math.cos(opening)
    acceleration = GRAVITY * math.sin(slope) / (1.0 + BALL / c**2)
    return acceleration, acceleration / c, 0.5 * math.cos(slope) / c


def ball_crossing_slope(slope: float, mu: float, v0: tuple[float, float], duration: float) -> np.ndarray:
    """State (x, y, vx, vy, ux, uy) of a sliding ball on a slope, x down it; u: slip of its lowest point [m/s].

    Friction turns with the slip: v' = g_x - mu g cos d, slip u' = g_x - mu g cos (1 + 1/k) d, d = u/|u|.
    Starts with u = v0 (no spin).
    """
    pull, grip = GRAVITY * math.sin(slope), mu * GRAVITY * math.cos(slope)

    def rhs(_t, y):
        d = y[4:] / np.linalg.norm(y[4:])
        down = np.array([pull, 0.0])
        return np.concatenate([y[2:4], down - grip * d, down - grip * (1.0 + 1.0 / BALL) * d])

    y0 = np.concatenate([np.zeros(2), v0, v0])
    return solve_ivp(rhs, (0.0, duration), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


# --- balls ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class SpinningBall:
    """Ball (mass 1) dropped with spin about the horizontal y axis, plastic impact with friction, then slides.

    Attributes: hit, normal_impulse, friction_impulse (along x), speed and spin after the impact, slip speed, the time
    `stick` when it starts to roll, place, speed and spin from then on. x' = omega R when rolling (omega about +y).
    """

    radius: float = 0.1
    height: float = 1.0
    spin0: float = 50.0
    mu: float = 0.2

    @property
    def hit(self) -> float:
        return math.sqrt(2.0 * (self.height - self.radius) / GRAVITY)

    @property
    def normal_impulse(self) -> float:
        return GRAVITY * self.hit

    @property
    def friction_impulse(self) -> float:
        """The point of contact moves backwards with omega R, so friction pushes forwards, until it rolls at most."""
        need = self.spin0 * self.radius / (1.0 + 1.0 / BALL)
        return min(self.mu * self.normal_impulse, need)

    @property
    def after(self) -> tuple[float, float, float]:
        """(speed, spin, slip speed omega R - x') right after the impact."""
        x = self.friction_impulse
        spin = self.spin0 - x / (BALL * self.radius)
        return x, spin, spin * self.radius - x

    @property
    def stick(self) -> float:
        return self.hit + self.after[2] / (self.mu * GRAVITY * (1.0 + 1.0 / BALL))

    @property
    def rolling(self) -> tuple[float, float]:
        """(speed, spin) of the rolling ball."""
        dt = self.stick - self.hit
        speed = self.after[0] + self.mu * GRAVITY * dt
        return speed, self.after[1] - self.mu * GRAVITY * dt / (BALL * self.radius)

    def place(self, t: float) -> float:
        """x at time t [m]."""
        if t <= self.hit:
            return 0.0
        dt = min(t, self.stick) - self.hit
        slid = self.after[0] * dt + 0.5 * self.mu * GRAVITY * dt * dt
        return slid + max(0.0, t - self.stick) * self.rolling[0]


def ball_off_ball(distance: float, angle0: float, rolling: bool) -> tuple[float, float]:
    """(angle from the top [rad], time [s]) where a ball leaves a fixed ball; rest at angle0; distance of the centres.

    (1 + k) w^2 / 2 = (g/d)(cos a0 - cos a), and the normal force m (g cos a - d w^2) ends.
    """
    k = BALL if rolling else 0.0
    leave = math.acos(2.0 * math.cos(angle0) / (3.0 + k))
    scale = 2.0 * GRAVITY / ((1.0 + k) * distance)

    # a = a0 + x^2 takes the singularity at rest away
    def integrand(x):
        if x == 0.0:
            return 2.0 / math.sqrt(scale * math.sin(angle0))
        return 2.0 * x / math.sqrt(scale * (math.cos(angle0) - math.cos(angle0 + x * x)))

    return leave, quad(integrand, 0.0, math.sqrt(leave - angle0), epsabs=1e-13, epsrel=1e-13)[0]


# --- rods -----------------------------------------------------------------------------------------------------------
class Ladder:
    """Uniform rod (mass, length) sliding without friction down a wall and along a floor, from rest at theta0 [rad]
    over the horizontal. It leaves the wall when its height is 2/3 of the first: sin(theta) = 2/3 sin(theta0).
    """

    def __init__(self, theta0: float, length: float = 1.0, mass: float = 1.0):
        self.theta0, self.a, self.mass = theta0, 0.5 * length, mass
        self.inertia = mass * length**2 / 12.0
        self.release_angle = math.asin(2.0 / 3.0 * math.sin(theta0))

    def _at_wall(self, _t, y):
        torque = -self.mass * GRAVITY * self.a * math.cos(y[0])
        return [y[1], torque / (self.mass * self.a**2 + self.inertia)]

    def _on_floor(self, _t, y):
        s, c, ma2 = math.sin(y[0]), math.cos(y[0]), self.mass * self.a**2
        return [y[1], (ma2 * s * c * y[1] ** 2 - self.mass * GRAVITY * self.a * c) / (ma2 * c * c + self.inertia)]

    @property
    def release(self) -> tuple[float, float]:
        """(time [s], angular velocity [rad/s]) where it leaves the wall."""

        def event(_t, y):
            return y[0] - self.release_angle

        event.terminal = True  # type: ignore[attr-defined]
        run = solve_ivp(
            self._at_wall, (0.0, 60.0), [self.theta0, 0.0], method="DOP853", rtol=1e-13, atol=1e-15, events=event
        )
        return float(run.t[-1]), float(run.y[1, -1])

    def state(self, t: float) -> tuple[float, float, float, float]:
        """(theta, theta', x, x') at time t; x: distance of the centre from the wall."""
        released, _ = self.release
        first = min(t, released)
        y = solve_ivp(self._at_wall, (0.0, first), [self.theta0, 0.0], method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
        x, speed = self.a * math.cos(y[0]), -self.a * math.sin(y[0]) * y[1]
        if t > released:
            y = solve_ivp(self._on_floor, (first, t), y, method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
            x += speed * (t - released)
        return float(y[0]), float(y[1]), x, speed

    def wall_force(self, theta: float) -> float:
        """[N], before the release."""
        ma2 = self.mass * self.a**2
        rate = self.mass * GRAVITY * self.a / (ma2 + self.inertia)
        return self.mass * self.a * rate * math.cos(theta) * (3 * math.sin(theta) - 2 * math.sin(self.theta0))


def rod_impact_with_friction(
    theta: float, speed: tuple[float, float], mu: float, restitution: float
) -> tuple[float, float]:
    """(P_n, P_t) on a rod m = l = 1 at `theta` over the ground, its lower end (left) hitting with speed (u_t, u_n < 0).

    Poisson's law in the plane: friction opposes the slip, or keeps the end at rest where the cone allows it, first in
    the compression and then in the expansion with at least e times its impulse.
    The end is at -cos/2, -sin/2 from the centre: G = [[1 + 3 c^2, -3 s c], [-3 s c, 1 + 3 s^2]] in (n, t).
    """
    s, c = math.sin(theta), math.cos(theta)
    g = np.array([[1 + 3 * c * c, -3 * s * c], [-3 * s * c, 1 + 3 * s * s]])

    def phase(w, lower):
        """Impulse (n, t) that ends with w_n = 0, or with its lower bound and w_n > 0."""
        stick = np.linalg.solve(g, -w)
        if stick[0] >= lower and abs(stick[1]) <= mu * stick[0]:
            return stick
        for sign in (1.0, -1.0):  # sign of the slip
            ray = np.array([1.0, -sign * mu])
            for size in (-w[0] / (g[0] @ ray), lower):
                after = w + g @ ray * size
                if size >= lower and after[0] >= -1e-15 and sign * after[1] > 0.0:
                    return ray * size
        sticks = np.array([lower, -(w[1] + g[1, 0] * lower) / g[1, 1]])  # leaves, without slip
        assert abs(sticks[1]) <= mu * lower
        return sticks

    w = np.array([speed[1], speed[0]])
    first = phase(w, 0.0)
    second = phase(w + g @ first, restitution * first[0])
    return float(first[0] + second[0]), float(first[1] + second[1])


def painleve_number(theta: float, mu: float) -> float:
    """A = W_n M^-1 (W_n - mu W_t)^T of the rod that slides to the side of Painleve's paradox: there A <= 0."""
    return 1.0 + 3.0 * math.cos(theta) ** 2 - 3.0 * mu * math.sin(theta) * math.cos(theta)


def painleve_mu(theta: float) -> float:
    """The friction from which the sliding rod is inconsistent; 4/3 at its smallest, tan(theta) = 2."""
    return (1.0 + 3.0 * math.cos(theta) ** 2) / (3.0 * math.sin(theta) * math.cos(theta))


# --- boxes ----------------------------------------------------------------------------------------------------------
def tipping_box(width: float, height: float, tilt0: float, rate0: float, t: float) -> tuple[float, float, float]:
    """(tilt, rate, |friction| / normal force, the largest) of a box that turns about its fixed lower edge.

    width, height [m] of the face it turns in; tilt [rad] from standing upright, 0 < tilt; beyond atan(width / height)
    it falls over. Uniform: I about the edge = m (w^2 + h^2) / 3.
    """
    r, lean = 0.5 * math.hypot(width, height), math.atan2(width, height)
    k = GRAVITY * r / (4.0 * r * r / 3.0)

    def rhs(_t, y):
        return [y[1], k * math.sin(y[0] - lean)]

    run = solve_ivp(rhs, (0.0, t), [tilt0, rate0], method="DOP853", rtol=1e-13, atol=1e-15, dense_output=True)
    a = run.sol(np.linspace(0.0, t, 200))
    angle, rate = a[0] - lean, a[1]  # of the centre from the vertical
    turn = k * np.sin(angle)
    normal = GRAVITY - r * (np.sin(angle) * turn + np.cos(angle) * rate**2)
    friction = r * (np.cos(angle) * turn - np.sin(angle) * rate**2)
    return float(run.y[0, -1]), float(run.y[1, -1]), float(np.abs(friction / normal).max())


def housner(width: float, height: float) -> float:
    """Ratio of angular velocities when a rocking block changes its edge without bounce: 1 - 1.5 sin^2(atan(w/h))."""
    return 1.0 - 1.5 * math.sin(math.atan2(width, height)) ** 2


def stack_loads(masses) -> np.ndarray:
    """Normal force under each body of a stack, from the lowest up [N]."""
    return GRAVITY * np.cumsum(np.asarray(masses, float)[::-1])[::-1]


# --- a pendulum at its limit ----------------------------------------------------------------------------------------
def pendulum_at_limit(limit: float, restitution: float, length: float = 1.0) -> tuple[float, float, float]:
    """(first hit [s], its speed [rad/s], end of the bouncing [s]) of a point mass on a rod, from rest at 0.

    Angle from the horizontal, downwards; limit [rad] in (0, pi/2). Between hits the energy is kept, so every flight
    starts with e times the speed of the last; flights tend to 2 w / (k cos(limit)), a geometric series.
    """
    k = GRAVITY / length
    rate = math.sqrt(2.0 * k * math.sin(limit))
    first, speed, t, flight = 0.5 * _flight(limit, rate, k), rate, 0.0, math.inf
    while restitution > 0.0 and rate > 1e-7 * speed:  # its square, 1e-14, is what the series then leaves out
        rate *= restitution
        flight = _flight(limit, rate, k)
        t += flight
    rest = flight * restitution / (1.0 - restitution) if restitution > 0.0 else 0.0
    return first, speed, first + t + rest


def _flight(limit: float, rate: float, k: float) -> float:
    """Time [s] until the pendulum thrown up from its limit with `rate` is back."""
    fall = 0.5 * rate**2 / k  # sin(limit) - sin(top); top = limit - x_end^2
    depth = brentq(lambda d: _rise(limit, d) - fall, 0.0, limit + 1e-9, xtol=1e-300, rtol=1e-15)

    # the time from the top down, angle = top + depth s^2, without the singularity at rest
    def integrand(s):
        top = limit - depth
        if s == 0.0:
            return 2.0 * math.sqrt(depth) / math.sqrt(2.0 * k * math.cos(top))
        return 2.0 * depth * s / math.sqrt(2.0 * k * _rise(top + depth * s * s, depth * s * s))

    return 2.0 * quad(integrand, 0.0, 1.0, epsabs=0.0, epsrel=1e-12)[0]


def _rise(angle: float, d: float) -> float:
    """sin(angle) - sin(angle - d) without cancellation."""
    return 2.0 * math.cos(angle - 0.5 * d) * math.sin(0.5 * d)


# --- plastic impacts ------------------------------------------------------------------------------------------------
def carnot(mass: np.ndarray, w: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, float]:
    """(v+, loss [J]) of the plastic impact that makes all rows of w v vanish: loss = gamma^T G_c^-1 gamma / 2."""
    response = np.linalg.solve(mass, w.T)
    gamma = w @ v
    lam = -np.linalg.lstsq(w @ response, gamma, rcond=1e-12)[0]
    return v + response @ lam, float(-0.5 * gamma @ lam)
