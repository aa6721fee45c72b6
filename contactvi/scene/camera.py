"""Where a picture of a scene is taken from: a preset, an eye and a target, or a body that is followed. Plain data."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactvi.errors import ContactviError, InputError, did_you_mean
from contactvi.inputs import check_choice, short, vector

PRESETS = ("auto", "front", "side", "top")
_EXPECTED = (
    " | ".join(repr(name) for name in PRESETS)
    + ', {"eye": [x, y, z], "target": [x, y, z]} or {"follow": "name of a body"}'
)
_Point = tuple[float, float, float]


@dataclass(frozen=True)
class Camera:
    """One camera; exactly one of `preset`, `eye` with `target`, `follow` is given.

    Attributes:
        preset: "auto" (the open side), "front" (looks along -x), "side" (along +y, x to the right), "top" (along -z).
        eye, target: where it stands and what it looks at [m], world frame.
        follow: name of the body that stays in the middle.
    """

    preset: str | None = None
    eye: _Point | None = None
    target: _Point | None = None
    follow: str | None = None

    def to_data(self) -> str | dict[str, Any]:
        """Return what `camera_of` makes this camera of."""
        if self.preset is not None:
            return self.preset
        if self.follow is not None:
            return {"follow": self.follow}
        return {"eye": list(self.eye or ()), "target": list(self.target or ())}


def camera_of(value: Any) -> Camera:
    """Return the camera that is meant by a preset's name, {"eye": ..., "target": ...} or {"follow": ...}.

    Raises:
        InputError: anything else, and an eye at its target.
    """
    if isinstance(value, str):
        check_choice("camera", value, PRESETS, "Camera of a picture")
        return Camera(preset=value)
    keys = set(value) if isinstance(value, Mapping) else set()
    if keys == {"follow"}:
        body = value["follow"]
        if not isinstance(body, str) or not body:
            raise _refused(value, 'Write {"follow": "ball"} with the name of a body')
        return Camera(follow=body)
    if keys != {"eye", "target"}:
        missing = {"eye", "target"} - keys if keys & {"eye", "target"} else set()
        remedy = f"Add {' and '.join(sorted(missing))}" if missing else "Use camera='auto', or one of the others"
        if keys - {"eye", "target", "follow"}:
            wrong = sorted(map(str, keys - {"eye", "target", "follow"}))[0]
            remedy = did_you_mean(wrong, ["eye", "target", "follow"])
        raise _refused(value, remedy)
    eye, target = vector("camera eye", value["eye"], 3), vector("camera target", value["target"], 3)
    if not np.linalg.norm(eye - target) > 1e-9 * max(1.0, float(np.abs(target).max())):
        raise InputError(
            "The camera stands at its target", name="camera", expected="two places", got=short(value),
            remedy="Move the eye away from the target",
        )  # fmt: skip
    return Camera(eye=_point(eye), target=_point(target))


def camera_of_text(text: str) -> Camera:
    """Return the camera of a text, as on the command line: a preset's name, or JSON. Raises InputError."""
    if not text.lstrip().startswith("{"):
        return camera_of(text)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        raise _refused(text, """Write it as --camera '{"follow": "ball"}', in single quotes""") from None
    return camera_of(value)


def bodies_to_follow(scene: Any) -> list[str]:
    """Return the names of a Scene's joints, links and shapes."""
    shapes = (shape.name for shape in scene.collision_model.geometryObjects)
    names = {*scene.model.names, *(frame.name for frame in scene.model.frames), *shapes}
    return sorted(names - {"universe"})


def check_followed(camera: Camera, bodies: Iterable[str]) -> None:
    """Raise InputError where the camera follows a body that is not there."""
    known = sorted(set(bodies))
    if camera.follow is None or camera.follow in known:
        return
    raise InputError(
        "The camera follows an unknown body", name="camera",
        expected="one of " + ", ".join(known[:12]) + (", ..." if len(known) > 12 else "") if known else "no body",
        got=repr(camera.follow), remedy=did_you_mean(camera.follow, known),
    )  # fmt: skip


def _point(values: Any) -> _Point:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _refused(value: Any, remedy: str) -> ContactviError:
    return InputError("Camera of a picture", name="camera", expected=_EXPECTED, got=short(value), remedy=remedy)
