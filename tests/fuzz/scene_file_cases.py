"""TOML scene files: every table that the reader knows, with a few damages; loaded, and run as the command does."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import typer

import contactvi as cvi
from contactvi.commands import cli
from contactvi.scene.toml_tables import KEYS as TABLES
from fuzz import law
from fuzz.draws import Case, Draws, damage_bytes, damage_data, run_settings

KEYS = tuple(sorted({key for keys in TABLES.values() for key in keys} | {"times", "values", "x"}))
ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="lower"><inertial><origin xyz="0 0 -.3"/><mass value="1"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 -.6"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="10" velocity="5"/></joint>
<joint name="elbow" type="revolute"><origin xyz="0 0 -.5"/><parent link="upper"/><child link="lower"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="10" velocity="5"/>
<dynamics damping="0.1" friction="0.2"/></joint></robot>"""
BOX_ON_A_SLIDE = """<mujoco model="cart"><worldbody><body name="cart" pos="0 3 1"><joint name="slide" type="slide"/>
<geom type="box" size=".1 .1 .1"/></body></worldbody>
<keyframe><key name="home" qpos="0.2" qvel="0.1"/></keyframe></mujoco>"""
SRDF = """<robot name="arm"><disable_collisions link1="upper" link2="lower" reason="Never"/>
<group_state name="bent"><joint name="elbow" value="0.5"/></group_state></robot>"""


def draw(d: Draws) -> Case:
    """Return a case."""
    data = scene(d)
    for _ in range(d.damages()):
        damage_data(d, data, KEYS)
    text = toml(data).encode("utf-8", "surrogatepass")
    if d.chance(6):
        text = damage_bytes(d, text)
    return {"data": text.decode("latin-1"), "command": d.chance(25), "run": run_settings(d)}


def scene(d: Draws) -> dict[str, Any]:
    """Return the tables of a valid scene."""
    data: dict[str, Any] = {"scene": {"title": "t", "description": "d", "gravity": [0.0, 0.0, -9.81]}}
    data["urdf"] = [{"path": "arm.urdf", "xyz": [0.0, 0.0, 2.0], "rpy": [0.0, 0.0, 0.1], "limits": d.chance(80)}]
    data["urdf"][0] |= _some(
        d,
        {
            "base": "fixed",
            "package_dirs": ["."],
            "srdf": "arm.srdf",
            "friction": True,
            "mimic": True,
            "self_collision": False,
            "armature": d.pick((0.01, {"elbow": 0.1})),
        },
    )
    if d.chance(15):
        data["mjcf"] = [{"path": "cart.xml", **_some(d, {"prefix": "m_", "restitution": "solref", "equality": False})}]
    data["sphere"] = [{"name": "ball", "radius": 0.1, "mass": 1.0, "xyz": [3.0, 0.0, 0.1], **_some(d, {"free": True})}]
    data["box"] = [{"name": "box", "size": [0.2, 0.3, 0.2], "xyz": [0.0, -3.0, 0.15], "color": [1.0, 0.0, 0.0, 1.0]}]
    data["capsule"] = [{"name": "rod", "radius": 0.1, "length": 0.3, "xyz": [-3.0, 0.0, 0.5], "rpy": [1.0, 0.0, 0.0]}]
    data["ellipsoid"] = [{"name": "egg", "radii": [0.1, 0.2, 0.3], "xyz": [-3.0, 3.0, 0.5]}]
    data["cylinder"] = [{"name": "can", "radius": 0.1, "length": 0.3, "xyz": [3.0, 3.0, 0.2], "free": d.chance(70)}]
    data["halfspace"] = [{"name": "ground", "normal": [0.0, 0.0, 1.0], "offset": 0.0}]
    for name in ("mjcf", "sphere", "box", "capsule", "cylinder", "halfspace"):
        if d.chance(35):
            data.pop(name, None)
    bodies = [data[name][0]["name"] for name in ("sphere", "box", "capsule") if name in data]
    ends = [*bodies, "upper", "lower", "world"]
    data["contact"] = {
        "restitution": d.number(0, 1),
        "friction": d.number(0, 1),
        **_some(
            d,
            {
                "disable": [["upper", "lower"]],
                "enable": [["upper", "lower"]],
                "body": [{"name": d.pick(ends[:-1]), "restitution": 0.2, "friction": 0.3}],
                "pair": [{"a": "upper", "b": "lower", "restitution": 0.9, "friction": 0.1}],
            },
        ),
    }
    data["joint"] = [
        {
            "name": d.pick(("elbow", "shoulder", "*e*")),
            **_some(
                d,
                {
                    "stiffness": 10.0,
                    "rest": 0.1,
                    "damping": 0.2,
                    "limits": d.pick((True, False, [-1.0, 1.0])),
                    "restitution": 0.3,
                    "friction": d.pick((True, 0.1)),
                    "spring": [1.0, 0.0, 2.0],
                    "armature": 0.01,
                    "gear_ratio": 10.0,
                    "rotor_inertia": 1e-4,
                },
            ),
        }
    ]
    _elements(d, data, ends)
    data["initial"] = _some(
        d, {"q": {"elbow": 0.3}, "v": {"shoulder": 0.4}, "springs_at_rest": False, "assemble": d.chance(30)}
    )
    if bodies and d.chance(40):
        data["initial"]["body"] = [
            {
                "name": bodies[0],
                "velocity": [1.0, 0.0, 0.0],
                "angular_velocity": [0.0, 1.0, 0.0],
                **_some(d, {"xyz": [3.0, -3.0, 1.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}),
            }
        ]
    data["run"] = {
        "dt": d.pick((1e-3, 1e-2, "auto")),
        "duration": 0.02,
        **_some(
            d,
            {
                "order": d.pick((2, 4, 16)),
                "tol": 1e-8,
                "solver_tol": 1e-8,
                "impact": d.pick(("ctec", "dtec", "mhc")),
                "mhc_reference": "global",
                "sample_dt": 1e-3,
                "record_every": 2,
                "dense": True,
                "dt_contact": 1e-3,
                "zeno": d.pick(("hold", "end")),
                "support": "stiff",
                "contact_points": 3,
                "record_contacts": True,
                "max_iterations": 20,
                "contact_mode": d.pick(("auto", "steps", "events")),
                "max_impacts_per_step": 100,
                "ledger": {"own_jump": 1e-3},
            },
            15,
        ),
    }
    return data


def _elements(d: Draws, data: dict[str, Any], ends: list[str]) -> None:
    a, b = d.pick(ends), d.pick(ends)
    motion = d.pick((0.2, {"times": [0.0, 1.0, 2.0], "values": [0.0, 0.1, 0.3]}))
    spring = {"stiffness": 10.0, **_some(d, {"rest_length": 0.5, "damping": 0.1, "tension_only": True, "name": "s"})}
    elements: dict[str, Any] = {
        "point": {"a": a, "b": b, "point_a": [0.1, 0.0, 0.0], "point_b": [0.0, 0.1, 0.0], "name": "p"},
        "distance": {"a": a, "b": b, "point_a": [0.1, 0.0, 0.0], **_some(d, {"length": motion, "name": "d"})},
        "weld": {"a": a, "b": b, **_some(d, {"xyz": [0.1, 0.2, 0.3], "rpy": [0.1, 0.2, 0.3]})},
        "screw": {"a": a, "b": b, "pitch": 0.1, **_some(d, {"frame_a": {"xyz": [0.1, 0.0, 0.0]}, "frame_b": {}})},
        "equality": {"joint": "elbow", **_some(d, {"other": "shoulder", "coefficients": [0.0, 1.0, 0.1]})},
        "prescribe": {"joint": "elbow", "motion": motion},
        "spring": {"a": a, "b": b, "point_a": [0.0, 0.0, 0.2], **spring},
        "tape_spring": {"points": [[a, [0.0, 0.0, 0.1]], [b, [0.1, 0.0, 0.0]], ["world", [0.0, 0.0, 3.0]]], **spring},
        "wrench": {
            "body": d.pick(ends[:-1]),
            "force": [1.0, 0.0, 0.0],
            **_some(d, {"torque": [0.0, 1.0, 0.0], "axes": "body", "point": [0.0, 0.0, 0.1]}),
        },
        "servo": {"joint": "shoulder", "kp": 10.0, "kd": 1.0, **_some(d, {"effort": 5.0, "target": motion})},
        "actuator": {"joint": "elbow", **_some(d, {"effort": True, "velocity": 3.0})},
    }
    for _ in range(d.pick((0, 1, 1, 2))):
        name = d.pick(list(elements))
        data.setdefault(name, []).append(elements[name])


def _some(d: Draws, values: dict[str, Any], percent: int = 30) -> dict[str, Any]:
    return {key: value for key, value in values.items() if d.chance(percent)}


def toml(data: dict[str, Any]) -> str:
    """Return tables as TOML, all in one line each."""
    return "\n".join(f"{_key(name)} = {_value(value)}" for name, value in data.items())


def _key(name: str) -> str:
    return name if name.isascii() and name.isidentifier() else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_value(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value)


def attempt(case: Case) -> bool:
    """Load the scene file and run it, some as the command line does."""
    for name, text in (("arm.urdf", ARM), ("cart.xml", BOX_ON_A_SLIDE), ("arm.srdf", SRDF)):
        Path(name).write_text(text)
    Path("scene.toml").write_bytes(case["data"].encode("latin-1"))
    scene = cvi.load_scene("scene.toml")
    if scene.q0 is not None:
        law.check_numbers("q0", scene.q0)
    if scene.v0 is not None:
        law.check_numbers("v0", scene.v0)
    str(scene.report)
    duration = few_steps(scene)
    if duration is None:
        return law.run_briefly(scene, case["run"])
    try:
        if not case["command"]:
            traj = cvi.simulate(scene, duration=duration, throw=False)
            law.check_run(traj)
            return traj.stats.steps > 0
        cli.run(Path("scene.toml"), Path("out"), duration=duration, fps=10.0, html=True, plot=False)
    except cvi.ContactviError:
        return False
    except typer.Exit as end:
        if end.exit_code != cli.ENDED_EARLY:
            raise
    law.check_run(cvi.Trajectory.load("out/trajectory.npz"))
    return True


def few_steps(scene: cvi.Scene) -> float | None:
    """Return a duration of few steps of the file's length, None where the file asks for more work than that [s]."""
    settings = scene.settings
    dt = settings.get("dt", 1e-3)
    if not isinstance(dt, float) or not 0.0 < dt < 1e300 or settings.get("solver_tol", 1e-8) != 1e-8:
        dt = 1e-3
    duration = 0.01 if settings.get("dt") == "auto" else 3.0 * dt
    for name in ("sample_dt", "dt_contact"):
        step = settings.get(name)
        if isinstance(step, (int, float)) and not isinstance(step, bool) and (step <= 0 or duration / step > 1e3):
            return None
    return duration if math.isfinite(duration) else None
