"""Cases of several bodies: sequences of impacts, plastic impacts, supports, Newton's cradle, a stack."""

from __future__ import annotations

import itertools
import math

import numpy as np

from contactvi.reproduce.check import Check, at_most, near, same
from contactvi.simultaneous.simultaneous import simultaneous_outcomes
from contactvi.verify import systems
from contactvi.verify.case import Case, Runs

_EPS = "rounding of a few impacts"
_BALLS = [("ball_1", "ball_2"), ("ball_2", "ball_3")]


def blocks(runs: Runs) -> list[Check]:
    """Known: 3, 31, 314, ... collisions, the digits of pi."""
    checks = []
    for k, count in enumerate((3, 31, 314, 3141, 31415)):
        masses = np.array([100.0**-k, 1.0])  # with these, impulses are of order 1 for every ratio
        q = [systems.RADIUS + 1.0, 3.0 * systems.RADIUS + 2.0]
        # The last collision may close slowly: with the ratio 100^2 it comes after more than 6 s.
        traj = runs.simulate(systems.ball_row(masses), q, [0.0, -1.0], 500.0, 0.5, record_contacts=False)
        kinetic = 0.5 * np.sum(traj.p**2 / masses, axis=1)
        drift = float(np.abs(kinetic / kinetic[0] - 1.0).max())
        checks += [
            same(f"collisions, mass ratio 100^{k}", count, len(traj.events)),
            at_most(f"energy, relative error, 100^{k}", 1e-12, drift, "given by the case"),
        ]
    return checks


def chains(runs: Runs) -> list[Check]:
    """Known: n - 1 impacts, the last ball leaves with v."""
    impacts, errors = [], []
    for n in range(2, 9):
        q = systems.touching_balls(n, 1.0)
        q[0] -= 0.25
        traj = runs.simulate(systems.ball_row([1.0] * n, wall=False), q, np.eye(n)[0], 0.5, 0.0125)
        impacts.append([event.pair for event in traj.events])
        errors.append(float(np.abs(traj.v[-1] - np.eye(n)[-1]).max()))
    expected = [[(f"ball_{k}", f"ball_{k + 1}") for k in range(1, n)] for n in range(2, 9)]
    return [
        same("impacts, n = 2 .. 8", [n - 1 for n in range(2, 9)], [len(pairs) for pairs in impacts]),
        same("from one to the next, in this order", True, impacts == expected),
        at_most("velocities after, largest error [m/s]", 1e-13, max(errors), _EPS),
    ]


def three_balls(runs: Runs) -> list[Check]:
    """Known outcomes of sequential impacts; beta from the masses."""
    checks = []
    equal, unlike = systems.ball_row([1.0, 1.0, 1.0], wall=False), systems.ball_row([1.0, 3.0, 1.0], wall=False)
    q = systems.touching_balls(3, 1.0)
    for v, after in (((1, 0, 0), (0, 0, 1)), ((1, 0, -1), (-1, 0, 1)), ((1, 0.3, -1), (-1, 0.3, 1))):
        found = simultaneous_outcomes(equal, q, v)
        traj = runs.simulate(equal, q, v, 0.05, 0.0125)
        checks += [
            near(f"outcome of {v}", after, found.chosen.v_plus, 1e-14, _EPS),
            same(f"outcomes of {v}; certified", "1; True", f"{len(found)}; {found.certificate.certified}"),
            near(f"a run of {v}", after, traj.v[-1], 1e-13, _EPS),
        ]
    degrees = math.degrees(simultaneous_outcomes(equal, q, (1, 0, 0)).certificate.angles[0, 1])
    found = simultaneous_outcomes(unlike, q, (1, 0, -1))
    traj = runs.simulate(unlike, q, (1.0, 0.0, -1.0), 0.05, 0.0125)
    outcomes = sorted(outcome.v_plus.tolist() for outcome in found)
    return [
        *checks,
        near("beta, equal masses [deg]", 60.0, degrees, 1e-12, "rounding"),
        near("beta, masses 1 3 1 [deg]", math.degrees(math.acos(0.25)), math.degrees(found.certificate.angles[0, 1]),
             1e-12, "rounding"),
        near("outcomes of (1, 0, -1), masses 1 3 1", [(-1.25, 0.25, 0.5), (-0.5, -0.25, 1.25)], outcomes, 1e-14, _EPS),
        same("unique; bound ceil(pi/beta); impacts", "False; 3; [2, 2]",
             f"{found.unique}; {found.certificate.bound}; {[len(outcome.sequence) for outcome in found]}"),
        near("a run takes the lower number first", found.chosen.v_plus, traj.v[-1], 1e-13, "documented choice on ties"),
    ]  # fmt: skip


def wedges(runs: Runs) -> list[Check]:
    """Known: v -> -v where n is even, else only the part along the bisector is turned; in any order."""
    checks = []
    for n in (2, 3, 4, 5):
        scene, q = systems.ball_in_wedge(n)
        angle = math.pi + 0.3 * math.pi / n
        v = np.array([math.cos(angle), math.sin(angle), 0.0, 0.0, 0.0, 0.0])
        after = -v if n % 2 == 0 else v * [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
        found = simultaneous_outcomes(scene, q, v)
        traj = runs.simulate(scene, q, v, 0.05, 0.0125)
        checks += [
            near(f"v+, pi/{n}", after[:2], found.chosen.v_plus[:2], 1e-14, _EPS),
            same(f"orders with another outcome; impacts, pi/{n}", f"0; {n}",
                 f"{len(found) - 1}; {len(found.chosen.sequence)}"),
            near(f"v+ of a run, pi/{n}", after[:2], traj.v[-1, :2], 1e-13, _EPS),
        ]  # fmt: skip
    return checks


def plastic_balls(runs: Runs) -> list[Check]:
    """Known: (1/3, 1/3, 1/3), energy 1/6; not (-1/3, 2/3, 2/3), which Newton's law for simultaneous impacts gives."""
    scene, q = systems.ball_row([1.0, 1.0, 1.0], e=0.0, wall=False), systems.touching_balls(3, 1.0)
    checks = []
    for impact in ("ctec", "mhc"):
        traj = runs.simulate(scene, q, (1.0, 0.0, 0.0), 0.05, 0.0125, impact=impact)
        energy = 0.5 * float(np.sum(traj.v[-1] ** 2))
        checks += [
            near(f"velocities after, {impact}", np.full(3, 1.0 / 3.0), traj.v[-1], 1e-12, "gamma+ = 0 to 1e-12"),
            near(f"energy after [J], {impact}", 1.0 / 6.0, energy, 1e-12, "gamma+ = 0 to 1e-12"),
        ]
    found = simultaneous_outcomes(scene, q, (1.0, 0.0, 0.0))
    return [*checks, near("simultaneous_outcomes", np.full(3, 1.0 / 3.0), found.chosen.v_plus, 1e-14, _EPS)]


def carnot(runs: Runs) -> list[Check]:
    """Closed form: gamma+ = 0 and the loss is gamma-^T G_c^-1 gamma- / 2 where all contacts stay closed."""
    checks = []
    turn = np.array([[1.0, -0.5], [1.0, 0.5]])  # the ends of a rod that lies flat: speeds of (z, about y)
    rod = systems.rod(
        {"left": 0.5, "right": -0.5}, {"ground": systems.halfspace(0.0, 0.0, 1.0)},
        [("ground", "left"), ("ground", "right")], 0.0625, 0.0,
    )  # fmt: skip
    cases = (
        ("three balls", systems.ball_row([2.0, 1.0, 3.0], e=0.0, wall=False), systems.touching_balls(3, 1.0),
         np.array([1.0, 0.2, -0.7]), np.array([2.0, 1.0, 3.0]), np.array([[-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])),
        ("rod on both ends", rod, np.array([0.0, 0.0625, 0.0]), np.array([0.3, -1.0, 0.5]),
         np.array([1.0, 1.0, 1.0 / 12.0]), np.column_stack([np.zeros(2), turn])),
    )  # fmt: skip
    for (name, scene, q, v, mass, W), impact in itertools.product(cases, ("ctec", "mhc")):
        traj = runs.simulate(scene, q, v, 0.05, 0.0125, impact=impact)
        loss = 0.5 * float(v @ (mass * v) - traj.v[-1] @ (mass * traj.v[-1]))
        gamma = W @ v
        exact = 0.5 * float(gamma @ np.linalg.solve(W @ np.diag(1.0 / mass) @ W.T, gamma))
        checks += [
            at_most(f"gamma+ [m/s], {name}, {impact}", 1e-12, float(np.abs(W @ traj.v[-1]).max()), "given by the case"),
            near(f"loss [J], {name}, {impact}", exact, loss, 1e-12, "given by the case"),
        ]
    return checks


def supports(runs: Runs) -> list[Check]:
    """A ball (e = 1) falls on a ball at rest on the ground (e_g): velocities right after over the speed before it.

    Fractions by hand, as sequences of single impacts; on a stiff support the ball comes back as it came.
    """
    table = {
        (1, 1): {1.0: (1.0, 0.0), 0.5: (0.5, 0.0), 0.0: (0.0, 0.0)},
        (1, 3): {1.0: (0.5, 0.5), 0.5: (0.5, 0.25), 0.0: (0.5, 0.0)},
        (3, 1): {1.0: (1.0, 0.0), 0.5: (0.34375, 0.046875), 0.0: (0.0, 0.0)},
    }
    checks = []
    for (upper, lower), rows in table.items():
        expected: list[tuple[float, float]] = []
        got: list[np.ndarray] = []
        stiff: list[np.ndarray] = []
        for ground, after in rows.items():
            for support in ("sequence", "stiff"):
                scene = systems.ball_row([lower, upper], axis="z", gravity=systems.GRAVITY)
                scene.set_contact("wall", "ball_1", restitution=ground)
                q = systems.touching_balls(2) + [0.0, 0.05]
                traj = runs.simulate(scene, q, np.zeros(2), 0.12, 0.01, support=support)
                time = traj.events.array("time")
                last = int(np.flatnonzero(np.abs(time - time[0]) <= 1e-9)[-1])
                speed = math.sqrt(2.0 * systems.GRAVITY * 0.05)
                ratio = traj.events[last].p_plus / [lower, upper] / speed
                (got if support == "sequence" else stiff).append(ratio[::-1])
            expected.append(after)
        reason = "an endless sequence is cut at 1e-9 of the speeds; the fall is located to 1e-12 m"
        checks += [
            near(f"upper, lower; masses {upper}:{lower}, e_g = 1 .5 0", expected, got, 2e-9, reason),
            near(f"stiff support, masses {upper}:{lower}", [(1.0, 0.0)] * 3, stiff, 1e-11, reason),
        ]
    return checks


def cradle(runs: Runs) -> list[Check]:
    """Closed form: the outer balls are pendulums at a wall, 2 sqrt(l/g) K(sin(theta0/2)); those between stay."""
    traj = runs.simulate(systems.newtons_cradle(), [-0.5, 0.0, 0.0, 0.0, 0.0], np.zeros(5), 5.0, tol=1e-10)
    times = traj.events.array("time")
    exact = np.repeat(1.0189339576 * (0.5 + np.arange(5)), 4)
    return [
        near("times of the impacts [s]", exact, times, 1e-9, "ten digits given, five periods; tol 1e-10"),
        at_most("balls between, largest angle [rad]", 1e-10, float(np.abs(traj.q[:, 1:4]).max()), "tol of the run"),
        at_most("energy, largest change [J]", 1e-9, float(np.abs(traj.energy - traj.energy[0]).max()),
                "tol of the run times the weight of 10 N"),
    ]  # fmt: skip


def beside(runs: Runs) -> list[Check]:
    """A ball bounces (e = 1, from 1 m) while another rests 1 m beside it: closed form of an elastic bounce."""
    checks, first = [], math.sqrt(2.0 / systems.GRAVITY)
    for h in (0.02, 0.01, 0.005, 0.001):
        scene = systems.ball_over_ground(1.0)
        scene.add_sphere("resting", radius=0.1, placement=(1.0, 0.0, 0.1))
        q = scene.neutral()
        q[2] = 1.1
        traj = runs.simulate(scene, q, np.zeros(12), 5.0, h)
        times = traj.events.array("time")[traj.events.array("gamma_minus") < -1.0]
        count = int((5.0 / first + 1.0) / 2.0)
        checks += [
            near(f"times of impacts [s], h = {h:g}", first * (1.0 + 2.0 * np.arange(count)), times, 1e-10,
                 "a free flight is exact; located to 1e-12 m"),
            at_most(f"the other moved [m], h = {h:g}", 1e-12, float(np.abs(traj.q[:, 7:] - q[7:]).max()), "no creep"),
        ]  # fmt: skip
    return checks


def stack(runs: Runs) -> list[Check]:
    """Five cubes of 1 kg on each other for 10 s: nothing moves, every one carries the weight above it."""
    scene = systems.box_stack(5, 0.25)
    start = scene.neutral()
    traj = runs.simulate(scene, start, np.zeros(30), 10.0, 0.01)
    pairs = [("box_1", "ground")] + [(f"box_{k}", f"box_{k + 1}") for k in range(1, 5)]
    loads = [float(np.abs(traj.contacts.force_of(*pair)[1][-1, 2])) for pair in pairs]
    moved = float(np.abs(traj.q - start).max())
    return [
        at_most("largest velocity [m/s, rad/s]", 1e-10, float(np.abs(traj.v).max()), "no jitter"),
        at_most("moved in 10 s [m]", 1e-10, moved, "no creep"),
        near("loads from below [N]", systems.GRAVITY * np.arange(5, 0, -1), loads, 1e-8, "steps are solved to 1e-12"),
    ]


CASES = (
    Case("two-blocks", "two blocks and a wall: digits of pi", blocks, former="N10"),
    Case("ball-chains", "chains of equal touching balls", chains, former="N11"),
    Case("three-balls", "three balls: unique outcomes, and exactly two", three_balls, former="N13"),
    Case("wedge", "a particle in a wedge of angle pi/n", wedges, former="N14"),
    Case("plastic-balls", "three plastic balls", plastic_balls, former="N15"),
    Case("plastic-contacts", "plastic impacts on two contacts: Carnot's loss", carnot, former="plastic"),
    Case("supports", "a ball falls on one that lies on the ground", supports),
    Case("cradle", "Newton's cradle", cradle),
    Case("beside", "a ball bounces while another one rests", beside),
    Case("stack", "five boxes on each other for 10 s", stack),
)
