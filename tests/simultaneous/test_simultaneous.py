"""Simultaneous impacts as sequences: chains, three balls, wedges, supports, the certificate, Newton's cradle."""

from __future__ import annotations

import math
import pathlib

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import contactvi as cvi
from helpers.contact_models import geometry, halfspace, place, scene, slider_blocks
from oracles.closed_forms import pendulum_wall_period
from oracles.impact_sequence import velocity_after

EPS = np.finfo(float).eps
CRADLE = pathlib.Path(__file__).resolve().parents[2] / "models" / "newtons_cradle.toml"


def balls(masses, restitution: float = 1.0) -> tuple[cvi.Scene, np.ndarray, list[tuple[str, str]]]:
    """Touching balls in a row on prismatic joints, their configuration, and the pairs between them (not the wall's)."""
    made = scene(*slider_blocks(tuple(map(float, masses)), 0.125, "sphere"), restitution)
    return made, 0.125 + 0.25 * np.arange(len(masses)), made.pair_names[1:]


def row(masses, v, **options) -> cvi.SimultaneousOutcomes:
    made, q, pairs = balls(masses)
    return cvi.simultaneous_outcomes(made, q, v, pairs=pairs, **options)


def wedge(n: int) -> tuple[cvi.Scene, np.ndarray]:
    """A free ball that touches both walls of a wedge of angle pi/n about +x, no gravity; the scene and q."""
    half, radius = 0.5 * math.pi / n, 0.1
    made = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    made.add_sphere("ball", radius=radius)
    for side, name in ((1.0, "upper"), (-1.0, "lower")):
        made.add_halfspace((math.sin(half), -side * math.cos(half), 0.0), 0.0, name=name)
    made.set_contact(restitution=1.0)
    q = made.neutral()
    q[0] = radius / math.sin(half)
    return made, q


# --- chains ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", range(2, 9))
def test_a_chain_hands_the_speed_on(n):
    v = np.eye(n)[0]
    found = row([1.0] * n, v)
    assert found.unique
    assert found.certificate.certified
    chosen = found.chosen
    assert chosen.sequence == tuple(((f"block{k}", f"block{k + 1}"),) for k in range(n - 1))
    assert np.abs(chosen.v_plus - v[::-1]).max() <= 8 * n * EPS
    assert np.abs(chosen.impulses - 1.0).max() <= 8 * n * EPS
    assert chosen.energy == pytest.approx(0.5, rel=1e-14)
    assert not chosen.cut


@pytest.mark.parametrize("n", range(2, 9))
def test_a_run_takes_the_sequence_of_the_chain(n):
    made, q, _ = balls([1.0] * n)
    q[0] -= 0.0625  # comes from a gap, and away from the wall
    q += 0.5
    traj = cvi.simulate(made, q, np.eye(n)[0], 0.125, 0.0125)
    assert [event.pair for event in traj.events] == [(f"block{k}", f"block{k + 1}") for k in range(n - 1)]
    assert np.abs(traj.v[-1] - np.eye(n)[-1]).max() <= 1e-12


# --- three balls -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("v", "after"),
    [((1, 0, 0), (0, 0, 1)), ((1, 0, -1), (-1, 0, 1)), ((1, 0.3, -1), (-1, 0.3, 1))],
)
def test_three_equal_balls_have_one_answer(v, after):
    found = row([1, 1, 1], v)
    assert found.unique
    assert found.certificate.certified
    assert found.certificate.angles[0, 1] == pytest.approx(math.radians(60.0), abs=4 * EPS)
    assert found.certificate.orders[0, 1] == 3
    assert found.certificate.bound == 3
    assert np.abs(found.chosen.v_plus - after).max() <= 16 * EPS


def test_masses_1_3_1_have_exactly_two_answers():
    found = row([1, 3, 1], (1, 0, -1))
    assert found.complete
    assert not found.unique
    assert not found.certificate.certified
    assert found.certificate.angles[0, 1] == pytest.approx(math.acos(0.25), abs=4 * EPS)
    assert found.certificate.orders[0, 1] == 0
    assert found.certificate.bound == 3
    # The two contacts close equally fast: the lower number, block0 | block1, is first.
    expected = [(-0.5, -0.25, 1.25), (-1.25, 0.25, 0.5)]
    assert np.abs(np.array([outcome.v_plus for outcome in found]) - expected).max() <= 16 * EPS
    assert found.chosen.sequence[0] == (("block0", "block1"),)
    assert all(len(outcome.sequence) <= 3 for outcome in found)
    assert all(outcome.energy == pytest.approx(1.0, rel=1e-14) for outcome in found)


@given(st.tuples(*[st.floats(0.05, 20.0)] * 3), st.tuples(*[st.floats(-1.0, 1.0)] * 3))
@settings(max_examples=60, deadline=None)
def test_two_contacts_keep_to_the_bound(masses, v):
    found = row(masses, v)
    m1, m2, m3 = masses
    beta = math.acos(math.sqrt(m1 * m3 / ((m1 + m2) * (m2 + m3))))
    assert found.certificate.angles[0, 1] == pytest.approx(beta, abs=1e-12)
    assert found.complete
    for outcome in found:
        assert len(outcome.sequence) <= found.certificate.bound
        assert outcome.energy == pytest.approx(found.energy, rel=1e-12, abs=1e-300)
        assert np.all(np.diff(outcome.v_plus) >= -1e-9 * np.abs(v).max())


# --- a particle in a wedge -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", range(2, 9))
def test_a_wedge_of_angle_pi_over_n_returns_the_particle_in_any_order(n):
    made, q = wedge(n)
    angle = math.pi + 0.3 * math.pi / n  # inside the opposite wedge: it strikes both walls
    v = np.array([math.cos(angle), math.sin(angle), 0.0, 0.0, 0.0, 0.0])
    found = cvi.simultaneous_outcomes(made, q, v)
    assert found.unique
    assert found.certificate.certified
    assert found.certificate.orders[0, 1] == n
    assert found.certificate.bound == n
    assert len(found.chosen.sequence) == n
    exact = -v if n % 2 == 0 else v * [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert np.abs(found.chosen.v_plus - exact).max() <= 8 * n * EPS


@pytest.mark.parametrize("angle", [0.9, 0.5 * math.pi + 0.1, math.radians(75.0)])
def test_another_wedge_is_not_certified(angle):
    made, q = wedge(2)
    turned = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    turned.add_sphere("ball", radius=0.1)
    turned.add_halfspace((0.0, 1.0, 0.0), 0.0, name="floor")
    turned.add_halfspace((math.sin(angle), -math.cos(angle), 0.0), 0.0, name="ramp")
    q[:2] = 0.1 / math.tan(0.5 * angle), 0.1
    found = cvi.simultaneous_outcomes(turned, q, np.array([-1.0, -0.2, 0.0, 0.0, 0.0, 0.0]), e=1.0)
    assert found.certificate.angles[0, 1] == pytest.approx(angle, abs=1e-14)
    assert not found.certificate.certified
    assert found.certificate.bound == math.ceil(math.pi / angle)


# --- plastic impacts -------------------------------------------------------------------------------------------------
def test_plastic_balls_move_on_together():
    found = row([1, 1, 1], (1, 0, 0), e=0.0)
    assert found.unique
    assert not found.certificate.certified
    assert np.abs(found.chosen.v_plus - 1.0 / 3.0).max() <= 16 * EPS
    assert found.chosen.energy == pytest.approx(1.0 / 6.0, abs=16 * EPS)
    assert np.abs(found.chosen.impulses - [2.0 / 3.0, 1.0 / 3.0]).max() <= 16 * EPS
    # Single plastic impacts make an endless sequence: each leaves a quarter of the closing speed.
    single = row([1, 1, 1], (1, 0, 0), e=0.0, max_states=3)
    assert not single.complete


def test_carnot_of_plastic_contacts():
    """gamma+ = 0 and the loss is gamma-^T G_c^-1 gamma- / 2 where all contacts stay closed."""
    made, q, pairs = balls([2.0, 1.0, 3.0])
    v = np.array([1.0, 0.2, -0.7])
    found = cvi.simultaneous_outcomes(made, q, v, pairs=pairs, e=0.0)
    W = np.vstack([contact.W for contact in found.contacts])
    gamma, G = W @ v, W @ np.diag([0.5, 1.0, 1.0 / 3.0]) @ W.T
    assert np.abs(W @ found.chosen.v_plus).max() <= 1e-14
    assert found.energy - found.chosen.energy == pytest.approx(0.5 * gamma @ np.linalg.solve(G, gamma), abs=1e-14)


# --- impacts against what rests on something -------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("ratio", "ground", "after"),
    [
        ((1, 1), 1.0, (1, 0)),
        ((1, 1), 0.5, (0.5, 0)),
        ((1, 1), 0.0, (0, 0)),
        ((1, 3), 1.0, (0.5, 0.5)),
        ((1, 3), 0.5, (0.5, 0.25)),
        ((1, 3), 0.0, (0.5, 0)),
        ((3, 1), 1.0, (1, 0)),
        ((3, 1), 0.5, (0.34375, 0.046875)),
        ((3, 1), 0.0, (0, 0)),
    ],
)
def test_ball_on_a_block_on_the_ground(ratio, ground, after):
    """Each contact of the sequence has its own e: the ball 1, the ground as given (fractions by hand)."""
    ball, block = ratio
    made, q, _ = balls([block, ball])
    found = cvi.simultaneous_outcomes(made, q, (0.0, -1.0), e=(ground, 1.0))
    # An endless sequence is cut at 1e-9 of the speeds.
    assert np.abs(found.chosen.v_plus[::-1] - after).max() <= 2e-9
    assert found.chosen.cut == (ratio == (3, 1) and ground == 0.0)


@given(
    st.lists(st.tuples(st.floats(0.1, 10.0), st.floats(-1.0, 1.0)), min_size=2, max_size=4),
    st.lists(st.sampled_from([0.0, 0.3, 0.8, 1.0]), min_size=4, max_size=4),
)
@settings(max_examples=60, deadline=None)
def test_laws_of_any_row(bodies, e):
    """Momentum and impulses agree, energy never rises, nothing closes any more, impulses push."""
    masses, v = np.array(bodies).T
    made, q, pairs = balls(masses)
    found = cvi.simultaneous_outcomes(made, q, v, pairs=pairs, e=e[: len(pairs)], max_states=2000)
    W = np.vstack([contact.W for contact in found.contacts])
    size = max(1e-3, np.abs(v).max())
    for outcome in found:
        assert np.abs(outcome.p_plus - masses * v - W.T @ outcome.impulses).max() <= 1e-11 * size * masses.sum()
        assert outcome.energy <= found.energy * (1.0 + 1e-12)
        assert (W @ outcome.v_plus).min() >= -1e-8 * size
        assert outcome.impulses.min() >= -1e-12 * size


@given(
    # A gap that closes slower than 1e-3 m/s does not cross the 1e-12 m of the root search in the time of the run.
    st.lists(st.tuples(st.floats(0.1, 10.0), st.integers(-1000, 1000).map((1e-3).__mul__)), min_size=2, max_size=4),
    st.lists(st.sampled_from([0.0, 0.3, 0.8, 1.0]), min_size=3, max_size=3),
)
@settings(max_examples=60, deadline=None)
def test_a_run_takes_the_chosen_outcome(bodies, e):
    """A run at an instant, the outcome that is asked for, and another code of the rule agree."""
    masses, v = np.array(bodies).T
    made, q, pairs = balls(masses)
    for pair, value in zip(pairs, e, strict=False):
        made.set_contact(*pair, restitution=value)
    q += 1.0
    found = cvi.simultaneous_outcomes(made, q, v, pairs=pairs)
    closing = np.diff(v)
    if np.any(np.abs(closing - closing.min()) <= 1e-9 * np.abs(v).max(), where=closing != closing.min()):
        return  # a tie, which rounding decides
    traj = cvi.simulate(made, q, v, 1e-6, 1e-6)
    exact = velocity_after(np.diag(masses), [contact.W[0] for contact in found.contacts], e[: len(pairs)], v)
    size = max(1e-3, np.abs(v).max())
    assert np.abs(traj.v[-1] - found.chosen.v_plus).max() <= 1e-8 * size
    assert np.abs(exact - found.chosen.v_plus).max() <= 1e-8 * size


# --- the interface ---------------------------------------------------------------------------------------------------
def test_limits_take_part():
    """Two sliders tied to nothing but their limits: a ball against one that stands at its upper limit."""
    model, shapes = slider_blocks((1.0, 1.0), 0.125, "sphere")
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -1.0, (5.0, 0.625)
    found = cvi.simultaneous_outcomes(scene(model, shapes), np.array([0.375, 0.625]), (1.0, 0.0))
    assert [contact.pair for contact in found.contacts] == [("block0", "block1"), ("slider1", "upper limit")]
    assert np.abs(found.chosen.v_plus - (-1.0, 0.0)).max() <= 8 * EPS


def test_a_squeezed_ball_ends_at_rest():
    """Between two walls that it touches at once no velocity separates: the endless sequence is cut."""
    made = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    made.add_sphere("ball", radius=0.125)
    made.add_halfspace((0.0, 0.0, 1.0), 0.0, name="floor")
    made.add_halfspace((0.0, 0.0, -1.0), -0.25, name="ceiling")
    q = made.neutral()
    q[2] = 0.125
    found = cvi.simultaneous_outcomes(made, q, np.array([0.3, 0.0, 1.0, 0.0, 0.0, 0.0]), e=1.0, max_states=100)
    assert found.chosen.cut
    assert np.abs(found.chosen.v_plus - [0.3, 0, 0, 0, 0, 0]).max() <= 1e-14
    assert found.certificate.bound is None
    assert not found.certificate.certified


def test_bad_input_is_named():
    made, q, pairs = balls([1, 1, 1])
    for options, name in (
        ({"e": 1.5}, "e"),
        ({"e": [1.0]}, "e"),
        ({"pairs": [("block0", "block7")]}, "pairs"),
        ({"pairs": []}, "q"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"max_states": 0}, "max_states"),
    ):
        with pytest.raises(cvi.InputError) as caught:
            cvi.simultaneous_outcomes(made, q, (1, 0, 0), **{"pairs": pairs, **options})
        assert caught.value.name == name
    with pytest.raises(cvi.InputError):
        cvi.simultaneous_outcomes(made, q, (1, 0), pairs=pairs)
    with pytest.raises(cvi.InputError, match="No contact is closed"):
        cvi.simultaneous_outcomes(made, q + [0.5, 1.0, 1.5], (1, 0, 0))
    with pytest.raises(cvi.PenetrationError) as deep:
        cvi.simultaneous_outcomes(made, q - [0.0, 0.01, 0.0], (1, 0, 0))
    assert deep.value.pair == ("block0", "block1")
    assert deep.value.depth == pytest.approx(0.01, abs=1e-12)


def test_what_constraints_hold_has_no_impact():
    """A welded ball, and one whose point of contact is fixed: no impulse changes their gap."""
    for element in ("add_weld", "add_point"):
        made = cvi.Scene()
        made.add_halfspace()
        made.add_sphere("ball", radius=0.1, placement=(0.0, 0.0, 0.1))
        getattr(made, element)("ball", "world", **({} if element == "add_weld" else {"point_a": (0.0, 0.0, -0.1)}))
        with pytest.raises(cvi.InputError, match="The constraints do not let ground and ball move") as caught:
            cvi.simultaneous_outcomes(made, v=-np.ones(6))
        assert caught.value.name == "pairs"


def test_a_fixed_point_of_a_face_has_no_part():
    """A box hinged about an edge lies on the ground: the two points of the edge cannot move, the two others can."""
    made = cvi.Scene()
    made.add_halfspace()
    made.add_box("box", (0.1, 0.1, 0.1), mass=2.0, placement=(0.0, 0.0, 0.05))
    made.set_contact(restitution=0.5)
    for y in (-0.05, 0.05):
        made.add_point("box", "world", point_a=(-0.05, y, -0.05), point_b=(-0.05, y, 0.0))
    rate = 2.0  # [rad/s] about the edge, into the ground: the middle is at (0.05, 0, 0.05) from the edge
    found = cvi.simultaneous_outcomes(made, v=rate * np.array([0.05, 0.0, -0.05, 0.0, 1.0, 0.0]), tolerance=1e-9)
    (contact,) = found.contacts
    assert contact.mobile.sum() == 2
    assert contact.W[contact.mobile, 4] == pytest.approx([-0.05, -0.05], rel=1e-12)
    assert np.abs(found.chosen.v_plus + 0.5 * rate * np.array([0.05, 0.0, -0.05, 0.0, 1.0, 0.0])).max() <= 1e-12


def test_at_rest_nothing_happens():
    found = row([1, 1], (0.0, 0.0))
    assert found.unique
    assert found.chosen.sequence == ()
    assert not found.chosen.v_plus.any()


def test_it_reads_well():
    text = str(row([1, 3, 1], (1, 0, -1)))
    for part in ("2 closed contacts", "75.5225 deg", "no certificate", "at most 3 impacts", "2 outcomes"):
        assert part in text
    assert "chosen v+ = (-0.5, -0.25, 1.25)" in text
    assert "other  v+ = (-1.25, 0.25, 0.5)" in text
    assert "60 deg = pi/3" in str(row([1, 1, 1], (1, 0, 0)))


def test_two_sides_of_one_body_count_as_they_are():
    """A rod lying on two supports is struck at one end: the angle is that of the rod's inertia, by hand."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "rise")
    joint = model.addJoint(joint, pin.JointModelRY(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3) / 12.0), pin.SE3.Identity())
    shapes = {f"end{s:+d}": (joint, place(x=0.5 * s), coal.Sphere(0.05)) for s in (-1, 1)}
    shapes["ground"] = (0, place(), halfspace(0.0, 0.0, 1.0, -0.05))
    made = scene(model, geometry(shapes, [("ground", "end-1"), ("ground", "end+1")]))
    found = cvi.simultaneous_outcomes(made, np.zeros(2), (-1.0, 0.0))
    # W = (1, +-1/2), M = diag(1, 1/12): cos beta = -(1 - 3) / (1 + 3)
    assert found.certificate.angles[0, 1] == pytest.approx(math.pi / 3.0, abs=1e-14)
    assert found.certificate.certified
    assert np.abs(found.chosen.v_plus - (1.0, 0.0)).max() <= 8 * EPS


# --- faces -----------------------------------------------------------------------------------------------------------
def box_on_ground(e: float) -> tuple[cvi.Scene, np.ndarray]:
    made = cvi.Scene()
    made.add_box("box", (0.2, 0.3, 0.1), mass=2.0, placement=(0.0, 0.0, 0.05))
    made.add_halfspace(name="ground")
    made.set_contact(restitution=e)
    return made, made.neutral()


def test_a_face_is_one_impact():
    """A box that lands flat with e = 0.5 comes back straight up with half its speed, not with a spin."""
    made, q = box_on_ground(0.5)
    found = cvi.simultaneous_outcomes(made, q, np.array([0.3, 0.0, -2.0, 0.0, 0.0, 0.0]))
    assert [len(contact.W) for contact in found.contacts] == [4]
    assert found.unique
    # A turn is rounding of the impulses over the lever, a twentieth of a metre.
    assert np.abs(found.chosen.v_plus - [0.3, 0.0, 1.0, 0.0, 0.0, 0.0]).max() <= 2e-15 / 0.05
    assert found.chosen.impulses == pytest.approx([6.0], rel=1e-14)
    assert "box | ground (4 points)" in str(found)


def test_a_struck_face_has_no_certificate():
    """A ball falls on the middle of a box that lies on the ground: e = 1 of equal masses, by the sequence."""
    made, q = box_on_ground(1.0)
    made.add_sphere("ball", radius=0.0625, mass=2.0, placement=(0.0, 0.0, 0.1625))
    q = made.neutral()
    v = np.zeros(12)
    v[8] = -1.0
    found = cvi.simultaneous_outcomes(made, q, v, e=1.0)
    assert not found.certificate.certified
    assert "several points" in found.certificate.reason
    assert found.unique
    assert np.abs(found.chosen.v_plus - -v).max() <= 1e-12


def test_rows_of_points_are_the_gradients_of_gaps():
    """A box on its edge has two points; the mean of their rows is the change of its least gap."""
    made, q = box_on_ground(0.0)
    turned = pin.Quaternion(pin.exp3(np.array([0.0, 0.4, 0.0])))
    q[2], q[3:7] = 0.1 * math.sin(0.4) + 0.05 * math.cos(0.4), turned.coeffs()
    contact = cvi.simultaneous_outcomes(made, q, np.zeros(6)).contacts[0]
    assert contact.W.shape == (2, 6)
    step = 1e-6
    for k, direction in enumerate(np.eye(6)):
        if k in (3, 5):  # turns that lift one end of the edge: the least gap has a kink there
            continue
        ahead, behind = (made.core().gaps(pin.integrate(made.model, q, s * direction))[0][0] for s in (step, -step))
        assert contact.W[:, k].mean() == pytest.approx((ahead - behind) / (2 * step), abs=1e-8)


# --- the cradle ------------------------------------------------------------------------------------------------------
def test_newtons_cradle():
    made = cvi.load_scene(CRADLE)
    traj = cvi.simulate(made)
    period = pendulum_wall_period(0.5)
    times = traj.events.array("time").reshape(-1, 4)
    exact = period * (0.5 + np.arange(len(times)))
    assert len(times) == 5
    # The run is accurate to tol in q; at the impacts the speed of the balls is sin(.25) 2 sqrt(g) = 1.55 m/s.
    assert np.abs(times - exact[:, None]).max() <= 1e-9
    forth = [tuple(f"ball_{k + i}_0" for i in (0, 1)) for k in range(1, 5)]
    assert [event.pair for event in traj.events] == [*forth, *forth[::-1], *forth, *forth[::-1], *forth]
    resting = np.abs(traj.q[:, 1:4]).max()
    assert resting <= 1e-12  # the middle ones pass the speed on and stay
    assert np.abs(traj.energy - traj.energy[0]).max() <= 1e-9


@pytest.mark.parametrize("v", [(1, 0, 0, 0, 0), (1, 1, 0, 0, 0), (1, 1, 1, 0, 0), (1, 0, 0, 0, -1), (1, 0.5, 0, 0, -1)])
def test_the_cradle_has_one_answer_for_any_number_of_balls(v):
    made = cvi.load_scene(CRADLE)
    found = cvi.simultaneous_outcomes(made, np.zeros(5), np.array(v, dtype=float))
    assert found.unique
    assert found.certificate.certified
    # Equal masses only exchange their velocities, which end sorted.
    assert np.abs(found.chosen.v_plus - np.sort(v)).max() <= 64 * EPS
