"""A self-contained page that plays a run: its data as JSON, the player (web/*.js), and three.js as meshcat ships it.

What is put into the page is put in in one pass and escaped; arrays are numbers in base64.
"""

from __future__ import annotations

import functools
import hashlib
import html
import importlib.resources
import importlib.util
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.files import check_free, write_atomic
from contactvi.inputs import flag, positive, words
from contactvi.playback.animation import Frames, Poses, frames_of
from contactvi.playback.animation import Run as AnimatedRun
from contactvi.playback.arrays import packed
from contactvi.playback.arrow_tips import AFTERGLOW, ARROW_LENGTH, LONGEST, arrow_tips
from contactvi.playback.contact_frames import ContactFrames, contact_frames
from contactvi.playback.event_list import KINDS, HappeningList, happenings
from contactvi.playback.framing import View, fit
from contactvi.playback.open_side import trees_of
from contactvi.playback.shapes import shape_data
from contactvi.playback.touches import Touches
from contactvi.playback.visuals import (
    MAX_TRIANGLES,
    NO_SHAPE_COLOR,
    SPRING_COLOR,
    STRING_COLOR,
    Visual,
    thin_out,
)
from contactvi.records.codes import GuardKind
from contactvi.records.pair_colors import pair_colors
from contactvi.scene.camera import Camera, camera_of, check_followed
from contactvi.scene.scene import Scene
from contactvi.status import Status
from contactvi.version import version

Array = NDArray[np.float64]
_LINES = {SPRING_COLOR: "green: springs", STRING_COLOR: "dark: strings and rods",
          NO_SHAPE_COLOR: "grey: links of models without shapes"}  # fmt: skip
_SCRIPTS = ("data", "stage", "orbit", "signs", "labels", "player", "panels", "main")


class Drawn(Protocol):
    """What is drawn, apart from where it is."""

    @property
    def scene(self) -> Scene: ...

    @property
    def visuals(self) -> list[Visual]: ...


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
    camera: Any = None,
    force_scale: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the page that plays `run`; return its path.

    Args:
        path: file to write, whole or not at all.
        fps: frames per second of simulated time, > 0; impacts get a frame of their own. Long runs get fewer.
        title: heading and name of the page.
        play: start playing when the page is opened.
        forces: show the forces of persistent contacts as arrows, where the run has recorded some.
        camera: "auto" (the open side), "front", "side", "top", {"eye": [x, y, z], "target": [x, y, z]} [m, world
            frame] or {"follow": "name of a body"}; None: the scene's, else "auto".
        force_scale: newtons whose arrow is a metre long [N/m], so that arrows of two runs are comparable; none is
            then cut. None: what suits the forces of the run.
        overwrite: whether a file of this name is replaced.

    Raises:
        OverwriteError: there is such a file, without `overwrite`.
        InputError: for a camera, title, flag or rate that is not usable, and a path that cannot be written.
    """
    check_free(path, overwrite)
    text = make_html(run, fps=fps, title=title, play=play, forces=forces, camera=camera, force_scale=force_scale)
    return write_atomic(path, lambda file: file.write(text.encode("utf-8")), overwrite)


def make_html(run: Run, *, script: str = "", **options: Any) -> str:
    """Return the text of the page; options as in `page_data`. script: JavaScript of the caller that runs first."""
    return fill_page(page_data(run, **options), script=script)


def page_data(
    run: Run,
    *,
    fps: float = 60.0,
    title: str = "",
    play: bool = True,
    forces: bool = True,
    camera: Any = None,
    force_scale: float | None = None,
    moment: float | None = None,
    triangles: int = MAX_TRIANGLES,
) -> dict[str, Any]:
    """Return what the page of a run shows; arguments and errors as those of `write_html`.

    Args:
        moment: time of the run [s] that is shown alone, to which the picture fits; None: all of it.
        triangles: how many the meshes have in all, about, at most.
    """
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
    scale = None if force_scale is None else positive("force_scale", force_scale, "newtons per metre of the arrows")
    chosen = chosen_camera(run, camera)
    title = title or title_of(run.scene)
    moment = None if moment is None else moment - float(run.t[0])
    shapes = thin_out(run.visuals, triangles)
    data = _data(run, shapes, frames_of(run, float(fps)), forces, chosen, moment, scale)
    return data | {"title": title, "play": play}


def chosen_camera(run: Run, camera: Any) -> Camera:
    """Return the camera that is asked for, else that of the scene; InputError for a bad one."""
    chosen = camera_of(camera if camera is not None else run.scene.camera or "auto")
    check_followed(chosen, bodies_of(run))
    return chosen


def fill_page(data: dict[str, Any], *, script: str = "", further: tuple[str, ...] = ()) -> str:
    """Return the page that shows `data`.

    Args:
        script: JavaScript of the caller that runs first.
        further: names of scripts of the folder web that the player takes beside its own.
    """
    player = "\n".join(f'<script class="player">\n{text}\n</script>' for text in _player(further))
    return _filled(data, script, player)


def carrying_page(data: dict[str, Any]) -> str:
    """Return the page of a cell of a notebook from which the pages of other cells take the player."""
    return fill_page(data, script=_web("carry.js").replace("@KEY@", _player_key()))


def taking_page(data: dict[str, Any]) -> str:
    """Return the page of a cell of a notebook that takes the player from another one, and is small."""
    return _filled(data, "", f"<script>\n{_web('take.js').replace('@KEY@', _player_key())}</script>")


def _filled(data: dict[str, Any], script: str, player: str) -> str:
    parts = {
        "@TITLE@": html.escape(data["title"]),
        "@RUN@": _escaped(data),
        "@STYLE@": _web("style.css"),
        "@PLAYER@": player,
        "@SCRIPT@": script,
    }
    return re.sub("|".join(parts), lambda found: parts[found[0]], _web("page.html"))  # once: what is put in stays


def _player(further: tuple[str, ...] = ()) -> tuple[str, str]:
    """Return the scripts of a page: three.js and the player."""
    names = (*_SCRIPTS[:-1], *further, _SCRIPTS[-1])
    return _three(), "\n".join(_web(f"{name}.js") for name in names)


@functools.lru_cache(maxsize=1)
def _player_key() -> str:
    """Return the name of the player in the page of a notebook, another one for each version of it."""
    return "contactvi_player_" + hashlib.sha256("".join(_player()).encode()).hexdigest()[:16]


def bodies_of(run: Drawn) -> dict[str, int]:
    """Return the names by which a camera finds a body that is drawn: of joints, links and shapes -> joint."""
    model = run.scene.model
    names = {visual.name: visual.joint for visual in run.visuals if visual.shape not in ("line", "halfspace")}
    drawn = set(names.values())
    names |= {name: k for k, name in enumerate(model.names) if k}
    names |= {frame.name: int(frame.parentJoint) for frame in model.frames if frame.type == pin.FrameType.BODY}
    return {name: joint for name, joint in names.items() if joint in drawn}


def _data(
    run: Run,
    visuals: list[Visual],
    frames: Frames,
    forces: bool,
    camera: Camera,
    moment: float | None,
    force_scale: float | None,
) -> dict[str, Any]:
    """Return all that the page shows; moment [s] from the start as of `fit`, force_scale [N/m]."""
    touches = Touches.of(run.contacts, float(run.t[0]))
    view = fit(run.visuals, frames, trees_of(run.scene.model), moment, touches)
    joints = {joint: k for k, joint in enumerate(frames.poses)}
    contacts = contact_frames(run, run.t[0] + frames.times, view.size) if forces else None
    colors = pair_colors(run.events, run.contacts)
    found = happenings(run)
    if moment is not None and forces:
        view = view.around(arrow_tips(contacts, found, float(run.t[0]), moment, frames, view.size, force_scale))
    events = event_data(found, float(run.t[0]), colors)
    return {
        "duration": float(frames.times[-1]),
        "times": packed(frames.times, "f8"),
        "bodies": [_body(run, joint, poses) for joint, poses in frames.poses.items()],
        "shapes": [shape_data(visual, k, joints) for k, visual in enumerate(visuals)],
        "contacts": None if contacts is None else _contacts(contacts, run, colors),
        "force_scale": force_scale,
        "events": events,
        "facts": _facts(run, float(frames.times[-1]), events["left_out"]),
        "view": view_data(view),
        "camera": camera_data(run, camera, joints),
    }


def body_name(model: pin.Model, joint: int) -> str:
    """Return the name that the page gives to a body: its link's, else its joint's."""
    link = next((f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == joint), None)
    return "world" if joint == 0 else link or str(model.names[joint])


def _body(run: Run, joint: int, poses: Poses) -> dict[str, Any]:
    return {
        "name": body_name(run.scene.model, joint),
        "moves": poses.moves,
        "fixed": joint == 0,
        "position": packed(poses.position, "f4"),
        "quaternion": packed(poses.quaternion, "f4"),
    }


def _contacts(found: ContactFrames, run: Run, colors: dict[tuple[str, str], str]) -> dict[str, Any]:
    present, place = np.unique(found.pair, return_inverse=True)
    labels = [run.events.label(int(GuardKind.CONTACT), int(pair)) for pair in present]
    pairs = [label for label in colors if label in set(labels)]  # the strongest first
    number = np.array([pairs.index(label) for label in labels])
    return {
        "times": packed(found.times - float(run.t[0]), "f8"),
        "first": packed(found.first, "u4"),
        "point": packed(found.point, "f4"),
        "force": packed(found.force, "f4"),
        "mode": packed(found.mode, "u1"),
        "pair": packed(number[place.reshape(-1)], "u2"),
        "pairs": [{"name": " | ".join(name), "color": colors[name]} for name in pairs],
        "next": packed(found.next, "i4"),
        "full": found.full,
    }


def event_data(found: HappeningList, start: float, colors: Mapping[tuple[str, str], str]) -> dict[str, Any]:
    """Return impacts and changes of contacts for the page, with times [s] from `start` on, and colours of pairs."""
    return {
        "kinds": list(KINDS),
        "names": [list(pair) for pair in found.names],
        "colors": [colors.get(pair) for pair in found.names],
        "time": packed(found.time - start, "f8"),
        "kind": packed(found.kind, "u1"),
        "name": packed(found.name, "u2"),
        "count": packed(np.minimum(found.count, 65_535), "u2"),
        "impulse": packed(found.impulse, "f4"),
        "before": packed(found.before, "f4"),
        "after": packed(found.after, "f4"),
        "point": packed(found.point, "f4"),
        "direction": packed(found.direction, "f4"),
        "drawn": packed(found.drawn, "u1"),
        "left_out": found.left_out,
    }


def _facts(run: Run, duration: float, left_out: int) -> list[dict[str, Any]]:
    """Return what is said about the run; the first line is always seen."""
    texts = [
        f"{duration:.6g} s simulated, {len(run.events)} {'impact' if len(run.events) == 1 else 'impacts'}",
        run.stepping,
        f"impact map {run.events.method.upper()}, contactvi {version()}",
    ]
    texts += line_words(run.visuals)
    if left_out:
        texts.append(f"{left_out} weaker impacts and changes of contacts are not listed")
    facts = [{"text": text, "bad": False} for text in texts]
    if not run.status.ok:
        facts.insert(1, {"text": str(run.status), "bad": True})
    return facts


def line_words(visuals: list[Visual]) -> list[str]:
    """Return what the colours of lines mean, where there are lines."""
    colors = {visual.color for visual in visuals if visual.shape == "line"}
    shown = [words for color, words in _LINES.items() if color in colors]
    return [f"lines, {', '.join(shown)}"] if shown else []


def view_data(view: View) -> dict[str, Any]:
    return {
        "center": view.center.tolist(),
        "radius": view.radius,
        "size": view.size,
        "arrow": ARROW_LENGTH * view.size,
        "longest": LONGEST,
        "afterglow": AFTERGLOW,
        "direction": view.direction.tolist(),
        "outline": packed(view.outline, "f8"),
    }


def camera_data(run: Drawn, camera: Camera, places: dict[int, int]) -> dict[str, Any]:
    """Return the camera for the page: a followed body is a place in its list of bodies."""
    if camera.follow is None:
        return {"preset": camera.preset, "eye": camera.eye, "target": camera.target}
    return {"follow": places[bodies_of(run)[camera.follow]]}


def title_of(scene: Scene) -> str:
    """Return the names of what is in the scene, the first few of them."""
    names = [part.name for part in scene.parts]
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")


@functools.cache
def _web(name: str) -> str:
    return importlib.resources.files("contactvi.playback").joinpath("web", name).read_text(encoding="utf-8")


@functools.lru_cache(maxsize=1)
def _three() -> str:
    """Return three.js, as the static pages of meshcat hold it."""
    found = importlib.util.find_spec("meshcat")  # the package itself is not loaded: it starts a web server's library
    assert found is not None
    assert found.origin is not None
    return (Path(found.origin).parent / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


def _escaped(data: Any) -> str:
    """Return data as JSON that cannot end a script element; numbers that are not finite are refused."""
    return json.dumps(data, allow_nan=False).replace("<", "\\u003c")
