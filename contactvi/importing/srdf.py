"""Read an SRDF: pairs of links that do not collide, and named values of joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from contactvi.importing.part import Part
from contactvi.importing.report import PartReport
from contactvi.importing.xml import numbers, read_xml


@dataclass
class Srdf:
    """What an SRDF says about a model.

    Attributes:
        pairs: disabled pairs of links with their reasons.
        states: values of joints (each a list of numbers) by the name of a group state.
    """

    pairs: list[tuple[str, str, str]]
    states: dict[str, dict[str, list[float]]]


def read_srdf(file: Path, model: pin.Model, report: PartReport) -> Srdf:
    """Return what an SRDF says about the links and joints of a model; what it has not is noted.

    Raises:
        SceneError: broken XML, not an SRDF, or words in place of numbers.
    """
    root = read_xml(file, "robot", "an SRDF")
    known = {frame.name for frame in model.frames}
    found = Srdf([], {})
    for element in root.iter("disable_collisions"):
        first, second = element.get("link1", ""), element.get("link2", "")
        if first in known and second in known:
            found.pairs.append((first, second, element.get("reason", "")))
        else:
            missing = first if first not in known else second
            report.note("suspicious", "SRDF", missing, "disable_collisions of a link the model does not have")
    for state in root.iter("group_state"):
        values = found.states.setdefault(state.get("name", ""), {})
        for joint in state.iter("joint"):
            name = joint.get("name", "")
            if model.existJointName(name):
                values[name] = numbers(joint, "value", file, f"group_state {state.get('name')!r}") or []
            else:
                report.note("suspicious", "SRDF", name, "group_state of a joint the model does not have")
    return found


def add_group_states(part: Part, states: Mapping[str, Mapping[str, list[float]]]) -> None:
    """Enter group states as configurations: joints that a state does not name are as in the start."""
    model = part.model
    for title, values in states.items():
        q = part.start.copy()
        for name, given in values.items():
            joint = model.joints[model.getJointId(name)]
            value = np.array(given)
            if joint.nq == 2 and len(value) == 1:
                value = np.array([np.cos(value[0]), np.sin(value[0])])
            if len(value) != joint.nq:
                text = f"group_state {title!r} gives {len(value)} numbers, the joint has {joint.nq}"
                part.report.note("suspicious", "SRDF", name, text)
                continue
            q[joint.idx_q : joint.idx_q + joint.nq] = value
        part.data.configurations[title] = pin.normalize(model, q), np.zeros(model.nv)
