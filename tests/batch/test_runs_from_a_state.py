"""Batches that go on from the present state of a simulator, against copies of it that go on alone, to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from helpers.rollout_scenes import MODELS, servo_arm, thrown_box

STEPS, DT = 60, 0.005


def slid_box() -> tuple[cvi.Simulator, int]:
    """A box that has slid on the ground for a while: it is in persistent contact, and its friction slides or sticks."""
    scene, _, _ = thrown_box()
    scene.set_contact(restitution=0.0, friction=0.4)
    sim = cvi.Simulator(scene, dt=DT)
    sim.reset([0.0, 0.0, 0.125, 0.0, 0.0, 0.0, 1.0], [0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    return sim, 6


def arm() -> tuple[cvi.Simulator, int]:
    """A double pendulum with servos near a wall."""
    scene, q, v = servo_arm()
    sim = cvi.Simulator(scene, dt=DT, order=4)
    sim.reset(q, v, t=1.5)
    return sim, 2


@pytest.mark.parametrize("make", [slid_box, arm])
def test_runs_go_on_from_the_state_of_a_simulator(make):
    sim, width = make()
    sim.run(20)
    rng = np.random.default_rng(0)
    control = 0.3 * rng.standard_normal((4, STEPS, width))
    inputs: dict[str, Any] = {"control": control}
    if sim.scene.servo_joints:
        inputs["target"] = 0.5 * rng.standard_normal((4, STEPS, width))
    before = sim.t, sim.q.tobytes(), sim.v.tobytes()
    for keep in ("ends", "nodes"):
        result = cvi.simulate_batch(sim, **inputs, duration=STEPS * DT, keep=keep, workers=2)
        assert result.ok.all()
        for k in range(4):
            twin = sim.copy()
            for i in range(STEPS):
                twin.step(control[k, i], inputs["target"][k, i] if "target" in inputs else None)
            made = twin.trajectory()
            for name in ("t", "q", "v"):
                own = getattr(made, name)[-STEPS - 1 :]
                expected = own[-1] if keep == "ends" else own
                assert getattr(result, name)[k].tobytes() == expected.tobytes(), (name, keep, k)
    assert (sim.t, sim.q.tobytes(), sim.v.tobytes()) == before


def test_servos_hold_what_they_held():
    """Without target each run follows what the simulator followed, not the place where it is now."""
    sim, _ = arm()
    sim.run(20)
    result = cvi.simulate_batch(sim, control=np.zeros((2, STEPS, 2)), duration=STEPS * DT, keep="ends")
    twin = sim.copy()
    twin.run(STEPS)
    assert np.allclose(result.q, twin.q, atol=1e-13)


def test_a_hand_that_holds_a_ball():
    scene = cvi.load_scene(MODELS / "allegro_ball.toml")
    sim = cvi.Simulator(scene, dt=1e-3, record=False)
    sim.reset()
    sim.run(600)
    assert sim.contacts
    result = cvi.simulate_batch(sim, control=np.zeros((3, 50, scene.nv)), duration=0.05, keep="nodes", workers=3)
    twin = sim.copy()
    twin.run(50)
    assert result.q[0].tobytes() == result.q[2].tobytes()
    assert result.q[1, -1].tobytes() == twin.q.tobytes()


@pytest.mark.parametrize("given", [
    {"q0s": np.zeros((2, 7))}, {"parameters": {"friction": 0.1}}, {"keep": "runs"}, {"dt": 1e-3},
    {"control": lambda t, q, v: np.zeros(6)},
])  # fmt: skip
def test_what_such_runs_have_not(given):
    sim, _ = slid_box()
    with pytest.raises(cvi.InputError, match="state of a simulator"):
        cvi.simulate_batch(sim, **{"duration": 0.1, **given})


def test_a_simulator_that_was_not_started():
    scene, _, _ = thrown_box()
    with pytest.raises(cvi.ContactviError):
        cvi.simulate_batch(cvi.Simulator(scene, dt=DT), control=np.zeros((2, 10, 6)), duration=10 * DT)
