"""The live view: a simulator shown in the browser while it runs, in the page of the playback."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.inputs import flag, short, words
from contactvi.playback.animation import Frames, Poses, is_free
from contactvi.playback.arrays import packed
from contactvi.playback.event_list import KINDS
from contactvi.playback.framing import fit
from contactvi.playback.live_frames import FrameWriter, Stepped
from contactvi.playback.live_server import FrameServer
from contactvi.playback.open_side import trees_of
from contactvi.playback.page import bodies_of, body_name, camera_data, fill_page, line_words, title_of, view_data
from contactvi.playback.scene_visuals import from_scene
from contactvi.playback.shapes import shape_data
from contactvi.playback.touches import Touches
from contactvi.playback.visuals import Visual
from contactvi.scene.camera import camera_of, check_followed
from contactvi.scene.scene import Scene
from contactvi.version import version

Array = NDArray[np.float64]

PERIOD = 1.0 / 60.0  # [s] of wall time between two frames, at least
_LATE = 0.1  # [s] a loop that is later than this does not catch up
_STEEPEST = 0.5  # a halfspace whose normal rises more is ground, on which things fall


class LiveView:
    """A simulator that is shown at `url` while it runs; a context manager, which closes it.

    The page is shown what the simulator is at each `sync`, so nothing is seen of a simulator that is not synced.

    Args:
        realtime: True, so that `sync` holds simulated time back to wall time, or a number of simulated seconds per
            second.
    """

    def __init__(
        self,
        sim: Stepped,
        *,
        realtime: bool | float = False,
        title: str = "",
        forces: bool = True,
        camera: Any = None,
    ) -> None:
        self._pace = _pace(realtime)
        page = _Page(sim, words("title", title), flag("forces", forces), camera)
        self._sim, self._writer = sim, page.writer
        self._server = FrameServer(page.text)
        self._closed, self._due = False, 0.0
        self.url = self._server.url

    def sync(self) -> None:
        """Show the simulator as it is now, where a frame is due: 60 times a second of wall time at most.

        With `realtime`, sleep until simulated time is not ahead of wall time.
        """
        now = time.perf_counter()
        if now >= self._due and not self._closed:
            self._due = now + PERIOD
            if self._server.pages:
                self._server.publish(*self._writer.write())
            else:
                self._writer.skip()
        if self._pace is not None:
            self._pace.keep(self._sim.t)

    @property
    def is_open(self) -> bool:
        """Whether to go on: a page is open, or none was so far; False after `close`.

        A page that is loaded again counts as open meanwhile, so that a closed one is noticed after two seconds.
        """
        return not self._closed and self._server.watched

    def wait_for_page(self, timeout: float = 10.0) -> bool:
        """Wait until a page is open, at most `timeout` [s]; return whether one is."""
        return self._server.wait_for_page(timeout)

    def close(self) -> None:
        """Show the last state and stop serving. An open page keeps the frames that it has."""
        if self._closed:
            return
        try:
            if self._server.pages:
                self._server.publish(*self._writer.write())
        finally:
            self._stop()

    def _stop(self) -> None:
        if not self._closed:
            self._closed = True
            self._server.close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._stop()  # the simulator may have no state to show

    def __repr__(self) -> str:
        return f"<LiveView at {self.url}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" style="width: 100%; height: 480px; border: none"></iframe>'


class _Pace:
    """Holds simulated time back to wall time times a factor."""

    def __init__(self, factor: float) -> None:
        self._factor = factor
        self._start: tuple[float, float] | None = None  # wall and simulated time [s]
        self._last = 0.0

    def keep(self, t: float) -> None:
        """Sleep while t [s] is ahead. From where the loop is late, or goes back in time, it is measured anew."""
        now = time.perf_counter()
        if self._start is None or t < self._last:
            self._start = now, t
        self._last = t
        ahead = (t - self._start[1]) / self._factor - (now - self._start[0])
        if ahead > 0.0:
            time.sleep(ahead)
        elif ahead < -_LATE:
            self._start = now, t


def _pace(realtime: bool | float) -> _Pace | None:
    """Return the pace of realtime=False, True, or a number of simulated seconds per second."""
    if isinstance(realtime, (bool, np.bool_)):
        return _Pace(1.0) if realtime else None
    if not isinstance(realtime, (int, float, np.integer, np.floating)) or not 0.0 < realtime < np.inf:
        raise InputError(
            "realtime is not usable", name="realtime", expected="True, False or simulated seconds per second, > 0",
            got=short(realtime), remedy="Use realtime=True, or realtime=0.5 for half the speed",
        )  # fmt: skip
    return _Pace(float(realtime))


class _Page:
    """The page of a simulator that has started, and the writer of its frames."""

    def __init__(self, sim: Stepped, title: str, forces: bool, camera: Any) -> None:
        self.scene: Scene = sim.scene
        self.visuals: list[Visual] = from_scene(self.scene)
        self._joints = sorted({joint for shown in self.visuals for joint in shown.joints})
        chosen = camera_of(camera if camera is not None else self.scene.camera or "auto")
        check_followed(chosen, bodies_of(self))
        self.writer = FrameWriter(sim, self._joints, forces)
        places = {joint: k for k, joint in enumerate(self._joints)}
        model, frames = self.scene.model, self._expected(sim.q)
        trees = trees_of(model)
        view = fit(self.visuals, frames, trees, touches=Touches.expected(self.scene, sim.q, trees))
        facts = ["live", *line_words(self.visuals), f"contactvi {version()}"]
        data = {
            "title": title or title_of(self.scene),
            "live": {"size": view.size, "kinds": list(KINDS)},
            "first": {"t": sim.t, "pose": packed(self.writer.poses.at(sim.q), "f4")},
            "bodies": [
                {"name": body_name(model, k), "moves": k != 0, "fixed": k == 0} for k in self._joints
            ],
            "shapes": [shape_data(visual, k, places) for k, visual in enumerate(self.visuals)],
            "facts": [{"text": text, "bad": False} for text in facts],
            "view": view_data(view),
            "camera": camera_data(self, chosen, places),
        }  # fmt: skip
        self.text = fill_page(data, further=("live",))

    def _expected(self, q: Array) -> Frames:
        """Return what is to be in the picture: the start, and bodies that are free fallen to the ground below."""
        model = self.scene.model
        start = self.writer.poses.at(q)
        roots = trees_of(model)[self._joints]
        fallen = np.zeros((len(start), 3))
        for root in np.unique(roots).tolist():
            if is_free(model, root):
                own = roots == root
                fallen[own] = self._fall(start[own, :3])
        poses = {
            joint: Poses(np.array([pose[:3], pose[:3] + way]), np.array([pose[3:], pose[3:]]))
            for joint, pose, way in zip(self._joints, start, fallen, strict=True)
        }
        return Frames(np.array([0.0, 1.0]), poses)

    def _fall(self, points: Array) -> Array:
        """Return the way [m] on which the lowest of some points (n, 3) comes to the first ground below."""
        ways = [np.zeros(3)]
        for shown in self.visuals:
            if shown.shape != "halfspace" or shown.joint != 0:
                continue
            normal = shown.placement[:3, :3] @ np.array(shown.sizes[:3])
            height = float(np.min((points - shown.placement[:3, 3]) @ normal)) - shown.sizes[3]
            if normal[2] > _STEEPEST and height > 0.0:
                ways.append(-height * normal)
        return min(ways[1:], key=lambda way: float(np.linalg.norm(way)), default=ways[0])
