"""Bodies of one shape, or of the pieces of a mesh, which are added to a scene."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi.importing import part as shapes
from contactvi.importing.mesh_bodies import mesh_shapes, mesh_source, solid_inertia
from contactvi.importing.part import Part, check_body_name, shape_part
from contactvi.inputs import flag, pose
from contactvi.keywords import refusing_methods
from contactvi.scene.notes import noted
from contactvi.scene.parts import Handle
from contactvi.scene.selection import BodyHandle
from contactvi.scene.surfaces import function_surface, with_surface

SurfaceFunction = Callable[[NDArray[np.float64]], ArrayLike]


@refusing_methods
@noted
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

    def add_surface(
        self,
        name: str,
        *,
        height: SurfaceFunction | None = None,
        distance: SurfaceFunction | None = None,
        gradient: Callable[..., Any] | None = None,
        hessian: Callable[..., Any] | None = None,
        extent: ArrayLike | None = None,
        placement: Any = None,
        color: Any = None,
        inertia: pin.Inertia | None = None,
    ) -> BodyHandle:
        """Add a solid whose surface a function gives: terrain z = f(x, y), or a signed distance d(x, y, z).

        Functions are of many points at once, in the frame of `placement`: arrays (n, 2) or (n, 3) [m], and return (n,).
        What touches such a surface: balls, by the distance of the centre from the nearest point of the surface;
        capsules, by both ends; boxes and convex hulls, by their vertices. So edges, faces and the middle of a capsule
        do not meet a bump that is thinner than they are long. Other shapes are refused (SceneError) when the scene is
        made. A ball needs one nearest point: a hollow has to be wider than it is.

        Args:
            name: of the body, its geometry and its part.
            height: f of points (n, 2) [m], twice continuously differentiable; the solid lies below. The distance is
                that of the nearest point, not the height above the ground. Compiled: an object whose `address` is that
                of a C function void(double x, double y, double values[6]) that fills f, f_x, f_y, f_xx, f_xy, f_yy, as
                numba.cfunc("void(float64, float64, CPointer(float64))"); it is called without the interpreter, by
                several threads at once.
            distance: d of points (n, 3) [m], negative inside: a true distance, with a gradient of length 1, which is
                checked here, and in a run, which ends where the length differs by more than 1e-6. Compiled:
                void(double x, double y, double z, double values[4]) that fills d, d_x, d_y, d_z.
            gradient: of points, returns (n, 2) or (n, 3); None: by differences of fourth order, which take 13 points.
            hessian: of a height, returns (n, 2, 2); None: by differences.
            extent: what is drawn [m], low and high along each axis, (2, 2) or (3, 2); by default -1 to 1. Of a
                distance on a free body all of the solid has to lie within.
            placement: of the surface in the world, as in add_sphere.
            color: rgba in 0..1.
            inertia: None: fixed to the world; else a free body with this inertia about its frame, that of `distance`.

        Raises:
            InputError: no function or two; a gradient that is not that of the function; a distance that is none.
            UserFunctionError: a function raised, or returned something else than finite numbers of the right shape.
        """
        check_body_name(name)
        surface = function_surface(height, distance, gradient, hessian, extent)
        surface.check(name)
        where = pose("placement", placement)
        shape = shapes.halfspace((0.0, 0.0, 1.0), 0.0, name)
        text = f"surface given by a {surface.kind}"
        part = shape_part(name, [shape], inertia, where, color, text)
        part.report.geometries[0] = replace(part.report.geometries[0], shape=text.capitalize())
        return self._add(with_surface(part, name, surface), BodyHandle)

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
