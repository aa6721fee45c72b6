"""The live view without a browser: what a page is sent, when, and what the loop has of it."""

from __future__ import annotations

import base64
import http.client
import json
import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.errors import InputError, SimulationError
from contactvi.playback.live_server import PENDING, RELOAD, FrameServer
from contactvi.playback.viewer import LiveView
from helpers.playback_data import run_data
from helpers.run_scenes import GRAVITY, HEIGHT, ball_file, ball_scene, hand_scene

SINGLE = float(np.finfo(np.float32).eps)
NUMBERS = {"f4": "<f4", "f8": "<f8", "u1": "u1", "u2": "<u2", "u4": "<u4", "i4": "<i4"}
DT = 1e-3


def unpacked(entry: dict) -> np.ndarray:
    return np.frombuffer(base64.b64decode(entry["data"]), NUMBERS[entry["type"]])


class Page:
    """A page that reads its frames."""

    def __init__(self, url: str, reads: bool = True) -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", int(url.rstrip("/").rsplit(":", 1)[1]), timeout=20)
        self._connection.connect()
        self._socket = self._connection.sock
        self._connection.request("GET", "/frames")
        self._response = self._connection.getresponse()
        assert self._response.headers["Content-Type"] == "text/event-stream"
        self.messages: list[dict] = []
        self.ended = False
        self._reader = threading.Thread(target=self.read, daemon=True)
        if reads:
            self._reader.start()

    def read(self) -> None:
        kind = b""
        for line in self._response:
            if line.startswith(b"event: "):
                kind = line[7:].strip()
            elif line.startswith(b"data: ") and kind == b"end":
                self.ended = True
            elif line.startswith(b"data: "):
                self.messages.append(json.loads(line[6:]))

    def finish(self) -> None:
        """Wait for the last frame."""
        self._reader.join(20)
        assert not self._reader.is_alive()

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self.finish()

    @property
    def frames(self) -> list[dict]:
        return [message["frame"] for message in self.messages]

    def event_times(self) -> list[float]:
        return [t for message in self.messages for part in message["happened"] for t in unpacked(part["time"])]


def simulator(scene: cvi.Scene, q0=None, v0=None, **options) -> cvi.Simulator:
    sim = cvi.Simulator(scene, **({"dt": DT} | options))
    sim.reset(q0, v0)
    return sim


def show(sim: cvi.Simulator, **options) -> LiveView:
    return cvi.view(sim, open_browser=False, **options)


def wait_until(holds, seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def sync_now(live: LiveView, page: Page) -> dict:
    """Show the simulator when the next frame is due; return the frame, not one that was still under way."""
    before = len(page.messages)
    while len(page.messages) == before or page.frames[-1]["t"] != live._sim.t:
        live.sync()
        time.sleep(0.002)
    return page.frames[-1]


def page_data(live: LiveView) -> dict:
    connection = http.client.HTTPConnection("127.0.0.1", int(live.url.rstrip("/").rsplit(":", 1)[1]), timeout=20)
    connection.request("GET", "/")
    return run_data(connection.getresponse().read().decode())


@pytest.fixture(scope="module")
def hand() -> tuple[cvi.Scene, np.ndarray]:
    return hand_scene()


@pytest.fixture
def server() -> Iterator[FrameServer]:
    server = FrameServer("<html></html>")
    yield server
    server.close()


# -- frames -----------------------------------------------------------------------------------------------------------


def test_poses_are_those_of_pinocchio(hand):
    """Of linked bodies and of a free one."""
    scene, q0 = hand
    v0 = np.zeros(scene.nv)
    v0[-3:] = (1.0, 2.0, 3.0)
    sim = simulator(scene, q0, v0)
    with show(sim) as live:
        names = [body["name"] for body in page_data(live)["bodies"]]
        page = Page(live.url)
        for _ in range(3):
            sim.run(40)
            frame = sync_now(live, page)
            assert frame["t"] == sim.t
            poses = unpacked(frame["pose"]).reshape(-1, 7)
            assert len(poses) == len(names) == scene.model.njoints
            data = scene.model.createData()
            pin.forwardKinematics(scene.model, data, sim.q)
            for joint, pose in enumerate(poses):
                placement = data.oMi[joint]
                turn = pin.Quaternion(pose[3:].astype(float)).normalized().matrix()
                assert pose[:3] == pytest.approx(placement.translation, abs=4 * SINGLE)
                assert turn == pytest.approx(placement.rotation, abs=8 * SINGLE)


def test_a_free_joint_with_a_placement():
    """The placement of a free joint turns and moves its body, as Pinocchio has it."""
    model = pin.Model()
    placement = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 1.1), np.array([1.0, -2.0, 0.5]))
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), placement, "free")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    geometries = pin.GeometryModel()
    geometries.addGeometryObject(pin.GeometryObject("body", joint, pin.SE3.Identity(), coal.Sphere(0.1)))
    scene = cvi.Scene.from_pinocchio(model, geometries)
    sim = simulator(scene, None, [0.4, 0.1, 0.2, 1.0, -2.0, 0.5])
    with show(sim) as live:
        page = Page(live.url)
        sim.run(100)
        pose = unpacked(sync_now(live, page)["pose"]).reshape(-1, 7)[-1].astype(float)
    data = model.createData()
    pin.forwardKinematics(model, data, sim.q)
    assert pose[:3] == pytest.approx(data.oMi[joint].translation, abs=8 * SINGLE)
    assert pin.Quaternion(pose[3:]).normalized().matrix() == pytest.approx(data.oMi[joint].rotation, abs=8 * SINGLE)


def test_contacts_are_those_of_the_last_step():
    """A box that stands still: the forces on it carry its weight, where the simulator says that it touches."""
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.1, 0.1), mass=2.0, placement=(0.0, 0.0, 0.05))
    scene.add_halfspace()
    scene.set_contact(friction=0.5)
    sim = simulator(scene)
    with show(sim) as live:
        page = Page(live.url)
        sim.run(200)
        contacts = sync_now(live, page)["contacts"]
        bodies = page_data(live)["bodies"]
    vectors, numbers = unpacked(contacts["vectors"]).reshape(-1, 6), unpacked(contacts["numbers"]).reshape(-1, 5)
    shown = sorted(vectors[:, :3].tolist())
    assert shown == [pytest.approx(c, abs=SINGLE) for c in sorted(c.position.tolist() for c in sim.contacts)]
    assert vectors[:, 3:].sum(axis=0) == pytest.approx(
        [0.0, 0.0, 2.0 * GRAVITY], abs=1e-5
    )  # of rest, and of single precision
    carriers = {bodies[k]["name"] for k in numbers[:, 3:].ravel()}
    assert carriers == {"world", "box"}
    assert not any(frame["bad"] for frame in page.frames)


def test_every_impact_comes_once():
    sim = simulator(ball_scene(restitution=0.7))
    with show(sim) as live:
        page = Page(live.url)
        live.wait_for_page()
        while sim.t < 2.0:
            sim.step()
            live.sync()
    page.finish()
    assert page.ended
    impacts = [t for m in page.messages for p in m["happened"] for t, k in zip(
        unpacked(p["time"]), unpacked(p["kind"]), strict=True) if p["kinds"][k] == "impact"]  # fmt: skip
    assert impacts == sim.events.array("time").tolist()
    assert impacts[0] == pytest.approx(math.sqrt(2 * HEIGHT / GRAVITY), abs=1e-9)
    assert page.frames[-1]["impacts"] == len(impacts) > 2
    assert page.frames[-1]["t"] == sim.t  # the last state is shown, however soon the loop ends


def test_without_a_record():
    """A simulator that keeps nothing shows where its bodies are, and its present contacts."""
    sim = simulator(ball_scene(restitution=0.0), record=False)
    with show(sim) as live:
        page = Page(live.url)
        sim.run(1000)
        frame = sync_now(live, page)
        assert unpacked(frame["pose"]).reshape(-1, 7)[-1, :3] == pytest.approx(sim.q[:3], abs=4 * SINGLE)
        assert len(unpacked(frame["contacts"]["numbers"])) == 5 * len(sim.contacts) == 5


def test_a_reset_starts_anew():
    sim = simulator(ball_scene(restitution=0.7))
    with show(sim) as live:
        page = Page(live.url)
        sim.run(1000)
        first = sync_now(live, page)
        assert len(page.event_times()) > 0
        seen = len(page.event_times())
        sim.reset()
        sim.run(10)
        second = sync_now(live, page)
        assert second["run"] == first["run"] + 1
        assert len(page.event_times()) == seen
        sim.run(490)
        assert sync_now(live, page)["run"] == second["run"]
        assert page.event_times()[seen:] == sim.events.array("time").tolist() != []


def test_a_run_that_ends_early_says_so():
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1, placement=(0, 0, 0.3))
    scene.add_halfspace()
    scene.set_contact(restitution=0.5)
    sim = simulator(scene, zeno="end")
    with show(sim) as live:
        page = Page(live.url)
        sim.run(3000)
        assert not sim.status.ok
        assert sync_now(live, page)["bad"] == str(sim.status)


# -- when -------------------------------------------------------------------------------------------------------------


def test_at_most_sixty_frames_a_second():
    sim = simulator(ball_scene())
    with show(sim) as live:
        page = Page(live.url)
        live.wait_for_page()
        start = time.perf_counter()
        while time.perf_counter() < start + 0.5:
            sim.step()
            live.sync()
        seconds = time.perf_counter() - start
    page.finish()
    # One more at the start, one that the page is given when it comes, and the last state.
    assert 2 <= len(page.messages) <= 60 * seconds + 3


def test_no_work_where_no_frame_is_due_or_nobody_looks(monkeypatch):
    sim = simulator(ball_scene())
    calls = []
    recent = cvi.Simulator.recent
    monkeypatch.setattr(cvi.Simulator, "recent", lambda self, since: calls.append(since) or recent(self, since))
    with show(sim) as live:
        for _ in range(5):
            live.sync()
            time.sleep(0.02)
        assert calls == []  # without a page
        page = Page(live.url)
        sync_now(live, page)
        for _ in range(5):
            start, made = time.perf_counter(), len(calls)
            live.sync()
            for _ in range(100):
                live.sync()
            if time.perf_counter() - start < 1 / 60:
                assert len(calls) - made <= 1


class Clock:
    """A clock that goes on where it is told to and where somebody sleeps: a busy machine does not move it."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.now += seconds


@pytest.mark.parametrize("factor", [True, 1, 2.0, 0.5])
@pytest.mark.parametrize(
    ("pause", "made_up_for"), [(0.0, 0.0), (0.05, 0.05), (0.3, 0.0)], ids=["in time", "a little late", "late"]
)
def test_real_time(monkeypatch, factor, pause, made_up_for):
    """Simulated time is not ahead of wall time; a loop makes up for a short delay and not for a long one."""
    clock = Clock()
    monkeypatch.setattr("contactvi.playback.live.time", clock)
    sim = simulator(ball_scene())
    with show(sim, realtime=factor) as live:
        live.sync()
        clock.now += pause
        live.sync()
        start, t = clock.now, sim.t
        while sim.t < t + 0.2:
            sim.step()
            live.sync()
        assert clock.now - start == pytest.approx((sim.t - t) / factor - made_up_for, abs=1e-9)


def test_real_time_by_the_clock_of_the_machine():
    """Real seconds pass. A machine that is busy can only make it longer."""
    sim = simulator(ball_scene())
    with show(sim, realtime=True) as live:
        start = time.perf_counter()
        live.sync()
        for _ in range(100):
            sim.step()
            live.sync()
        assert time.perf_counter() - start > 0.1 - 1e-4  # what a clock and a sleep round to


# -- pages that are slow, or gone --------------------------------------------------------------------------------------


def test_the_last_frame_wins(server):
    """A page that does not read holds up nobody, and is later sent the newest frame, not all of them."""
    page = Page(server.url, reads=False)
    server.wait_for_page(10)
    padding = "x" * 500_000
    longest = 0.0
    for k in range(200):  # more than the buffers of a connection hold
        start = time.perf_counter()
        server.publish(json.dumps({"number": k, "padding": padding}), f'{{"number": {k}}}')
        longest = max(longest, time.perf_counter() - start)
    assert longest < 1.0  # it waits for nobody: a page that is waited for would never come
    threading.Thread(target=page.read, daemon=True).start()
    wait_until(lambda: page.messages and page.frames[-1]["number"] == 199)
    assert len(page.messages) < 100
    # What happened is no state that a later frame repeats: all of it comes.
    assert [part["number"] for message in page.messages for part in message["happened"]] == list(range(200))


def test_what_waits_for_a_page_is_bounded(server):
    page = Page(server.url, reads=False)
    server.wait_for_page(10)
    server.publish('"' + "x" * 30_000_000 + '"')  # the connection is full from now on
    time.sleep(0.3)
    part = json.dumps({"padding": "x" * 10_000})
    for k in range(2000):
        server.publish(str(k), part)
    threading.Thread(target=page.read, daemon=True).start()
    wait_until(lambda: page.messages and page.frames[-1] == 1999)
    assert sum(len(message["happened"]) for message in page.messages) * len(part) <= 2 * PENDING
    assert len(page.messages[-1]["happened"]) > 0.9 * PENDING / len(part)


def test_a_restart_forgets_what_waits(server):
    page = Page(server.url, reads=False)
    server.wait_for_page(10)
    server.publish('"' + "x" * 30_000_000 + '"')
    time.sleep(0.3)
    server.publish("1", '"old"')
    server.publish("2", '"new"', restart=True)
    threading.Thread(target=page.read, daemon=True).start()
    wait_until(lambda: page.messages and page.frames[-1] == 2)
    assert page.messages[-1]["happened"] == ["new"]


def test_the_loop_ends_when_the_page_is_closed():
    sim = simulator(ball_scene())
    with show(sim) as live:
        assert live.is_open  # nobody was there yet
        page = Page(live.url)
        assert live.wait_for_page()
        sync_now(live, page)
        page.close()
        start = time.monotonic()
        while live.is_open:
            sim.step()
            live.sync()
            assert time.monotonic() < start + 20
        assert time.monotonic() - start >= RELOAD
    assert not live.is_open


def test_a_page_that_is_loaded_again_keeps_the_loop():
    sim = simulator(ball_scene())
    with show(sim) as live:
        page = Page(live.url)
        sync_now(live, page)
        page.close()
        wait_until(lambda: not live.wait_for_page(0))
        assert live.is_open
        again = Page(live.url)
        wait_until(lambda: len(again.messages) > 0)  # at once, without a sync
        assert live.is_open
        assert again.frames[0] == page.frames[-1]


def test_closed_view_goes_on_without_pages():
    sim = simulator(ball_scene())
    live = show(sim)
    live.close()
    live.close()
    sim.step()
    live.sync()
    assert not live.is_open
    with pytest.raises(ConnectionRefusedError):
        page_data(live)


def test_an_error_in_the_loop_comes_through():
    """Also one that leaves the simulator without a state; pages are told that it is over."""
    sim = cvi.Simulator(ball_scene(), dt=DT)
    sim.reset()
    live = show(sim)
    page = Page(live.url)

    def loop() -> None:
        with live:
            sync_now(live, page)
            sim._run = None
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        loop()
    page.finish()
    assert page.ended
    assert not live.is_open


def test_only_this_machine_and_only_its_paths():
    with show(simulator(ball_scene())) as live:
        assert live.url.startswith("http://127.0.0.1:")
        connection = http.client.HTTPConnection("127.0.0.1", int(live.url.rstrip("/").rsplit(":", 1)[1]), timeout=20)
        connection.request("GET", "/etc/passwd")
        assert connection.getresponse().status == 404
        assert live.url in repr(live)
        assert live.url in live._repr_html_()


# -- inputs -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [
    {"realtime": 0}, {"realtime": -1.0}, {"realtime": math.nan}, {"realtime": math.inf}, {"realtime": "fast"},
    {"camera": "back"}, {"camera": {"follow": "bell"}}, {"title": 3}, {"forces": 1},
])  # fmt: skip
def test_wrong_options_are_refused(options):
    with pytest.raises(InputError) as caught:
        show(simulator(ball_scene()), **options)
    assert caught.value.remedy


def test_a_simulator_without_a_state_is_refused():
    with pytest.raises(SimulationError, match="no state"):
        show(cvi.Simulator(ball_scene(), dt=DT))


def test_forces_may_be_left_out():
    sim = simulator(ball_scene(restitution=0.0))
    with show(sim, forces=False) as live:
        page = Page(live.url)
        sim.run(1000)
        assert sync_now(live, page)["contacts"] is None
        assert len(sim.contacts) == 1


# -- the picture ------------------------------------------------------------------------------------------------------


def test_the_picture_reaches_to_the_ground_on_which_free_bodies_fall():
    with show(simulator(ball_scene())) as live:
        view = page_data(live)["view"]
    lowest = unpacked(view["outline"]).reshape(-1, 3)[:, 2].min()
    assert lowest == pytest.approx(-0.1, abs=0.02)  # the middle of the ball comes down to the ground, at most


# -- records ----------------------------------------------------------------------------------------------------------


def test_recent_is_the_end_of_the_record():
    """Whatever the calls that made the steps; the logs of the whole run are the reference."""
    sim = simulator(ball_scene(restitution=0.6))
    for steps in (1, 700, 1, 1, 300, 900, 1, 600):
        sim.run(steps)
    traj = sim.trajectory()
    times = traj.events.array("time")
    assert len(times) > 3
    for since in (-math.inf, 0.0, float(times[0]), float(times[2]), float(times[-1]), sim.t):
        recent = sim.recent(since)
        assert recent.events.array("time").tolist() == times[times > since].tolist()
        changes = traj.contact_changes.array("time")
        assert recent.contact_changes.array("time").tolist() == changes[changes > since].tolist()
    assert [str(c.pair) for c in sim.recent(0.0).contacts] == [str(c.pair) for c in sim.contacts]


# -- the command line -------------------------------------------------------------------------------------------------


def test_run_live(command, tmp_path, monkeypatch):
    """The run lasts as long as it simulates, and its files are those of the run without a view."""
    file = ball_file(tmp_path, restitution=0.7, duration=0.5)
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url, new=0: opened.append(url) or True)
    start = time.perf_counter()
    result = command("run", file, "--live", "--no-browser", "-o", "live", "--no-plot", "--no-html")
    assert result.exit_code == 0, result.stderr
    assert time.perf_counter() - start > 0.5 - 0.01
    assert opened == []
    assert "http://127.0.0.1:" in result.stdout
    assert command("run", file, "-o", "plain", "--no-plot", "--no-html").exit_code == 0
    live, plain = (cvi.Trajectory.load(f"{name}/trajectory.npz") for name in ("live", "plain"))
    np.testing.assert_array_equal(live.q, plain.q)


def test_run_live_chooses_a_step_where_the_run_would(command, tmp_path):
    file = ball_file(tmp_path, duration=0.1)
    result = command("run", file, "--live", "--no-browser", "--dt", "auto", "--no-plot", "--no-html", "-o", "out")
    assert result.exit_code == 0, result.stderr
    assert "dt = 0.001 s" in result.stderr
    options = cvi.Trajectory.load("out/trajectory.npz").options
    assert options == cvi.Options(dt=1e-3, duration=0.1)


def test_run_live_ends_when_the_page_is_closed(command, tmp_path, monkeypatch):
    """The browser of this test opens the page, and closes it after a while."""
    pages: list[Page] = []

    def browse() -> None:
        wait_until(lambda: len(pages[0].messages) > 10)
        pages[0].close()

    def opened(url: str, new: int = 0) -> bool:
        pages.append(Page(url))
        threading.Thread(target=browse).start()
        return True

    monkeypatch.setattr("webbrowser.open", opened)
    result = command("run", ball_file(tmp_path, duration=60.0), "--live", "-o", "out", "--no-plot", "--no-html")
    assert result.exit_code == 0, result.stderr
    assert "The page was closed at t =" in result.stderr
    traj = cvi.Trajectory.load("out/trajectory.npz")
    assert traj.status.ok
    assert pages[0].frames[-1]["t"] < traj.t[-1] < 59.0
    assert pages[0].frames[0]["t"] < 1.0  # the run began when the page was open


def test_ctrl_c_ends_a_live_run_with_its_files(tmp_path):
    """The real program and the real signal."""
    environment = {**os.environ, "PYTHONPATH": str(Path(cvi.__file__).parents[1])}
    environment.pop("PYTHONUNBUFFERED", None)  # the address is printed at once as it is
    arguments = [
        "run",
        ball_file(tmp_path, duration=1e4),
        "--live",
        "--no-browser",
        "-o",
        "out",
        "--no-plot",
        "--no-html",
    ]
    run = subprocess.Popen(
        [sys.executable, "-c", "from contactvi.commands.entry import main; main()", *map(str, arguments)],
        cwd=tmp_path, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        # Children of a shell's background job inherit an ignored SIGINT.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    too_long = threading.Timer(60.0, run.kill)
    too_long.start()
    while "Live view at" not in run.stdout.readline():
        assert run.poll() is None
    time.sleep(0.5)
    run.send_signal(signal.SIGINT)
    _, errors = run.communicate(timeout=30)
    too_long.cancel()
    assert run.returncode == 3, errors
    traj = cvi.Trajectory.load(tmp_path / "out" / "trajectory.npz")
    assert traj.status.code == cvi.StatusCode.INTERRUPTED
    assert 0.0 < traj.t[-1] < 30.0
