"""URDF text: valid trees of links with a few damages."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import contactvi as cvi
from fuzz import law
from fuzz.draws import Case, Draws, damage_bytes, damage_xml, run_settings, xml_text

Element = ElementTree.Element
TAGS = (
    *("robot", "link", "joint", "inertial", "mass", "inertia", "origin", "collision", "visual", "geometry", "box"),
    *("sphere", "cylinder", "capsule", "mesh", "axis", "limit", "dynamics", "mimic", "parent", "child", "material"),
    *("color", "texture", "safety_controller", "calibration", "transmission", "gazebo", "x"),
)
KEYS = (
    *("name", "type", "xyz", "rpy", "value", "ixx", "ixy", "izz", "size", "radius", "length", "filename", "scale"),
    *("lower", "upper", "effort", "velocity", "damping", "friction", "joint", "multiplier", "offset", "link", "rgba"),
    *("soft_lower_limit", "k_velocity", "rising", "version", "x"),
)
JOINTS = ("revolute", "revolute", "continuous", "prismatic", "fixed", "floating", "planar")
CUBE = """v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1
f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4
"""


def sub(parent: Element, tag: str, **attributes: object) -> Element:
    """Add an element with attributes; tuples are written as numbers with spaces between."""
    given = {key: " ".join(map(str, v)) if isinstance(v, tuple) else str(v) for key, v in attributes.items()}
    return ElementTree.SubElement(parent, tag, given)


def draw(d: Draws) -> Case:
    """Return a case."""
    root = tree(d)
    for _ in range(d.damages()):
        damage_xml(d, root, TAGS, KEYS)
    data = xml_text(root).encode("utf-8", "surrogatepass")
    if d.chance(6):
        data = damage_bytes(d, data)
    options: Case = {"base": d.pick(("fixed", "free")), "limits": d.chance(70), "friction": d.chance(30)}
    options["mimic"] = d.chance(70)
    if d.chance(40):
        options["armature"] = d.pick((1e-3, 0.1, 1e-300, 1e300, {"joint_*": 0.01}, {"*_1": 0.5}))
    if d.chance(10):
        options["prefix"] = d.wild_word()
    if d.chance(10):
        options["placement"] = [d.number(-1, 1) for _ in range(3)]
    srdf = srdf_text(d) if d.chance(15) else None
    return {"data": data.decode("latin-1"), "options": options, "srdf": srdf, "run": run_settings(d)}


def tree(d: Draws) -> Element:
    """Return a valid robot."""
    root = Element("robot", {"name": "r"})
    count = d.whole(1, 5) if d.chance(97) else d.whole(20, 120)
    for k in range(count):
        link = sub(root, "link", name=f"link_{k}")
        if d.chance(90):
            _inertial(d, link)
        for holder in ("collision", "visual"):
            for _ in range(d.pick((0, 1, 1, 2) if holder == "collision" else (0, 0, 1))):
                _shape(d, sub(link, holder))
    kinds = {}
    for k in range(1, count):
        kinds[k] = d.pick(JOINTS)
        joint = sub(root, "joint", name=f"joint_{k}", type=kinds[k])
        sub(joint, "parent", link=f"link_{d.whole(max(0, k - 2), k - 1)}")
        sub(joint, "child", link=f"link_{k}")
        if d.chance(70):
            sub(joint, "origin", xyz=_three(d), rpy=_three(d))
        if kinds[k] not in ("fixed", "floating") and d.chance(80):
            axis = d.pick(((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0.6, 0, 0.8), (1, 1, 1), (2, 0, 0)))
            sub(joint, "axis", xyz=axis)
        if kinds[k] in ("revolute", "prismatic") or d.chance(10):
            sub(joint, "limit", lower=d.number(-2, 0), upper=d.number(0, 2), effort=10, velocity=d.number(0, 5))
        if d.chance(30):
            sub(joint, "dynamics", damping=d.number(0, 1), friction=d.number(0, 1))
        if k > 1 and d.chance(15):
            sub(joint, "mimic", joint=f"joint_{d.whole(1, k - 1)}", multiplier=d.number(-2, 2), offset=d.number(-1, 1))
        if d.chance(5):
            sub(joint, "safety_controller", soft_lower_limit=-1, soft_upper_limit=1, k_velocity=10, k_position=1)
    return root


def _three(d: Draws) -> tuple[float, ...]:
    return tuple(d.number(-1, 1) for _ in range(3))


def _inertial(d: Draws, link: Element) -> None:
    inertial = sub(link, "inertial")
    if d.chance(40):
        sub(inertial, "origin", xyz=_three(d), rpy=_three(d))
    sub(inertial, "mass", value=d.number(0.1, 5))
    ixx, iyy, izz = (d.number(0.02, 0.04) for _ in range(3))  # no one above the sum of the others
    sub(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy=d.number(0, 0.005), ixz=0, iyz=0)


def _shape(d: Draws, holder: Element) -> None:
    if d.chance(50):
        sub(holder, "origin", xyz=_three(d), rpy=_three(d))
    geometry = sub(holder, "geometry")
    kind = d.pick(("box", "sphere", "cylinder", "capsule", "ellipsoid", "mesh"))
    if kind == "box":
        sub(geometry, "box", size=tuple(d.number(0.05, 0.5) for _ in range(3)))
    elif kind == "sphere":
        sub(geometry, "sphere", radius=d.number(0.05, 0.5))
    elif kind == "ellipsoid":
        sub(geometry, "drake:ellipsoid", a=d.number(0.05, 0.5), b=d.number(0.05, 0.5), c=d.number(0.05, 0.5))
    elif kind in ("cylinder", "capsule"):
        sub(geometry, kind, radius=d.number(0.05, 0.5), length=d.number(0.05, 0.5))
    else:
        sub(
            geometry, "mesh", filename=d.pick(("cube.obj", "package://./cube.obj", "./cube.obj")), scale=(0.1, 0.1, 0.1)
        )


def srdf_text(d: Draws) -> str:
    """Return the text of an SRDF, mostly valid."""
    root = Element("robot", {"name": "r"})
    for _ in range(d.whole(0, 2)):
        sub(root, "disable_collisions", link1=f"link_{d.whole(0, 4)}", link2=f"link_{d.whole(0, 4)}", reason="Never")
    state = sub(root, "group_state", name="home", group="all")
    for k in range(d.whole(0, 3)):
        sub(state, "joint", name=f"joint_{k}", value=d.number(-1, 1))
    if d.chance(60):
        damage_xml(
            d, root, ("robot", "group_state", "disable_collisions", "joint"), ("name", "value", "link1", "reason")
        )
    return xml_text(root)


def attempt(case: Case) -> bool:
    """Add the model to a scene with a ground, and run it."""
    Path("model.urdf").write_bytes(case["data"].encode("latin-1"))
    Path("cube.obj").write_text(CUBE)
    options = dict(case["options"])
    if case["srdf"] is not None:
        Path("model.srdf").write_bytes(case["srdf"].encode("utf-8", "surrogatepass"))
        options["srdf"] = "model.srdf"
    scene = cvi.Scene()
    scene.add_urdf("model.urdf", **options)
    return use(scene, case["run"])


def use(scene: cvi.Scene, run: Case) -> bool:
    """Look at all of an accepted scene and run it; return whether the run made steps."""
    law.check_numbers("neutral", scene.neutral())
    for name, (q, v) in scene.named_configurations.items():
        law.check_numbers(f"configuration {name!r}", [*q, *v])
    str(scene.report)
    try:
        scene.disable_overlapping()
    except cvi.ContactviError:
        return False
    return law.run_briefly(scene, run)
