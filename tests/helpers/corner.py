"""A box without gravity that hits a plane with one corner: an impact with friction in three dimensions.

Its laws are those of the Delassus matrix G of the corner, rows (n, t1, t2), and its velocity gamma before the impact.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import contactvi as cvi

GAP = 1e-9  # [m] at the start: the impact follows within about as many seconds, in which nothing turns
SIZE = np.array([0.3, 0.2, 0.5])
MASS = 1.3


class Corner:
    """A box whose corner is above the ground, its velocity, and the impact of its corner."""

    def __init__(self, seed: int, mu: float, e: float) -> None:
        rng = np.random.default_rng(seed)
        self.mu, self.e = mu, e
        self.R = rotation(rng)
        corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * SIZE
        world = corners @ self.R.T
        self.r = world[np.argmin(world[:, 2])]
        self.omega = rng.normal(size=3)
        self.v = rng.normal(size=3)
        speed = (self.v + np.cross(self.omega, self.r))[2]
        self.v[2] -= speed + abs(rng.normal()) + 0.2
        x, y, z = SIZE
        inertia = self.R @ np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) @ self.R.T * MASS / 12.0
        rows = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        W = np.hstack([rows, np.cross(self.r, rows)])  # of (v, omega) in the world
        none = np.zeros((3, 3))
        self.W = W
        self.G = W @ np.linalg.solve(np.block([[MASS * np.eye(3), none], [none, inertia]]), W.T)
        self.gamma = W @ np.hstack([self.v, self.omega])

    def scene(self, **law: object) -> cvi.Scene:
        """Return the scene, without gravity."""
        scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
        scene.add_halfspace()
        place = np.hstack([[0.0, 0.0, GAP - self.r[2]], pin.Quaternion(self.R).coeffs()])
        scene.add_box("box", SIZE, mass=MASS)
        scene.set_contact(friction=self.mu, restitution=self.e, **law)
        self.q0, self.v0 = place, np.hstack([self.R.T @ self.v, self.R.T @ self.omega])
        return scene

    def after(self, **law: object) -> np.ndarray:
        """Return the corner's velocity (n, t1, t2) after the impact; `run` is the run."""
        scene = self.scene(**law)
        self.run = cvi.simulate(scene, self.q0, self.v0, duration=1e-8, dt=1e-8)
        assert self.run.status.ok, self.run.status
        v = self.run.v[-1]
        return self.W @ np.hstack([self.R @ v[:3], self.R @ v[3:]])


def rotation(rng: np.random.Generator) -> np.ndarray:
    """Return a rotation by up to 3 rad about any axis, (3, 3)."""
    axis = rng.normal(size=3)
    return pin.exp3(axis / np.linalg.norm(axis) * rng.uniform(0.0, 3.0))
