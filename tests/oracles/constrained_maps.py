"""DTEC and MHC with constraints phi(q, t) = 0 in slow NumPy: the constrained step, its two energies, and the impact.

One step of h from (q0, p0) at t0, with Phi = d phi/dq as columns and both momenta of the smooth step
(oracles.del_step):
  p0(v) = p0 + Phi_0 Lam,  phi(q0 + h v, t0 + h) = 0;   p1 = p^-(v) + Phi_1 Lam',  Phi_1^T M^-1 p1 + d phi/dt = 0.
A force of a constraint does the work -Lam . d phi/dt. At an impact p+ = p- + lam W', W' the gradient of the gap with
the impulses of the constraints, and what DTEC and MHC conserve, less the loss, is
  DTEC  E_d of the parts of the step, with the work of the constraints between the middles of both parts,
  MHC   H~_h = H + h^2 H2 at both ends of the step, with the work of the constraints over it,
        H2 = -(G.a - dG.v - f.(Phi^T a)) / 24, a the constrained acceleration and f the forces of the constraints.
Models whose joints have one degree of freedom; no friction, damping or inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from .constraints import Constraint, Motion
from .del_step import System
from .dtec_mhc import find_root


@dataclass(frozen=True)
class Step:
    """A finished step: q, p at its end, its velocity v, its length, impulses at both ends, d phi/dt there."""

    q: np.ndarray
    p: np.ndarray
    v: np.ndarray
    h: float
    start: np.ndarray
    end: np.ndarray
    start_rate: np.ndarray
    end_rate: np.ndarray

    @property
    def work_at_start(self) -> float:
        return -float(self.start @ self.start_rate)

    @property
    def work_at_end(self) -> float:
        return -float(self.end @ self.end_rate)


class ConstrainedSystem:
    """A Lagrangian system with constraints; its states are (q, p, t)."""

    def __init__(self, model: pin.Model, constraints: Sequence[Constraint]):
        self.system, self.constraints = System(model), list(constraints)
        self.model, self.nv = model, model.nv

    def rows(self, q: np.ndarray, t: float, v: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """phi, Phi (nv, m), d phi/dt, and what is left of the second derivative in time at zero acceleration."""
        v = np.zeros(self.nv) if v is None else v
        motion = Motion(self.model, q, v)
        jets = [c.jet(motion, t) for c in self.constraints]
        value, rate, bias = (np.concatenate([getattr(j, name) for j in jets]) for name in ("value", "rate", "bias"))
        jac = np.vstack([j.jac for j in jets])
        return value, jac.T, rate - jac @ v, bias

    def step(self, q0: np.ndarray, p0: np.ndarray, t0: float, h: float) -> Step:
        s = self.system
        _, start, start_rate, _ = self.rows(q0, t0)
        v = np.linalg.solve(s.mass_matrix(q0), p0)
        impulse = np.zeros(start.shape[1])

        def residual(v: np.ndarray, impulse: np.ndarray) -> np.ndarray:
            phi = self.rows(q0 + h * v, t0 + h)[0]
            return np.concatenate([s.both_momenta(q0, v, h, np.zeros(self.nv))[0] - p0 - start @ impulse, phi / h])

        best, found = np.inf, (v, impulse)
        for _ in range(30):
            r = residual(v, impulse)
            if np.abs(r).max() < best:
                best, found = np.abs(r).max(), (v, impulse)
            elif best < 1e-12 * (1.0 + np.abs(p0).max()):
                break
            e = 1e-5 * np.eye(self.nv)
            by_velocity = np.column_stack([(residual(v + d, impulse) - residual(v - d, impulse)) / 2e-5 for d in e])
            m = start.shape[1]
            J = np.column_stack([by_velocity, np.vstack([-start, np.zeros((m, m))])])
            change = np.linalg.lstsq(J, -r, rcond=1e-9)[0]
            v, impulse = v + change[: self.nv], impulse + change[self.nv :]
        assert best < 1e-11 * (1.0 + np.abs(p0).max()), f"the step was not solved: {best}"
        v, impulse = found
        q1, p1 = q0 + h * v, s.both_momenta(q0, v, h, np.zeros(self.nv))[1]
        _, end, end_rate, _ = self.rows(q1, t0 + h)
        answer = np.linalg.solve(s.mass_matrix(q1), np.column_stack([end, p1]))
        last = -np.linalg.pinv(end.T @ answer[:, :-1], rcond=1e-9) @ (end.T @ answer[:, -1] + end_rate)
        return Step(q1, p1 + end @ last, v, h, impulse, last, start_rate, end_rate)

    def discrete_energy(self, q0: np.ndarray, step: Step) -> float:
        return float(self.system.energy(q0 + 0.5 * step.h * step.v, step.v).sum())

    def modified_energy(self, q: np.ndarray, p: np.ndarray, t: float, h: float) -> float:
        s = self.system
        M = s.mass_matrix(q)
        v = np.linalg.solve(M, p)
        _, rows, _, bias = self.rows(q, t, v)
        free = s.acceleration(q, v)
        answer = np.linalg.solve(M, rows)
        force = -np.linalg.pinv(rows.T @ answer, rcond=1e-9) @ (rows.T @ free + bias)
        a = free + answer @ force

        def slope(q: np.ndarray, v: np.ndarray) -> np.ndarray:  # dL/dq
            _, dt_dq, g = s.dynamics(q, v)
            return dt_dq - g

        e = 1e-3  # its derivative along the motion, of fourth order
        nodes = {k: slope(q + k * e * v, v + k * e * a) for k in (-2, -1, 1, 2)}
        turning = (8.0 * (nodes[1] - nodes[-1]) - nodes[2] + nodes[-2]) / (12.0 * e)
        h2 = -(slope(q, v) @ a - turning @ v + force @ bias) / 24.0
        return float(s.energy(q, v).sum() + h * h * h2)

    def impact(self, before: Step, q0: np.ndarray, p0: np.ndarray, t0: float, gradient: np.ndarray, e: float,
               after: float, method: str) -> tuple[float, np.ndarray]:  # fmt: skip
        """(lam, p+) of the impact at the end of the step `before` from (q0, p0, t0), `after` before its own end."""
        s, q, p, h = self.system, before.q, before.p, before.h + after
        t = t0 + before.h
        _, rows, rate, _ = self.rows(q, t)
        answer = np.linalg.solve(s.mass_matrix(q), np.column_stack([rows, gradient]))
        share = np.linalg.pinv(rows.T @ answer[:, :-1], rcond=1e-9) @ (rows.T @ answer[:, -1])
        row = gradient - rows @ share
        inverse = float(row @ np.linalg.solve(s.mass_matrix(q), row))
        closing = float(gradient @ np.linalg.solve(s.mass_matrix(q), p))
        loss = (1.0 - e * e) * closing**2 / (2.0 * inverse)
        driven = float(share @ rate)  # work of the constraints per unit of lam

        def scalar(plus: np.ndarray) -> float:
            rest = self.step(q, plus, t, after)
            if method == "dtec":
                return self.discrete_energy(q, rest) - rest.work_at_start
            return self.modified_energy(rest.q, rest.p, t + after, h) - rest.work_at_start - rest.work_at_end

        if method == "dtec":
            target = self.discrete_energy(q0, before) + before.work_at_end
        else:
            target = self.modified_energy(q0, p0, t0, h) + before.work_at_start + before.work_at_end
        plastic = -closing / inverse
        lam = find_root(
            lambda lam: scalar(p + lam * row) - lam * driven - (target - loss), plastic, (1 + e) * plastic,
            1e-3 * plastic,
        )  # fmt: skip
        return lam, p + lam * row
