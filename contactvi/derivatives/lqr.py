"""The time-varying linear-quadratic regulator of discrete steps: the Riccati recursion."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve, solve_discrete_are

from contactvi import inputs
from contactvi.errors import InputError

Array = NDArray[np.float64]
Weight = ArrayLike | Callable[[int], ArrayLike]  # one matrix for all k, or a function of k


class LqrSolution(NamedTuple):
    """Gains K (N, inputs, states) and the matrix P (states, states) of the cost-to-go from k = 0."""

    K: Array
    P: Array


def solve_tv_lqr(A: ArrayLike, B: ArrayLike, Q: Weight, R: Weight, *, end: str | ArrayLike = "Q") -> LqrSolution:
    """Return the gains K[k] of the inputs -K[k] x[k] of least cost, and P, x[0]^T P x[0] being twice that cost.

    The system is x[k+1] = A[k] x[k] + B[k] u[k], the cost half the sum of x^T Q(k) x + u^T R(k) u and of the end.

    Args:
        A, B: (N, n, n) and (N, n, m).
        Q, R: weights (n, n) and (m, m), or functions of k that return them; Q also for k = N.
        end: weight of the last state: "Q": Q(N); "stationary": that of infinitely many more steps with the last A, B,
            Q and R (scipy.linalg.solve_discrete_are); or a matrix (n, n).
    """
    a = np.asarray(A, dtype=float)
    b = np.asarray(B, dtype=float)
    if a.ndim != 3 or b.ndim != 3 or a.shape[1] != a.shape[2] or a.shape[:2] != b.shape[:2] or not len(a):
        raise InputError(
            "A and B are no linear system", name="A, B", expected="shapes (N, n, n) and (N, n, m)",
            got=f"{a.shape} and {b.shape}", remedy="Give those of linearize_trajectory",
        )  # fmt: skip
    count, n, m = b.shape
    P = _end_weight(a[-1], b[-1], Q, R, count, end)
    gains = np.zeros((count, m, n))
    for k in reversed(range(count)):
        weighted = b[k].T @ P
        gains[k] = solve(_weight("R", R, k, m) + weighted @ b[k], weighted @ a[k], assume_a="sym")
        P = _weight("Q", Q, k, n) + a[k].T @ P @ (a[k] - b[k] @ gains[k])
        P = 0.5 * (P + P.T)
    return LqrSolution(gains, P)


def _end_weight(a: Array, b: Array, Q: Weight, R: Weight, count: int, end: str | ArrayLike) -> Array:
    if not isinstance(end, str):
        return inputs.array("end", end, a.shape, "the weight of the last state")
    inputs.check_choice("end", end, ("Q", "stationary"), "Unknown end of the LQR problem")
    Q_end = _weight("Q", Q, count, len(a))
    if end == "Q":
        return Q_end
    return np.asarray(solve_discrete_are(a, b, Q_end, _weight("R", R, count - 1, b.shape[1])))


def _weight(name: str, given: Weight, k: int, size: int) -> Array:
    return inputs.array(name, given(k) if callable(given) else given, (size, size), f"the weight at k = {k}")
