"""The linearised smooth motion of a pinocchio model along its true flow: the limit of the discrete A and B as h -> 0.

With da/dq, da/dv, da/dtau of `pin.computeABADerivatives` and delta the displacement in Pinocchio's tangent at q(t):
  delta' = dv - [v, delta],   dv' = da/dq delta + da/dv dv + da/dtau dtau
[ , ] the bracket of the configuration group (so(3), se(3), se(2), zero else), because v is a body velocity (Marsden,
Ratiu, "Introduction to Mechanics and Symmetry", 13.5). Integrated with q by DOP853 in the numbers of q.
State and columns: (delta at q0, dv0) -> (delta at q1, dv1), each 2 nv, all in Pinocchio's coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from scipy.linalg import expm

TOLERANCE = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}


@dataclass(frozen=True)
class Linearised:
    """q (nq,), v (nv,) at the end; A (2 nv, 2 nv) by the state at the start, B (2 nv, nv) by a constant tau."""

    q: np.ndarray
    v: np.ndarray
    A: np.ndarray
    B: np.ndarray


def aba_derivatives(model: pin.Model, q, v, tau=None, damping=None):
    """(a, da/dq, da/dv, da/dtau) of a = ABA(q, v, tau - damping v): (nv,) and (nv, nv) in Pinocchio's tangent at q.

    damping (nv,) [N s/m, N m s/rad] acts on Pinocchio's v. What a model itself carries of it is not used by pin.
    """
    tau = np.zeros(model.nv) if tau is None else np.asarray(tau, float)
    damping = np.zeros(model.nv) if damping is None else np.asarray(damping, float)
    data = model.createData()
    pin.computeABADerivatives(model, data, q, v, tau - damping * v)
    inverse = np.triu(data.Minv) + np.triu(data.Minv, 1).T
    return data.ddq.copy(), data.ddq_dq.copy(), data.ddq_dv - inverse * damping, inverse


def _joints(model: pin.Model):
    for j in list(model.joints)[1:]:
        name = j.shortname()
        yield (
            next((k for k in ("FreeFlyer", "Spherical", "Planar", "RUB", "RevoluteUnbounded") if k in name), "line"),
            j,
        )


def configuration_rate(model: pin.Model, q, v) -> np.ndarray:
    """dq/dt in the numbers of q, shape (nq,)."""
    rate = np.zeros(model.nq)
    for kind, j in _joints(model):
        x, w, at = q[j.idx_q : j.idx_q + j.nq], v[j.idx_v : j.idx_v + j.nv], slice(j.idx_q, j.idx_q + j.nq)
        if kind == "FreeFlyer":
            rate[at] = [*(_rotation(x[3:]) @ w[:3]), *_quaternion_rate(x[3:], w[3:])]
        elif kind == "Spherical":
            rate[at] = _quaternion_rate(x, w)
        elif kind == "Planar":
            c, s = x[2], x[3]
            rate[at] = [c * w[0] - s * w[1], s * w[0] + c * w[1], -s * w[2], c * w[2]]
        elif j.nq == 2:  # cosine and sine of one angle
            rate[at] = [-x[1] * w[0], x[0] * w[0]]
        else:
            rate[at] = w
    return rate


def _rotation(x) -> np.ndarray:
    return pin.Quaternion(x / np.linalg.norm(x)).matrix()


def _quaternion_rate(x, w) -> np.ndarray:
    """x o (w, 0) / 2 of a quaternion (x y z w) and a body angular velocity."""
    return 0.5 * np.array([*(x[3] * w + np.cross(x[:3], w)), -x[:3] @ w])


def _hat(w) -> np.ndarray:
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def bracket_matrix(model: pin.Model, v) -> np.ndarray:
    """ad_v (nv, nv): [v, w] = ad_v w in body coordinates."""
    ad = np.zeros((model.nv, model.nv))
    for kind, j in _joints(model):
        x, i = v[j.idx_v : j.idx_v + j.nv], j.idx_v
        if kind == "Spherical":
            ad[i : i + 3, i : i + 3] = _hat(x)
        elif kind == "FreeFlyer":
            turn, zero = _hat(x[3:]), np.zeros((3, 3))
            ad[i : i + 6, i : i + 6] = np.block([[turn, _hat(x[:3])], [zero, turn]])
        elif kind == "Planar":
            ad[i : i + 2, i : i + 3] = [[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]]]
    return ad


def flow_linearisation(model: pin.Model, q0, v0, duration: float, tau=None, damping=None) -> Linearised:
    """State, A and B after `duration` [s] under a constant tau (nv,)."""
    nq, nv = model.nq, model.nv
    start = np.hstack([np.eye(2 * nv), np.zeros((2 * nv, nv))])  # of (delta, dv), by the start and by tau

    def rhs(_t, y):
        q, v, columns = pin.normalize(model, y[:nq]), y[nq : nq + nv], y[nq + nv :].reshape(2 * nv, 3 * nv)
        a, a_q, a_v, a_tau = aba_derivatives(model, q, v, tau, damping)
        delta, dv = columns[:nv], columns[nv:]
        dv_rate = a_q @ delta + a_v @ dv
        dv_rate[:, 2 * nv :] += a_tau
        rates = np.vstack([dv - bracket_matrix(model, v) @ delta, dv_rate])
        return np.concatenate([configuration_rate(model, q, v), a, rates.ravel()])

    y0 = np.concatenate([q0, v0, start.ravel()])
    y = solve_ivp(rhs, (0.0, duration), y0, **TOLERANCE).y[:, -1]
    columns = y[nq + nv :].reshape(2 * nv, 3 * nv)
    return Linearised(pin.normalize(model, y[:nq]), y[nq : nq + nv], columns[:, : 2 * nv], columns[:, 2 * nv :])


def discretised(model: pin.Model, q, v, duration: float, tau=None, damping=None) -> tuple[np.ndarray, np.ndarray]:
    """(A, B) of the linear system frozen at (q, v), by expm: exact at an equilibrium, else to O(duration^2)."""
    nv = model.nv
    _, a_q, a_v, a_tau = aba_derivatives(model, q, v, tau, damping)
    rate = np.zeros((3 * nv, 3 * nv))
    rate[:nv, : 2 * nv] = np.hstack([-bracket_matrix(model, v), np.eye(nv)])
    rate[nv : 2 * nv] = np.hstack([a_q, a_v, a_tau])
    end = expm(duration * rate)
    return end[: 2 * nv, : 2 * nv], end[: 2 * nv, 2 * nv :]


def to_momenta(model: pin.Model, q, v) -> np.ndarray:
    """d(delta, p)/d(delta, v) of p = M(q) v, shape (2 nv, 2 nv): [[1, 0], [d(M v)/dq, M]].

    A in (q, p) is to_momenta(q1, v1) A to_momenta(q0, v0)^-1, B in (q, p) is to_momenta(q1, v1) B.
    """
    weightless, nv = pin.Model(model), model.nv
    weightless.gravity = pin.Motion.Zero()
    data = weightless.createData()
    pin.computeRNEADerivatives(weightless, data, q, np.zeros(nv), v)
    m = np.triu(pin.crba(model, model.createData(), q, pin.Convention.WORLD))
    return np.block([[np.eye(nv), np.zeros((nv, nv))], [data.dtau_dq, m + np.triu(m, 1).T]])
