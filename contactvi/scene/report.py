"""The report of a complete scene: the findings of its parts, and what the scene uses, changes or adds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from contactvi.elements.constraints import Constraint
from contactvi.elements.element import Element
from contactvi.errors import SceneError
from contactvi.importing.checks import FILE_FRICTION
from contactvi.importing.part import Part
from contactvi.importing.report import ImportReport, Note, PartReport, Use, number
from contactvi.importing.urdf import FILE_LIMITS
from contactvi.scene.build import Built
from contactvi.scene.element_list import ElementList
from contactvi.scene.joints import JointSettings, JointTable

NO_SHAPES = "no shapes to touch with; where it has no pictures either it is drawn as lines from joint to joint"


def scene_report(parts: Sequence[Part], built: Built, table: JointTable, elements: ElementList) -> ImportReport:
    """Return the findings of the parts, joint settings that replace data of files, elements, pairs and shapes."""
    joints = table.settings
    damped = {name for name, settings in joints.items() if settings.damping is not None}
    with_friction = {built.elements.dofs[dof] for dof in np.flatnonzero(built.arrays.joint_friction)}
    actuated = {name for name, own in joints.items() if own.effort and own.velocity}
    limited = dict(zip(built.model.names, built.arrays.limits, strict=True))
    found = []
    for part in parts:
        kept = part.report.without("suspicious", damped, "damping").without("ignored", with_friction, FILE_FRICTION)
        found.append(_with_limits(kept.without("ignored", actuated, FILE_LIMITS), limited))
    report = ImportReport(found, list(built.pairs), list(built.removed))
    for name, settings in joints.items():
        report.notes += [Note(use, "joint", name, text) for use, text in _joint_notes(name, settings, built)]
    report.notes += [Note("used", "model", part.name, NO_SHAPES) for part in parts if _has_no_shapes(part)]
    report.notes += [_element_note(element) for element in elements.elements]
    lost = "given by a Python function, which is not stored: add it again to run the scene"
    report.notes += [Note("ignored", "element", name, lost) for name in elements.missing]
    if built.pairs:
        text = f"restitution {_range(built.restitution)}, Coulomb friction {_range(built.friction)}"
        report.notes.append(Note("used", "pairs", f"{len(built.pairs)}", text))
    for law, places in built.laws:
        a, b = built.pairs[places[0]]
        more = f" and {len(places) - 1} more" if len(places) > 1 else ""
        report.notes.append(Note("used", "law of contact", f"{a} and {b}{more}", law.words()))
    for name, motion in built.surface_motions.items():
        report.notes.append(Note("used", "surface velocity", name, motion.words()))
    for row in built.elements.compliances:
        report.notes.append(Note("used", "compliance", " and ".join(row.names), row.law.describe()))
    try:
        rounding = list(built.engine.rounding)
    except SceneError as error:
        report.notes.append(Note("refused", "scene", "", str(error)))
        rounding = []
    rounded = [float(r) for r in rounding if r > 0.0]
    if rounded:
        text = f"edges rounded with radius {_range(rounded)} m inside the shape, for exact normals"
        report.notes.append(Note("changed", "pairs", f"{len(rounded)} of {len(rounding)}", text))
    return report


def _has_no_shapes(part: Part) -> bool:
    """Return whether a model moves and nothing of it can touch."""
    return part.model.njoints > 1 and not len(part.collision.geometryObjects)


def _joint_notes(name: str, own: JointSettings, built: Built) -> Iterator[tuple[Use, str]]:
    """Yield use and text of each setting of a joint."""
    if own.damping is not None:
        yield "changed", f"damping set to {number(float(np.max(own.damping)))}, instead of the file's"
    if own.limits is not None:
        yield "changed", "limits not used" if own.limits is False else "limits set"
    if own.stiffness:
        yield "used", f"spring of {number(own.stiffness)} N m/rad or N/m"
    if own.spring is not None and np.any(own.spring):
        yield "used", f"nonlinear spring, coefficients {', '.join(number(float(k)) for k in own.spring)}"
    dof = int(built.model.idx_vs[built.model.getJointId(name)])
    if own.armature is not None or own.rotor_inertia is not None:
        yield "changed", f"armature {number(float(built.model.armature[dof]))} kg m^2 or kg"
    if own.gear_ratio is not None and not own.rotor_inertia:
        yield "ignored", "gear_ratio: it multiplies rotor_inertia, and there is none"
    if own.friction is not None and own.friction is not False:
        where = " of the file" if own.friction is True else ""
        yield "used", f"joint friction{where} {number(float(built.arrays.joint_friction[dof]))} N m or N"
    if own.servo is not None and (own.servo.kp or own.servo.kd):
        limit = float(built.arrays.servo[2, dof])
        text = "no effort limit" if np.isinf(limit) else f"effort at most {number(limit)}"
        damping = float(built.model.damping[dof])
        if damping > 0.0 and own.servo.kp:
            slow = number((own.servo.kd + damping) / own.servo.kp)
            text += f"; the joint's damping {number(damping)} acts beside kd: (kd + damping) / kp = {slow} s"
        yield "used", f"servo with kp {number(own.servo.kp)}, kd {number(own.servo.kd)}, {text}"
    for row, key in enumerate(("effort", "velocity")):
        limit = float(built.arrays.actuator[row, dof]) if built.model.nvs[built.model.getJointId(name)] == 1 else np.inf
        if np.isfinite(limit):
            yield "used", f"{key} limit{' of the file' if getattr(own, key) is True else ''} {number(limit)}"


def _element_note(element: Element) -> Note:
    topic = "constraint" if isinstance(element, Constraint) else "element"
    return Note("used", topic, element.name, element.describe().removeprefix("constraint: "))


def _with_limits(report: PartReport, limited: Mapping[str, bool]) -> PartReport:
    """Return the report with the limits that are simulated; settings may switch them off, or give others."""
    rows = [replace(row, limited=bool(limited.get(row.name, row.limited))) for row in report.joints]
    return replace(report, joints=rows)


def _range(values: Sequence[float] | np.ndarray) -> str:
    low, high = number(float(min(values))), number(float(max(values)))
    return low if low == high else f"{low} to {high}"
