"""Friction of one joint in closed form: |force| <= f at rest, -f sign(v) in motion.

In each stretch without a turn the friction is constant, so the motion is that of a shifted spring or a constant force.
The motion is a list of such stretches; a joint at rest sticks where the other forces are within f.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.optimize import brentq

GRAVITY = 9.81


@dataclass(frozen=True)
class SpringMass:
    """m x'' = -k x - f sign(x'), from (x0, v0); also a hinge with inertia m and torques.

    Moving in the direction s, the centre is c = -s f/k and x - c = A cos(w t - d). Half a period on, the mirrored
    point: |x| falls by 2 f/k at each turn, 4 f/k in a full cycle, until |x| <= f/k at a turn, where it sticks.
    """

    mass: float
    stiffness: float
    friction: float
    x0: float
    v0: float = 0.0

    def omega(self) -> float:
        return math.sqrt(self.stiffness / self.mass)

    def turns(self) -> list[tuple[float, float]]:
        """(time, place) of every rest: the turns, then the place of the stick. From rest the start is the first."""
        w, dead = self.omega(), self.friction / self.stiffness
        t, x = 0.0, self.x0
        found = [(t, x)] if self.v0 == 0.0 else []
        if self.v0 != 0.0:
            s = math.copysign(1.0, self.v0)
            amplitude = math.hypot(x + s * dead, self.v0 / w)
            # x + s dead = s A sin(phase) runs up to s A at phase pi/2
            phase = math.atan2(s * (x + s * dead), abs(self.v0) / w)
            t, x = (0.5 * math.pi - phase) / w, s * (amplitude - dead)
            found.append((t, x))
        while abs(x) > dead:
            t, x = t + math.pi / w, math.copysign(2.0 * dead, x) - x
            found.append((t, x))
        return found

    def stick(self) -> tuple[float, float]:
        """(time, place) from where on it rests."""
        return self.turns()[-1]

    def state(self, t: float) -> tuple[float, float]:
        """(x, x') at time t."""
        w, dead, turns = self.omega(), self.friction / self.stiffness, self.turns()
        if t >= turns[-1][0]:
            return turns[-1][1], 0.0
        before = [(time, x) for time, x in turns if time <= t]
        if before:  # from a turn, towards the middle
            start, x = before[-1]
            centre = math.copysign(dead, x)
            amplitude, phase = x - centre, w * (t - start)
        else:  # before the first turn: backwards from it
            start, x = turns[0]
            centre = -math.copysign(dead, self.v0)
            amplitude, phase = x - centre, w * (t - start)
        return centre + amplitude * math.cos(phase), -amplitude * w * math.sin(phase)

    def energy(self, x: float, v: float) -> float:
        return 0.5 * self.mass * v * v + 0.5 * self.stiffness * x * x

    def dissipated(self) -> float:
        """f times the way until the stick [J], equal to the loss of energy."""
        places = [self.x0, *(x for _, x in self.turns())]
        return self.friction * sum(abs(b - a) for a, b in zip(places[:-1], places[1:], strict=True))


@dataclass(frozen=True)
class Slide:
    """m x'' = push - friction sign(x'), constant push [N], from x = 0 with the speed v0; also a hinge.

    While moving in the direction s the acceleration is (push - s friction)/m; it stops after |v0| / |..| where that is
    against the motion, and stays where |push| <= friction, else goes back with (push +- friction)/m.
    """

    mass: float
    friction: float
    v0: float
    push: float = 0.0

    def stop(self) -> tuple[float, float] | None:
        """(time, place) of the first rest; None where it never comes to one."""
        s = math.copysign(1.0, self.v0) if self.v0 != 0.0 else 0.0
        a = (self.push - s * self.friction) / self.mass
        if s == 0.0:
            return 0.0, 0.0
        return None if s * a >= 0.0 else (-self.v0 / a, -0.5 * self.v0**2 / a)

    def sticks(self) -> bool:
        """It stays where it has come to rest."""
        return abs(self.push) <= self.friction

    def state(self, t: float) -> tuple[float, float]:
        """(x, x') at time t."""
        s, rest = math.copysign(1.0, self.v0), self.stop()
        if rest is None or t < rest[0]:
            a = (self.push - s * self.friction) / self.mass
            return self.v0 * t + 0.5 * a * t * t, self.v0 + a * t
        excess = math.copysign(max(abs(self.push) - self.friction, 0.0), self.push) / self.mass
        return rest[1] + 0.5 * excess * (t - rest[0]) ** 2, excess * (t - rest[0])


def block_on_slope(v0: float, mu: float, slope: float = 0.0, mass: float = 1.0, gravity: float = GRAVITY) -> Slide:
    """Block sent up a slope [rad] at v0: friction mu m g cos, push -m g sin; level: stops at v0/(mu g)."""
    weight = mass * gravity
    return Slide(mass, mu * weight * math.cos(slope), v0, -weight * math.sin(slope))


def pendulum_turns(theta0: float, weight: float, friction: float) -> list[float]:
    """Angles of rest of a hinge with the torques -weight sin(theta) and joint friction, released at theta0, |.| < pi.

    From turn to turn weight (cos b - cos a) = friction |b - a|: a root beyond the bottom. The last one sticks:
    weight |sin theta| <= friction.
    """
    turns = [theta0]
    while weight * abs(math.sin(turns[-1])) > friction:
        a = turns[-1]
        side = math.copysign(1.0, a)

        def gain(b: float, a: float = a, side: float = side) -> float:
            """Kinetic energy at side * b, b < |a|."""
            return weight * (math.cos(b) - math.cos(a)) - friction * (abs(a) - b)

        fastest = math.asin(friction / weight)  # kinetic energy grows from |a| down to here, then falls
        turns.append(side * float(brentq(gain, -abs(a), fastest, xtol=1e-15, rtol=1e-15)))
    return turns
