"""Cases of persistent contact: balls, Painleve's rod, boxes, rolling, a ladder, a joint limit."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from scipy.integrate import quad

from contactvi.reproduce.check import Check, at_least, at_most, near, same
from contactvi.trajectory.trajectory import Trajectory
from contactvi.verify import systems
from contactvi.verify.case import Case, Runs, changes_of, largest

_G = systems.GRAVITY
_EVEN = "constant acceleration is exact in the midpoint rule; steps are solved to 1e-12"


def dropped_ball(runs: Runs) -> list[Check]:
    """Closed form of a fall from 0.9 m with e = 0.5: accumulation at t1 (1 + e) / (1 - e) = 3 t1."""
    scene = systems.ball_over_ground(0.5, 0.2)
    traj = runs.simulate(scene, systems.at_height(scene, 1.0), np.zeros(6), 2.0, 0.01)
    first, ended = traj.events[0], times_of(traj, "bouncing ended", "value")
    rest = traj.t >= 1.29
    return [
        near("first impact [s]", 0.4283529369, first.time, 6e-11, "the digits given"),
        near("v- [m/s]", -4.2021423108, first.gamma_minus, 6e-11, "the digits given"),
        near("bouncing ended [s]", [1.2850588106], ended, 1e-9, "accumulated location error of 1e-12 m"),
        at_most("off y = R from 1.29 s on [m]", 1e-10, largest(traj.q[rest, 2] - 0.1), "phi of persistent contact"),
        at_most("speed from then on [m/s, rad/s]", 1e-10, largest(traj.v[rest]), "velocity is projected at the nodes"),
    ]


def spinning_ball(runs: Runs) -> list[Check]:
    """Closed form: P_F = mu P_N while it slips, -2/7 of R omega when it has come to roll."""
    scene, mass = systems.ball_over_ground(0.0, 0.2, mass=2.0), 2.0
    v = np.array([0.0, 0.0, 0.0, 0.0, -50.0, 0.0])  # about -y: counterclockwise seen with x right and z up
    traj = runs.simulate(scene, systems.at_height(scene, 1.0), v, 1.0, 0.01)
    event, stick = traj.events[0], times_of(traj, "stick")
    after = np.asarray(traj.scene.core().velocity(event.q[None], event.p_plus[None]))[0]
    impulse = event.impulse_vector * (1.0 if event.pair[1] == "ball" else -1.0)  # on the second shape
    digits, located = "the digits given", "the digits given; the stick is located to 1e-10 s"
    return [
        near("P_N / m [m/s]", 4.2021423108, impulse[2] / mass, 6e-11, digits),
        near("P_F / m [m/s]", -0.8404284622, impulse[0] / mass, 6e-11, digits),
        # The body frame turns about y only, so that its angular velocity about y is the world's.
        near("omega after the impact [rad/s]", 28.9892884461, -after[4], 6e-10, digits),
        near("sticks at [s]", [0.7281199942], stick[:1], 1e-9, located),
        near("x' at 1 s [m/s]", -10.0 / 7.0, world_velocity(traj)[0], 1e-9, located),
        near("omega at 1 s [rad/s]", 100.0 / 7.0, -traj.v[-1, 4], 1e-8, located),
        near("place at 1 s [m]", _rolled(), traj.q[-1, 0], 2e-9, "the speeds, over 0.6 s"),
    ]


def _rolled() -> float:
    hit, stick = 0.4283529369, 0.7281199942
    slid = -0.8404284622 * (stick - hit) - 0.5 * 1.962 * (stick - hit) ** 2
    return slid - 10.0 / 7.0 * (1.0 - stick)


def painleve(runs: Runs) -> list[Check]:
    """Closed form: A = 1 + 3 c^2 - 3 mu s c (with a ball at the end: - 6 mu c r); the force is m g / A at the start."""
    theta, radius = math.atan(2.0), 1e-4
    s, c = math.sin(theta), math.cos(theta)
    checks = []
    for mu in (1.2, 1.4):
        scene, q = systems.rod_on_ground(theta, radius, 0.0, mu, _G)
        traj = runs.simulate(scene, q, [-1.0, 0.0, 0.0], 0.05, 1e-4)
        A = 1.0 + 3.0 * c * c - 6.0 * mu * c * (0.5 * s + radius)
        reported = len(times_of(traj, "inconsistent"))
        finite = bool(np.isfinite(traj.q).all() and np.isfinite(traj.v).all())
        checks.append(same(f"all numbers finite, mu = {mu:g}", True, finite))
        if A > 0.0:
            force = float(traj.contacts.on("end")[1][0, 2])
            checks += [
                same(f"reported inconsistencies, mu = {mu:g} < 4/3", 0, reported),
                same(f"impacts, mu = {mu:g}", 0, int((traj.events.array("impulse") > 0.0).sum())),
                near(f"normal force in the first step [N], mu = {mu:g}", _G / A, force, 2e-3,
                     "mean of a step of 1e-4 s: A changes by some 1e-5 of itself in it"),
            ]  # fmt: skip
        else:
            answered = reported > 0 or len(traj.events) > 0
            checks.append(same(f"an inconsistency or an impact reported, mu = {mu:g} > 4/3", True, answered))
    return checks


def box_on_slope(runs: Runs) -> list[Check]:
    """A box in the friction cone stays for 100 s."""
    slope = math.radians(30.0)
    checks = []
    for factor in (1.02, 1.5):
        scene, q = systems.box_on_ground((0.2, 0.3, 0.1), 0.0, factor * math.tan(slope), slope)
        traj = runs.simulate(scene, q, np.zeros(6), 100.0, 0.05)
        checks += [
            at_most(f"moved in 100 s [m], mu = {factor:g} tan", 1e-10, largest(traj.q - q), "given by the case"),
            at_most(f"largest velocity, mu = {factor:g} tan", 1e-10, largest(traj.v), "no jitter"),
        ]
    return checks


def box_slides(runs: Runs) -> list[Check]:
    """Closed form: a = g (sin - mu cos)."""
    slope, mu = math.radians(30.0), 0.3
    scene, q = systems.box_on_ground((0.2, 0.3, 0.1), 0.0, mu, slope)
    traj = runs.simulate(scene, q, np.zeros(6), 1.0, 0.01)
    a = _G * (math.sin(slope) - mu * math.cos(slope))
    down = np.array([math.cos(slope), 0.0, -math.sin(slope)])
    return [
        near("way in 1 s [m]", 0.5 * a, (traj.q[-1, :3] - q[:3]) @ down, 1e-10, _EVEN),
        near("speed [m/s]", a, traj.v[-1, 0], 1e-10, _EVEN),
        at_most("turned [rad/s]", 1e-10, largest(traj.v[:, 3:]), _EVEN),
    ]


def box_stops(runs: Runs) -> list[Check]:
    """Closed form: a box on the flat with 1 m/s and mu = 0.3 stops after 1/(mu g) s, 1/(2 mu g) m, and stays."""
    scene, q = systems.box_on_ground((0.2, 0.3, 0.1), 0.0, 0.3)
    traj = runs.simulate(scene, q, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1.0, 0.01)
    located = "the stick is located inside its step to 1e-10 s"
    return [
        near("way [m]", 0.5 / (0.3 * _G), traj.q[-1, 0] - q[0], 1e-10, "the speed is zero there: " + located),
        near("stops at [s]", [1.0 / (0.3 * _G)], np.unique(times_of(traj, "stick").round(9))[:1], 1e-9, located),
        at_most("moved after that [m]", 1e-12, largest(traj.q[traj.t > 0.36, 0] - traj.q[-1, 0]), "anchors: no creep"),
    ]


def flat_box(runs: Runs) -> list[Check]:
    """A face is one impact: a box dropped flat comes back with e v, straight up, by four equal impulses."""
    scene, q = systems.box_on_ground((0.2, 0.3, 0.1), 0.5, 0.4)
    q[2] += 0.5
    traj = runs.simulate(scene, q, np.zeros(6), 0.4, 0.01)
    event = traj.events[0]
    after = np.asarray(traj.scene.core().velocity(event.q[None], event.p_plus[None]))[0]
    speed = math.sqrt(2.0 * _G * 0.5)
    log = traj.contacts
    points = log.normal_impulse[(log.h == 0.0) & (log.t == event.time)]
    return [
        near("velocity after [m/s]", [0.0, 0.0, 0.5 * speed], after[:3], 1e-11, "located to 1e-12 m"),
        at_most("spin after [rad/s]", 1e-10, largest(after[3:]), "rounding over the box's inertia of 1e-3"),
        near(
            "impulses of the corners [N s]",
            np.full(4, 1.5 * speed / 4.0),
            points,
            1e-10,
            "least norm of a redundant face",
        ),
    ]


def rocking_box(runs: Runs) -> list[Check]:
    """Housner: a plastic block that rocks from one edge to the other keeps 1 - 1.5 sin^2 of its spin, tan = b/h.

    With edges rounded by r the points of contact stand at a = b/2 - r: (I + m (h^2/4 - a^2)) / (I + m (h^2/4 + a^2)).
    """
    b, h = 0.1, 0.3
    scene, q = systems.box_on_ground((b, 0.2, h), 0.0, 3.0)
    r = max(scene.core().rounding)
    tilt = 0.1
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, tilt, 0.0]))).coeffs()
    # The block is raised until its lower rounded edge touches the ground.
    q[2] = (0.5 * b - r) * math.sin(tilt) + (0.5 * h - r) * math.cos(tilt) + r
    traj = runs.simulate(scene, q, np.zeros(6), 0.6, 0.0025)
    inertia, a = (b * b + h * h) / 12.0, 0.5 * b - r
    exact = (inertia + h * h / 4.0 - a * a) / (inertia + h * h / 4.0 + a * a)
    spins = _spins(traj)
    return [
        near("spin kept at the first landing", exact, spins[0] if len(spins) else math.nan, 1e-9,
             "the impact problem is solved to 1e-12, located to 1e-12 m"),
        near("that is 1 - 1.5 sin^2 but for the rounding", 0.85, exact, 10.0 * r + 1e-12,
             f"d(ratio)/da is 9 / m, r = {r:.2g} m"),
    ]  # fmt: skip


def _spins(traj: Trajectory) -> list[float]:
    """Return omega+ / omega- about y of the impacts."""
    core, found = traj.scene.core(), []
    for event in traj.events:
        minus, plus = (np.asarray(core.velocity(event.q[None], p[None]))[0, 4] for p in (event.p_minus, event.p_plus))
        found.append(float(plus / minus))
    return found


def tossed_box(runs: Runs) -> list[Check]:
    """A box with spin, mu = .4, e = .3: whatever the step, it ends at rest on one of its faces."""
    checks, size = [], np.array([0.2, 0.3, 0.4])
    for h in (0.1, 0.05, 0.02, 0.01, 0.005):
        scene, q = systems.box_on_ground(size, 0.3, 0.4)
        q[:3] = 0.0, 0.0, 0.6
        q[3:7] = pin.Quaternion(pin.exp3(np.array([0.4, -0.7, 0.3]))).coeffs()
        traj = runs.simulate(scene, q, [0.5, 0.2, 0.0, 2.0, -1.0, 3.0], 5.0, h)
        height = float(traj.q[-1, 2])
        face = float(0.5 * size[np.abs(0.5 * size - height).argmin()])
        checks += [
            at_most(f"speed at 5 s, h = {h:g}", 1e-8, largest(traj.v[-1]), "given by the case"),
            near(f"height at 5 s [m], h = {h:g}", face, height, 1e-9, "given by the case"),
        ]
    return checks


def rolling_cylinder(runs: Runs) -> list[Check]:
    """Closed form: rolls on at v = R omega; down a slope with 2/3 g sin."""
    slope = math.radians(10.0)
    checks = []
    for name, angle, speed in (("flat", 0.0, 1.0), ("slope of 10 deg", slope, 0.0)):
        scene, q = systems.cylinder_on_ground(0.5, angle)
        v = np.zeros(6)
        # The cylinder's axis is the body's z, turned to -y of the world: rolling to +x is a turn about the body's -z.
        v[0], v[5] = speed, -speed / 0.1
        traj = runs.simulate(scene, q, v, 1.0, 0.01)
        a = 2.0 / 3.0 * _G * math.sin(angle)
        checks += [
            near(f"way in 1 s [m], {name}", speed + 0.5 * a, traj.q[-1, 0], 1e-9, _EVEN),
            near(f"v - R omega [m/s], {name}", 0.0, world_velocity(traj)[0] + 0.1 * traj.v[-1, 5], 1e-9, "it sticks"),
            at_most(f"sideways [m], {name}", 1e-9, largest(traj.q[:, 1]), "two points share the load"),
        ]
    return checks


def ladder_leaves(runs: Runs) -> list[Check]:
    """Closed form: from rest at theta0 it leaves the wall at sin theta = 2/3 sin theta0; the time is a quadrature."""
    start = math.radians(60.0)
    end = math.asin(2.0 / 3.0 * math.sin(start))

    def integrand(u: float) -> float:  # theta = start - u^2 takes the singularity at rest away
        if u == 0.0:
            return 2.0 / math.sqrt(3.0 * _G * math.cos(start))
        return 2.0 * u / math.sqrt(3.0 * _G * (math.sin(start) - math.sin(start - u * u)))

    exact = quad(integrand, 0.0, math.sqrt(start - end), epsabs=1e-14, epsrel=1e-13)[0]
    errors, checks = [], []
    for h in (0.01, 0.005, 0.0025):
        scene, q = systems.ladder_in_corner(start)
        traj = runs.simulate(scene, q, np.zeros(3), 0.6, h)
        lost = [found for found in changes_of(traj, "release") if "wall" in found.pair]
        time = lost[0].time if lost else math.nan
        errors.append(abs(time - exact))
        checks.append(near(f"leaves the wall at [s], h = {h:g}", exact, time, 0.5 * h * h,
                           "order 2: half of h^2, times of order 1 s"))  # fmt: skip
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    return [
        *checks,
        at_least(
            "order of the time, least of two halvings",
            1.8,
            float(orders.min()),
            "second order; the time is located in its step",
        ),
    ]


def joint_limit(runs: Runs) -> list[Check]:
    """Closed form of the bouncing ball, at a joint limit with e = 0.5, 1 m below; then the limit carries the weight."""
    traj = runs.simulate(systems.slider_with_limit(0.5), [1.0], [0.0], 3.0, 0.01)
    rest = traj.t > 1.36
    log = traj.contacts
    force = log.force[log.h > 0.0][:, 0]
    return [
        near("first impact [s]", 0.4515236410, traj.events[0].time, 6e-11, "the digits given"),
        near("bouncing ended [s]", [3.0 * math.sqrt(2.0 / _G)], times_of(traj, "bouncing ended", "value"), 1e-9,
             "accumulated location error of 1e-12 m"),
        at_most("off the limit from 1.36 s on [m]", 1e-10, largest(traj.q[rest]), "phi of persistent contact"),
        at_most("speed from then on [m/s]", 1e-10, largest(traj.v[rest]), "velocity is projected at the nodes"),
        near("force of the limit at the end [N]", _G, force[-1] if len(force) else math.nan, 1e-9, "solved to 1e-12"),
    ]  # fmt: skip


def times_of(traj: Trajectory, change: str, what: str = "time") -> np.ndarray:
    """Return the times (or values) of the changes of one kind, shape (n,)."""
    return np.array([getattr(found, what) for found in changes_of(traj, change)])


def world_velocity(traj: Trajectory) -> np.ndarray:
    """Return the linear velocity of the one free body at the end, world axes, shape (3,)."""
    rotation = pin.Quaternion(traj.q[-1, 3:7]).toRotationMatrix()
    return np.asarray(rotation @ traj.v[-1, :3])


CASES = (
    Case("dropped-ball", "a ball dropped with e = .5 comes to rest", dropped_ball, former="N02"),
    Case("spinning-ball", "a spinning ball dropped with e = 0 slips, then rolls", spinning_ball, former="N03"),
    Case("painleve-rod", "Painleve's rod: no jam below mu = 4/3, reported above", painleve, former="N18"),
    Case("incline-stick", "a box on a slope within the friction cone", box_on_slope),
    Case("incline-slip", "a box that slides down a slope", box_slides),
    Case("box-stops", "a box slides to a stop on the flat", box_stops),
    Case("box-flat", "a box dropped flat on its face", flat_box),
    Case("box-rocks", "a block rocks from edge to edge", rocking_box),
    Case("tossed-box", "a tossed box comes to rest, h = .1 .. .005", tossed_box, former="N26-tossed"),
    Case("cylinder", "a cylinder rolls", rolling_cylinder),
    Case("ladder", "a ladder slides down and leaves the wall", ladder_leaves),
    Case("joint-limit", "a slider bounces on a joint limit and rests on it", joint_limit, former="limit"),
)
