"""All places of a height field over a rectangle where the distance of a point is least, by looking everywhere.

A dense grid of starts, from each of which a general minimizer goes down within the rectangle.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize


def feet(
    height: Callable[[float, float], float], low: np.ndarray, high: np.ndarray, point: np.ndarray, starts: int = 25
) -> np.ndarray:
    """Return distances of the local minima, ascending, (n,); minima nearer to each other than 1e-4 m are one."""

    def square(u: np.ndarray) -> float:
        return float((u[0] - point[0]) ** 2 + (u[1] - point[1]) ** 2 + (height(*u) - point[2]) ** 2)

    x, y = (np.linspace(a, b, starts) for a, b in zip(low, high, strict=True))
    table = np.array([[square(np.array([a, b])) for b in y] for a in x])
    found: list[tuple[float, np.ndarray]] = []
    for i, j in np.ndindex(table.shape):
        around = table[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        if table[i, j] > around.min():
            continue
        end = minimize(
            square, [x[i], y[j]], bounds=list(zip(low, high, strict=True)), method="L-BFGS-B",
            options={"ftol": 1e-16, "gtol": 1e-12},
        )  # fmt: skip
        if all(np.linalg.norm(end.x - other) > 1e-4 for _, other in found):
            found.append((float(np.sqrt(end.fun)), end.x))
    return np.array(sorted(distance for distance, _ in found))
