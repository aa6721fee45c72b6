"""All first and second derivatives of the midpoint variational step, with the names of trep.

Johnson, Murphey, "Scalable variational integrators for constrained mechanical systems in generalized coordinates",
2009, and trep's `MidpointVI` and `DSystem`: discrete Lagrangian and forces
  L_d(q0, q1) = h L((q0 + q1)/2, (q1 - q0)/h)       f = h F((q0 + q1)/2, (q1 - q0)/h, u)
  0 = p0 + D1 L_d + (1 - part) f                    p1 = D2 L_d + part f
part = 1/2 gives half of the force's impulse to each end, as the step of oracles.derivative_step does; part = 0 is
trep's choice (f_d^- = f, f_d^+ = 0), whose momenta are lower by h F/2.
With X = (q0, p0), U = tau, the map X1 = f(X, U) = (q1, p1) is differentiated by the implicit function theorem in
Decimal; the derivatives of the two equations come by dual numbers, three deep.
"""

from __future__ import annotations

import decimal
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from . import precise
from .derivative_step import Motion, velocity
from .precise import gradient


@dataclass(frozen=True)
class Derivatives:
    """f (2n,), fdx (2n, 2n), fdu (2n, m); fdxdx (2n, 2n, 2n), fdxdu (2n, 2n, m), fdudu (2n, m, m), index of f first."""

    f: np.ndarray
    fdx: np.ndarray
    fdu: np.ndarray
    fdxdx: np.ndarray
    fdxdu: np.ndarray
    fdudu: np.ndarray

    def contracted(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(fdxdx(z), fdxdu(z), fdudu(z)) as trep returns them: sum_k z_k d2f_k."""
        return tuple(np.tensordot(z, t, 1) for t in (self.fdxdx, self.fdxdu, self.fdudu))  # type: ignore[return-value]


def _equations(motion: Motion, x: dict, part):
    """y = (q0, p0, tau, q1) -> the two right sides above, as one list (2n,)."""
    n, h = len(x["q0"]), x["h"]
    m = len(x["tau"])

    def discrete_lagrangian(ends):
        middle = [(a + b) / 2 for a, b in zip(ends[:n], ends[n:], strict=True)]
        return h * motion.lagrangian(middle, [(b - a) / h for a, b in zip(ends[:n], ends[n:], strict=True)], x)

    def equations(y):
        q0, p0, tau, q1 = y[:n], y[n : 2 * n], y[2 * n : 2 * n + m], y[2 * n + m :]
        slope = gradient(discrete_lagrangian, [*q0, *q1])[1]
        middle, v = (
            [(a + b) / 2 for a, b in zip(q0, q1, strict=True)],
            [(b - a) / h for a, b in zip(q0, q1, strict=True)],
        )
        force = motion.force(middle, v, {**x, "tau": tau})
        start = [p + d + (1 - part) * h * f for p, d, f in zip(p0, slope[:n], force, strict=True)]
        return [*start, *(d + part * h * f for d, f in zip(slope[n:], force, strict=True))]

    return equations


def _end(motion: Motion, x: dict, part) -> list:
    """q1 in Decimal."""
    n, plain = len(x["q0"]), precise.as_floats(x)

    def unknown(x, part):
        return lambda q1: _equations(motion, x, part)([*x["q0"], *x["p0"], *x["tau"], *q1])[:n]

    start = plain["q0"] + plain["h"] * velocity(motion, plain["q0"], plain["p0"], plain)
    return list(precise.refine(unknown(x, part), *precise.newton(unknown(plain, float(part)), start), Decimal))


def derivatives(motion: Motion, inputs: precise.Inputs, part: float = 0.5) -> Derivatives:
    """Of one step; inputs as in oracles.derivative_step, with q0, p0, tau and h."""
    with decimal.localcontext() as context:
        context.prec = precise.DIGITS
        x = precise.as_decimals(inputs)
        n, m, equations = len(x["q0"]), len(x["tau"]), _equations(motion, x, Decimal(part))
        y = [*x["q0"], *x["p0"], *x["tau"], *_end(motion, x, Decimal(part))]
        size, known = len(y), 2 * n + m
        value, first = gradient(equations, y)
        flat = gradient(lambda y: list(gradient(equations, y)[1].ravel()), y)[1]
        second = flat.reshape(2 * n, size, size)

        # q1(q0, p0, tau) from the first n equations, `whole` = d(q0, p0, tau, q1)/d(q0, p0, tau)
        slope = -precise.solve_linear(first[:n, known:], first[:n, :known])
        whole = np.vstack([_identity(known), slope])
        bent = np.array([whole.T @ t @ whole for t in second])
        curve = -precise.solve_linear(first[:n, known:], bent[:n].reshape(n, -1))
        d1 = np.vstack([slope, first[n:] @ whole])
        d2 = np.vstack([curve, bent[n:].reshape(n, -1) + first[n:, known:] @ curve]).reshape(2 * n, known, known)
        f, d1, d2 = (t.astype(float) for t in (np.array([*y[known:], *value[n:]]), d1, d2))
    k = 2 * n
    return Derivatives(f, d1[:, :k], d1[:, k:], d2[:, :k, :k], d2[:, :k, k:], d2[:, k:, k:])


def _identity(n: int) -> np.ndarray:
    return np.array([[Decimal(int(i == j)) for j in range(n)] for i in range(n)], dtype=object)
