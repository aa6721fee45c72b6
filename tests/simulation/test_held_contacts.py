"""What users can measure of persistent contacts in smooth steps: gaps, energy, impulses; and what is left to others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.verify import systems
from helpers import held_contact_scenes as scenes
from helpers.persistent_runs import Start, pose, turned

GRAVITY = 9.81
MODELS = Path(__file__).resolve().parents[2] / "models"


def rolling_cylinder(friction: float) -> cvi.Scene:
    """A cylinder dropped on its rim: it rocks and rolls from side to side, faster the flatter it lies."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_cylinder("can", radius=0.08, length=0.2, placement=((0.0, 0.0, 0.35), (0.7, 0.2, 0.1)))
    scene.set_contact(restitution=0.0, friction=friction)
    return scene


@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("friction", [0.0, 0.3, 0.8])
def test_a_rim_gains_no_energy(friction, order):
    """Where the rim falls nearly flat its point runs around it; steps that do not resolve that are not taken."""
    scene = rolling_cylinder(friction)
    traj = cvi.simulate(scene, None, [0.3, -0.2, 0.0, 0.5, 0.4, 0.1], duration=1.5, dt=1e-2, order=order)
    assert traj.phases is not None
    assert min(scene.gaps(q).min() for q in traj.q) >= -1e-9
    rise = traj.energy - np.minimum.accumulate(traj.energy)
    assert rise.max() <= 1e-3 * traj.kinetic_energy.max()  # what a step may be off by


@pytest.mark.parametrize("order", [4, 8])
def test_impulses_are_those_of_the_motion(order):
    """The normal turns while a ball rolls off another: the impulses, gravity and the momentum balance exactly."""
    held = scenes.ball_off_sphere()
    traj = held.run(8, order)
    log = traj.contacts
    mass = traj.scene.model.inertias[1].mass
    momentum = mass * held.observe(traj.q, traj.v)[:, 2:4]  # x and z
    for k in range(len(traj) - 1):
        inside = (log.t >= traj.t[k] - 1e-12) & (log.t < traj.t[k + 1] - 1e-12)
        impulse = log.array("start")[inside].sum(axis=0) + log.array("end")[inside].sum(axis=0)
        weight = mass * GRAVITY * (traj.t[k + 1] - traj.t[k])
        change = momentum[k + 1] - momentum[k] + np.array([0.0, weight])
        np.testing.assert_allclose(impulse[[0, 2]], change, atol=1e-13)
    impulses = log.array("start") + log.array("end")
    along = np.einsum("ij,ij->i", impulses, log.array("normal"))
    across = np.linalg.norm(impulses - along[:, None] * log.array("normal"), axis=1)
    assert (along > 0.0).all()
    assert (across <= 0.3 * along * (1.0 + 1e-12)).all()
    assert np.abs(np.linalg.norm(log.array("normal"), axis=1) - 1.0).max() < 1e-14


@pytest.mark.parametrize("order", [4, 8])
def test_what_rigid_bodies_leave_open(order):
    """How the corners of a box share its weight decides how it spins while it slides: contact steps take over."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", size=(0.2, 0.3, 0.1), mass=2.0, placement=((0.0, 0.0, 0.05), (0.0, 0.0, 0.0)))
    scene.set_contact(restitution=0.0, friction=0.3)
    v = [1.0, 0.3, 0.0, 0.0, 0.0, 3.0]
    exact = cvi.simulate(scene, None, v, duration=0.2, dt=1e-4, order=2)
    traj = cvi.simulate(scene, None, v, duration=0.2, dt=1e-2, order=order)
    assert traj.stats.contact_steps > 0
    assert "order 2" in traj.stepping
    # of contact steps of 1e-3 s; the error of such steps falls with their square
    assert np.abs(traj.q[-1] - exact.q[-1]).max() < 1e-6
    # without the spin the split of the load does not matter
    straight = cvi.simulate(scene, None, [1.0, 0.3, 0.0, 0.0, 0.0, 0.0], duration=0.2, dt=1e-2, order=order)
    assert straight.stats.contact_steps == 0


def linkage() -> Start:
    """A four-bar whose crank goes round."""
    scene = systems.four_bar()
    q = systems.four_bar_angles(0.3)
    v = scene.consistent_velocity(q, [1.0, 0.0, 0.0])
    return scene, q, v * (2.0 / v[0])


def ball_drawn_to_a_sphere() -> Start:
    """Without friction, around a sphere to whose centre a spring draws it: a spherical pendulum with a spin."""
    scene = cvi.Scene()
    scene.add_sphere("support", radius=0.5, free=False)
    scene.add_sphere("ball", radius=0.1)
    scene.add_spring("world", "ball", 400.0, rest_length=0.4)  # 80 N: more than the weight and the turning ask for
    scene.set_contact(restitution=0.0, friction=0.0)
    return scene, pose([0.6 * np.sin(0.8), 0.0, 0.6 * np.cos(0.8)]), np.array([0.0, 1.0, 0.0, 1.0, 2.0, 3.0])


def top_on_its_tip() -> Start:
    """A pyramid that spins on its apex, which sticks: it leans by .2 rad and more, but not to its rim."""
    scene = cvi.Scene()
    scene.add_halfspace()
    around = 2.0 * np.pi * np.arange(6) / 6.0
    rim = np.column_stack([0.1 * np.cos(around), 0.1 * np.sin(around), np.full(6, 0.06)])
    scene.add_mesh("top", np.vstack([np.zeros(3), rim]), mass=1.0)
    scene.set_contact(restitution=0.0, friction=3.0)
    return scene, pose(np.zeros(3), turned(0.2)), np.array([0.0, 0.0, 0.0, 1.0, 0.0, 36.0])


# The modes of the contact, and steps at the orders 4 and 8 with a range of the energy that rounding does not reach.
SYMPLECTIC: dict[str, tuple[Callable[[], Start], set[str], dict[int, float]]] = {
    "linkage": (linkage, set(), {4: 1e-2, 8: 4e-2}),
    "ball drawn to a sphere": (ball_drawn_to_a_sphere, {"frictionless"}, {4: 1e-2, 8: 5e-2}),
    "top on its tip": (top_on_its_tip, {"stick"}, {4: 1e-2, 8: 2e-2}),
}


@pytest.mark.slow
@pytest.mark.parametrize("order", [4, 8])
@pytest.mark.parametrize("name", SYMPLECTIC)
def test_energy_is_flat_over_1e5_steps(name, order):
    """What sticks, what slides without friction, and loops: the steps are symplectic, and the energy has no trend."""
    make, modes, steps = SYMPLECTIC[name]
    (scene, q, v), dt = make(), steps[order]
    options: dict[str, Any] = {"dt": dt, "order": order, "solver_tol": 1e-15, "record_every": 50, "dense": False}
    traj = cvi.simulate(scene, q, v, duration=1e5 * dt, **options)
    assert {contact.mode for contact in traj.contacts.at(0.5 * traj.t[-1])} == modes
    assert traj.stats.contact_steps == traj.stats.halved == 0
    assert len(traj.contact_changes) == len(modes)  # the contact begins, and never ends
    tenth = len(traj.energy) // 10
    first, last = traj.energy[:tenth], traj.energy[-tenth:]
    # By the solver in each step, were it always of one sign.
    left = 1e5 * options["solver_tol"] * np.abs(traj.energy).max()
    assert np.ptp(traj.energy) <= 1.1 * np.ptp(first) + left
    assert abs(last.mean() - first.mean()) <= 0.05 * np.ptp(first) + left


@pytest.mark.parametrize(("order", "steps"), [(4, (2e-2, 1e-2, 5e-3)), (8, (5e-2, 4e-2))])
def test_drift_of_rolling(order, steps):
    """A coin that wobbles along: what rolls is not symplectic. Its energy drifts, but with the order and less."""
    held = scenes.rolling_coin(1.0)
    rates = []
    for dt in steps:
        options = {"dt": dt, "order": order, "solver_tol": 1e-14, "dense": False}
        traj = cvi.simulate(held.scene, held.q, held.v, duration=40.0, **options)
        assert traj.stats.contact_steps == traj.stats.halved == 0
        rates.append(abs(np.polyfit(traj.t, traj.energy, 1)[0]))
    seen = np.diff(np.log(rates)) / np.diff(np.log(steps))
    assert (seen > order - 0.3).all()


@pytest.mark.parametrize("order", [4, 8])
def test_a_scene_has_no_memory_of_its_last_run(order):
    """Islands that are formed anew know nothing of an earlier run: the same call gives the same bits."""
    scene = cvi.load_scene(MODELS / "allegro_ball.toml")
    first, second = (cvi.simulate(scene, duration=0.4, dt=5e-3, order=order, dense=False) for _ in range(2))
    assert second.stats.contact_steps == first.stats.contact_steps
    np.testing.assert_array_equal(second.q, first.q)


class PressingArm:
    """An arm of three light rods on servos that press its tip, a ball, on the ground.

    `holding` is an independent answer: the force at the tip that leaves it no acceleration, by Pinocchio's dynamics.
    """

    friction, radius, length, height = 0.2688, 0.03, 0.4, 0.5
    masses = (0.506, 0.74, 0.7515)
    kp, kd, target = (75.1, 41.9, 81.0), (3.43, 1.724, 3.41), (0.7648, 0.5414, 0.4167)

    def __init__(self) -> None:
        model, parent = systems.empty_model(systems.GRAVITY), 0
        for k, mass in enumerate(self.masses):
            at = systems.place(x=self.length) if k else systems.place(z=self.height)
            parent = model.addJoint(parent, pin.JointModelRY(), at, f"j{k}")
            inertia = pin.Inertia(mass, np.array([0.5 * self.length, 0.0, 0.0]), np.diag([1e-3, 0.013, 0.013]))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        shapes: systems.Shapes = {
            "tip": (parent, systems.place(x=self.length), coal.Sphere(self.radius)),
            "ground": (0, systems.place(), systems.halfspace(0.0, 0.0, 1.0)),
        }
        self.scene = systems.built(model, shapes, [("ground", "tip")], 0.0, self.friction)
        for k in range(3):
            self.scene.set_servo(f"j{k}", kp=self.kp[k], kd=self.kd[k], target=self.target[k])
        self.model, self.data = self.scene.model, self.scene.model.createData()

    def rows(self, q: np.ndarray) -> np.ndarray:
        """Return what takes velocities to those of the tip's lowest point along x and z, (2, 3)."""
        pin.computeJointJacobians(self.model, self.data, q)
        turn = pin.getJointJacobian(self.model, self.data, 3, pin.LOCAL_WORLD_ALIGNED)
        lowest = self.data.oMi[3].rotation @ [self.length, 0.0, 0.0] - [0.0, 0.0, self.radius]
        return (turn[:3] - pin.skew(lowest) @ turn[3:])[[0, 2]]

    def holding(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the force on the tip along x and z with which its lowest point has no acceleration [N]."""
        W, step = self.rows(q), 1e-6
        bias = (self.rows(q + step * v) - self.rows(q - step * v)) @ v / (2.0 * step)
        servo = np.array(self.kp) * (np.array(self.target) - q) - np.array(self.kd) * v
        mass = pin.crba(self.model, self.data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        free = np.linalg.solve(mass, servo - pin.nonLinearEffects(self.model, self.data, q, v))
        return np.linalg.solve(W @ np.linalg.solve(mass, W.T), -(W @ free + bias))


@pytest.mark.parametrize("order", [8, 16])
def test_a_tip_that_is_pressed_sticks_and_slips_in_turn(order):
    """The tip stays where it has come to rest until what holds it reaches the cone, and begins to slip then.

    That is when the slip would begin with more than 1e-7 of the largest acceleration, which is 1e-5 of the force here.
    """
    arm = PressingArm()
    options: dict[str, Any] = {"duration": 0.6, "order": order, "solver_tol": 1e-14}
    times = []
    for dt in (2e-3, 1e-3):
        traj = cvi.simulate(arm.scene, [0.1, 0.2, 0.2], [0.0, 0.0, 0.0], dt=dt, **options)
        changes = traj.contact_changes
        assert [c.change for c in changes] == ["begin", "stick", "slip", "stick"]
        times.append(np.array([c.time for c in changes]))
        for change in changes[1:]:
            state = traj.at(change.time)
            force = arm.holding(np.asarray(state.q), np.asarray(state.v))
            held = abs(force[0]) / force[1] / arm.friction
            if change.change == "slip":
                assert held == pytest.approx(1.0, abs=1e-5)
            else:
                assert held < 1.0 - 1e-3
    np.testing.assert_allclose(times[0], times[1], atol=2e-7)  # the force grows by 80 of it per second
