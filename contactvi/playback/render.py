"""Pictures and films of a run for papers and pages: its playback drawn by a headless browser, as PNG, GIF or MP4."""

from __future__ import annotations

import importlib.resources
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from contactvi.errors import ContactviError, InputError
from contactvi.files import check_free, write_atomic
from contactvi.inputs import flag, positive, real, short
from contactvi.playback.browser import find_browser, pictures
from contactvi.playback.page import Run, chosen_camera, make_html
from contactvi.playback.picture_size import picture_size
from contactvi.playback.visuals import MAX_TRIANGLES
from contactvi.records.pair_colors import PAIR_COLORS

if TYPE_CHECKING:
    from PIL import Image

FORMATS = (".gif", ".mp4", ".png")
_FILMS = (".avi", ".mkv", ".mov", ".webm", ".apng", ".m4v", "")  # what may be meant by other endings
MAX_FRAMES = 5000
_COLORS = 255  # of a GIF
_SAMPLES = 6  # pictures whose colours make the palette of a GIF
_PIXELS = 25  # for each triangle of a film, at least: smaller ones are not seen and take most of the time
_SIGNS = ("#e0431f", "#0072b2", "#e69f00", "#009e73", *PAIR_COLORS)  # small, and not to be lost


def render(
    run: Run,
    path: str | os.PathLike[str],
    *,
    camera: Any = None,
    size: Any = None,
    at: float | None = None,
    fps: float = 25.0,
    speed: float = 1.0,
    start: float | None = None,
    end: float | None = None,
    forces: bool = True,
    labels: bool = False,
    ground: bool | None = None,
    force_scale: float | None = None,
    transparent: bool = False,
    dpi: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Draw a run into a file; return its path. Needs Chromium or Chrome, an MP4 ffmpeg too.

    Args:
        path: ends with .gif, .mp4 or .png (the picture of one time).
        camera: "auto", "front", ... as of `contactvi.playback.page.write_html`; a .png fits to what there is
            at its time, a film to all of the run.
        size: width and height [pixels], whole numbers or "800x600"; even ones for an MP4. None: 640x480 for a GIF,
            else 800x600.
        at: time of a .png [s].
        fps: frames per second of a film; a GIF shows frames for whole hundredths of a second.
        speed: of a film, simulated seconds per second.
        start, end: times between which a film goes [s], by default those of the run.
        forces: show the forces of contacts, in the colours of their pairs, and the impulses of the last quarter of a
            second, in red, both with a scale. What bodies hide of an arrow is faint. In a .png impulses that would
            lie over each other are beside each other, with lines to their points.
        labels: write the names of the bodies; none covers another one. In a .png several impulses have numbers, in
            the order of time.
        ground: draw ground and walls, which are halfspaces; False leaves them out. None: they are drawn, but in a
            transparent .png only the shadows on them.
        force_scale: newtons whose arrow is a metre long in the scene [N/m], which the scale says: pictures with the
            same one, and the same camera, are comparable. None: what suits the forces of the run.
        transparent: a .png without a background.
        dpi: pixels per inch that a .png says it has, by which programs that set text take its size; it changes no
            pixel.
        overwrite: whether a file of this name is replaced.

    Raises:
        OverwriteError: there is such a file, without `overwrite`.
        InputError: a bad argument, another ending, or more than 5000 frames.
        ContactviError: no browser, no ffmpeg, or one of them failed.
    """
    file = check_free(path, overwrite)
    kind = _kind(file, at)
    usual = (640, 480) if kind == ".gif" else (800, 600)
    width, height = picture_size(usual if size is None else size, even=kind == ".mp4")
    fps, speed = positive("fps", fps, "frames per second"), positive("speed", speed, "simulated seconds per second")
    first, last = float(run.t[0]), float(run.t[-1])
    if kind == ".png":
        times = np.array([real("at", at, first, last, expected=f"a time of the run, {first:g} to {last:g} s")])
    else:
        times = _times(first, last, start, end, fps, speed)
    chosen_camera(run, camera)  # what is wrong with it is told before a browser is looked for
    forces, labels, transparent = flag("forces", forces), flag("labels", labels), flag("transparent", transparent)
    drawn_ground = _ground(ground, transparent)
    scale = None if force_scale is None else positive("force_scale", force_scale, "newtons per metre of the arrows")
    if kind != ".png" and (transparent or dpi is not None):
        raise InputError(
            "Option of a picture", name="transparent" if transparent else "dpi", expected="a .png for it",
            got=short(file.name), remedy="Write a .png, or leave it out",
        )  # fmt: skip
    resolution = {} if dpi is None else {"dpi": (positive("dpi", dpi, "pixels per inch"),) * 2}
    find_browser()
    if kind == ".mp4":
        _find_ffmpeg()
    moment = float(times[0]) if kind == ".png" else None
    shown = {"forces": forces, "labels": labels, "transparent": transparent, "ground": drawn_ground}
    frames = _Frames(run, camera, shown, width, height, speed, moment, scale)
    if kind == ".png":
        (picture,) = frames.draw(times)
        return write_atomic(file, lambda out: picture.save(out, "PNG", optimize=True, **resolution), overwrite)
    if kind == ".gif":
        return write_atomic(file, lambda out: _write_gif(out, frames, times, fps), overwrite)
    return write_atomic(file, lambda out: _write_mp4(out, frames, times, fps), overwrite)


class _Frames:
    """The pictures of a run at given times."""

    def __init__(
        self,
        run: Run,
        camera: Any,
        shown: dict[str, Any],
        width: int,
        height: int,
        speed: float,
        moment: float | None,
        force_scale: float | None,
    ) -> None:
        self.run, self.camera, self.shown, self.moment, self.force_scale = run, camera, shown, moment, force_scale
        self.width, self.height, self.speed = width, height, speed

    def draw(self, times: np.ndarray) -> Iterator[Image.Image]:
        """Yield the pictures. That of one time is drawn at twice the size and scaled down."""
        from PIL import Image

        job = {
            "times": (times - float(self.run.t[0])).tolist(),
            "width": self.width, "height": self.height, "speed": self.speed, "ratio": 1 if self.moment is None else 2,
            **self.shown,
        }  # fmt: skip
        folder = importlib.resources.files("contactvi.playback").joinpath("web")
        web = [folder.joinpath(name).read_text(encoding="utf-8") for name in ("smooth.js", "render.js")]
        script = "\n".join([f"const job = {json.dumps(job, allow_nan=False)};", *web])
        page = make_html(
            self.run, fps=200.0, play=False, forces=self.shown["forces"], camera=self.camera, script=script,
            moment=self.moment, force_scale=self.force_scale,
            triangles=MAX_TRIANGLES if self.moment is not None else max(12_000, self.width * self.height // _PIXELS),
        )  # fmt: skip
        size = self.width, self.height
        picture = None
        for data in pictures(page, len(times)):
            if data or picture is None:  # nothing is sent where it is the one before
                drawn = Image.frombytes("RGBA", size, data)
                picture = drawn if self.shown["transparent"] else drawn.convert("RGB")
            yield picture


def _kind(file: Path, at: float | None) -> str:
    kind = file.suffix.lower()
    if kind not in FORMATS:
        raise InputError(
            "Format of a picture", name="path", expected="a name ending in " + ", ".join(FORMATS),
            got=short(file.name), remedy=f"Name it {file.stem}{'.gif' if at is None and kind in _FILMS else '.png'}",
        )  # fmt: skip
    if (at is None) == (kind == ".png"):
        remedy = "Use at=0.5, or another time in seconds" if at is None else "Leave at out, or write a .png"
        raise InputError(
            "Time of a picture", name="at", expected="at for a .png, and for nothing else",
            got=f"at={at} for {kind}", remedy=remedy,
        )  # fmt: skip
    return kind


def _ground(ground: bool | None, transparent: bool) -> str:
    """Return what is drawn of halfspaces: "drawn", "shadows" or "none"."""
    if ground is None:
        return "shadows" if transparent else "drawn"
    return "drawn" if flag("ground", ground) else "none"


def _times(first: float, last: float, start: Any, end: Any, fps: float, speed: float) -> np.ndarray:
    """Return the times of the frames of a film [s]."""
    expected = f"a time of the run, {first:g} to {last:g} s"
    begin = first if start is None else real("start", start, first, last, expected=expected)
    stop = last if end is None else real("end", end, begin, last, expected=f"a time from start to {last:g} s")
    number = int(min((stop - begin) / speed * fps * (1.0 + 1e-9), 1e9)) + 1
    if number > MAX_FRAMES:
        raise InputError(
            "A film of so many frames", name="fps", expected=f"at most {MAX_FRAMES} frames", got=f"{number}",
            remedy="Raise speed, lower fps, or give start and end",
        )  # fmt: skip
    return np.asarray(np.minimum(begin + np.arange(number) * (speed / fps), stop))


def _write_gif(out: IO[bytes], frames: _Frames, times: np.ndarray, fps: float) -> None:
    """Write a film with one palette for all frames, so that what stands still does not flicker and takes no space."""
    from PIL import Image

    rows = np.unique(np.linspace(0, len(times) - 1, _SAMPLES).astype(int)).tolist()
    others = np.delete(times, rows)
    drawn = frames.draw(np.concatenate([times[rows], others]))
    chosen = {row: next(drawn) for row in rows}
    palette = _sheet([frame.reduce(2) for frame in chosen.values()]).quantize(_COLORS, kmeans=1)
    shown = (chosen.pop(row) if row in chosen else next(drawn) for row in range(len(times)))
    before: Image.Image | None = None
    quantized: list[Image.Image] = []
    for picture in shown:
        same = picture is before  # then Pillow shows the one before for longer
        quantized.append(
            quantized[-1] if same else picture.quantize(_COLORS, palette=palette, dither=Image.Dither.NONE)
        )
        before = picture
    first, *later = quantized
    ends = np.rint(np.arange(len(times) + 1) * 100.0 / fps).astype(int)  # [1/100 s]
    durations = np.maximum(10 * np.diff(ends), 20)  # shorter ones are shown slowly by most browsers
    durations[-1] += 600  # [ms] before it begins again
    first.save(
        out, "GIF", save_all=True, append_images=later, duration=durations.tolist(), loop=0, optimize=True
    )  # fmt: skip


def _sheet(frames: list[Image.Image]) -> Image.Image:
    """Return frames below each other, with a block of each colour of signs: they are too small to count alone."""
    from PIL import Image

    width, height = frames[0].size
    sheet = Image.new("RGB", (width, height * (len(frames) + 1)), (255, 255, 255))
    for k, frame in enumerate(frames):
        sheet.paste(frame, (0, height * k))
    step = max(1, height // (2 * len(_SIGNS)))
    for k, color in enumerate(_SIGNS):
        sheet.paste(color, (0, height * len(frames) + step * k, width // 2, height * len(frames) + step * (k + 1)))
    return sheet


def _find_ffmpeg() -> str:
    found = shutil.which("ffmpeg")
    if found is None:
        raise ContactviError(
            "An MP4 is written by ffmpeg, and it was not found", expected="ffmpeg in PATH", got="none",
            remedy="Install it (Debian: apt install ffmpeg), or write a .gif",
        )  # fmt: skip
    return found


def _write_mp4(out: IO[bytes], frames: _Frames, times: np.ndarray, fps: float) -> None:
    with tempfile.TemporaryDirectory(prefix="contactvi-") as folder:
        film = Path(folder) / "film.mp4"
        with (Path(folder) / "log").open("w+b") as log:
            process = subprocess.Popen(
                [_find_ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24",
                 "-s", f"{frames.width}x{frames.height}", "-r", f"{fps:.6g}", "-i", "-", "-an", "-c:v", "libx264",
                 "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(film)],
                stdin=subprocess.PIPE, stdout=log, stderr=log,
            )  # fmt: skip
            assert process.stdin is not None
            try:
                for frame in frames.draw(times):
                    process.stdin.write(frame.tobytes())
                process.stdin.close()
            except BrokenPipeError:
                pass  # it has ended, and says why below
            finally:
                if not process.stdin.closed:
                    process.kill()
                code = process.wait()
            log.seek(0)
            said = log.read().decode("utf-8", errors="replace").strip().splitlines()
        if code != 0 or not film.exists():
            raise ContactviError(
                "ffmpeg wrote no film", expected="an MP4 with H.264", got=said[-1] if said else f"exit code {code}",
                remedy="Install an ffmpeg with libx264, or write a .gif",
            )  # fmt: skip
        with film.open("rb") as source:
            shutil.copyfileobj(source, out)
