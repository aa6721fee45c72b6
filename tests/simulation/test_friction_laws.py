"""Friction of belts, of rest and of slip speed, along axes, and adhesion, against oracles that know no engine."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import contactvi as cvi
from contactvi.verify import systems
from oracles import friction_laws as right

BOX = (0.2, 0.2, 0.1)
FLAT = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0])
MASS = 2.0
ORDERS = [(4, 0.01), (8, 0.02)]


def box_on_ground(mu: object = 0.5, **contact: object) -> cvi.Scene:
    """Return a box on a plane, which persists there."""
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_box("box", BOX, mass=MASS)
    scene.set_contact("ground", "box", friction=mu, restitution=0.0, **contact)
    return scene


def turning(factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Return R(angle) and its integral over the angle, of turns in the plane."""
    c, s = math.cos(factor), math.sin(factor)
    return np.array([[c, -s], [s, c]]), np.array([[s, c - 1.0], [1.0 - c, s]])


@pytest.mark.parametrize(("order", "dt"), ORDERS)
def test_a_belt_takes_a_box_along(order: int, dt: float) -> None:
    """A box slides until it has the belt's velocity, then goes with it; heat and the belt's work in closed form."""
    belt, v = np.array([1.0, 0.5]), np.array([-0.2, 0.3])
    time, place, heat, work = right.conveyor(v, belt, 0.5, MASS)
    scene = box_on_ground()
    scene.set_surface_velocity("ground", (*belt, 7.0))  # the velocity along the normal does not count
    run = cvi.simulate(scene, FLAT, [*v, 0.0, 0.0, 0.0, 0.0], duration=0.5, dt=dt, order=order)
    np.testing.assert_allclose(run.q[-1][:2], place + belt * (0.5 - time), atol=1e-12)
    np.testing.assert_allclose(run.v[-1][:2], belt, atol=1e-12)
    sticks = [row.time for row in run.contact_changes if row.change == "stick"]
    np.testing.assert_allclose(sticks, time, atol=1e-10)
    assert run.friction_loss[-1] == pytest.approx(heat, rel=1e-9)
    assert run.work.prescribed[-1] == pytest.approx(work, rel=1e-9)


@pytest.mark.parametrize(("order", "dt"), ORDERS)
def test_a_belt_that_swings(order: int, dt: float) -> None:
    """Stick and slip on a belt of velocity sin(4 t), with its events, heat and work."""
    scene = box_on_ground(0.3)
    scene.set_surface_velocity("ground", (1.0, 0.0, 0.0), profile=lambda t: math.sin(4.0 * t))
    run = cvi.simulate(scene, FLAT, np.zeros(6), duration=3.0, dt=dt, order=order)
    known, log = right.conveyor_moving(
        lambda t: math.sin(4.0 * t), lambda t: 4.0 * math.cos(4.0 * t), 0.0, 0.3, 3.0, MASS
    )
    atol = {4: 3e-6, 8: 1e-9}[order]
    np.testing.assert_allclose([run.q[-1][0], run.v[-1][0]], known[:2], atol=atol)
    np.testing.assert_allclose([run.friction_loss[-1], run.work.prescribed[-1]], known[2:], atol=100 * atol)
    changes = {round(t, 4) for t, _ in log if t > 0.0}
    assert changes <= {round(row.time, 4) for row in run.contact_changes}


@pytest.mark.parametrize(("order", "dt"), [(2, 0.005), *ORDERS])
def test_a_ball_on_a_turntable(order: int, dt: float) -> None:
    """A ball that rolls on a turntable goes round a circle with 2/7 of the table's rate, wherever it is."""
    scene, q, v, place = systems.ball_on_turntable()
    run = cvi.simulate(scene, q, v, duration=1.0, dt=dt, order=order)
    tolerance = {2: 3e-6, 4: 3e-9, 8: 1e-13}[order]  # of the orders, from the steps
    np.testing.assert_allclose(run.q[-1][:2], place(1.0), atol=tolerance)


def test_an_impact_on_a_belt() -> None:
    """A ball that falls on a belt has the impulse of one that falls, moving the other way, on a surface at rest."""
    belt = np.array([1.5, -0.5, 0.0])
    found = []
    for moves in (True, False):
        scene = cvi.Scene()
        scene.add_halfspace(name="ground")
        scene.add_sphere("ball", 0.1)
        scene.set_contact(friction=0.2, restitution=0.6)
        v = np.array([0.2, 0.1, 0.0])
        if moves:
            scene.set_surface_velocity("ground", belt)
        else:
            v -= belt
        run = cvi.simulate(scene, [0, 0, 0.3, 0, 0, 0, 1], [*v, 1.0, 2.0, 3.0], duration=0.3, dt=0.01)
        assert len(run.events) == 1
        found.append(run)
    np.testing.assert_allclose(found[0].events[0].impulse_vector, found[1].events[0].impulse_vector, atol=1e-13)
    np.testing.assert_allclose(found[0].v[-1][3:], found[1].v[-1][3:], atol=1e-12)
    event = found[0].events[0]
    assert found[0].work.prescribed[-1] == pytest.approx(-event.impulse_vector @ -belt, rel=1e-12)


def test_dense_steps_on_a_belt() -> None:
    """A heap in dense steps goes with its belt, to the first order, and the balance of the energy closes."""
    scene = box_on_ground()
    scene.set_surface_velocity("ground", (1.0, 0.0, 0.0))
    run = cvi.simulate(scene, FLAT, np.zeros(6), duration=0.5, dt=1e-3, contact_mode="steps")
    time, place, heat, work = right.conveyor([0.0, 0.0], [1.0, 0.0], 0.5, MASS)
    assert run.q[-1][0] == pytest.approx(place[0] + 0.5 - time, abs=1e-3)
    assert run.work.prescribed[-1] == pytest.approx(work, rel=1e-2)


@pytest.mark.parametrize("given", ["function", "table"])
@pytest.mark.parametrize(("order", "dt"), ORDERS)
def test_stick_slip_on_a_belt(order: int, dt: float, given: str) -> None:
    """A block on a spring, on a belt with Stribeck's friction: the limit cycle by DOP853, every event of it."""
    belt, stiffness, static = 0.1, 100.0, 0.6
    curve = right.stribeck(static, 0.3, 0.2) if given == "function" else lambda v: np.interp(v, [0.0, 0.5], [0.5, 0.3])
    mu = curve if given == "function" else [(0.0, 0.5), (0.5, 0.3)]
    scene = box_on_ground(mu, static_friction=static)
    scene.add_spring("world", "box", stiffness, rest_length=1.0, point_a=(-1.0, 0.0, 0.05))
    scene.set_surface_velocity("ground", (belt, 0.0, 0.0))
    block = right.Oscillator(MASS, stiffness, MASS * 9.81, belt, static, curve)
    cycle = block.cycle()
    start = FLAT.copy()
    start[0] = cycle["x_slip"]
    run = cvi.simulate(scene, start, [belt, 0, 0, 0, 0, 0], duration=2.2, dt=dt, order=order)
    slips = np.unique([round(row.time, 9) for row in run.contact_changes if row.change == "slip"])
    sticks = np.unique([round(row.time, 9) for row in run.contact_changes if row.change == "stick"])
    tolerance = {4: 3e-5, 8: 3e-7}[order]
    first = slips[slips > 0.5 * cycle["period"]][0]
    np.testing.assert_allclose(sticks[sticks > 1e-3][0], cycle["slip"], atol=tolerance)
    np.testing.assert_allclose(first, cycle["period"], atol=tolerance)
    assert np.max(run.q[:, 0]) <= cycle["x_max"] + tolerance


@pytest.mark.parametrize("turned", [0.0, 0.7])
@pytest.mark.parametrize(("order", "dt"), ORDERS)
def test_a_slide_along_axes(order: int, dt: float, turned: float) -> None:
    """A box without turning slides on a curved path to the place and time of rest of the ellipse of friction."""
    mu, v = (0.5, 0.2), np.array([1.0, 1.2])
    slide = right.Ellipse(v, *mu)
    turn, _ = turning(turned)
    scene = box_on_ground(mu, friction_axis=[*(turn @ [1.0, 0.0]), 0.0])
    run = cvi.simulate(scene, FLAT, [*(turn @ v), 0, 0, 0, 0], duration=0.2, dt=dt, order=order)
    place, speed = slide.at(0.2)
    np.testing.assert_allclose(run.v[-1][:2], turn @ speed, atol=1e-6)
    np.testing.assert_allclose(run.q[-1][:2], turn @ place, atol=1e-6)


@pytest.mark.parametrize("angle", [0.2, 0.9, 1.4])
def test_rest_along_axes(angle: float) -> None:
    """A box on an incline stays or slides as its ellipse says, along each direction."""
    mu, slope = (0.5, 0.2), math.radians(15.0)
    down = np.array([math.cos(angle), math.sin(angle)])
    scene = cvi.Scene(gravity=9.81 * np.array([math.sin(slope) * down[0], math.sin(slope) * down[1], -math.cos(slope)]))
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", 0.05, mass=MASS)
    scene.add_box("box", BOX, mass=MASS)
    scene.set_contact("ground", "box", friction=mu, friction_axis=(1.0, 0.0, 0.0), restitution=0.0)
    start = [*[5.0, 5.0, 1.0, 0, 0, 0, 1], *FLAT]
    run = cvi.simulate(scene, start, np.zeros(12), duration=0.3, dt=0.01, order=4)
    force = 9.81 * math.sin(slope) * down
    holds = right.ellipse_holds(force, *mu, 9.81 * math.cos(slope))
    assert (np.linalg.norm(run.v[-1][6:8]) < 1e-10) == holds


@pytest.mark.parametrize(("order", "dt"), [(2, 1e-3), (4, 0.02), (8, 0.02)])
def test_a_suction_cup(order: int, dt: float) -> None:
    """A box hangs on a ceiling up to the bound of the pull, and falls from there on."""
    pull, load, rate = 40.0, 1.0, 30.0
    scene = cvi.Scene()
    scene.add_halfspace(name="ceiling", normal=(0.0, 0.0, -1.0), offset=-1.0)
    scene.add_box("box", BOX, mass=MASS)
    scene.set_contact(friction=0.3, restitution=0.0, adhesion=pull)
    scene.add_wrench("box", lambda t: [0.0, 0.0, -(load + rate * t)])
    start = FLAT.copy()
    start[2] = 0.95
    run = cvi.simulate(scene, start, np.zeros(6), duration=1.0, dt=dt, order=order)
    released = right.suction_release(MASS, pull, load, rate)
    times = [row.time for row in run.contact_changes if row.change == "release"]
    assert len(times) == 4
    np.testing.assert_allclose(times, released, atol={2: 1e-5, 4: 1e-9, 8: 1e-9}[order])
    fall, speed = right.suction_fall(1.0, MASS, pull, load, rate)
    tolerance = {2: 1e-5, 4: 1e-9, 8: 1e-9}[order]
    np.testing.assert_allclose([0.95 - run.q[-1][2], -run.v[-1][2]], [fall, speed], atol=10 * tolerance)


def test_adhesion_adds_to_friction() -> None:
    """What is pressed by a pull slides against mu (N + pull), and the force that is told is the net one."""
    pull, mu = 15.0, 0.3
    scene = box_on_ground(mu, adhesion=pull)
    run = cvi.simulate(scene, FLAT, [2.0, 0, 0, 0, 0, 0], duration=0.2, dt=0.01, order=4)
    assert run.v[-1][0] == pytest.approx(2.0 - mu * (9.81 + pull / MASS) * 0.2, abs=1e-10)
    rows = [row for row in run.contacts if row.step == 5]
    assert len(rows) == 4
    assert sum(row.force[2] for row in rows) == pytest.approx(MASS * 9.81, rel=1e-9)


def test_an_axis_is_that_of_its_surface() -> None:
    """One geometry with an axis, first in some pairs and second in others: all slide as the ellipse says."""
    mu, v = (0.5, 0.2), np.array([1.0, 1.2])
    scene = cvi.Scene()
    scene.add_box("a_box", BOX, mass=MASS)
    scene.add_halfspace(name="ground")
    scene.add_box("z_box", BOX, mass=MASS)
    scene.set_contact("ground", friction=mu, friction_axis=(1.0, 0.0, 0.0), restitution=0.0)
    far = FLAT.copy()
    far[0] = 5.0
    motion = [*v, 0.0, 0.0, 0.0, 0.0]
    run = cvi.simulate(scene, [*FLAT, *far], [*motion, *motion], duration=0.2, dt=0.02, order=8)
    _, speed = right.Ellipse(v, *mu).at(0.2)
    np.testing.assert_allclose(run.v[-1].reshape(2, 6)[:, :2], [speed, speed], atol=1e-6)


def test_what_is_no_law_of_friction_is_refused() -> None:
    """Each with an error that says what was expected."""
    scene = box_on_ground()
    for given, words in (
        ({"friction": (0.1, 0.2)}, "friction_axis"),
        ({"friction": (0.1, 0.0), "friction_axis": (1, 0, 0)}, "> 0"),
        ({"friction": 0.2, "friction_axis": (1, 0, 0)}, "along, across"),
        ({"friction": [(0.5, 0.2), (0.1, 0.3)]}, "ascend"),
        ({"static_friction": -1.0}, "static_friction"),
        ({"adhesion": -2.0}, "adhesion"),
    ):
        with pytest.raises(cvi.InputError, match=words):
            scene.set_contact("ground", "box", **given)
    scene.set_contact("ground", "box", friction=0.5, static_friction=0.3)
    with pytest.raises(cvi.SceneError, match="static_friction"):
        cvi.simulate(scene, FLAT, duration=0.1, dt=0.01)
    with pytest.raises(cvi.InputError, match="linear"):
        scene.set_surface_velocity("ground", (1.0, 2.0))


def test_laws_of_friction_are_stored(tmp_path) -> None:
    """A stored run brings its laws and moving surfaces; functions are named as missing."""
    scene = box_on_ground([(0.0, 0.5), (1.0, 0.3)], static_friction=0.6, adhesion=[(0.0, 3.0), (1.0, 5.0)])
    scene.set_surface_velocity("ground", (0.4, 0.0, 0.0), angular=(0.0, 0.0, 1.0), profile=[(0.0, 0.0), (0.2, 1.0)])
    run = cvi.simulate(scene, FLAT, np.zeros(6), duration=0.3, dt=0.01)
    run.save(tmp_path / "run.npz")
    again = cvi.simulate(cvi.Trajectory.load(tmp_path / "run.npz").scene, FLAT, np.zeros(6), duration=0.3, dt=0.01)
    np.testing.assert_array_equal(run.q, again.q)
    scene.set_surface_velocity("ground", (0.4, 0.0, 0.0), profile=math.cos)
    cvi.simulate(scene, FLAT, np.zeros(6), duration=0.1, dt=0.01).save(tmp_path / "other.npz")
    assert "the surface velocity of ground" in cvi.Trajectory.load(tmp_path / "other.npz").scene.missing


def test_functions_that_fail_say_so() -> None:
    """Friction, adhesion and profiles that raise or return nonsense end the run with the name of the pair."""

    def broken(x: float) -> float:
        if x > 0.01:
            raise ValueError("no more")
        return 0.4

    for given in ({"mu": broken}, {"adhesion": broken}, {"mu": lambda v: math.nan if v > 0.0 else 0.4}):
        with pytest.raises(cvi.UserFunctionError, match="'ground' and 'box'"):
            cvi.simulate(box_on_ground(**given), FLAT, [0.2, 0, 0, 0, 0, 0], duration=0.1, dt=0.01, order=4)
    scene = box_on_ground()
    scene.set_surface_velocity("ground", (1.0, 0.0, 0.0), profile=broken)
    with pytest.raises(cvi.UserFunctionError, match="the surface of 'ground'"):
        cvi.simulate(scene, FLAT, np.zeros(6), duration=0.1, dt=0.01, order=4)


def test_the_last_law_of_friction_counts() -> None:
    """A number, a function and an axis replace each other; those of two sides have to agree."""
    scene = box_on_ground(lambda v: 0.5 / (1.0 + v), static_friction=0.9)
    scene.set_contact("ground", "box", friction=(0.2, 0.2), friction_axis=(1.0, 0.0, 0.0))
    scene.set_contact("ground", "box", friction=0.2)
    plain = box_on_ground(0.2)
    runs = [cvi.simulate(s, FLAT, [1.0, 0, 0, 0, 0, 0], duration=0.1, dt=0.01) for s in (scene, plain)]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    mixed = cvi.Scene()
    mixed.add_halfspace(name="ground")
    mixed.add_box("box", BOX, mass=MASS)
    mixed.set_contact("ground", friction=(0.2, 0.4), friction_axis=(1.0, 0.0, 0.0))
    mixed.set_contact("box", friction=[(0.0, 0.5), (1.0, 0.3)])
    with pytest.raises(cvi.SceneError, match="two sides"):
        cvi.simulate(mixed, FLAT, duration=0.1, dt=0.01)
    mixed = cvi.Scene()
    mixed.add_halfspace(name="ground")
    mixed.add_box("box", BOX, mass=MASS)
    mixed.set_contact("ground", friction=(0.2, 0.4), friction_axis=(1.0, 0.0, 0.0))
    mixed.set_contact(friction=[(0.0, 0.5), (1.0, 0.3)])
    with pytest.raises(cvi.SceneError, match="direction"):
        cvi.simulate(mixed, FLAT, duration=0.1, dt=0.01)


@pytest.mark.parametrize("dt", [5e-3, 1e-3])
def test_a_suction_cup_in_dense_steps(dt: float) -> None:
    """The pull holds up to its bound; the box lets go within the step after it, at the latest, and falls from there."""
    pull, load, rate = 40.0, 1.0, 30.0
    scene = cvi.Scene()
    scene.add_halfspace(name="ceiling", normal=(0.0, 0.0, -1.0), offset=-1.0)
    scene.add_box("box", BOX, mass=MASS)
    scene.set_contact(friction=0.3, restitution=0.0, adhesion=pull)
    scene.add_wrench("box", lambda t: [0.0, 0.0, -(load + rate * t)])
    start = FLAT.copy()
    start[2] = 0.95
    run = cvi.simulate(scene, start, np.zeros(6), duration=1.0, dt=dt, contact_mode="steps")
    released = right.suction_release(MASS, pull, load, rate)
    times = [row.time for row in run.contact_changes if row.change == "release"]
    assert len(times) == 4
    assert np.abs(np.array(times) - released).max() <= 2.0 * dt
    before = run.t < released - dt
    assert np.abs(run.q[before, 2] - 0.95).max() <= 1e-10
    fall, speed = right.suction_fall(1.0, MASS, pull, load, rate)
    # It falls later or sooner by up to two steps, with what the load is above the pull there.
    assert -run.v[-1][2] == pytest.approx(speed, abs=2.0 * dt * (load + rate - 0.0) / MASS)
    net = [row.force[2] for row in run.contacts if row.t < released - 2.0 * dt]
    assert min(net) >= -pull / 4 * (1.0 + 1e-6)


def test_adhesion_in_dense_steps_adds_to_friction() -> None:
    pull, mu = 15.0, 0.3
    scene = box_on_ground(mu, adhesion=pull)
    run = cvi.simulate(scene, FLAT, [2.0, 0, 0, 0, 0, 0], duration=0.2, dt=0.01, contact_mode="steps")
    assert run.v[-1][0] == pytest.approx(2.0 - mu * (9.81 + pull / MASS) * 0.2, abs=1e-7)
    rows = [row for row in run.contacts if row.step == 5]
    assert sum(row.force[2] for row in rows) == pytest.approx(MASS * 9.81, rel=1e-6)
    assert run.ledger.dense_energy_rise.max() <= 0.0


@pytest.mark.parametrize("mode", ["auto", "steps"])
def test_adhesion_of_a_body_is_shared_by_all_that_it_touches(mode: str) -> None:
    """A box hangs from a ceiling; one that slides on a floor along a wall has half of its pull at each."""
    scene, height = cvi.Scene(), 1.0 - 0.5 * BOX[2]
    scene.add_halfspace(name="ceiling", normal=(0.0, 0.0, -1.0), offset=-1.0)
    scene.add_box("box", BOX, mass=MASS)
    scene.set_contact(friction=0.5, restitution=0.0)
    start, weight = np.array([0.0, 0.0, height, 0, 0, 0, 1.0]), MASS * 9.81

    def holds(pull: float | Callable[[float], float]) -> bool:
        scene.set_body_adhesion("box", pull)
        run = cvi.simulate(scene, start, np.zeros(6), duration=0.1, dt=0.005, contact_mode=mode)
        return bool(run.q[-1][2] > height - 1e-9)

    assert not holds(0.99 * weight)
    assert holds(1.01 * weight)
    assert holds(lambda t: 1.5 * weight)
    assert not holds(0.0)
    mu, pull = 0.3, 15.0
    for walls in (0, 1):
        scene = box_on_ground(mu)
        if walls:
            scene.add_halfspace(name="wall", normal=(1.0, 0.0, 0.0), offset=-0.5 * BOX[0])
            scene.set_contact("wall", friction=0.0)
        scene.set_body_adhesion("box", pull)
        run = cvi.simulate(scene, FLAT, [0, 2.0, 0, 0, 0, 0], duration=0.2, dt=0.01, contact_mode=mode)
        assert run.v[-1][1] == pytest.approx(2.0 - mu * (9.81 + pull / (1 + walls) / MASS) * 0.2, abs=1e-7)
    with pytest.raises(cvi.InputError, match="one body that moves"):
        scene.set_body_adhesion("wall", 1.0)


def test_adhesion_of_a_body_is_stored(tmp_path) -> None:
    scene = box_on_ground(0.4)
    scene.set_body_adhesion("box", [(0.0, 3.0), (1.0, 5.0)])
    run = cvi.simulate(scene, FLAT, [1.0, 0, 0, 0, 0, 0], duration=0.1, dt=0.01)
    run.save(tmp_path / "run.npz")
    again = cvi.simulate(cvi.Trajectory.load(tmp_path / "run.npz").scene, FLAT, [1.0, 0, 0, 0, 0, 0], 0.1, 0.01)
    assert (again.q == run.q).all()
