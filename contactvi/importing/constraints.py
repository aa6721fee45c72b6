"""The joint equalities that the mimic tags of a URDF bring, noted in its report."""

from __future__ import annotations

from collections.abc import Mapping

import pinocchio as pin

from contactvi.elements.constraints import EqualityConstraint
from contactvi.elements.element import Element
from contactvi.importing.joint_kinds import joint_kind
from contactvi.importing.part import Part
from contactvi.importing.urdf import Mimic


def mimic_constraints(part: Part, mimics: Mapping[str, Mimic], use: bool) -> list[Element]:
    """Return a joint equality for each mimic tag between joints with one number in q; none unless `use`."""
    found: list[Element] = []
    for name, mimic in mimics.items():
        free = _many_numbers(part.model, name, mimic.joint)
        joint, other = part.prefix + name, part.prefix + mimic.joint
        if use and not free:
            coefficients = (mimic.offset, mimic.multiplier)
            found.append(EqualityConstraint(f"mimic_{joint}", joint, other, coefficients))
            part.report.note("used", "joint", joint, f"mimic tag: a coupled joint, {mimic}")
            continue
        reason = f" ({free})" if free else ""
        part.report.note("ignored", "joint", joint, f"mimic tag: treated as an independent joint{reason}")
        text = "the file couples it to another joint (mimic), here it moves freely"
        part.report.note("suspicious", "joint", joint, text)
    return found


def _many_numbers(model: pin.Model, *names: str) -> str:
    """Return why these joints cannot be made equal: one with more numbers in q than one; nothing where they can."""
    for name in names:
        index = model.getJointId(name) if model.existJointName(name) else 0
        if index == 0:
            return f"{name!r} does not move"
        if model.nqs[index] != 1:
            return f"{name!r} is {joint_kind(model.joints[index])}, it has no single number in q"
    return ""
