"""Height fields: heights over a rectangle, as one smooth surface or as convex prisms."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from contactvi.errors import ContactviError, InputError, SceneError
from contactvi.importing import cubic_splines
from contactvi.importing.given_surfaces import GivenSurface
from contactvi.importing.hulls import hull_of_points
from contactvi.importing.paths import unreadable
from contactvi.importing.pictures import Surface
from contactvi.inputs import short, vector

Array = NDArray[np.float64]
MOST_PRISMS = 2000  # of which a height field is made: more would take minutes to load
_DRAWN = 40_000  # cells that are drawn, at most, where the samples are not more
_PARTS = 4  # of a cell along each axis, at whose corners two surfaces are compared


class Deviation(NamedTuple):
    """How far one surface is from another, measured along z [m]."""

    largest: float
    mean: float


@dataclass(frozen=True, eq=False)
class HeightField(GivenSurface):
    """A block with vertical sides, down without end, under a bicubic spline through samples.

    Attributes:
        heights: (rows, columns) [m], rows along y and columns along x, both from low to high.
        size: of the rectangle along x and y [m], (2,); its middle is the origin.
    """

    heights: Array
    size: Array

    kind = "height field"
    storable = True

    @property
    def reach(self) -> float:
        return float(np.linalg.norm([*(0.5 * self.size), np.abs(self.heights).max()]))

    @property
    def spacing(self) -> Array:
        """Distance of neighbouring samples along x and y [m], (2,)."""
        spacing: Array = self.size / (np.array(self.heights.shape[::-1]) - 1)
        return spacing

    @cached_property
    def coefficients(self) -> Array:
        """Of the B-splines, x first: (columns + 2, rows + 2)."""
        return cubic_splines.along_all(self.heights.T)

    def put(self, scene: Any, number: int, name: str) -> None:
        lost = partial(self.lost, name)
        scene.set_height_field(number, self.coefficients, -0.5 * self.size, self.spacing, self.reach, lost)

    def lost(self, name: str, point: NDArray[np.float64]) -> None:
        raise SceneError(
            f"The height field {name!r} gives no nearest point", body=name,
            expected="one nearest point of the surface, not on its border where that meets other shapes than balls",
            got=f"none of {short(np.round(point, 9).tolist())}",
            remedy="Make the field larger, or smoother, with heights that differ less from sample to sample",
        )  # fmt: skip

    def between(self, parts: int) -> Array:
        """Return the heights at the samples and `parts - 1` places between two along each axis, rows along y."""
        rows, columns = self.heights.shape
        across = cubic_splines.basis(columns, parts) @ self.coefficients
        return (across @ cubic_splines.basis(rows, parts).T).T

    def from_triangles(self) -> Deviation:
        """Return how far the surface is from the triangles through the samples, cut as those of MuJoCo."""
        t = np.arange(_PARTS + 1) / _PARTS
        x, y = np.meshgrid(t, t)
        a, b, d, e = _corners(self.heights)
        off, mean = [], 0.0
        smooth = self.between(_PARTS)
        for i, j in itertools.product(range(_PARTS + 1), repeat=2):
            u, v = x[i, j], y[i, j]
            flat = a + (e - d) * u + (d - a) * v if v >= u else a + (b - a) * u + (e - b) * v
            rows, columns = np.array(flat.shape) * _PARTS
            off.append(np.abs(smooth[i : i + rows : _PARTS, j : j + columns : _PARTS] - flat))
            # The sides of a cell count half, and its corners a quarter.
            mean += np.mean(off[-1]) * (1.0 - 0.5 * (i % _PARTS == 0)) * (1.0 - 0.5 * (j % _PARTS == 0))
        return Deviation(float(np.max(off)), float(mean) / _PARTS**2)

    def grid(self, name: str) -> Surface:
        rows, columns = self.heights.shape
        parts = max(1, min(8, int(np.sqrt(_DRAWN / ((rows - 1) * (columns - 1))))))
        z = self.between(parts)
        x, y = (np.linspace(-0.5 * length, 0.5 * length, n) for length, n in zip(self.size, z.shape[::-1], strict=True))
        at = np.arange(z.size).reshape(z.shape)
        a, b, d, e = (corner.ravel() for corner in _corners(at))
        faces = np.concatenate([np.stack([a, e, d], axis=1), np.stack([a, b, e], axis=1)])
        vertices = np.column_stack([part.ravel() for part in (*np.meshgrid(x, y), z)])
        return Surface(vertices.astype(np.float32), faces.astype(np.uint32))

    def to_data(self, name: str) -> dict[str, Any]:
        return {"type": "heightfield", "heights": self.heights, "size": self.size.tolist()}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> HeightField:
        """Return the surface that `to_data` described."""
        return height_field(data["heights"], data["size"])


def height_field(heights: Any, size: Any, height: float | None = None) -> HeightField:
    """Return a height field of checked arguments; see `Scene.add_heightfield`. Raises InputError, SceneError."""
    rectangle = vector("size", size, 2)
    if not (rectangle > 0.0).all():
        raise InputError(
            "The size of a height field", name="size", expected="positive lengths along x and y [m]",
            got=short(rectangle.tolist()), remedy="For example size=(10, 10)",
        )  # fmt: skip
    samples = _samples(heights, height)
    if samples.ndim != 2 or min(samples.shape) < 2 or not np.isfinite(samples).all():
        got = "numbers that are not finite" if samples.ndim == 2 and min(samples.shape) > 1 else f"{samples.shape}"
        raise InputError(
            "The heights of a field", name="heights", expected="finite numbers (rows, columns), two and more of both",
            got=got, remedy="Rows lie along y and columns along x, both from low to high",
        )  # fmt: skip
    return HeightField(samples, rectangle)


def prisms(heights: Array, size: Array, depth: float, name: str) -> list[tuple[str, coal.Convex]]:
    """Return the convex prisms of a height field, two for each cell, down to z = -depth, each with its suffix.

    They are cut as MuJoCo cuts them.
    """
    rows, columns = heights.shape
    x, y = (np.linspace(-0.5 * length, 0.5 * length, n) for length, n in zip(size, (columns, rows), strict=True))
    found = []
    for r, c in itertools.product(range(rows - 1), range(columns - 1)):
        a, b, d, e = (r, c), (r, c + 1), (r + 1, c), (r + 1, c + 1)
        for half, corners in enumerate(((d, a, e), (a, e, b))):
            points = [(x[j], y[i], z) for i, j in corners for z in (heights[i, j], -depth)]
            suffix = f"_{r}_{c}_{half}"
            found.append((suffix, hull_of_points(np.array(points), f"{name}{suffix}")))
    return found


def count_prisms(heights: Array) -> int:
    """Return how many prisms a field of these samples has."""
    rows, columns = heights.shape
    return int(2 * (rows - 1) * (columns - 1))


def _corners(table: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return the corners of all cells: low, low; high x; high y; high both."""
    return table[:-1, :-1], table[:-1, 1:], table[1:, :-1], table[1:, 1:]


def _samples(heights: Any, height: float | None) -> Array:
    if not isinstance(heights, (str, os.PathLike)):
        try:
            return (1.0 if height is None else height) * np.array(heights, dtype=float)
        except (TypeError, ValueError):
            raise InputError(
                "The heights of a field", name="heights", expected="numbers (rows, columns), or the path of a file",
                got=short(heights), remedy="Rows lie along y and columns along x, both from low to high",
            ) from None  # fmt: skip
    path = Path(heights)
    try:
        if path.suffix == ".npy":
            return np.asarray((1.0 if height is None else height) * np.load(path, allow_pickle=False), dtype=float)
        return _from_picture(path, height)
    except ContactviError:
        raise
    except (OSError, ValueError) as error:
        raise unreadable(path, error) from None


def _from_picture(path: Path, height: float | None) -> Array:
    """Return the heights of a picture seen from above: black 0, white `height`, its lowest row at low y."""
    from PIL import Image

    if height is None:
        raise InputError(
            f"The picture {path.name} has no lengths", name="height", expected="the height of white [m]",
            got="None", remedy="For example height=0.5",
        )  # fmt: skip
    with Image.open(path) as picture:
        deep = picture.mode.startswith("I")
        values = np.array(picture if deep else picture.convert("L"), dtype=float)
    return height * values[::-1] / (65535.0 if deep else 255.0)
