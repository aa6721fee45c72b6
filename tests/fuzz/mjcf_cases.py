"""MJCF text: valid models with a few damages, read by the importer of MJCF files."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import contactvi as cvi
from fuzz.draws import Case, Draws, damage_bytes, damage_xml, run_settings, xml_text
from fuzz.urdf_cases import CUBE, Element, sub, use

TAGS = (
    *(
        "mujoco",
        "compiler",
        "option",
        "flag",
        "default",
        "asset",
        "mesh",
        "hfield",
        "worldbody",
        "body",
        "joint",
        "geom",
    ),
    *(
        "freejoint",
        "inertial",
        "site",
        "equality",
        "connect",
        "weld",
        "distance",
        "tendon",
        "fixed",
        "spatial",
        "actuator",
    ),
    *(
        "motor",
        "position",
        "velocity",
        "general",
        "intvelocity",
        "keyframe",
        "key",
        "contact",
        "exclude",
        "pair",
        "include",
    ),
    *(
        "replicate",
        "frame",
        "attach",
        "composite",
        "flexcomp",
        "sensor",
        "size",
        "visual",
        "statistic",
        "custom",
        "plugin",
    ),
    *("light", "camera", "material", "texture", "skin", "polycoef", "damper", "cylinder", "muscle", "adhesion", "x"),
)
KEYS = (
    *("name", "class", "childclass", "type", "size", "pos", "quat", "euler", "axisangle", "fromto", "mass", "density"),
    *(
        "friction",
        "solref",
        "solimp",
        "margin",
        "gap",
        "condim",
        "priority",
        "contype",
        "conaffinity",
        "range",
        "limited",
    ),
    *(
        "stiffness",
        "damping",
        "armature",
        "frictionloss",
        "springref",
        "ref",
        "axis",
        "mesh",
        "file",
        "scale",
        "vertex",
    ),
    *("joint", "joint1", "joint2", "body1", "body2", "anchor", "polycoef", "relpose", "active", "kp", "kv", "gear"),
    *(
        "ctrlrange",
        "forcerange",
        "gravity",
        "timestep",
        "integrator",
        "cone",
        "angle",
        "coordinate",
        "eulerseq",
        "qpos",
    ),
    *(
        "qvel",
        "ctrl",
        "time",
        "gravcomp",
        "mocap",
        "diaginertia",
        "fullinertia",
        "balanceinertia",
        "boundmass",
        "count",
    ),
    *(
        "autolimits",
        "inertiafromgeom",
        "settotalmass",
        "springlength",
        "springdamper",
        "user",
        "group",
        "fluidshape",
        "x",
    ),
)
GEOMS = ("sphere", "box", "capsule", "cylinder", "ellipsoid", "mesh")


def draw(d: Draws) -> Case:
    """Return a case."""
    root = model(d)
    for _ in range(d.damages()):
        damage_xml(d, root, TAGS, KEYS)
    data = xml_text(root).encode("utf-8", "surrogatepass")
    if d.chance(6):
        data = damage_bytes(d, data)
    options: Case = {"limits": d.chance(70), "friction": d.chance(40)}
    options["equality"], options["actuators"] = d.chance(80), d.chance(80)
    options["restitution"] = d.pick((0.0, 0.5, 1.0, None, "solref", "x", 2.0))
    if d.chance(10):
        options["prefix"] = d.wild_word()
    return {"data": data.decode("latin-1"), "options": options, "run": run_settings(d)}


def model(d: Draws) -> Element:
    """Return a valid model."""
    root = Element("mujoco", {"model": "m"})
    if d.chance(50):
        sub(root, "compiler", angle=d.pick(("radian", "degree")), autolimits=d.pick(("true", "false")))
    if d.chance(50):
        option = sub(root, "option", timestep=0.002, gravity=(0, 0, d.pick((-9.81, 0, 1))), density=d.pick((0, 0, 1.2)))
        if d.chance(30):
            flags = (
                "contact",
                "limit",
                "gravity",
                "spring",
                "damper",
                "frictionloss",
                "equality",
                "actuation",
                "warmstart",
            )
            sub(option, "flag", **{d.pick(flags): d.pick(("enable", "disable"))})
    if d.chance(30):
        default = sub(root, "default")
        sub(default, "joint", damping=d.number(0, 1), armature=d.number(0, 0.1))
        sub(default, "geom", friction=(0.8, 0.005, 0.0001), solref=d.pick(((0.02, 1), (0.02, 0.5), (-1000, -10))))
        inner = sub(default, "default", **{"class": "soft"})
        sub(inner, "geom", condim=d.pick((1, 3, 4, 6)), priority=d.whole(0, 1))
    asset = sub(root, "asset")
    sub(asset, "mesh", name="cube", file="cube.obj", scale=(0.1, 0.1, 0.1))
    sub(asset, "mesh", name="own", vertex=(0, 0, 0, 0.2, 0, 0, 0, 0.2, 0, 0, 0, 0.2))
    world = sub(root, "worldbody")
    if d.chance(60):
        sub(world, "geom", name="floor", type="plane", size=(1, 1, 0.1), pos=(0, 0, -2))
    bodies, joints = [], {}
    for k in range(d.whole(1, 4)):
        parent = d.pick([world, *bodies])
        body = sub(parent, "body", name=f"body_{k}", pos=tuple(d.number(-1, 1) for _ in range(3)))
        bodies.append(body)
        if d.chance(30):
            body.set(*d.pick((("euler", "0.1 0.2 0.3"), ("quat", "1 0 0 1"), ("axisangle", "0 0 1 1"))))
        _joints(d, body, k, parent is world, joints)
        for _ in range(d.pick((1, 1, 2))):
            _geom(d, body)
        if d.chance(20):
            sub(body, "inertial", pos=(0, 0, 0), mass=1, diaginertia=(0.1, 0.1, 0.1))
        sub(body, "site", name=f"site_{k}", pos=(0.1, 0, 0))
    _rest(d, root, len(bodies), joints)
    return root


def _joints(d: Draws, body: Element, k: int, on_world: bool, joints: dict[str, str]) -> None:
    kind = d.pick(("hinge", "hinge", "slide", "ball", "none", "two") + (("free",) * 2 if on_world else ()))
    if kind == "free":
        sub(body, "freejoint", name=f"joint_{k}")
    elif kind in ("ball", "hinge", "slide", "two"):
        joint = sub(body, "joint", name=f"joint_{k}", type="hinge" if kind == "two" else kind)
        if kind != "ball":
            joint.set("axis", d.pick(("1 0 0", "0 1 0", "0 0 1", "1 1 0")))
            joints[f"joint_{k}"] = kind
            if d.chance(40):
                joint.set("range", d.pick(("-1 1", "-90 45", "0 0.5")))
                joint.set("limited", d.pick(("true", "auto", "false")))
        for key in ("stiffness", "damping", "armature", "frictionloss", "springref"):
            if d.chance(15):
                joint.set(key, str(d.number(0, 2)))
        if kind == "two":
            sub(body, "joint", name=f"joint_{k}b", type=d.pick(("slide", "hinge")), axis=(0, 1, 0))


def _geom(d: Draws, body: Element) -> None:
    kind = d.pick(GEOMS)
    sizes = {"sphere": 1, "box": 3, "capsule": 2, "cylinder": 2, "ellipsoid": 3}
    geom = sub(body, "geom", type=kind, pos=tuple(d.number(-0.2, 0.2) for _ in range(3)))
    if kind == "mesh":
        geom.set("mesh", d.pick(("cube", "own")))
    elif kind == "capsule" and d.chance(40):
        geom.set("fromto", "0 0 0 0.1 0.2 0.3")
        geom.set("size", "0.05")
    else:
        geom.set("size", " ".join(str(d.number(0.05, 0.3)) for _ in range(sizes[kind])))
    if d.chance(20):
        geom.set(*d.pick((("mass", "0.5"), ("density", "500"), ("condim", "1"), ("contype", "0"), ("margin", "0.01"))))
    if d.chance(10):
        geom.set(*d.pick((("friction", "0.3 0 0"), ("solref", "0.01 0.2"), ("class", "main"), ("group", "3"))))


def _rest(d: Draws, root: Element, bodies: int, joints: dict[str, str]) -> None:
    """Add what stands beside the bodies: contacts, equalities, tendons, actuators, keyframes."""
    first, last = "body_0", f"body_{bodies - 1}"
    names = list(joints)
    if d.chance(25) and bodies > 1:
        sub(sub(root, "contact"), "exclude", body1=first, body2=last)
    if d.chance(30):
        equality = sub(root, "equality")
        kind = d.pick(("connect", "weld", "joint"))
        if kind == "connect":
            sub(equality, kind, body1=first, anchor=(0, 0, 0), **({"body2": last} if bodies > 1 else {}))
        elif kind == "weld":
            sub(equality, kind, body1=first, **({"body2": last} if bodies > 1 else {}))
        elif names:
            sub(
                equality,
                "joint",
                joint1=names[0],
                polycoef=(0, 1, 0, 0, 0),
                **({"joint2": n} if (n := names[-1]) != names[0] else {}),
            )
    if d.chance(25):
        tendon = sub(root, "tendon")
        spatial = sub(tendon, "spatial", name="rope", stiffness=d.number(0, 100), damping=d.number(0, 1))
        for k in range(max(2, bodies)):
            sub(spatial, "site", site=f"site_{min(k, bodies - 1)}")
        if names:
            sub(sub(tendon, "fixed", name="sum"), "joint", joint=names[0], coef=1)
    if names and d.chance(40):
        actuators = sub(root, "actuator")
        kind = d.pick(("motor", "position", "velocity", "general", "intvelocity"))
        actuator = sub(actuators, kind, name="drive", joint=names[0])
        if kind == "position":
            actuator.set("kp", "10")
        if d.chance(40):
            actuator.set("ctrlrange", "-1 1")
        if d.chance(40):
            actuator.set("forcerange", "-5 5")
        if kind == "intvelocity":
            actuator.set("actrange", "-1 1")
    if d.chance(20):
        sub(sub(root, "keyframe"), "key", name="home", time=0)


def attempt(case: Case) -> bool:
    """Read the model and run it."""
    Path("model.xml").write_bytes(case["data"].encode("latin-1"))
    Path("cube.obj").write_text(CUBE)
    return use(cvi.Scene.from_mjcf("model.xml", **case["options"]), case["run"])


__all__ = ["ElementTree", "attempt", "draw"]
