"""The parts of a scene in the order they were added, the names they take, and the one model they are assembled into."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import pinocchio as pin

from contactvi.importing.given_surfaces import GivenSurface, with_surface
from contactvi.importing.part import Part, take_names, with_inertia
from contactvi.importing.pictures import Picture, with_meshes
from contactvi.scene.assembly import Assembly, assemble, assemble_pictures
from contactvi.scene.selection import Names, PartHandle

Handle = TypeVar("Handle", bound=PartHandle)


class PartList:
    """The parts of a scene. Model, names and pictures are made on first use and again after a part was added.

    Attributes:
        gravity: Acceleration of free fall [m/s^2], world frame, shape (3,).
        parts: What was added, in order.
        handles: Handle of each part by its name.
    """

    def __init__(self, gravity: np.ndarray) -> None:
        self.gravity = gravity
        self.parts: list[Part] = []
        self.handles: dict[str, PartHandle] = {}
        self._taken: dict[str, set[str]] = {}  # names by kind
        self._assembly: Assembly | None = None
        self._names: Names | None = None
        self._pictures: list[Picture] | None = None
        self._visual: pin.GeometryModel | None = None

    def add(self, part: Part, kind: type[Handle]) -> Handle:
        """Add a part and return its handle; raise InputError, and change nothing, where a name is taken already."""
        take_names(part, self._taken)
        part.place = len(self.parts)
        handle = kind(
            part.name,
            tuple(part.joint_names()),
            tuple(part.body_names()),
            tuple(part.geometry_names()),
            tuple(part.data.actuators),
        )
        self.parts.append(part)
        self.handles[part.name] = handle
        self._forget()
        return handle

    def add_stored(self, part: Part, handles: dict[str, PartHandle]) -> None:
        """Add the one part of a stored scene, with the handles of the parts that it once was."""
        take_names(part, self._taken)
        self.parts.append(part)
        self.handles.update(handles)
        self._forget()

    @property
    def assembly(self) -> Assembly:
        """All parts in one model, before joint settings and the choice of pairs; it is constant."""
        if self._assembly is None:
            self._assembly = assemble(self.parts, self.gravity)
        return self._assembly

    @property
    def names(self) -> Names:
        """The names of joints, bodies, geometries and parts, and what selectors mean."""
        if self._names is None:
            self._names = Names(self.assembly.model, self.assembly.collision, self.handles)
        return self._names

    @property
    def pictures(self) -> list[Picture]:
        """The pictures of all parts."""
        if self._pictures is None:
            self._pictures = assemble_pictures(self.parts, self.assembly.model)
        return self._pictures

    @property
    def visual(self) -> pin.GeometryModel:
        """The pictures as Pinocchio's model."""
        if self._visual is None:
            self._visual = with_meshes(self.pictures)
        return self._visual

    @property
    def surfaces(self) -> dict[str, GivenSurface]:
        """The surfaces given by functions, by the names of their geometries."""
        return {part.prefix + name: surface for part in self.parts for name, surface in part.surfaces.items()}

    def set_surface(self, name: str, surface: GivenSurface) -> None:
        """Set the function of a surface, in a new part that stands in the place of the old one."""
        at = next(k for k, part in enumerate(self.parts) if name in part.surfaces)
        self.parts[at] = with_surface(self.parts[at], name, surface)
        self._pictures = self._visual = None

    def named_configurations(self, neutral: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return q (nq,) and v (nv,) by name; `neutral` (nq,) is where the other parts are."""
        found: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        nv, at_q, at_v = sum(part.model.nv for part in self.parts), 0, 0
        for part in self.parts:
            for name, (own_q, own_v) in part.data.configurations.items():
                q, v = neutral.copy(), np.zeros(nv)
                q[at_q : at_q + part.model.nq], v[at_v : at_v + part.model.nv] = own_q, own_v
                found[part.prefix + name] = q, v
            at_q, at_v = at_q + part.model.nq, at_v + part.model.nv
        return found

    def set_gravity(self, gravity: np.ndarray) -> None:
        """Set the acceleration of free fall."""
        self.gravity, self._assembly = gravity.copy(), None

    def set_inertia(self, joint: str, body: pin.Inertia) -> None:
        """Set the inertia of what a joint moves, in a new part that stands in the place of the old one.

        Other lists may hold the old one. Names and pictures stay.
        """
        at = next(k for k, part in enumerate(self.parts) if joint in part.joint_names())
        self.parts[at] = with_inertia(self.parts[at], joint, body)
        self._assembly = None

    def copy(self) -> PartList:
        """Return a list with these parts, to which parts can be added apart from this one."""
        twin = PartList(self.gravity)
        twin.parts, twin.handles = list(self.parts), dict(self.handles)
        twin._taken = {kind: set(names) for kind, names in self._taken.items()}
        twin._assembly, twin._names = self._assembly, self._names
        twin._pictures, twin._visual = self._pictures, self._visual
        return twin

    def _forget(self) -> None:
        """Drop what was made of the parts."""
        self._assembly = self._names = self._pictures = self._visual = None
