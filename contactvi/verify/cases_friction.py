"""Laws of friction and of adhesion: belts, turntables, friction of rest and by the speed of a slip, axes, a cup."""

from __future__ import annotations

import math

import numpy as np

from contactvi.reproduce.check import Check, near
from contactvi.scene.scene import Scene
from contactvi.verify import systems
from contactvi.verify.case import Case, Runs

_MASS, _WEIGHT = 2.0, 19.62
_FLAT = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0])
_ROUNDING = "rounding"


def _box(friction: object, **contact: object) -> Scene:
    scene = Scene()
    scene.add_halfspace(name="ground")
    scene.add_box("box", (0.2, 0.2, 0.1), mass=_MASS)
    scene.set_contact("ground", "box", friction=friction, restitution=0.0, **contact)  # type: ignore[arg-type]
    return scene


def belt(runs: Runs) -> list[Check]:
    """Closed form: a box slides for u / (mu g) on a belt of the relative speed u, and then goes with it."""
    scene, velocity, start, mu = _box(0.5), np.array([1.0, 0.5]), np.array([-0.2, 0.3]), 0.5
    scene.set_surface_velocity("ground", [*velocity, 0.0])
    traj = runs.simulate(scene, _FLAT, [*start, 0.0, 0.0, 0.0, 0.0], 0.5, 0.02, order=8)
    relative = velocity - start
    time = float(np.linalg.norm(relative)) / (mu * 9.81)
    place = 0.5 * (velocity + start) * time + velocity * (0.5 - time)
    stick = next(change.time for change in traj.contact_changes if change.change == "stick")
    return [
        near("sticks at [s]", time, stick, 1e-10, "the event is located"),
        near("place at .5 s [m]", place, traj.q[-1][:2], 1e-12, _ROUNDING),
        near("heat [J]", 0.5 * _MASS * float(relative @ relative), traj.friction_loss[-1], 1e-9, _ROUNDING),
        near("work of the belt [J]", _MASS * float(relative @ velocity), traj.work.prescribed[-1], 1e-9, _ROUNDING),
    ]


def turntable(runs: Runs) -> list[Check]:
    """Closed form: a rolling ball goes round a circle with 2/7 of the rate of the table (Weltner 1979)."""
    scene, q, v, place = systems.ball_on_turntable()
    traj = runs.simulate(scene, q, v, 1.0, 0.02, order=8)
    return [near("place at 1 s [m]", place(1.0), traj.q[-1][:2], 1e-12, "order 8, steps of 20 ms")]


def stick_slip(runs: Runs) -> list[Check]:
    """Limit cycle of a block on a spring on a belt, Stribeck's friction, by DOP853 with located events."""
    scene = _box(lambda v: 0.3 + 0.3 * math.exp(-((v / 0.2) ** 2)), static_friction=0.6)
    scene.add_spring("world", "box", 100.0, rest_length=1.0, point_a=(-1.0, 0.0, 0.05))
    scene.set_surface_velocity("ground", (0.1, 0.0, 0.0))
    start = _FLAT.copy()
    start[0] = 0.6 * _WEIGHT / 100.0
    traj = runs.simulate(scene, start, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], 2.0, 0.01, order=8)
    sticks, slips = (
        [change.time for change in traj.contact_changes if change.change == kind and change.time > 0.1]
        for kind in ("stick", "slip")
    )
    return [
        near("sticks at [s]", 0.6699562637182499, sticks[0], 1e-7, "order 8, steps of 10 ms"),
        near("slips again at [s]", 1.9296748931215613, slips[0], 1e-7, "order 8, steps of 10 ms"),
    ]


def along_axes(runs: Runs) -> list[Check]:
    """Curved slide of a box with friction .5 along x and .2 along y: exponentials over the path, by quadrature."""
    scene = _box((0.5, 0.2), friction_axis=(1.0, 0.0, 0.0))
    traj = runs.simulate(scene, _FLAT, [1.0, 1.2, 0.0, 0.0, 0.0, 0.0], 0.2, 0.02, order=8)
    return [
        near(
            "place at .2 s [m]",
            (0.11868237752636479, 0.2185337694939115),
            traj.q[-1][:2],
            1e-9,
            "order 8, steps of 20 ms",
        ),
        near(
            "velocity at .2 s [m/s]",
            (0.2443922085869481, 0.9578008608282276),
            traj.v[-1][:2],
            1e-9,
            "order 8, steps of 20 ms",
        ),
    ]


def suction_cup(runs: Runs) -> list[Check]:
    """Closed form: a box hangs on a ceiling until weight and load are more than the pull, and then falls."""
    pull, load, rate = 40.0, 1.0, 30.0
    scene = Scene()
    scene.add_halfspace(name="ceiling", normal=(0.0, 0.0, -1.0), offset=-1.0)
    scene.add_box("box", (0.2, 0.2, 0.1), mass=_MASS)
    scene.set_contact(friction=0.3, restitution=0.0, adhesion=pull)
    scene.add_wrench("box", lambda t: [0.0, 0.0, -(load + rate * t)])
    start = _FLAT.copy()
    start[2] = 0.95
    traj = runs.simulate(scene, start, np.zeros(6), 1.0, 0.02, order=8)
    released = (pull - _WEIGHT - load) / rate
    left = 1.0 - released
    fall = 0.5 * (9.81 + (load + rate * released) / _MASS) * left**2 + rate / _MASS * left**3 / 6.0
    time = next(change.time for change in traj.contact_changes if change.change == "release")
    return [
        near("lets go at [s]", released, time, 1e-9, "the event is located"),
        near("has fallen by [m]", fall, 0.95 - traj.q[-1][2], 1e-8, "order 8"),
    ]


CASES = (
    Case("belt", "a box on a conveyor: stick, heat, work", belt),
    Case("turntable", "a ball that rolls on a turntable", turntable),
    Case("stick-slip", "a block on a belt with Stribeck's friction: its limit cycle", stick_slip),
    Case("friction-axes", "a slide with friction that depends on its direction", along_axes),
    Case("suction-cup", "adhesion up to its bound", suction_cup),
)
