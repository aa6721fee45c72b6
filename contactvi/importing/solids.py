"""Solids that need not be convex, given by a function that is negative in them.

The engine measures the distance from the surface, where the function is zero, itself: the function need not be a
distance.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from math import gamma
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, SceneError
from contactvi.importing import cubic_splines
from contactvi.importing.given_surfaces import GivenSurface
from contactvi.importing.height_fields import Deviation
from contactvi.importing.pictures import Surface
from contactvi.importing.surface_nets import surface_net
from contactvi.inputs import real, short, vector

Array = NDArray[np.float64]
_ACROSS = 4.0  # cells from the middle to the surface where that is nearest
_MOST_CELLS = 8_000_000


@dataclass(frozen=True, eq=False)
class Solid(GivenSurface):
    """A solid within a box, or with `hollow` all but that.

    Attributes:
        extent: low and high along each axis [m], (3, 2). cells: of a grid in it, (3,): what is thinner than a cell may
            be missed.
    """

    hollow: bool

    storable = True

    @property
    @abstractmethod
    def extent(self) -> Array:
        """Low and high along each axis [m], (3, 2)."""

    @property
    @abstractmethod
    def cells(self) -> NDArray[np.int64]:
        """Of a grid in it, (3,)."""

    @abstractmethod
    def values(self, points: Array) -> Array:
        """Return numbers (n,), negative within the surface, at corners of cells (n, 3)."""

    @property
    def reach(self) -> float:
        return float(np.linalg.norm(np.abs(self.extent).max(axis=1)))

    @property
    def axes(self) -> list[Array]:
        """Places of the corners of the cells along each axis."""
        return [np.linspace(low, high, n + 1) for (low, high), n in zip(self.extent, self.cells, strict=True)]

    def engine(self) -> tuple[bool, Array, Array, NDArray[np.int32]]:
        """Return the grid as the engine takes it."""
        return self.hollow, self.extent[:, 0], self.extent[:, 1], self.cells.astype(np.int32)

    def lost(self, name: str, point: Array) -> None:
        raise SceneError(
            f"The solid {name!r} gives no nearest point", body=name, expected="one nearest point of its surface",
            got=f"none of {short(np.round(point, 9).tolist())}", remedy="Make it smoother, or its cells smaller",
        )  # fmt: skip

    def grid(self, name: str) -> Surface:
        axes = self.axes
        corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        return surface_net(axes, self.values(corners.reshape(-1, 3)).reshape(corners.shape[:3]))


@dataclass(frozen=True, eq=False)
class Torus(Solid):
    """A tube around a circle about z: radii of the circle and of the tube [m]."""

    ring: float
    tube: float

    kind = "torus"

    @property
    def extent(self) -> Array:
        across = 1.1 * self.tube
        return np.outer([self.ring + across, self.ring + across, across], [-1.0, 1.0])

    @property
    def cells(self) -> NDArray[np.int64]:
        return _cells(self.extent, self.tube / _ACROSS)

    def values(self, points: Array) -> Array:
        values: Array = np.hypot(np.hypot(points[:, 0], points[:, 1]) - self.ring, points[:, 2]) - self.tube
        return values

    def put(self, scene: Any, number: int, name: str) -> None:
        scene.set_torus(number, self.ring, self.tube, self.engine(), self.reach, partial(self.lost, name))

    def to_data(self, name: str) -> dict[str, Any]:
        return {"type": "torus", "sizes": [self.ring, self.tube], "hollow": self.hollow}

    def inertia(self, mass: float) -> pin.Inertia:
        """Return that of the solid torus of this mass [kg], about its middle."""
        across = 0.5 * self.ring**2 + 0.625 * self.tube**2
        about = self.ring**2 + 0.75 * self.tube**2
        return pin.Inertia(mass, np.zeros(3), mass * np.diag([across, across, about]))


@dataclass(frozen=True, eq=False)
class Superellipsoid(Solid):
    """|x/a|^n + |y/b|^n + |z/c|^n = 1: half axes [m] and the exponent n >= 2, from an ellipsoid towards a box."""

    radii: Array
    exponent: float

    kind = "superellipsoid"

    @property
    def extent(self) -> Array:
        return np.outer(1.1 * self.radii, [-1.0, 1.0])

    @property
    def cells(self) -> NDArray[np.int64]:
        return _cells(self.extent, float(self.radii.min()) / _ACROSS)

    def values(self, points: Array) -> Array:
        values: Array = (np.abs(points / self.radii) ** self.exponent).sum(axis=1) - 1.0
        return values

    def put(self, scene: Any, number: int, name: str) -> None:
        lost = partial(self.lost, name)
        scene.set_superellipsoid(number, self.radii, self.exponent, self.engine(), self.reach, lost)

    def to_data(self, name: str) -> dict[str, Any]:
        return {"type": "superellipsoid", "sizes": [*self.radii.tolist(), self.exponent], "hollow": self.hollow}

    def inertia(self, mass: float) -> pin.Inertia:
        """Return that of the solid of this mass [kg], about its middle: Dirichlet's integral."""
        n = self.exponent
        ratio = gamma(3.0 / n) * gamma(1.0 + 3.0 / n) / (gamma(1.0 / n) * gamma(1.0 + 5.0 / n))
        squares = mass * ratio * self.radii**2  # of the places along each axis
        return pin.Inertia(mass, np.zeros(3), np.diag(squares.sum() - squares))


@dataclass(frozen=True, eq=False)
class Thread(Solid):
    """A thread about z: `radius` + `depth` cos(angle - 2 pi z / pitch) from the axis [m] along a length, open there."""

    radius: float
    depth: float
    pitch: float
    length: float

    kind = "thread"

    @property
    def extent(self) -> Array:
        across = 1.1 * (self.radius + self.depth)
        return np.outer([across, across, 0.5 * self.length], [-1.0, 1.0])

    @property
    def cells(self) -> NDArray[np.int64]:
        return _cells(self.extent, min(abs(self.pitch) / (2.0 * _ACROSS), self.radius / _ACROSS))

    def values(self, points: Array) -> Array:
        turn = np.arctan2(points[:, 1], points[:, 0]) - 2.0 * np.pi * points[:, 2] / self.pitch
        values: Array = np.hypot(points[:, 0], points[:, 1]) - self.radius - self.depth * np.cos(turn)
        return values

    def put(self, scene: Any, number: int, name: str) -> None:
        lost = partial(self.lost, name)
        scene.set_thread(number, self.radius, self.depth, self.pitch, self.engine(), self.reach, lost)

    def to_data(self, name: str) -> dict[str, Any]:
        sizes = [self.radius, self.depth, self.pitch, self.length]
        return {"type": "thread", "sizes": sizes, "hollow": self.hollow}


@dataclass(frozen=True, eq=False)
class SampledSolid(Solid):
    """A tricubic spline through samples (nx, ny, nz) of a function at the corners of a grid over a box."""

    box: Array
    samples: Array

    kind = "sampled solid"

    @property
    def extent(self) -> Array:
        return self.box

    @property
    def cells(self) -> NDArray[np.int64]:
        return np.array(self.samples.shape) - 1

    @cached_property
    def coefficients(self) -> Array:
        return cubic_splines.along_all(self.samples)

    def values(self, points: Array) -> Array:
        return self.samples.reshape(-1)

    def put(self, scene: Any, number: int, name: str) -> None:
        lost = partial(self.lost, name)
        scene.set_spline_solid(number, self.coefficients.reshape(-1), self.engine(), self.reach, lost)

    def to_data(self, name: str) -> dict[str, Any]:
        return {"type": "solid", "extent": self.box.tolist(), "samples": self.samples, "hollow": self.hollow}

    def passed(self) -> NDArray[np.int64]:
        """Return the cells that the surface passes through, (n, 3)."""
        inside = self.samples < 0.0
        counts = np.zeros(tuple(self.cells), dtype=int)
        for corner in np.ndindex(2, 2, 2):
            counts += inside[tuple(slice(c, n + c) for c, n in zip(corner, self.cells, strict=True))]
        return np.argwhere((counts > 0) & (counts < 8))

    def middles(self, cells: NDArray[np.int64]) -> Array:
        """Return the middles of cells (n, 3) [m]."""
        return self.box[:, 0] + (cells + 0.5) * (self.box[:, 1] - self.box[:, 0]) / self.cells

    def at(self, points: Array) -> tuple[Array, Array]:
        """Return the values (n,) and gradients (n, 3) of the spline at points (n, 3) [m]; beyond the box it goes on."""
        spacing = (self.box[:, 1] - self.box[:, 0]) / self.cells
        place = (points - self.box[:, 0]) / spacing
        cell = np.clip(np.floor(place), 0, self.cells - 1).astype(np.int64)
        weights = [cubic_splines.weights(place[:, axis] - cell[:, axis]) for axis in range(3)]
        i, j, k = (cell[:, axis, None] + np.arange(4) for axis in range(3))
        own = self.coefficients[i[:, :, None, None], j[:, None, :, None], k[:, None, None, :]]
        value, *along = (
            np.einsum("nijk,ni,nj,nk->n", own, *(weights[a][int(a == b)] for a in range(3))) for b in (None, 0, 1, 2)
        )
        return value, np.stack(along, axis=1) / spacing


def torus(ring: Any, tube: Any, hollow: bool) -> Torus:
    """Return a torus of checked radii [m]. Raises InputError."""
    radii = real("ring", ring, 0.0, open_low=True), real("tube", tube, 0.0, open_low=True)
    if radii[1] >= radii[0]:
        raise InputError(
            "The tube of a torus", name="tube", expected=f"less than the ring's radius {radii[0]:g} m",
            got=f"{radii[1]:g} m", remedy="A torus that meets itself has a kink",
        )  # fmt: skip
    return Torus(hollow, *radii)


def superellipsoid(radii: Any, exponent: Any, hollow: bool) -> Superellipsoid:
    """Return a superellipsoid of checked half axes [m] and exponent. Raises InputError."""
    axes = vector("radii", radii, 3)
    for axis in axes:
        real("radii", axis, 0.0, open_low=True)
    return Superellipsoid(hollow, axes, real("exponent", exponent, 2.0, 32.0))


def thread(radius: Any, depth: Any, pitch: Any, length: Any, hollow: bool) -> Thread:
    """Return a thread of checked sizes [m]. Raises InputError."""
    sizes = [real(name, size, 0.0, open_low=True) for name, size in (("radius", radius), ("depth", depth))]
    turn = real("pitch", pitch)
    if sizes[1] >= sizes[0] or turn == 0.0:
        name, expected = ("pitch", "another number than zero") if turn == 0.0 else ("depth", "less than the radius")
        raise InputError(
            "A thread", name=name, expected=expected, got=short([*sizes, turn]),
            remedy="Give the mean radius, half of the height of the thread, and the height of a turn",
        )  # fmt: skip
    return Thread(hollow, sizes[0], sizes[1], turn, real("length", length, 0.0, open_low=True))


def sampled_solid(function: Callable[[Array], Any], extent: Array, spacing: float, hollow: bool) -> SampledSolid:
    """Return the spline through values of a function within a box [m], (3, 2), whose cells are about `spacing` long.

    Raises:
        InputError: too many cells; values that are not finite; a surface that is not within the box.
    """
    cells = _cells(extent, spacing)
    if int(np.prod(cells)) > _MOST_CELLS:
        raise InputError(
            "The cells of a solid", name="spacing", expected=f"{_MOST_CELLS} cells at most", got=str(np.prod(cells)),
            remedy="Give a larger spacing, or a smaller extent",
        )  # fmt: skip
    axes = [np.linspace(low, high, n + 1) for (low, high), n in zip(extent, cells, strict=True)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    samples = np.asarray(function(corners.reshape(-1, 3)), dtype=float).reshape(corners.shape[:3])
    inside = samples < 0.0
    border = np.concatenate([inside.take(k, axis).ravel() for axis in range(3) for k in (0, -1)])
    if not np.isfinite(samples).all() or not inside.any() or border.any():
        got = (
            "values that are not finite" if not np.isfinite(samples).all()
            else "no negative value" if not inside.any() else "negative values on the border of the extent"
        )  # fmt: skip
        raise InputError(
            "A solid within an extent", name="extent", expected="negative values inside, positive ones at its border",
            got=got, remedy="Change the sign of the function, which is negative all around" if border.all()
            else "Give an extent around all of the solid, and a spacing that meets its thinnest part",
        )  # fmt: skip
    return SampledSolid(hollow, np.array(extent, dtype=float), samples)


def deviation(solid: SampledSolid, function: Callable[[Array], Any]) -> Deviation:
    """Return how far the surface is from that of the function [m], measured in the middles of the cells it passes.

    There the spline is farthest from its samples; the distance is the difference of the two over the gradient.
    """
    middles = solid.middles(solid.passed())
    value, gradient = solid.at(middles)
    given = np.asarray(function(middles), dtype=float)
    off = np.abs(value - given) / np.linalg.norm(gradient, axis=1)
    return Deviation(float(off.max()), float(off.mean()))


def solid_from_data(data: Mapping[str, Any]) -> Solid:
    """Return the solid that `to_data` described."""
    hollow = bool(data["hollow"])
    if data["type"] == "solid":
        return SampledSolid(hollow, np.array(data["extent"], dtype=float), np.array(data["samples"], dtype=float))
    if data["type"] == "thread":
        return Thread(hollow, *(float(x) for x in data["sizes"]))
    *radii, last = (float(x) for x in data["sizes"])
    return Torus(hollow, radii[0], last) if data["type"] == "torus" else Superellipsoid(hollow, np.array(radii), last)


def _cells(extent: Array, spacing: float) -> NDArray[np.int64]:
    return np.maximum(np.ceil((extent[:, 1] - extent[:, 0]) / spacing), 3.0).astype(np.int64)
