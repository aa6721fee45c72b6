"""What newer readers of URDF, Drake, Bullet and Gazebo put into a file besides the first version of the format.

Read here: rotations as quaternions (`quat_xyzw`, URDF 1.1), Drake's groups of links that do not collide, and the
friction of surfaces, if the user asks for it: <drake:mu_dynamic> in the <drake:proximity_properties> of a collision,
else <lateral_friction> in Bullet's <contact> of a link, else <mu1> and <mu2> of Gazebo. All else is noted as ignored.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from contactvi.errors import SceneError, did_you_mean
from contactvi.importing.report import PartReport
from contactvi.importing.xml import Element, numbers

DRAKE = "drake:"
_GROUP = f"{DRAKE}collision_filter_group"
_READ = {  # what is read of each element, here or in urdf.py
    "link": ("inertial", "visual", "collision"),
    "collision": ("origin", "geometry", "material", "name"),
    "visual": ("origin", "geometry", "material"),
    "mesh": (f"{DRAKE}declare_convex",),  # every mesh becomes its hull
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"),
}
_LIMITS = ("acceleration", "deceleration", "jerk", f"{DRAKE}acceleration")


def turn_quaternions(root: Element, path: Path) -> None:
    """Put `rpy` in the place of each `quat_xyzw` of an <origin>: the parser behind reads the former alone."""
    for origin in root.iter("origin"):
        values = numbers(origin, "quat_xyzw", path, "its <origin>", 4)
        if values is None:
            continue
        length = float(np.linalg.norm(values))
        if origin.get("rpy") is not None or not 1e-50 < length < 1e50:
            both = origin.get("rpy") is not None
            raise SceneError(
                f"{path.name}: quat_xyzw of an <origin>",
                path=path,
                expected="one of rpy and quat_xyzw" if both else "four numbers that are not all 0",
                got="both" if both else repr(origin.get("quat_xyzw")),
                remedy="Leave rpy out" if both else 'Write quat_xyzw="0 0 0 1" for no rotation',
            )
        del origin.attrib["quat_xyzw"]
        rotation = pin.Quaternion(np.array(values) / length).toRotationMatrix()
        origin.set("rpy", " ".join(repr(float(angle)) for angle in pin.rpy.matrixToRpy(rotation)))


def check_joint_tags(root: Element, path: Path) -> None:
    """Raise SceneError for joints of Drake's own types: without them the links behind would hang at nothing."""
    joint = root.find(f"{DRAKE}joint")
    if joint is None:
        return
    raise SceneError(
        f"{path.name}: <{DRAKE}joint> {joint.get('name')!r}",
        path=path,
        joint=joint.get("name"),
        expected="<joint> of one of the types of URDF",
        got=f"type {joint.get('type')!r} of Drake",
        remedy="Write a planar one as <joint type='planar'>, a ball joint as three continuous joints one after the "
        "other or as scene.add_point between two files, a screw as a continuous joint and a prismatic one with a mimic "
        "tag",
    )


def filtered_pairs(root: Element, links: dict[str, Element], path: Path) -> list[tuple[str, str, str]]:
    """Return the pairs of links that Drake's groups keep from colliding, each once, with the groups as the reason.

    Raises:
        SceneError: a group, or a link of a group, that the file does not have.
    """
    groups = {g.get("name", ""): g for g in root.findall(_GROUP) if g.get("ignore") != "true"}
    found: dict[tuple[str, str], str] = {}
    for name, group in groups.items():
        own = _members(name, groups, links, path, ())
        for other in (e.get("name", "") for e in group.findall(f"{DRAKE}ignored_collision_filter_group")):
            for a in own:
                for b in _members(other, groups, links, path, (name,)):
                    if a != b:
                        found.setdefault((min(a, b), max(a, b)), f"groups {name!r} and {other!r}")
    return [(a, b, reason) for (a, b), reason in found.items()]


def _members(
    name: str, groups: dict[str, Element], links: dict[str, Element], path: Path, above: tuple[str, ...]
) -> list[str]:
    """Return the links of a group, those of its groups among them; `above`: the groups that it is asked for by."""
    if name not in groups:
        raise SceneError(
            f"{path.name}: collision filter group of {above[-1]!r}",
            path=path,
            expected="the name of a group",
            got=repr(name),
            remedy=did_you_mean(name, groups),
        )
    members = [element.get("link", "") for element in groups[name].findall(f"{DRAKE}member")]
    for link in members:
        if link not in links:
            raise SceneError(
                f"{path.name}: member of the collision filter group {name!r}",
                path=path,
                body=link,
                expected="the name of a link",
                got=repr(link),
                remedy=did_you_mean(link, links),
            )
    for inner in (element.get("name", "") for element in groups[name].findall(f"{DRAKE}member_group")):
        if inner not in (*above, name):
            members += _members(inner, groups, links, path, (*above, name))
    return list(dict.fromkeys(members))


def surface_friction(root: Element, links: dict[str, Element], path: Path) -> dict[str, float]:
    """Return the friction of the collision shapes that have some, by Pinocchio's name of the shape.

    Raises:
        SceneError: a coefficient that is no number >= 0.
    """
    found: dict[str, float] = {}
    of_gazebo: dict[str, float] = {}
    for gazebo in root.findall("gazebo"):
        own = [_text(gazebo, tag, path) for tag in ("mu1", "mu2")]
        given = [value for value in own if value is not None]
        if given and (reference := gazebo.get("reference")):
            of_gazebo[reference] = min(given)
    for name, link in links.items():
        bullet = link.find("contact/lateral_friction")
        of_link = of_gazebo.get(name) if bullet is None else _value(bullet, path, f"link {name!r}")
        for k, collision in enumerate(link.findall("collision")):
            properties = collision.find(f"{DRAKE}proximity_properties")
            of_shape = _of_drake(properties, path, f"link {name!r}") if properties is not None else None
            if (value := of_link if of_shape is None else of_shape) is not None:
                found[f"{name}_{k}"] = value
    return found


def _of_drake(properties: Element, path: Path, where: str) -> float | None:
    for tag in ("mu_dynamic", "mu_static"):
        if (element := properties.find(DRAKE + tag)) is not None:
            return _value(element, path, where)
    return None


def _text(holder: Element, tag: str, path: Path) -> float | None:
    """Return the number that stands in an element of Gazebo; None where it has none."""
    element = holder.find(tag)
    if element is None:
        return None
    if element.get("value") is None:
        element.set("value", (element.text or "").strip())
    return _value(element, path, f"<gazebo> of {holder.get('reference')!r}")


def _value(element: Element, path: Path, where: str) -> float:
    found = numbers(element, "value", path, where, 1) or [-1.0]
    if found[0] < 0.0:
        raise SceneError(
            f"{path.name}: <{element.tag}> in {where}",
            path=path,
            expected="a number >= 0",
            got=repr(element.get("value")),
            remedy="Correct it, or leave contact_friction=True out",
        )
    return found[0]


def note_extensions(root: Element, report: PartReport, friction: bool) -> None:
    """Note the elements that are not read, each kind once for all links and joints that have it.

    Args:
        friction: whether the friction of surfaces is used.
    """
    for holder, name, tag, read in _extensions(root):
        if read and friction:
            report.note("used", "friction", name, f"<{tag}> of <{holder}>: friction of its shapes")
        elif read:
            text = f"<{tag}> of <{holder}>: not used, unless with contact_friction=True"
            report.note("ignored", "friction", name, text)
        else:
            report.note("ignored", "extension", name, f"<{tag}> of <{holder}>")
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        for key in _LIMITS if limit is not None else ():
            if limit is not None and limit.get(key) is not None:
                report.note("ignored", "extension", joint.get("name", ""), f"{key} of <limit>")


def _extensions(root: Element) -> Iterator[tuple[str, str, str, bool]]:
    """Yield tag of the holder, name of link or joint, tag, and whether it is friction, of what is not read."""
    for link in root.findall("link"):
        name = link.get("name", "")
        for holder in (link, *link.findall("collision"), *link.findall("visual"), *link.iter("mesh")):
            for child in holder:
                if child.tag in _READ[str(holder.tag)]:
                    continue
                inner = list(child) if child.tag in ("contact", f"{DRAKE}proximity_properties") else []
                for element in inner or [child]:
                    friction = element.tag in ("lateral_friction", f"{DRAKE}mu_dynamic", f"{DRAKE}mu_static")
                    yield str(holder.tag if element is child else child.tag), name, str(element.tag), friction
    for joint in root.findall("joint"):
        for child in joint:
            if child.tag not in _READ["joint"]:
                yield "joint", joint.get("name", ""), str(child.tag), False
    for gazebo in root.findall("gazebo"):
        for child in gazebo:
            yield "gazebo", gazebo.get("reference", "") or "the robot", str(child.tag), child.tag in ("mu1", "mu2")


__all__ = ["DRAKE", "check_joint_tags", "filtered_pairs", "note_extensions", "surface_friction", "turn_quaternions"]
