"""Surfaces that are no shapes of coal, each in the place of a halfspace of a part."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from contactvi.importing.part import Part
from contactvi.importing.pictures import Picture, Surface

SURFACES = (
    "surface",
    "heightfield",
    "torus",
    "superellipsoid",
    "thread",
    "solid",
)  # types of stored shapes that are such surfaces


class GivenSurface(ABC):
    """A surface in the frame of its geometry.

    Attributes:
        kind: what it is, in one or two words. storable: whether `to_data` holds all of it.
    """

    kind: str
    storable: bool = False

    @property
    @abstractmethod
    def reach(self) -> float:
        """Largest distance of one of its points from the origin [m], of one on a moving body."""

    @abstractmethod
    def put(self, scene: Any, number: int, name: str) -> None:
        """Put it in the place of the halfspace with this number in the engine's scene."""

    @abstractmethod
    def grid(self, name: str) -> Surface:
        """Return what is drawn: vertices and triangles."""

    @abstractmethod
    def to_data(self, name: str) -> dict[str, Any]:
        """Return what is stored of it, with its `type`."""

    @abstractmethod
    def lost(self, name: str, point: NDArray[np.float64]) -> None:
        """Raise the ContactviError of a point (3,) of which no nearest point is known."""


def with_surface(part: Part, name: str, surface: GivenSurface) -> Part:
    """Return the part with a surface in the place of the halfspace `name`; the given one stays as it is."""
    before = part.load_pictures

    def load() -> list[Picture]:
        return [
            Picture(picture.geometry, surface.grid(name))
            if picture.geometry.name == name and isinstance(picture.geometry.geometry, coal.Halfspace)
            else picture
            for picture in before()
        ]

    return replace(part, surfaces={**part.surfaces, name: surface}, load_pictures=load)
