"""The Galerkin-Gauss step of order 2s in dense NumPy on pin's matrices.

Discrete Lagrangian: L_d(q0, q1) = ext h sum_i b_i L(q_i, v_i) over polynomials X(t) of degree s in the chart
q(X) = q0 (+) X, with X(0) = 0 and q0 (+) X(h) = q1; q_i = q0 (+) X_i, v_i = J(X_i) X'_i, J the right Jacobian. Its
Euler-Lagrange equations, with Ad(X) = d(q (+) X)/dq and G_i + F_i the force at stage i, are
  J_i^T M v_i = px0 + h sum_j a_ij f_j,   f_i = J_i^T (G_i + F_i) + (d(J(X) X'_i)/dX)^T M v_i
  p1 = Ad(X_1)^-T (p0 + h sum_i b_i Ad(X_i)^T (G_i + F_i)),   px0 = J(X_1)^T p1 - h sum_i b_i f_i
so that the rates X'_i are the only unknowns. The derivative of J X' is taken as it stands, without the identity that
turns it into ad* and J'.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from . import so3
from .del_step import System

# Below this angle [rad] the derivatives by t of (1 - cos t)/t^2 and (t - sin t)/t^3, divided by t, come from series.
SERIES_ANGLE = 1.0


def gauss_table(s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(c, b, A) of s Gauss points on [0, 1] by Legendre polynomials: shapes (s,), (s,), (s, s)."""
    x, w = np.polynomial.legendre.leggauss(s)
    values = np.polynomial.legendre.legvander(x, s)  # P_k(x_i)
    a = np.tile(0.5 * (x[:, None] + 1.0), (1, s))
    for k in range(1, s):
        a += 0.5 * np.outer(values[:, k + 1] - values[:, k - 1], values[:, k])
    return 0.5 * (x + 1.0), 0.5 * w, a * (0.5 * w)


def right_jacobian_derivative(phi: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Derivative of so3.right_jacobian at phi along d, shape (3, 3)."""
    t, x, y = float(np.linalg.norm(phi)), so3.hat(phi), so3.hat(d)
    if t > SERIES_ANGLE:
        one = (t * math.sin(t) - 2.0 * (1.0 - math.cos(t))) / t**4
        three = (t * (1.0 - math.cos(t)) - 3.0 * (t - math.sin(t))) / t**5
    else:
        one, three = (
            sum((-1) ** k * 2 * k * t ** (2 * k - 2) / math.factorial(2 * k + n) for k in range(1, 12)) for n in (2, 3)
        )
    b, c = so3._one_minus_cos_over_square(t), so3._t_minus_sin_over_cube(t)
    return -b * y + c * (x @ y + y @ x) + float(phi @ d) * (three * x @ x - one * x)


@dataclass(frozen=True)
class Solved:
    """A solved step in split coordinates: q1 (nq,), p1 (nv,), rates X' (s, nv), stages q (s, nq) and v (s, nv)."""

    q1: np.ndarray
    p1: np.ndarray
    rates: np.ndarray
    q: np.ndarray
    v: np.ndarray


class GaussStep:
    """The step with s stages of a System (with its springs and damping)."""

    def __init__(self, system: System, stages: int):
        self.system, self.split, self.s, self.nv = system, system.split, stages, system.nv
        self.c, self.b, self.a = gauss_table(stages)

    # --- equations, split coordinates --------------------------------------------------------------
    def stage(self, q0, x, rate, tau):
        """(q, v, M v, J^T M v, G + F, f, Ad) at the chart point x with chart rate `rate`."""
        system, split = self.system, self.split
        q, (ad, j) = split.integrate(q0, x), split.jacobians(x)
        v = j @ rate
        mv, dt_dq, g = system.dynamics(q, v)
        force = dt_dq - g + system.spring_force(q) - system.damping * v + split.tangent_map(q) @ tau
        f = j.T @ force
        for joint in split.joints:
            if joint.kind == "rotation":
                i = joint.v
                turns = [right_jacobian_derivative(x[i], e) @ rate[i] for e in np.eye(3)]
                f[i] += np.array(turns) @ mv[i]
        return q, v, mv, j.T @ mv, force, f, ad

    def equations(self, q0, p0, h, rates, tau):
        """Stage residuals px_i - J_i^T M v_i (s, nv), p1 (nv,), X_1 (nv,), stages q and v, for any rates (s, nv)."""
        x1, points = h * self.b @ rates, h * self.a @ rates
        stages = [self.stage(q0, x, r, tau) for x, r in zip(points, rates, strict=True)]
        q, v, _, px, force, f, ad = (list(column) for column in zip(*stages, strict=True))
        ad1, j1 = self.split.jacobians(x1)
        pushed = p0 + h * sum(b * m.T @ w for b, m, w in zip(self.b, ad, force, strict=True))
        p1 = np.linalg.solve(ad1.T, pushed)
        px0 = j1.T @ p1 - h * self.b @ f
        return px0 + h * self.a @ f - px, p1, x1, np.array(q), np.array(v)

    def _preconditioner(self, q0, h):
        """Inverse of the derivative of J^T M v - h a f at X' = 0, without gravity and gyroscopic terms."""
        system, one = self.system, np.eye(self.s)
        m = np.kron(one, system.mass_matrix(q0)) + h * np.kron(self.a, np.diag(system.damping))
        return np.linalg.inv(m + h * h * np.kron(self.a @ self.a, system.spring_stiffness(q0)))

    def split_step(self, q0, p0, h, tau=None, iterations=200, depth=12) -> Solved:
        """Fixed-point iterations on the rates with Anderson's acceleration, until they no longer improve."""
        tau = np.zeros(self.nv) if tau is None else tau
        shape, inverse = (self.s, self.nv), self._preconditioner(q0, h)
        x = np.tile(np.linalg.solve(self.system.mass_matrix(q0), p0), self.s)
        best, best_x, stalled = np.inf, x, 0
        points: list[np.ndarray] = []
        changes: list[np.ndarray] = []
        scale = 1.0 + np.abs(p0).max()
        for n in range(iterations):
            r = self.equations(q0, p0, h, x.reshape(shape), tau)[0].ravel()
            size = np.abs(r).max()
            scale += size if n == 0 else 0.0  # with the impulses of the forces
            stalled = 0 if size < 0.9 * best else stalled + 1
            if size < best:
                best, best_x = size, x
            if best == 0.0 or (stalled >= 6 and best <= 1e-12 * scale) or not np.isfinite(size):
                break
            points.append(x)
            changes.append(inverse @ r)
            x = _anderson(points[-depth:], changes[-depth:])
        if not best <= 1e-12 * scale:  # far above rounding: the equations were not solved
            raise ArithmeticError(f"the oracle's iterations stopped at {best:.1e}")
        rates = best_x.reshape(shape)
        _, p1, x1, q, v = self.equations(q0, p0, h, rates, tau)
        return Solved(self.split.integrate(q0, x1), p1, rates, q, v)

    def rates_of(self, h, v):
        """Chart rates X' (s, nv) of the stage velocities v (s, nv), by fixed point."""
        rates = v.copy()
        for _ in range(100):
            jacobians = [self.split.jacobians(x)[1] for x in h * self.a @ rates]
            new = np.array([np.linalg.solve(j, w) for j, w in zip(jacobians, v, strict=True)])
            if np.abs(new - rates).max() <= 4e-16 * (1.0 + np.abs(v).max()):
                return new
            rates = new
        return rates

    # --- public coordinates: v = Pinocchio's tangent velocity, p = M v ----------------------------------
    def solve(self, q0, p0, h, tau=None) -> Solved:
        """The solved step (split coordinates) from q0, p0 in Pinocchio coordinates."""
        return self.split_step(q0, self.split.tangent_map(q0) @ p0, h, tau)

    def step(self, q0, p0, h, tau=None):
        """(q1, p1) in Pinocchio coordinates."""
        done = self.solve(q0, p0, h, tau)
        return done.q1, self.split.tangent_map(done.q1).T @ done.p1

    def energy_of_stages(self, done: Solved) -> float:
        """Discrete energy E_d = sum b_i E(q_i, v_i) [J]."""
        return float(sum(b * self.system.energy(q, v).sum() for b, q, v in zip(self.b, done.q, done.v, strict=True)))

    def discrete_energy(self, q0, p0, h, tau=None) -> float:
        """E_d [J] of the step of h [s] from (q0, p0)."""
        return self.energy_of_stages(self.solve(q0, p0, h, tau))

    def residual(self, q0, p0, h, v, q1, p1, tau=None):
        """What a step with stage velocities v (s, nv; split) leaves in the stages' momenta (s, nv), q1 and p1 (nv,)."""
        tau = np.zeros(self.nv) if tau is None else tau
        split = self.split
        r, want_p1, x1, *_ = self.equations(q0, split.tangent_map(q0) @ p0, h, self.rates_of(h, v), tau)
        return r, split.difference(split.integrate(q0, x1), q1), split.tangent_map(q1) @ p1 - want_p1


def _anderson(points, changes):
    """Next point of x <- x + change(x) from the last ones: Walker and Ni 2011, the differences in least squares."""
    if len(points) == 1:
        return points[0] + changes[0]
    dx = np.array([b - a for a, b in zip(points, points[1:], strict=False)]).T
    df = np.array([b - a for a, b in zip(changes, changes[1:], strict=False)]).T
    size = np.linalg.norm(df, axis=0)
    size[size == 0.0] = 1.0
    weights = np.linalg.lstsq(df / size, changes[-1], rcond=1e-12)[0] / size
    return points[-1] + changes[-1] - (dx + df) @ weights
