"""Reference for smooth motion: pin.aba integrated by DOP853 in the numbers of q."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from .del_step import System


def flow(
    system: System, q0: np.ndarray, v0: np.ndarray, duration: float, tau: np.ndarray | None = None, rtol: float = 1e-12
):
    """(q, v) after `duration` [s] from the state (q0, v0), Pinocchio coordinates.

    tau: constant generalized force in Pinocchio coordinates, shape (nv,).
    """
    split, nq = system.split, system.split.nq
    tau = np.zeros(system.nv) if tau is None else tau

    def rhs(_t, y):
        q, v = split.normalize(y[:nq]), y[nq:]
        return np.concatenate([split.rate(q, v), system.acceleration(q, v, split.tangent_map(q) @ tau)])

    y0 = np.concatenate([q0, split.tangent_map(q0) @ v0])
    y = solve_ivp(rhs, (0.0, duration), y0, method="DOP853", rtol=rtol, atol=rtol).y[:, -1]
    q = split.normalize(y[:nq])
    return q, split.tangent_map(q).T @ y[nq:]
