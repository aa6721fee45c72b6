"""A compiled MJCF as the part of a scene."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import SceneError
from contactvi.importing.given_surfaces import with_surface
from contactvi.importing.mesh_hulls import MeshHulls
from contactvi.importing.mjcf.actuators import actuators_of
from contactvi.importing.mjcf.compiler import Source
from contactvi.importing.mjcf.contacts import geom_friction, geom_pairs, geom_turning, pair_title, surface_velocity
from contactvi.importing.mjcf.contacts import restitution as ratio_of_speeds
from contactvi.importing.mjcf.forces import Forces
from contactvi.importing.mjcf.shapes import Shape, Shapes, color_of, in_pictures
from contactvi.importing.mjcf.states import configuration_of, inside_limits, velocity_of
from contactvi.importing.mjcf.tree import Tree, build_tree
from contactvi.importing.part import FileData, Part
from contactvi.importing.pictures import Picture, Surface

SOLREF = "solref"  # value of the argument restitution: from the damping ratios of the file's contacts
ALLOWED = ("flex",)  # values of the argument allow: what is refused unless it is named


@dataclass(frozen=True)
class MjcfFile:
    """A file that MuJoCo has compiled."""

    path: Path
    source: Source

    @property
    def gravity(self) -> np.ndarray:
        """Acceleration of free fall in the file [m/s^2], shape (3,)."""
        off = self.source.off("GRAVITY")
        return np.zeros(3) if off else np.array(self.source.m.opt.gravity, dtype=float)


@dataclass(frozen=True)
class Choices:
    """How a file is added, as in Scene.add_mjcf; gravity [m/s^2], shape (3,), is the scene's."""

    prefix: str
    placement: pin.SE3
    gravity: np.ndarray
    equality: bool
    actuators: bool
    restitution: float | str | None
    allow: tuple[str, ...] = ()
    turning_friction: bool = False
    hfield: str = "prisms"


def part_of(opened: MjcfFile, choices: Choices, hulls: MeshHulls) -> Part:
    """Return the part of a compiled model; `hulls` is given the meshes of its collision shapes."""
    source, prefix, placement = opened.source, choices.prefix, choices.placement
    m = source.m
    if m.nbody == 1 and m.ngeom == 0:
        raise SceneError(
            f"{opened.path.name} has nothing in it",
            path=opened.path,
            expected="bodies or geoms",
            got="an empty world",
            remedy="Load the file that includes this one",
        )
    _check_deformables(opened, choices.allow)
    tree = build_tree(source)
    name = _model_name(source) or opened.path.stem
    tree.model.name = name
    shapes = Shapes(source, choices.hfield)
    collision, index = _collision(source, tree, shapes, hulls)
    drawn = [(_geometry(source, tree, g, shape), shape.mesh) for g in in_pictures(source) for shape in shapes.of(g)]
    forces = Forces(source, tree, prefix, placement, choices.gravity)
    data = FileData(springs=forces.springs(), actuators=actuators_of(source, prefix) if choices.actuators else [])
    data.elements = [*(forces.constraints() if choices.equality else []), *forces.tendons(), *forces.wrenches()]
    given = _contacts(source, collision, index, data, choices)
    qpos = inside_limits(source, np.array(m.qpos0))
    part = Part(
        name=prefix + name,
        kind="mjcf",
        model=tree.model,
        collision=collision,
        start=configuration_of(source, qpos),
        report=source.report,
        load_pictures=cache(lambda: [Picture(item, _surface(source, mesh)) for item, mesh in drawn]),
        prefix=prefix,
        placement=placement,
        given_pairs=given,
        checks_overlaps=True,
        data=data,
    )
    for key, title in enumerate(source.names["key"]):
        qpos, qvel = np.array(m.key_qpos[key]), np.array(m.key_qvel[key])
        if not source.given["key"][key] and np.array_equal(qpos, m.qpos0) and not np.any(qvel):
            continue  # one of those that <size nkey=".."/> adds says nothing
        data.configurations[title] = configuration_of(source, qpos), velocity_of(source, qpos, qvel)
        if np.any(m.key_act[key]) or np.any(m.key_ctrl[key]):
            source.lose("keyframe", title, "its controls (ctrl, act)")
    _place_free_joints(part)
    for geom in range(m.ngeom):
        for shape in shapes.of(geom) if geom in index else ():
            if shape.field is not None:
                part = with_surface(part, source.names["geom"][geom], shape.field)
    _note_rest(source)
    if not np.allclose(opened.gravity, choices.gravity):
        own = ", ".join(f"{x:g}" for x in opened.gravity)
        source.lose("option", "gravity", f"({own}) m/s^2 of the file: the scene has its own; Scene.from_mjcf takes it")
    return part


def _check_deformables(opened: MjcfFile, allow: tuple[str, ...]) -> None:
    """Raise SceneError for flexes, whose bodies without the elasticity between them are loose particles."""
    source = opened.source
    names, m = source.names["flex"], source.m
    if not names:
        return
    shown = ", ".join(repr(name) for name in names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    bodies = len({int(body) for body in m.flex_vertbodyid if body > 0})
    if "flex" in allow:
        text = f"not simulated: its vertices are {bodies} bodies in all, without elasticity, volume and contact surface"
        for name in names:
            source.lose("flex", name, text)
        return
    raise SceneError(
        f"{opened.path.name} has deformable bodies",
        path=opened.path,
        expected="rigid bodies (no flex, no flexcomp)",
        got=f"{len(names)} flex: {shown}, with {bodies} bodies at its vertices",
        remedy="Take them out of the file, or put rigid bodies in their place; allow=('flex',) (in a scene file allow "
        '= ["flex"], on the command line --allow flex) runs their vertices as loose bodies without elasticity and '
        "contact surface",
    )


def _model_name(source: Source) -> str:
    """Return the name of the model, which is the first one in MuJoCo's list of names."""
    return bytes(source.m.names).partition(b"\0")[0].decode("utf-8", "replace")


def _surface(source: Source, mesh: int | None) -> Surface | None:
    return None if mesh is None else source.meshes.of(mesh)


def _geometry(source: Source, tree: Tree, geom: int, shape: Shape) -> pin.GeometryObject:
    m, body = source.m, int(source.m.geom_bodyid[geom])
    place = tree.at(body, m.geom_pos[geom], m.geom_quat[geom])
    name = source.names["geom"][geom] + shape.suffix
    made = pin.GeometryObject(name, tree.joint[body], tree.frame[body], place, shape.solid)
    made.meshColor = color_of(source, geom)
    return made


def _collision(
    source: Source, tree: Tree, shapes: Shapes, hulls: MeshHulls
) -> tuple[pin.GeometryModel, dict[int, list[int]]]:
    """Return the geoms that can touch anything, and the numbers of the shapes of each geom."""
    m, model = source.m, pin.GeometryModel()
    listed = {int(g) for g in (*m.pair_geom1, *m.pair_geom2)}
    bits = np.asarray(m.geom_contype) | np.asarray(m.geom_conaffinity)
    index: dict[int, list[int]] = {}
    for geom in range(m.ngeom):
        if bits[geom] or geom in listed:
            index[geom] = []
            for shape in shapes.of(geom):
                made = _geometry(source, tree, geom, shape)
                if shape.mesh is not None:
                    hulls.take_surface(made, *source.meshes.of(shape.mesh), title=source.given["mesh"][shape.mesh])
                index[geom].append(model.addGeometryObject(made))
    return model, index


def _contacts(
    source: Source,
    collision: pin.GeometryModel,
    index: dict[int, list[int]],
    data: FileData,
    choices: Choices,
) -> list[tuple[int, int]]:
    """Return the pairs that are tested, and enter friction and restitution of geoms and pairs into the data."""
    names = [geometry.name for geometry in collision.geometryObjects]
    given: list[tuple[int, int]] = []
    bounce = choices.restitution
    single = None if bounce is None or bounce == SOLREF else float(bounce)
    for geom, shapes in index.items():
        for k in shapes:
            data.contact[names[k],] = geom_friction(source, geom), single
            if (velocity := surface_velocity(source, geom)) is not None:
                data.surface_velocities[names[k]] = velocity
            if choices.turning_friction:
                data.turning[names[k],] = geom_turning(source, geom)
    for pair in geom_pairs(source):
        if pair.untaken and not choices.turning_friction:
            source.lose("pair", pair_title(source, pair.a, pair.b), pair.untaken)
        ratio = ratio_of_speeds(pair.damping_ratio) if bounce == SOLREF else single
        for i, j in itertools.product(index[pair.a], index[pair.b]):
            given.append((i, j))
            data.contact[names[i], names[j]] = pair.friction, ratio
            if pair.adhesion:
                data.adhesion[names[i], names[j]] = pair.adhesion
            if choices.turning_friction:
                data.turning[names[i], names[j]] = pair.turning
    data.limit_restitution = single
    return given


def _place_free_joints(part: Part) -> None:
    """Let the values of free joints be poses in the scene's world, where the part is placed."""
    model, place = part.model, part.placement
    configurations = part.data.configurations
    for i in range(1, model.njoints):
        if model.nqs[i] != 7:
            continue
        # The assembled placement is that of the part times this one.
        model.jointPlacements[i] = place.inverse()
        own = slice(model.idx_qs[i], model.idx_qs[i] + 7)
        for q in (part.start, *(q for q, _ in configurations.values())):
            q[own] = pin.SE3ToXYZQUAT(place * pin.XYZQUATToSE3(q[own]))


def _note_rest(source: Source) -> None:
    """Note what else the file has and the engine has not."""
    m, option = source.m, source.m.opt
    present: dict[str, Any] = {
        "density": option.density, "viscosity": option.viscosity, "wind": np.any(option.wind),
        "skin": m.nskin, "plugin": m.nplugin,
    }  # fmt: skip
    for name, there in present.items():
        if there:
            source.lose("option", name, "not simulated")
    if m.nsensor:
        kinds = sorted({source.word("Sensor", kind) for kind in m.sensor_type})
        source.lose("sensor", f"{m.nsensor}", f"sensors: {', '.join(kinds)}")
    for body, name in enumerate(source.names["body"]):
        if m.body_mocapid[body] >= 0:
            source.report.note("changed", "body", name, "a mocap body, which stands still here")
