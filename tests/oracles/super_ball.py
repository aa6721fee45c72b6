"""A sphere with normal and tangential restitution at a plane, in closed form (Walton 1993; Garwin 1969: e = e_t = 1).

The plane is z = 0, the sphere has radius r and inertia k m r^2. Its lowest point slips with s = v_t + r (-w_y, w_x) .
The normal impulse is (1 + e) m |v_z|. A grip reverses the slip, s+ = -e_t s, and needs the impulse (1 + e_t) |s| m
k / (1 + k); where that is more than mu times the normal impulse the contact slides: the impulse is mu times the normal
one, against s. The spin about the normal is untouched. No energy is gained: the loss is (1 - e^2) m v_z^2 / 2 +
(1 - e_t^2) m k / (1 + k) s^2 / 2 in a grip, and the slide loses more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GRAVITY = 9.81


@dataclass(frozen=True)
class Bounce:
    """v (3,), omega (3,) after the bounce, impulse (3,) on the ball, whether it gripped."""

    v: np.ndarray
    omega: np.ndarray
    impulse: np.ndarray
    grip: bool


def slip(v: np.ndarray, omega: np.ndarray, radius: float) -> np.ndarray:
    """Velocity (2,) of the lowest point along the plane: v + omega x (0, 0, -r)."""
    return np.array([v[0] - radius * omega[1], v[1] + radius * omega[0]])


def bounce(
    v: np.ndarray,
    omega: np.ndarray,
    e: float,
    tangential: float,
    mu: float,
    radius: float = 0.02,
    mass: float = 1.0,
    k: float = 0.4,
) -> Bounce:
    """One impact with the plane z = 0; v_z < 0 before it."""
    v, omega = np.asarray(v, float), np.asarray(omega, float)
    s = slip(v, omega, radius)
    normal = -(1.0 + e) * mass * v[2]
    push = -(1.0 + tangential) * mass * k / (1.0 + k) * s
    size = float(np.linalg.norm(push))
    grip = size <= mu * normal
    if not grip:
        push = -mu * normal * s / np.linalg.norm(s)
    impulse = np.array([push[0], push[1], normal])
    spin = np.cross([0.0, 0.0, -radius], impulse) / (k * mass * radius**2)
    return Bounce(v + impulse / mass, omega + spin, impulse, grip)


def energy(v: np.ndarray, omega: np.ndarray, radius: float, mass: float = 1.0, k: float = 0.4) -> float:
    """Kinetic energy of the sphere."""
    return 0.5 * mass * float(np.dot(v, v) + k * radius**2 * np.dot(omega, omega))


def hops(
    position: np.ndarray,
    v: np.ndarray,
    omega: np.ndarray,
    n: int,
    e: float,
    tangential: float,
    mu: float,
    radius: float = 0.02,
    k: float = 0.4,
    gravity: float = GRAVITY,
) -> list[tuple[float, np.ndarray, Bounce]]:
    """(time, position of the centre, bounce) of the first n impacts of a thrown ball under gravity."""
    t, x, v, omega = 0.0, np.asarray(position, float), np.asarray(v, float), np.asarray(omega, float)
    found = []
    for _ in range(n):
        height = x[2] - radius
        flight = (v[2] + np.sqrt(v[2] ** 2 + 2.0 * gravity * max(height, 0.0))) / gravity
        x = np.array([x[0] + v[0] * flight, x[1] + v[1] * flight, radius])
        after = bounce(v - [0.0, 0.0, gravity * flight], omega, e, tangential, mu, radius, 1.0, k)
        t, v, omega = t + flight, after.v, after.omega
        found.append((t, x, after))
    return found


if __name__ == "__main__":
    # Garwin's ball, e = e_t = 1: it hops back and forth between two states.
    for t, x, after in hops([0.0, 0.0, 0.52], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 4, 1.0, 1.0, 1e9):
        print(f"t = {t:.10f}, x = {x[0]:+.10f}, v_x = {after.v[0]:+.10f}, omega_y = {after.omega[1]:+.8f}")
