"""Read and check an MJCF before Pinocchio does, rewrite what its reader would lose, and read its <equality> section.

pin 4.1 has these faults: only the first body of <worldbody> is read, a body without a name or with the name of another
one is dropped, values that are no numbers are skipped, and the frame of a rotated free joint is wrong. Here every body
gets a name, numbers are checked, all top bodies are put under one static body, and includes are resolved.

Of <equality>, connect, weld and joint become plain data, the rest is reported as ignored. What MuJoCo does softly
(solref, solimp) is exact here. A connect, and a weld without relpose, keep what the neutral configuration has.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from contactvi.elements.elements import WORLD
from contactvi.errors import SceneError
from contactvi.importing.report import PartReport
from contactvi.importing.xml import Element, named, numbers, read_xml

NUMERIC = {
    "body": ("pos", "quat", "euler", "axisangle", "xyaxes", "zaxis"),
    "geom": ("pos", "quat", "euler", "axisangle", "size", "fromto", "mass", "density", "margin"),
    "joint": ("pos", "axis", "range", "damping", "armature", "frictionloss", "stiffness", "ref"),
    "inertial": ("pos", "quat", "mass", "diaginertia", "fullinertia"),
}
IGNORED_SECTIONS = ("actuator", "sensor", "tendon", "contact", "keyframe", "custom", "statistic", "visual")
REFUSED_ELEMENTS = ("replicate", "composite", "flexcomp", "attach", "frame")
STATIC = "mjcf_world"  # name of the static body that has all top bodies as children


@dataclass
class MjcfText:
    """A checked MJCF: its model name, the rewritten XML, its <exclude> pairs of bodies with the reason.

    Attributes:
        constraints: as read_equality returns them.
    """

    name: str
    xml: str
    excluded: list[tuple[str, str, str]]
    constraints: list[dict[str, Any]]


def read_mjcf(path: Path, report: PartReport) -> MjcfText:
    """Read, check and rewrite an MJCF; what is ignored or changed goes to the report.

    Raises:
        SceneError: whatever makes the file unusable.
    """
    root = read_xml(path, "mujoco", "an MJCF")
    _include(root, path, depth=0)
    worlds = root.findall("worldbody")
    if not worlds:
        raise SceneError(f"{path.name} has no <worldbody>", path=path, expected="<worldbody>", got="none")
    world = worlds[0]
    for other in worlds[1:]:  # Included files bring their own <worldbody>; MuJoCo merges them too.
        world.extend(other)
        root.remove(other)
    _check_bodies(world, path, report)
    _check_meshes(root, path)
    excluded = [(e.get("body1", ""), e.get("body2", ""), "MJCF exclude") for e in root.findall("./contact/exclude")]
    _note_ignored(root, world, report)
    static = ElementTree.Element("body", name=STATIC)
    for body in world.findall("body"):
        world.remove(body)
        static.append(body)
    world.append(static)
    constraints = read_equality(root, path, report)
    for section in (*IGNORED_SECTIONS, "equality"):
        for element in root.findall(section):
            root.remove(element)
    return MjcfText(
        root.get("model") or path.stem, ElementTree.tostring(root, encoding="unicode"), excluded, constraints
    )


def _include(root: Element, path: Path, depth: int) -> None:
    """Replace every <include file=...> by the children of that file's root."""
    if depth > 10:
        raise SceneError(f"{path.name}: includes are nested more than 10 deep", path=path, remedy="Look for a circle")
    for parent in list(root.iter()):
        for index, child in reversed(list(enumerate(parent))):
            if child.tag != "include":
                continue
            file = path.parent / child.get("file", "")
            if not file.is_file():
                raise SceneError(
                    f"{path.name}: no such include file", path=file, expected="an existing file", got=str(file)
                )
            included = _read_include(file)
            _include(included, file, depth + 1)
            parent.remove(child)
            for offset, element in enumerate(included):
                parent.insert(index + offset, copy.deepcopy(element))


def _read_include(file: Path) -> Element:
    try:
        return ElementTree.parse(file).getroot()
    except ElementTree.ParseError as error:
        raise SceneError(f"Broken XML in {file.name}", path=file, expected="well-formed XML", got=str(error)) from None


def _check_bodies(world: Element, path: Path, report: PartReport) -> None:
    bodies = list(world.iter("body"))
    taken = {body.get("name") for body in bodies}
    for index, body in enumerate(bodies):
        if not body.get("name"):
            name = next(n for n in (f"body_{index + k}" for k in range(len(bodies) + 1)) if n not in taken)
            taken.add(name)
            body.set("name", name)
            report.note("changed", "body", name, "named by its place, the file gives no name")
    named(bodies, path, "body")
    joints = [e for tag in ("joint", "freejoint") for e in world.iter(tag) if e.get("name")]
    named(joints, path, "joint")
    for tag in REFUSED_ELEMENTS:
        if world.find(f".//{tag}") is not None:
            raise SceneError(
                f"{path.name} uses <{tag}>",
                path=path,
                expected="bodies, joints and geoms",
                got=f"<{tag}>",
                remedy="Save the expanded model from MuJoCo (mj_saveLastXML) and import that",
            )
    for body in bodies:
        for element in [body, *body.findall("geom"), *body.findall("joint"), *body.findall("inertial")]:
            _check_element(element, f"body {body.get('name')!r}", path)
        if len(body.findall("joint")) + len(body.findall("freejoint")) > 1:
            report.note("suspicious", "body", str(body.get("name")), "several joints in one body: a composite joint")
    for geom in world.findall("geom"):
        _check_element(geom, "the world", path)


def _check_element(element: Element, where: str, path: Path) -> None:
    for key in NUMERIC.get(str(element.tag), ()):
        values = numbers(element, key, path, where)
        if values and key == "size" and element.get("type") != "plane" and min(values) <= 0.0:
            raise SceneError(
                f"{path.name}: size of a geom in {where}", path=path, expected="numbers > 0", got=element.get("size")
            )
        if values and key == "axis" and not any(values):
            raise SceneError(f"{path.name}: axis of a joint in {where}", path=path, expected="nonzero", got="0 0 0")


def _check_meshes(root: Element, path: Path) -> None:
    """Check that the mesh files exist, and make the mesh folder absolute: the rewritten file lies elsewhere."""
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.Element("compiler")
        root.insert(0, compiler)
    folder = path.parent / (compiler.get("meshdir") or compiler.get("assetdir") or "")
    compiler.set("meshdir", str(folder.resolve()))
    for mesh in root.findall("./asset/mesh"):
        file = mesh.get("file")
        if file and not (folder / file).is_file():
            raise SceneError(
                f"No such file: {file}",
                path=folder / file,
                expected="an existing mesh file",
                got=f"nothing at {folder / file}",
                remedy="Put it there, or correct meshdir of <compiler>",
            )
    for asset in root.findall("asset"):
        if asset.find("hfield") is not None:
            raise SceneError(
                f"{path.name} has a height field",
                path=path,
                expected="planes, primitives or meshes",
                got="<hfield>",
                remedy="Replace it by boxes or a mesh",
            )
        for element in asset.findall("texture") + asset.findall("skin"):
            asset.remove(element)
        for material in asset.findall("material"):
            material.attrib.pop("texture", None)


def _note_ignored(root: Element, world: Element, report: PartReport) -> None:
    for section in IGNORED_SECTIONS:
        count = sum(child.tag != "exclude" for element in root.findall(section) for child in element)
        if count:
            report.note("ignored", "section", f"<{section}>", f"{count} element(s)")
    for geom in world.iter("geom"):
        if geom.get("friction") is not None:
            report.note("ignored", "geom", geom.get("name") or "(unnamed)", "friction: use set_contact")
        bits = {geom.get("contype", "1"), geom.get("conaffinity", "1")}
        if bits not in ({"0"}, {"1"}):
            text = "contype and conaffinity: use disable_pair"
            report.note("ignored", "geom", geom.get("name") or "(unnamed)", text)
    for joint in world.iter("joint"):
        if joint.get("stiffness") not in (None, "0"):
            name = joint.get("name") or "(unnamed)"
            report.note("ignored", "joint", name, "stiffness: use set_joint(stiffness=, rest=)")
    option = root.find("option")
    for key in sorted(option.attrib) if option is not None else ():
        report.note("ignored", "option", key, "gravity and steps come from the scene and the run")


def read_equality(root: Element, path: Path, report: PartReport) -> list[dict[str, Any]]:
    """Return the constraints as {kind: "point" | "weld" | "equality", name, ...} with the file's names.

    point: a, b, point_a. weld: a, b, placement (xyz and quaternion x y z w) or None. equality: joint, other or None,
    coefficients. Raises SceneError for words in place of numbers.
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
