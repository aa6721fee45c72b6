"""The efforts of servos and inputs at the nodes: their work is that of the ledger, and they keep their limits."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import contactvi as cvi
from helpers.loop_scenes import arm_scene

PENDULUM = "models/damped_pendulum.urdf"


def servo_scene(**limits) -> cvi.Scene:
    scene = arm_scene(2, gravity=True)
    scene.set_servo("j*", 40.0, 3.0, effort=limits.pop("servo_effort", None))
    if limits:
        scene.set_actuator("j*", **limits)
    return scene


def work_of(traj: cvi.Trajectory) -> float:
    """The integral of the power by the trapezoidal rule, O(dt^2)."""
    joints = traj.efforts().joints
    power = sum(traj.effort(joint) * traj.v[:, traj.scene.v_index(joint).start] for joint in joints)
    return float(np.sum(np.diff(traj.t) * 0.5 * (power[1:] + power[:-1])))


def reach(t: float) -> np.ndarray:
    return np.array([np.sin(2.0 * t), 0.5 * np.cos(3.0 * t)])


@pytest.mark.parametrize(
    "run",
    [
        {"order": 4, "target": [0.7, -0.4]},
        {"order": 4, "control": lambda t, q, v: np.array([2.0, -v[1]])},
        {"order": 4, "target": reach, "control": np.array([1.0, 0.5])},
        {"order": 2, "target": {"j1": 0.5}},
    ],
)
def test_their_work_is_that_of_the_ledger(run):
    """References and inputs are constant over a step, so that the trapezoidal rule errs by O(dt): it halves with dt."""
    scene = servo_scene()
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        traj = cvi.simulate(scene, duration=0.8, dt=dt, **run)
        errors.append(abs(work_of(traj) - traj.work.input[-1]))
    scale = np.ptp(traj.work.input)
    assert errors[2] < 1e-2 * scale
    assert errors[2] < 0.6 * errors[0]


def test_a_moving_target_of_an_adaptive_run():
    """Steps of "auto" follow it at their stages: only the trapezoidal rule errs, with the square of the sampling."""
    scene = servo_scene()
    runs = [cvi.simulate(scene, duration=0.8, tol=1e-8, target=reach, sample_dt=dt) for dt in (1e-3, 5e-4)]
    coarse, fine = (abs(work_of(traj) - traj.work.input[-1]) for traj in runs)
    assert 3.5 < coarse / fine < 4.5


def test_limits_of_effort_and_speed_are_kept():
    scene = servo_scene(servo_effort=5.0)
    traj = cvi.simulate(scene, duration=0.5, dt=1e-3, target=[1.5, -1.0])
    values = traj.efforts().values
    assert np.abs(values).max() == 5.0
    assert (np.abs(values) < 5.0).any()
    scene = servo_scene(velocity=1.0)
    traj = cvi.simulate(scene, duration=0.3, dt=1e-4, target=[1.5, -1.0])
    fast = np.abs(traj.v) >= 1.0
    assert fast.any()
    assert (traj.efforts().values * traj.v)[fast].max() <= 0.0


def test_a_continuous_joint_goes_the_shorter_way():
    scene = cvi.Scene(gravity=(0, 0, 0))
    scene.add_urdf(PENDULUM)
    scene.set_servo("hinge", kp=10.0, kd=0.0)
    q0 = scene.configuration({"hinge": 3.0})
    traj = cvi.simulate(scene, q0, duration=0.01, dt=1e-3, target=[-3.0])
    assert traj.effort("hinge")[0] == pytest.approx(10.0 * (2.0 * np.pi - 6.0), rel=1e-12)


def test_steps_of_a_simulator():
    """What each step is asked for, at the node where it begins."""
    scene = servo_scene()
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset(t=0.5)
    asked = [0.1 * k for k in range(6)]
    for target in asked:
        sim.step(target=[target, 0.0])
    sim.run(3, tau=[1.0, 0.0])
    traj = sim.trajectory()
    at = [*asked, traj.q[0, 0], traj.q[0, 0], traj.q[0, 0], traj.q[0, 0]]
    wanted = 40.0 * (np.array(at) - traj.q[:, 0]) - 3.0 * traj.v[:, 0] + np.array([0.0] * 6 + [1.0] * 4)
    assert np.allclose(traj.effort("j1"), wanted, rtol=0.0, atol=1e-12)
    sim.load(sim.save())
    assert np.array_equal(sim.trajectory().effort("j1"), traj.effort("j1"))


def test_they_are_kept_in_files_and_pickles(tmp_path):
    traj = cvi.simulate(servo_scene(), duration=0.2, dt=1e-2, target=lambda t: reach(t))
    other = pickle.loads(pickle.dumps(cvi.simulate(servo_scene(), duration=0.2, dt=1e-2, target=lambda t: reach(t))))
    loaded = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    for kept in (other, loaded, cvi.Trajectory.load(loaded.save(tmp_path / "again.npz"))):
        assert np.array_equal(kept.effort("j2"), traj.effort("j2"))
    table = loaded.table("efforts")
    assert list(table.columns) == ["t", "j1", "j2"]
    assert table.units["j1"] == "N m"
    names = [path.name for path in loaded.to_csv(tmp_path / "tables")]
    assert "efforts.csv" in names


def test_an_input_alone_and_none_at_all(tmp_path):
    scene = arm_scene(2, gravity=True)
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2, control=[0.0, 2.0])
    assert list(traj.efforts().joints) == ["j2"]
    assert np.all(traj.effort("j2") == 2.0)
    with pytest.raises(cvi.InputError, match="Nothing drives joint 'j1'"):
        traj.effort("j1")
    limp = cvi.simulate(scene, duration=0.1, dt=1e-2)
    assert not limp.drives
    assert "efforts.csv" not in [path.name for path in limp.to_csv(tmp_path / "tables")]
    with pytest.raises(cvi.InputError, match="set_servo"):
        limp.effort("j1")


def test_inputs_that_were_not_kept():
    sim = cvi.Simulator(arm_scene(2, gravity=True), dt=1e-3)
    sim.reset()
    sim.step([1.0, 0.0])  # which the engine records by itself
    with pytest.raises(cvi.InputError, match="inputs of the run were not kept"):
        sim.trajectory().effort("j1")
    last = cvi.Simulator(servo_scene(), dt=1e-3, record=5)
    last.reset()
    last.run(10)
    assert not last.trajectory().drives
    with pytest.raises(cvi.InputError, match="inputs of the run were not kept"):
        last.trajectory().effort("j1")
