"""Measures of a run of S7, by the same formulas for every simulator, from its states alone.

The gaps are those of the exact shapes (boxes and spheres against a sphere), whatever margins a simulator adds. The
energy is kinetic, potential and kp/2 |q - goal|^2 of the controller: dampers, friction and impacts without rebound only
take from it, so each rise between two samples was made by the simulator (or had been stored in its contacts).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import hand
import numpy as np
import pinocchio as pin
from scenes import TIGHT
from scipy.integrate import solve_ivp

LATE = 0.2  # s: rest is judged over the last 0.2 s
TOUCH = 1e-4  # m: a smaller gap counts as touching
HELD = 1e-3, 1e-2  # held: two parts of the hand touch it, and it drifts [m] and moves [m/s] less than this

Array = np.ndarray


class Measures:
    """Of the states q (N, 19), v (N, 22) at the times k * sample, k = 1..N, after the job's start."""

    def __init__(self, job: dict[str, Any], model: pin.Model, q: Array, v: Array) -> None:
        self.job, self.model, self.data = job, model, model.createData()
        self.q = np.vstack([job["start"]["q"], q])
        self.v = np.vstack([job["start"]["v"], v])
        self.t = job["sample"] * np.arange(len(self.q))

    @cached_property
    def _places(self) -> tuple[Array, Array]:
        """Gaps (N, shapes) [m] and the directions from the ball's centre to each shape's nearest point."""
        gaps, towards = [], []
        for q in self.q:
            pin.forwardKinematics(self.model, self.data, q[:16])
            row = [_nearest(shape, self.data.oMi[shape["joint"]], q[16:]) for shape in self.job["shapes"]]
            gaps.append([distance - self.job["ball"]["radius"] for distance, _ in row])
            towards.append([direction for _, direction in row])
        return np.array(gaps), np.array(towards)

    @property
    def overlap(self) -> float:
        """Deepest penetration [m]."""
        return float(max(0.0, -self._places[0].min()))

    @property
    def overlap_end(self) -> float:
        """Penetration at the end [m]."""
        return float(max(0.0, -self._places[0][-1].min()))

    @property
    def touching(self) -> list[str]:
        """Parts of the hand that touch the ball at the end."""
        at_end = zip(self.job["shapes"], self._places[0][-1], strict=True)
        close = {self.job["parts"][shape["joint"]] for shape, gap in at_end if gap < TOUCH}
        return sorted(close, key=["palm", *hand.FINGERS].index)

    @property
    def _late(self) -> Array:
        return np.flatnonzero(self.t > self.t[-1] - LATE - 1e-9)

    @property
    def drift(self) -> float:
        """Farthest that the ball is from its last place in the last 0.2 s [m]."""
        return float(np.linalg.norm(self.q[self._late, 16:] - self.q[-1, 16:], axis=1).max())

    @property
    def slip(self) -> float:
        """Longest path that the ball slips on a shape in the last 0.2 s [m], without rolling."""
        radius, late = self.job["ball"]["radius"], self._late
        total = np.zeros(len(self.job["shapes"]))
        for k in late[1:]:
            gaps, towards = self._places[0][k], self._places[1][k]
            pin.computeJointJacobians(self.model, self.data, self.q[k, :16])
            for i in np.flatnonzero(gaps < TOUCH):
                arm = radius * towards[i]
                speed = self.v[k, 16:19] + np.cross(self.v[k, 19:], arm)
                speed = speed - self._velocity(self.job["shapes"][i]["joint"], self.q[k, 16:] + arm, self.v[k, :16])
                slip = speed - towards[i] * (towards[i] @ speed)
                total[i] += np.linalg.norm(slip) * (self.t[k] - self.t[k - 1])
        return float(total.max())

    def _velocity(self, joint: int, point: Array, speeds: Array) -> Array:
        """Velocity of a point that is fixed in a joint's frame, world axes; needs the Jacobians of the place."""
        if joint == 0:
            return np.zeros(3)
        twist = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED) @ speeds
        return twist[:3] + np.cross(twist[3:], point - self.data.oMi[joint].translation)

    @property
    def speed(self) -> float:
        """Of the ball's centre at the end [m/s]."""
        return float(np.linalg.norm(self.v[-1, 16:19]))

    @property
    def held(self) -> bool:
        """Whether the ball has come to rest between two parts of the hand."""
        return len(self.touching) >= 2 and self.drift < HELD[0] and self.speed < HELD[1]

    @property
    def moved(self) -> float:
        """Farthest that the ball was from its start [m]."""
        return float(np.linalg.norm(self.q[:, 16:] - self.q[0, 16:], axis=1).max())

    @cached_property
    def energy(self) -> Array:
        """Kinetic, potential and spring energy at every sample [J]."""
        ball, found = self.job["ball"], []
        spin = 0.4 * ball["mass"] * ball["radius"] ** 2
        for q, v in zip(self.q, self.v, strict=True):
            pin.computeAllTerms(self.model, self.data, q[:16], v[:16])
            value = self.data.kinetic_energy + self.data.potential_energy + ball["mass"] * self.job["gravity"] * q[18]
            value += 0.5 * ball["mass"] * v[16:19] @ v[16:19] + 0.5 * spin * v[19:] @ v[19:]
            found.append(value + 0.5 * self.job["kp"] * np.sum((q[:16] - self.job["goal"]) ** 2))
        return np.array(found)

    @property
    def gained(self) -> float:
        """All rises of the energy between samples [J]."""
        return float(np.maximum(np.diff(self.energy), 0.0).sum())

    @property
    def flight_error(self) -> float:
        """Largest |q - q_ref| [rad, m] while nothing touches, against DOP853 at rtol 1e-13."""
        free = np.flatnonzero(self.t <= hand.TOUCHES_AT)
        ball = self.job["start"]["q"][18] - 0.5 * self.job["gravity"] * self.t[free] ** 2
        exact = np.column_stack([self._flight(self.t[free]), ball])
        return float(np.linalg.norm(self.q[free][:, [*range(16), 18]] - exact, axis=1).max())

    def _flight(self, times: Array) -> Array:
        goal, kp, kd = np.array(self.job["goal"]), self.job["kp"], self.job["kd"]
        data = self.model.createData()

        def rate(_: float, y: Array) -> Array:
            q, v = y[:16], y[16:]
            return np.concatenate([v, pin.aba(self.model, data, q, v, kp * (goal - q) - kd * v)])

        # From sample to sample: the dense output is of lower order.
        found, y, t = [], np.concatenate([self.q[0, :16], self.v[0, :16]]), 0.0
        for end in times:
            if end > t:
                run = solve_ivp(rate, (t, end), y, **TIGHT)
                y, t = run.y[:, -1], end
            found.append(y[:16])
        return np.array(found)


def _nearest(shape: dict[str, Any], joint: pin.SE3, centre: Array) -> tuple[float, Array]:
    """Distance from a point to a shape's surface (negative inside) and the direction towards it, world axes."""
    place = joint * pin.SE3(pin.rpy.rpyToMatrix(*shape["rpy"]), np.array(shape["xyz"]))
    local = place.actInv(centre)
    if "sphere" in shape:
        length = float(np.linalg.norm(local))
        return length - shape["sphere"], place.rotation @ (-local / length)
    beyond = np.abs(local) - 0.5 * np.array(shape["box"])
    if beyond.max() > 0.0:
        outside = np.sign(local) * np.maximum(beyond, 0.0)
        length = float(np.linalg.norm(outside))
        return length, place.rotation @ (-outside / length)
    axis = int(np.argmax(beyond))
    return float(beyond[axis]), place.rotation[:, axis] * -np.sign(local[axis])
