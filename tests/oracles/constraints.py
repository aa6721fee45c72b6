"""Two-sided constraints phi(q, t) = 0 of a Pinocchio model, with their first and second derivatives in time.

Every constraint is one formula in jets. A jet carries a quantity along the motion q(t):
  value, jac (k, nv), rate = jac v + d/dt, bias = (second derivative in time) - jac a.
The points and axes of bodies come from Pinocchio's joint Jacobians and classical accelerations; sums, products, lengths
and angles follow by the rules of calculus. There are no differences, so the derivatives are good to rounding; the tests
compare them with central differences. Coordinates and velocities are Pinocchio's (a free-flyer has its body twist).

Multipliers enter as M a + nle = tau + J^T lam: lam is a force on the second body [N], or a torque on it [N m].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

PrescribedMotion = Callable[[float], tuple[float, float, float]]  # r, r', r'' at time t [s]
Place = tuple[int, Sequence[float]]  # joint (0: the world) and a point in its frame [m]


def constant(value: float) -> PrescribedMotion:
    return lambda _t: (value, 0.0, 0.0)


def ramp(start: float, speed: float) -> PrescribedMotion:
    return lambda t: (start + speed * t, speed, 0.0)


def sine(amplitude: float, omega: float, offset: float = 0.0) -> PrescribedMotion:
    """offset + amplitude sin(omega t)."""
    return lambda t: (
        offset + amplitude * math.sin(omega * t),
        amplitude * omega * math.cos(omega * t),
        -amplitude * omega**2 * math.sin(omega * t),
    )


@dataclass(frozen=True)
class Jet:
    """value, rate, bias (k,), jac (k, nv) as above; k = 3 for vectors, k = 1 for numbers."""

    value: np.ndarray
    jac: np.ndarray
    rate: np.ndarray
    bias: np.ndarray

    def __add__(self, other: Jet) -> Jet:
        return Jet(self.value + other.value, self.jac + other.jac, self.rate + other.rate, self.bias + other.bias)

    def __sub__(self, other: Jet) -> Jet:
        return self + other.times(-1.0)

    def times(self, number: float) -> Jet:
        return Jet(number * self.value, number * self.jac, number * self.rate, number * self.bias)

    def dot(self, other: Jet) -> Jet:
        """(a . b)'' = a'' . b + 2 a' . b' + a . b''; also the product of two numbers."""
        return Jet(
            np.array([self.value @ other.value]),
            (self.value @ other.jac + other.value @ self.jac)[None, :],
            np.array([self.value @ other.rate + self.rate @ other.value]),
            np.array([self.value @ other.bias + 2.0 * self.rate @ other.rate + self.bias @ other.value]),
        )

    def cross(self, other: Jet) -> Jet:
        return Jet(
            np.cross(self.value, other.value),
            pin.skew(self.value) @ other.jac - pin.skew(other.value) @ self.jac,
            np.cross(self.value, other.rate) + np.cross(self.rate, other.value),
            np.cross(self.value, other.bias) + 2.0 * np.cross(self.rate, other.rate) + np.cross(self.bias, other.value),
        )

    def function(self, f: float, f1: float, f2: float) -> Jet:
        """f(x) of a number x, from f and its two derivatives at the value."""
        return Jet(np.array([f]), f1 * self.jac, f1 * self.rate, f1 * self.bias + f2 * self.rate**2)

    def norm(self) -> Jet:
        s = float(self.value @ self.value)
        return self.dot(self).function(math.sqrt(s), 0.5 / math.sqrt(s), -0.25 / s**1.5)


def stack(*jets: Jet) -> Jet:
    """Jets below one another."""
    return Jet(*(np.concatenate([getattr(j, name) for j in jets]) for name in ("value", "jac", "rate", "bias")))


def angle(c: Jet, s: Jet) -> Jet:
    """atan2(s, c): x' = (c s' - s c') / r^2 and its derivative, r^2 = c^2 + s^2."""
    (cv, cr, cb), (sv, sr, sb) = ((float(j.value[0]), float(j.rate[0]), float(j.bias[0])) for j in (c, s))
    r2, turn = cv**2 + sv**2, cv * sr - sv * cr
    bias = (cv * sb - sv * cb) / r2 - turn * 2.0 * (cv * cr + sv * sr) / r2**2
    jac = (cv * s.jac - sv * c.jac) / r2
    return Jet(np.array([math.atan2(sv, cv)]), jac, np.array([turn / r2]), np.array([bias]))


class Motion:
    """The jets of a model at (q, v)."""

    def __init__(self, model: pin.Model, q: np.ndarray, v: np.ndarray | None = None):
        self.model, self.data, self.q = model, model.createData(), q
        self.v = np.zeros(model.nv) if v is None else v
        pin.computeJointJacobians(model, self.data, q)
        pin.forwardKinematics(model, self.data, q, self.v, np.zeros(model.nv))

    def _spin(self, joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(J_w, w, w' at a = 0) of a body, world axes."""
        jac = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)[3:]
        acceleration = pin.getClassicalAcceleration(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)
        return jac, jac @ self.v, acceleration.angular

    def axis(self, joint: int, direction: Sequence[float]) -> Jet:
        """A vector fixed in a body, world axes: u' = w x u, u'' = w' x u + w x (w x u)."""
        u = np.array(direction, float)
        if joint == 0:
            return Jet(u, np.zeros((3, self.model.nv)), np.zeros(3), np.zeros(3))
        u = self.data.oMi[joint].rotation @ u
        jac, w, w1 = self._spin(joint)
        rate = np.cross(w, u)
        return Jet(u, -pin.skew(u) @ jac, rate, np.cross(w1, u) + np.cross(w, rate))

    def point(self, place: Place) -> Jet:
        """A point fixed in a body, world frame."""
        joint, position = place
        arm = self.axis(joint, position)
        if joint == 0:
            return arm
        jac = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)[:3]
        bias = pin.getClassicalAcceleration(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED).linear
        return Jet(self.data.oMi[joint].translation, jac, jac @ self.v, bias) + arm

    def length(self, places: Sequence[Place]) -> Jet:
        """Length of the straight pieces from point to point."""
        points = [self.point(p) for p in places]
        total = self.time((0.0, 0.0, 0.0))
        for a, b in zip(points[:-1], points[1:], strict=True):
            total = total + (b - a).norm()
        return total

    def joint(self, joint: int) -> Jet:
        """Coordinate of a joint with one degree of freedom; an unbounded revolute gives its angle in (-pi, pi]."""
        j = self.model.joints[joint]
        if j.nv != 1:
            raise ValueError(f"joint {joint} has {j.nv} degrees of freedom, expected 1")
        x = self.q[j.idx_q] if j.nq == 1 else math.atan2(self.q[j.idx_q + 1], self.q[j.idx_q])
        jac = np.zeros((1, self.model.nv))
        jac[0, j.idx_v] = 1.0
        return Jet(np.array([x]), jac, self.v[j.idx_v : j.idx_v + 1].copy(), np.zeros(1))

    def time(self, prescribed: tuple[float, float, float]) -> Jet:
        """A number given in time by r, r', r''."""
        r, r1, r2 = prescribed
        return Jet(np.array([r]), np.zeros((1, self.model.nv)), np.array([r1]), np.array([r2]))


class Constraint:
    """phi(q, t) = 0. A child gives `jet`; the methods here are its parts."""

    def jet(self, motion: Motion, t: float) -> Jet:
        raise NotImplementedError

    def residual(self, model: pin.Model, q: np.ndarray, t: float = 0.0) -> np.ndarray:
        return self.jet(Motion(model, q), t).value

    def jacobian(self, model: pin.Model, q: np.ndarray, t: float = 0.0) -> np.ndarray:
        return self.jet(Motion(model, q), t).jac

    def bias(self, model: pin.Model, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> np.ndarray:
        """gamma of phi'' = J a + gamma: Jdot v and all that comes from the explicit time."""
        return self.jet(Motion(model, q, v), t).bias


@dataclass(frozen=True)
class Point(Constraint):
    """x_b - x_a = 0 [m], world axes: lam is the force on b."""

    a: Place
    b: Place

    def jet(self, motion: Motion, t: float) -> Jet:
        return motion.point(self.b) - motion.point(self.a)


@dataclass(frozen=True)
class Tape(Constraint):
    """Length along the points = length(t) [m]: -lam is the tension [N]. Two points: a rod between them."""

    places: Sequence[Place]
    length: PrescribedMotion

    def jet(self, motion: Motion, t: float) -> Jet:
        return motion.length(self.places) - motion.time(self.length(t))


def distance(a: Place, b: Place, length: float | PrescribedMotion) -> Tape:
    """|x_b - x_a| = length, a number [m] or a function of time."""
    return Tape((a, b), length if callable(length) else constant(length))


@dataclass(frozen=True)
class Weld(Constraint):
    """Frames X_a on body a and X_b on body b coincide: 3 rows of position [m], 3 of turn, world axes.

    Turn: sum_k a_k x b_k / 2 = sin(angle) axis of the rotation from a to b, a_k and b_k the axes of the frames. At
    phi = 0 its derivative is w_b - w_a, so lam is the force and the torque on b at the frame's origin.
    """

    a: int
    X_a: pin.SE3
    b: int
    X_b: pin.SE3

    def jet(self, motion: Motion, t: float) -> Jet:
        move = motion.point((self.b, self.X_b.translation)) - motion.point((self.a, self.X_a.translation))
        a, b = axes(motion, self.a, self.X_a), axes(motion, self.b, self.X_b)
        turn = a[0].cross(b[0]) + a[1].cross(b[1]) + a[2].cross(b[2])
        return stack(move, turn.times(0.5))


@dataclass(frozen=True)
class Screw(Constraint):
    """The z axes of two frames coincide, and b advances by pitch [m/rad] times its turn about z.

    Rows: d . x_a, d . y_a [m], z_b . x_a, z_b . y_a, d . z_a - pitch (angle of x_b about z_a) - offset [m], with
    d = x_b - x_a. The angle is taken on the turn that makes the last row smallest, so the thread may turn many times;
    the last multiplier is the axial force on b [N].
    """

    a: int
    X_a: pin.SE3
    b: int
    X_b: pin.SE3
    pitch: float
    offset: float = 0.0

    def jet(self, motion: Motion, t: float) -> Jet:
        d = motion.point((self.b, self.X_b.translation)) - motion.point((self.a, self.X_a.translation))
        a, b = axes(motion, self.a, self.X_a), axes(motion, self.b, self.X_b)
        turn = angle(a[0].dot(b[0]), a[1].dot(b[0]))
        advance = d.dot(a[2]) - turn.times(self.pitch) - motion.time((self.offset, 0.0, 0.0))
        lead = 2.0 * math.pi * self.pitch
        if lead != 0.0:
            advance = advance - motion.time((lead * round(float(advance.value[0]) / lead), 0.0, 0.0))
        return stack(d.dot(a[0]), d.dot(a[1]), b[2].dot(a[0]), b[2].dot(a[1]), advance)


@dataclass(frozen=True)
class JointPolynomial(Constraint):
    """y - sum_k c_k x^k = 0 for the coordinates of two joints of one degree of freedom (nq = 1): lam acts on y."""

    y: int
    x: int
    coefficients: Sequence[float]

    def jet(self, motion: Motion, t: float) -> Jet:
        if motion.model.nqs[self.x] != 1 or motion.model.nqs[self.y] != 1:
            raise ValueError("the joints of a polynomial have one number each, expected nq = 1")
        x = motion.joint(self.x)
        f = np.polynomial.Polynomial(self.coefficients)
        at = float(x.value[0])
        return motion.joint(self.y) - x.function(f(at), f.deriv(1)(at), f.deriv(2)(at))


@dataclass(frozen=True)
class Prescribed(Constraint):
    """Coordinate of a joint of one degree of freedom = r(t): lam is the force or torque that prescribes it."""

    joint: int
    path: PrescribedMotion

    def jet(self, motion: Motion, t: float) -> Jet:
        phi = motion.joint(self.joint) - motion.time(self.path(t))
        if motion.model.nqs[self.joint] == 2:  # an angle known up to whole turns
            turns = round(float(phi.value[0]) / (2.0 * math.pi))
            phi = phi - motion.time((2.0 * math.pi * turns, 0.0, 0.0))
        return phi


def axes(motion: Motion, joint: int, frame: pin.SE3) -> list[Jet]:
    """The three axes of a frame on a body."""
    return [motion.axis(joint, frame.rotation[:, k]) for k in range(3)]
