"""What is to be drawn of a scene.

Shapes are taken from the scene's visual model, which pictures what has no mesh by its collision shapes. Halfspaces are
taken from the collision geometry, so that the viewer can make them as large as the scene needs. Springs and distances
are lines, and so are models without any shape.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.elements.forces import PathSpring
from contactvi.importing.pictures import Picture
from contactvi.playback.skeleton import skeletons
from contactvi.playback.visuals import (
    MAX_TRIANGLES,
    SPRING_COLOR,
    STRING_COLOR,
    Visual,
    from_picture,
    line,
    thin_out,
)
from contactvi.scene.scene import Scene


def from_scene(scene: Scene) -> list[Visual]:
    """Return what is to be drawn of a scene, at most MAX_TRIANGLES triangles."""
    solids = [s for s in scene.collision_model.geometryObjects if s.name not in scene.surfaces]
    planes = {solid.name: Picture(solid) for solid in solids if _is_plane(solid)}
    shown = [picture for picture in scene.pictures() if picture.geometry.name not in planes]
    found = [visual for picture in (*shown, *planes.values()) if (visual := from_picture(picture)) is not None]
    return thin_out(found + skeletons(scene.model, found, _held(scene)) + _lines(scene), MAX_TRIANGLES)


def _held(scene: Scene) -> dict[int, list[NDArray[np.float64]]]:
    """Return the points at which loops are closed, by the joints that carry them, in their frames [m]."""
    points: dict[int, list[NDArray[np.float64]]] = {}
    for row in scene.built().elements.constraints:
        if row.kind in ("point", "weld", "screw"):
            for joint, _, point in (row.a, row.b):
                points.setdefault(joint, []).append(point)
    return points


def _lines(scene: Scene) -> list[Visual]:
    """Return the springs and the distances of a scene."""
    resolved = scene.built().elements
    springs = [element for element in scene.elements if isinstance(element, PathSpring)]
    lines = [
        line(own.name, found[0], found[1], SPRING_COLOR) for own, found in zip(springs, resolved.springs, strict=True)
    ]
    for row in resolved.constraints:
        if row.kind == "distance":
            (a, _, point_a), (b, _, point_b) = row.a, row.b
            lines.append(line(row.name, (a, b), (point_a, point_b), STRING_COLOR))
    return lines


def _is_plane(shape: pin.GeometryObject) -> bool:
    return type(shape.geometry).__name__ in ("Halfspace", "Plane")
