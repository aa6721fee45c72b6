"""A simulator serves one call at a time: other threads, and functions that a step calls, get an error."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest

import contactvi as cvi


def simulator(within: Callable[[], None]) -> cvi.Simulator:
    """A ball in flight; `within` is called once, by a force, in a step after 10 ms."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    calls: list[Callable[[], None]] = [within]

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        if t >= 0.01 and calls:
            calls.pop()()
        return -0.1 * v

    scene.add_force(force, lambda t, q, v: (np.zeros((6, 6)), -0.1 * np.eye(6)), check=False)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    return sim


def test_two_threads():
    """What the second thread is refused does not disturb the first one."""
    refused: list[str] = []

    def disturb() -> None:
        for call in (sim.step, sim.reset, sim.save, sim.trajectory, lambda: sim.q):
            try:
                call()
            except cvi.SimulationError as error:
                refused.append(str(error))

    def within() -> None:
        other = threading.Thread(target=disturb)
        other.start()
        other.join()

    sim, alone = simulator(within), simulator(lambda: None)
    assert sim.run(30).ok
    assert alone.run(30).ok
    assert len(refused) == 5
    assert all("in use" in text and "another thread" in text and "copy" in text for text in refused)
    assert (sim.q == alone.q).all()
    assert (sim.v == alone.v).all()


def test_a_function_of_the_step_may_look_but_not_step():
    seen: list[float] = []

    def within() -> None:
        seen.append(sim.t)
        for call in (sim.step, sim.reset, sim.save):
            with pytest.raises(cvi.SimulationError, match="a callback of its own"):
                call()

    sim = simulator(within)
    assert sim.run(30).ok
    assert seen == [pytest.approx(0.01, abs=1.1e-3)]
    assert sim.step().ok
