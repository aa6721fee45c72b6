"""Ctrl-C at every line of a run: what was computed is kept, and whoever calls learns that the run was stopped."""

from __future__ import annotations

import math
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi.interrupts import held_back
from contactvi.verify.case import Runs

STEPS, DT = 30, 1e-2
SOURCES = str(Path(cvi.__file__).parent)


@pytest.fixture(autouse=True)
def python_handles_ctrl_c() -> Iterator[None]:
    """A shell starts background jobs with SIGINT ignored; Python then has no handler of its own."""
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, handler)


def ball() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 0.2))
    scene.set_contact(restitution=0.5)
    return scene


class Presser:
    """Presses Ctrl-C at the n-th line of the package that is run, or only counts the lines."""

    def __init__(self, at: int = -1) -> None:
        self.at, self.lines, self.place = at, 0, ""

    def __enter__(self) -> Presser:
        sys.settrace(self._enter)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _enter(self, frame: Any, event: str, arg: Any) -> Callable[..., Any] | None:
        return self._line if frame.f_code.co_filename.startswith(SOURCES) else None

    def _line(self, frame: Any, event: str, arg: Any) -> Callable[..., Any]:
        if event == "line":
            if self.lines == self.at:
                self.place = f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"
                signal.raise_signal(signal.SIGINT)
            self.lines += 1
        return self._line


def run(dt: Any, control: Any) -> cvi.Trajectory:
    return cvi.simulate(SCENE, duration=STEPS * DT, dt=dt, control=control, throw=False)


SCENE = ball()


@pytest.mark.thinned(3)
@pytest.mark.parametrize(
    ("dt", "control"), [(DT, None), (DT, lambda t, q, v: np.zeros(6)), ("auto", None)], ids=["run", "control", "auto"]
)
def test_nothing_that_was_computed_is_lost(dt, control):
    run(dt, control)  # compiles the scene, loads modules
    with Presser() as presser:
        whole = run(dt, control)
    lost: list[str] = []
    unnoticed: list[str] = []
    kept = 0
    stride = max(1, presser.lines // 400)
    for at in range(0, presser.lines, stride):
        traj = None
        with Presser(at) as press:
            try:
                traj = run(dt, control)
            except KeyboardInterrupt:
                lost.append(press.place)
        if traj is None:
            continue
        kept += 1
        if traj.status.ok:  # at the last lines, where all is computed
            assert press.place.split(":")[0] in ("simulation.py", "interrupts.py")
            unnoticed.append(press.place)
        assert traj.status.ok or traj.status.code == cvi.StatusCode.INTERRUPTED, press.place
        assert traj.t[-1] == traj.status.time, press.place
        if dt != "auto":  # the engine makes all steps at once, or one by one
            count = len(traj.t)
            assert count in (1, len(whole.t)) or control is not None, press.place
            np.testing.assert_array_equal(traj.q, whole.q[:count])
            assert len(traj.events) == sum(event.time <= traj.t[-1] for event in whole.events), press.place
    assert len(unnoticed) <= math.ceil(9 / stride), unnoticed  # nine lines follow the last look at Ctrl-C
    assert kept > 0.5 * (kept + len(lost))
    # Before the run there is nothing to keep: options and the compilation of the scene.
    files = {place.split(":")[0] for place in lost}
    assert not files & {"run.py", "recorder.py", "engine.py", "adaptive.py", "trajectory.py"}, lost


def test_a_second_ctrl_c_is_raised_at_once():
    def stuck(t, q, v):
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("not reached")

    traj = cvi.simulate(ball(), duration=0.1, dt=DT, control=stuck, throw=False)
    assert traj.status.code == cvi.StatusCode.INTERRUPTED
    assert list(traj.t) == [0.0]


def test_handlers_of_the_user_stay():
    pressed = []
    former = signal.signal(signal.SIGINT, lambda *_: pressed.append(True))
    try:
        traj = cvi.simulate(
            ball(), duration=0.1, dt=DT, control=lambda t, q, v: signal.raise_signal(signal.SIGINT) or np.zeros(6)
        )
        assert len(pressed) == 10  # it is called between the steps, and as it raises nothing the run goes on
        assert traj.status.ok
    finally:
        signal.signal(signal.SIGINT, former)


def test_the_handler_is_put_back():
    for throw in (True, False):
        cvi.simulate(ball(), duration=0.1, dt=DT, throw=throw)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with held_back() as outer, held_back() as inner:
        assert outer is inner
        signal.raise_signal(signal.SIGINT)
        assert outer.settle()
    assert outer.pressed
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_simulator_steps_are_recorded_or_end_the_run():
    """Stepping one by one, Ctrl-C is raised where it is pressed; the record never misses a step without a word."""
    sim = cvi.Simulator(SCENE, dt=DT)
    sim.reset()
    for _ in range(5):
        sim.step()
    start = sim.save()
    with Presser() as presser:
        sim.step()
    for at in range(presser.lines):
        sim.load(start)
        with Presser(at), pytest.raises(KeyboardInterrupt):
            sim.step()
        status = sim.status
        assert status is not None
        traj = sim.trajectory()
        assert traj.t[-1] == sim.t
        assert status.ok or (status.code == cvi.StatusCode.INTERRUPTED and status.time == sim.t)
        assert len(traj.t) == (6 if sim.t < 5.5 * DT else 7)


def test_verify_is_stopped_and_no_case_fails():
    def stop(t: float, impacts: int) -> None:
        signal.raise_signal(signal.SIGINT)

    runs = Runs(60.0)
    runs._in_time = stop  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        runs.simulate(ball(), None, None, 1e4, 1e-2)
