"""Laws that any step (q0, p0) -> (q1, p1) in Pinocchio coordinates must keep; nothing here knows the method."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pinocchio as pin

Step = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
_STENCIL = ((-3, -1 / 60), (-2, 9 / 60), (-1, -45 / 60), (1, 45 / 60), (2, -9 / 60), (3, 1 / 60))


def mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Symmetric M(q), shape (nv, nv)."""
    m = np.triu(pin.crba(model, model.createData(), q, pin.Convention.WORLD))
    return m + np.triu(m, 1).T


def retract(model: pin.Model, q: np.ndarray, w: np.ndarray) -> np.ndarray:
    """q moved along w [Pinocchio's tangent], to first order pin.integrate; free-flyers and planar joints without exp6.

    pin's SE(2) and SE(3) logarithms lose up to seven digits at small angles (seen as 1e-9 here), so rotation and
    translation are moved separately, which has the same derivative at w = 0.
    """
    out = pin.integrate(model, q, w)
    for j in list(model.joints)[1:]:
        x, a = q[j.idx_q : j.idx_q + j.nq], w[j.idx_v : j.idx_v + j.nv]
        if j.shortname().endswith("FreeFlyer"):
            out[j.idx_q : j.idx_q + 3] = x[:3] + pin.Quaternion(x[3:]).matrix() @ a[:3]
        elif j.shortname().endswith("Planar"):
            out[j.idx_q : j.idx_q + 2] = x[:2] + np.array([[x[2], -x[3]], [x[3], x[2]]]) @ a[:2]
    return out


def displacement(model: pin.Model, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
    """Inverse of `retract`, shape (nv,)."""
    w = pin.difference(model, q0, q1)
    for j in list(model.joints)[1:]:
        x, y, iv = q0[j.idx_q : j.idx_q + j.nq], q1[j.idx_q : j.idx_q + j.nq], j.idx_v
        if j.shortname().endswith("FreeFlyer"):
            w[iv : iv + 3] = pin.Quaternion(x[3:]).matrix().T @ (y[:3] - x[:3])
        elif j.shortname().endswith("Planar"):
            w[iv : iv + 2] = np.array([[x[2], x[3]], [-x[3], x[2]]]) @ (y[:2] - x[:2])
            w[iv + 2] = np.arctan2(x[2] * y[3] - x[3] * y[2], x[2] * y[2] + x[3] * y[3])
        elif (j.nq, j.nv) == (2, 1):  # pin's SO(2) logarithm is good to 1e-9 only
            w[iv] = np.arctan2(x[0] * y[1] - x[1] * y[0], x @ y)
    return w


def bracket(model: pin.Model, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Lie bracket of the configuration group in Pinocchio's body coordinates: so(3), se(3), se(2), else 0."""
    c = np.zeros(model.nv)
    for j in list(model.joints)[1:]:
        name, s = j.shortname(), slice(j.idx_v, j.idx_v + j.nv)
        x, y = a[s], b[s]
        if name.endswith("Spherical"):
            c[s] = np.cross(x, y)
        elif name.endswith("FreeFlyer"):
            c[s] = pin.Motion(x.copy()).cross(pin.Motion(y.copy())).vector
        elif name.endswith("Planar"):
            turn = np.array([[0.0, -1.0], [1.0, 0.0]])
            c[s][:2] = x[2] * turn @ y[:2] - y[2] * turn @ x[:2]
    return c


def canonical_form(model: pin.Model, p: np.ndarray, xi: np.ndarray, pi: np.ndarray) -> np.ndarray:
    """Omega of the tangent vectors (xi[:, i], pi[:, i]): xi left-trivialised, pi the change of the numbers of p.

    Omega = -d(<p, xi>). For left-invariant fields d theta(X, Y) = X theta(Y) - Y theta(X) - theta([X, Y]), so
    Omega(X, Y) = <pi_Y, xi_X> - <pi_X, xi_Y> + <p, [xi_X, xi_Y]>.
    """
    unit = np.eye(model.nv)
    structure = np.zeros((model.nv, model.nv))  # <p, [e_i, e_j]>
    for joint in list(model.joints)[1:]:
        indices = range(joint.idx_v, joint.idx_v + joint.nv)
        for i, j in itertools.combinations(indices, 2):
            structure[i, j] = p @ bracket(model, unit[i], unit[j])
            structure[j, i] = -structure[i, j]
    return xi.T @ pi - pi.T @ xi + xi.T @ structure @ xi


def symplectic_defect(model: pin.Model, step: Step, q: np.ndarray, p: np.ndarray, eps: float = 3e-3) -> float:
    """max |Omega_1(Df X, Df Y) - Omega_0(X, Y)| / max |Omega_0|, Df by sixth-order central differences.

    Momenta are varied by M e_i, i.e. by unit velocities, so light links are not blown up. With eps = 3e-3
    the differences are good to some 1e-13 (measured on the oracle), a solver error d enters as about d/eps.
    """
    n, m = model.nv, mass_matrix(model, q)
    xi0, pi0 = np.hstack([np.eye(n), np.zeros((n, n))]), np.hstack([np.zeros((n, n)), m])
    q1, p1 = step(q, p)
    xi1, pi1 = np.zeros((n, 2 * n)), np.zeros((n, 2 * n))
    for i in range(2 * n):
        for s, weight in _STENCIL:
            qs, ps = step(retract(model, q, s * eps * xi0[:, i]), p + s * eps * pi0[:, i])
            xi1[:, i] += weight / eps * displacement(model, q1, qs)
            pi1[:, i] += weight / eps * (ps - p1)
    before = canonical_form(model, p, xi0, pi0)
    return float(np.abs(canonical_form(model, p1, xi1, pi1) - before).max() / np.abs(before).max())


def orders(errors) -> np.ndarray:
    """log2 of the ratios of successive errors under halving."""
    e = np.asarray(errors, float)
    return np.log2(e[:-1] / e[1:])


def distance(model: pin.Model, a: tuple, b: tuple) -> float:
    """Error of a state (q, v) in tangent coordinates."""
    return float(np.linalg.norm(np.concatenate([displacement(model, a[0], b[0]), a[1] - b[1]])))


def run(step: Step, q: np.ndarray, p: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """State after n steps."""
    for _ in range(n):
        q, p = step(q, p)
    return q, p
