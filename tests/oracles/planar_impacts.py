"""Planar impacts in closed form: a rod that hits a plane, and a double pendulum whose end hits the ground.

One contact with velocity (normal, tangential), normal > 0 leaves, and Delassus matrix [[n, c], [c, t]]. While the slip
keeps its sign s, the impulse grows along (1, -mu s): both velocities are linear in the normal impulse and its work is
quadratic (Routh, "Dynamics of a system of rigid bodies", 1860). A slip that comes to zero sticks where |c| <= mu t, and
turns to the sign of c elsewhere. The ends of the impact are as in `impact_laws`: Poisson's, Newton's, and the energetic
one of Stronge ("Rigid body collisions with friction", Proc. R. Soc. A 431, 1990). `complementarity` is Newton's law
with Coulomb friction on the slip after the impact, and `two_phase` Poisson's law as two such problems.

Kane, Levinson ("Dynamics: theory and applications", 1985, section 5.12 and its exercises) and Stronge's "Impact
mechanics" (2000) have the double pendulum: two equal uniform rods, hinged to each other and to a fixed point, the free
end strikes rough ground. The angles and rates that are defaults here (length and mass 1, angles of 20 and 30 degrees
from the downward vertical, rates -0.1 and -0.2 rad/s, e = 0.5, mu = 0.5) are those known to the author from memory, not
read in the book; the functions take any others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Planar:
    """Velocity (2,) after the impact, impulse (2,), normal impulse of compression, names of the phases in order."""

    velocity: np.ndarray
    impulse: np.ndarray
    compression: float
    phases: tuple[str, ...] = ()


def incremental(g: np.ndarray, velocity: np.ndarray, mu: float, e: float, law: str) -> Planar:
    """Routh's process, ended by `law`: "poisson", "newton" or "energetic"."""
    (n, c), (_, t) = np.asarray(g, float)
    u, s = (float(x) for x in velocity)
    start, p, q, work = u, 0.0, 0.0, 0.0
    names: list[str] = []
    lam_c = work_c = None
    holds = abs(c) <= mu * t
    while True:
        if s != 0.0:
            name, ratio = "slip", -mu * math.copysign(1.0, s)
        elif holds:
            name, ratio = "stick", -c / t
        else:
            name, ratio = "slip again", -mu * math.copysign(1.0, c)
        du, ds = n + c * ratio, c + t * ratio  # of the velocities, for each unit of normal impulse
        left = math.inf  # normal impulse until the slip comes to zero
        if s != 0.0 and s * ds < 0.0:
            left = -s / ds
        if lam_c is None:
            end = -u / du if du > 0.0 else math.inf
        elif law == "poisson":
            end = (1.0 + e) * lam_c - p
        elif law == "newton":
            end = (-e * start - u) / du if du > 0.0 else math.inf
        else:
            rest = (1.0 - e * e) * work_c - work
            root = u * u + 2.0 * du * rest
            end = 2.0 * rest / (u + math.sqrt(root)) if root >= 0.0 and u + math.sqrt(root) > 0.0 else math.inf
        x = min(left, end)
        if math.isinf(x):
            raise ArithmeticError("the impact does not end")
        work += x * (u + 0.5 * du * x)
        p, q, u, s = p + x, q + ratio * x, u + du * x, (0.0 if left <= end or name == "stick" else s + ds * x)
        names.append(name)
        if end <= left:
            if lam_c is not None or e == 0.0:
                lam_c = p if lam_c is None else lam_c
                break
            lam_c, work_c, u = p, work, 0.0
    return Planar(np.array([u, s]), np.array([p, q]), lam_c, tuple(names))


def complementarity(g: np.ndarray, velocity: np.ndarray, mu: float, target: float) -> Planar:
    """Impulse (p, q) with normal velocity `target` after it and |q| <= mu p against the slip after it; the least p."""
    (n, c), (_, t) = np.asarray(g, float)
    u, s = (float(x) for x in velocity)
    found = []
    p, q = np.linalg.solve([[n, c], [c, t]], [target - u, -s])
    if p >= 0.0 and abs(q) <= mu * p:
        found.append((p, q, 0.0, "stick"))
    for sign in (1.0, -1.0):
        along = n - mu * sign * c
        if along > 0.0:
            p = (target - u) / along
            after = s + (c - mu * sign * t) * p
            if p >= 0.0 and sign * after > 0.0:
                found.append((p, -mu * sign * p, after, "slip"))
    p, q, after, name = min(found)
    return Planar(np.array([target, after]), np.array([p, q]), p, (name,))


def two_phase(g: np.ndarray, velocity: np.ndarray, mu: float, e: float) -> Planar:
    """Poisson's law: compression to rest; expansion with e times its normal impulse, more if that does not separate."""
    (n, c), (_, t) = np.asarray(g, float)
    first = complementarity(g, velocity, mu, 0.0)
    p, s = e * first.impulse[0], float(first.velocity[1])
    q = min(max(-(s + c * p) / t, -mu * p), mu * p)
    u = n * p + c * q
    if u < 0.0:
        again = complementarity(g, first.velocity, mu, 0.0)
        p, q, u = float(again.impulse[0]), float(again.impulse[1]), 0.0
    after = np.array([u, s + c * p + t * q])
    return Planar(after, first.impulse + [p, q], first.compression, (*first.phases, "expansion"))


def solve(g: np.ndarray, velocity: np.ndarray, mu: float, e: float, law: str) -> Planar:
    """Any of the laws: "complementarity", "two_phase", "poisson", "newton", "energetic"."""
    if law == "complementarity":
        return complementarity(g, velocity, mu, -e * float(velocity[0]))
    if law == "two_phase":
        return two_phase(g, velocity, mu, e)
    return incremental(g, velocity, mu, e, law)


def energy_change(g: np.ndarray, velocity: np.ndarray, found: Planar) -> float:
    """Change of kinetic energy: impulse . (velocity before + after) / 2."""
    return 0.5 * float(found.impulse @ (np.asarray(velocity, float) + found.velocity))


# --- a rod ----------------------------------------------------------------------------------------------------------
def rod_delassus(theta: float, mass: float = 1.0, length: float = 1.0) -> np.ndarray:
    """Rows (normal, tangent) of the lower end of a uniform rod at the angle theta from the horizontal.

    The centre is at +length/2 (cos theta, sin theta) from the end; the plane is y = 0, the tangent x.
    """
    r = -0.5 * length * np.array([math.cos(theta), math.sin(theta)])  # from the centre to the end
    rows = np.array([[0.0, 1.0, r[0]], [1.0, 0.0, -r[1]]])  # on (vx, vy, omega)
    return rows @ np.diag([1.0 / mass, 1.0 / mass, 12.0 / (mass * length**2)]) @ rows.T


def rod_impact(
    theta: float,
    motion: np.ndarray,
    mu: float,
    e: float,
    law: str,
    mass: float = 1.0,
    length: float = 1.0,
) -> tuple[np.ndarray, Planar]:
    """(vx, vy, omega) of the rod's centre after the end has hit the plane y = 0, and the contact's impact."""
    r = -0.5 * length * np.array([math.cos(theta), math.sin(theta)])
    rows = np.array([[0.0, 1.0, r[0]], [1.0, 0.0, -r[1]]])
    inverse = np.diag([1.0 / mass, 1.0 / mass, 12.0 / (mass * length**2)])
    found = solve(rows @ inverse @ rows.T, rows @ motion, mu, e, law)
    return np.asarray(motion, float) + inverse @ rows.T @ found.impulse, found


# --- a double pendulum ----------------------------------------------------------------------------------------------
def pendulum_matrices(angles: np.ndarray, mass: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """(mass matrix, rows of the free end) of two equal uniform rods at absolute angles from the downward vertical.

    The end is at length (sin a + sin b, -cos a - cos b); the rows are the upward normal and the horizontal tangent.
    """
    a, b = angles
    unit = mass * length**2
    cross = 0.5 * unit * math.cos(a - b)
    matrix = np.array([[4.0 / 3.0 * unit, cross], [cross, unit / 3.0]])
    rows = length * np.array([[math.sin(a), math.sin(b)], [math.cos(a), math.cos(b)]])
    return matrix, rows


def pendulum_impact(
    law: str,
    e: float = 0.5,
    mu: float = 0.5,
    angles: tuple[float, float] = (math.radians(20.0), math.radians(30.0)),
    rates: tuple[float, float] = (-0.1, -0.2),
    mass: float = 1.0,
    length: float = 1.0,
) -> tuple[np.ndarray, Planar, float]:
    """(rates after the impact, the contact's impact, change of kinetic energy) of the double pendulum at the ground."""
    matrix, rows = pendulum_matrices(np.asarray(angles), mass, length)
    before = np.asarray(rates, float)
    delassus = rows @ np.linalg.solve(matrix, rows.T)
    found = solve(delassus, rows @ before, mu, e, law)
    after = before + np.linalg.solve(matrix, rows.T @ found.impulse)
    return after, found, 0.5 * float(after @ matrix @ after - before @ matrix @ before)


if __name__ == "__main__":
    for law in ("complementarity", "two_phase", "newton", "poisson", "energetic"):
        for mu in (0.0, 0.5, 0.7):
            after, found, change = pendulum_impact(law, mu=mu)
            print(f"{law:16s} mu {mu}: rates {after[0]:+.10f} {after[1]:+.10f}, energy {change:+.3e}", found.phases)
