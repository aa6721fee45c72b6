"""The scene S7: the Allegro hand closes around a ball; friction 0.7, 1 s. Needs pin, numpy, contactvi.

The hand of example-robot-data with its boxes and spheres, palm up, fixed tips merged, without its damping, friction and
joint limits, from an open pose at rest. A PD controller (0.5 N m/rad, 0.01 N m s/rad, the file's effort limit of
15 N m, which it never reaches) drives every joint to a half closed pose. The ball, 3 cm in radius and 100 g, starts
8.9 mm above the palm, at rest. Contacts: ball against hand only.

States are plain lists, in the job as in the results: q = joints in the job's order and the ball's centre (19,);
v = speeds of the joints, the ball's velocity and its angular velocity, both along the world's axes (22,).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import scenes

from contactvi.importing.paths import resolve_path

FILE = "example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf"
# The palm's normal (+x of the hand) points up, the fingers along -x.
PALM_UP = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
START = [0.0, 0.2, 0.2, 0.2] * 3 + [0.8, 0.3, 0.2, 0.2]
GOAL = [0.0, 1.4, 1.2, 0.8] * 3 + [1.2, 0.3, 0.3, 0.9]
FINGERS = ("index", "middle", "ring", "thumb")  # four joints each
KP, KD, FRICTION, DURATION = 0.5, 0.01, 0.7, 1.0
BALL = {"radius": 0.03, "mass": 0.1}
BALL_START = (PALM_UP @ [0.05, -0.02, 0.0]).tolist()
TOUCHES_AT = 0.035  # s: nothing touches before
SQUEEZE = 0.5  # s at the end, over which the normal forces of all contacts are summed and averaged


def model() -> pin.Model:
    """The hand, palm up."""
    hand = scenes.allegro()[0]
    turn = pin.SE3(PALM_UP, np.zeros(3))
    for j in range(1, hand.njoints):
        if hand.parents[j] == 0:
            hand.jointPlacements[j] = turn * hand.jointPlacements[j]
    hand.gravity.linear = np.array([0.0, 0.0, -scenes.GRAVITY])
    return hand


def job(folder: Path) -> dict[str, Any]:
    """The scene as plain data; its URDF is written into the folder, `urdf` is without shapes."""
    hand = model()
    numbers = [int(name.removeprefix("joint_").removesuffix(".0")) for name in list(hand.names)[1:]]
    q0 = [START[k] for k in numbers]
    scene = scenes.Scene("S7", hand, np.array(q0), np.zeros(16), DURATION)
    found = _shapes(hand)
    elements: dict[int, list[str]] = {}
    for shape in found:
        elements.setdefault(shape["joint"], []).append(_element(shape))
    file = folder / "S7.urdf"
    file.write_text(scenes.to_urdf(scene, elements))
    return {
        "name": "S7", "urdf_file": str(file), "urdf": scenes.to_urdf(scene), "joints": list(hand.names)[1:],
        "start": {"q": q0 + BALL_START, "v": [0.0] * 22}, "goal": [GOAL[k] for k in numbers], "kp": KP, "kd": KD,
        "effort": _effort(), "friction": FRICTION, "ball": BALL, "shapes": found, "gravity": scenes.GRAVITY,
        "parts": ["palm", *(FINGERS[k // 4] for k in numbers)], "duration": DURATION, "sample": scenes.SAMPLE,
    }  # fmt: skip


def _effort() -> float:
    """The effort limit of the file [N m], equal for all joints."""
    return float(pin.buildModelFromUrdf(str(resolve_path(FILE))).effortLimit.min())


def _shapes(hand: pin.Model) -> list[dict[str, Any]]:
    """The hand's shapes: joint (0: the palm), box (sides) or sphere (radius), place in the joint's frame [m]."""
    geometry = pin.buildGeomFromUrdf(hand, str(resolve_path(FILE)), pin.GeometryType.COLLISION)
    turn, found = pin.SE3(PALM_UP, np.zeros(3)), []
    for item in geometry.geometryObjects:
        place, shape = turn * item.placement if item.parentJoint == 0 else item.placement, item.geometry
        box = hasattr(shape, "halfSide")  # coal holds the half edges of a box
        size = {"box": (2.0 * shape.halfSide).tolist()} if box else {"sphere": float(shape.radius)}
        rpy = pin.rpy.matrixToRpy(place.rotation).tolist()
        found.append({"joint": int(item.parentJoint), **size, "xyz": place.translation.tolist(), "rpy": rpy})
    return found


def _element(shape: dict[str, Any]) -> str:
    """A collision element."""
    body = f'<box size="{_text(shape["box"])}"/>' if "box" in shape else f'<sphere radius="{shape["sphere"]!r}"/>'
    origin = f'<origin xyz="{_text(shape["xyz"])}" rpy="{_text(shape["rpy"])}"/>'
    return f"<collision>{origin}<geometry>{body}</geometry></collision>"


def _text(values: list[float]) -> str:
    return " ".join(repr(x) for x in values)
