"""The midpoint variational step in dense NumPy on pin's matrices.

Equations, with q_m = q0 (+) h v/2 and G = dL/dq in the tangent space:
  p1 = Jv^-T [ P(q_m, v) + h/2 Jmv^T (G + F) ],   p0 = Jq^T p1 - h Jmq^T (G + F),   q1 = q0 (+) h v.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from . import so3
from .split import SplitModel


class System:
    """Lagrangian system: a model, joint springs and viscous damping.

    Parameters: stiffness (njoints,) [N/m or N m/rad] per joint of the original model, rest (nq,) rest
    configuration of the springs, damping (nv,) [N s/m or N m s/rad].
    """

    def __init__(self, model: pin.Model, stiffness=None, rest=None, damping=None):
        self.split = SplitModel(model)
        self.model, self.data, self.nv = self.split.model, self.split.data, self.split.nv
        self.damping = np.zeros(self.nv) if damping is None else np.asarray(damping, float)
        self.rest = pin.neutral(model) if rest is None else np.asarray(rest, float)
        self.springs = []
        for i, k in enumerate(np.zeros(model.njoints) if stiffness is None else stiffness):
            if k != 0.0:
                self.springs.append((self.split.joints[self.split.last[i] - 1], float(k)))

    # --- energy and its derivatives, split coordinates -------------------------------------------
    def mass_matrix(self, q):
        m = np.triu(pin.crba(self.model, self.data, q, pin.Convention.WORLD))
        return m + np.triu(m, 1).T

    def spring_force(self, q):
        """-dV/dq of the springs. On SO(3), V = k |log(R_rest^T R)|^2 / 2 and its gradient is k log."""
        f, w = np.zeros(self.nv), self.split.difference(self.rest, q)
        for j, k in self.springs:
            f[j.v] = -k * w[j.v]
        return f

    def spring_stiffness(self, q):
        """Derivative of -spring_force with respect to q in the tangent space, (nv, nv)."""
        s, w = np.zeros((self.nv, self.nv)), self.split.difference(self.rest, q)
        for j, k in self.springs:
            s[j.v, j.v] = k * (so3.right_jacobian_inverse(w[j.v]) if j.kind == "rotation" else np.eye(w[j.v].size))
        return s

    def energy(self, q, v):
        """[kinetic, potential] energy [J]; the potential includes the springs."""
        w = self.split.difference(self.rest, q)
        potential = pin.computePotentialEnergy(self.model, self.data, q)
        potential += sum(0.5 * k * w[j.v] @ w[j.v] for j, k in self.springs)
        return np.array([0.5 * v @ self.mass_matrix(q) @ v, potential])

    def dynamics(self, q, v):
        """M v, dT/dq (tangent space, v constant) and the generalized gravity g."""
        mv = self.mass_matrix(q) @ v
        c = pin.computeCoriolisMatrix(self.model, self.data, q, v).copy()
        g = pin.computeGeneralizedGravity(self.model, self.data, q).copy()
        return mv, c.T @ v - self.split.ad_star(v, mv), g

    def acceleration(self, q, v, tau=0.0):
        force = self.spring_force(q) - self.damping * v + tau
        return pin.aba(self.model, self.data, q, v, force).copy()

    # --- the step, split coordinates ---------------------------------------------------------------
    def both_momenta(self, q0, v, h, tau):
        """(p0, p1) of the midpoint step with mean velocity v; tau in public coordinates."""
        split = self.split
        q_mid = split.integrate(q0, 0.5 * h * v)
        mv, dt_dq, g = self.dynamics(q_mid, v)
        force = dt_dq - g + self.spring_force(q_mid) - self.damping * v + split.tangent_map(q_mid) @ tau
        jq, jv = split.jacobians(h * v)
        jmq, jmv = split.jacobians(0.5 * h * v)
        p1 = np.linalg.solve(jv.T, mv + 0.5 * h * jmv.T @ force)
        return jq.T @ p1 - h * jmq.T @ force, p1

    def split_step(self, q0, p0, h, tau=None, iterations=40):
        """(q1, p1, v) in split coordinates, solved until Newton no longer improves."""
        tau = np.zeros(self.nv) if tau is None else tau
        v = np.linalg.solve(self.mass_matrix(q0), p0)
        scale = 1.0 + np.abs(p0).max()
        best, best_v, stalled, jac = np.inf, v, 0, None
        for n in range(iterations):
            r = self.both_momenta(q0, v, h, tau)[0] - p0
            size = np.abs(r).max()
            if size < best:
                best, best_v, stalled = size, v, 0
            else:
                stalled += 1
            if stalled >= 2 or best == 0.0:
                break
            if jac is None or n in (3, 6):
                jac = self._jacobian(q0, v, h, tau)
            v = v - np.linalg.solve(jac, r)
        if best > 1e-12 * scale:  # far above rounding: the equations were not solved
            raise ArithmeticError(f"oracle Newton stopped at {best:.1e}")
        return self.split.integrate(q0, h * best_v), self.both_momenta(q0, best_v, h, tau)[1], best_v

    def _jacobian(self, q0, v, h, tau, eps=1e-5):
        columns = []
        for i in range(self.nv):
            d = np.zeros(self.nv)
            d[i] = eps * max(1.0, abs(v[i]))
            up, down = self.both_momenta(q0, v + d, h, tau)[0], self.both_momenta(q0, v - d, h, tau)[0]
            columns.append((up - down) / (2 * d[i]))
        return np.array(columns).T

    # --- public coordinates: v = Pinocchio's tangent velocity, p = M v ----------------------------------
    def step(self, q0, p0, h, tau=None):
        """(q1, p1) in Pinocchio coordinates."""
        q1, p1, _ = self.split_step(q0, self.split.tangent_map(q0) @ p0, h, tau)
        return q1, self.split.tangent_map(q1).T @ p1

    def residual(self, q0, p0, q1, p1, h, tau=None):
        """Both discrete Euler-Lagrange residuals of a finished step, public coordinates, stacked (2 nv,)."""
        tau = np.zeros(self.nv) if tau is None else tau
        v = self.split.difference(q0, q1) / h
        want0, want1 = self.both_momenta(q0, v, h, tau)
        r0 = want0 - self.split.tangent_map(q0) @ p0
        return np.concatenate([r0, want1 - self.split.tangent_map(q1) @ p1])

    def momentum(self, q, v):
        """Public p = M v from the public v (the tangent map is orthogonal)."""
        t = self.split.tangent_map(q)
        return t.T @ self.mass_matrix(q) @ t @ v

    def velocity(self, q, p):
        """Public v = M^-1 p."""
        t = self.split.tangent_map(q)
        return t.T @ np.linalg.solve(self.mass_matrix(q), t @ p)
