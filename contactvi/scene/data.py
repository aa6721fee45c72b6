"""A scene as plain data and back, as in stored runs: it is read without the model files and without the engine.

Layout (lists, numbers, strings, None; NumPy arrays only under "vertices" and "faces"; lengths in m, angles in rad):

format "contactvi-scene", version 1, gravity
joints      [{name, parent (index, 0 = world), type, axis, pitch, placement, mass, lever, inertia (3x3, about the centre
            of mass), lower, upper, damping, friction, armature}] in Pinocchio order without the universe; placement
            is {xyz, rotation (3x3)} in the parent joint's frame; lower and upper have nq numbers, the others nv
bodies      [{name, joint, placement}]
geometries  [{name, body, joint, placement, shape: {type, sizes | normal, offset | vertices, faces}}
            of a surface that a function gives: {type, kind, extent, vertices, faces}, the grid that is drawn; of a
            height field {type, heights, size}]; the
            pictures of a trajectory are stored beside the scene (visuals.py)
pairs, pair_restitution, pair_friction, restitution, friction (defaults)
compliances [{pair, stiffness, exponent, damping, friction, slip_speed}]: the compliant pairs, which are not among
            `pairs`. Not in files of older versions
neutral_overlaps [{pair, depth (text), one_part, restitution, friction}]: pairs that overlap at the neutral pose, of
            which a run tests those that are apart in its start; what the stored run tested is among `pairs` too. Not in
            files of older versions
stiffness, rest, limits, limit_restitution; start (neutral q); parts {name: {joints, bodies, geometries}}
dry_friction (nv), servo (3 x nv: kp, kd, effort), actuator (2 x nv: effort, velocity limits; inf: none), targets of
            servos {joint: motion}, polynomials [[joint (index), rest, [k1, k2, ...]]] of nonlinear springs
elements    as Element.to_data (elements.py); a motion is a number or {times, values}. missing: names of elements and
            targets that functions gave, and "surface of NAME" of surfaces, which are not stored
q0, v0, settings
camera      as `camera_of` takes it, or None; not in files of older versions
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from contactvi.elements.signals import Signal
from contactvi.elements.stored import element_from_data
from contactvi.errors import SceneError
from contactvi.importing.given_surfaces import SURFACES, GivenSurface, with_surface
from contactvi.importing.hulls import PRIMITIVES, faces_of, hull_from_faces, shape_sizes
from contactvi.importing.joint_kinds import MANY_DOFS, ONE_DOF, joint_kind, joint_model, motion_axis
from contactvi.importing.part import Part
from contactvi.importing.pictures import pictures_of
from contactvi.importing.report import PartReport
from contactvi.inputs import vector
from contactvi.scene.build import Built
from contactvi.scene.camera import Camera, camera_of
from contactvi.scene.compliance import compliance_name, compliances_from_dict, compliances_to_dict
from contactvi.scene.contact_laws import laws_from_data, laws_to_data
from contactvi.scene.contact_rules import ContactRules
from contactvi.scene.element_list import ElementList
from contactvi.scene.joints import JointSettings, JointTable, Servo
from contactvi.scene.pair_rules import Rule
from contactvi.scene.selection import PartHandle
from contactvi.scene.surface_motion import motions_from_data, motions_to_data
from contactvi.scene.surfaces import missing_name, surface_from_dict

FORMAT = "contactvi-scene"
VERSION = 1
_SHAPES = {shape.__name__.lower(): shape for shape in PRIMITIVES}


@dataclass
class SceneData:
    """The contents of a stored scene, from which `Scene.from_dict` makes one; apart: as `Scene.with_apart` takes it."""

    gravity: np.ndarray
    part: Part
    handles: dict[str, PartHandle]
    contact: ContactRules
    joints: JointTable
    elements: ElementList
    q0: np.ndarray | None
    v0: np.ndarray | None
    settings: dict[str, Any]
    camera: Camera | None
    apart: frozenset[tuple[str, str]]


def scene_to_dict(
    built: Built, contact: ContactRules, elements: ElementList, handles: Sequence[PartHandle]
) -> dict[str, Any]:
    """Return a complete scene as plain data (layout above, without q0, v0 and settings)."""
    model, arrays = built.model, built.arrays
    return {
        "format": FORMAT,
        "version": VERSION,
        "gravity": model.gravity.linear.tolist(),
        "joints": [_joint_to_dict(model, i) for i in range(1, model.njoints)],
        "bodies": [
            {"name": f.name, "joint": int(f.parentJoint), "placement": _place(f.placement)}
            for f in model.frames
            if f.type == pin.FrameType.BODY
        ],
        "geometries": [_geometry_to_dict(model, g, built.surfaces) for g in built.collision.geometryObjects],
        "pairs": [list(pair) for pair in built.pairs],
        "pair_restitution": built.restitution.tolist(),
        "pair_friction": built.friction.tolist(),
        "compliances": compliances_to_dict(built.elements.compliances),
        "neutral_overlaps": _overlaps_to_dict(built),
        "restitution": contact.restitution.default,
        "friction": contact.friction.default,
        "contact_laws": laws_to_data(built.laws, list(built.pairs)),
        "surface_motions": motions_to_data(built.surface_motions),
        "stiffness": arrays.stiffness.tolist(),
        "rest": arrays.rest.tolist(),
        "limits": [bool(used) for used in arrays.limits],
        "limit_restitution": arrays.limit_restitution.tolist(),
        "start": built.start.tolist(),
        **_actuation_to_dict(built),
        "elements": [element.to_data() for element in elements.elements if element.storable],
        "missing": [
            *(name for name in elements.missing if name not in _lost_by_themselves(built)),
            *(element.name for element in elements.elements if not element.storable),
            *(f"the law of contact of {built.pairs[places[0]]}" for law, places in built.laws if not law.storable),
            *(missing_name(name) for name, surface in built.surfaces.items() if not surface.storable),
            *(compliance_name(row.names) for row in built.elements.compliances if not row.law.storable),
            *(
                f"the surface velocity of {name}"
                for name, motion in built.surface_motions.items()
                if not motion.storable
            ),
            *(target_name(name) for name, goal in arrays.targets.items() if not goal.storable),
        ],
        "parts": {
            part.name: {"joints": list(part.joints), "bodies": list(part.bodies), "geometries": list(part.geometries)}
            for part in handles
        },
    }


def scene_from_dict(data: Mapping[str, Any]) -> SceneData:
    """Return what scene_to_dict described.

    Raises:
        SceneError: another format or version, or data that are missing or damaged.
    """
    if not isinstance(data, Mapping) or data.get("format") != FORMAT or data.get("version") != VERSION:
        got = f"{data.get('format')} {data.get('version')}" if isinstance(data, Mapping) else type(data).__name__
        raise SceneError(
            "Description of a scene",
            expected=f"{FORMAT} {VERSION}",
            got=got,
            remedy="Give what Scene.to_dict of this version returned, or read a scene file with load_scene",
        )
    try:
        return _read(data)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RuntimeError) as error:
        got = f"{type(error).__name__}: {error}"
        raise SceneError(
            "Damaged description of a scene",
            expected="the data of Scene.to_dict",
            got=got,
            remedy="Write it again with Scene.to_dict",
        ) from error


def _read(data: Mapping[str, Any]) -> SceneData:
    model = _model(data)
    collision = _collision(data, model)
    index = {g.name: k for k, g in enumerate(collision.geometryObjects)}
    overlaps = {
        tuple(map(str, row["pair"])): (str(row["depth"]), bool(row["one_part"]))
        for row in data.get("neutral_overlaps", ())
    }
    soft = [row["pair"] for row in data.get("compliances", ())]
    part = Part(
        name="stored",
        kind="pinocchio",
        model=model,
        collision=collision,
        start=vector("start", data["start"], model.nq),
        report=PartReport("scene from stored data"),
        load_pictures=lambda: pictures_of(collision),
        # An empty list means that no pair is tested.
        given_pairs=[(index[a], index[b]) for a, b in [*data["pairs"], *soft]],
        neutral_overlaps={(index[a], index[b]): row for (a, b), row in overlaps.items()},
    )
    for item in data["geometries"]:
        if item["shape"]["type"] in SURFACES:
            part = with_surface(part, str(item["name"]), surface_from_dict(item["shape"]))
    handles = {
        name: PartHandle(name, *(tuple(group[key]) for key in ("joints", "bodies", "geometries")))
        for name, group in data["parts"].items()
    }
    joints = _joints(data, model)
    elements = ElementList((element_from_data(element) for element in data["elements"]), map(str, data["missing"]))
    return SceneData(
        gravity=vector("gravity", data["gravity"], 3),
        part=part,
        handles=handles,
        contact=_contact(data),
        joints=joints,
        elements=elements,
        q0=None if data["q0"] is None else vector("q0", data["q0"], model.nq),
        v0=None if data["v0"] is None else vector("v0", data["v0"], model.nv),
        settings=dict(data["settings"]),
        camera=None if data.get("camera") is None else camera_of(data["camera"]),
        apart=frozenset((str(a), str(b)) for a, b in data["pairs"] if (a, b) in overlaps),
    )


def _lost_by_themselves(built: Built) -> set[str]:
    """Return the names in the list of what is missing of things that the scene still knows to have lost."""
    return {*map(missing_name, built.surfaces), *(compliance_name(row.names) for row in built.elements.compliances)}


def target_name(joint: str) -> str:
    """Return the name of the target of a servo in the list of what is missing."""
    return f"target of {joint}"


def _overlaps_to_dict(built: Built) -> list[dict[str, Any]]:
    found = built.overlaps
    columns = zip(found.names, found.depths, found.same_part, *built.overlap_values, strict=True)
    return [
        {"pair": list(pair), "depth": depth, "one_part": bool(one), "restitution": float(e), "friction": float(mu)}
        for pair, depth, one, e, mu in columns
    ]


def _actuation_to_dict(built: Built) -> dict[str, Any]:
    arrays = built.arrays
    return {
        "dry_friction": arrays.joint_friction.tolist(),
        "servo": arrays.servo.tolist(),
        "actuator": arrays.actuator.tolist(),
        "targets": {name: goal.to_data() for name, goal in arrays.targets.items() if goal.storable},
        "polynomials": [[int(i), float(rest), torque.tolist()] for i, rest, torque in arrays.polynomials],
    }


def _contact(data: Mapping[str, Any]) -> ContactRules:
    compliance = compliances_from_dict(data.get("compliances", ()))
    rules = ContactRules(Rule(float(data["restitution"])), Rule(float(data["friction"])), compliance)
    rules.laws = laws_from_data(data.get("contact_laws", ()))
    rules.surface_motions = motions_from_data(data.get("surface_motions", ()))
    for (a, b), e, mu in zip(data["pairs"], data["pair_restitution"], data["pair_friction"], strict=True):
        rules.restitution.set_pair([a], [b], float(e))
        rules.friction.set_pair([a], [b], float(mu))
    for row in data.get("neutral_overlaps", ()):
        a, b = row["pair"]
        rules.restitution.set_pair([a], [b], float(row["restitution"]))
        rules.friction.set_pair([a], [b], float(row["friction"]))
    return rules


def _joints(data: Mapping[str, Any], model: pin.Model) -> JointTable:
    settings: dict[str, JointSettings] = {}
    for i in range(1, model.njoints):
        q = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
        settings[model.names[i]] = JointSettings(
            stiffness=float(data["stiffness"][i]),
            rest=np.array(data["rest"][q], dtype=float),
            limits=None if data["limits"][i] else False,
            restitution=float(data["limit_restitution"][i]),
        )
    for index, _rest, torque in data["polynomials"]:
        settings[model.names[int(index)]].spring = np.array(torque, dtype=float)
    friction, servo, actuator = (np.array(data[key], dtype=float) for key in ("dry_friction", "servo", "actuator"))
    for i in range(1, model.njoints):
        if model.nvs[i] != 1:
            continue
        own, v = settings[model.names[i]], model.idx_vs[i]
        own.friction = float(friction[v]) or None
        own.effort, own.velocity = (float(limit) if np.isfinite(limit) else None for limit in actuator[:, v])
        if np.any(servo[:2, v]):
            goal = data["targets"].get(model.names[i])
            target = None if goal is None else Signal(goal, f"target of joint {model.names[i]!r}")
            own.servo = Servo(float(servo[0, v]), float(servo[1, v]), float(servo[2, v]), target)
    return JointTable(settings)


def _place(placement: pin.SE3) -> dict[str, Any]:
    return {"xyz": placement.translation.tolist(), "rotation": placement.rotation.tolist()}


def _placed(data: Mapping[str, Any]) -> pin.SE3:
    return pin.SE3(np.array(data["rotation"], dtype=float).reshape(3, 3), np.array(data["xyz"], dtype=float))


def _joint_to_dict(model: pin.Model, i: int) -> dict[str, Any]:
    joint, inertia = model.joints[i], model.inertias[i]
    kind = str(joint_kind(joint))
    axis: list[float] | None = None
    pitch = 0.0
    if kind in ONE_DOF:
        motion = motion_axis(joint)
        direction = motion[:3] if kind == "prismatic" else motion[3:]
        axis = direction.tolist()
        pitch = float(joint.extract().pitch) if kind == "helical" else 0.0
    q, v = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
    return {
        "name": model.names[i],
        "parent": int(model.parents[i]),
        "type": kind,
        "axis": axis,
        "pitch": pitch,
        "placement": _place(model.jointPlacements[i]),
        "mass": float(inertia.mass),
        "lever": inertia.lever.tolist(),
        "inertia": inertia.inertia.tolist(),
        "lower": model.lowerPositionLimit[q].tolist(),
        "upper": model.upperPositionLimit[q].tolist(),
        "damping": model.damping[v].tolist(),
        "friction": model.upperDryFrictionLimit[v].tolist(),
        "armature": model.armature[v].tolist(),
    }


def _joint_model(data: Mapping[str, Any]) -> Any:
    kind = data["type"]
    pitch = float(data["pitch"]) if kind == "helical" else 0.0
    return joint_model(kind, None if kind in MANY_DOFS else np.array(data["axis"], dtype=float), pitch)


def _model(data: Mapping[str, Any]) -> pin.Model:
    model = pin.Model()
    model.name = "scene"
    for joint in data["joints"]:
        i = model.addJoint(int(joint["parent"]), _joint_model(joint), _placed(joint["placement"]), str(joint["name"]))
        model.inertias[i] = pin.Inertia(
            float(joint["mass"]), np.array(joint["lever"], dtype=float), np.array(joint["inertia"], dtype=float)
        )
        q = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
        v = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
        model.lowerPositionLimit[q], model.upperPositionLimit[q] = joint["lower"], joint["upper"]
        model.damping[v], model.armature[v] = joint["damping"], joint["armature"]
        model.upperDryFrictionLimit[v] = joint["friction"]
    for body in data["bodies"]:
        joint_index = int(body["joint"])
        zero = pin.Inertia.Zero()
        frame = pin.Frame(body["name"], joint_index, 0, _placed(body["placement"]), pin.FrameType.BODY, zero)
        model.addFrame(frame, False)
    return model


def _geometry_to_dict(
    model: pin.Model, geometry: pin.GeometryObject, surfaces: Mapping[str, GivenSurface]
) -> dict[str, Any]:
    shape = geometry.geometry
    plain: dict[str, Any]
    if geometry.name in surfaces:
        plain = surfaces[geometry.name].to_data(geometry.name)
    elif isinstance(shape, coal.Halfspace):
        plain = {"type": "halfspace", "normal": shape.n.tolist(), "offset": float(shape.d)}
    elif isinstance(shape, coal.Convex):
        plain = {"type": "convex", "vertices": np.array(shape.points()), "faces": faces_of(shape)}
    else:
        plain = {"type": type(shape).__name__.lower(), "sizes": list(shape_sizes(shape).values())}
    return {
        "name": geometry.name,
        "body": model.frames[geometry.parentFrame].name,
        "joint": int(geometry.parentJoint),
        "placement": _place(geometry.placement),
        "shape": plain,
    }


def _shape(data: Mapping[str, Any]) -> coal.CollisionGeometry:
    kind = data["type"]
    if kind in SURFACES:
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
    if kind == "halfspace":
        return coal.Halfspace(np.array(data["normal"], dtype=float), float(data["offset"]))
    if kind == "convex":
        return hull_from_faces(data["vertices"], data["faces"])
    sizes = np.array(data["sizes"], dtype=float)
    return _SHAPES[kind](sizes) if kind == "ellipsoid" else _SHAPES[kind](*sizes.tolist())


def _collision(data: Mapping[str, Any], model: pin.Model) -> pin.GeometryModel:
    collision = pin.GeometryModel()
    frames = {f.name: k for k, f in enumerate(model.frames) if f.type == pin.FrameType.BODY}
    for item in data["geometries"]:
        frame, joint = frames.get(item["body"], 0), int(item["joint"])
        place = _placed(item["placement"])
        collision.addGeometryObject(pin.GeometryObject(item["name"], joint, frame, place, _shape(item["shape"])))
    return collision
