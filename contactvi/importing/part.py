"""A part of a scene: one imported model or one primitive, before all parts are assembled into one pin.Model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from contactvi.elements.element import Element
from contactvi.errors import InputError
from contactvi.importing.hulls import describe
from contactvi.importing.mjcf.actuators import Actuator
from contactvi.importing.pictures import Picture
from contactvi.importing.report import BodyRow, GeometryRow, PartReport
from contactvi.inputs import is_text, real, unit_vector, vector

COLORS = (
    (0.90, 0.40, 0.20, 1.0),
    (0.45, 0.66, 0.92, 1.0),  # lighter than the arrows of forces, shaded too
    (0.40, 0.70, 0.35, 1.0),
    (0.80, 0.65, 0.20, 1.0),
    (0.55, 0.40, 0.75, 1.0),
    (0.20, 0.65, 0.65, 1.0),
    (0.85, 0.45, 0.65, 1.0),
    (0.50, 0.35, 0.25, 1.0),
)
GROUND_COLOR = (0.75, 0.75, 0.72, 1.0)
GROUND_SIZE = 2.0  # [m] edge of the plate that a halfspace is drawn as
GROUND_THICKNESS = 0.01


@dataclass
class FileData:
    """What the file of a model says beyond bodies, joints and shapes; the scene takes it over.

    Attributes:
        elements: constraints, springs and forces, with the scene's names.
        springs: stiffness and rest of joints, by the file's names.
        actuators: actuators of an MJCF, with the scene's names.
        contact: friction and restitution (None: the scene's) of a geometry (name,) or a pair (name, name), by the
            file's names.
        surface_velocities: linear [m/s] and angular [rad/s] ones, (3,) each, of geometries whose surfaces move along
            themselves, by the file's names.
        adhesion: of pairs [N], by the file's names.
        turning: radii of friction against spinning and rolling [m], as `contact`.
        limit_restitution: restitution of the limits of joints, None: the scene's.
        configurations: q (nq,) and v (nv,) of the part by name: keyframes, reference poses.
    """

    elements: list[Element] = field(default_factory=list)
    springs: dict[str, tuple[float, Any]] = field(default_factory=dict)
    actuators: list[Actuator] = field(default_factory=list)
    contact: dict[tuple[str, ...], tuple[float, float | None]] = field(default_factory=dict)
    surface_velocities: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    adhesion: dict[tuple[str, str], float] = field(default_factory=dict)
    turning: dict[tuple[str, ...], tuple[float, float]] = field(default_factory=dict)
    limit_restitution: float | None = None
    configurations: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)


@dataclass
class Part:
    """One addition to the scene.

    Attributes:
        kind: "urdf", "mjcf", "pinocchio" or "primitive".
        model, collision: Pinocchio models without the prefix and without the placement.
        load_pictures: returns what is drawn; it is called late, because pictures load slowly.
        placement: where the part's own world frame lies in the scene's.
        start: neutral configuration of the part, shape (nq,).
        disabled: link pairs switched off by the SRDF, with its reason.
        given_pairs: collision pairs (geometry indices) given with the model; None = the default choice.
        checks_overlaps: whether given pairs that overlap in the model's own pose are left out.
        neutral_overlaps: of stored scenes, pairs (geometry indices) that overlap at the neutral pose, which runs test
            where they start apart: their depths as text, and whether both shapes were of one part.
        self_collision: whether links of the model may touch each other.
        mimics: mimic tags by joint, for the report.
        surfaces: surfaces given by functions (contactvi.scene.surfaces), each by the name of the geometry, a halfspace,
            in whose place it stands.
        data: what else the file says.
        place: how many parts the scene had before it; bodies without a colour have one by it.
    """

    name: str
    kind: str
    model: pin.Model
    collision: pin.GeometryModel
    start: np.ndarray
    report: PartReport
    load_pictures: Callable[[], list[Picture]]
    prefix: str = ""
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    disabled: list[tuple[str, str, str]] = field(default_factory=list)
    given_pairs: list[tuple[int, int]] | None = None
    checks_overlaps: bool = False
    neutral_overlaps: Mapping[tuple[int, int], tuple[str, bool]] = field(default_factory=dict)
    self_collision: bool = True
    mimics: Mapping[str, object] = field(default_factory=dict)
    surfaces: Mapping[str, Any] = field(default_factory=dict)
    data: FileData = field(default_factory=FileData)
    place: int = 0

    def joint_names(self) -> list[str]:
        return [self.prefix + name for name in list(self.model.names)[1:]]

    def body_names(self) -> list[str]:
        return [self.prefix + frame.name for frame in self.model.frames if frame.type == pin.FrameType.BODY]

    def geometry_names(self) -> list[str]:
        return [self.prefix + geometry.name for geometry in self.collision.geometryObjects]


def check_body_name(name: Any) -> None:
    """Raise InputError for what is no name of a body."""
    if not is_text(name):
        raise InputError(
            "Name of a body",
            name="name",
            expected="a non-empty str in UTF-8",
            got=repr(name),
            remedy="Give it a name such as 'ball'",
        )


def shape_part(
    name: str,
    shapes: Sequence[coal.CollisionGeometry],
    inertia: pin.Inertia | None,
    placement: pin.SE3,
    color: Sequence[float] | None,
    text: str = "",
) -> Part:
    """Return a part with one body and one shape or more: free (inertia given) or fixed to the world (None).

    The joint of a free body, its body and its only geometry all carry the body's name; of several geometries each has
    its number behind the name. text: how the shapes were made, for the report.
    """
    check_body_name(name)
    if inertia is not None:
        _check_inertia(name, inertia)
    rgba = None if color is None else vector(f"color of {name!r}", color, 4)
    model = pin.Model()
    model.name = name
    joint = 0
    start = np.zeros(0)
    if inertia is not None:
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.addJointFrame(joint, 0)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        start = pin.SE3ToXYZQUAT(placement)
    frame = model.addFrame(
        pin.Frame(name, joint, joint, pin.SE3.Identity(), pin.FrameType.BODY, inertia or pin.Inertia.Zero()), False
    )
    collision = pin.GeometryModel()
    names = [name] if len(shapes) == 1 else [f"{name}_{k}" for k in range(len(shapes))]
    for own, shape in zip(names, shapes, strict=True):
        collision.addGeometryObject(pin.GeometryObject(own, joint, frame, pin.SE3.Identity(), shape))
    what = text or describe(shapes[0])
    report = PartReport(f"{name}: {what}, {'free' if joint else 'fixed to the world'}")
    part = Part(
        name=name,
        kind="primitive",
        model=model,
        collision=collision,
        start=start,
        report=report,
        load_pictures=lambda: shown(collision, rgba if rgba is not None else _color(part)),
        placement=pin.SE3.Identity() if joint else placement,
    )
    if joint:
        report.bodies.append(BodyRow(name, name, model.inertias[joint].mass))
    report.geometries += [GeometryRow(own, name, describe(shape)) for own, shape in zip(names, shapes, strict=True)]
    return part


def with_inertia(part: Part, joint: str, body: pin.Inertia) -> Part:
    """Return the part with another inertia of what a joint (with the prefix) moves; the given one stays as it is.

    In the report the bodies of the joint share its mass as before.
    """
    index = part.joint_names().index(joint) + 1
    model = pin.Model(part.model)
    before = float(model.inertias[index].mass)
    model.inertias[index] = body
    rows = [row for row in part.report.bodies if row.joint == joint]
    shares = {row.name: row.mass / before if before > 0.0 else 1.0 / len(rows) for row in rows}
    bodies = [
        replace(row, mass=float(body.mass) * shares[row.name]) if row.joint == joint else row
        for row in part.report.bodies
    ]
    return replace(part, model=model, report=replace(part.report, bodies=bodies))


def _check_inertia(name: str, inertia: pin.Inertia) -> None:
    """Raise InputError where the moments of inertia overflow, or vanish to rounding (of a rod as thin as 1e-160 m)."""
    moments = np.diag(inertia.inertia)
    if not np.all(np.isfinite(moments)) or float(moments.min()) < np.finfo(float).tiny:
        raise InputError(
            f"The moments of inertia of {name!r} are not usable", name="size", expected="finite numbers > 0",
            got=f"{moments} kg m^2", remedy="Mind the units: m and kg",
        )  # fmt: skip


def _color(part: Part) -> Sequence[float]:
    """Return the colour of a body without one: those that are added one after the other have different ones."""
    return COLORS[part.place % len(COLORS)] if part.model.njoints > 1 else GROUND_COLOR


def shown(collision: pin.GeometryModel, color: Sequence[float] | np.ndarray) -> list[Picture]:
    """Return pictures of collision shapes."""
    copies = [geometry.copy() for geometry in collision.geometryObjects]
    for copy in copies:
        copy.meshColor = np.asarray(color, dtype=float)
    return [Picture(copy) for copy in copies]


def plate_of(geometry: pin.GeometryObject) -> pin.GeometryObject:
    """Return a plate whose upper face is the surface of a halfspace geometry."""
    halfspace = geometry.geometry
    normal = np.asarray(halfspace.n)
    rotation = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal).toRotationMatrix()
    centre = pin.SE3(rotation, normal * (halfspace.d - 0.5 * GROUND_THICKNESS))
    plate = geometry.copy()
    plate.geometry = coal.Box(GROUND_SIZE, GROUND_SIZE, GROUND_THICKNESS)
    plate.placement = geometry.placement * centre
    return plate


def sphere(name: str, radius: float, mass: float) -> tuple[coal.CollisionGeometry, pin.Inertia]:
    """Return shape and inertia of a solid sphere: radius [m], mass [kg]."""
    radius, mass = _size(name, "radius", radius), _size(name, "mass", mass)
    return coal.Sphere(radius), pin.Inertia.FromSphere(mass, radius)


def box(name: str, size: ArrayLike, mass: float) -> tuple[coal.CollisionGeometry, pin.Inertia]:
    """Return shape and inertia of a solid box: full edge lengths [m], mass [kg]."""
    edges = vector(f"size of {name!r}", size, 3)
    for edge in edges:
        _size(name, "size", edge)
    return coal.Box(*edges.tolist()), pin.Inertia.FromBox(_size(name, "mass", mass), *edges.tolist())


def capsule(name: str, radius: float, length: float, mass: float) -> tuple[coal.CollisionGeometry, pin.Inertia]:
    """Return shape and inertia of a solid capsule along z: radius and length without caps [m], mass [kg]."""
    radius, length = _size(name, "radius", radius), _size(name, "length", length)
    mass = _size(name, "mass", mass)
    return coal.Capsule(radius, length), pin.Inertia.FromCapsule(mass, radius, length)


def cylinder(name: str, radius: float, length: float, mass: float) -> tuple[coal.CollisionGeometry, pin.Inertia]:
    """Return shape and inertia of a solid cylinder along z: radius and length [m], mass [kg]."""
    radius, length = _size(name, "radius", radius), _size(name, "length", length)
    return coal.Cylinder(radius, length), pin.Inertia.FromCylinder(_size(name, "mass", mass), radius, length)


def ellipsoid(name: str, radii: ArrayLike, mass: float) -> tuple[coal.CollisionGeometry, pin.Inertia]:
    """Return shape and inertia of a solid ellipsoid: half axes along x, y, z [m], mass [kg]."""
    axes = vector(f"radii of {name!r}", radii, 3)
    for axis in axes:
        _size(name, "radii", axis)
    return coal.Ellipsoid(*axes.tolist()), pin.Inertia.FromEllipsoid(_size(name, "mass", mass), *axes.tolist())


def halfspace(normal: ArrayLike, offset: float, name: str) -> coal.CollisionGeometry:
    """Return the solid halfspace n.x <= offset [m]; the free side is where the normal points."""
    return coal.Halfspace(unit_vector(f"normal of {name!r}", normal), real(f"offset of {name!r}", offset))


def _size(name: str, what: str, value: float) -> float:
    return real(f"{what} of {name!r}", value, 0.0, open_low=True)


def take_names(part: Part, taken: dict[str, set[str]]) -> None:
    """Add the names of the part to those taken, by kind; raise InputError, and add none, where one is taken already."""
    kinds = {
        "part": [part.name],
        "joint": part.joint_names(),
        "body": part.body_names(),
        "geometry": part.geometry_names(),
    }
    for kind, new in kinds.items():
        double = next((name for name in new if name in taken.get(kind, ())), None)
        if double is not None:
            raise InputError(
                f"There is a {kind} called {double!r} already",
                name="name",
                expected="a new name",
                got=repr(double),
                remedy="Give another name, or a prefix: prefix='left_'",
            )
    for kind, new in kinds.items():
        taken.setdefault(kind, set()).update(new)


def copy_geometry(source: pin.GeometryModel | None) -> pin.GeometryModel:
    """Return a GeometryModel with copies of the objects (shapes shared) and without collision pairs."""
    # At once: a model that grows by one geometry after the other copies its table of pairs each time.
    result = pin.GeometryModel() if source is None else pin.GeometryModel(source)
    result.removeAllCollisionPairs()
    return result


def pictures(part: Part) -> list[Picture]:
    """Return the part's pictures, halfspaces as plates."""
    return [
        Picture(
            plate_of(shape) if surface is None and isinstance(shape.geometry, coal.Halfspace) else shape.copy(), surface
        )
        for shape, surface in ((picture.geometry, picture.surface) for picture in part.load_pictures())
    ]
