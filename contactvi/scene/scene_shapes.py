"""Bodies of one shape, or of the pieces of a mesh, which are added to a scene."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from typing import Any

import coal
import pinocchio as pin
from numpy.typing import ArrayLike

from contactvi.importing import part as shapes
from contactvi.importing.mesh_bodies import mesh_shapes, mesh_source, solid_inertia
from contactvi.importing.part import Part, check_body_name, shape_part
from contactvi.inputs import flag, pose
from contactvi.scene.parts import Handle
from contactvi.scene.selection import BodyHandle


class SceneShapes(ABC):
    """The methods of a scene that add a single body, free or fixed to the world."""

    @abstractmethod
    def _add(self, part: Part, kind: type[Handle]) -> Handle:
        """Add a part and return its handle."""

    def add_sphere(
        self, name: str, radius: float, mass: float = 1.0, free: bool = True, placement: Any = None, color: Any = None
    ) -> BodyHandle:
        """Add a solid sphere: radius [m], mass [kg]. `free`: moves freely, else fixed to the world.

        `placement` as in add_urdf (for a free body the pose that neutral() gives it), color rgba in 0..1.
        """
        return self._add_shape(name, *shapes.sphere(name, radius, mass), free, placement, color)

    def add_box(
        self,
        name: str,
        size: ArrayLike,
        mass: float = 1.0,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a solid box: full edge lengths [m], shape (3,). The rest as in add_sphere."""
        return self._add_shape(name, *shapes.box(name, size, mass), free, placement, color)

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
        return self._add_shape(name, *shapes.capsule(name, radius, length, mass), free, placement, color)

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
        return self._add_shape(name, *shapes.cylinder(name, radius, length, mass), free, placement, color)

    def add_ellipsoid(
        self,
        name: str,
        radii: ArrayLike,
        mass: float = 1.0,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a solid ellipsoid: half axes along x, y, z [m], shape (3,). The rest as in add_sphere."""
        return self._add_shape(name, *shapes.ellipsoid(name, radii, mass), free, placement, color)

    def add_mesh(
        self,
        name: str,
        mesh: str | os.PathLike[str] | ArrayLike | tuple[ArrayLike, ArrayLike],
        mass: float | None = None,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
        *,
        density: float | None = None,
        scale: float | ArrayLike = 1.0,
        decompose: bool | float = False,
    ) -> BodyHandle:
        """Add a solid body made of a mesh: its convex hull, or convex pieces. The rest as in add_sphere.

        The body's frame is that of the mesh. What collides is what has mass: the hull, or the pieces together, of one
        density. Edges of some pairs are rounded by up to 1 mm, as those of models (see `report`).

        Args:
            mesh: path of an STL, OBJ, PLY or DAE file; vertices [m], shape (n, 3), for their hull; or (vertices,
                faces) with outward triangles, shape (m, 3).
            mass: [kg]; density: [kg/m^3]. One of them; 1 kg by default.
            scale: factor on the coordinates, or one for each axis: 0.001 for millimetres.
            decompose: True: pieces by CoACD, which needs `pip install "contactvi[decompose]"` and takes seconds; a
                number: the largest concavity of a piece, 0.05 by default, smaller for more of them. The shapes are
                called name_0, name_1, ...

        Raises:
            SceneError: no such file; a mesh without a hull; CoACD is not installed.
        """
        check_body_name(name)
        hulls, text = mesh_shapes(name, mesh_source(name, mesh, scale), decompose)
        inertia = solid_inertia(name, hulls, mass, density)
        return self._add_shape(name, hulls, inertia, free, placement, color, text)

    def add_halfspace(
        self, normal: ArrayLike = (0.0, 0.0, 1.0), offset: float = 0.0, name: str = "ground", color: Any = None
    ) -> BodyHandle:
        """Add the solid halfspace n . x <= offset [m], fixed to the world; n is the normal made a unit vector."""
        shape = shapes.halfspace(normal, offset, name)
        return self._add(shape_part(name, [shape], None, pin.SE3.Identity(), color), BodyHandle)

    def _add_shape(
        self,
        name: str,
        shape: coal.CollisionGeometry | list[coal.Convex],
        inertia: pin.Inertia,
        free: bool,
        placement: Any,
        color: Any,
        text: str = "",
    ) -> BodyHandle:
        where, moves = pose("placement", placement), flag("free", free)
        several = shape if isinstance(shape, list) else [shape]
        return self._add(shape_part(name, several, inertia if moves else None, where, color, text), BodyHandle)
