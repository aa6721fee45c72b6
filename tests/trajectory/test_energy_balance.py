"""The ledger's energy balance: input work, losses and the change of H agree to O(h^2), whatever acts."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactvi as cvi
from helpers.loop_scenes import BAR, arm_scene, four_bar, four_bar_start


def wave(t: float) -> tuple[float, float, float]:
    return 0.4 * math.sin(3 * t), 1.2 * math.cos(3 * t), -3.6 * math.sin(3 * t)


def damped_and_pushed() -> tuple[cvi.Scene, dict]:
    scene = arm_scene(2)
    scene.set_joint("j*", damping=0.2)
    return scene, {"control": lambda t, q, v: np.array([math.sin(7 * t), 0.5])}


def spring_dampers() -> tuple[cvi.Scene, dict]:
    scene = arm_scene(2)
    scene.add_spring("world", "j2", 30.0, damping=2.0, point_a=(0, 0, 0.8), point_b=(BAR, 0, 0), rest_length=0.3)
    scene.set_joint("j2", spring=[1.0, 0.0, 3.0])
    return scene, {}


def wrenches() -> tuple[cvi.Scene, dict]:
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.1, 0.3), placement=((0, 0, 0), (0.3, 0.2, 0.1)))
    scene.add_wrench("box", (0, 0, 5.0), (0.01, 0.02, 0.0), (0.1, 0.1, 0), "body")
    scene.add_wrench("box", lambda t: (math.sin(5 * t), 0.0, 0.0))
    return scene, {}


def user_force() -> tuple[cvi.Scene, dict]:
    scene = arm_scene(2)
    scene.add_force(lambda t, q, v: np.array([math.sin(3 * t), 0.0]) - 0.1 * v * np.abs(v))
    return scene, {}


def servos() -> tuple[cvi.Scene, dict]:
    scene = arm_scene(2)
    scene.set_servo("j*", 30.0, 1.0)
    return scene, {"target": {"j1": wave}}


def driven_loop() -> tuple[cvi.Scene, dict]:
    scene = four_bar()
    q = four_bar_start(scene)
    scene.set_joint("j2", damping=0.05)
    scene.prescribe("j1", lambda t: (q[0] + wave(t)[0], *wave(t)[1:]))
    return scene, {"q0": q}


def joint_friction() -> tuple[cvi.Scene, dict]:
    scene = arm_scene(2)
    scene.set_joint("j*", friction=0.3)
    return scene, {}


SCENES = [damped_and_pushed, spring_dampers, wrenches, user_force, servos, driven_loop, joint_friction]


def unaccounted(make, dt: float) -> tuple[float, float]:
    scene, options = make()
    traj = cvi.simulate(scene, duration=0.8, dt=dt, **options)
    assert np.ptp(traj.energy) > 1e-2 or np.ptp(traj.work.input + traj.work.prescribed) > 1e-2
    return float(np.abs(traj.ledger.energy_balance).max()), float(traj.kinetic_energy.max())


@pytest.mark.parametrize("make", SCENES)
def test_the_balance_is_of_order_two(make):
    """At the ends of slips the error of a step is O(h^2) with a factor that depends on where in a step they lie."""
    (coarse, _), (middle, _), (fine, scale) = (unaccounted(make, dt) for dt in (8e-3, 4e-3, 2e-3))
    assert fine < 1e-3 * scale
    if fine > 1e-13 * scale:
        assert 0.5 * math.log2(coarse / fine) == pytest.approx(2.0, abs=0.15 if make is not joint_friction else 0.5)


def test_impacts_and_persistent_contact_are_in_it():
    """A box is thrown on a ground with friction, hits it, slides and stops, pushed by a force all the while."""
    worst = []
    for dt in (2e-3, 1e-3, 5e-4):
        scene = cvi.Scene()
        scene.add_halfspace()
        scene.add_box("box", (0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.06))
        scene.set_contact(restitution=0.3, friction=0.3)
        scene.add_wrench("box", (2.0, 1.0, 0.0))
        traj = cvi.simulate(scene, v0=scene.velocity({"box": (4.0, 0, 0)}), duration=1.0, dt=dt)
        assert len(traj.events) > 0
        assert traj.friction_loss[-1] > 0.1
        worst.append(np.abs(traj.ledger.energy_balance).max() / traj.kinetic_energy.max())
    assert max(worst) < 1e-9  # bouncing ends with what is left of it, below 0.3^8 of the first impact's speed


def test_a_linkage_that_hits_its_stop():
    """e = 1: the energy is that of the start after each impact, to what the steps leave, and the loop stays closed."""
    scene = four_bar()
    q = four_bar_start(scene)
    scene.set_joint("j1", limits=(-2.0, -0.9), restitution=1.0)
    traj = cvi.simulate(scene, q, duration=3.0, dt=1e-3)
    assert len(traj.events) >= 3
    kinetic = traj.kinetic_energy.max()
    assert np.abs(traj.events.energy_change).max() < 1e-12 * kinetic
    assert np.abs(traj.ledger.energy_balance).max() < 1e-4 * kinetic
    core = scene.core()
    assert max(np.abs(core.constraint_residual(x, 0.0)).max() for x in traj.q) <= 1e-10


def test_a_tolerance_on_the_balance_ends_a_run():
    scene, options = servos()
    cvi.simulate(scene, duration=0.5, dt=2e-3, ledger={"energy_balance": 0.1}, **options)
    with pytest.raises(cvi.SimulationError, match="energy_balance is .* of the largest kinetic energy") as caught:
        cvi.simulate(scene, duration=0.5, dt=2e-3, ledger={"energy_balance": 1e-9}, **options)
    assert caught.value.status.code == cvi.StatusCode.LEDGER


def test_blocks_of_a_watched_run_are_one_run():
    """A bound that the run just keeps is kept by its blocks too: what was lost before a block is carried on."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.15))
    scene.set_contact(restitution=0.3, friction=0.5)
    v0 = scene.velocity({"box": (1.0, 0, 0)})
    free = cvi.simulate(scene, v0=v0, duration=1.5, dt=1e-3)
    scale = np.maximum.accumulate(free.kinetic_energy)
    worst = (np.abs(free.ledger.energy_balance) / scale).max()
    cvi.simulate(scene, v0=v0, duration=1.5, dt=1e-3, ledger={"energy_balance": 1.01 * worst + 1e-12})


def test_the_balance_of_a_run_that_chooses_its_steps():
    scene = arm_scene(2)
    scene.set_joint("j*", damping=0.1)
    traj = cvi.simulate(scene, duration=0.5, tol=1e-9, ledger={"energy_balance": 1e-6})
    assert traj.options.dt == "auto"
    assert traj.work.damping[-1] > 1e-2
    assert np.abs(traj.ledger.energy_balance).max() < 1e-8
