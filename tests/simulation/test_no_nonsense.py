"""What would be nonsense is refused or ends the run with its reason; numbers that leave the API are finite."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.inputs import LARGEST

JOINTS = (pin.JointModelRY, pin.JointModelRX, pin.JointModelPZ)
ALLEGRO = "example-robot-data://robots/allegro_hand_description/urdf/allegro_left_hand.urdf"
ICUB = "example-robot-data://robots/icub_description/robots/icub.urdf"


def random_tree(rng: np.random.Generator) -> cvi.Scene | None:
    """Return a random tree of up to five joints with limits; None where its joints are not in depth-first order."""
    model = pin.Model()
    for k in range(int(rng.integers(2, 6))):
        parent = int(rng.integers(0, model.njoints))
        kind = JOINTS[rng.integers(len(JOINTS))]()
        placement = pin.SE3(pin.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-0.5, 0.5, 3))
        joint = model.addJoint(parent, kind, placement, f"j{k}")
        ball = pin.Inertia.FromSphere(rng.uniform(0.2, 2.0), rng.uniform(0.05, 0.3))
        model.appendBodyToJoint(joint, ball, pin.SE3(np.eye(3), rng.uniform(-0.3, 0.3, 3)))
    model.upperPositionLimit[:] = rng.uniform(0.3, 1.0, model.nq)
    model.lowerPositionLimit[:] = -model.upperPositionLimit
    try:
        return cvi.Scene.from_pinocchio(model, name="tree")
    except cvi.SceneError:
        return None


@pytest.mark.parametrize("impact", ["mhc", "dtec"])
def test_no_impact_separates_faster_than_it_closes(impact):
    """At long steps of order 2 the maps' own scalars may ask for it; with e < 1 that is no answer."""
    events = fallbacks = 0
    for seed in range(80):
        rng = np.random.default_rng(seed)
        scene = random_tree(rng)
        if scene is None:
            continue
        scene.set_contact(restitution=0.8)
        for dt in (1e-2, 5e-2):
            traj = cvi.simulate(
                scene, v0=rng.uniform(-12.0, 12.0, scene.nv), duration=1.0, dt=dt, impact=impact, throw=False,
                contact_mode="events",
            )  # fmt: skip
            before, after = traj.events.array("gamma_minus"), traj.events.array("gamma_plus")
            assert np.all(after <= -before * (1.0 + 1e-12)), (seed, dt)
            assert np.all(np.isfinite(traj.events.array("jump")))
            events += len(traj.events)
            fallbacks += sum(event.fallback is not None for event in traj.events)
    assert events > 500
    assert fallbacks < 0.05 * events


def test_a_start_without_inertia_is_refused():
    """The iCub of example-robot-data has a motion without inertia in its neutral pose."""
    scene = cvi.Scene()
    scene.add_urdf(ICUB, base="free")
    with pytest.raises(cvi.SceneError, match="mass matrix is singular at the start") as caught:
        cvi.simulate(scene, duration=0.01, dt=1e-3)
    assert caught.value.joint in scene.model.names
    scene.set_joint(caught.value.joint, armature=1e-4)
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3, contact_mode="steps", throw=False)
    assert np.abs(traj.v[-1]).max() < 10.0


def test_numbers_whose_products_overflow_are_refused():
    scene = cvi.Scene()
    for call in (
        lambda: scene.add_sphere("ball", 0.1, placement=(1.7e308, 0.0, 0.0)),
        lambda: scene.add_sphere("ball", 0.1, mass=1e300),
        lambda: scene.add_sphere("ball", 1e51),
        lambda: cvi.Scene(gravity=(0.0, 0.0, 1e60)),
    ):
        with pytest.raises(cvi.InputError, match=r"at most 1e\+50"):
            call()
    scene.add_sphere("ball", 0.1, mass=LARGEST, placement=(LARGEST, 0.0, 0.0))
    with pytest.raises(cvi.SimulationError, match="momentum of the start state overflows"):
        cvi.simulate(scene, v0=[LARGEST, 0.0, 0.0, 0.0, 0.0, 0.0], duration=0.1, dt=1e-2)
    traj = cvi.simulate(scene, v0=[1e40, 0.0, 0.0, 0.0, 0.0, 0.0], duration=0.1, dt=1e-2, throw=False)
    assert np.all(np.isfinite(traj.q))
    assert np.all(np.isfinite(traj.energy))


def test_a_motion_that_explodes_ends_while_its_energy_is_finite():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model, name="slider")
    scene.add_force(lambda t, q, v: 400.0 * q, lambda t, q, v: (np.eye(1) * 400.0, np.zeros((1, 1))))
    traj = cvi.simulate(scene, [1.0], [0.0], duration=100.0, dt=1e-2, throw=False)
    assert traj.status.code == cvi.StatusCode.NOT_FINITE
    assert 8.0 < traj.status.time < 13.0  # |p| = 1e100 at 20 t = ln(1e100 / 10)
    assert np.all(np.isfinite(traj.energy))
    assert np.all(np.isfinite(traj.v))


def test_shares_of_a_loss_add_up_to_a_loss():
    """A ball falls on two boxes on each other: what contacts that act together lose is shared, and never won."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("low", (0.4, 0.4, 0.1), placement=(0.0, 0.0, 0.05))
    scene.add_box("high", (0.3, 0.3, 0.1), placement=(0.0, 0.0, 0.15))
    scene.add_sphere("ball", 0.05, placement=(0.05, 0.02, 0.4))
    scene.set_contact(restitution=0.5, friction=0.4)
    for support in ("sequence", "stiff"):
        traj = cvi.simulate(scene, duration=0.5, dt=1e-3, support=support, contact_mode="events")
        times, loss = traj.events.array("time"), traj.events.array("loss")
        energy = max(abs(traj.energy[0]), 1.0)
        for time in np.unique(times):
            assert loss[times == time].sum() >= -1e-13 * energy


@pytest.mark.parametrize("contact_mode", ["auto", "events", "steps"])
def test_a_scene_in_which_nothing_moves_runs(contact_mode):
    scene = cvi.Scene()
    scene.add_box("box", (1.0, 1.0, 1.0), free=False)
    scene.add_halfspace(offset=-2.0)
    traj = cvi.simulate(scene, duration=2.0, dt=1.0, contact_mode=contact_mode)
    assert len(traj.t) == 3
    if contact_mode == "steps":
        return  # dense steps have no constraints
    scene.add_point("box", "world", point_b=None)
    assert cvi.simulate(scene, duration=0.1, dt=0.1, contact_mode=contact_mode).status.ok


def test_targets_of_too_many_steps_are_refused_before_they_are_made():
    scene = cvi.Scene()
    scene.add_urdf(ALLEGRO)
    scene.set_servo("*", kp=1.0, kd=0.1)
    with pytest.raises(cvi.InputError, match="take too much memory"):
        cvi.simulate(scene, duration=1e9, dt=1e-3)
