"""One midpoint step of persistent contact in RATTLE form, solved by brute force over the modes.

  start  p0(v) = p_k + W_k^T Lam,  0 <= Lam_n _|_ phi(q1) >= 0,  |Lam_t| <= mu Lam_n,  s != 0 => Lam_t = -mu Lam_n s/|s|
  end    M(q1) v1 = p^-(v) + W_1^T Lam',  0 <= Lam'_n _|_ w_n >= 0,  w = W_1 v1,  |Lam'_t| <= mu Lam'_n
p0(v), p^-(v): both momenta of the smooth step (oracles.del_step). Slip s: W_t(q_m) v where the point of contact moves
on the body, else the displacement of the body's point over its support since the anchor, over h. A point that slipped
keeps its direction in the velocity impulse unless that would reverse its slip.
Also the continuous contact forces and the motion that they give, for references at rtol 1e-12.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from .contact_modes import Law, Problem
from .contact_points import Points
from .del_step import System

TOUCHING = 1e-12  # [m], contacts with gaps up to it have velocity impulses
REGULAR = 1e-5  # times the largest entry of G_c: what chooses among forces that are not unique


@dataclass(frozen=True)
class Step:
    """A finished step: q, p (Pinocchio coordinates), velocity v of the step (split), modes of the position impulses.

    start, end: impulses on the bodies [N s], world frame, (m, 3); slip: relative velocity of the points at the end
    [m/s], world frame, (m, 3) (for a limit: along its joint); gap [m]; anchors: for the next step.
    """

    q: np.ndarray
    p: np.ndarray
    v: np.ndarray
    modes: tuple
    start: np.ndarray
    end: np.ndarray
    slip: np.ndarray
    gap: np.ndarray
    anchors: list


class PersistentSystem:
    """A Lagrangian system with a list of contact points (oracles.contact_points), each with its own mu."""

    def __init__(self, system: System, points: list):
        self.system, self.split, self.mu = system, system.split, [p.mu for p in points]
        self.points = Points(system.split, points)

    # --- the step ---------------------------------------------------------------------------------------------------
    def step(self, q0, p0, h, anchors=None, tau=None, first=None) -> Step:
        """One step of length h from (q0, p0), Pinocchio coordinates; anchors from the last step, None at first."""
        points, split = self.points, self.split
        tau = np.zeros(split.nv) if tau is None else tau
        bases, places = points.bases(q0), points.places(q0)
        anchors = [None] * len(places) if anchors is None else anchors
        reference = [y if a is None else a for y, a in zip(places, anchors, strict=True)]
        turned = [r.T @ b for r, b in zip(points.rotations(q0), bases, strict=True)]
        w0, start = points.gradients(q0, bases), split.tangent_map(q0) @ p0

        def function(v):
            f = self.system.both_momenta(q0, v, h, tau)[0] - start
            return f, self._measure(q0, v, h, bases, turned, reference)

        free = np.linalg.solve(self.system.mass_matrix(q0), start)
        position = Problem(function, w0, free, [Law(mu) for mu in self.mu]).solve(first, self._epsilon(q0, w0))
        q1 = split.integrate(q0, h * position.x)
        p_minus = self.system.both_momenta(q0, position.x, h, tau)[1]
        carried = points.carried(bases, q1)
        lam, v1, w = self._velocity_impulses(q1, p_minus, position, carried)
        stuck = [tangential == "stick" for _, tangential in position.modes]
        return Step(
            q1,
            split.tangent_map(q1).T @ self.system.mass_matrix(q1) @ v1,
            position.x,
            position.modes,
            np.array([b @ x for b, x in zip(bases, position.lam, strict=True)]),
            np.array([b @ x for b, x in zip(carried, lam, strict=True)]),
            np.array([b @ x for b, x in zip(carried, w, strict=True)]),
            points.gaps(q1),
            [y if s else None for y, s in zip(reference, stuck, strict=True)],
        )

    def _measure(self, q0, v, h, bases, turned, reference):
        """gap/h and slip of each point, (m, 3)."""
        q1, qm = self.split.integrate(q0, h * v), self.split.integrate(q0, 0.5 * h * v)
        y = np.einsum("irk,k->ir", self.points.gradients(qm, self.points.carried(bases, qm)), v)
        y[:, 0] = self.points.gaps(q1) / h
        for i, place in enumerate(self.points.places(q1)):
            if self.points.points[i].material:
                y[i, 1:] = (turned[i].T @ (place - reference[i]))[1:] / h
        return y

    def _velocity_impulses(self, q1, p_minus, position, bases):
        """(impulses (m, 3), velocity, w (m, 3)) that leave no point approaching at q1."""
        gaps, mass = self.points.gaps(q1), self.system.mass_matrix(q1)
        gradients = self.points.gradients(q1, bases)
        active = [i for i in range(len(gaps)) if position.lam[i, 0] > 0.0 or gaps[i] <= TOUCHING]
        w1 = gradients[active]

        directions = {}
        for i in active:
            if position.modes[i][1] == "slip":
                directions[i] = position.w[i, 1:] / np.linalg.norm(position.w[i, 1:])
        while True:
            laws = [Law(self.mu[i], 0.0, directions.get(i)) for i in active]
            end = Problem(lambda v: (mass @ v - p_minus, w1 @ v), w1, np.linalg.solve(mass, p_minus), laws).solve(
                None, self._epsilon(q1, w1)
            )
            reversed_ = [i for k, i in enumerate(active) if i in directions and end.w[k, 1:] @ directions[i] < -1e-13]
            if not reversed_:
                break
            for i in reversed_:
                del directions[i]
        lam = np.zeros((len(gaps), 3))
        lam[active] = end.lam
        return lam, end.x, gradients @ end.x

    def _epsilon(self, q, w):
        if len(w) < 2:
            return 0.0
        flat = w.reshape(-1, w.shape[2])
        return REGULAR * float((flat @ np.linalg.solve(self.system.mass_matrix(q), flat.T)).diagonal().max())

    # --- continuous forces ------------------------------------------------------------------------------------------
    def forces(self, q, v, tangential, tau=0.0):
        """(lam (m, 3) [N; n, t1, t2], acceleration, bases) at (q, v) in split coordinates.

        tangential: for each point "none", "stick" (its three rows are constraints) or "slip" (against its slip);
        None for a point without contact. Normal forces may come out negative: the constraints are bilateral here.
        """
        m, bases = len(tangential), self.points.bases(q)
        w = self.points.gradients(q, bases)
        rate, eps = np.zeros((m, 3)), 1e-3
        for k, weight in ((-3, -1 / 60), (-2, 9 / 60), (-1, -45 / 60), (1, 45 / 60), (2, -9 / 60), (3, 1 / 60)):
            moved = self.split.integrate(q, k * eps * v)
            rate += weight / eps * (self.points.gradients(moved, self.points.carried(bases, moved)) @ v)
        constraints, pulls = [], []  # rows of the constraints; how each of their forces acts, (3m,)
        for i, kind in enumerate(tangential):
            rows = {None: (), "stick": (0, 1, 2)}.get(kind, (0,))
            for r in rows:
                pull = np.zeros((m, 3))
                pull[i, r] = 1.0
                if kind == "slip":
                    slip = w[i, 1:] @ v
                    pull[i, 1:] = -self.mu[i] * slip / np.linalg.norm(slip)
                constraints.append((i, r))
                pulls.append(pull.reshape(-1))
        flat, index = w.reshape(3 * m, -1), [3 * i + r for i, r in constraints]
        free = self.system.acceleration(q, v, tau)
        if not index:
            return np.zeros((m, 3)), free, bases
        push = np.linalg.solve(self.system.mass_matrix(q), flat.T @ np.array(pulls).T)
        strength = -np.linalg.lstsq(flat[index] @ push, flat[index] @ free + rate.reshape(-1)[index], rcond=1e-11)[0]
        return (np.array(pulls).T @ strength).reshape(m, 3), free + push @ strength, bases

    def flow(self, q, v, duration, tangential, tau=None, event=None, rtol=1e-12):
        """(q, v, time) after `duration` [s] with these points in contact, Pinocchio coordinates, by DOP853.

        event(q, v_split): a function whose zero ends the motion before.
        """
        split = self.split

        def rhs(_t, y):
            x, u = split.normalize(y[: split.nq]), y[split.nq :]
            force = 0.0 if tau is None else split.tangent_map(x) @ tau
            return np.concatenate([split.rate(x, u), self.forces(x, u, tangential, force)[1]])

        def stop(_t, y):
            return event(split.normalize(y[: split.nq]), y[split.nq :])

        stop.terminal = True  # type: ignore[attr-defined]
        y0 = np.concatenate([q, split.tangent_map(q) @ v])
        run = solve_ivp(
            rhs, (0.0, duration), y0, method="DOP853", rtol=rtol, atol=rtol, events=None if event is None else stop
        )
        q1 = split.normalize(run.y[: split.nq, -1])
        return q1, split.tangent_map(q1).T @ run.y[split.nq :, -1], float(run.t[-1])
