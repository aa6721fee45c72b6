"""Cases of single bodies and impacts: problem B, balls, a pendulum, a rod, grazing impacts, a thin plate."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from contactvi.reproduce.check import Check, at_most, near, same
from contactvi.reproduce.systems import ABSOLUTE, START
from contactvi.scene.scene import Scene
from contactvi.trajectory.trajectory import Trajectory
from contactvi.verify import systems
from contactvi.verify.case import Case, Runs, changes_of, largest

_G = systems.GRAVITY
_DIGITS = "the digits given, half a unit of the last, and the run's tol"
_LOCATED = "impacts are located to 1e-12 m; errors add up over them"


def problem_b(runs: Runs) -> list[Check]:
    """Reference of the case: an event-located DOP853 run at rtol 1e-13."""
    scene = systems.double_pendulum_at_wall(0.0)
    traj = runs.simulate(scene, np.linalg.solve(ABSOLUTE, START), np.zeros(2), 3.0, tol=1e-11)
    time, speed, impulse = (traj.events.array(name) for name in ("time", "gamma_minus", "impulse"))
    return [
        near("times of the impacts [s]", [0.656671045, 2.017056240], time, 6e-10, _DIGITS),
        near("gamma- [m/s]", [-1.844474252, -1.025804628], speed, 6e-10, _DIGITS),
        near("impulses [N s]", [3.691654896, 2.131421633], impulse, 6e-10, _DIGITS),
        near("q(3), absolute [rad]", [0.3205793585, -0.2173609757], ABSOLUTE @ traj.q[-1], 1e-10, _DIGITS),
        near("v(3), absolute [rad/s]", [-1.1276643332, 1.2653022812], ABSOLUTE @ traj.v[-1], 2e-10, _DIGITS),
    ]


def bouncing_ball(runs: Runs) -> list[Check]:
    """Closed form: t_n = t1 (1 + 2 (e + .. + e^(n-1))), apexes e^2n, accumulation at t1 (1 + e) / (1 - e)."""
    checks, first = [], math.sqrt(2.0 / _G)
    for e, zeno in ((0.9, 8.5789491787), (0.5, 1.354571)):
        scene = systems.ball_over_ground(e)
        traj = runs.simulate(scene, systems.at_height(scene, 1.1), np.zeros(6), 10.0, 0.01)
        events, of = traj.events, f", e = {e:g}"
        n = len(events)
        powers = e ** np.arange(n)
        times = first * (1.0 + 2.0 * (np.cumsum(powers) - 1.0))
        bounced = events.array("restitution") > 0.0
        apex = events.array("gamma_plus")[bounced] ** 2 / (2.0 * _G)
        ended = changes_of(traj, "bouncing ended")
        exact = first * (1.0 + e) / (1.0 - e)
        digits = "the closed form; accumulated location error of 1e-12 m, over (1 - e)"
        rest = traj.t >= zeno + 1e-3
        checks += [
            near(f"first impact [s]{of}", 0.4515236410, events.array("time")[0], 6e-11, "the digits given"),
            at_most(f"times of impacts, largest error [s]{of}", 1e-9, largest(events.array("time") - times), _LOCATED),
            at_most(f"apexes, largest error [m]{of}", 1e-10, largest(apex - e ** (2.0 * np.arange(1, n + 1))[bounced]),
                    "half of gamma+^2 / g; the gap is located to 1e-12 m"),
            near(f"bouncing ended [s]{of}", exact, ended[0].value if ended else math.nan, 1e-9, digits),
            near(f"closed form, digits given{of}", zeno, exact, 6e-7 if e == 0.5 else 6e-11, "the digits given"),
            at_most(f"off the ground 1 ms later [m]{of}", 1e-10, largest(traj.q[rest, 2] - 0.1),
                    "phi of persistent contact"),
            at_most(f"speed from then on [m/s]{of}", 1e-10, largest(traj.v[rest]), "it is projected at the nodes"),
        ]  # fmt: skip
    return checks


def dtec_ball(runs: Runs) -> list[Check]:
    """Closed form of the midpoint rule: dH = m g^2 h (r - a) / 8 at an impact, a of the step before and r after it."""
    scene, h = systems.ball_over_ground(1.0), 0.01
    traj = runs.simulate(scene, systems.at_height(scene, 1.1), np.zeros(6), 10.0, h, impact="dtec", solver_tol=1e-14)
    events = traj.events
    a, r = events.array("before"), events.array("after")
    minus, plus = events.array("p_minus")[:, 2], events.array("p_plus")[:, 2]
    jump = 0.5 * (plus**2 - minus**2)
    return [
        same("impacts that DTEC solved", len(events), int((events.array("fallback") == 0).sum())),
        at_most("dH - m g^2 h (r - a)/8, largest [J]", 1e-13, largest(jump - _G**2 * h * (r - a) / 8.0),
                "given by the case; rounding of energies of 10 J is 2e-15"),
        at_most("p+^2 - p-^2 - m^2 g^2 (r^2 - a^2)/4, largest", 2e-13,
                largest(plus**2 - minus**2 - _G**2 * (r**2 - a**2) / 4.0), "twice the bound of dH, m = 1"),
    ]  # fmt: skip


def mhc_ball(runs: Runs) -> list[Check]:
    """On a ball under gravity MHC is CTEC: the modified energy differs from the energy by a constant."""
    scene = systems.ball_over_ground(1.0)
    found: dict[str, Trajectory] = {
        name: runs.simulate(
            scene, systems.at_height(scene, 1.1), np.zeros(6), 20.0, 0.01, impact=name, solver_tol=1e-14
        )
        for name in ("ctec", "mhc")
    }
    mhc, ctec = found["mhc"].events, found["ctec"].events
    if len(mhc) != len(ctec):
        return [same("impacts", len(ctec), len(mhc))]
    drift = found["mhc"].energy / found["mhc"].energy[0] - 1.0
    apart = mhc.array("impulse") / ctec.array("impulse") - 1.0
    return [
        same("impacts that MHC solved", len(mhc), int((mhc.array("fallback") == 0).sum())),
        at_most("impulses, MHC / CTEC - 1", 1e-11, largest(apart), "both located to 1e-12 m, over 22 impacts"),
        at_most("energy, relative error", 1e-12, largest(drift), "given by the case"),
    ]


def pendulum_at_wall(runs: Runs) -> list[Check]:
    """Closed form: 2 sqrt(l/g) K(sin(theta0/2)) between two hits of the wall at theta = 0."""
    checks = []
    for start, period in ((0.5, 1.0189339576), (1.0, 1.0695688003), (1.5, 1.1654933911)):
        traj = runs.simulate(systems.pendulum_at_wall(), [start], [0.0], 6.0, tol=1e-10)
        times = traj.events.array("time")
        name = f"time between impacts [s], theta0 = {start:g}"
        checks += [
            near(name, np.full(len(times) - 1, period), np.diff(times), 1e-9, "the digits given; tol 1e-10 over 6 s"),
            same(f"impacts, theta0 = {start:g}", int(6.0 / period + 0.5), len(times)),
        ]
    return checks


def rod(runs: Runs) -> list[Check]:
    """Closed form: P = 2 / (1 + 3 cos^2 th)."""
    checks = []
    for degrees, v_com, omega in (
        (0, -0.5, 3.0),
        (30, -0.384615, 3.197632),
        (45, -0.2, 3.394113),
        (60, 0.142857, 3.428571),
    ):
        theta = math.radians(degrees)
        scene, q = systems.rod_on_ground(theta, 0.01, 1.0)
        q[1] += 0.05
        traj = runs.simulate(scene, q, [0.0, -1.0, 0.0], 0.1, 0.01)
        impulse = 2.0 / (1.0 + 3.0 * math.cos(theta) ** 2)
        event = traj.events[0]
        checks += [
            near(f"P [N s], {degrees} deg", impulse, event.impulse, 1e-12, "rounding of a located impact"),
            # A turn about y, from z to x, lifts the end that hits the ground.
            near(f"v_com, omega, {degrees} deg", [v_com, omega], event.p_plus[1:] * [1.0, 12.0], 6e-7, "digits given"),
        ]  # fmt: skip
    return checks


def free_body(runs: Runs) -> list[Check]:
    """A box thrown about its middle axis without gravity: it turns over, its angular momentum stays."""
    scene = Scene((0.0, 0.0, 0.0))
    scene.add_box("box", (0.1, 0.3, 0.2), mass=1.0)
    v = np.array([0.1, 0.0, 0.0, 0.02, 0.01, 8.0])
    traj = runs.simulate(scene, scene.neutral(), v, 50.0, 0.005)
    momentum = traj.ledger.angular_momentum
    size = float(np.linalg.norm(momentum[0]))
    turned = traj.v[:, 5].min() / traj.v[:, 5].max()
    return [
        same("steps", 10_000, traj.stats.steps),
        at_most(
            "drift of the angular momentum, relative",
            1e-10,
            largest(momentum - momentum[0]) / size,
            "given by the case",
        ),
        at_most("it turned over: least / largest spin", -0.9, turned, "the middle axis is unstable"),
    ]


def grazing(runs: Runs) -> list[Check]:
    """Problem B with its wall where the tip just reaches it: depth of the free motion beyond it from 1e-2 to 1e-12 m.

    The free motion comes from DOP853 at rtol 1e-13; its gap is parabolic there, so gamma- = -sqrt(2 a depth).
    """

    def speed(_t: float, y: np.ndarray) -> float:
        return float(math.cos(y[0]) * y[2] + math.cos(y[1]) * y[3])

    speed.direction = 1.0  # type: ignore[attr-defined]  # from approach to separation
    y = np.array([*START, 0.0, 0.0])
    turn = solve_ivp(_rate, (0.0, 1.5), y, method="DOP853", rtol=1e-13, atol=1e-14, events=speed, dense_output=True)
    state = turn.y_events[0][0]
    least, when = float(np.sin(state[:2]).sum()), float(turn.t_events[0][0])
    slope = np.array(_rate(0.0, state))[2:]
    bend = float(np.cos(state[:2]) @ slope - np.sin(state[:2]) @ state[2:] ** 2)
    counts, steps, speeds, jumps = [], [], [], []
    depths = (1e-2, 1e-4, 1e-6, 1e-8, 1e-9, 1e-10, -1e-10, -1e-8, -1e-4)
    end = 0.05 * math.ceil((when + 0.1) / 0.05)
    for depth in depths:
        q = np.linalg.solve(ABSOLUTE, START)
        traj = runs.simulate(systems.double_pendulum_at_wall(least + depth), q, np.zeros(2), end, 0.05, order=16)
        counts.append(len(traj.events))
        steps.append(traj.stats.steps)
        jumps.append(largest(traj.energy - traj.energy[0]))
        if depth > 0.0 and len(traj.events) == 1:
            speeds.append(traj.events[0].gamma_minus / -math.sqrt(2.0 * bend * depth) - 1.0)
    return [
        same("impacts at depths 1e-2 .. 1e-10 m, then beside the wall", [1] * 6 + [0] * 3, counts),
        at_most("energy, largest change [J]", 1e-8, max(jumps), "given by the case"),
        same("steps, each", [round(end / 0.05)] * len(depths), steps, "grazing costs no steps"),
        at_most("gamma- / -sqrt(2 a depth) - 1 from 1e-4 m down", 0.01, largest(np.array(speeds[1:])),
                "the parabola is off by the depth to the power 1/2: 1 % at 1e-4 m"),
    ]  # fmt: skip


def thin_plate(runs: Runs) -> list[Check]:
    """A 5 mm ball at 20 m/s moves 0.2 m per step of 1e-2 s towards a plate of 2 mm."""
    checks = []
    for gap in (0.25, 0.3, 0.387):
        scene = Scene((0.0, 0.0, 0.0))
        scene.add_sphere("ball", radius=0.0025, mass=0.001)
        scene.add_box("plate", (0.2, 0.2, 0.002), free=False)
        scene.set_contact(restitution=1.0)
        q = systems.at_height(scene, 0.001 + 0.0025 + gap)
        traj = runs.simulate(scene, q, [0.0, 0.0, -20.0, 0.0, 0.0, 0.0], 0.05, 1e-2)
        times = traj.events.array("time")
        box = "distances of a rounded box come from an iteration, good to 1e-10 m"
        checks += [
            near(f"impact [s], {gap:g} m away", [gap / 20.0], times, 1e-11, box),
            near(
                f"height at the end [m], {gap:g} m away", 20.0 * (0.05 - gap / 20.0), traj.q[-1, 2] - 0.0035, 1e-9, box
            ),
        ]
    return checks


def _rate(_t: float, y: np.ndarray) -> list[float]:
    """Return d(a1, a2, w1, w2)/dt of problem B without its wall, absolute angles, by hand."""
    c, s = math.cos(y[0] - y[1]), math.sin(y[0] - y[1])
    f1 = -s * y[3] ** 2 - 2.0 * _G * math.sin(y[0])
    f2 = s * y[2] ** 2 - _G * math.sin(y[1])
    return [y[2], y[3], (f1 - c * f2) / (2.0 - c * c), (2.0 * f2 - c * f1) / (2.0 - c * c)]


CASES = (
    Case("double-pendulum", "the paper's double pendulum at a wall, elastic", problem_b, former="B"),
    Case("bouncing-ball", "bouncing ball, e = .9 and .5: it comes to rest and stays", bouncing_ball, former="N01"),
    Case("dtec-ball", "DTEC's closed form on an elastic ball", dtec_ball, former="N06"),
    Case("mhc-ball", "on an elastic ball MHC is CTEC", mhc_ball, former="N07"),
    Case("pendulum-at-wall", "pendulum at a wall: elliptic periods", pendulum_at_wall, former="N08"),
    Case("rod", "a rod hits the ground with one end", rod, former="N16"),
    Case("tumbling-box", "free asymmetric body, 10^4 steps", free_body, former="N26-racket"),
    Case(
        "ball-in-bowl",
        "ball in a bowl",
        None,
        "contact shapes are convex; the inside of a bowl is not, and pieces of one are not smooth",
        former="N26-bowl",
    ),
    Case("grazing", "grazing: problem B at a wall that it barely reaches", grazing, former="N27"),
    Case("thin-plate", "a 5 mm ball at 20 m/s meets a plate of 2 mm", thin_plate, former="plate"),
)
