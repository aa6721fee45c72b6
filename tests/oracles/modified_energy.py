"""Modified Hamiltonian of the midpoint step, with springs.

H~ = H + h^2 H2,  H2 = -1/24 ( G.a - dG.v + p.[v, a] ),  dG = dG/dt along the exact motion. Since
v.G = v.c - v.u with c = C v and u = g + spring gradient,  dG.v = d(v.c - v.u)/dt - a.G.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .del_step import System


def modified_energy(system: System, q: np.ndarray, p: np.ndarray, h: float) -> float:
    """H~_h(q, p) [J]; q, p in Pinocchio coordinates."""
    split, model, data = system.split, system.model, system.data
    p = split.tangent_map(q) @ p
    v = np.linalg.solve(system.mass_matrix(q), p)
    mv, dt_dq, g = system.dynamics(q, v)
    u = g - system.spring_force(q)
    a = pin.aba(model, data, q, v, system.spring_force(q)).copy()
    zero = np.zeros(system.nv)
    dg_dq = pin.computeGeneralizedGravityDerivatives(model, data, q).copy()
    dtau_dq, dtau_dv, _ = (m.copy() for m in pin.computeRNEADerivatives(model, data, q, v, zero))
    c = pin.rnea(model, data, q, v, zero) - g
    du_dq = dg_dq + system.spring_stiffness(q)
    total = dt_dq - u
    dg_v = v @ ((dtau_dq - dg_dq) - du_dq) @ v + a @ (c - u) + v @ dtau_dv @ a - a @ total
    h2 = -(total @ a - dg_v + mv @ split.bracket(v, a)) / 24.0
    return float(system.energy(q, v).sum() + h * h * h2)
