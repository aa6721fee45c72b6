"""A self-contained page that plays a run: meshcat's viewer, its drawing commands, and a time slider.

The commands are those of meshcat's Python package (geometry, material, animation), packed as it packs them. They are
put into the page in order and need no server; tracks are sent as arrays, which three.js takes as well as key lists.
"""

from __future__ import annotations

import base64
import functools
import html
import importlib.resources
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import meshcat
import numpy as np
import umsgpack  # type: ignore[import-untyped]
from meshcat import commands
from meshcat import geometry as mg
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.files import write_atomic
from contactvi.inputs import flag, words
from contactvi.playback.animation import Frames, Marker, Poses, frames_of, shown_impacts
from contactvi.playback.animation import Run as AnimatedRun
from contactvi.playback.force_arrows import Arrow, Forces, forces_of
from contactvi.playback.lines import Piece, pieces_of
from contactvi.playback.shapes import (
    ARROW_COLOR,
    ARROW_LENGTH,
    FORCE_COLOR,
    arrow,
    draw,
    fit,
    floor,
    line,
    point_marker,
)
from contactvi.playback.visuals import SPRING_COLOR, STRING_COLOR
from contactvi.status import Status
from contactvi.version import version

Array = NDArray[np.float64]
_DISCRETE, _LINEAR = 2300, 2301  # three.js: InterpolateDiscrete, InterpolateLinear
_ROOT = "/contactvi"
_LINES = {SPRING_COLOR: "green: springs", STRING_COLOR: "dark: strings and rods"}
_LINE_RADIUS = 0.004  # of the radius of the picture


class Run(AnimatedRun, Protocol):
    """The part of a run that the page shows; contactvi.Trajectory has it."""

    status: Status

    @property
    def stepping(self) -> str: ...


def write_html(
    run: Run,
    path: str | os.PathLike[str],
    *,
    fps: float = 60.0,
    title: str = "",
    play: bool = True,
    forces: bool = True,
) -> Path:
    """Write the page that plays `run`; return its path.

    Args:
        path: file to write, replaced whole or not at all.
        fps: frames per second of simulated time, > 0; impacts get a frame of their own. Long runs get fewer.
        title: heading and name of the page.
        play: start playing when the page is opened.
        forces: show the forces of persistent contacts as arrows, where the run has recorded some.
    """
    text = make_html(run, fps=fps, title=title, play=play, forces=forces)
    return write_atomic(path, lambda file: file.write(text.encode("utf-8")))


def make_html(run: Run, *, fps: float = 60.0, title: str = "", play: bool = True, forces: bool = True) -> str:
    """Return the text of the page; arguments as in `write_html`."""
    if not isinstance(fps, (int, float)) or isinstance(fps, bool) or not 0 < fps < 1e6:
        raise InputError(
            "fps is not usable",
            name="fps",
            expected="frames per second of simulated time",
            got=repr(fps),
            remedy="Use fps=60",
        )
    if not hasattr(run, "visuals"):
        raise InputError(
            "Argument run", name="run", expected="a Trajectory", got=type(run).__name__,
            remedy="Give what simulate returns",
        )  # fmt: skip
    title, play, forces = words("title", title), flag("play", play), flag("forces", forces)
    frames = frames_of(run, float(fps))
    view = fit(run.visuals, frames)
    shown = forces_of(run, run.t[0] + frames.times) if forces else None
    packed = [umsgpack.packb(command) for command in _commands(run, frames, view, shown)]
    title = title or _title(run)
    parts = {
        "@TITLE@": html.escape(title),
        "@RUN@": _script(_description(run, frames, view, shown, title, play)),
        "@COMMANDS@": json.dumps([base64.b64encode(data).decode("ascii") for data in packed]),
        "@MESHCAT@": _meshcat_script(),
    }
    text = importlib.resources.files("contactvi.playback").joinpath("page.html").read_text(encoding="utf-8")
    return re.sub("|".join(parts), lambda found: parts[found[0]], text)  # in one pass: what is put in is not looked at


def _commands(run: Run, frames: Frames, view: dict[str, Any], forces: Forces | None) -> Iterator[dict[str, Any]]:
    """Yield the drawing commands, lowered to plain data."""
    yield from _properties(
        ("/Background", "top_color", [0.97, 0.98, 1.0]),
        ("/Background", "bottom_color", [0.80, 0.84, 0.89]),
        ("/Grid", "visible", False),
        ("/Axes", "visible", False),
    )
    tracks: dict[str, list[dict[str, Any]]] = {}
    for k, visual in enumerate(run.visuals):
        if visual.shape == "line":
            for j, piece in enumerate(pieces_of(visual, frames.poses)):
                path = f"{_ROOT}/lines/{k}_{_path_name(visual.name)}/{j}"
                yield from _object(f"{path}/piece", *line(visual, _LINE_RADIUS * view["radius"]))
                yield commands.SetTransform(_stretched(piece), path=_Path(path)).lower()
                tracks |= {path: _piece_tracks(piece, frames.times)} if piece.moves else {}
            continue
        path = f"{_ROOT}/{_joint_path(run, visual.joint)}/{k}_{_path_name(visual.name)}"
        parts = floor(visual, view) if visual.shape == "halfspace" else draw(visual, k)
        for j, (piece, material, matrix) in enumerate(parts):
            yield from _object(f"{path}/{j}", piece, material, visual.placement @ matrix)
    for joint, poses in frames.poses.items():
        path = f"{_ROOT}/{_joint_path(run, joint)}"
        yield commands.SetTransform(_matrix(poses), path=_Path(path)).lower()
        if poses.moves:
            tracks[path] = [
                _track("position", "vector3", frames.times, poses.position),
                _track("quaternion", "quaternion", frames.times, poses.quaternion),
            ]
    largest = max((max(marker.impulse) for marker in frames.markers), default=0.0)
    for k, marker in enumerate(frames.markers):
        path = f"{_ROOT}/impacts/{k}"
        yield from _object(f"{path}/point", *point_marker(view["size"]))
        for j, part in enumerate(arrow(view["size"])):
            yield from _object(f"{path}/arrow/{j}", *part)
        yield from _properties((path, "visible", False))
        tracks |= _marker_tracks(path, marker, largest)
    if forces is not None:
        for k, shown in enumerate(forces.arrows):
            path = f"{_ROOT}/forces/{k}"
            for j, part in enumerate(arrow(view["size"], FORCE_COLOR)):
                yield from _object(f"{path}/{j}", *part)
            yield from _properties((path, "visible", False))
            tracks[path] = _force_tracks(shown, forces.length(shown), float(run.t[0]))
    if tracks:
        yield _animation(tracks)


def _marker_tracks(path: str, marker: Marker, largest: float) -> dict[str, list[dict[str, Any]]]:
    """Return the tracks that move one marker from impact to impact and show it only around them."""
    start = np.array(marker.start)
    key, shown = _switches(marker)
    # Length in proportion to the impulse, with a least length that can still be seen; thickness follows less.
    length = np.maximum(np.array(marker.impulse) / largest if largest > 0 else np.ones(len(start)), 0.08)
    width = 0.4 + 0.6 * length
    return {
        path: [
            _track("position", "vector3", start, np.array(marker.point), _DISCRETE),
            {"name": ".visible", "type": "bool", "times": _floats(key), "values": [bool(x) for x in shown]},
        ],
        f"{path}/arrow": [
            _track("quaternion", "quaternion", start, np.array([_turn(n) for n in marker.direction]), _DISCRETE),
            _track("scale", "vector3", start, np.column_stack([width, width, length]), _DISCRETE),
        ],
    }


def _force_tracks(arrow: Arrow, length: Array, start: float) -> list[dict[str, Any]]:
    """Return the tracks that move one arrow with its contact point, as long as the force is strong."""
    time = np.array(arrow.time) - start
    width = 0.5 + 0.3 * length
    turns = np.array([_turn(force) for force in arrow.force])
    near = np.cumprod(np.where(np.sum(turns[1:] * turns[:-1], axis=1) < 0, -1.0, 1.0))
    turns[1:] *= near[:, None]  # q and -q are one rotation: the sign near the previous key, as they are interpolated
    # Before its first key a track has the value of that key: an arrow that appears later is hidden from the start.
    key, shown = np.append(0.0, time) if time[0] > 0.0 else time, arrow.shown
    shown = [False, *shown] if time[0] > 0.0 else shown
    return [
        {"name": ".visible", "type": "bool", "times": _floats(key), "values": shown},
        _track("position", "vector3", time, np.array(arrow.point)),
        _track("quaternion", "quaternion", time, turns),
        _track("scale", "vector3", time, np.column_stack([width, width, length])),
    ]


def _piece_tracks(piece: Piece, times: Array) -> list[dict[str, Any]]:
    """Return the tracks that move, turn and stretch a piece of a line."""
    ones = np.ones(len(piece.length))
    return [
        _track("position", "vector3", times, piece.start),
        _track("quaternion", "quaternion", times, piece.quaternion),
        _track("scale", "vector3", times, np.column_stack([ones, ones, piece.length])),
    ]


def _switches(marker: Marker) -> tuple[Array, NDArray[np.bool_]]:
    """Return the times at which a marker is switched and whether it is on from then; the last switch counts."""
    switch = {0.0: False}
    for k, (start, end) in enumerate(zip(marker.start, marker.end, strict=True)):
        switch[start] = True
        if k + 1 == len(marker.start) or end < marker.start[k + 1]:
            switch[end] = False
    times = sorted(switch)
    return np.array(times), np.array([switch[time] for time in times])


def _description(
    run: Run, frames: Frames, view: dict[str, Any], forces: Forces | None, title: str, play: bool
) -> dict[str, Any]:
    """Return the texts of the page, and its camera."""
    events = run.events
    duration = float(frames.times[-1])
    listed = shown_impacts(run)
    impacts = [_impact(run, int(k)) for k in listed]
    facts = [
        {"text": f"{duration:.6g} s simulated, {run.stepping}, {len(events)} impacts", "bad": False},
        {"text": f"impact map {run.events.method.upper()}, contactvi {version()}", "bad": False},
    ]
    if forces is not None:
        drawn = ARROW_LENGTH * view["size"] * forces.reference / forces.full
        text = f"blue arrows: contact forces, {_metres(drawn)} for {forces.reference:g} N"
        facts.append({"text": text + (", not all of them" if forces.hidden else ""), "bad": False})
    colors = {visual.color for visual in run.visuals if visual.shape == "line"}
    shown = [words for color, words in _LINES.items() if color in colors]
    if shown:
        facts.append({"text": f"lines, {', '.join(shown)}", "bad": False})
    if not run.status.ok:
        facts.append({"text": str(run.status), "bad": True})
    if len(listed) < len(events):
        facts.append({"text": f"{len(listed)} of the impacts are shown", "bad": False})
    return {
        "title": title,
        "duration": duration,
        "impacts": impacts,
        "facts": facts,
        "view": {name: view[name] for name in ("center", "radius", "direction", "spread")},
        "play": bool(play),
    }


def _metres(length: float) -> str:
    return f"{length:.2g} m" if length >= 1.0 else f"{100.0 * length:.2g} cm"


def _title(run: Run) -> str:
    """Return the names of what is in the scene, the first few of them."""
    names = [part.name for part in run.scene.parts]
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")


def _impact(run: Run, k: int) -> dict[str, Any]:
    event = run.events[k]
    impulse, speed = (" N s", " m/s") if event.kind == "contact" else ("", "")  # a limit may be an angle or a length
    return {
        "t": event.time - float(run.t[0]),
        "pair": f"{event.pair[0]} | {event.pair[1]}",
        "kind": event.kind,
        "text": f"impulse {event.impulse:.4g}{impulse}, speed {event.gamma_minus:.4g} to {event.gamma_plus:.4g}{speed}",
    }


def _object(path: str, piece: Any, material: Any, matrix: Array) -> Iterator[dict[str, Any]]:
    yield commands.SetObject(piece, material, path=_Path(path)).lower()
    yield commands.SetTransform(matrix, path=_Path(path)).lower()


def _properties(*values: tuple[str, str, Any]) -> Iterator[dict[str, Any]]:
    for path, key, value in values:
        yield {"type": "set_property", "path": path, "property": key, "value": value}


def _animation(tracks: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    clips = [{"path": path, "clip": {"fps": 1, "name": "run", "tracks": found}} for path, found in tracks.items()]
    return {"type": "set_animation", "path": "", "animations": clips, "options": {"play": True, "repetitions": 1}}


def _track(name: str, kind: str, times: Array, values: Array, interpolation: int = _LINEAR) -> dict[str, Any]:
    return {
        "name": f".{name}",
        "type": kind,
        "times": _floats(times),
        "values": _floats(values),
        "interpolation": interpolation,
    }


def _floats(values: Array) -> Any:
    """Return numbers as meshcat packs a Float32Array; those beyond its range become the largest ones in it."""
    most = float(np.finfo(np.float32).max)
    single = np.ascontiguousarray(np.clip(values, -most, most), np.float32)
    return umsgpack.Ext(mg.threejs_type(np.dtype(np.float32))[1], single.tobytes())


def _matrix(poses: Poses) -> Array:
    import pinocchio as pin

    x, y, z, w = poses.quaternion[0]
    return np.asarray(pin.SE3(pin.Quaternion(w, x, y, z), poses.position[0]).homogeneous)


def _stretched(piece: Piece) -> Array:
    """Return the matrix of a piece of a line in the first frame."""
    return _matrix(Poses(piece.start, piece.quaternion)) @ np.diag([1.0, 1.0, float(piece.length[0]), 1.0])


def _turn(direction: Array) -> Array:
    """Return the quaternion (x y z w) that turns the z axis into `direction`."""
    import pinocchio as pin

    return np.asarray(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.asarray(direction, float)).coeffs())


def _joint_path(run: Run, joint: int) -> str:
    return "world" if joint == 0 else f"{joint}_{_path_name(run.scene.model.names[joint])}"


def _path_name(name: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in name)


class _Path:
    """A path as meshcat's commands want it."""

    def __init__(self, path: str) -> None:
        self._path = path

    def lower(self) -> str:
        return self._path


@functools.lru_cache(maxsize=1)
def _meshcat_script() -> str:
    """Return meshcat's JavaScript, as the static pages of meshcat hold it."""
    path = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
    return path.read_text(encoding="utf-8")


def _script(data: Any) -> str:
    """Return data as JSON that cannot end a script element; numbers that are not finite are refused."""
    return json.dumps(data, allow_nan=False).replace("</", "<\\/").replace("<!--", "<\\u0021--")


__all__ = ["ARROW_COLOR", "Run", "make_html", "write_html"]
