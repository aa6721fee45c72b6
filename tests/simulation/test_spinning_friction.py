"""Friction against spinning and rolling: balls that spin down, roll to a stop, slide and spin; the tippe top."""

from __future__ import annotations

import math
import pickle

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.contact_models import geometry, halfspace, place
from helpers.persistent_runs import changes
from oracles import tippe_top
from oracles.rolling_spinning import GRAVITY, SlidingSpin, roll_line, rolling_stop, spin_down

RADIUS = 0.05


def ball(mu=0.3, slope=0.0, gravity=GRAVITY, **radii) -> tuple[cvi.Scene, np.ndarray]:
    """A ball of 1 kg that touches a plane; down the slope is +x."""
    scene = cvi.Scene(gravity=(gravity * math.sin(slope), 0.0, -gravity * math.cos(slope)))
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=0.0, friction=mu, **radii)
    return scene, np.array([0.0, 0.0, RADIUS, 0.0, 0.0, 0.0, 1.0])


def yaw(traj: cvi.Trajectory, k: int = -1) -> float:
    """Angle about the vertical of a ball that turns about it alone, in (-pi, pi]."""
    return 2.0 * math.atan2(traj.q[k, 5], traj.q[k, 6])


def world_motion(traj: cvi.Trajectory, k: int = -1) -> tuple[np.ndarray, np.ndarray]:
    """(v, omega) in the world; that of the engine's output is in the body."""
    R = pin.Quaternion(traj.q[k, 3:7]).matrix()
    return R @ traj.v[k, :3], R @ traj.v[k, 3:]


@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_ball_spins_down(dt):
    """The torque is constant: the motion is exact, the stop is located, and the ball stands still afterwards."""
    drill, spin = 0.002, 3.0
    scene, q = ball(spinning_radius=drill)
    traj = cvi.simulate(scene, q, [0, 0, 0, 0, 0, spin], 0.8, dt, order=2)
    rate, stop, angle = spin_down(spin, 0.3, drill, RADIUS)
    moving = traj.t < stop - 1e-9
    assert traj.v[moving, 5] == pytest.approx(spin - rate * traj.t[moving], abs=1e-10)
    (stuck,) = changes(traj, "stick")
    assert stuck.time == pytest.approx(stop, abs=1e-9)
    assert yaw(traj) == pytest.approx(angle, abs=1e-9)
    rest = traj.t > stop + dt
    assert np.abs(traj.v[rest]).max() <= 1e-12
    assert np.ptp(traj.q[rest], axis=0).max() <= 1e-13
    loss = 0.5 * 0.4 * RADIUS**2 * spin**2
    assert traj.contacts.array("work").sum() == pytest.approx(-loss, rel=1e-9)
    assert traj.contacts.array("work").max() <= 1e-16


def test_without_radii_it_spins_on():
    scene, q = ball()
    traj = cvi.simulate(scene, q, [0, 0, 0, 0, 0, 3.0], 0.2, 0.01, order=2)
    assert traj.v[-1, 5] == pytest.approx(3.0, abs=1e-13)


@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_ball_rolls_to_a_stop(dt):
    """Rolling friction stops a ball that rolls, exactly where the closed form says, and holds it there."""
    v, rho = 0.05, 0.001
    scene, q = ball(rolling_radius=rho)
    traj = cvi.simulate(scene, q, [v, 0, 0, 0, v / RADIUS, 0], 0.6, dt, order=2)
    slowing, stop, distance = rolling_stop(v, rho, RADIUS)
    half = np.searchsorted(traj.t, 0.5 * stop)
    assert world_motion(traj, half)[0][0] == pytest.approx(v - slowing * traj.t[half], abs=1e-10)
    assert traj.q[-1, 0] == pytest.approx(distance, abs=1e-9)
    rest = traj.t > stop + dt
    assert np.abs(traj.v[rest]).max() <= 1e-12
    assert np.ptp(traj.q[rest], axis=0).max() <= 1e-13
    assert traj.contacts.array("work").sum() == pytest.approx(-0.5 * 1.4 * v**2, rel=1e-9)


@pytest.mark.parametrize(("slope", "holds"), [(0.0199, True), (0.0201, False)])
def test_slope(slope, holds):
    """A ball stands on a slope of less than rolling radius over radius, and rolls down one that is steeper."""
    rho = RADIUS * math.tan(0.02)
    scene, q = ball(slope=slope, rolling_radius=rho)
    traj = cvi.simulate(scene, q, np.zeros(6), 0.5, 0.01, order=2)
    if holds:
        assert np.abs(traj.q[-1, :3] - q[:3]).max() <= 1e-14
        assert np.abs(traj.v).max() <= 1e-14
    else:
        normal, along = GRAVITY * math.cos(slope), GRAVITY * math.sin(slope)
        expected = 0.5 * (along - rho * normal / RADIUS) / 1.4 * 0.5**2
        assert traj.q[-1, 0] == pytest.approx(expected, abs=1e-10)


def test_rolls_up_and_down_a_slope():
    """Slides, rolls up a slope, turns back and rolls down: constant forces between events."""
    rho, slope = 0.002, 0.2
    pieces = roll_line(-1.0, 0.0, 0.3, rho, RADIUS, slope=slope)
    scene, q = ball(slope=slope, rolling_radius=rho)
    traj = cvi.simulate(scene, q, [-1.0, 0, 0, 0, 0, 0], 1.5, 0.005, order=2)
    last = [piece for piece in pieces if piece.t <= 1.5][-1]
    x, v, _, w = last.at(1.5)
    found_v, found_w = world_motion(traj)
    # The step in which the ball turns back is O(h^2) wrong in place, all else is exact between located events.
    assert traj.q[-1, 0] == pytest.approx(x, abs=1e-4)
    assert [found_v[0], found_w[1]] == pytest.approx([v, w], abs=2e-3)


def test_sliding_and_spinning_ball_converges_at_order_2():
    """Slip and spin in one ball: both come to rest at the same instant."""
    v, omega, drill = np.array([0.4, 0.1]), np.array([0.0, 2.0, 30.0]), 0.01
    truth = SlidingSpin(v, omega, 0.3, drill, RADIUS)
    scene, q = ball(spinning_radius=drill)
    t, errors = 0.2, []
    assert t < truth.stop_time()
    x, v_t, omega_t = truth.state(t)
    for dt in (0.02, 0.01, 0.005):
        traj = cvi.simulate(scene, q, [*v, 0.0, *omega], t, dt, order=2)
        found_v, found_w = world_motion(traj)
        errors.append(
            max(
                np.abs(traj.q[-1, :2] - x).max(),
                np.abs(found_v[:2] - v_t).max(),
                np.abs(found_w - omega_t).max() * RADIUS,
            )
        )
    assert errors[-1] <= 1e-4
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0
    stop = truth.stop_time()
    assert stop < 1.15
    traj = cvi.simulate(scene, q, [*v, 0.0, *omega], 1.2, 0.005, order=2)
    (stuck,) = changes(traj, "stick")
    assert stuck.time == pytest.approx(stop, abs=1e-3)


def test_impact_of_a_spinning_ball():
    """A plastic impact slows the spin by mu r_s times the normal impulse."""
    drill, mu, spin, fall = 0.004, 0.3, 40.0, 1.0
    scene, q = ball(mu, gravity=0.0, spinning_radius=drill)
    q[2] += 0.01
    traj = cvi.simulate(scene, q, [0, 0, -fall, 0, 0, spin], 0.02, 0.005, order=2)
    assert traj.v[-1, 5] == pytest.approx(spin - mu * drill * fall / (0.4 * RADIUS**2), abs=1e-12)
    assert traj.events[0].loss == pytest.approx(
        0.5 * fall**2 + 0.2 * RADIUS**2 * (spin**2 - traj.v[-1, 5] ** 2), rel=1e-12
    )


def test_bounce_of_a_rolling_ball():
    """An elastic impact lets no more than r_r times its impulse turn against rolling; it gains no energy."""
    rho, spin = 0.001, 40.0
    scene, q = ball(0.5, rolling_radius=rho)
    scene.set_contact(restitution=1.0)
    q[2] += 0.01
    traj = cvi.simulate(scene, q, [spin * RADIUS, 0, -1.0, 0, spin, 0], 0.02, 0.005, order=2)
    event = traj.events[0]
    v, w = world_motion(traj)
    # Poisson: twice the impulse of the compression, friction keeps the ball rolling, the torque is at its bound.
    push, torque = event.impulse_vector[0], rho * event.impulse
    assert w[1] == pytest.approx(spin - (torque + RADIUS * push) / (0.4 * RADIUS**2), abs=1e-10)
    assert v[0] == pytest.approx(RADIUS * w[1], abs=1e-12)
    assert event.loss > 0.0


def top_scene() -> tuple[cvi.Scene, tippe_top.Top]:
    """The tippe top of Leine and Glocker: a body with two spheres on a plane."""
    top = tippe_top.Top()
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -tippe_top.GRAVITY])
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), place(), "top")
    model.appendBodyToJoint(joint, pin.Inertia(top.mass, np.zeros(3), np.diag([top.i1, top.i1, top.i3])), place())
    spheres = zip(("body", "stem"), top.a, top.r, strict=True)
    shapes = {name: (joint, place(z=a), coal.Sphere(r)) for name, a, r in spheres}
    shapes["ground"] = (0, place(), halfspace(0.0, 0.0, 1.0, 0.0))
    collision = geometry(shapes, [("ground", "body"), ("ground", "stem")])
    scene = cvi.Scene.from_pinocchio(model, collision)
    scene.set_contact(restitution=0.0, friction=top.mu, spinning_radius=top.drill)
    return scene, top


def spin_top(t: float, dt: float, **options) -> cvi.Trajectory:
    scene, top = top_scene()
    tilt = pin.exp3(np.array([0.1, 0.0, 0.0]))
    q = np.array([0.0, 0.0, top.r[0] - top.a[0] * math.cos(0.1), *pin.Quaternion(tilt).coeffs()])
    return cvi.simulate(scene, q, [0, 0, 0, 0, 0, 180.0], t, dt, **{"order": 2, **options})


def inclination(traj: cvi.Trajectory, k: int = -1) -> float:
    e = pin.Quaternion(traj.q[k, 3:7]).matrix()[:, 2]
    return math.atan2(math.hypot(e[0], e[1]), e[2])


def test_tippe_top_converges_at_order_2():
    """Of the reference (located events, rtol 1e-12): inclination .5180101458 at half a second."""
    errors = [abs(inclination(spin_top(0.5, dt)) - 0.5180101458) for dt in (4e-4, 2e-4, 1e-4)]
    assert errors[-1] <= 1e-3
    assert errors[0] / errors[1] > 3.0
    assert errors[1] / errors[2] > 3.0


@pytest.mark.slow
def test_tippe_top_inverts():
    """It turns over, the stem touches at 1.3710432514 s, and it spins on the stem."""
    traj = spin_top(1.5, 1e-4)
    touches = [c.time for c in changes(traj, "begin") if "stem" in c.pair]
    at_one = int(np.searchsorted(traj.t, 1.0 - 1e-9))
    assert inclination(traj, at_one) == pytest.approx(1.5725914174, abs=2e-3)
    assert touches[0] == pytest.approx(1.3710432514, abs=1e-3)
    assert inclination(traj) == pytest.approx(3.0725365158, abs=2e-3)
    assert np.diff(traj.energy).max() <= 1e-9


def test_dt_auto_and_higher_orders_leave_it_to_contact_steps():
    drill, spin = 0.002, 3.0
    scene, q = ball(spinning_radius=drill)
    rate = spin_down(spin, 0.3, drill, RADIUS)[0]
    for options in ({"dt": "auto"}, {"dt": 0.01, "order": 6}):
        traj = cvi.simulate(scene, q, [0, 0, 0, 0, 0, spin], 0.3, **options)
        assert traj.v[-1, 5] == pytest.approx(spin - rate * 0.3, abs=1e-9)
        assert traj.stats.contact_steps > 0


def dense(scene, q, v, duration: float, dt: float) -> cvi.Trajectory:
    traj = cvi.simulate(scene, q, v, duration, dt, contact_mode="steps")
    assert traj.status.ok
    assert traj.ledger.dense_residual.max() <= 1e-4
    assert traj.ledger.dense_energy_rise.max() <= 0.0
    return traj


@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_ball_spins_down_in_dense_steps(dt):
    """The torque is constant, so that only the step in which the ball stops is wrong, by its torque times h^2."""
    drill, spin = 0.002, 3.0
    scene, q = ball(spinning_radius=drill)
    traj = dense(scene, q, [0, 0, 0, 0, 0, spin], 0.8, dt)
    rate, stop, angle = spin_down(spin, 0.3, drill, RADIUS)
    moving = traj.t < stop - dt
    assert traj.v[moving, 5] == pytest.approx(spin - rate * traj.t[moving], abs=1e-7)
    assert yaw(traj) == pytest.approx(angle, abs=rate * dt**2)
    rest = traj.t > stop + dt
    assert np.abs(traj.v[rest]).max() <= 1e-7


@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_ball_rolls_to_a_stop_in_dense_steps(dt):
    v, rho = 0.05, 0.001
    scene, q = ball(rolling_radius=rho)
    traj = dense(scene, q, [v, 0, 0, 0, v / RADIUS, 0], 0.6, dt)
    slowing, stop, distance = rolling_stop(v, rho, RADIUS)
    half = np.searchsorted(traj.t, 0.5 * stop)
    assert world_motion(traj, half)[0][0] == pytest.approx(v - slowing * traj.t[half], abs=1e-7)
    assert traj.q[-1, 0] == pytest.approx(distance, abs=slowing * dt**2)
    assert np.abs(traj.v[traj.t > stop + dt]).max() <= 1e-7


@pytest.mark.parametrize(("slope", "holds"), [(0.0195, True), (0.0205, False)])
def test_slope_in_dense_steps(slope, holds):
    rho = RADIUS * math.tan(0.02)
    scene, q = ball(slope=slope, rolling_radius=rho)
    traj = dense(scene, q, np.zeros(6), 0.5, 0.01)
    expected = 0.0
    if not holds:
        normal, along = GRAVITY * math.cos(slope), GRAVITY * math.sin(slope)
        expected = 0.5 * (along - rho * normal / RADIUS) / 1.4 * 0.5**2
    assert traj.q[-1, 0] == pytest.approx(expected, abs=1e-7)


def test_sliding_and_spinning_ball_in_dense_steps():
    """Slip and spin in one ball, whose direction turns: of order 1, since each impulse of a step has its own one."""
    v, omega, drill = np.array([0.4, 0.1]), np.array([0.0, 2.0, 30.0]), 0.01
    truth, t, errors = SlidingSpin(v, omega, 0.3, drill, RADIUS), 0.2, []
    scene, q = ball(spinning_radius=drill)
    x, v_t, omega_t = truth.state(t)
    for dt in (0.02, 0.01, 0.005):
        traj = dense(scene, q, [*v, 0.0, *omega], t, dt)
        found_v, found_w = world_motion(traj)
        errors.append(
            max(np.abs(traj.q[-1, :2] - x).max(), np.abs(found_v[:2] - v_t).max(), np.abs(found_w - omega_t).max())
        )
    assert 3.0 < errors[0] / errors[2] < 5.0
    assert errors[2] <= 1e-2


def test_turntable_takes_the_spin_along_in_dense_steps():
    """What the surface puts in is in the ledger: the balance of energy of a dense step knows its work."""
    drill, turn = 0.002, 3.0
    scene, q = ball(spinning_radius=drill)
    scene.set_surface_velocity("ground", angular=(0.0, 0.0, turn))
    traj = dense(scene, q, np.zeros(6), 0.8, 0.01)
    rate, stop, _ = spin_down(turn, 0.3, drill, RADIUS)
    before = traj.t < stop - 0.01
    assert traj.v[before, 5] == pytest.approx(rate * traj.t[before], abs=1e-7)
    assert traj.v[traj.t > stop + 0.01, 5] == pytest.approx(turn, abs=1e-7)


def test_impact_of_a_spinning_ball_in_a_dense_step():
    """A plastic impact inside of a step slows the spin by mu r_s times the normal impulse."""
    drill, mu, spin, fall = 0.004, 0.3, 40.0, 1.0
    scene, q = ball(mu, gravity=0.0, spinning_radius=drill)
    q[2] += 0.01
    traj = cvi.simulate(scene, q, [0, 0, -fall, 0, 0, spin], 0.02, 0.005, contact_mode="steps")
    assert traj.v[-1, 5] == pytest.approx(spin - mu * drill * fall / (0.4 * RADIUS**2), abs=1e-6)


def pile(seed: int, **radii) -> tuple[cvi.Scene, np.ndarray]:
    """Balls and boxes that fall on a plane and on each other."""
    rng, scene = np.random.default_rng(seed), cvi.Scene()
    scene.add_halfspace(name="ground")
    q = []
    for k in range(12):
        if k % 3 == 2:
            scene.add_box(f"b{k}", (0.08, 0.08, 0.08))
        else:
            scene.add_sphere(f"b{k}", 0.05)
        turn = rng.normal(size=4)
        q += [*(0.04 * rng.normal(size=2)), 0.08 + 0.12 * k, *(turn / np.linalg.norm(turn))]
    scene.set_contact(restitution=0.0, friction=0.6, **radii)
    return scene, np.array(q)


def spread(traj: cvi.Trajectory) -> float:
    return float(np.hypot(traj.q[-1, 0::7], traj.q[-1, 1::7]).mean())


def test_heap_comes_to_rest():
    """With friction against rolling the balls of a heap stop; without they roll away. The energy only falls."""
    speeds, spreads = [], []
    for radii in ({"spinning_radius": 0.01, "rolling_radius": 0.005}, {}):
        scene, q = pile(3, **radii)
        traj = cvi.simulate(scene, q, None, 3.0, 0.005, contact_mode="steps")
        assert traj.status.ok
        assert traj.ledger.dense_energy_rise.max() <= 1e-6
        speeds.append(np.abs(traj.v[-1]).max())
        spreads.append(spread(traj))
    assert speeds[0] <= 1e-3
    assert speeds[1] > 0.1
    assert spreads[0] < spreads[1]


def test_auto_goes_over_to_dense_steps_and_back():
    scene, q = pile(4, spinning_radius=0.01, rolling_radius=0.005)
    traj = cvi.simulate(scene, q, None, 3.5, 0.005)
    assert traj.status.ok
    assert traj.stats.dense_steps > 0
    assert np.abs(traj.v[-1]).max() <= 1e-3


def test_no_derivative_in_dense_steps():
    scene, q = ball(spinning_radius=0.002)
    traj = cvi.simulate(scene, q, [0, 0, 0, 0, 0, 3.0], 0.05, 0.01, contact_mode="steps", record="gradient")
    with pytest.raises(cvi.NotDifferentiable, match="spinning or rolling"):
        traj.sensitivity()


def test_refused():
    scene, q = ball(spinning_radius=0.002)
    with pytest.raises(cvi.InputError, match="rolling_radius"):
        scene.set_contact(rolling_radius=-1.0)
    scene.set_contact(impact_process="incremental")
    with pytest.raises(cvi.SceneError, match="law of restitution"):
        scene.core()
    scene, _ = ball(0.0, rolling_radius=0.001)
    with pytest.raises(cvi.SceneError, match="none against slip"):
        scene.core()


def test_stored_and_in_scene_files(tmp_path):
    file = tmp_path / "ball.toml"
    file.write_text("""
[scene]
gravity = [0.0, 0.0, -9.81]
[[halfspace]]
name = "ground"
[[sphere]]
name = "ball"
radius = 0.05
xyz = [0.0, 0.0, 0.05]
[contact]
restitution = 0.0
friction = 0.3
rolling_radius = 0.5
[[contact.pair]]
a = "ground"
b = "ball"
spinning_radius = 0.002
rolling_radius = 0.001
""")
    scene = cvi.load_scene(file)
    assert "spinning radius 0.002, rolling radius 0.001" in str(scene.report)
    v = [0.05, 0, 0, 0, 1.0, 3.0]
    traj = cvi.simulate(scene, duration=0.1, dt=0.01, v0=v)
    traj.save(tmp_path / "run.npz")
    again = cvi.Trajectory.load(tmp_path / "run.npz")
    (law,) = again.scene.to_dict()["contact_laws"]
    assert (law["spinning_radius"], law["rolling_radius"]) == (0.002, 0.001)
    replayed = cvi.simulate(again.scene, traj.q[0], v, 0.1, 0.01)
    assert (replayed.q == traj.q).all()


def test_a_run_goes_on_with_the_same_digits():
    """Spin, roll and their forces are part of the state."""
    scene, q = ball(spinning_radius=0.01, rolling_radius=0.001)
    start = [0.4, 0.1, 0.0, 0.0, 2.0, 30.0]
    whole = cvi.simulate(scene, q, start, 0.1, 0.01, order=2)
    simulator = cvi.Simulator(scene, dt=0.01, order=2)
    simulator.reset(q, start)
    for _ in range(5):
        simulator.step()
    other = cvi.Simulator.of(pickle.loads(pickle.dumps(simulator.save())))
    for _ in range(5):
        other.step()
    assert (other.q == whole.q[-1]).all()


def test_turntable_takes_the_spin_along():
    """The spin is counted from that of the surface: a ball at rest on a turntable is turned until it turns along."""
    drill, turn = 0.002, 3.0
    scene, q = ball(spinning_radius=drill)
    scene.set_surface_velocity("ground", angular=(0.0, 0.0, turn))
    traj = cvi.simulate(scene, q, np.zeros(6), 0.8, 0.01, order=2)
    rate, stop, _ = spin_down(turn, 0.3, drill, RADIUS)
    before = traj.t < stop - 1e-9
    assert traj.v[before, 5] == pytest.approx(rate * traj.t[before], abs=1e-10)
    assert traj.v[traj.t > stop + 0.01, 5] == pytest.approx(turn, abs=1e-12)
