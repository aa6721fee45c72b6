"""Bodies of one shape, or of the pieces of a mesh, which are added to a scene."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi.elements.user_functions import called, checked
from contactvi.errors import InputError, SceneError
from contactvi.importing import part as shapes
from contactvi.importing.given_surfaces import GivenSurface, with_surface
from contactvi.importing.height_fields import MOST_PRISMS, count_prisms, height_field, prisms
from contactvi.importing.mesh_bodies import MeshSource, mesh_inertia, mesh_shapes, mesh_source, solid_inertia
from contactvi.importing.part import Part, check_body_name, shape_part
from contactvi.importing.solids import Solid, deviation, sampled_solid, superellipsoid, thread, torus
from contactvi.inputs import array, flag, pose, real
from contactvi.keywords import refusing_methods
from contactvi.scene.notes import noted
from contactvi.scene.parts import Handle
from contactvi.scene.selection import BodyHandle
from contactvi.scene.surfaces import function_surface

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
        spacing: float | None = None,
    ) -> BodyHandle:
        """Add a solid body made of a mesh: its hull, convex pieces, or a solid of its shape. The rest as in add_sphere.

        The body's frame is that of the mesh. What collides is what has mass: the hull, or the pieces together, of one
        density. Edges of some pairs are rounded by up to 0.001 mm, as those of models (see `report`).

        Args:
            mesh: path of an STL, OBJ, PLY or DAE file; vertices [m], shape (n, 3), for their hull; or (vertices,
                faces) with outward triangles, shape (m, 3).
            mass: [kg]; density: [kg/m^3]. One of them; 1 kg by default.
            scale: factor on the coordinates, or one for each axis: 0.001 for millimetres.
            decompose: True: pieces by CoACD, which needs `pip install "contactvi[decompose]"` and takes seconds; a
                number: the largest concavity of a piece, 0.05 by default, smaller for more of them. The shapes are
                called name_0, name_1, ...
            spacing: makes it a solid of its own shape, which need not be convex, as `add_solid` does: its signed
                distance, sampled so far apart [m]. The mesh has to be closed; at sharp edges the surface is off by up
                to a third of the spacing, and the report says by how much. Balls, ends of capsules, and vertices of
                boxes and hulls touch it.

        Raises:
            SceneError: no such file; a mesh without a hull, or not closed; CoACD is not installed.
            InputError: `decompose` with `spacing`, or a spacing that is too large or takes too many samples.
        """
        check_body_name(name)
        if spacing is not None:
            return self._add_mesh_solid(
                name, mesh_source(name, mesh, scale), spacing, mass, density, free, placement, color, decompose
            )
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
        text = f"surface given by a {surface.kind}"
        return self._add(_surface_part(name, surface, text, inertia, placement, color), BodyHandle)

    def add_heightfield(
        self,
        name: str,
        heights: ArrayLike | str | os.PathLike[str],
        size: ArrayLike,
        *,
        height: float | None = None,
        smooth: bool = True,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a height field, fixed to the world: a block with vertical sides under heights over a rectangle.

        Smooth ones are one surface without seams: the bicubic spline through the samples, with two continuous
        derivatives. What touches it is what touches a surface of `add_surface`, and cylinders, ellipsoids and solids; a
        ball or the end of a capsule touches in as many points as it has nearest ones, so that hollows may be narrower
        than it is. The block has no bottom.

        Args:
            name: of the body, its geometry and its part.
            heights: (rows, columns) [m], two of both at least, rows along y and columns along x, both from low to
                high; or the path of a .npy file with such an array, or of a picture seen from above (8 or 16 bits,
                colours as grey), whose lowest row is at low y.
            size: of the rectangle along x and y [m], (2,); its middle is the origin of `placement`.
            height: of white in a picture [m], which needs it; a factor on other heights, 1 by default.
            smooth: False: the triangles between the samples as convex prisms, two to a cell, called name_0,
                name_1, ..., 2000 of them at most. They have edges; what slides over flush ones does not meet them.
            placement, color: as in add_sphere.

        Raises:
            InputError: heights or a size of another shape, or not finite. SceneError: a file that cannot be read, or
            too many prisms.
        """
        check_body_name(name)
        field = height_field(heights, size, None if height is None else real("height", height))
        if flag("smooth", smooth):
            part = _surface_part(
                name, field, f"{len(field.heights)} x {field.heights.shape[1]} heights", None, placement, color
            )
            return self._add(part, BodyHandle)
        if (count := count_prisms(field.heights)) > MOST_PRISMS:
            raise SceneError(
                f"The height field {name!r} has too many prisms", body=name, expected=f"{MOST_PRISMS} at most",
                got=str(count), remedy="Leave out smooth=False, or give fewer heights",
            )  # fmt: skip
        depth = float(field.size.max() - field.heights.min())
        solids = [solid for _, solid in prisms(field.heights, field.size, depth, name)]
        return self._add_shape(name, solids, pin.Inertia.Zero(), False, placement, color)

    def add_torus(
        self,
        name: str,
        ring: float,
        tube: float,
        mass: float = 1.0,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
        *,
        hollow: bool = False,
    ) -> BodyHandle:
        """Add a torus about z: the radius of the ring of the tube's axis, and the tube's, which is smaller [m].

        Balls, capsules (by their ends), boxes and hulls (by their vertices) touch it, exactly, wherever it is nearest:
        a ball in as many points as it has nearest ones. So do other solids, ellipsoids, cylinders, halfspaces and
        smooth height fields. `hollow`: the solid is all around the torus, a channel, fixed to the world (free=False).
        The rest as in add_sphere.
        """
        solid = torus(ring, tube, flag("hollow", hollow))
        inertia = solid.inertia(real("mass", mass, 0.0, open_low=True))
        return self._add_solid(name, solid, inertia, free, placement, color)

    def add_superellipsoid(
        self,
        name: str,
        radii: ArrayLike,
        exponent: float,
        mass: float = 1.0,
        free: bool = True,
        placement: Any = None,
        color: Any = None,
        *,
        hollow: bool = False,
    ) -> BodyHandle:
        """Add the solid ``|x/a|^n + |y/b|^n + |z/c|^n <= 1``: half axes [m], (3,), and the exponent n in 2..32.

        From an ellipsoid (2) towards a box with round edges. What touches it, `hollow` and the rest as in add_torus.
        """
        solid = superellipsoid(radii, exponent, flag("hollow", hollow))
        inertia = solid.inertia(real("mass", mass, 0.0, open_low=True))
        return self._add_solid(name, solid, inertia, free, placement, color)

    def add_thread(
        self,
        name: str,
        radius: float,
        depth: float,
        pitch: float,
        length: float,
        *,
        hollow: bool = False,
        inertia: pin.Inertia | None = None,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a screw's thread about z, exactly: radius + depth cos(angle - 2 pi z / pitch) from the axis [m].

        Right-handed, with a negative pitch left-handed. It is looked at along its length alone, and its ends are open.
        What touches it and `hollow`, the thread of a nut, as in add_torus; `inertia`: None: fixed to the world; else a
        free body with this inertia about its frame. `placement` and `color` as in add_sphere.
        """
        solid = thread(radius, depth, pitch, length, flag("hollow", hollow))
        return self._add_solid(name, solid, inertia, inertia is not None, placement, color)

    def add_solid(
        self,
        name: str,
        function: SurfaceFunction,
        extent: ArrayLike,
        spacing: float,
        *,
        hollow: bool = False,
        inertia: pin.Inertia | None = None,
        placement: Any = None,
        color: Any = None,
    ) -> BodyHandle:
        """Add a solid that need not be convex: where a smooth function is negative, such as a signed distance.

        The function is sampled once, on a grid; the shape is that of the tricubic spline through the samples, with two
        continuous derivatives. Distances from it are measured, so that the function need not be one. The report says
        how far the surface is from that of the function. What touches it and `hollow` as in add_torus.

        Args:
            name: of the body, its geometry and its part.
            function: of points (n, 3) [m], returns (n,).
            extent: a box around the solid [m], low and high along each axis, (3, 2).
            spacing: of the samples [m], smaller than the thinnest part and its gaps.
            inertia: None: fixed to the world; else a free body with this inertia about its frame.
            placement, color: as in add_sphere.

        Raises:
            InputError: values that are not finite, a solid that is not within the extent, too many samples.
            UserFunctionError: the function raised, or returned something else than numbers of the right shape.
        """
        box = array("extent", extent, (3, 2), "low and high [m] along each axis")
        asked = partial(_asked, f"the function of the solid {name!r}", function)
        solid = sampled_solid(asked, box, real("spacing", spacing, 0.0, open_low=True), flag("hollow", hollow))
        off = deviation(solid, asked)
        note = f"{off.largest:.3g} m from the surface of the function at most, {off.mean:.3g} m in the mean"
        return self._add_solid(name, solid, inertia, inertia is not None, placement, color, note)

    def _add_mesh_solid(
        self,
        name: str,
        source: MeshSource,
        spacing: float,
        mass: float | None,
        density: float | None,
        free: bool,
        placement: Any,
        color: Any,
        decompose: bool | float,
    ) -> BodyHandle:
        from contactvi.importing.mesh_solids import closed, mesh_solid

        if decompose is not False:
            raise InputError(
                f"The mesh of {name!r} is decomposed and sampled", name="spacing", expected="decompose or spacing",
                got="both", remedy="Leave one of them out",
            )  # fmt: skip
        vertices, faces = closed(name, *source.arrays(name))
        solid, off = mesh_solid(name, vertices, faces, real("spacing", spacing, 0.0, open_low=True))
        note = f"{off.largest:.3g} m from the mesh at most, {off.mean:.3g} m in the mean"
        inertia = mesh_inertia(name, vertices, faces, mass, density)
        return self._add_solid(name, solid, inertia, free, placement, color, note)

    def _add_solid(
        self,
        name: str,
        solid: Solid,
        inertia: pin.Inertia | None,
        free: bool,
        placement: Any,
        color: Any,
        note: str = "",
    ) -> BodyHandle:
        check_body_name(name)
        if solid.hollow and flag("free", free):
            raise InputError(
                f"The hollow solid {name!r} moves", name="free", expected="a channel fixed to the world",
                got="a free body", remedy="Give free=False, or inertia=None",
            )  # fmt: skip
        text = f"{'hollow ' if solid.hollow else ''}{solid.kind}"
        part = _surface_part(name, solid, text, inertia if flag("free", free) else None, placement, color)
        if note:
            part.report.note("changed", "geom", name, note)
        return self._add(part, BodyHandle)

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


def _surface_part(
    name: str, surface: GivenSurface, text: str, inertia: pin.Inertia | None, placement: Any, color: Any
) -> Part:
    """Return the part of a surface in the place of a halfspace."""
    shape = shapes.halfspace((0.0, 0.0, 1.0), 0.0, name)
    part = shape_part(name, [shape], inertia, pose("placement", placement), color, text)
    part.report.geometries[0] = replace(part.report.geometries[0], shape=text.capitalize())
    return with_surface(part, name, surface)


def _asked(what: str, function: SurfaceFunction, points: NDArray[np.float64]) -> NDArray[np.float64]:
    return checked(called(function, what, None, points), what, None, (len(points),), "a number for each point")
