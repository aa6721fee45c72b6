"""A simulator serves one call at a time: other threads, and callbacks of its own, get an error."""

from __future__ import annotations

import threading

import pytest

import contactvi as cvi

PANDA = "example-robot-data://robots/panda_description/urdf/panda.urdf"


@pytest.fixture
def simulator() -> cvi.Simulator:
    scene = cvi.Scene()
    scene.add_urdf(PANDA)
    sim = cvi.Simulator(scene, dt=1e-4)
    sim.reset()
    return sim


def test_two_threads(simulator: cvi.Simulator):
    """What the second thread is refused does not disturb the first one."""
    alone = simulator.copy()
    refused: list[str] = []
    started = threading.Event()

    def disturb() -> None:
        started.wait()
        for call in (simulator.step, simulator.reset, simulator.save, simulator.trajectory, lambda: simulator.q):
            try:
                call()
            except cvi.SimulationError as error:
                refused.append(str(error))

    other = threading.Thread(target=disturb)
    other.start()

    def progress(*_: object) -> None:
        started.set()
        other.join()

    simulator.run(2000, progress=progress)
    alone.run(2000)
    assert len(refused) == 5
    assert all("in use" in text and "another thread" in text and "copy" in text for text in refused)
    assert (simulator.q == alone.q).all()
    assert (simulator.v == alone.v).all()


def test_a_callback_may_look_but_not_step(simulator: cvi.Simulator):
    seen: list[float] = []

    def progress(*_: object) -> None:
        seen.append(simulator.t)
        with pytest.raises(cvi.SimulationError, match="a callback of its own"):
            simulator.step()
        with pytest.raises(cvi.SimulationError, match="in use"):
            simulator.reset()

    simulator.run(2000, progress=progress)
    assert seen
    assert simulator.step().ok
