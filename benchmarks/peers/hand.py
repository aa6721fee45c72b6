"""The scene S7: the Allegro hand closes around a ball; friction 0.7, 1 s. Needs pin, numpy, contactvi.

The hand of example-robot-data with its boxes and spheres, palm up, fixed tips merged, without its damping, friction and
limits, from an open pose at rest; every joint has a spring of 0.5 N m/rad towards a half closed pose and a damping of
0.01 N m s/rad (a PD controller). The ball, 3 cm in radius and 100 g, starts 8.9 mm above the palm, at rest. Contacts:
ball against hand only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import scenes

from contactvi.paths import resolve_path

# The palm's normal (+x of the hand) points up, the fingers along -x.
PALM_UP = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
START = [0.0, 0.2, 0.2, 0.2] * 3 + [0.8, 0.3, 0.2, 0.2]
GOAL = [0.0, 1.4, 1.2, 0.8] * 3 + [1.2, 0.3, 0.3, 0.9]
STIFFNESS, DAMPING, FRICTION, DURATION = 0.5, 0.01, 0.7, 1.0
BALL = {"radius": 0.03, "mass": 0.1, "position": (PALM_UP @ [0.05, -0.02, 0.0]).tolist()}


def make() -> tuple[scenes.Scene, dict[int, list[str]]]:
    """The hand and its shapes as URDF, by joint (0: the palm)."""
    path = str(resolve_path("example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf"))
    model = scenes.allegro()[0]
    geometry = pin.buildGeomFromUrdf(model, path, pin.GeometryType.COLLISION)
    turn = pin.SE3(PALM_UP, np.zeros(3))
    q0 = np.zeros(16)
    for k in range(16):
        q0[model.joints[model.getJointId(f"joint_{k}.0")].idx_q] = START[k]
    for j in range(1, model.njoints):
        if model.parents[j] == 0:
            model.jointPlacements[j] = turn * model.jointPlacements[j]
    shapes: dict[int, list[str]] = {}
    for shape in geometry.geometryObjects:
        place = turn * shape.placement if shape.parentJoint == 0 else shape.placement
        shapes.setdefault(shape.parentJoint, []).append(_urdf(shape.geometry, place))
    scene = scenes.Scene("S7", model, q0, np.zeros(16), DURATION)
    scene.model.gravity.linear = np.array([0.0, 0.0, -scenes.GRAVITY])
    return scene, shapes


def job(folder: Path) -> dict[str, Any]:
    """The scene as plain data; its URDF is written into the folder."""
    scene, shapes = make()
    file = folder / "S7.urdf"
    file.write_text(scenes.to_urdf(scene, shapes))
    names = list(scene.model.names)[1:]
    goal = [GOAL[int(name.removeprefix("joint_").removesuffix(".0"))] for name in names]
    return {
        "name": "S7", "urdf_file": str(file), "joints": names, "q0": scene.q0.tolist(), "goal": goal,
        "stiffness": STIFFNESS, "damping": DAMPING, "friction": FRICTION, "ball": BALL, "gravity": scenes.GRAVITY,
        "duration": DURATION, "sample": scenes.SAMPLE,
    }  # fmt: skip


def energy(job: dict[str, Any], q: np.ndarray, v: np.ndarray) -> float:
    """Kinetic, potential and spring energy [J]. q: joints, then the ball's position; v: joints, then its 6 speeds."""
    model = make()[0].model
    data, ball = model.createData(), job["ball"]
    spin = 0.4 * ball["mass"] * ball["radius"] ** 2
    kinetic = 0.5 * ball["mass"] * v[16:19] @ v[16:19] + 0.5 * spin * v[19:22] @ v[19:22]
    potential = ball["mass"] * job["gravity"] * q[18] + 0.5 * job["stiffness"] * np.sum((q[:16] - job["goal"]) ** 2)
    pin.computeAllTerms(model, data, q[:16], v[:16])
    return float(kinetic + potential + data.kinetic_energy + data.potential_energy)


def _urdf(shape: Any, place: pin.SE3) -> str:
    """A collision element; coal holds the half edges of a box."""
    if hasattr(shape, "halfSide"):
        size = " ".join(repr(2.0 * float(x)) for x in shape.halfSide)
        body = f'<box size="{size}"/>'
    else:
        body = f'<sphere radius="{float(shape.radius)!r}"/>'
    xyz, rpy = (" ".join(repr(float(x)) for x in v) for v in (place.translation, pin.rpy.matrixToRpy(place.rotation)))
    return f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{body}</geometry></collision>'
