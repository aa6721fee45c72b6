"""The dense step by itself: what it promises about momentum, friction of joints, points that come in, and its state."""

from __future__ import annotations

import warnings

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.run_scenes import funnel


def run(scene: cvi.Scene, v: np.ndarray, duration: float, **options) -> cvi.Trajectory:
    return cvi.simulate(scene, scene.neutral(), v, duration, dt=1e-3, **{"contact_mode": "steps", **options})


def row_of_balls(gaps: tuple[float, ...]) -> tuple[cvi.Scene, np.ndarray]:
    """Balls of 0.1 m radius along x without gravity, the first one at 20 m/s; gaps between them [m]."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    x = 0.0
    for k, gap in enumerate((0.0, *gaps)):
        x += gap + (0.2 if k else 0.0)
        scene.add_sphere(f"ball{k}", radius=0.1, mass=1.0 + k, placement=(x, 0.0, 0.0))
    scene.set_contact(restitution=0.0, friction=0.5)
    v = np.zeros(scene.nv)
    v[0] = 20.0
    return scene, v


@pytest.mark.parametrize("gap", [1e-3, 5e-3, 8e-3, 1.5e-2])
def test_a_blow_that_brings_a_pair_within_reach(gap):
    """The second ball is at rest until the first one hits it, so the pair behind it is found within the step only.

    A point of that pair has an impulse only where it closes: its normal is a unit vector, and the momentum stays.
    """
    scene, v = row_of_balls((5e-3, gap))
    traj = run(scene, v, 5e-3)
    assert traj.status.ok
    momentum = traj.ledger.linear_momentum
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(momentum), 1)), atol=1e-13 * 20.0)
    np.testing.assert_allclose(np.linalg.norm(traj.contacts.array("normal"), axis=1), 1.0, atol=1e-14)
    centers = traj.q[:, [0, 7, 14]] + np.cumsum([0.0, 0.205, 0.2 + gap]) - traj.q[0, [0, 7, 14]]
    assert np.diff(centers, axis=1).min() >= 0.2 - 1e-9


SLIDER = """<robot name="slider"><link name="base"/><link name="bar"/>
<link name="car"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="along" type="prismatic"><parent link="base"/><child link="bar"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="100" velocity="100"/></joint>
<joint name="across" type="prismatic"><parent link="bar"/><child link="car"/><axis xyz="0 1 0"/>
<limit lower="-0.01" upper="0.01" effort="100" velocity="100"/></joint></robot>"""


def test_friction_of_a_joint_keeps_its_bound_in_an_impact(tmp_path):
    """A car slides along a bar with friction and bounces off a limit across it: friction gives f h in every step."""
    bound = 30.0
    file = tmp_path / "slider.urdf"
    file.write_text(SLIDER)
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_urdf(file, limits=True)
    scene.set_joint("along", friction=bound)
    scene.set_joint("across", restitution=0.8)
    traj = run(scene, np.array([3.0, 3.0]), 8e-3)
    assert traj.status.ok
    assert traj.v[0, 1] == 3.0
    assert traj.v[-1, 1] == pytest.approx(-0.8 * 3.0, rel=1e-12)
    np.testing.assert_allclose(np.diff(traj.p[:, 0]), -bound * 1e-3, rtol=1e-12)


def test_a_snapshot_of_a_dense_phase_goes_on_with_the_same_digits():
    """In another simulator, which has made no dense step of its own, and over the return to located events."""
    scene = funnel()
    options = {"dt": 1e-3, "max_impacts_per_step": 200}  # so few that there are dense steps
    sim = cvi.Simulator(scene, **options)
    sim.reset()
    kept, dense = sim.save(), 0
    for _ in range(400):
        last, before = dense, sim.save()
        sim.step()
        dense = len(sim.trajectory().dense_steps)
        if 0 < dense == last:  # this step was the first one with located events again
            kept = before
            break
    assert 0 < dense == last
    for _ in range(20):
        sim.step()
    other = cvi.Simulator(scene, **options)
    other.load(kept)
    for _ in range(21):
        other.step()
    assert sim.t == other.t
    assert sim.q.tobytes() == other.q.tobytes()
    assert sim.p.tobytes() == other.p.tobytes()


def resting_boxes(contact_mode: str) -> cvi.Trajectory:
    """Seven boxes side by side at rest on the ground: more points than a run with located events keeps."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(7):
        scene.add_box(f"box{k}", size=(0.1, 0.1, 0.1), placement=(0.1 * k, 0.0, 0.05))
    scene.set_contact(friction=0.5)
    return cvi.simulate(scene, duration=0.02, dt="auto", contact_mode=contact_mode)


def test_auto_takes_dense_steps_where_a_fixed_step_would():
    with pytest.warns(cvi.DenseStepWarning):
        traj = resting_boxes("auto")
    assert traj.status.ok
    assert len(traj.dense_steps) > 0
    assert np.abs(traj.q - traj.q[0]).max() <= traj.error_estimate <= traj.options.tol


def test_auto_with_events_alone_takes_no_dense_steps():
    with warnings.catch_warnings():
        warnings.simplefilter("error", cvi.DenseStepWarning)
        traj = resting_boxes("events")
    assert len(traj.dense_steps) == 0
    assert np.abs(traj.q - traj.q[0]).max() <= traj.error_estimate <= traj.options.tol


def tilted_box(mode: str, dt: float) -> np.ndarray:
    """The end of a box that turns about its lower edge, which friction holds, before a face falls flat."""
    scene = cvi.Scene()
    scene.add_halfspace()
    angle, half = 0.5, np.array([0.1, 0.08, 0.15])
    turned = pin.rpy.rpyToMatrix(0.0, angle, 0.0)
    corners = turned @ np.array([[x, 0.0, z] for x in (-half[0], half[0]) for z in (-half[2], half[2])]).T
    scene.add_box("box", tuple(2.0 * half), placement=pin.SE3(turned, np.array([0.0, 0.0, -corners[2].min()])))
    scene.set_contact(restitution=0.0, friction=0.8)
    v = np.zeros(6)
    v[4] = 1.5  # about the edge that is down, which stays where it is
    v[:3] = -np.cross(v[3:], [half[0], 0.0, -half[2]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        traj = cvi.simulate(scene, scene.neutral(), v, duration=0.08, dt=dt, contact_mode=mode)
    assert traj.status.ok
    if mode == "steps":
        assert np.all(traj.dense_steps["energy_rise"] == 0.0)
    return traj.q[-1]


def test_friction_of_a_turning_body_is_of_second_order():
    """No impact lies inside of the steps: they converge to the run with located events like those of its contacts."""
    exact = tilted_box("events", 1e-4)
    errors = [np.abs(tilted_box("steps", dt) - exact).max() for dt in (4e-3, 2e-3, 1e-3)]
    assert errors[0] < 9.81 * 4e-3**2  # of the size of g h^2
    assert np.log2(errors[1] / errors[2]) > 1.9, errors
