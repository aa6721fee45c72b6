"""Closed loops with known answers: four-bar linkage, slider-crank, nut on a screw. Planar angles from the x axis."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

GRAVITY = 9.81


@dataclass(frozen=True)
class FourBar:
    """Ground pivots A = (0, 0) and D = (ground, 0); crank A-B, coupler B-C, rocker D-C [m].

    Loop: crank e(q) + coupler e(c) = ground e(0) + rocker e(r), e(x) = (cos x, sin x). C lies on two circles, about B
    and about D; branch +1 takes the one on the left of the way from B to D, -1 the other. All angles are absolute
    [rad].
    """

    ground: float
    crank: float
    coupler: float
    rocker: float
    branch: int = 1

    def grashof(self) -> float:
        """longest + shortest - the other two [m]: negative where the shortest link turns fully against the others.

        That link is the crank of a crank-rocker where it is `crank`; 0: change points (a parallelogram).
        """
        links = sorted((self.ground, self.crank, self.coupler, self.rocker))
        return links[0] + links[3] - links[1] - links[2]

    def angles(self, q: float) -> tuple[float, float]:
        """(coupler, rocker) at the crank angle q, each in (-pi, pi].

        With d = |D - B|: the angle at B between the coupler and the way to D has the cosine
        (d^2 + coupler^2 - rocker^2) / (2 d coupler).
        """
        b = self.crank * np.array([math.cos(q), math.sin(q)])
        way = np.array([self.ground, 0.0]) - b
        d = math.hypot(*way)
        cosine = (d * d + self.coupler**2 - self.rocker**2) / (2.0 * d * self.coupler)
        c = math.atan2(way[1], way[0]) + self.branch * math.acos(cosine)
        tip = b + self.coupler * np.array([math.cos(c), math.sin(c)]) - np.array([self.ground, 0.0])
        return math.atan2(math.sin(c), math.cos(c)), math.atan2(tip[1], tip[0])

    def rates(self, q: float, w: float) -> tuple[float, float]:
        """(coupler, rocker) velocities [rad/s]: the loop's derivative across the rocker and across the coupler.

        crank w e'(q) + coupler c' e'(c) = rocker r' e'(r), times e(r) and times e(c).
        """
        c, r = self.angles(q)
        return (
            -self.crank * w * math.sin(q - r) / (self.coupler * math.sin(c - r)),
            self.crank * w * math.sin(q - c) / (self.rocker * math.sin(r - c)),
        )

    def accelerations(self, q: float, w: float, a: float = 0.0) -> tuple[float, float]:
        """(coupler, rocker) accelerations [rad/s^2]: the same with the centripetal parts -w^2 e."""
        (c, r), (wc, wr) = self.angles(q), self.rates(q, w)

        def along(x: float) -> float:
            """The known terms times e(x)."""
            known = self.crank * (a * math.sin(x - q) - w * w * math.cos(q - x))
            return known - self.coupler * wc * wc * math.cos(c - x) + self.rocker * wr * wr * math.cos(r - x)

        return along(r) / (self.coupler * math.sin(c - r)), -along(c) / (self.rocker * math.sin(r - c))


@dataclass(frozen=True)
class SliderCrank:
    """Crank of length r at the origin, rod of length l, pin of the slider on the line y = offset [m], x > 0 side.

    sin(rod) = (offset - r sin q) / l, x = r cos q + l cos(rod); q: crank, rod: absolute angle of the rod from the pin
    of the crank to the slider.
    """

    crank: float
    rod: float
    offset: float = 0.0

    def rod_angle(self, q: float) -> tuple[float, float, float]:
        """(rod, d rod/dq, d^2 rod/dq^2): cos(rod) rod' = -r cos q / l, and again."""
        sine = (self.offset - self.crank * math.sin(q)) / self.rod
        cosine = math.sqrt(1.0 - sine * sine)
        first = -self.crank * math.cos(q) / (self.rod * cosine)
        second = (self.crank * math.sin(q) / self.rod + sine * first * first) / cosine
        return math.asin(sine), first, second

    def slider(self, q: float) -> tuple[float, float, float]:
        """(x, dx/dq, d^2x/dq^2) [m]: at a crank speed w the velocity is w x', the acceleration w^2 x'' + w' x'."""
        return self._along_rod(q, self.rod)[0]

    def _along_rod(self, q: float, s: float) -> np.ndarray:
        """x and y of the rod's point at s from the crank pin, each with two derivatives by q, (2, 3)."""
        b, b1, b2 = self.rod_angle(q)
        r, (c, d), (cb, sb) = self.crank, (math.cos(q), math.sin(q)), (math.cos(b), math.sin(b))
        x = [r * c + s * cb, -r * d - s * sb * b1, -r * c - s * (cb * b1 * b1 + sb * b2)]
        y = [r * d + s * sb, r * c + s * cb * b1, -r * d + s * (cb * b2 - sb * b1 * b1)]
        return np.array([x, y])

    def inertia(self, q: float, masses: MassesOfSliderCrank) -> tuple[float, float]:
        """(I, dI/dq) [kg m^2]: kinetic energy I(q) w^2 / 2, I = sum m |dx/dq|^2 + J (d angle/dq)^2."""
        _, b1, b2 = self.rod_angle(q)
        value, slope = masses.crank_inertia + masses.rod_inertia * b1 * b1, 2.0 * masses.rod_inertia * b1 * b2
        for m, s in ((masses.rod, masses.rod_centre), (masses.slider, self.rod)):
            p = self._along_rod(q, s)
            value += m * float(p[:, 1] @ p[:, 1])
            slope += 2.0 * m * float(p[:, 1] @ p[:, 2])
        return value, slope

    def torque(self, q: float, w: float, masses: MassesOfSliderCrank, gravity: float = 0.0, a: float = 0.0) -> float:
        """Torque on the crank [N m] for the speed w and the acceleration a: d/dt (I w) - I' w^2 / 2 + dV/dq.

        At constant speed I' w^2 / 2 + dV/dq; gravity along -y, the slider's weight does no work.
        """
        inertia, slope = self.inertia(q, masses)
        weight = masses.crank_moment * math.cos(q) + masses.rod * self._along_rod(q, masses.rod_centre)[1, 1]
        return inertia * a + 0.5 * slope * w * w + gravity * weight


@dataclass(frozen=True)
class MassesOfSliderCrank:
    """crank_inertia about its pivot, crank_moment = mass times distance of the centre from the pivot [kg m].

    rod_inertia about the rod's centre, which lies rod_centre [m] from the crank pin.
    """

    crank_inertia: float
    crank_moment: float
    rod: float
    rod_centre: float
    rod_inertia: float
    slider: float


@dataclass(frozen=True)
class ScrewNut:
    """Nut of mass m and inertia I about its axis on a fixed vertical screw, z = pitch q, pitch in m/rad, no friction.

    L = (m pitch^2 + I) q'^2 / 2 - m g pitch q, so q'' = -m g pitch / (m pitch^2 + I) and z'' = pitch q''. The thread
    bears N = m (g + z'') = m g I / (m pitch^2 + I) along z and the torque I q'' about it.
    """

    mass: float
    inertia: float
    pitch: float
    gravity: float = GRAVITY

    def acceleration(self) -> tuple[float, float]:
        """(z'' [m/s^2], q'' [rad/s^2])."""
        turn = -self.mass * self.gravity * self.pitch / (self.mass * self.pitch**2 + self.inertia)
        return self.pitch * turn, turn

    def bearing(self) -> tuple[float, float]:
        """(axial force [N], torque [N m]) of the thread on the nut; the torque is -pitch times the force."""
        return self.mass * (self.gravity + self.acceleration()[0]), self.inertia * self.acceleration()[1]

    def motion(self, t: float, z0: float = 0.0, speed: float = 0.0) -> tuple[float, float]:
        """(z, z') at time t."""
        a = self.acceleration()[0]
        return z0 + speed * t + 0.5 * a * t * t, speed + a * t

    def energy(self, z: float, speed: float) -> float:
        """Kinetic and potential, 0 at z = 0."""
        return 0.5 * (self.mass + self.inertia / self.pitch**2) * speed**2 + self.mass * self.gravity * z
