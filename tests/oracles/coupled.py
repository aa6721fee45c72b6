"""Motion of a robot with coupled joints, by its equations in the coordinates that are left; Pinocchio and SciPy.

q = c + S y, v = S u: S^T M(q) S u' = S^T (tau - b(q, v)), which DOP853 solves to rounding.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp


class Coupled:
    """A model whose joints have one number in q each, with followers {joint: (leader, ratio, offset)} by name.

    stiffness, damping and armature: {joint: number}; springs are relaxed at q = 0.
    """

    def __init__(self, model, followers, stiffness=None, damping=None, armature=None):
        self.model, self.data = model, model.createData()
        nv = model.nv

        def of(name):
            return model.idx_vs[model.getJointId(name)]

        S, c, led = np.eye(nv), np.zeros(nv), []
        left = dict(followers)
        while left:  # a chain is composed from its head
            for name, (leader, ratio, offset) in list(left.items()):
                if leader in left:
                    continue
                i, j = of(name), of(leader)
                S[i], c[i] = ratio * S[j], offset + ratio * c[j]
                led.append(i)
                del left[name]
        self.c, self.S = c, np.delete(S, led, axis=1)
        self.free = [i for i in range(nv) if i not in led]
        arrays = []
        for given in (stiffness, damping, armature):
            values = np.zeros(nv)
            for name, value in (given or {}).items():
                values[of(name)] = value
            arrays.append(values)
        self.stiffness, self.damping, self.armature = arrays

    def q(self, y):
        return self.c + self.S @ y

    def mass(self, q):
        M = np.triu(pin.crba(self.model, self.data, q))
        return self.S.T @ (M + np.triu(M, 1).T + np.diag(self.armature)) @ self.S

    def acceleration(self, y, u, tau=0.0):
        q, v = self.q(y), self.S @ u
        force = tau - pin.nonLinearEffects(self.model, self.data, q, v) - self.stiffness * q - self.damping * v
        return np.linalg.solve(self.mass(q), self.S.T @ force)

    def energy(self, y, u):
        q = self.q(y)
        pin.computePotentialEnergy(self.model, self.data, q)
        return 0.5 * u @ self.mass(q) @ u + self.data.potential_energy + 0.5 * self.stiffness @ q**2

    def run(self, y, u, duration, tau=0.0, limits=(), restitution=1.0):
        """Return q and v at the end, (nv,) each, and the times of impacts at limits.

        limits: (joint, bound, +1 for a lower one and -1 for an upper one); Newton's law with this restitution.
        """
        n = len(y)
        t, x, hits = 0.0, np.append(y, u), []
        rows = [(self.model.idx_vs[self.model.getJointId(name)], bound, sign) for name, bound, sign in limits]

        def rates(_t, x):
            return np.append(x[n:], self.acceleration(x[:n], x[n:], tau))

        def gap(dof, bound, sign):
            def event(_t, x):
                return sign * (self.q(x[:n])[dof] - bound)

            event.terminal, event.direction = True, -1.0
            return event

        events = [gap(*row) for row in rows]
        while t < duration:
            found = solve_ivp(rates, (t, duration), x, method="DOP853", rtol=3e-14, atol=1e-14, events=events)
            t, x = found.t[-1], found.y[:, -1].copy()
            for (dof, _, sign), times in zip(rows, found.t_events or [], strict=True):
                if not len(times):
                    continue
                w = sign * self.S[dof]
                along = np.linalg.solve(self.mass(self.q(x[:n])), w)
                x[n:] -= (1.0 + restitution) * (w @ x[n:]) / (w @ along) * along
                hits.append(t)
        return self.q(x[:n]), self.S @ x[n:], np.array(hits)
