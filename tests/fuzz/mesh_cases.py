"""Mesh files in the formats STL and OBJ: solids of all sizes, thin, flat, damaged; in a URDF and in an MJCF."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import contactvi as cvi
from fuzz.draws import EXTREME, Case, Draws, damage_bytes, run_settings
from fuzz.urdf_cases import use

Point = tuple[float, float, float]
TETRAHEDRON = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
BOX = [(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]
BOX_FACES = [
    (0, 1, 3),
    (0, 3, 2),
    (4, 6, 7),
    (4, 7, 5),
    (0, 4, 5),
    (0, 5, 1),
    (2, 3, 7),
    (2, 7, 6),
    (0, 2, 6),
    (0, 6, 4),
    (1, 5, 7),
    (1, 7, 3),
]
URDF = """<robot name="r"><link name="a"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>
<mesh filename="{file}" scale="{scale}"/></geometry></collision></link></robot>"""
MJCF = """<mujoco><asset><mesh name="m" file="{file}" scale="{scale}" {more}/></asset><worldbody><body name="a">
<freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""


def draw(d: Draws) -> Case:
    """Return a case."""
    points, faces = solid(d)
    for _ in range(d.damages()):
        _damage(d, points, faces)
    kind = d.pick(("stl", "ascii", "obj"))
    write = {"stl": binary_stl, "ascii": ascii_stl, "obj": obj}[kind]
    data = write(points, faces)
    if d.chance(20):
        data = damage_bytes(d, data)
    scale = [d.pick((1.0, 1.0, 1.0, -1.0, 1e-3, 1e3))] * 3
    if d.chance(15):
        scale[d.whole(0, 2)] = d.pick(EXTREME)
    return {
        "file": "m.obj" if kind == "obj" else "m.stl",
        "data": data.decode("latin-1"),
        "scale": " ".join(map(repr, scale)),
        "mjcf": d.chance(30),
        "more": d.pick(("", "", 'inertia="shell"', 'inertia="exact"', 'inertia="convex"', 'maxhullvert="8"')),
        "run": run_settings(d),
    }


def solid(d: Draws) -> tuple[list[list[float]], list[tuple[int, ...]]]:
    """Return vertices and faces of a solid, of a random cloud, a disc or a bar."""
    kind = d.whole(0, 5)
    size = d.pick((1.0, 1.0, 0.1, 1e-3, 1e-6, 1e3, 1e6))
    if kind <= 1:
        points, faces = TETRAHEDRON, FACES
    elif kind <= 3:
        points, faces = BOX, BOX_FACES
    elif kind == 4:  # a cloud, in triangles of three each
        points = [(d.number(-1, 1), d.number(-1, 1), d.number(-1, 1)) for _ in range(3 * d.whole(2, 10))]
        faces = [(k, k + 1, k + 2) for k in range(0, len(points), 3)]
    else:  # a cone above a finely divided circle
        count = d.whole(3, 300)
        turn = 2.0 * math.pi / count
        points = [(math.cos(turn * k), math.sin(turn * k), 0.0) for k in range(count)] + [(0.0, 0.0, d.number(-1, 1))]
        faces = [(k, (k + 1) % count, count) for k in range(count)]
    stretch = [size * (d.pick((1e-2, 1e-4, 1e-5, 1e-6, 1e-7, 1e-9, 0.0)) if d.chance(10) else 1.0) for _ in range(3)]
    shift = d.pick((0.0, 0.0, 0.0, 1.0, 1e4, 1e8)) if d.chance(30) else 0.0
    return [[shift + s * x for s, x in zip(stretch, point, strict=True)] for point in points], list(faces)


def _damage(d: Draws, points: list[list[float]], faces: list[tuple[int, ...]]) -> None:
    kind = d.whole(0, 5)
    k = d.whole(0, len(points) - 1)
    if kind <= 1:
        points[k][d.whole(0, 2)] = d.pick((*EXTREME, math.nan, math.inf, -math.inf, 3.4e38, 1e-38, 1e-45))
    elif kind == 2:
        points[k] = list(d.pick(points))
    elif kind == 3 and len(faces) > 1:
        del faces[d.whole(0, len(faces) - 1)]
    elif kind == 4:
        faces.append(
            tuple(d.pick((0, 1, len(points) - 1, -1, len(points), 10**6, 2**31)) for _ in range(d.whole(0, 5)))
        )
    else:
        points += [list(point) for point in points]


def _corners(points: list[list[float]], face: tuple[int, ...]) -> list[list[float]]:
    """Return three corners of a face; STL has no numbers of vertices that could be wrong."""
    return [points[k % len(points)] for k in (*face, 0, 0, 0)[:3]]


def binary_stl(points: list[list[float]], faces: list[tuple[int, ...]]) -> bytes:
    """Return a binary STL file."""
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(_single(x) for p in _corners(points, face) for x in p), 0) for face in faces
    )
    return b"x" * 80 + struct.pack("<I", len(faces)) + body


def _single(number: float) -> float:
    return number if not abs(number) > 3.4e38 or math.isinf(number) else math.copysign(math.inf, number)


def ascii_stl(points: list[list[float]], faces: list[tuple[int, ...]]) -> bytes:
    """Return an STL file in text."""
    lines = ["solid x"]
    for face in faces:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += [f"vertex {x!r} {y!r} {z!r}" for x, y, z in _corners(points, face)] + ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid x", ""]).encode()


def obj(points: list[list[float]], faces: list[tuple[int, ...]]) -> bytes:
    """Return an OBJ file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    return "\n".join([*lines, ""]).encode()


def attempt(case: Case) -> bool:
    """Read a model that has the mesh, and let it fall."""
    Path(case["file"]).write_bytes(case["data"].encode("latin-1"))
    scene = cvi.Scene()
    if case["mjcf"]:
        Path("m.xml").write_text(MJCF.format(**case))
        scene.add_mjcf("m.xml")
    else:
        Path("m.urdf").write_text(URDF.format(**case))
        scene.add_urdf("m.urdf", base="free")
    scene.add_halfspace(offset=-2.0)
    return use(scene, case["run"])
