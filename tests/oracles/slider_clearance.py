"""Slider-crank whose slider has clearance in its channel (Flores, Leine, Glocker 2010, their table 1).

Absolute angles q = (crank, rod, slider) from the x axis, w = q'; gravity along -y; the slider's pin is its centre, the
crank's and the rod's centres are their middles. The slider has the half length a and the half height b, the channel the
half height b + c. Corners in the order of the paper: 0 (-a, b), 1 (a, b) against the upper wall, 2 (-a, -b), 3 (a, -b)
against the lower one. Motion between impacts by DOP853, impacts located by Newton on the integrated state.

Impact law: gamma+ >= -e gamma-, P >= 0, one of them equal, for all corners that touch at once; friction |P_t| <= mu P,
P_t = -mu P sign(slip after) where it slips (no restitution along the wall). Solved by trying every combination. The
given start has the slider parallel to the wall and without spin, and the law keeps it there: both corners of a side hit
at once, every time. With a turned slider (`start`) the first impacts are of one corner.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

SIGNS = ((-1, 1), (1, 1), (-1, -1), (1, -1))  # corners: along and across the slider
SPEEDS = (150.0, -75.0, 0.0)  # [rad/s], start of the paper, all angles 0
TOUCHING = 1e-12  # [m]; corners with less gap take part in an impact


@dataclass(frozen=True)
class Impact:
    """Time [s], corners in touch, q, velocities before and after, normal speed (4,) before, impulses (4, 2) [N s].

    impulses: normal and along x, on the slider; 0 for corners that do not touch.
    """

    time: float
    corners: list[int]
    q: np.ndarray
    w_minus: np.ndarray
    w_plus: np.ndarray
    gamma_minus: np.ndarray
    impulses: np.ndarray


@dataclass(frozen=True)
class Run:
    """State at the end, and why: "duration", "count", or "accumulation" (impacts closer than the resolution)."""

    time: float
    q: np.ndarray
    w: np.ndarray
    impacts: list[Impact]
    reason: str


@dataclass(frozen=True)
class SliderClearance:
    """Lengths [m], masses [kg], inertias about the centres [kg m^2], restitution e, friction mu."""

    l1: float = 0.153
    l2: float = 0.306
    a: float = 0.05
    b: float = 0.025
    c: float = 0.001
    masses: tuple[float, float, float] = (0.038, 0.038, 0.076)
    inertias: tuple[float, float, float] = (7.4e-5, 5.9e-4, 2.7e-6)
    e: float = 0.4
    mu: float = 0.01
    gravity: float = 9.81

    # --- dynamics ---------------------------------------------------------------------------------------------------
    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        m1, m2, m3 = self.masses
        j1, j2, j3 = self.inertias
        cross = (0.5 * m2 + m3) * self.l1 * self.l2 * math.cos(q[1] - q[0])
        first = j1 + (0.25 * m1 + m2 + m3) * self.l1**2
        return np.array([[first, cross, 0.0], [cross, j2 + (0.25 * m2 + m3) * self.l2**2, 0.0], [0.0, 0.0, j3]])

    def acceleration(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        """M a = force; d/dt (M w) - dT/dq leaves the centrifugal parts below."""
        m1, m2, m3 = self.masses
        turn = (0.5 * m2 + m3) * self.l1 * self.l2 * math.sin(q[1] - q[0])
        first = turn * w[1] ** 2 - (0.5 * m1 + m2 + m3) * self.gravity * self.l1 * math.cos(q[0])
        second = -turn * w[0] ** 2 - (0.5 * m2 + m3) * self.gravity * self.l2 * math.cos(q[1])
        return np.linalg.solve(self.mass_matrix(q), np.array([first, second, 0.0]))

    def energy(self, q: np.ndarray, w: np.ndarray) -> float:
        m1, m2, m3 = self.masses
        height = (0.5 * m1 + m2 + m3) * self.l1 * math.sin(q[0]) + (0.5 * m2 + m3) * self.l2 * math.sin(q[1])
        return 0.5 * float(w @ self.mass_matrix(q) @ w) + self.gravity * height

    # --- geometry ---------------------------------------------------------------------------------------------------
    def corners(self, q: np.ndarray) -> np.ndarray:
        """Places of the corners [m], (4, 2)."""
        return self._arms(q).sum(axis=0)

    def _arms(self, q: np.ndarray) -> np.ndarray:
        """Vectors along crank and rod, and from the slider's pin to the corners, (3, 4, 2)."""
        along, across = _direction(q[2]), _direction(q[2] + 0.5 * math.pi)
        corner = np.array([i * self.a * along + j * self.b * across for i, j in SIGNS])
        return np.array([[self.l1 * _direction(q[0])] * 4, [self.l2 * _direction(q[1])] * 4, corner])

    def corner_jacobians(self, q: np.ndarray) -> np.ndarray:
        """d corners / dq, (4, 2, 3): a turn moves by the turned arm."""
        arms = self._arms(q)
        return np.stack([-arms[:, :, 1], arms[:, :, 0]], axis=1).transpose(2, 1, 0)

    def gaps(self, q: np.ndarray) -> np.ndarray:
        """Distances of the corners to their walls [m], (4,): half height of the channel -+ y."""
        return self.b + self.c - np.array([j for _, j in SIGNS]) * self.corners(q)[:, 1]

    def gap_gradients(self, q: np.ndarray) -> np.ndarray:
        """(4, 3), rows W with gap' = W w."""
        return -np.array([[j] for _, j in SIGNS]) * self.corner_jacobians(q)[:, 1]

    def gap_accelerations(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        """gap'' in flight [m/s^2], (4,): a corner has J w' - sum of arm w^2."""
        corner = self.corner_jacobians(q) @ self.acceleration(q, w) - np.einsum("nkr,n->kr", self._arms(q), w * w)
        return -np.array([j for _, j in SIGNS]) * corner[:, 1]

    def slip_gradients(self, q: np.ndarray) -> np.ndarray:
        """(4, 3), velocity of the corners along x."""
        return self.corner_jacobians(q)[:, 0]

    # --- impacts ----------------------------------------------------------------------------------------------------
    def impact(self, q: np.ndarray, w: np.ndarray, corners: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """(velocity after, impulses (4, 2)) of the law above for these corners together.

        The first combination of modes that solves it, fewest open corners first.
        """
        normal, slip = self.gap_gradients(q)[corners], self.slip_gradients(q)[corners]
        inverse, target = np.linalg.inv(self.mass_matrix(q)), -self.e * normal @ w
        # corners move at 23 m/s: their speeds are known to 1e-14 m/s
        n, rounding = len(corners), 1e-11 * float(np.abs(normal @ w).max()) + 1e-13
        closed = ("stick", 1.0, -1.0) if self.mu > 0.0 else (0.0,)
        for modes in sorted(itertools.product(("open", *closed), repeat=n), key=lambda m: m.count("open")):
            # each corner: impulses (P, P_t) = columns times its unknowns; as many rows that must vanish
            pulls, rows, wanted = [], [], []
            for k, mode in enumerate(modes):
                if mode == "open":
                    continue
                if mode == "stick":
                    pulls += [normal[k], slip[k]]
                    rows += [normal[k], slip[k]]
                    wanted += [target[k], 0.0]
                else:
                    pulls.append(normal[k] - self.mu * float(mode) * slip[k])
                    rows.append(normal[k])
                    wanted.append(target[k])
            unknown = np.zeros(0)
            w_plus = w
            if rows:
                push = inverse @ np.array(pulls).T
                unknown = np.linalg.lstsq(np.array(rows) @ push, np.array(wanted) - np.array(rows) @ w, rcond=1e-12)[0]
                w_plus = w + push @ unknown
                if np.abs(np.array(rows) @ w_plus - wanted).max() > rounding:
                    continue
            impulses = self._impulses(modes, unknown)
            if self._admissible(modes, impulses, normal @ w_plus - target, slip @ w_plus, rounding):
                out = np.zeros((4, 2))
                out[corners] = impulses
                return w_plus, out
        raise ArithmeticError("no combination of modes solves the impact")

    def _impulses(self, modes: tuple, unknown: np.ndarray) -> np.ndarray:
        """(n, 2) from the unknowns of `impact`."""
        values, out = iter(unknown), np.zeros((len(modes), 2))
        for k, mode in enumerate(modes):
            if mode == "stick":
                out[k] = next(values), next(values)
            elif mode != "open":
                p = next(values)
                out[k] = p, -self.mu * float(mode) * p
        return out

    def _admissible(
        self, modes: tuple, impulses: np.ndarray, excess: np.ndarray, slip: np.ndarray, rounding: float
    ) -> bool:
        """excess: gamma+ + e gamma-; signs up to rounding."""
        for k, mode in enumerate(modes):
            p, tangential = impulses[k]
            if p < -rounding or excess[k] < -rounding:
                return False
            if mode == "stick" and abs(tangential) > self.mu * p:
                return False
            if isinstance(mode, float) and mode * slip[k] < 0.0:
                return False
        return True

    def run(
        self,
        duration: float = 0.2,
        start: tuple = (0.0, 0.0, 0.0),
        speeds: tuple = SPEEDS,
        most: int = 1000,
        resolution: float = 1e-7,
    ) -> Run:
        """Motion with impacts, up to `most` of them; ends early where two are less than `resolution` [s] apart."""
        impacts: list[Impact] = []
        t, q, w = 0.0, np.array(start, float), np.array(speeds, float)
        if self.gaps(q).min() <= 0.0:
            raise ValueError("the slider starts in the wall")
        while len(impacts) < most:
            hit = self._next_hit(q, w, duration - t)
            if hit is None:
                q, w = self._flow(q, w, duration - t)
                return Run(duration, q, w, impacts, "duration")
            step, q, w = hit
            gamma = self.gap_gradients(q) @ w
            corners = [k for k in range(4) if self.gaps(q)[k] <= TOUCHING]
            w_plus, impulses = self.impact(q, w, corners)
            t += step
            impacts.append(Impact(t, corners, q, w, w_plus, gamma, impulses))
            w = w_plus
            if step < resolution:
                return Run(t, q, w, impacts, "accumulation")
        return Run(t, q, w, impacts, "count")

    def _flow(self, q: np.ndarray, w: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
        y = self._integrate(q, w, duration, [], np.inf).y[:, -1]
        return y[:3], y[3:]

    def _integrate(self, q: np.ndarray, w: np.ndarray, duration: float, events: list, longest: float) -> Any:
        def rhs(_t: float, y: np.ndarray) -> np.ndarray:
            return np.concatenate([y[3:], self.acceleration(y[:3], y[3:])])

        y0 = np.concatenate([q, w])
        return solve_ivp(
            rhs, (0.0, duration), y0, method="DOP853", rtol=1e-13, atol=1e-15, events=events, max_step=longest
        )

    def _next_hit(self, q: np.ndarray, w: np.ndarray, duration: float) -> tuple[float, np.ndarray, np.ndarray] | None:
        """(time, q, w) where the first gap closes; corners on a wall count again once they have separated from it."""
        guards = []
        for k in range(4):

            def guard(_t: float, y: np.ndarray, k: int = k) -> float:
                return float(self.gaps(y[:3])[k])

            guard.terminal, guard.direction = True, -1.0  # type: ignore[attr-defined]
            guards.append(guard)
        # Two crossings within one step would be missed: steps shorter than a turn of 1e-4 s * 150 rad/s, and than the
        # flight ahead of a corner that bounces, 2 gap' / -gap''.
        gaps, rates, accelerations = self.gaps(q), self.gap_gradients(q) @ w, self.gap_accelerations(q, w)
        flights = [
            -2.0 * v / a for x, v, a in zip(gaps, rates, accelerations, strict=True) if x <= TOUCHING and a < 0.0
        ]
        run = self._integrate(q, w, duration, guards, min([1e-4, *(0.1 * f for f in flights)]))
        lowest = min(self.gaps(y[:3]).min() for y in run.y[:, :-1].T)
        if lowest < -TOUCHING:
            raise ArithmeticError(f"a crossing was missed: gap {lowest:.3g}")
        times = [(e[0], k) for k, e in enumerate(run.t_events) if e.size]
        if not times:
            return None
        step, k = min(times)
        at = int(np.searchsorted(run.t, step)) - 1
        qs, ws, h = run.y[:3, at], run.y[3:, at], step - run.t[at]
        for _ in range(8):
            qh, wh = self._flow(qs, ws, h)
            correction = self.gaps(qh)[k] / (self.gap_gradients(qh)[k] @ wh)
            h -= correction
            if abs(correction) < 1e-17:
                break
        qh, wh = self._flow(qs, ws, h)
        return run.t[at] + h, qh, wh

    # --- the same mechanism for Pinocchio ---------------------------------------------------------------------------
    def model(self) -> pin.Model:
        """Three hinges about z, relative angles: q_pin = (q0, q1 - q0, q2 - q1), the same for the velocities."""
        model, parent = pin.Model(), 0
        model.gravity = pin.Motion(np.array([0.0, -self.gravity, 0.0]), np.zeros(3))
        centres, offsets = (0.5 * self.l1, 0.5 * self.l2, 0.0), (0.0, self.l1, self.l2)
        for name, m, j, x, offset in zip(
            ("crank", "rod", "slider"), self.masses, self.inertias, centres, offsets, strict=True
        ):
            place = pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0]))
            parent = model.addJoint(parent, pin.JointModelRZ(), place, name)
            inertia = pin.Inertia(m, np.array([x, 0.0, 0.0]), np.diag([j, j, j]))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        return model


def _direction(angle: float) -> np.ndarray:
    return np.array([math.cos(angle), math.sin(angle)])
