"""The <equality> section of an MJCF: connect, weld and joint become plain data, the rest is reported as ignored.

What MuJoCo does softly (solref, solimp) is exact here. A connect, and a weld without relpose, hold what the neutral
configuration has.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from contactvi.importing.report import PartReport
from contactvi.importing.xml import Element, numbers

WORLD = "world"


def read_equality(root: Element, path: Path, report: PartReport) -> list[dict[str, Any]]:
    """Return the constraints as {kind: "point" | "weld" | "equality", name, ...} with the file's names.

    point: a, b, point_a. weld: a, b, placement (xyz and quaternion x y z w) or None. equality: joint, other or None,
    coefficients. Raises SceneError for numbers that are none.
    """
    bodies = {body.get("name") for body in root.iter("body")}
    joints = (joint for body in root.iter("body") for joint in body.findall("joint"))
    referred = {joint.get("name"): joint.get("ref", "0") for joint in joints}
    found: list[dict[str, Any]] = []
    for section in root.findall("equality"):
        for element in section:
            tag = str(element.tag)
            name = element.get("name") or f"{tag}_{len(found) + 1}"
            where = f"the equality {name!r}"
            reason = _unused(element, bodies, referred)
            if reason:
                report.note("ignored", "equality", name, f"<{tag}>: {reason}")
            elif tag == "joint":
                coefficients = numbers(element, "polycoef", path, where) or [0.0, 1.0, 0.0, 0.0, 0.0]
                other = element.get("joint2")
                found.append({
                    "kind": "equality", "name": name, "joint": element.get("joint1"), "other": other,
                    "coefficients": coefficients if other else coefficients[:1],
                })  # fmt: skip
            else:
                ends = {"a": element.get("body1"), "b": element.get("body2") or WORLD}
                if tag == "connect":
                    anchor = numbers(element, "anchor", path, where, 3) or [0.0, 0.0, 0.0]
                    found.append({"kind": "point", "name": name, **ends, "point_a": anchor, "point_b": None})
                else:
                    found.append({"kind": "weld", "name": name, **ends, "placement": _relpose(element, path, where)})
    return found


def _unused(element: Element, bodies: set[str | None], joints: dict[str | None, str]) -> str:
    """Return why an element is not used, nothing where it is."""
    tag = str(element.tag)
    if tag not in ("connect", "weld", "joint"):
        return "not supported"
    if element.get("active") == "false":
        return "not active"
    if tag == "joint":
        names = [element.get("joint1"), element.get("joint2")]
        names = names if names[1] else names[:1]
        if any(name is None or name not in joints for name in names):
            return "of a joint that the file does not have"
        return "of a joint with ref" if any(float(joints[name]) != 0.0 for name in names) else ""
    if element.get("site1") or element.get("site2"):
        return "sites are not supported: give body1, body2 and anchor"
    names = [element.get("body1"), element.get("body2") or WORLD]
    return (
        ""
        if all(name is not None and (name in bodies or name == WORLD) for name in names)
        else "of a body that the file does not have"
    )


def _relpose(element: Element, path: Path, where: str) -> list[float] | None:
    """Return xyz and quaternion (x, y, z, w) of body2 in body1; None where the file leaves it to the pose."""
    values = numbers(element, "relpose", path, where, 7)
    if values is None or not any(values[3:]):
        return None
    length = sum(value**2 for value in values[3:]) ** 0.5
    w, x, y, z = (value / length for value in values[3:])
    return [*values[:3], x, y, z, w]
