"""Laws of one frictional impact on a Delassus matrix: Poisson in two phases, Newton, and the incremental laws.

One contact with velocity gamma = (normal, tangent 1, tangent 2), normal > 0 leaves. Its impulse Lam changes it by
gamma+ = gamma- + G Lam, G (3, 3) symmetric and positive definite, in the same order of rows. Friction is Coulomb's
with coefficient mu. The laws:

newton           0 <= Lam_n, gamma_n+ >= -e gamma_n-, complementary; Coulomb between Lam and the slip after the impact
                 (Moreau 1988). One complementarity problem, at times with more energy after than before.
poisson          Compression: the same with e = 0, Lam1. Expansion from there: Lam2_n >= e Lam1_n, gamma_n+ >= 0,
                 complementary, and Coulomb between Lam2 and the slip after it (Glocker, Pfeiffer 1995, without
                 restitution of the tangential impulse).
incremental      d gamma / d Lam_n = G (1, -mu s / |s|) while the contact slips with s (Routh 1860; Keller 1986). A slip
                 that comes to zero sticks if friction can hold it, |G_tt^-1 G_tn| <= mu, else it starts again in the
                 one direction in which slip can grow (Batlle 1996). Compression ends when gamma_n = 0, at Lam_c, W_c.
                 The end of the impact: "poisson" Lam_n = (1 + e) Lam_c; "newton" gamma_n = -e gamma_n-; "energetic"
                 W_n = (1 - e^2) W_c with W_n the work of the normal impulse (Stronge 1990).

While it slips, d Lam_n = |s| d tau makes the angle of slip an equation of its own, and the logarithm of the slip speed
a smooth function: the singularity at the end of slip goes to infinity, where nothing is lost by ending at 1e-16.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq

from .event_ode import leg

LOG_STOP = -37.0  # of slip speed over its start: 1e-16


@dataclass(frozen=True)
class Impact:
    """gamma+ (3,), total impulse (3,), what ends compression, and the phases (name, Lam_n at its end, gamma then)."""

    gamma: np.ndarray
    impulse: np.ndarray
    compression: float  # normal impulse until gamma_n = 0
    phases: list[tuple[str, float, np.ndarray]] = field(default_factory=list)


def kinetic_change(g: np.ndarray, gamma: np.ndarray, impulse: np.ndarray) -> float:
    """Change of kinetic energy by an impulse: Lam . (gamma- + gamma+) / 2."""
    return float(impulse @ (gamma + 0.5 * g @ impulse))


def friction_impulse(g_tt: np.ndarray, slip: np.ndarray, bound: float) -> np.ndarray:
    """Tangential impulse with |p| <= bound that opposes the slip after it, slip + G_tt p: stick if it can.

    Slip: slip + G_tt p = -x p with x > 0 and |p| = bound, where |p| falls with x: one root.
    """
    if bound <= 0.0:
        return np.zeros(2)
    stick = -np.linalg.solve(g_tt, slip)
    if np.linalg.norm(stick) <= bound:
        return stick
    values, basis = np.linalg.eigh(g_tt)
    part = basis.T @ slip

    def excess(x: float) -> float:
        return 1.0 / math.hypot(*(part / (values + x))) - 1.0 / bound

    top = np.linalg.norm(slip) / bound
    return -basis @ (part / (values + brentq(excess, 0.0, top, xtol=1e-300, rtol=1e-15)))


def _impulses(g: np.ndarray, gamma: np.ndarray, mu: float, target: float) -> list[np.ndarray]:
    """All Lam with Lam_n > 0, gamma_n+ = target, and Coulomb's law with the slip after the impact, by increasing Lam_n.

    For a given Lam_n the friction is unique; gamma_n+ as a function of Lam_n is continuous, and scanned for its roots.
    """

    def impulse(normal: float) -> np.ndarray:
        slip = gamma[1:] + g[1:, 0] * normal
        return np.concatenate([[normal], friction_impulse(g[1:, 1:], slip, mu * normal)])

    def miss(normal: float) -> float:
        return float(gamma[0] + g[0] @ impulse(normal) - target)

    scale = (target - gamma[0]) / g[0, 0]
    grid = scale * np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 40)[:-1], np.geomspace(1.0, 1e3, 80)])
    values = [miss(x) for x in grid]
    roots = [
        brentq(miss, a, b, xtol=1e-300, rtol=8.9e-16)
        for a, b, fa, fb in zip(grid[:-1], grid[1:], values[:-1], values[1:], strict=True)
        if fa * fb < 0.0 or (fb == 0.0 and fa != 0.0)
    ]
    return [impulse(x) for x in roots]


def newton(g: np.ndarray, gamma: np.ndarray, mu: float, e: float) -> Impact:
    """Newton's law with Coulomb friction on the slip after the impact. More than one answer: the smallest impulse."""
    g, gamma = np.asarray(g, float), np.asarray(gamma, float)
    if gamma[0] >= 0.0:
        return Impact(gamma.copy(), np.zeros(3), 0.0)
    impulse = _impulses(g, gamma, mu, -e * gamma[0])[0]
    return Impact(gamma + g @ impulse, impulse, float(_impulses(g, gamma, mu, 0.0)[0][0]))


def newton_answers(g: np.ndarray, gamma: np.ndarray, mu: float, e: float) -> list[np.ndarray]:
    """All impulses that Newton's law admits; several only where the normal and tangential rows couple strongly."""
    g, gamma = np.asarray(g, float), np.asarray(gamma, float)
    return _impulses(g, gamma, mu, -e * gamma[0])


def poisson(g: np.ndarray, gamma: np.ndarray, mu: float, e: float) -> Impact:
    """Poisson's law in two phases, each a complementarity problem."""
    g, gamma = np.asarray(g, float), np.asarray(gamma, float)
    if gamma[0] >= 0.0:
        return Impact(gamma.copy(), np.zeros(3), 0.0)
    first = _impulses(g, gamma, mu, 0.0)[0]
    middle = gamma + g @ first
    normal = e * first[0]
    slip = middle[1:] + g[1:, 0] * normal
    second = np.concatenate([[normal], friction_impulse(g[1:, 1:], slip, mu * normal)])
    if middle[0] + g[0] @ second < -1e-15 * abs(gamma[0]):  # the stored impulse does not separate: more than it
        second = _expansion(g, middle, mu, normal)
    phases = [("compression", first[0], middle), ("expansion", first[0] + second[0], middle + g @ second)]
    return Impact(middle + g @ second, first + second, float(first[0]), phases)


def _expansion(g: np.ndarray, middle: np.ndarray, mu: float, least: float) -> np.ndarray:
    """Expansion impulse above the stored one with gamma_n+ = 0."""

    def impulse(normal: float) -> np.ndarray:
        slip = middle[1:] + g[1:, 0] * normal
        return np.concatenate([[normal], friction_impulse(g[1:, 1:], slip, mu * normal)])

    top = 2.0 * least
    while middle[0] + g[0] @ impulse(top) < 0.0:
        top *= 2.0
    return impulse(brentq(lambda x: float(middle[0] + g[0] @ impulse(x)), least, top, xtol=1e-300, rtol=1e-15))


# --- incremental laws -----------------------------------------------------------------------------------------------
def slip_direction(g: np.ndarray, mu: float) -> float | None:
    """Angle in which slip starts from zero, or None where it sticks: t.(G_tn - mu G_tt r) = 0 and r.( .. ) > 0."""
    g = np.asarray(g, float)
    if np.linalg.norm(np.linalg.solve(g[1:, 1:], g[1:, 0])) <= mu:
        return None

    def rates(angle: float) -> tuple[float, float]:
        r, t = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
        push = g[1:, 0] - mu * g[1:, 1:] @ r
        return float(t @ push), float(r @ push)

    grid = np.linspace(0.0, 2.0 * math.pi, 3001) + 0.1234567  # no root at a point of the grid by symmetry
    found = []
    for a, b in zip(grid[:-1], grid[1:], strict=True):
        if rates(a)[0] * rates(b)[0] < 0.0:
            root = brentq(lambda x: rates(x)[0], a, b, xtol=1e-15)
            if rates(root)[1] > 0.0:
                found.append(root)
    if len(found) != 1:
        raise ArithmeticError(f"{len(found)} directions of slip")
    return found[0]


class _Run:
    """The impulse process: state (Lam_n, Lam_t1, Lam_t2, W_n), from which gamma follows."""

    def __init__(self, g: np.ndarray, gamma: np.ndarray, mu: float, e: float, law: str):
        self.g, self.start, self.mu, self.e, self.law = g, gamma, mu, e, law
        self.lam, self.work = np.zeros(3), 0.0
        self.compressed: tuple[float, float] | None = None  # Lam_c, W_c
        self.phases: list[tuple[str, float, np.ndarray]] = []

    def gamma(self, lam: np.ndarray | None = None) -> np.ndarray:
        return self.start + self.g @ (self.lam if lam is None else lam)

    def end(self) -> Callable[[np.ndarray, float], float]:
        """Function of (Lam, W_n) that rises through zero at the end of the phase: of compression, or of the impact."""
        if self.compressed is None:
            return lambda lam, work: float(self.start[0] + self.g[0] @ lam)
        lam_c, work_c = self.compressed
        if self.law == "poisson":
            return lambda lam, work: lam[0] / ((1.0 + self.e) * lam_c) - 1.0
        if self.law == "newton":
            return lambda lam, work: float(self.start[0] + self.g[0] @ lam) / -self.start[0] - self.e
        if self.law == "energetic":
            return lambda lam, work: (1.0 - self.e**2) - work / work_c
        raise ValueError(f"no law {self.law}")

    def note(self, name: str) -> None:
        self.phases.append((name, float(self.lam[0]), self.gamma()))

    def straight(self, direction: np.ndarray, name: str) -> None:
        """Stick, or slip in one direction, up to the end of the phase: Lam grows along `direction` (1, ., .)."""
        a, b = self.gamma()[0], float(self.g[0] @ direction)
        lam, work, end = self.lam.copy(), self.work, self.end()
        if b <= 0.0:
            raise ArithmeticError("a straight phase that does not separate")

        def at(x: float) -> tuple[np.ndarray, float]:
            return lam + x * direction, work + a * x + 0.5 * b * x * x

        if self.compressed is None:
            x = -a / b
        elif self.law == "poisson":
            x = (1.0 + self.e) * self.compressed[0] - lam[0]
        elif self.law == "newton":
            x = (-self.e * self.start[0] - a) / b
        else:  # work + a x + b x^2 / 2 = (1 - e^2) W_c
            rest = (1.0 - self.e**2) * self.compressed[1] - work
            x = (-a + math.sqrt(a * a + 2.0 * b * rest)) / b
        self.lam, self.work = at(x)
        assert abs(end(self.lam, self.work)) <= 1e-9
        self.note(name)

    def slide(self) -> bool:
        """Slip with turning direction up to the end of the phase (True) or until it comes to zero (False)."""
        slip = self.gamma()[1:]
        size, end = float(np.linalg.norm(slip)), self.end()

        def rhs(tau: float, y: np.ndarray) -> np.ndarray:
            angle, log, lam = y[0], y[1], y[2:5]
            r, t = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
            push = self.g[1:, 0] - self.mu * self.g[1:, 1:] @ r
            speed = size * math.exp(log)
            step = speed * np.array([1.0, -self.mu * r[0], -self.mu * r[1]])
            return np.array([t @ push, r @ push, *step, self.gamma(lam)[0] * speed])

        y0 = np.array([math.atan2(slip[1], slip[0]), 0.0, *self.lam, self.work])
        events = [(lambda tau, y: end(y[2:5], y[5]), 1), (lambda tau, y: y[1] - LOG_STOP, -1)]
        done = leg(rhs, 0.0, y0, 1e6, events)
        if done.event is None:
            raise ArithmeticError("an endless impact")
        self.lam, self.work = done.y[2:5], float(done.y[5])
        if done.event == 1:  # what is left of the slip is rounding: remove it
            self.lam[1:] -= np.linalg.solve(self.g[1:, 1:], self.gamma()[1:])
        self.note("slip")
        return done.event == 0


def incremental(g: np.ndarray, gamma: np.ndarray, mu: float, e: float, law: str = "energetic") -> Impact:
    """The impulse process of Routh and Keller, ended by `law`: "poisson", "newton" or "energetic"."""
    g, gamma = np.asarray(g, float), np.asarray(gamma, float)
    if gamma[0] >= 0.0:
        return Impact(gamma.copy(), np.zeros(3), 0.0)
    speed, unit = -float(gamma[0]), -float(gamma[0]) / float(g[0, 0])  # of velocities and of impulses
    g, gamma = g / g[0, 0], gamma / speed
    run = _Run(g, gamma, mu, e, law)
    slipping = mu > 0.0 and bool(np.linalg.norm(gamma[1:]) > 0.0)
    rest: tuple[np.ndarray, str] | None = None  # the straight process after the slip came to zero
    if mu == 0.0:
        rest = (np.array([1.0, 0.0, 0.0]), "frictionless")
    while True:
        if rest is None and not slipping:
            angle = slip_direction(g, mu)
            if angle is None:
                rest = (np.concatenate([[1.0], -np.linalg.solve(g[1:, 1:], g[1:, 0])]), "stick")
            else:
                rest = (np.array([1.0, -mu * math.cos(angle), -mu * math.sin(angle)]), "slip again")
        if rest is not None:
            run.straight(*rest)
        elif not run.slide():
            slipping = False
            continue
        if run.compressed is not None:
            break
        run.compressed = (float(run.lam[0]), run.work)
        if e == 0.0:
            break
    phases = [(name, unit * normal, speed * velocity) for name, normal, velocity in run.phases]
    return Impact(speed * run.gamma(), unit * run.lam, unit * run.compressed[0], phases)
