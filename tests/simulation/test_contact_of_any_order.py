"""Persistent contact, joint friction and their changes in steps of orders 2 to 16, and with dt = "auto".

Each motion has a known answer (tests/oracles/held_contact.py). Changes of a contact lie anywhere within the steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pytest

import contactvi as cvi
from helpers import held_contact_scenes as scenes
from helpers.held_contact_scenes import Held
from oracles import joint_friction

ROLLING: dict[str, Callable[[], Held]] = {
    "ball slides, then rolls": scenes.slides_then_rolls,
    "ball rolls down": scenes.rolls_down,
}
EXACT: dict[str, Callable[[], Held]] = {
    "ball without friction": lambda: scenes.slides_then_rolls(0.0),
    "box slides to rest": lambda: scenes.box_slides(0.0, 0.3, 1.0, 1.0),
    "box slides up and back": lambda: scenes.box_slides(0.4, 0.3, 1.5, 1.0),
    "box slides up and stays": lambda: scenes.box_slides(0.4, 0.6, 1.5, 1.0),
}
MOTIONS: dict[str, Callable[[], Held]] = {
    **ROLLING,
    "slip turns": lambda: scenes.turning_slip(1.7, 0.8),
    "slip turns and ends": lambda: scenes.turning_slip(2.0, 1.4),
    "ball on a turntable": scenes.turntable,
    "point leaves a sphere": lambda: scenes.point_on_sphere(0.0, 0.0, 0.8),
    "point slides off a sphere": lambda: scenes.point_on_sphere(0.2, 1.2, 0.8),
    "ball rolls off a sphere": scenes.ball_off_sphere,
    **{f"ball rolls over: {kind}": partial(scenes.over_edge, "ball", kind) for kind in scenes.EDGES},
    "capsule rolls over: box": partial(scenes.over_edge, "capsule", "box"),
    "capsule rolls over: capsule": partial(scenes.over_edge, "capsule", "capsule"),
    "rod slides": lambda: scenes.rod_on_tip(0.3, 1.5, 0.3),
    "rod turns back": lambda: scenes.rod_on_tip(0.3, 0.4, 0.36),
    "rod sticks": lambda: scenes.rod_on_tip(0.5, 0.3, 0.36),
    "block on a belt": scenes.steady_belt,
    "block on a shaking belt": scenes.shaking_belt,
    "box on a tilting plane": scenes.tilting_plane,
    "pendulum with joint friction": scenes.rubbing_pendulum,
    "spring with joint friction": scenes.rubbing_spring,
    "coin goes round": scenes.rolling_coin,
    "coin wobbles": lambda: scenes.rolling_coin(1.0),
}
# Steps of the run at the orders 4, 8 and 16. Where a change lies within its step moves the errors by a factor of two or
# so: the numbers of steps are far apart, or the last one comes to rounding. What rolls turns by less than half a radian
# in a step: longer ones are cut in two, which makes the same steps of several dt.
STEPS: dict[str, tuple[Sequence[int], Sequence[int], Sequence[int]]] = {
    "ball slides, then rolls": ((20, 40, 160), (10, 20, 40), (4, 6, 10)),
    "ball rolls down": ((20, 40, 160), (10, 20, 40), (4, 6, 10)),
    "slip turns": ((5, 10, 40), (4, 8, 16), (2, 3, 4)),
    "slip turns and ends": ((10, 20, 80), (4, 8, 16), (2, 3, 5)),
    "ball on a turntable": ((80, 160, 320), (30, 45, 60), (15, 20, 30)),
    "point leaves a sphere": ((10, 20, 80), (5, 10, 20), (2, 3, 5)),
    "point slides off a sphere": ((10, 20, 80), (5, 10, 20), (2, 3, 5)),
    "ball rolls off a sphere": ((20, 40, 160), (10, 20, 40), (4, 6, 10)),
    **{f"ball rolls over: {kind}": ((20, 40, 160), (10, 20, 40), (4, 6, 10)) for kind in scenes.EDGES},
    "capsule rolls over: capsule": ((20, 40, 160), (10, 20, 40), (4, 6, 10)),
    "capsule rolls over: box": ((20, 40, 160), (10, 20, 40), (4, 6, 10)),
    "rod slides": ((10, 20, 40), (2, 4, 8), (1, 2, 3)),
    "rod turns back": ((10, 20, 80), (3, 6, 12), (1, 2, 3)),
    "rod sticks": ((10, 20, 80), (3, 6, 12), (1, 2, 3)),
    "block on a belt": ((20, 40, 160), (10, 20, 60), (4, 6, 10)),
    "block on a shaking belt": ((20, 40, 160), (10, 20, 60), (4, 6, 10)),
    "box on a tilting plane": ((5, 10, 40), (2, 3, 5), (1, 2, 3)),
    "pendulum with joint friction": ((40, 80, 320), (20, 40, 80), (12, 18, 24)),
    "spring with joint friction": ((30, 60, 240), (12, 24, 60), (5, 8, 12)),
    "coin goes round": ((40, 80, 160), (20, 30, 40), (15, 20, 30)),
    "coin wobbles": ((60, 120, 240), (30, 45, 60), (15, 20, 30)),
}
CHANGING = (
    "ball slides, then rolls", "slip turns and ends", "point leaves a sphere", "point slides off a sphere",
    "ball rolls off a sphere", "rod turns back", "rod sticks", "block on a belt", "block on a shaking belt",
    "box on a tilting plane",
)  # fmt: skip
ORDER_2 = (50, 200, 800)
# Between those: the beginning of a slip is not located at order 2, and the factor of the square of the step's length
# that this costs varies by three with the place within the step.
SLACK_2 = 0.5
SINGULAR = 1.7  # of a TurningSlip whose acceleration has a root of the time left in it
ROUNDING = 1e-11
# Of which only the answers of "auto" are looked at.
AUTO: dict[str, Callable[[], Held]] = {
    "slip turns and ends with a root": lambda: scenes.turning_slip(SINGULAR, 1.4),
    **{f"ball rolls over, and flies: {kind}": partial(scenes.over_edge, "ball", kind, True) for kind in scenes.EDGES},
    "capsule rolls over, and flies: capsule": partial(scenes.over_edge, "capsule", "capsule", True),
}


def observed_order(errors: Sequence[float], counts: Sequence[int]) -> float:
    return math.log(errors[0] / errors[-1]) / math.log(counts[-1] / counts[0])


def check_order(held: Held, order: int, counts: Sequence[int], slack: float = 0.3) -> None:
    """The error falls as it should between the longest and the shortest steps, or to that of rounding."""
    nodes = math.gcd(*counts)
    times = held.duration / nodes * np.arange(1, nodes + 1)
    exact = held.exact(np.append(0.0, times))[1:]
    errors = [float(held.errors(held.run(count, order), times, exact).max()) for count in counts]
    assert errors[-1] < ROUNDING or observed_order(errors, counts) > order - slack, errors
    assert errors[-1] < 2e-3


@pytest.mark.parametrize(
    ("name", "order"), [(name, order) for name in EXACT for order in (2, 4, 8, 16)] + [(name, 2) for name in ROLLING]
)
def test_what_is_exact(name, order):
    """Constant forces between the changes, and steps of any length.

    At order 2 a ball that rolls is exact, too. Above the spin at a stage is that of a polynomial of turns, and not the
    momentum of the stage over the inertia: what rolls has the error of the order.
    """
    held = {**EXACT, **ROLLING}[name]()
    for count in (7, 20):
        times = held.duration / count * np.arange(1, count + 1)
        exact = held.exact(np.append(0.0, times))[1:]
        # rounding of the pose and of the spin, some 20 rad/s, in body axes
        assert held.errors(held.run(count, order), times, exact).max() < ROUNDING


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", MOTIONS)
def test_order_2(name):
    check_order(MOTIONS[name](), 2, ORDER_2, SLACK_2)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", [4, 8, 16])
@pytest.mark.parametrize("name", MOTIONS)
def test_order(name, order):
    check_order(MOTIONS[name](), order, STEPS[name][{4: 0, 8: 1, 16: 2}[order]])


@pytest.mark.parametrize("name", CHANGING)
def test_times_of_changes(name):
    held = MOTIONS[name]()
    traj = held.run(STEPS[name][1][-1], 8)
    assert held.changes
    found = np.array([change.time for change in traj.contact_changes])
    for time in held.changes:
        # The end of a slip moves the motion by its error; its beginning, or the end of a contact, by the square.
        assert np.abs(found - time).min() < (1e-9 if time in held.slip_ends else 1e-6)


@pytest.mark.parametrize("order", [4, 8])
def test_twenty_cycles(order):
    """A block on a shaking belt sticks and slips forty times: the error of the order comes through all changes."""
    period = 2.0 * math.pi / 7.0
    held = scenes.shaking_belt(20.0 * period)
    assert len(held.changes) > 70
    check_order(held, order, {4: (200, 400, 1600), 8: (90, 180, 540)}[order])


@pytest.mark.parametrize("order", [4, 8])
def test_rolling_keeps_the_energy(order):
    """A coin wobbles: rolling does no work, and the energy has the error of the order only."""
    held = scenes.rolling_coin(1.0)
    counts = STEPS["coin wobbles"][{4: 0, 8: 1}[order]]
    ranges = [float(np.ptp(held.run(count, order).energy)) for count in counts]
    assert ranges[-1] < ROUNDING or observed_order(ranges, counts) > order - 0.3, ranges


@pytest.mark.parametrize("order", [4, 8, 16])
@pytest.mark.parametrize("name", EXACT)
def test_states_between_the_nodes(name, order):
    """Constant forces: the polynomials of the steps are the motion, on both sides of a change."""
    held = EXACT[name]()
    traj = held.run(10, order)
    times = np.linspace(0.0, held.duration, 73)[1:]
    states = [traj.at(t) for t in times]
    seen = held.observe(np.array([state.q for state in states]), np.array([state.v for state in states]))
    # the polynomial's rate where steps are short: rounding over their length
    assert np.abs(seen - held.exact(np.append(0.0, times))[1:]).max() < 1e-9


@pytest.mark.parametrize("order", [4, 8, 16])
def test_a_box_at_rest_stays(order):
    """After it has slid up a slope, in steps that are long beside the slide."""
    held = scenes.box_slides(0.4, 0.6, 1.5, 20.0)
    traj = held.run(40, order)
    stop = joint_friction.block_on_slope(1.5, 0.6, 0.4, mass=2.0).stop()
    assert stop is not None
    rows = held.observe(traj.q, traj.v)[traj.t > stop[0]]
    assert np.abs(rows[:, 0] - stop[1]).max() < 1e-12
    assert np.abs(rows[:, 1:]).max() < 1e-12


@pytest.mark.thinned(3)
@pytest.mark.parametrize("tol", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("name", [*MOTIONS, *AUTO])
def test_auto_meets_the_accuracy(name, tol):
    held = {**MOTIONS, **AUTO}[name]()
    traj = held.run_auto(tol)
    exact = held.exact(traj.t)
    error = np.abs(held.observe(traj.q, traj.v) - exact)[:, held.places].max()
    # of some coordinates only, and the estimate is one of the first order
    assert error <= 3.0 * traj.error_estimate
    assert traj.error_estimate <= tol


@pytest.mark.parametrize("name", ["ball rolls down", "slip turns", "rod slides", "coin goes round"])
def test_auto_takes_long_steps(name):
    """In a phase without changes the steps are those of the order, and not as short as contact of order 2 asks for."""
    held = MOTIONS[name]()
    assert len(held.run_auto(1e-6).t) < 100  # a second of some 10 rad/s, half a radian a step, and companion levels


@pytest.mark.parametrize("order", [4, 8, 16])
def test_corners_of_a_box_come_to_rest_together(order):
    """Four slips that share a load end at one time, in one attempt and without contact steps."""
    held = scenes.box_slides(0.0, 0.3, 1.0, 1.0)
    traj = held.run(5, order)
    assert traj.stats.contact_steps == 0
    stop = joint_friction.block_on_slope(1.0, 0.3, 0.0, mass=2.0).stop()
    assert stop is not None
    ends = [change.time for change in traj.contact_changes if change.time > 0.0]
    assert len(ends) == 4
    assert ends == pytest.approx([stop[0]] * 4, abs=1e-12)
    # of seven steps, and of some parts of one, 3 to 5 each; in halved steps 174
    assert traj.stats.stage_iterations < 60


@pytest.mark.parametrize("order", [4, 8, 16])
def test_what_the_matrix_does_not_know_is_accelerated(order):
    """A ball on a turntable, a radian a step: its rows turn with its spin, which the matrix leaves out."""
    held = scenes.turntable()
    # 12 to 14 a step; with the matrix made anew each time, and nothing else, 16 to 19
    assert held.run(20, order).stats.stage_iterations < 15 * 20


def test_motions_are_asked_a_few_times_for_a_step():
    """Once for each node of a step and each state at which the forces are looked at."""
    calls = 0

    class Counted(scenes.oracle.BlockOnBelt):
        def belt(self, t: float) -> tuple[float, float, float]:
            nonlocal calls
            calls += 1
            return super().belt(t)

    held = scenes.block_on_belt(Counted(40.0, 0.4, 0.5), 0.0, 0.2)
    calls = 0
    held.run(10, 8)
    # 98; with all states at either side of those, for the differences of the rows, 168
    assert calls < 12 * 10


@pytest.mark.parametrize("order", [2, 4])
def test_every_end_of_a_slip_in_one_step_is_located(order):
    """Six boxes on springs that hardly pull, which make them one island, stop within one step, each where it should."""
    scene, mu, boxes = cvi.Scene(), 0.3, 6
    scene.add_halfspace(name="ground")
    start, speeds = [], mu * 9.81 * (0.052 + 0.045 * np.arange(boxes) / boxes)
    for k in range(boxes):
        scene.add_box(f"b{k}", (0.2, 0.15, 0.1), mass=1.0)
        start += [0, 0.6 * k, 0.05, 0, 0, 0, 1]
        if k:
            scene.add_spring(f"b{k - 1}", f"b{k}", stiffness=1e-9, rest_length=0.6)
    scene.set_contact(friction=mu, restitution=0.0)
    v = np.outer(speeds, np.eye(6)[0]).ravel()
    traj = cvi.simulate(scene, start, v, 0.2, 0.05, order=order, contact_mode="events")
    assert traj.q[-1][::7] == pytest.approx(speeds**2 / (2.0 * mu * 9.81), abs=1e-12)
    assert traj.friction_loss[-1] == pytest.approx(0.5 * np.sum(speeds**2), rel=1e-10)
