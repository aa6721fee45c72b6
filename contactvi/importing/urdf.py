"""Read and check a URDF before Pinocchio does, whose reader drops silently what it cannot parse.

pin 4.1 has these faults: a mass that is no number becomes zero, a collision whose shape is unknown or has words for
numbers disappears, a zero axis stays zero, negative sizes are kept. Mesh references become absolute paths here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from contactvi.errors import SceneError, did_you_mean
from contactvi.importing.paths import resolve_resource
from contactvi.importing.report import PartReport
from contactvi.importing.urdf_extensions import (
    DRAKE,
    check_joint_tags,
    filtered_pairs,
    note_extensions,
    surface_friction,
    turn_quaternions,
)
from contactvi.importing.xml import Element, check_positive, named, numbers, read_xml

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
# Sizes of each shape: name and count of the numbers. A capsule's length is that of its cylinder, an ellipsoid has half
# axes along x, y and z.
SHAPES: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
    f"{DRAKE}ellipsoid": (("a", 1), ("b", 1), ("c", 1)),
    "mesh": (),
}
# urdfdom recurses over the links, and ends the process for some thousands of them.
MOST_LINKS_IN_A_CHAIN = 1500
KNOWN = ("link", "joint", "material", f"{DRAKE}collision_filter_group")
FILE_LIMITS = "effort and velocity limits"


class Mimic(NamedTuple):
    """A mimic tag: q = multiplier * q of `joint` + offset."""

    joint: str
    multiplier: float
    offset: float

    def __str__(self) -> str:
        return f"{self.multiplier:g} * {self.joint} + {self.offset:g}"


@dataclass
class UrdfText:
    """A checked URDF.

    Attributes:
        xml: with resolved meshes. mimics: mimic tags by joint.
        filtered: pairs of links that do not collide, with the reason.
        friction: of collision shapes by name, if it was asked for.
    """

    name: str
    xml: str
    mimics: dict[str, Mimic]
    filtered: list[tuple[str, str, str]]
    friction: dict[str, float]


def read_urdf(
    path: Path, package_dirs: Sequence[object], report: PartReport, mimic: bool = True, friction: bool = False
) -> UrdfText:
    """Read, check and complete a URDF; what is ignored or changed goes to the report.

    Args:
        mimic: whether mimic tags are needed; else those of unknown joints are noted only.
        friction: whether the friction of surfaces is needed.

    Raises:
        SceneError: whatever makes the file unusable, with path, joint or body.
    """
    root = read_xml(path, "robot", "a URDF")
    _check_expanded(root, path)
    if not root.get("name"):
        root.set("name", path.stem)
        report.note("changed", "file", path.name, f"the robot has no name, it is called {path.stem!r}")
    root.attrib.pop("version", None)  # All versions are read; the parser behind takes some alone.
    check_joint_tags(root, path)
    turn_quaternions(root, path)
    links = named(root.findall("link"), path, "link")
    joints = named(root.findall("joint"), path, "joint")
    _check_tree(links, joints, path)
    for name, joint in joints.items():
        _check_joint(name, joint, path)
    for name, link in links.items():
        _check_link(name, link, path, package_dirs, report)
    mimics = _mimics(joints, path, report, mimic)
    _note_joints(joints, report)
    for tag in sorted({str(child.tag) for child in root if child.tag not in KNOWN}):
        names = [child.get("name") or child.get("reference") or "" for child in root.findall(tag)]
        given = ", ".join(dict.fromkeys(n for n in names if n)) or f"{len(names)} of them"
        report.note("ignored", "element", f"<{tag}>", given if len(given) < 90 else f"{len(names)} of them")
    note_extensions(root, report, friction)
    return UrdfText(
        name=str(root.get("name")),
        xml=ElementTree.tostring(root, encoding="unicode"),
        mimics=mimics,
        filtered=filtered_pairs(root, links, path),
        friction=surface_friction(root, links, path) if friction else {},
    )


def _check_expanded(root: Element, path: Path) -> None:
    for element in root.iter():
        if "xacro" in str(element.tag) or any("${" in value or "$(" in value for value in element.attrib.values()):
            raise SceneError(
                f"{path.name} is a xacro macro file",
                path=path,
                expected="a plain URDF",
                got=f"<{element.tag}>",
                remedy=f"Expand it first: xacro {path.name} > {path.stem}.urdf",
            )


def _check_tree(links: dict[str, Element], joints: dict[str, Element], path: Path) -> None:
    """Check that the links form one tree; the error of Pinocchio would be 'not a valid URDF model' only."""
    if not links:
        raise SceneError(
            f"{path.name} has no link",
            path=path,
            expected="at least one <link>",
            got="none",
            remedy='Add the body: <link name="base"/>',
        )
    parent_of: dict[str, str] = {}
    for name, joint in joints.items():
        ends = {}
        for side in ("parent", "child"):
            element = joint.find(side)
            link = element.get("link", "") if element is not None else ""
            if link not in links:
                raise SceneError(
                    f"{path.name}: {side} of joint {name!r}",
                    path=path,
                    joint=name,
                    expected="the name of a link",
                    got=repr(link),
                    remedy=did_you_mean(link, links),
                )
            ends[side] = link
        if ends["child"] in parent_of:
            raise SceneError(
                f"{path.name}: link {ends['child']!r} is the child of two joints",
                path=path,
                joint=name,
                body=ends["child"],
                expected="a tree",
                got="a loop",
                remedy="Cut the loop, and close it in the scene: scene.add_point or scene.add_weld",
            )
        parent_of[ends["child"]] = ends["parent"]
    roots = [link for link in links if link not in parent_of]
    if len(roots) != 1:
        raise SceneError(
            f"{path.name}: the links do not form one tree",
            path=path,
            expected="one link without a parent joint",
            got=", ".join(roots) or "none (the joints form a loop)",
            remedy="Join the links, or put separate bodies in separate files",
        )
    _check_depth(parent_of, path)


def _check_depth(parent_of: dict[str, str], path: Path) -> None:
    """Raise SceneError where links form a loop, or a chain that is longer than the parser's recursion can take."""
    depths: dict[str, int] = {}
    for link in parent_of:
        chain: dict[str, None] = {}
        while link in parent_of and link not in depths:
            if link in chain:
                raise SceneError(
                    f"{path.name}: links form a loop beside the tree",
                    path=path,
                    body=link,
                    expected="one tree",
                    got=" - ".join([*list(chain)[list(chain).index(link) :], link][:8]),
                    remedy="Cut the loop, and close it in the scene: scene.add_point or scene.add_weld",
                )
            chain[link] = None
            link = parent_of[link]
        level = depths.get(link, 0)
        for k, above in enumerate(reversed(list(chain))):
            depths[above] = level + k + 1
    deepest = max(depths.values(), default=0)
    if deepest > MOST_LINKS_IN_A_CHAIN:
        raise SceneError(
            f"{path.name}: a chain of links is too long",
            path=path,
            expected=f"at most {MOST_LINKS_IN_A_CHAIN} joints between the base and a link",
            got=deepest,
            remedy="Split the model into several files, and join them with scene.add_weld",
        )


def _check_joint(name: str, joint: Element, path: Path) -> None:
    where = f"joint {name!r}"
    kind = joint.get("type", "")
    if kind not in JOINT_TYPES:
        raise SceneError(
            f"{path.name}: type of {where}",
            path=path,
            joint=name,
            expected=" | ".join(JOINT_TYPES),
            got=repr(kind),
            remedy=did_you_mean(kind, JOINT_TYPES),
        )
    if (origin := joint.find("origin")) is not None:
        numbers(origin, "xyz", path, where, 3)
        numbers(origin, "rpy", path, where, 3)
    if (axis := joint.find("axis")) is not None and kind not in ("fixed", "floating"):
        values = numbers(axis, "xyz", path, where, 3)
        if values is not None and not any(values):
            raise SceneError(
                f"{path.name}: axis of {where}",
                path=path,
                joint=name,
                expected="a nonzero vector",
                got="0 0 0",
                remedy='Give the direction, for example <axis xyz="0 0 1"/>',
            )
    if kind in ("revolute", "prismatic") and joint.find("limit") is None:
        raise SceneError(
            f"{path.name}: {where} of type {kind} has no <limit>",
            path=path,
            joint=name,
            expected="<limit lower= upper= effort= velocity=>",
            got="none",
            remedy="Add it, or make the joint continuous",
        )
    for tag, keys in (("limit", ("lower", "upper", "effort", "velocity")), ("dynamics", ("damping", "friction"))):
        if (element := joint.find(tag)) is not None:
            for key in keys:
                numbers(element, key, path, where, 1)


def _check_link(name: str, link: Element, path: Path, package_dirs: Sequence[object], report: PartReport) -> None:
    where = f"link {name!r}"
    for inertial in link.findall("inertial"):
        mass = inertial.find("mass")
        inertia = inertial.find("inertia")
        if mass is None or inertia is None:
            missing = "mass" if mass is None else "inertia"  # urdfdom would drop the other one too.
            raise SceneError(
                f"{path.name}: inertial of {where}",
                path=path,
                body=name,
                expected=f"<{missing}>",
                got="none",
                remedy=f"Add <{missing}> to the <inertial>, or remove the <inertial> of a link without mass",
            )
        numbers(mass, "value", path, where, 1)
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
            numbers(inertia, key, path, where, 1)
        if (origin := inertial.find("origin")) is not None:
            numbers(origin, "xyz", path, where, 3)
            numbers(origin, "rpy", path, where, 3)
    for collision in link.findall("collision"):
        _check_shape(collision, name, path, package_dirs)
    for visual in link.findall("visual"):
        try:
            _check_shape(visual, name, path, package_dirs)
        except SceneError as error:  # A model can be simulated without its pictures.
            link.remove(visual)
            report.note("ignored", "visual", name, str(error))


def _check_shape(holder: Element, link: str, path: Path, package_dirs: Sequence[object]) -> None:
    """Check a <collision> or <visual> and put the absolute path of its mesh in place."""
    where = f"link {link!r}"
    geometry = holder.find("geometry")
    shape = next(iter(geometry), None) if geometry is not None else None
    if shape is not None and shape.tag == f"{DRAKE}capsule":
        shape.tag = "capsule"
    if shape is None or shape.tag not in SHAPES:
        raise SceneError(
            f"{path.name}: shape of a <{holder.tag}> of {where}",
            path=path,
            body=link,
            expected=" | ".join(SHAPES),
            got="none" if shape is None else f"<{shape.tag}>",
            remedy="Replace it by one of these shapes",
        )
    if (origin := holder.find("origin")) is not None:
        numbers(origin, "xyz", path, where, 3)
        numbers(origin, "rpy", path, where, 3)
    for key, count in SHAPES[shape.tag]:
        check_positive(shape, key, path, where, count)
    if shape.tag == "mesh":
        scale = numbers(shape, "scale", path, where, 3)
        if scale is not None and not all(scale):
            raise SceneError(
                f"{path.name}: mesh scale in {where}",
                path=path,
                body=link,
                expected="nonzero",
                got=scale,
                remedy='Give three factors that are not 0, for example scale="0.001 0.001 0.001" for a mesh in mm',
            )
        shape.set("filename", str(resolve_resource(shape.get("filename", ""), path.parent, package_dirs)))


def _note_joints(joints: dict[str, Element], report: PartReport) -> None:
    """Note data of joints that are used only on request (limits of effort and velocity), or not at all."""
    for name, joint in joints.items():
        limit = joint.find("limit")
        if limit is not None and joint.get("type") != "fixed":
            report.note("ignored", "joint", name, f"{FILE_LIMITS}: not used, unless by set_actuator(joint, ...)")
        for tag in ("safety_controller", "calibration"):
            if joint.find(tag) is not None:
                report.note("ignored", "joint", name, tag)


def _mimics(joints: dict[str, Element], path: Path, report: PartReport, needed: bool) -> dict[str, Mimic]:
    """Return the mimic tags of joints that move; one of an unknown joint is refused if they are needed."""
    mimics: dict[str, Mimic] = {}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None or joint.get("type") == "fixed":
            continue
        other = mimic.get("joint", "")
        if other not in joints or other == name:
            if not needed:
                text = f"mimic tag of {other!r}, which the file does not have: treated as an independent joint"
                report.note("suspicious", "joint", name, text)
                continue
            near = did_you_mean(other, [known for known in joints if known != name])
            raise SceneError(
                f"{path.name}: mimic tag of joint {name!r}",
                path=path,
                joint=name,
                expected="the name of another joint",
                got=repr(other),
                remedy=f"{near + ', or t' if near else 'T'}reat such joints as independent: mimic=False",
            )
        values = [numbers(mimic, key, path, f"joint {name!r}", 1) for key in ("multiplier", "offset")]
        factor, offset = values[0] or [1.0], values[1] or [0.0]
        mimics[name] = Mimic(other, factor[0], offset[0])
    return mimics
