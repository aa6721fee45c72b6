"""Checks of a pin.Model before it goes to the engine: supported joints, depth-first order, numbers, mass.

A model that cannot be simulated raises an error; data that merely look wrong are "suspicious" notes in the report.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from contactvi.elements.element import Element
from contactvi.errors import SceneError, UnsupportedJointError
from contactvi.importing.couplings import Coupled, coupled_basis, find_followers, on_couplings
from contactvi.importing.engine_model import EngineModel, engine_model
from contactvi.importing.joint_kinds import NO_LIMIT, ONE_DOF, has_limits, joint_kind, motion_axis
from contactvi.importing.report import BodyRow, JointRow, PartReport, number
from contactvi.inputs import LARGEST

MOST_DOFS = 4000  # of one model: its mass matrix is checked by its eigenvalues, which take 8 s for so many
SINGULAR = 1e-12  # eigenvalue of the scaled mass matrix below which a motion has no inertia
FILE_FRICTION = "joint friction"  # beginning of the note on the friction that a file gives a joint
NEARLY_SINGULAR = 1e-9  # such an eigenvalue of one pose below which velocities have at most half of their digits
_STILL = 1e-6  # of the largest velocity: less is the rounding of a motion that was computed
FAST_DAMPING = 1e3  # [1/s] damping / inertia above which a motion dies within a millisecond


def check_size(model: pin.Model, source: str) -> None:
    """Raise SceneError for a model that the checks below cannot hold in memory."""
    if model.nv > MOST_DOFS:
        raise SceneError(
            f"{source} has too many degrees of freedom",
            expected=f"at most {MOST_DOFS} in one model",
            got=model.nv,
            remedy="Split it into several files",
        )


def check_lengths(model: pin.Model, source: str) -> None:
    """Raise SceneError for arrays of a model that do not belong to its joints: Python may replace them by any."""
    of = {
        "nq": ("lowerPositionLimit", "upperPositionLimit"),
        "nv": ("damping", "armature", "rotorInertia", "rotorGearRatio"),
        "njoints": ("names", "parents", "inertias", "jointPlacements", "idx_vs", "nvs"),
    }
    for size, name in ((size, name) for size, names in of.items() for name in names):
        if len(getattr(model, name)) != getattr(model, size):
            raise SceneError(
                f"{source}: {name} of the model",
                expected=f"{getattr(model, size)} entries ({size})",
                got=f"{len(getattr(model, name))}",
                remedy="Set its entries, not the array: model.armature[3] = 0.1",
            )


def check_joints(model: pin.Model, report: PartReport, source: str) -> None:
    """Raise for an unsupported joint (all are noted, the first is raised), a wrong order and duplicate names."""
    refused = [i for i in range(1, model.njoints) if joint_kind(model.joints[i]) is None]
    for i in refused:
        report.note("refused", "joint", model.names[i], f"type {model.joints[i].shortname()} is not supported")
    if refused:
        name, kind = model.names[refused[0]], model.joints[refused[0]].shortname()
        remedy = "Use a spherical joint, or a chain of revolute joints with a body each"
        if kind == "JointModelMimic":
            remedy = "Build the model with mimic=False: the joint becomes independent"
        raise UnsupportedJointError(
            f"Joint {name!r} of {source}",
            joint=name,
            joint_type=kind,
            expected="revolute, continuous, prismatic, helical, planar, translation, spherical or free-flyer",
            got=kind,
            remedy=remedy,
        )
    names = list(model.names)
    for name, count in Counter(names).items():
        if count > 1:
            raise SceneError(
                f"{source}: two joints are called {name!r}",
                joint=name,
                expected="distinct names",
                got=name,
                remedy="Rename one of them; models that are added twice take a prefix: prefix='left_'",
            )
    branch = [0]  # joints from the world to the last one that was visited
    for i in range(1, model.njoints):
        while branch and branch[-1] != model.parents[i]:
            branch.pop()
        if not branch:
            raise SceneError(
                f"{source}: joint {names[i]!r} does not follow its parent's other descendants",
                joint=names[i],
                expected="joints in depth-first order",
                got=f"parents {list(model.parents)}",
                remedy="Add each joint's whole subtree before its next sibling",
            )
        branch.append(i)
    for i in range(1, model.njoints):
        if joint_kind(model.joints[i]) in ONE_DOF:
            length = np.linalg.norm(motion_axis(model.joints[i])[3:]) or np.linalg.norm(motion_axis(model.joints[i]))
            if not abs(length - 1.0) < 1e-6:
                raise SceneError(
                    f"{source}: axis of joint {names[i]!r}",
                    joint=names[i],
                    expected="a unit vector",
                    got=f"length {length:g}",
                    remedy="Divide the axis by its length",
                )


def check_numbers(model: pin.Model, source: str) -> None:
    """Raise SceneError for numbers that are not finite, negative masses and negative damping."""
    for i in range(model.njoints):
        inertia, name = model.inertias[i], model.names[i]
        values = [inertia.mass, *inertia.lever, *inertia.inertia.ravel(), *model.jointPlacements[i].homogeneous.ravel()]
        if not np.all(np.abs(values) <= LARGEST):
            worst = "nan or inf" if not np.all(np.isfinite(values)) else f"{np.max(np.abs(values)):g}"
            wanted = f"finite, at most {LARGEST:g}"
            what = f"{source}: numbers of joint {name!r}"
            raise SceneError(what, joint=name, expected=wanted, got=worst, remedy="Correct them in the model")
        if inertia.mass < 0.0:
            raise SceneError(
                f"{source}: mass moved by joint {name!r}",
                joint=name,
                expected=">= 0 kg",
                got=f"{inertia.mass:g} kg",
                remedy="Correct the sign of its mass in the model",
            )
    for what, values in (("damping", model.damping), ("armature", model.armature)):
        bad = np.flatnonzero(~((values <= LARGEST) & (values >= 0.0)))
        if len(bad):
            name = dof_joint(model, int(bad[0]))
            raise SceneError(
                f"{source}: {what} of joint {name!r}",
                joint=name,
                expected=f">= 0, at most {LARGEST:g}",
                got=values[bad[0]],
                remedy=f"Correct it in the model: model.{what}, or the {what} of the joint in the file",
            )
        _check_isotropy(model, what, np.asarray(values), source)
    for frame in model.frames:
        if not frame.inertia.mass >= 0.0:
            raise SceneError(
                f"{source}: mass of frame {frame.name!r}",
                body=frame.name,
                expected=">= 0 kg",
                got=frame.inertia.mass,
                remedy="Correct the sign of its mass in the model",
            )


def _check_isotropy(model: pin.Model, what: str, values: np.ndarray, source: str) -> None:
    """Raise for damping or armature that differs between directions, and for armature on free and planar joints.

    The engine chooses the axes of joints itself and splits free and planar joints in two.
    """
    for i in range(1, model.njoints):
        joint, kind = model.joints[i], str(joint_kind(model.joints[i]))
        own = values[joint.idx_v : joint.idx_v + joint.nv]
        halves = np.split(own, {"free": [3], "planar": [2]}.get(kind, []))
        wanted = "the same number in all directions"
        bad = any(np.ptp(half) > 0.0 for half in halves)
        if what == "armature" and len(halves) == 2:
            wanted, bad = "none", bool(np.any(own))
        if bad:
            title = f"{source}: {what} of the {kind} joint {model.names[i]!r}"
            raise SceneError(
                title,
                joint=model.names[i],
                expected=wanted,
                got=str(own),
                remedy="Remove it from the file"
                if wanted == "none"
                else f"Give all directions of this joint one {what}",
            )


def body_masses(model: pin.Model) -> list[tuple[str, int, float]]:
    """Return (body, joint index, mass [kg]) of every body frame.

    Pinocchio sums the links of a joint into one inertia and leaves the mass of a link behind a fixed joint on that
    joint's frame; the first body of a joint has the rest.
    """
    rest = [inertia.mass for inertia in model.inertias]
    first: dict[int, int] = {}
    result: list[tuple[str, int, float]] = []
    for frame in model.frames:
        joint, mass = frame.parentJoint, frame.inertia.mass
        if frame.type == pin.FrameType.BODY:
            above = model.frames[frame.parentFrame]
            if above.type == pin.FrameType.FIXED_JOINT and above.parentJoint == joint:
                mass += above.inertia.mass
            first.setdefault(joint, len(result))
            result.append((frame.name, joint, mass))
        rest[joint] -= frame.inertia.mass
    for joint, row in first.items():
        name, _, mass = result[row]
        # A remainder below the rounding of the sum counts as zero.
        remainder = rest[joint] if rest[joint] > 1e-12 * model.inertias[joint].mass else 0.0
        result[row] = (name, joint, mass + remainder)
    return result


def dof_joint(model: pin.Model, dof: int) -> str:
    """Return the name of the joint that owns velocity index `dof`."""
    for i in range(1, model.njoints):
        if model.idx_vs[i] <= dof < model.idx_vs[i] + model.nvs[i]:
            return str(model.names[i])
    return "universe"


def check_mass(
    model: pin.Model, q: np.ndarray, report: PartReport, prefix: str = "", elements: Sequence[Element] = ()
) -> np.ndarray:
    """Return the diagonal of the mass matrix near q, shape (nv,); note where it is nearly singular at q itself.

    Where joints are coupled by the elements it is the mass matrix of those that lead, and of a follower the diagonal
    has the inertia of its leader, as it counts there.

    Raises:
        SceneError: some motion has no inertia (a joint that moves nothing), at a generic pose near q.
    """
    if model.nv == 0:
        return np.zeros(0)
    # The pose is generic: at a special one even a good model may be singular, and a bad one regular.
    generic = pin.integrate(model, q, 0.3 * np.sin(1.0 + np.arange(model.nv)))
    own = engine_model(model)
    followers, _ = find_followers(model, elements, prefix)
    generic, q = (on_couplings(model, at, followers) for at in (generic, q))
    diagonal, least, worst = _least_inertia(own, generic, SINGULAR, model, followers)
    if least < SINGULAR:
        name = dof_joint(model, worst)
        raise SceneError(
            f"{report.title.partition(':')[0]}: joint {name!r} moves no mass",
            joint=name,
            expected="a positive mass or inertia behind every joint",
            got=_no_inertia(diagonal[worst], least),
            remedy=f"Give {_moved_by_nothing(model, own, generic, followers)} an <inertial>, make the joint fixed, or "
            "give it an armature: "
            f"add_urdf(..., armature={{{name!r}: 1e-4}}), or model.armature of a Pinocchio model",
        )
    _, here, worst = _least_inertia(own, q, NEARLY_SINGULAR, model, followers)
    if here < NEARLY_SINGULAR:
        name = dof_joint(model, worst)
        text = (
            f"a motion of it and others has nearly no inertia in the neutral pose ({here:.1g} of theirs): runs from "
            f"there are nonsense; set_joint({prefix + name!r}, armature=1e-4) mends it"
        )
        report.note("suspicious", "joint", prefix + name, text)
    return diagonal


def _no_inertia(own: float, least: float) -> str:
    """Say what moves nothing: a joint whose own inertia is next to nothing, or a motion of several joints together."""
    if own < np.finfo(float).tiny:  # as in _least_inertia
        return f"inertia {own:g} about it"
    return (
        f"a motion of this joint and others together that moves nothing ({least:.1g} of their inertias; {own:g} about "
        "this joint alone)"
    )


def _moved_by_nothing(model: pin.Model, own: EngineModel, q: np.ndarray, followers: Sequence[Coupled]) -> str:
    """Name the links that move in the motion without inertia at q: what is behind a joint, or the base before it."""
    from scipy.linalg import eigh

    S = coupled_basis(model, followers)
    mass = S.T @ np.asarray(own.mass_matrix(q)) @ S
    diagonal, _, worst = _least_of(mass, SINGULAR)
    motion = S[:, worst]
    if diagonal[worst] >= np.finfo(float).tiny:
        scale = 1.0 / np.sqrt(diagonal)
        motion = S @ (scale * eigh(scale[:, None] * mass * scale, subset_by_index=[0, 0])[1][:, 0])
    data = model.createData()
    pin.forwardKinematics(model, data, q, motion)
    speeds = np.array([np.linalg.norm(velocity.vector) for velocity in data.v])
    moved = np.flatnonzero(speeds > _STILL * speeds.max())
    links = [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint in moved]
    names = links or [f"what joint {model.names[i]!r} moves" for i in moved]
    shown = [repr(name) if links else name for name in names[:3]]
    return ("the link " if len(links) == 1 else "the links " if links else "") + ", ".join(
        [*shown, *(["..."] if len(names) > 3 else [])]
    )


def _least_inertia(
    own: EngineModel, q: np.ndarray, enough: float, model: pin.Model, followers: Sequence[Coupled]
) -> tuple[np.ndarray, float, int]:
    """Return the diagonal of M(q), the least eigenvalue of M scaled to a unit diagonal, and the dof that moves most.

    Where the eigenvalue is above `enough`, a lower bound above it may stand for it, and any dof. Of coupled joints
    S^T M S takes the place of M.
    """
    mass = np.asarray(own.mass_matrix(q))
    if not followers:
        return _least_of(mass, enough)
    S = coupled_basis(model, followers)
    diagonal, least, worst = _least_of(S.T @ mass @ S, enough)
    led = {int(model.idx_vs[f.joint]) for f in followers}
    left = [dof for dof in range(model.nv) if dof not in led]
    with np.errstate(divide="ignore"):
        shares = np.divide(S**2, diagonal, out=np.zeros_like(S), where=S != 0.0)
        return 1.0 / shares.sum(axis=1), least, left[worst]


def _least_of(mass: np.ndarray, enough: float) -> tuple[np.ndarray, float, int]:
    diagonal = np.diag(mass).copy()
    worst = int(np.argmin(diagonal))
    if diagonal[worst] < np.finfo(float).tiny:  # below it doubles have lost digits, and M^-1 overflows
        return diagonal, 0.0, worst
    scale = 1.0 / np.sqrt(diagonal)
    scaled = mass * scale[:, None] * scale  # the product of two scales alone may overflow
    # The norm of the inverse is at least its largest eigenvalue, and takes a tenth of the time of eigenvalues. The
    # factor 2 is far more than its rounding: 1e-16 over the eigenvalue.
    with contextlib.suppress(np.linalg.LinAlgError):
        bound = 1.0 / float(np.linalg.norm(np.linalg.inv(scaled)))
        if bound > 2.0 * enough:
            return diagonal, bound, worst
    from scipy.linalg import eigh  # takes a while to import, and few models come here

    values, vectors = eigh(scaled, subset_by_index=[0, 0])  # of 1000 dofs in a fifth of the time of all of them
    return diagonal, float(values[0]), int(np.argmax(np.abs(vectors[:, 0])))


def describe_model(
    model: pin.Model,
    report: PartReport,
    q: np.ndarray,
    prefix: str = "",
    mimics: Mapping[str, object] | None = None,
    elements: Sequence[Element] = (),
) -> None:
    """Fill the body and joint tables of the report and note suspicious data; q is the neutral pose, shape (nq,)."""
    names = list(model.names)
    for body, joint, mass in body_masses(model):
        report.bodies.append(BodyRow(prefix + body, prefix + names[joint] if joint else names[0], mass))
    diagonal = check_mass(model, q, report, prefix, elements)
    for i in range(1, model.njoints):
        _describe_joint(model, i, report, prefix, str((mimics or {}).get(names[i], "")), diagonal)
        _describe_inertia(model, i, report, prefix)


def _describe_joint(
    model: pin.Model, i: int, report: PartReport, prefix: str, mimic: str, diagonal: np.ndarray
) -> None:
    joint, name = model.joints[i], prefix + model.names[i]
    kind = joint_kind(joint) or joint.shortname()
    dofs = slice(joint.idx_v, joint.idx_v + joint.nv)
    damping, friction = np.max(model.damping[dofs]), np.max(model.upperDryFrictionLimit[dofs])
    lower = upper = np.nan
    limited = has_limits(model, i)
    if kind in ONE_DOF and joint.nq == 1:
        lower, upper = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        lower, upper = (x if abs(x) < NO_LIMIT else np.nan for x in (lower, upper))
        if not limited and not np.isnan(lower) and not np.isnan(upper):
            text = f"limits lower >= upper ({number(lower)}, {number(upper)}): treated as no limit"
            report.note("suspicious", "joint", name, text)
        elif not limited:
            report.note("used", "joint", name, "no limits")
    elif kind == "continuous":
        report.note("used", "joint", name, "unbounded: no limits")
    parent = prefix + model.names[model.parents[i]] if model.parents[i] else "universe"
    report.joints.append(JointRow(name, kind, parent, lower, upper, damping, friction, limited, mimic))
    if friction > 0.0:
        report.note(
            "ignored",
            "joint",
            name,
            f"{FILE_FRICTION} of the file: not used, unless by set_joint(joint, friction=True)",
        )
    with np.errstate(over="ignore"):
        rate = np.max(model.damping[dofs] / diagonal[dofs])
    if rate > FAST_DAMPING:
        text = (
            f"damping {number(damping)} is unusually large for the joint-space inertia "
            f"{number(np.min(diagonal[dofs]))}: a motion dies within {number(1.0 / rate)} s; "
            "set_joint(damping=) replaces it"
        )
        report.note("suspicious", "joint", name, text)


def _describe_inertia(model: pin.Model, i: int, report: PartReport, prefix: str) -> None:
    inertia, name = model.inertias[i], prefix + model.names[i]
    if inertia.mass <= 0.0 and not any(f.parentJoint == i and f.type == pin.FrameType.BODY for f in model.frames):
        return  # one of several joints of a body, the last of which carries it
    if inertia.mass <= 0.0:
        report.note("suspicious", "body", name, "no mass of its own (the joints behind it carry some)")
        return
    moments = np.linalg.eigvalsh(inertia.inertia)
    # Files give 4 to 6 digits, and a thin plate or a point mass lies exactly on the bound.
    slack = 1e-3 * max(moments[2], 0.0)
    if moments[0] < -slack:
        report.note("suspicious", "body", name, f"negative moment of inertia {number(moments[0])}")
    elif moments[0] + moments[1] < moments[2] - slack:
        values = ", ".join(number(m) for m in moments)
        report.note("suspicious", "body", name, f"moments of inertia ({values}) break the triangle inequality")
