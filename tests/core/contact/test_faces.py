"""Faces and edges: boxes rest, tip, rock, stack, come to rest; what rests does not move."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from batteries import contact_laws
from helpers import laws, persistent_runs
from helpers.persistent_runs import GRAVITY, changes, check_contacts, check_sums, same
from oracles import persistent_scenes


def upright(height: float, restitution: float, mu=0.6, size=(0.2, 0.3, 0.6)):
    """A tall box tilted about its edge at -x until its other edge is `height` over the ground, falling flat."""
    scene, q, v = persistent_runs.box(mu=mu, restitution=restitution, size=size)
    tilt = -math.asin(height / size[0])
    turn = persistent_runs.turned(tilt)
    q = persistent_runs.pose(-turn @ [-0.5 * size[0], 0.0, -0.5 * size[2]], turn)
    return scene, q, v


@pytest.mark.parametrize("mu", [0.0, 0.5])
def test_box_rests(mu):
    traj = cvi.simulate(*persistent_runs.box(mu=mu), 2.0, 0.01)
    assert np.abs(traj.v).max() <= 1e-10
    assert np.abs(traj.q - traj.q[0]).max() <= 1e-12
    log = traj.contacts
    assert len(log) == 4 * 200
    each = 2.0 * GRAVITY / 4
    # a regularization of 1e-5 of G_c selects the smallest forces: equal to some 5e-12
    assert np.abs(np.abs(log.force[:, 2]) - each).max() <= 1e-10 * each
    assert np.ptp(np.abs(log.force[:, 2])) <= 1e-11 * each
    assert {tuple(np.round(x, 9)) for x in np.abs(log.position)} == {(0.1, 0.15, 0.0)}


@pytest.mark.parametrize("points", [3, 4, 8])
def test_number_of_points_is_an_option(points):
    traj = cvi.simulate(*persistent_runs.box(mu=0.5), 0.1, 0.01, contact_points=points)
    # of three corners the middle one carries nothing: the centre of mass is over the diagonal of the other two
    assert len(traj.contacts) == (20 if points == 3 else 40)
    _, force = traj.contacts.on("box")
    assert force == pytest.approx(np.tile([0.0, 0.0, 2.0 * GRAVITY], (10, 1)), abs=1e-9)


def test_box_dropped_flat_bounces_flat():
    scene, q, v = persistent_runs.box(mu=0.5, gap=0.2, restitution=0.5)
    traj = cvi.simulate(scene, q, v, 0.3, 0.01)
    event = traj.events[0]
    assert event.points == 4
    assert event.gamma_plus == pytest.approx(-0.5 * event.gamma_minus, rel=1e-12)
    assert event.p_plus == pytest.approx([0.0, 0.0, 2.0 * event.gamma_plus, 0.0, 0.0, 0.0], abs=1e-12)
    rows = traj.contacts[:4]
    assert all(row.mode == "impact" and row.h == 0.0 for row in rows)
    assert [abs(row.impulse[2]) for row in rows] == pytest.approx([abs(event.impulse) / 4] * 4, rel=1e-9)
    # its end as the ball's: the face is one contact
    whole = cvi.simulate(scene, q, v, 2.0, 0.01)
    first = math.sqrt(0.4 / GRAVITY)
    for ended in changes(whole, "bouncing ended"):
        assert ended.value == pytest.approx(3.0 * first, abs=1e-9)
    assert changes(whole, "bouncing ended")
    assert whole.q[-1] == pytest.approx(persistent_runs.pose([0.0, 0.0, 0.05]), abs=1e-12)


# --- stacks -----------------------------------------------------------------------------------------------------------
def rest_of_stack(count: int, duration: float, h: float) -> None:
    traj = cvi.simulate(*persistent_runs.stack(count), duration, h)
    assert np.abs(traj.v).max() <= 1e-10
    assert np.abs(traj.q - traj.q[0]).max() <= 1e-10
    loads = persistent_scenes.stack_loads([1.0] * count)
    for k, pair in enumerate([("ground", "b0"), *((f"b{k}", f"b{k + 1}") for k in range(count - 1))]):
        _, force = traj.contacts.force_of(*pair)
        assert np.abs(np.abs(force[:, 2]) - loads[k]).max() <= 1e-8
        rows = traj.contacts.of(*pair)
        # boxes on boxes touch at rounded corners: four of them, a quarter each
        assert np.abs(np.abs(rows.force[:, 2]) - loads[k] / 4).max() <= 1e-6
    check_contacts(traj, 0.5)
    check_sums(traj, [1.0] * count, [f"b{k}" for k in range(count)])


@pytest.mark.parametrize("count", [2, 3])
def test_small_stacks_rest(count):
    rest_of_stack(count, 1.0, 0.01)


def test_stack_of_five_rests_for_ten_seconds():
    rest_of_stack(5, 10.0, 0.01)


def test_top_of_a_stack_slides_off_alone():
    """Three boxes, the top one pushed: it stops after v^2 / (2 mu g), the others do not move."""
    scene, q, v = persistent_runs.stack(3, mu=0.5)
    v[12] = 0.5
    traj = cvi.simulate(scene, q, v, 0.5, 0.01)
    assert np.abs(traj.q[:, :14] - traj.q[0, :14]).max() <= 1e-9
    assert traj.q[-1, 14] == pytest.approx(0.125 / (0.5 * GRAVITY), abs=1e-7)
    assert np.abs(traj.v[-1]).max() <= 1e-9


def test_box_dropped_on_a_stack_comes_to_rest():
    scene, q, v = persistent_runs.stack(3)
    q[16] += 0.05
    traj = cvi.simulate(scene, q, v, 0.5, 0.01)
    assert np.abs(traj.v[-1]).max() <= 1e-9
    assert traj.q[-1, [2, 9, 16]] == pytest.approx([0.05, 0.15, 0.25], abs=1e-9)
    check_sums(traj, [1.0] * 3, ["b0", "b1", "b2"])


# --- edges ------------------------------------------------------------------------------------------------------------
def test_box_tips_about_its_edge():
    """The angle is of order 2, and the edge does not move."""
    tilt, duration = 0.6, 0.4
    exact, _, grip = persistent_scenes.tipping_box(0.2, 0.4, tilt, 0.0, duration)
    assert grip < 3.0
    errors = []
    for h in (0.02, 0.01, 0.005):
        traj = cvi.simulate(*persistent_runs.tipping(tilt), duration, h)
        errors.append(abs(2.0 * math.atan2(traj.q[-1, 4], traj.q[-1, 6]) - exact))
        turns = [pin.Quaternion(q[3:7]).matrix() for q in traj.q]
        edge = traj.q[:, :3] + np.array([r @ [0.1, 0.0, -0.2] for r in turns])
        assert np.abs(edge).max() <= 1e-14
        assert set(traj.contacts.array("mode").tolist()) == {0}
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.1, errors


def test_box_tilted_a_little_falls_back():
    """Housner: when it lands flat it goes on about the other edge with 1 - 1.5 sin^2 of its speed."""
    scene, q, v = upright(0.02, 0.0, mu=5.0)
    width, height = 0.2, 0.6
    traj = cvi.simulate(scene, q, v, 0.5, 0.005)
    event = traj.events[0]
    assert event.q[2] == pytest.approx(0.3, abs=1e-9)
    # momentum about the y axis of the body is I omega
    ratio = event.p_plus[4] / event.p_minus[4]
    assert ratio == pytest.approx(persistent_scenes.housner(width, height), rel=1e-9)
    check_contacts(traj, 5.0)
    # it rocks over to +x, less far
    assert traj.q[:, 4].max() > 0.0
    assert traj.energy[-1] < traj.energy[0]


def test_rocking_block_comes_to_rest():
    traj = cvi.simulate(*upright(0.02, 0.0), 10.0, 0.005)
    assert np.abs(traj.v[-1]).max() <= 1e-8
    assert traj.q[-1, 2] == pytest.approx(0.3, abs=1e-9)
    check_contacts(traj, 0.6)


def test_box_pushed_low_slides_and_pushed_high_tips():
    """A box thrown along the floor tips over its front edge where mu > width / height (a tall one), else slides."""
    for size, tips in (((0.2, 0.3, 0.1), False), ((0.1, 0.3, 0.4), True)):
        scene, q, v = persistent_runs.box(mu=0.5, size=size)
        v[0] = 1.0
        traj = cvi.simulate(scene, q, v, 0.15, 0.005)
        tilt = np.abs(traj.q[:, 4]).max()
        assert (tilt > 1e-3) == tips
        if not tips:
            assert tilt <= 1e-12
        check_contacts(traj, 0.5)


# --- tossed -----------------------------------------------------------------------------------------------------------
def toss(restitution: float, h: float, seed: int, duration=None) -> tuple[cvi.Trajectory, np.ndarray]:
    size = np.array([0.2, 0.3, 0.1])
    scene, q, v = persistent_runs.box(mu=0.4, restitution=restitution, gap=0.3, size=tuple(size))
    rng = np.random.default_rng([23, seed])
    q[3:7] = pin.Quaternion(pin.exp3(rng.uniform(-1.0, 1.0, 3))).coeffs()
    v[:] = np.append(rng.uniform(-0.5, 0.5, 3), rng.uniform(-4.0, 4.0, 3))
    steps = round((duration or 3.0) / h)
    return cvi.simulate(scene, q, v, steps * h, h), size


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("restitution", [0.0, 0.3])
@pytest.mark.parametrize("h", [0.1, 0.05, 0.02, 0.01, 0.005])
def test_tossed_box_comes_to_rest(h, restitution, seed):
    traj, size = toss(restitution, h, seed)
    assert traj.status.ok
    assert np.abs(traj.v[-1]).max() < 1e-8
    assert np.abs(traj.q[-1, 2] - 0.5 * size).min() < 1e-9
    check_contacts(traj, 0.4)
    check_sums(traj, [2.0], ["box"])
    # impacts and friction only take; the midpoint step itself varies by O(h^2) while the box tumbles
    assert np.diff(traj.energy).max() <= 10.0 * h * h * traj.energy.max() + 1e-9


def test_tossed_box_repeats_bit_by_bit():
    same(toss(0.3, 0.01, 0)[0], toss(0.3, 0.01, 0)[0])


@pytest.mark.parametrize("axis", ["x", "tilted"])
def test_cylinder_lies_and_stands(axis):
    """On its side a line of two points, on its end a circle; both rest."""
    scene, q, v = persistent_runs.cylinder(mu=0.5)
    if axis == "tilted":
        q = persistent_runs.pose([0.0, 0.0, 0.15])  # standing
    traj = cvi.simulate(scene, q, v, 1.0, 0.01)
    assert np.abs(traj.v).max() <= 1e-10
    assert np.abs(traj.q - traj.q[0]).max() <= 1e-10
    _, force = traj.contacts.on("cylinder")
    assert force == pytest.approx(np.tile([0.0, 0.0, 1.5 * GRAVITY], (len(force), 1)), abs=1e-8)


@pytest.mark.parametrize(("tilt", "mu", "restitution"), itertools.product((0.1, 0.3, 0.5), (0.0, 0.5, 1.5), (0.0, 0.5)))
def test_cylinder_on_its_rim_falls_flat(tilt, mu, restitution):
    """The lowest point of the rim runs to its other side as the cylinder falls flat; nothing is gained by that."""
    radius, length, mass, h = 0.1, 0.2, 1.0, 0.005
    scene, q, v = persistent_runs.cylinder(mu=mu, radius=radius, length=length, mass=mass)
    scene.set_contact(restitution=restitution, friction=mu)
    height = 0.5 * length * math.cos(tilt) + radius * math.sin(tilt)
    q = persistent_runs.pose([0.0, 0.0, height], pin.exp3(np.array([tilt, 0.0, 0.0])))
    traj = cvi.simulate(scene, q, v, 1.0, h)
    assert traj.status.code is cvi.StatusCode.SUCCESS
    assert not contact_laws.broken(traj)
    # a midpoint step errs by (h Omega)^2 / 12 of the energy for each rate: of turning, of the rim's point, of gravity
    rate = np.sum(traj.v[:, 3:] ** 2, axis=1).max() + GRAVITY / radius
    rise = (traj.energy - np.minimum.accumulate(traj.energy)).max()
    assert rise <= 0.25 * h**2 * rate * traj.kinetic_energy.max()
    # It stands, or rolls on its rim, which touches: impacts that multiply errors decide which of the two. Of starts
    # that differ by 1e-4 rad one in four to one in twenty rolls on, however short the steps are.
    axis = pin.Quaternion(traj.q[-1, 3:]).matrix()[:, 2]
    lean = float(np.linalg.norm(axis[:2]))
    left = 1e-9  # what gaps of 1e-10 m leave
    assert traj.q[-1, 2] == pytest.approx(0.5 * length * axis[2] + radius * lean, abs=left)
    if np.abs(traj.v[-1]).max() > 1e-6:
        assert traj.q[-1, 2] < height
        return
    assert lean <= left / radius
    assert traj.energy[-1] == pytest.approx(mass * GRAVITY * 0.5 * length, abs=mass * GRAVITY * 2 * left)


def test_ball_lies_in_a_corner():
    """A groove without friction: both sides carry weight / (2 cos)."""
    traj = cvi.simulate(*persistent_runs.groove(0.0, 0.0, 0.7), 1.0, 0.01)
    assert np.abs(traj.v).max() <= 1e-12
    load = persistent_scenes.ball_in_groove(0.0, 0.7)[2] * GRAVITY
    assert traj.contacts.normal_impulse / traj.contacts.h == pytest.approx(np.full(200, load), rel=1e-10)


@pytest.mark.parametrize("dt", [1e-3, 1e-4, 5e-5, 4e-5])
def test_a_box_that_comes_to_lie_flat_lies_on_all_of_its_corners(dt):
    # With short steps its last corner comes down with the face, without an impact of its own.
    scene = cvi.Scene()
    scene.add_halfspace()
    turn = (-0.35135782963355516, 0.04447689353657874, -0.18283871637591878)
    scene.add_box("box", size=(0.3, 0.2, 0.1), mass=1.0, placement=((0, 0, 0.3), turn))
    scene.set_contact(restitution=0.4, friction=0.3)
    v0 = [-1.8425790826815776, 0.3923681529677569, 0.056487267319778774]
    v0 += [-2.1374983557868457, 1.1746807496828715, 2.7101159735917775]
    run = cvi.simulate(scene, v0=v0, duration=0.6, dt=dt, order=8)
    assert len(run.contacts.at(0.59)) == 4
