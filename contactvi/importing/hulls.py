"""Collision shapes the engine can use: convex primitives as they are, meshes as their convex hulls.

A triangle soup has no inside and no penetration depth (coal), so every mesh becomes its hull. The hull is first found
with qhull alone, which reports flat and broken meshes where coal 3.0's buildConvexHull ends the process.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from contactvi.errors import SceneError
from contactvi.importing.report import number

MOST_NEIGHBOURS = 254  # of a vertex that coal can count
# Least thickness of a mesh over its size. Below 1e-7 coal's hull ends the process; that is also the rounding of single
# precision, in which mesh files hold their vertices.
THINNEST = 1e-6
PRIMITIVES = (coal.Sphere, coal.Box, coal.Capsule, coal.Cylinder, coal.Ellipsoid)


def hull_of_points(points: np.ndarray, name: str) -> coal.Convex:
    """Return the convex hull of points (n, 3) [m], whatever number of neighbours its vertices have.

    Coal counts 254 of them. Its own distances from the hull are right up to there; the engine's copies of hulls have
    helpers at vertices with more (core/model/crowded_vertex.hpp), see `crowded_text`.

    Raises:
        SceneError: not finite, fewer than 4 points, or all in a plane.
    """
    from contactvi import _core  # here: saved runs are read and shown without the engine

    outer = _outer_points(np.asarray(points, dtype=float).reshape(-1, 3), name)
    vertices, faces = _core.hull_of_points(np.ascontiguousarray(outer))
    if len(faces) < 4:
        raise SceneError(
            f"Mesh of geometry {name!r}",
            body=name,
            expected="points with a convex hull",
            got="none that can be told from rounding",
            remedy="Repair the mesh, or replace it by a box, a sphere or a capsule",
        )
    return hull_by_engine(vertices, faces)


def crowded_text(hull: coal.Convex) -> str:
    """Return what the report says of a hull with vertices of more edges than coal can count; "" for others."""
    from contactvi import _core  # here: saved runs are read and shown without the engine

    if hull.num_points <= MOST_NEIGHBOURS:
        return ""
    count = _core.crowded_vertices(np.array(hull.points()), faces_by_engine(hull))
    if count == 0:
        return ""
    size = float(np.linalg.norm(hull.aabb_local.max_ - hull.aabb_local.min_))
    several = "vertex" if count == 1 else "vertices"
    return f"{count} {several} of more than {MOST_NEIGHBOURS} edges, distances to {number(_core.HULL_ERROR * size)} m"


def _outer_points(points: np.ndarray, name: str) -> np.ndarray:
    """Return the vertices of the hull of points (n, 3)."""
    from contactvi import _core  # here: saved runs are read and shown without the engine

    remedy = "Replace the mesh by a box or repair it"
    if len(points) < 4 or not np.all(np.isfinite(points)):
        what = "fewer than 4 vertices" if len(points) < 4 else "vertices that are not finite"
        raise SceneError(f"Mesh of geometry {name!r}", body=name, expected="a solid", got=what, remedy=remedy)
    outer = points[_core.hull_vertices(np.ascontiguousarray(points))]
    if not thickness(outer) > THINNEST:
        raise SceneError(
            f"Mesh of geometry {name!r}",
            body=name,
            expected=f"a solid, at least {THINNEST:g} of its size thick",
            got="points in a plane",
            remedy=remedy,
        )
    return outer


def thickness(points: np.ndarray) -> float:
    """Return the width of points (n, 3) across the plane nearest to them over their largest extent; 0 for none."""
    if len(points) < 4:
        return 0.0
    centered = points - points.mean(axis=0)
    axes = np.linalg.svd(centered, full_matrices=False)[2]
    widths = np.ptp(centered @ axes.T, axis=0)
    return float(widths.min() / widths.max()) if widths.max() > 0.0 else 0.0


def hull_from_faces(vertices: np.ndarray, faces: np.ndarray) -> coal.Convex:
    """Return the convex polytope with these vertices (n, 3) and outward triangles (m, 3)."""
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int32)
    # As many triangles as neighbours meet at a vertex; coal's constructor raises an error for too many of them.
    if faces.size and np.bincount(faces.ravel()).max() > MOST_NEIGHBOURS:
        return hull_by_engine(np.ascontiguousarray(vertices), np.ascontiguousarray(faces))
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(vertices))
    triangle, append = coal.Triangle(), triangles.append  # which copies; making each one anew takes four times as long
    for a, b, c in faces.tolist():
        triangle.set(a, b, c)
        append(triangle)
    return _finished(coal.Convex(points, triangles))


def hull_by_engine(vertices: np.ndarray, faces: np.ndarray) -> coal.Convex:
    """Return an equal hull as hull_from_faces does, in a thirtieth of the time; vertices float64, faces int32."""
    from contactvi import _core  # here: saved runs are read and shown without the engine

    hull = coal.Convex()
    _core.set_hull(hull.id(), vertices, faces)
    return _finished(hull)


def faces_of(hull: coal.Convex) -> np.ndarray:
    """Return the triangles of a hull as vertex indices, shape (m, 3); one by one where there is no engine."""
    try:
        return faces_by_engine(hull).astype(int)
    except ImportError:  # saved runs are read, shown and written again without it
        pass
    polygons = [hull.polygons(k) for k in range(hull.num_polygons)]
    return np.array([[polygon[0], polygon[1], polygon[2]] for polygon in polygons], dtype=int).reshape(-1, 3)


def faces_by_engine(hull: coal.Convex) -> np.ndarray:
    """Return the triangles of a hull as faces_of does, at once and not one by one; int32."""
    from contactvi import _core

    return np.asarray(_core.hull_faces(hull.id()))


def faces_of_mesh(mesh: coal.BVHModelBase) -> np.ndarray:
    """Return the triangles of a mesh as vertex indices, shape (m, 3)."""
    if mesh.num_tris == 0:
        return np.zeros((0, 3), dtype=np.int64)
    try:
        mesh.buildConvexRepresentation(True)  # shares the triangles, and so gives them at once and not one by one
    except RuntimeError:  # a vertex has more neighbours than coal can count
        corners = (mesh.tri_indices(k) for k in range(mesh.num_tris))
        return np.array([(corner[0], corner[1], corner[2]) for corner in corners], dtype=np.int64)
    return faces_by_engine(mesh.convex).astype(np.int64)


def _finished(hull: coal.Convex) -> coal.Convex:
    hull.computeLocalAABB()  # Coal leaves the box at +-1e308 otherwise.
    return hull


def check_shape(geometry: pin.GeometryObject) -> str:
    """Return what there is to say of a collision shape that is no mesh ("" = nothing).

    Raises:
        SceneError: a shape the engine cannot use, or a size that is not positive and finite.
    """
    shape = geometry.geometry
    if isinstance(shape, coal.Halfspace):
        if not np.all(np.isfinite([*shape.n, shape.d])) or abs(np.linalg.norm(shape.n) - 1.0) > 1e-9:
            raise SceneError(
                f"Halfspace {geometry.name!r}",
                body=geometry.name,
                expected="a unit normal",
                got=shape.n,
                remedy="Divide the normal and the offset by the length of the normal",
            )
        return ""
    if isinstance(shape, coal.Convex):
        # An empty one has no array of points, and asking for it ends the process.
        points = np.array(shape.points()) if shape.num_points >= 4 and shape.num_polygons >= 4 else np.zeros((0, 3))
        if len(points) < 4 or not np.all(np.isfinite(points)):
            raise SceneError(
                f"Hull {geometry.name!r}",
                body=geometry.name,
                expected="at least 4 finite vertices, and as many triangles",
                got="vertices that are not finite"
                if len(points)
                else f"{shape.num_points} vertices, {shape.num_polygons} triangles",
                remedy="Make it of at least 4 points that are not in one plane: "
                'coal.Convex.convexHull(points, True, "Qt")',
            )
        _finished(shape)
        return f"{shape.num_points} vertices"
    if isinstance(shape, PRIMITIVES):
        sizes = np.array(list(shape_sizes(shape).values()), dtype=float)
        if not np.all(np.isfinite(sizes)) or np.any(sizes <= 0.0):
            raise SceneError(
                f"Shape of geometry {geometry.name!r}",
                body=geometry.name,
                expected="sizes > 0",
                got=describe(shape),
                remedy="Correct the sizes of the shape; for a plane take a halfspace, for a point no shape",
            )
        return ""
    remedies = {
        "Plane": "A plane has two sides: use coal.Halfspace, a solid with one",
        "ConvexBase": 'It has no triangles: make it by coal.Convex.convexHull(points, True, "Qt")',
    }
    for bounding in ("AABB", "OBBRSS"):  # coal has no distance between a height field and a shape
        remedies[f"HeightField{bounding}"] = "Make a convex prism of each triangle, as add_mjcf does with an hfield"
    kind = type(shape).__name__
    raise SceneError(
        f"Shape of geometry {geometry.name!r}",
        body=geometry.name,
        expected="sphere, box, capsule, cylinder, ellipsoid, halfspace, convex hull or mesh",
        got=kind,
        remedy=remedies.get(kind, "Replace it by convex shapes"),
    )


def shape_sizes(shape: coal.CollisionGeometry) -> dict[str, float]:
    """Return the sizes [m] of a primitive by name; lengths are full lengths without the caps."""
    if isinstance(shape, coal.Sphere):
        return {"radius": float(shape.radius)}
    if isinstance(shape, coal.Box):
        return dict(zip(("x", "y", "z"), (2.0 * shape.halfSide).tolist(), strict=True))
    if isinstance(shape, coal.Ellipsoid):
        return dict(zip(("radius_x", "radius_y", "radius_z"), shape.radii.tolist(), strict=True))
    return {"radius": float(shape.radius), "length": 2.0 * float(shape.halfLength)}


def describe(shape: coal.CollisionGeometry) -> str:
    """Return a short text for a shape: name and sizes [m]."""
    if isinstance(shape, PRIMITIVES):
        sizes = " x ".join(number(s) for s in shape_sizes(shape).values())
        return f"{type(shape).__name__} {sizes}"
    if isinstance(shape, coal.Halfspace):
        return f"Halfspace n = ({', '.join(number(x) for x in shape.n)}), offset {number(shape.d)}"
    if isinstance(shape, coal.Convex):
        return f"Hull of {shape.num_points} vertices"
    return type(shape).__name__
