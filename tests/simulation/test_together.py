"""Simulators stepped side by side have the bits of their own runs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.simulation.recorder import BLOCK
from contactvi.simulation.together import step_together
from helpers.run_scenes import ball_scene, hand_scene, slider_scene


def hands(number: int, **options: object) -> list[cvi.Simulator]:
    """The Allegro hand with servos in its fingers and a ball above it, each in another state."""
    scene, start = hand_scene()
    for k in range(16):
        scene.set_servo(f"joint_{k}.0", 1.0, 0.02)
    found = []
    for k in range(number):
        sim = cvi.Simulator(scene, 1e-3, **options)
        q = start.copy()
        q[18] -= 0.03 * k  # the ball
        sim.reset(q)
        found.append(sim)
    return found


def state(sim: cvi.Simulator) -> list[np.ndarray]:
    return [np.array(sim.t), sim.q, sim.v, np.array(sim.impacts), *sim.last_step()[1:]]


def assert_equal(ours: cvi.Simulator, theirs: cvi.Simulator) -> None:
    for a, b in zip(state(ours), state(theirs), strict=True):
        np.testing.assert_array_equal(a, b)
    assert [str(contact) for contact in ours.contacts] == [str(contact) for contact in theirs.contacts]
    assert ours.status.code == theirs.status.code


@pytest.mark.thinned(2)
@pytest.mark.parametrize("workers", [1, 2, 3])
@pytest.mark.parametrize("record", ["states", False, 5])
def test_bits_of_single_runs(workers, record):
    """With forces and targets, through impacts and persistent contact; the last step as if made one by one."""
    together, alone = hands(4, record=record), hands(4, record=record)
    random = np.random.default_rng(0)
    for _ in range(12):
        targets = random.uniform(0.2, 0.8, (4, 16))
        forces = np.zeros((4, 22))
        forces[:, 16:] = random.uniform(-0.2, 0.2, (4, 6))
        statuses = step_together(together, 20, forces, targets, workers)
        for k, sim in enumerate(alone):
            for _ in range(20):
                status = sim.step(forces[k], targets[k])
            assert statuses[k] == status
            assert_equal(together[k], sim)
    assert all(sim.impacts > 0 for sim in alone)
    if record == "states":
        for a, b in zip(together, alone, strict=True):
            ours, theirs = a.trajectory(), b.trajectory()
            np.testing.assert_array_equal(ours.q, theirs.q)
            np.testing.assert_array_equal(ours.work.input, theirs.work.input)
            assert [str(event) for event in ours.events] == [str(event) for event in theirs.events]


def test_the_default_of_the_servos():
    """They hold the start."""
    (ours,), (theirs,) = hands(1), hands(1)
    step_together([ours], 50)
    theirs.run(50)
    np.testing.assert_array_equal(ours.q, theirs.q)


def falling(**options: object) -> cvi.Simulator:
    sim = cvi.Simulator(ball_scene(0.5), 1e-2, **options)
    sim.reset()
    return sim


def test_one_that_ends_does_not_end_the_others():
    sims = [falling(zeno="end"), falling()]
    first, second = step_together(sims, 400, workers=2)
    alone = falling(zeno="end")
    assert first == alone.run(400)
    assert first.code == cvi.StatusCode.ZENO
    assert second.ok
    assert sims[1].t == pytest.approx(4.0, abs=1e-12)
    with pytest.raises(cvi.SimulationError, match="has ended"):
        step_together(sims, 1)


def test_a_record_that_grows_to_its_limit_is_shortened():
    ours, theirs = falling(record=3), falling(record=3)
    steps = 2 * BLOCK + 7
    assert step_together([ours], steps)[0].ok
    theirs.run(steps)
    np.testing.assert_array_equal(ours.q, theirs.q)
    np.testing.assert_array_equal(ours.trajectory().t, theirs.trajectory().t)


def test_runs_whose_steps_are_looked_at():
    """With tolerances of a ledger, and with functions of the user."""
    scene = slider_scene()
    scene.add_potential(lambda q: 5.0 * float(q[0]) ** 2, lambda q: 10.0 * q)
    makers = [
        lambda: cvi.Simulator(slider_scene(), 1e-2, ledger={"energy_rise": 1.0}),
        lambda: cvi.Simulator(scene, 1e-2),
    ]
    sims = [[maker() for maker in (*makers, makers[0])] for _ in range(2)]
    for both in sims:
        for sim in both:
            sim.reset()
    step_together(sims[0], 60)
    for ours, theirs in zip(*sims, strict=True):
        theirs.run(60)
        np.testing.assert_array_equal(ours.q, theirs.q)


def test_scenes_of_their_own():
    """Their servos may stand at other places among the joints."""

    def arm(first: bool) -> cvi.Simulator:
        model = pin.Model()
        joint = 0
        for name in "ab":
            joint = model.addJoint(joint, pin.JointModelRY(), pin.SE3.Identity(), name)
            model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3(np.eye(3), np.array([0, 0, -1.0])))
        scene = cvi.Scene.from_pinocchio(model)
        scene.set_servo("a" if first else "b", 10.0, 1.0)
        sim = cvi.Simulator(scene, 1e-3)
        sim.reset()
        return sim

    ours, theirs = [arm(True), arm(False)], [arm(True), arm(False)]
    step_together(ours, 30, targets=[[0.5], [-0.5]])
    for sim, target, own in zip(theirs, (0.5, -0.5), ours, strict=True):
        sim.run(30, target=[target])
        np.testing.assert_array_equal(sim.q, own.q)


def test_wrong_arguments():
    sims = hands(2)
    assert step_together([], 3) == []
    with pytest.raises(cvi.SimulationError, match="in use"):
        step_together([sims[0], sims[0]], 1)
    with pytest.raises(cvi.SimulationError, match="no state yet"):
        step_together([cvi.Simulator(ball_scene(), 1e-2)], 1)
    for arguments in (
        {"steps": 0},
        {"steps": 1, "workers": 0},
        {"steps": 1, "forces": np.zeros((1, 22))},
        {"steps": 1, "forces": np.full((2, 22), np.nan)},
        {"steps": 1, "targets": np.zeros((2, 3))},
        {"steps": 1, "targets": np.zeros(16)},
        {"steps": 1, "targets": "a"},
    ):
        with pytest.raises(cvi.InputError):
            step_together(sims, **arguments)
    other = cvi.Simulator(ball_scene(), 1e-2)
    other.reset()
    with pytest.raises(cvi.InputError, match="as many"):
        step_together([sims[0], other], 1)
    step_together(sims, 1)  # none of this has left one of them in use
