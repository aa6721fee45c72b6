"""The start of a run as a scene file gives it: [initial] and [[initial.body]] (contactvi.scene.toml)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.errors import InputError
from contactvi.inputs import flag, mapping, pose, unit_quaternion, vector
from contactvi.scene.toml_tables import at

Scene = Any  # contactvi.Scene, which uses this module to look at what it has written


def set_start(scene: Scene, data: Mapping[str, Any], file: Path) -> None:
    """Give a scene the q0 and v0 of the file's data."""
    initial = data.get("initial", {})
    with at(file, "initial"):
        values = mapping("q", initial.get("q", {}), "joint: value")
        q, v = _base(scene, initial)
        q = scene.configuration(values, q)
        speeds = dict(mapping("v", initial.get("v", {}), "joint: velocity"))
    for number, entry in enumerate(initial.get("body", ())):
        with at(file, "initial.body", number):
            name = entry["name"]
            if scene.nv == 0 or len(q[scene.q_index(name)]) != 7:
                remedy = "Set it in [initial] q, v"
                raise InputError(f"Body {name!r}", name="name", expected="a free body", got="a joint", remedy=remedy)
            place = _body_pose(entry, q[scene.q_index(name)])
            q = scene.configuration({name: place}, q)
            zero = [0.0, 0.0, 0.0]
            speeds[name] = tuple(vector(key, entry.get(key, zero), 3) for key in ("velocity", "angular_velocity"))
    with at(file, "initial"):
        scene.q0, scene.v0 = q, scene.velocity(speeds, q, v)
        if flag("assemble", initial.get("assemble", False)):
            scene.q0 = scene.assemble(q)
            scene.v0 = scene.consistent_velocity(scene.q0, scene.v0)
        elif not speeds and not np.any(v) and scene.elements:
            scene.v0 = None  # A run then starts with the velocity that driven constraints give.


def _base(scene: Scene, initial: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return q (nq,) and v (nv,) of what [initial] begins with."""
    at_rest, named = flag("springs_at_rest", initial.get("springs_at_rest", False)), initial.get("configuration")
    if named is None:
        return scene.spring_rest() if at_rest else scene.neutral(), np.zeros(scene.nv)
    if at_rest or not isinstance(named, str):
        got = "configuration and springs_at_rest" if at_rest else repr(named)
        raise InputError(
            "Start of the run",
            name="configuration",
            expected="the name of one",
            got=got,
            remedy="Remove springs_at_rest: the configuration says where the joints are"
            if at_rest
            else 'Write configuration = "home", with a name of the models\' files',
        )
    return scene.configuration({}, named), scene.named_configurations[named][1]


def _body_pose(entry: Mapping[str, Any], now: np.ndarray) -> pin.SE3:
    """Return the pose an [[initial.body]] entry gives; what it leaves out stays as it is."""
    placement = pin.XYZQUATToSE3(now)
    if "rpy" in entry and "quaternion" in entry:
        raise InputError(
            "Orientation given twice",
            name="rpy",
            expected="rpy or quaternion",
            got="both",
            remedy="Remove one of the two",
        )
    if "xyz" in entry:
        placement.translation = vector("xyz", entry["xyz"], 3)
    if "rpy" in entry:
        placement.rotation = pose("rpy", ([0.0, 0.0, 0.0], entry["rpy"])).rotation
    if "quaternion" in entry:
        x, y, z, w = unit_quaternion("quaternion", entry["quaternion"])
        placement.rotation = pin.Quaternion(w, x, y, z).toRotationMatrix()
    return placement
