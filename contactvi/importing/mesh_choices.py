"""What meshes of models become in contact: their hulls, convex pieces, or fields of their signed distance."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.importing.given_surfaces import with_surface
from contactvi.importing.hulls import faces_of
from contactvi.importing.mesh_bodies import MeshSource, mesh_shapes
from contactvi.importing.mesh_hulls import MeshHulls
from contactvi.importing.part import FileData, Part
from contactvi.inputs import check_choice, real

Array = NDArray[np.float64]

SHAPES = ("hull", "pieces", "field")
_FINE = 40.0  # cells of a field along the longest edge of its mesh, where no spacing is given


@dataclass
class MeshChoice:
    """What the meshes of one model become.

    Attributes:
        kinds: one of SHAPES by the name of a geometry or of a mesh, or by a pattern of these; the first one that fits
            counts, and what none fits is a hull of which no distance is measured.
        spacing: of the samples of fields [m]; None: a fortieth of the longest edge of each mesh.
    """

    kinds: dict[str, str]
    spacing: float | None
    _seen: set[str] = field(default_factory=set)
    _used: set[str] = field(default_factory=set)

    def of(self, *names: str) -> str | None:
        """Return what the mesh with one of these names becomes, None where nothing is said of it."""
        self._seen |= set(names)
        for pattern, kind in self.kinds.items():
            if any(fnmatch.fnmatchcase(name, pattern) for name in names):
                self._used.add(pattern)
                return kind
        return None

    def check_used(self) -> None:
        """Raise InputError for a name that no mesh of the model has; of one kind for all there may be none."""
        for pattern in self.kinds:
            if pattern != "*" and pattern not in self._used:
                raise InputError(
                    "Shape of a mesh", name="shape", expected="names or patterns of geometries with meshes or of files",
                    got=repr(pattern), remedy=did_you_mean(pattern, sorted(self._seen)),
                )  # fmt: skip


def mesh_choice(shape: Any, spacing: Any) -> MeshChoice:
    """Return the checked arguments `shape` and `spacing` of Scene.add_urdf and add_mjcf. Raises InputError."""
    given = {} if shape is None else shape if isinstance(shape, Mapping) else {"*": shape}
    for kind in given.values():
        check_choice("shape", kind, SHAPES, "What a mesh becomes")
    size = None if spacing is None else real("spacing", spacing, 0.0, open_low=True)
    return MeshChoice({str(name): kind for name, kind in given.items()}, size)


def take_meshes(part: Part, hulls: MeshHulls, choice: MeshChoice) -> tuple[Part, dict[str, str]]:
    """Put pieces and fields in the place of the meshes that are chosen to be such; hulls stay meshes.

    Returns the part, whose collision shapes are changed in place, and what the report says of geometries by name.

    Raises:
        InputError: a name that no mesh has. SceneError: a field of a mesh that is not closed; CoACD is not installed.
    """
    if not choice.kinds:
        return part, {}
    from contactvi.importing import mesh_distance  # here: the engine's module is not needed otherwise

    texts: dict[str, str] = {}
    for number, name in enumerate([geometry.name for geometry in part.collision.geometryObjects]):
        mesh = hulls.mesh_of(name)
        kind = None if mesh is None else choice.of(name, mesh.name, Path(mesh.name).stem)
        if mesh is None or kind is None:
            continue
        vertices, faces = (np.array(values) for values in mesh.load())
        mesh_of_name = MeshSource(None, vertices.astype(float), faces.astype(np.int64))
        if kind == "field":
            solid, spacing = mesh_distance.field(name, mesh_of_name, choice.spacing, _FINE)
            off = mesh_distance.from_field(mesh_of_name, solid)
            part = with_surface(part, name, solid)
            part.collision.geometryObjects[number].geometry = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
            hulls.drop(name)
            taken, made = f"a field with samples {spacing:.3g} m apart", [name]
        else:
            if kind == "hull":
                found = hulls.of(part.collision.geometryObjects[number])
                assert found is not None
                pieces, taken, made = [found.shape], "its convex hull", [name]
            else:
                pieces, _ = mesh_shapes(name, mesh_of_name, True)
                hulls.drop(name)
                taken, made = f"{len(pieces)} convex pieces", _put_pieces(part, number, pieces)
            off = mesh_distance.from_hulls(mesh_of_name, [(np.array(p.points()), faces_of(p)) for p in pieces])
        away = f"its surface is {off.largest:.3g} m from the mesh at most, {off.mean:.3g} m in the mean"
        part.report.note("changed", "mesh", name, f"taken as {taken}: {away}")
        texts |= dict.fromkeys(
            made, f"{kind} of the mesh, {off.largest:.3g} m from it at most, {off.mean:.3g} in the mean"
        )
    choice.check_used()
    return part, texts


def _put_pieces(part: Part, number: int, pieces: list[coal.Convex]) -> list[str]:
    """Let pieces stand for a geometry: the first one in its place, the others at the end; return their names."""
    collision = part.collision
    geometry = collision.geometryObjects[number].copy()  # those of the model move in the memory as it grows
    old, numbers = geometry.name, [number]
    names = [f"{old}_{k}" for k in range(len(pieces))] if len(pieces) > 1 else [old]
    geometry.meshPath = ""
    for name, piece in zip(names[1:], pieces[1:], strict=True):
        geometry.name, geometry.geometry = name, piece
        numbers.append(collision.addGeometryObject(geometry))
    first = collision.geometryObjects[number]
    first.name, first.geometry, first.meshPath = names[0], pieces[0], ""
    if part.given_pairs is not None:
        part.given_pairs = [
            (k if a == number else a, k if b == number else b)
            for a, b in part.given_pairs
            for k in (numbers if number in (a, b) else numbers[:1])
        ]
    _expand(part.data, old, names)
    return names


def _expand(data: FileData, old: str, names: list[str]) -> None:
    """Give what a file says of a geometry to each of its pieces."""
    tables: tuple[dict[Any, Any], ...] = (data.contact, data.turning, data.adhesion)
    for table in tables:
        for key in [key for key in table if old in key]:
            value = table.pop(key)
            for name in names:
                table[tuple(name if part == old else part for part in key)] = value
    if old in data.surface_velocities:
        velocity = data.surface_velocities.pop(old)
        data.surface_velocities |= dict.fromkeys(names, velocity)
