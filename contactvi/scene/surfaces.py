"""Surfaces given by functions: heights z = f(x, y) and signed distances d(x, y, z), as a scene keeps them.

The engine asks for the values at several points at once. What is not given is found by differences of fourth order:
with steps of H [m] the gradient of a height is then true to about 1e-12 where the surface bends over decimetres and
more. The gap itself has no error of these differences, because it is the distance to the nearest point, where the error
of that point counts in second order; the normal has it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.elements.user_functions import called, checked
from contactvi.errors import InputError, SceneError, UserFunctionError
from contactvi.importing.given_surfaces import GivenSurface
from contactvi.importing.height_fields import HeightField
from contactvi.importing.pictures import Surface
from contactvi.importing.solids import Solid, solid_from_data
from contactvi.importing.surface_nets import surface_net
from contactvi.inputs import array, short

Array = NDArray[np.float64]
H = 3e-4  # [m] step of differences of values
H_GRADIENT = 1e-5  # [m] of gradients
CELLS = 60  # of a drawn height along each axis
CELLS_OF_SOLID = 40  # and of a distance
_SAMPLES = 5  # along each axis, at which functions are tried when they are given
_UNIT = 1e-6  # by how much the gradient of a distance may differ from a unit vector, as in the engine
_AGREE = 1e-5  # of 1 + the gradient: what a given gradient and differences may differ by
TOUCHING = (coal.Sphere, coal.Capsule, coal.Box, coal.Convex)
TOUCHING_SOLIDS = (coal.Halfspace, coal.Ellipsoid, coal.Cylinder)
TOUCHING_FIELDS = (coal.Ellipsoid, coal.Cylinder)
_VALUES = {"height": 6, "distance": 4}


def _stencil(dimensions: int) -> tuple[Array, Array]:
    """Return places (m, dimensions) around a point, and the numbers (m, .) by which values there are its differences.

    Of heights with what is f, f_x, f_y, f_xx, f_xy, f_yy, of distances d, d_x, d_y, d_z.
    """
    axes = np.eye(dimensions)
    steps = [np.zeros(dimensions), *(k * e for e in axes for k in (-2.0, -1.0, 1.0, 2.0))]
    if dimensions == 2:
        steps += [np.array([x, y]) for x in (1.0, -1.0) for y in (1.0, -1.0)]
    numbers = np.zeros((len(steps), _VALUES["height" if dimensions == 2 else "distance"]))
    numbers[0, 0] = 1.0
    for axis in range(dimensions):
        own = slice(1 + 4 * axis, 5 + 4 * axis)
        numbers[own, 1 + axis] = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * H)
        if dimensions == 2:
            numbers[own, 3 + 2 * axis] = np.array([-1.0, 16.0, 16.0, -1.0]) / (12.0 * H * H)
            numbers[0, 3 + 2 * axis] = -30.0 / (12.0 * H * H)
    if dimensions == 2:
        numbers[9:, 4] = np.array([1.0, -1.0, -1.0, 1.0]) / (4.0 * H * H)
    return H * np.array(steps), numbers


_STENCILS = {"height": _stencil(2), "distance": _stencil(3)}
_GRADIENTS = H_GRADIENT * np.array([(0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])


@dataclass(frozen=True, eq=False)
class FunctionSurface(GivenSurface):
    """A surface in the frame of its geometry.

    Attributes:
        kind: "height" or "distance".
        function: of points (n, 2) or (n, 3) [m], returns (n,) [m]; or compiled, with an `address`; None: a stored scene
            has lost it.
        gradient, hessian: of points, return (n, 2) and (n, 2, 2), or (n, 3); None: by differences.
        extent: what is drawn [m], low and high along each axis, shape (2, 2) or (3, 2).
        drawn: the grid that is drawn, of a stored scene.
    """

    kind: str
    function: Callable[..., Any] | None
    gradient: Callable[..., Any] | None
    hessian: Callable[..., Any] | None
    extent: Array
    drawn: Surface | None = None

    @property
    def address(self) -> int | None:
        """The address of a compiled function."""
        address = getattr(self.function, "address", None)
        return address if isinstance(address, int) else None

    @property
    def reach(self) -> float:
        """Largest distance of a point of the drawn part from the origin [m]."""
        return float(np.linalg.norm(np.abs(self.extent).max(axis=1)))

    def put(self, scene: Any, number: int, name: str) -> None:
        """See GivenSurface; `name` is for messages of what goes wrong in it. Raises SceneError without a function."""
        if self.function is None:
            raise SceneError(
                f"The surface {name!r} has no function", body=name, expected="the function that gave it",
                got="a stored scene, which cannot hold functions",
                remedy=f"Give it again: scene.set_surface({name!r}, {self.kind}=...)",
            )  # fmt: skip
        given = self.address if self.address is not None else lambda points: self.values(name, points)
        scene.set_surface(number, given, self.kind == "height", self.reach, partial(self.lost, name))

    def values(self, name: str, points: Array) -> Array:
        """Return rows f, f_x, f_y, f_xx, f_xy, f_yy (n, 6) of a height, d, d_x, d_y, d_z (n, 4) of a distance.

        Raises:
            UserFunctionError: the function raised, or returned something else than finite numbers of the right shape.
        """
        if self.address is not None:
            return _compiled_values(self.address, self.kind, points)
        what = f"the {self.kind} of the surface {name!r}"
        return self._height(what, points) if self.kind == "height" else self._distance(what, points)

    def _asked(self, function: Callable[..., Any], what: str, points: Array, *shape: int) -> Array:
        value = called(function, what, None, points)
        asks = f"numbers for each point: it gets an array of points, shape {points.shape}, and returns one"
        return checked(value, what, None, (len(points), *shape), asks)

    def _by_differences(self, what: str, points: Array) -> Array:
        assert self.function is not None
        places, numbers = _STENCILS[self.kind]
        found = self._asked(self.function, what, _around(points, places))
        return found.reshape(len(places), len(points)).T @ numbers

    def _height(self, what: str, points: Array) -> Array:
        assert self.function is not None
        if self.gradient is None:
            return self._by_differences(what, points)
        n = len(points)
        rows = np.empty((n, 6))
        rows[:, 0] = self._asked(self.function, what, points)
        if self.hessian is not None:
            rows[:, 1:3] = self._asked(self.gradient, f"the gradient of {what}", points, 2)
            hessian = self._asked(self.hessian, f"the Hessian of {what}", points, 2, 2)
            rows[:, 3:] = hessian[:, [0, 0, 1], [0, 1, 1]]
            return rows
        found = self._asked(self.gradient, f"the gradient of {what}", _around(points, _GRADIENTS), 2).reshape(5, n, 2)
        rows[:, 1:3] = found[0]
        along_x, along_y = ((found[k] - found[k + 1]) / (2.0 * H_GRADIENT) for k in (1, 3))
        rows[:, 3], rows[:, 5] = along_x[:, 0], along_y[:, 1]
        rows[:, 4] = 0.5 * (along_x[:, 1] + along_y[:, 0])
        return rows

    def _distance(self, what: str, points: Array) -> Array:
        assert self.function is not None
        if self.gradient is None:
            return self._by_differences(what, points)
        rows = np.empty((len(points), 4))
        rows[:, 0] = self._asked(self.function, what, points)
        rows[:, 1:] = self._asked(self.gradient, f"the gradient of {what}", points, 3)
        return rows

    def lost(self, name: str, point: Array) -> None:
        """Raise the UserFunctionError of a point (3,) [m] of which no nearest point is known."""
        rows = self.values(name, point[None, : len(self.extent)])[0]
        length = float(np.linalg.norm(rows[1:]))
        wanted = "two continuous derivatives, and hollows that are wider than a ball in them"
        got = "no nearest point, or two that the ball touches"
        if not np.isfinite(rows).all():
            wanted, got = "finite numbers", f"values {short(rows.tolist())}"
        elif self.kind == "distance" and abs(length - 1.0) > _UNIT:
            wanted, got = "a true distance, with a gradient of length 1", f"length {length:.9g}"
        what = f"the {self.kind} of the surface {name!r}"
        raise UserFunctionError(
            f"{what} gives no gap at the point {short(np.round(point, 9).tolist())}", function=what, expected=wanted,
            got=got, remedy="Correct the function; it has to be defined wherever bodies may come",
        )  # fmt: skip

    def grid(self, name: str) -> Surface:
        """Return what is drawn: vertices and triangles."""
        if self.drawn is not None:
            return self.drawn
        if self.kind == "height":
            return _sheet(self.extent, lambda points: self.values(name, points)[:, 0])
        axes = [np.linspace(low, high, CELLS_OF_SOLID + 1) for low, high in self.extent]
        corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        return surface_net(axes, self.values(name, corners.reshape(-1, 3))[:, 0].reshape(corners.shape[:3]))

    def to_data(self, name: str) -> dict[str, Any]:
        """Return what is stored of it: what it was, and the grid that is drawn."""
        vertices, faces = self.grid(name)
        kind = {"type": "surface", "kind": self.kind, "extent": self.extent.tolist()}
        return kind | {"vertices": np.asarray(vertices), "faces": np.asarray(faces)}

    def check(self, name: str) -> None:
        """Try the functions within the extent.

        Raises:
            UserFunctionError: see `values`.
            InputError: a given gradient is not that of the function; a distance whose gradient is no unit vector.
        """
        axes = [np.linspace(low, high, _SAMPLES + 2)[1:-1] + 0.01 * (high - low) / np.pi for low, high in self.extent]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(self.extent))
        rows = self.values(name, points)
        if not np.isfinite(rows).all():
            raise InputError(
                f"The {self.kind} of the surface {name!r} is not finite", name=self.kind,
                expected="finite numbers within the extent", got=f"{short(rows[~np.isfinite(rows).all(axis=1)][0])}",
                remedy="Correct the function, or make the extent smaller",
            )  # fmt: skip
        if self.gradient is not None:
            self._check_gradient(name, points, rows)
        if self.kind == "distance":
            self._check_unit(name, points)

    def _check_gradient(self, name: str, points: Array, rows: Array) -> None:
        plain = FunctionSurface(self.kind, self.function, None, None, self.extent)
        size = points.shape[1]
        given, found = rows[:, 1 : 1 + size], plain.values(name, points)[:, 1 : 1 + size]
        off = np.abs(given - found).max(axis=1) / (1.0 + np.abs(found).max(axis=1))
        # A distance has kinks, on which differences say nothing: most of the points decide.
        if np.median(off) > _AGREE:
            k = int(np.argsort(off)[len(off) // 2])
            raise InputError(
                f"The gradient of the surface {name!r} is not that of its {self.kind}", name="gradient",
                expected=f"{short(found[k].tolist())} at {short(points[k].tolist())}, by differences",
                got=short(given[k].tolist()), remedy="Correct it, or leave it out: it is then found by differences",
            )  # fmt: skip

    def _check_unit(self, name: str, points: Array) -> None:
        """Look at the gradient on the surface, where the samples are nearest to it."""
        for _ in range(3):  # A true distance is there after one step.
            rows = self.values(name, points)
            points = points - rows[:, :1] * rows[:, 1:] / np.maximum((rows[:, 1:] ** 2).sum(axis=1, keepdims=True), 0.1)
        rows = self.values(name, points)
        lengths = np.linalg.norm(rows[:, 1:], axis=1)[np.abs(rows[:, 0]) < 1e-3]
        if len(lengths) and np.median(np.abs(lengths - 1.0)) > _UNIT:
            raise InputError(
                f"The distance of the surface {name!r} is no distance", name="distance",
                expected="a gradient of length 1 at the surface: the distance from the nearest point, negative inside",
                got=f"length {np.median(lengths):.6g}",
                remedy="Give a true distance; a height z = f(x, y) is taken as height=f, and its distance is computed",
            )  # fmt: skip


def function_surface(height: Any, distance: Any, gradient: Any, hessian: Any, extent: Any) -> FunctionSurface:
    """Return a surface of checked arguments; see `Scene.add_surface`. Raises InputError."""
    if (height is None) == (distance is None):
        raise InputError(
            "A surface needs one function", name="height", expected="height=... or distance=...",
            got="both" if height is not None else "none", remedy="For example height=lambda p: 0.1 * p[:, 0] ** 2",
        )  # fmt: skip
    kind, function = ("height", height) if height is not None else ("distance", distance)
    compiled = isinstance(getattr(function, "address", None), int)
    for what, given in ((kind, function), ("gradient", gradient), ("hessian", hessian)):
        if given is not None and not callable(given) and not (what == kind and compiled):
            raise InputError(
                f"The {what} of a surface is no function", name=what, expected="a function of points (n, "
                f"{2 if kind == 'height' else 3}), or an object with the address of a C function",
                got=short(given), remedy="For example height=lambda p: 0.1 * p[:, 0] ** 2",
            )  # fmt: skip
    if compiled and (gradient is not None or hessian is not None):
        raise InputError(
            "A compiled surface fills its derivatives itself", name="gradient",
            expected="None with a compiled function", got="a function", remedy="Leave gradient and hessian out",
        )  # fmt: skip
    if hessian is not None and (kind == "distance" or gradient is None):
        raise InputError(
            "The Hessian of a surface", name="hessian", expected="None for a distance and without a gradient",
            got="a function", remedy="Leave it out, or give the gradient of the height too",
        )  # fmt: skip
    axes = 2 if kind == "height" else 3
    default = np.array([(-1.0, 1.0)] * axes)
    box = default if extent is None else array("extent", extent, (axes, 2), "low and high [m] along each axis")
    if np.any(box[:, 0] >= box[:, 1]):
        raise InputError(
            "The extent of a surface is empty", name="extent", expected="low < high along each axis",
            got=short(box.tolist()), remedy="For example extent=[(-1, 1), (-1, 1)]",
        )  # fmt: skip
    return FunctionSurface(kind, function, gradient, hessian, box)


def refuse_untouchable(
    pairs: NDArray[np.int32],
    compliant: NDArray[np.int32],
    objects: list[pin.GeometryObject],
    surfaces: Mapping[str, GivenSurface],
) -> None:
    """Raise SceneError where a surface has a pair with a shape that it cannot touch, or a compliant one."""
    if not surfaces:
        return
    for a, b in compliant.tolist():
        names = objects[a].name, objects[b].name
        if not surfaces.keys().isdisjoint(names):
            raise SceneError(
                f"The contact of {names[0]!r} and {names[1]!r} is compliant", body=names[0],
                expected="rigid contact with a surface given by a function", got="a compliant pair",
                remedy=f"scene.set_compliance({names[0]!r}, {names[1]!r}, stiffness=None)",
            )  # fmt: skip
    for a, b in pairs.tolist():
        names = objects[a].name, objects[b].name
        for own, other in ((a, b), (b, a)):
            if objects[own].name not in surfaces or isinstance(objects[other].geometry, TOUCHING):
                continue
            met = surfaces.get(objects[other].name)
            if _touch_at_normals(surfaces[objects[own].name], met, objects[other].geometry):
                continue
            kind = met.kind if met is not None else None
            raise SceneError(
                f"The surface {objects[own].name!r} and {objects[other].name!r} have no contact",
                body=objects[other].name,
                expected="a ball, capsule, box or convex hull on a surface given by a function; two solids, or one and "
                "a halfspace; a cylinder or an ellipsoid on a solid or a smooth height field, or a solid on that",
                got=kind or type(objects[other].geometry).__name__,
                remedy=f"scene.disable_pair({names[0]!r}, {names[1]!r}), or another shape: add_mesh takes hulls",
            )  # fmt: skip


def _touch_at_normals(own: GivenSurface, met: GivenSurface | None, shape: coal.CollisionGeometry) -> bool:
    """Return whether a surface and another one, or a shape, touch at their common normals."""
    if met is not None:
        return any(isinstance(a, Solid) and isinstance(b, (Solid, HeightField)) for a, b in ((own, met), (met, own)))
    if isinstance(own, Solid):
        return isinstance(shape, TOUCHING_SOLIDS)
    return isinstance(own, HeightField) and isinstance(shape, TOUCHING_FIELDS)


def surface_from_dict(data: Mapping[str, Any]) -> GivenSurface:
    """Return the surface that `to_data` described, one of a function without it."""
    if data["type"] == "heightfield":
        return HeightField.from_data(data)
    if data["type"] != "surface":
        return solid_from_data(data)
    drawn = Surface(np.asarray(data["vertices"], dtype=np.float32), np.asarray(data["faces"], dtype=np.uint32))
    extent = np.array(data["extent"], dtype=float)
    return FunctionSurface(str(data["kind"]), None, None, None, extent, drawn)


def missing_name(name: str) -> str:
    """Return the name of the function of a surface in the list of what is missing."""
    return f"surface of {name}"


def _compiled_values(address: int, kind: str, points: Array) -> Array:
    """Call a compiled function at each point, as the engine does."""
    coordinates = 2 if kind == "height" else 3
    function = ctypes.CFUNCTYPE(None, *[ctypes.c_double] * coordinates, ctypes.POINTER(ctypes.c_double))(address)
    rows = np.full((len(points), _VALUES[kind]), np.nan)
    for point, row in zip(points.tolist(), rows, strict=True):
        function(*point, row.ctypes.data_as(ctypes.POINTER(ctypes.c_double)))
    return rows


def _around(points: Array, places: Array) -> Array:
    """Return all points moved to each of the places, one place after the other."""
    return np.asarray((points + places[:, None]).reshape(-1, points.shape[1]))


def _sheet(extent: Array, height: Callable[[Array], Array]) -> Surface:
    x, y = (np.linspace(low, high, CELLS + 1) for low, high in extent)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    at = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    vertices = np.column_stack([points, height(points)])
    return Surface(vertices.astype(np.float32), faces.astype(np.uint32))
