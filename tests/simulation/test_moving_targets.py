"""Steps of dt="auto" follow the moving references of servos, and forces given in Python, at their stages."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import contactvi as cvi
from helpers.loop_scenes import arm_scene, wheel_scenes

TABLE = """<robot name="table">
<link name="world"/><joint name="slide" type="prismatic"><parent link="world"/><child link="plate"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="1e6" velocity="1e6"/></joint>
<link name="plate"><inertial><mass value="3"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="2 1 0.1"/></geometry></collision></link></robot>"""
KP, KD = np.array([60.0, 25.0]), np.array([2.0, 1.0])


def references(t: float) -> np.ndarray:
    """Positions and velocities of both joints."""
    return np.array(
        [0.6 * math.sin(4 * t), 0.3 * math.cos(7 * t), 2.4 * math.cos(4 * t), -2.1 * math.sin(7 * t)]
    )  # fmt: skip


def arm(**limits: float) -> cvi.Scene:
    scene = arm_scene(2, gravity=True)
    for name, kp, kd in zip(("j1", "j2"), KP, KD, strict=True):
        scene.set_servo(name, kp, kd)
    if limits:
        scene.set_actuator("j*", **limits)
    return scene


def arm_at_the_end(scene: cvi.Scene, q0: np.ndarray, v0: np.ndarray, effort: float = math.inf) -> np.ndarray:
    """Return q after a second by DOP853 and Pinocchio's forward dynamics; kinks by short steps."""
    model = scene.model
    data = model.createData()

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        goal = references(t)
        tau = np.clip(KP * (goal[:2] - x[:2]) + KD * (goal[2:] - x[2:]), -effort, effort)
        return np.concatenate([x[2:], pin.aba(model, data, x[:2], x[2:], tau - model.damping * x[2:])])

    start = np.concatenate([q0, v0])
    found = solve_ivp(rate, (0.0, 1.0), start, method="DOP853", rtol=1e-13, atol=1e-13, max_step=2e-3)
    return found.y[:2, -1]


@pytest.mark.parametrize("effort", [math.inf, 9.0])
@pytest.mark.parametrize("tol", [1e-4, 1e-8])
def test_an_arm_that_follows_meets_the_accuracy(effort, tol):
    scene = arm() if effort == math.inf else arm(effort=effort)
    q0, v0 = np.array([-0.5, 0.3]), np.array([2.0, -1.0])
    exact = arm_at_the_end(scene, q0, v0, effort)
    traj = cvi.simulate(scene, q0, v0, duration=1.0, dt="auto", tol=tol, target=references)
    assert (traj.stats.switches > 0) == (effort < math.inf)
    assert traj.error_estimate <= tol
    assert np.abs(traj.q[-1] - exact).max() <= 3.0 * traj.error_estimate + 1e-11
    assert len(traj.t) < 200
    # Some 10 N m over an error of q below tol/10.
    assert np.abs(traj.ledger.energy_balance).max() < tol


def test_targets_of_the_scene_and_of_the_call_are_one():
    q0 = np.array([-0.5, 0.3])
    runs = [cvi.simulate(arm(), q0, duration=0.5, dt="auto", target=references)]
    own = arm_scene(2, gravity=True)
    for k, (name, kp, kd) in enumerate(zip(("j1", "j2"), KP, KD, strict=True)):
        own.set_servo(name, kp, kd, target=lambda t, k=k: (*references(t)[k::2], 0.0))
    runs.append(cvi.simulate(own, q0, duration=0.5))  # dt = "auto" by default
    signals = {f"j{k + 1}": lambda t, k=k: (*references(t)[k::2], 0.0) for k in range(2)}
    runs.append(cvi.simulate(arm(), q0, duration=0.5, target=signals))
    several = cvi.simulate_batch(arm(), q0[None], duration=0.5, dt="auto", target=references, keep="runs")
    runs.append(several[0])
    for traj in runs:
        assert traj.options.auto
        assert np.array_equal(traj.q, runs[0].q)


def test_steps_of_one_length_converge_to_it():
    """References that are constant over a step of length h are off by h/2 on average: order 1."""
    q0 = np.array([-0.5, 0.3])
    close = cvi.simulate(arm(), q0, duration=0.5, dt="auto", tol=1e-10, target=references).q[-1]
    errors = [
        np.abs(cvi.simulate(arm(), q0, duration=0.5, dt=dt, order=4, target=references).q[-1] - close).max()
        for dt in (2e-3, 1e-3)
    ]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("effort", [None, 0.95])
def test_a_wheel_is_led_over_many_revolutions(effort):
    """A continuous joint, q = (cos, sin), as a revolute one: the reference goes on through half revolutions."""
    ends = []
    for scene in wheel_scenes():
        scene.set_servo("wheel", kp=20.0, kd=0.8, effort=effort)
        motion = {"wheel": lambda t: (20.0 * t + math.sin(5.0 * t), 20.0 + 5.0 * math.cos(5.0 * t), 0.0)}
        traj = cvi.simulate(scene, v0=[25.0], duration=2.0, dt="auto", tol=1e-8, target=motion)
        assert traj.error_estimate <= 1e-8
        assert (traj.stats.switches > 0) == (effort is not None)
        ends.append(traj.q[-1])
    # Two runs that are each off by 1e-8 at most.
    assert ends[0] == pytest.approx([np.cos(ends[1][0]), np.sin(ends[1][0])], abs=2e-8)


def test_a_box_on_a_driven_table_sticks_and_slips(tmp_path):
    """A servo shakes a table; a box on it is held by friction up to mu g, slips beyond it, and sticks again."""
    table, box, mu, g, kp, kd = 3.0, 1.0, 0.3, 9.81, 400.0, 10.0

    def goal(t: float) -> tuple[float, float, float]:
        return 0.04 * (1 - math.cos(9.0 * t)), 0.36 * math.sin(9.0 * t), 3.24 * math.cos(9.0 * t)

    path = tmp_path / "table.urdf"
    path.write_text(TABLE)
    scene = cvi.Scene()
    scene.add_urdf(path)
    scene.add_box("box", (0.2, 0.2, 0.1), mass=box)
    scene.set_contact(friction=mu, restitution=0.0)
    scene.set_servo("slide", kp, kd, target=goal)
    q0 = scene.neutral()
    q0[3] = 0.1
    traj = cvi.simulate(scene, q0, duration=1.0, dt="auto", tol=1e-8)

    def servo(t: float, x: float, v: float) -> float:
        return kp * (goal(t)[0] - x) + kd * (goal(t)[1] - v)

    # Either both move as one, or the box with mu g against its slip; x = (table, box, their speeds).
    def rate(t: float, x: np.ndarray, slip: float, begin: float) -> list[float]:
        if slip == 0.0:
            a = servo(t, x[0], x[2]) / (table + box)
            return [x[2], x[3], a, a]
        return [x[2], x[3], (servo(t, x[0], x[2]) + mu * box * g * slip) / table, -mu * g * slip]

    def ends(t: float, x: np.ndarray, slip: float, begin: float) -> float:
        if slip == 0.0:
            return mu * g - abs(servo(t, x[0], x[2])) / (table + box)
        return (x[3] - x[2]) * slip + (1e-12 if t - begin < 1e-6 else 0.0)  # it begins with none

    ends.terminal, ends.direction = True, -1.0
    state, t, slip = np.zeros(4), 0.0, 0.0
    while t < 1.0:
        found = solve_ivp(
            rate, (t, 1.0), state, "DOP853", rtol=1e-12, atol=1e-13, events=ends, max_step=1e-2, args=(slip, t)
        )  # fmt: skip
        t, state = found.t[-1], found.y[:, -1]
        if slip != 0.0:
            state[3] = state[2]
        force = servo(t, state[0], state[2]) / (table + box)
        slip = 0.0 if slip != 0.0 and abs(force) <= mu * g else -math.copysign(1.0, force)
    assert traj.error_estimate <= 1e-8
    assert traj.q[-1][:2] == pytest.approx(state[:2], abs=3.0 * max(traj.error_estimate, 1e-9))


def test_what_is_given_by_steps_has_no_place_between_them():
    for given in (
        {"control": np.zeros((1, 2))},
        {"target": np.zeros((5, 2))},
        {"control": lambda t, q, v: np.zeros(2)},
    ):
        for call in (cvi.simulate, cvi.simulate_batch):
            with pytest.raises(cvi.InputError, match="constant over a step"):
                call(arm(), duration=0.5, dt="auto", **given)
    assert cvi.simulate(arm(), duration=0.1, target=[0.1, 0.2]).options.auto  # constant


def test_what_a_reference_raises_comes_through():
    def broken(t: float) -> list[float]:
        return [0.1, 1.0 / max(0.0, 0.3 - t)]

    with pytest.raises(cvi.UserFunctionError, match="ZeroDivisionError"):
        cvi.simulate(arm(), duration=0.5, dt="auto", target=broken)

    def stopped(t: float) -> list[float]:
        if t > 0.2:
            raise KeyboardInterrupt
        return [0.1, 0.2]

    traj = cvi.simulate(arm(), duration=0.5, dt="auto", target=stopped, throw=False)
    assert traj.status.code == cvi.StatusCode.INTERRUPTED


def test_forces_given_in_python_have_the_order():
    """A law of PD as a function of the user, without the servo that knows it."""
    q0, v0 = np.array([-0.5, 0.3]), np.array([2.0, -1.0])
    scene = arm_scene(2, gravity=True)

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return KP * (references(t)[:2] - q) + KD * (references(t)[2:] - v)

    scene.add_force(force, lambda t, q, v: (-np.diag(KP), -np.diag(KD)))
    exact = arm_at_the_end(scene, q0, v0)
    for tol in (1e-4, 1e-8):
        traj = cvi.simulate(scene, q0, v0, duration=1.0, tol=tol)
        assert traj.options.auto
        assert traj.error_estimate <= tol
        assert np.abs(traj.q[-1] - exact).max() <= 3.0 * traj.error_estimate + 1e-11
