"""What a scene is put together from: models from files, primitive bodies, halfspaces."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.importing import part as shapes
from contactvi.importing.checks import has_limits
from contactvi.importing.part import Part, shape_part, take_names
from contactvi.importing.readers import import_mjcf, import_urdf
from contactvi.inputs import flag, pose, vector
from contactvi.scene.assembly import Assembly, assemble
from contactvi.scene.build import Built, Edits
from contactvi.scene.contact_rules import FRICTION, RESTITUTION, Rule
from contactvi.scene.joints import JointSettings
from contactvi.scene.selection import BodyHandle, Names, PartHandle

GRAVITY = (0.0, 0.0, -9.81)


class SceneParts:
    """The parts of a scene and their names; `contactvi.Scene` adds contact data, joint data and what follows."""

    def __init__(self, gravity: Sequence[float] | np.ndarray) -> None:
        self._gravity = vector("gravity", gravity, 3)
        self._parts: list[Part] = []
        self._taken: dict[str, set[str]] = {}  # names by kind
        self._groups: dict[str, PartHandle] = {}  # names that stand for several bodies
        self._edits = Edits(Rule(RESTITUTION), Rule(FRICTION))
        self._base: tuple[Assembly, Names] | None = None  # of the parts alone
        self._built: Built | None = None  # of everything; dropped by every edit
        self._visual: pin.GeometryModel | None = None

    def add_urdf(
        self,
        path: str | os.PathLike[str],
        *,
        base: str = "fixed",
        placement: Any = None,
        package_dirs: Sequence[str | os.PathLike[str]] = (),
        srdf: str | os.PathLike[str] | None = None,
        prefix: str = "",
        limits: bool = True,
        friction: bool = False,
        mimic: bool = True,
    ) -> PartHandle:
        """Add a URDF model. Meshes become convex hulls, mimic tags become constraints (see `report`).

        Args:
            path: file, or `package://...`, `example-robot-data://robots/...`.
            base: "fixed" to the world or "free" (a free-flyer named root_joint).
            placement: of the base in the world: None, xyz [m], (xyz, rpy [rad]), 7 numbers (xyz, quaternion xyzw) or
                pin.SE3. For a free base it is where neutral() puts it.
            package_dirs: folders in which to look for packages first.
            srdf: file whose disable_collisions are left out of the collision pairs.
            prefix: put before all names, to add the same model twice.
            limits: whether the limits of its joints stop them (lower >= upper means none); one by one: `set_joint`.
            friction: whether its joints have the dry friction of the file; one by one: `set_joint(friction=True)`.
            mimic: whether joints with a mimic tag follow the other joint (joint equality constraints, which need steps
                of one length); else they are independent.

        Raises:
            SceneError, UnsupportedJointError, InputError
        """
        dirs = [package_dirs] if isinstance(package_dirs, (str, os.PathLike)) else list(package_dirs)
        where = pose("placement", placement)
        part = import_urdf(path, base=base, placement=where, package_dirs=dirs, srdf=srdf, prefix=prefix, mimic=mimic)
        return self.add_model(part, limits, friction)

    def add_mjcf(
        self,
        path: str | os.PathLike[str],
        *,
        placement: Any = None,
        prefix: str = "",
        limits: bool = True,
        friction: bool = False,
        equality: bool = True,
    ) -> PartHandle:
        """Add an MJCF model: bodies, joints, geometries; planes are halfspaces. Arguments and errors as in add_urdf.

        Args:
            equality: whether connect, weld and joint of its <equality> become constraints.
            friction: its frictionloss.
        """
        where = pose("placement", placement)
        return self.add_model(import_mjcf(path, placement=where, prefix=prefix, equality=equality), limits, friction)

    def add_model(self, part: Part, limits: Any, friction: Any = False) -> PartHandle:
        """Add an imported model (for scene files); `limits` and `friction` as in add_urdf."""
        limits, friction = flag("limits", limits), flag("friction", friction)
        handle: PartHandle = self._add(part)
        for i in range(1, part.model.njoints):
            own = JointSettings(limits=False if not limits and has_limits(part.model, i) else None)
            if friction and part.model.nvs[i] == 1 and part.model.upperDryFrictionLimit[part.model.idx_vs[i]] > 0.0:
                own.friction = True
            if own != JointSettings():
                self._edits.joints[part.prefix + part.model.names[i]] = own
        taken = {element.name for element in self._edits.elements}
        for constraint in part.constraints:
            names = (constraint.name, *(f"{constraint.name}_{k}" for k in range(2, len(taken) + 3)))
            name = next(name for name in names if name not in taken)
            taken.add(name)
            self._edits.elements.append(replace(constraint, name=name))
        return handle

    def add_sphere(
        self, name: str, radius: float, mass: float = 1.0, free: bool = True, placement: Any = None, color: Any = None
    ) -> BodyHandle:
        """Add a solid sphere: radius [m], mass [kg]. `free`: moves freely, else fixed to the world.

        `placement` as in add_urdf (for a free body the pose that neutral() gives it), color rgba in 0..1.
        """
        return self._add_shape(name, shapes.sphere(name, radius, mass), free, placement, color)

    def add_box(
        self,
        name: str,
        size: Sequence[float],
        mass: float = 1.0,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a solid box: full edge lengths [m], shape (3,). The rest as in add_sphere."""
        return self._add_shape(name, shapes.box(name, size, mass), free, placement, color)

    def add_capsule(
        self,
        name: str,
        radius: float,
        length: float,
        mass: float = 1.0,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a solid capsule along z: radius, length without the caps [m]. The rest as in add_sphere."""
        return self._add_shape(name, shapes.capsule(name, radius, length, mass), free, placement, color)

    def add_cylinder(
        self,
        name: str,
        radius: float,
        length: float,
        mass: float = 1.0,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a solid cylinder along z: radius, length [m]. The rest as in add_sphere."""
        return self._add_shape(name, shapes.cylinder(name, radius, length, mass), free, placement, color)

    def add_halfspace(
        self, normal: Sequence[float] = (0.0, 0.0, 1.0), offset: float = 0.0, name: str = "ground", color: Any = None
    ) -> BodyHandle:
        """Add the solid halfspace n . x <= offset [m], fixed to the world; n is the normal made a unit vector."""
        shape = shapes.halfspace(normal, offset, name)
        return self._add(shape_part(name, shape, None, pin.SE3.Identity(), color), BodyHandle)

    def _add_shape(self, name: str, body: Any, free: bool, placement: Any, color: Any) -> BodyHandle:
        shape, inertia = body
        where = pose("placement", placement)
        return self._add(shape_part(name, shape, inertia if free else None, where, color), BodyHandle)

    def _add(self, part: Part, handle_type: type = PartHandle) -> Any:
        take_names(part, self._taken)
        handle = handle_type(
            part.name, tuple(part.joint_names()), tuple(part.body_names()), tuple(part.geometry_names())
        )
        self._parts.append(part)
        self._groups[part.name] = handle
        self._base = self._built = self._visual = None
        return handle

    def _assembled(self) -> tuple[Assembly, Names]:
        if self._base is None:
            assembly = assemble(self._parts, self._gravity)
            self._base = assembly, Names(assembly.model, assembly.collision, self._groups)
        return self._base
