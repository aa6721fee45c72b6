"""The engine's choice of the vertices of a hull, against SciPy's."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, QhullError

from contactvi import _core


def by_scipy(points: np.ndarray) -> list[int]:
    try:
        return sorted(ConvexHull(points).vertices.tolist())
    except (QhullError, ValueError):
        return []


@pytest.mark.parametrize("seed", range(60))
def test_as_scipy_finds_them(seed: int):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(int(rng.integers(4, 300)), 3)) * [1.0, 1.0, 10.0 ** -rng.integers(0, 12)]
    if seed % 3 == 0:  # many points in one plane, and many that are twice there
        points = np.round(points, 1)
    assert _core.hull_vertices(points).tolist() == by_scipy(points)


@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_no_hull_is_no_error(count: int, capfd: pytest.CaptureFixture[str]):
    assert _core.hull_vertices(np.ones((count, 3))).size == 0
    assert capfd.readouterr() == ("", ""), "qhull explains its errors at length"
