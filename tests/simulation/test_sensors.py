"""Simulator for control loops: what it has of sensors, contacts, reactions; states saved and restored to the bit."""

from __future__ import annotations

import copy
import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.loop_scenes import BAR, arm_scene, four_bar, four_bar_start

G = 9.81


def resting_box(friction: float = 0.5) -> tuple[cvi.Scene, cvi.Simulator]:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.05))
    scene.set_contact(restitution=0.0, friction=friction)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    return scene, sim


# -- bad input --------------------------------------------------------------------------------------------------------


def test_sensors_of_nothing_are_refused():
    _, sim = resting_box()
    with pytest.raises(cvi.InputError, match="Unknown joint"):
        cvi.JointEncoder(sim, "elbow")
    with pytest.raises(cvi.InputError, match="Unknown body"):
        cvi.Imu(sim, "bok")
    with pytest.raises(cvi.InputError, match="Placement"):
        cvi.Imu(sim, "box", "up")
    with pytest.raises(cvi.SimulationError, match="No step was made yet"):
        cvi.Imu(sim, "box").read()
    blind = cvi.Simulator(sim.scene, dt=1e-3, record_contacts=False)
    with pytest.raises(cvi.InputError, match="record_contacts=True"):
        cvi.ContactSensor(blind, "box")
    for sensor in (cvi.JointEncoder, cvi.Imu, cvi.ContactSensor):
        with pytest.raises(cvi.InputError, match=r"expected a contactvi.Simulator, got Scene"):
            sensor(sim.scene, "box")
    arm = cvi.Simulator(arm_scene(1), dt=1e-3)
    with pytest.raises(cvi.InputError, match="no shape"):
        cvi.ContactSensor(arm, "j1")


@pytest.mark.parametrize("steps", [-1, 1.5, None, "two", True, math.inf])
def test_a_bad_number_of_steps_is_refused(steps):
    _, sim = resting_box()
    with pytest.raises(cvi.InputError, match="a whole number >= 0"):
        sim.run(steps)
    assert sim.t == 0.0


def test_snapshots_of_others_are_refused():
    _, sim = resting_box()
    saved = sim.save()
    _, other = resting_box()
    with pytest.raises(cvi.InputError, match="another scene"):
        other.load(saved)
    with pytest.raises(cvi.InputError, match="Snapshot"):
        sim.load(3)


# -- sensors ----------------------------------------------------------------------------------------------------------


def test_encoder():
    scene = arm_scene(2)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset([0.1, 0.2], [0.3, 0.4])
    reading = cvi.JointEncoder(sim, "j2").read()
    assert (reading.q[0], reading.v[0]) == pytest.approx((0.2, 0.4), abs=1e-15)


def test_imu_at_rest_and_in_free_fall():
    _, sim = resting_box()
    turned = pin.rpy.rpyToMatrix(0.3, 0.2, 0.1)
    imu = cvi.Imu(sim, "box", pin.SE3(turned, np.array([0.05, 0.02, 0.01])))
    sim.run(5)
    sim.step()
    assert imu.read().specific_force == pytest.approx(turned.T @ [0, 0, G], abs=1e-8)
    assert imu.read().angular_velocity == pytest.approx(np.zeros(3), abs=1e-10)
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.2, 0.1), placement=(0, 0, 1))
    fall = cvi.Simulator(scene, dt=1e-3)
    fall.reset()
    fall.step()
    assert cvi.Imu(fall, "box").read().specific_force == pytest.approx(np.zeros(3), abs=1e-9)


def test_imu_on_a_wheel():
    """Off the axis by r at rate w: w^2 r towards the axis, to O(h^2)."""
    scene = arm_scene(1, gravity=False)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset(None, [3.0])
    sim.step()
    reading = cvi.Imu(sim, "j1", (BAR, 0, 0)).read()
    assert reading.specific_force == pytest.approx([-9.0 * BAR, 0, 0], abs=9.0 * BAR * 1e-5)
    assert reading.angular_velocity == pytest.approx([0, 3.0, 0], abs=1e-12)


def test_imu_shows_an_impact():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, mass=1.0, placement=(0, 0, 0.1 + 0.5 * G * 0.01**2))
    scene.set_contact(restitution=1.0)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    imu, touch = cvi.Imu(sim, "ball"), cvi.ContactSensor(sim, "ball")
    seen, felt = [], []
    for _ in range(15):
        sim.step()
        seen.append(imu.read().specific_force[2] * 1e-3)
        felt.append(touch.read().force[2] * 1e-3)
    assert sum(felt) == pytest.approx(2 * 0.01 * G, rel=1e-9)
    assert seen == pytest.approx(felt, abs=1e-9)  # what is not gravity is contact


@pytest.mark.parametrize("steps", ["one", "many"])
def test_contact_forces_carry_the_weight(steps):
    _, sim = resting_box()
    for _ in range(6):
        sim.step() if steps == "one" else sim.run(3)
    reading = cvi.ContactSensor(sim, "box").read()
    assert reading.force == pytest.approx([0, 0, 2.0 * G], abs=1e-7)
    assert reading.torque == pytest.approx(np.zeros(3), abs=1e-7)
    assert reading.points == 4
    ground = cvi.ContactSensor(sim, "ground").read()
    assert ground.force == pytest.approx([0, 0, -2.0 * G], abs=1e-7)


def test_contacts_are_those_of_the_last_step():
    scene, sim = resting_box()
    assert sim.contacts == []
    sim.step()
    assert len(sim.contacts) == 4
    assert {contact.pair for contact in sim.contacts} == {("ground", "box")}
    assert sum(contact.force[2] for contact in sim.contacts) == pytest.approx(2.0 * G)
    push = np.zeros(6)
    push[2] = 3 * 2.0 * G
    sim.step(push)
    sim.step(push)
    assert sim.contacts == []
    sim.step()
    assert sim.contacts == []


def test_reactions_of_the_last_step():
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.1, 0.1), mass=3.0, placement=(0.5, 0, 1))
    scene.add_weld("world", "box", name="weld")
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    sim.step()
    assert sim.reaction("weld")[:3] == pytest.approx([0, 0, 3 * G], abs=1e-7)


# -- states -----------------------------------------------------------------------------------------------------------


def bouncing() -> tuple[cvi.Scene, np.ndarray]:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.15, 0.1), mass=2.0, placement=((0, 0, 0.15), (0.3, 0.2, 0.1)))
    scene.set_contact(restitution=0.3, friction=0.5)
    return scene, scene.velocity({"box": (0.5, 0, 0)})


def linkage() -> tuple[cvi.Scene, np.ndarray]:
    scene = four_bar()
    scene.q0 = four_bar_start(scene)
    scene.set_servo("j1", 5.0, 0.5)
    scene.set_joint("j2", friction=0.1)
    return scene, np.zeros(3)


@pytest.mark.parametrize("make", [bouncing, linkage])
@pytest.mark.parametrize("order", [2, 8])
def test_a_restored_state_goes_on_to_the_bit(make, order):
    scene, v0 = make()
    sim = cvi.Simulator(scene, dt=2e-3, order=order)
    sim.reset(None, v0)
    sim.run(61)
    saved, twin = sim.save(), sim.copy()
    sim.run(150)
    wanted = sim.trajectory()
    twin.run(150)
    sim.load(saved)
    assert sim.t == pytest.approx(61 * 2e-3)
    assert sim.impacts == len(saved.record.log())
    sim.run(150)
    for got in (sim.trajectory(), twin.trajectory()):
        for name in ("t", "q", "p"):
            assert np.array_equal(getattr(got, name), getattr(wanted, name)), name
        assert np.array_equal(got.events.array("impulse"), wanted.events.array("impulse"))
        assert np.array_equal(got.forces.values, wanted.forces.values)
        assert np.array_equal(got.contacts.array("start"), wanted.contacts.array("start"))


def test_a_copy_is_apart():
    _, sim = resting_box()
    sim.step()
    twin = sim.copy()
    twin.run(10, np.tile([0, 0, 50.0, 0, 0, 0], (10, 1)))
    assert sim.t == pytest.approx(1e-3)
    assert len(sim.trajectory()) == 2
    assert len(twin.trajectory()) == 12
    assert abs(sim.q[2] - 0.05) < 1e-10


def test_copy_and_save_before_a_start():
    scene, _ = bouncing()
    sim = cvi.Simulator(scene, dt=1e-3)
    assert sim.copy().status is None
    with pytest.raises(cvi.SimulationError):
        sim.save()


@pytest.mark.parametrize("twin_of", [copy.copy, copy.deepcopy])
def test_copies_of_the_standard_library_go_on_by_themselves(twin_of):
    _, sim = resting_box()
    sim.run(3)
    twin = twin_of(sim)
    sim.step([1.0, 0, 0, 0, 0, 0])
    assert twin.t == pytest.approx(3e-3)
    twin.step([1.0, 0, 0, 0, 0, 0])
    assert np.array_equal(twin.q, sim.q)
