"""Cases of height fields and of solids that are not convex: against planes, rails, steps and pendulums."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from contactvi.reproduce.check import Check, near, same
from contactvi.scene.scene import Scene
from contactvi.trajectory.trajectory import Trajectory
from contactvi.verify.case import Case, Runs

_GRAVITY = 9.81


def plane_of_heights(runs: Runs) -> list[Check]:
    """A ball slips and rolls over thirty cells of a height field that is a plane: as on the halfspace."""
    slope, radius = np.array([0.1, -0.05]), 0.1
    normal = np.array([*-slope, 1.0]) / math.sqrt(1.0 + float(slope @ slope))
    x, y = np.linspace(-4.0, 4.0, 81), np.linspace(-2.0, 2.0, 41)
    found: list[Trajectory] = []
    for smooth in (True, False):
        scene = Scene()
        if smooth:
            scene.add_heightfield("ground", slope[0] * x + slope[1] * y[:, None], (8.0, 4.0))
        else:
            scene.add_halfspace(normal)
        scene.add_sphere("ball", radius)
        scene.set_contact(restitution=0.0, friction=0.1)
        start = np.array([0.5, 0.0, 0.05]) + radius * normal
        v = np.array([-1.0, 0.3, 0.0])
        q = [*start, 0.0, 0.0, 0.0, 1.0]
        found.append(runs.simulate(scene, q, [*(v - normal * (normal @ v)), 0.0, 0.0, 0.0], 2.0, 0.01))
    heights, plane = found
    changes = [[change.change for change in traj.contact_changes] for traj in found]
    return [
        near("places [m]", plane.q[:, :3], heights.q[:, :3], 1e-12, "rounding: a spline meets a plane"),
        same("changes of the contact", changes[1], changes[0]),
    ]


def ball_on_rails(runs: Runs) -> list[Check]:
    """A ball rolls down a groove that is narrower than it, on two points: (2/5) R^2 / rho^2 of its mass turns."""
    radius, tilt, deep, wave = 0.1, 0.1, 0.04, 2.0 * math.pi / 0.3
    x = np.linspace(-0.6, 0.6, 241)
    scene = Scene(_GRAVITY * np.array([0.0, math.sin(tilt), -math.cos(tilt)]))
    scene.add_heightfield("groove", np.tile(-deep * np.cos(wave * x), (4, 1)), (1.2, 6.0))
    scene.add_sphere("ball", radius)
    scene.set_contact(restitution=0.0, friction=2.0)
    # The place of the rails, where the normal of the cosine at a distance of the radius passes the middle.
    low, high = 0.02, 0.12
    for _ in range(100):
        at = 0.5 * (low + high)
        slope = deep * wave * math.sin(wave * at)
        low, high = (at, high) if at < radius * slope / math.hypot(1.0, slope) else (low, at)
    rho = radius / math.hypot(1.0, slope)
    traj = runs.simulate(
        scene, [0.0, -2.0, -deep * math.cos(wave * at) + rho + 1e-5, 0.0, 0.0, 0.0, 1.0], None, 1.5, 0.01, order=4
    )
    known = _GRAVITY * math.sin(tilt) / (1.0 + 0.4 * (radius / rho) ** 2)
    rolling = traj.t > 0.1
    t, y = traj.t[rolling], traj.q[rolling, 1]
    found = 2.0 * np.polynomial.polynomial.polyfit(t, y, 2)[2]
    return [
        near("acceleration [m/s^2]", known, found, 1e-5, "5 mm between samples of the profile"),
        near("height [m]", -deep * math.cos(wave * at) + rho, traj.q[-1, 2], 1e-6, "the same"),
        same("contact points", 2, len(traj.contact_changes) - sum(c.change != "begin" for c in traj.contact_changes)),
    ]


def torus_channel(runs: Runs) -> list[Check]:
    """A ball in a channel of the shape of a torus: across the lying one and along the standing one it is a pendulum."""
    ring, tube, radius = 0.5, 0.2, 0.08
    checks = []
    for what, stands, friction, length, angle in (
        ("across, sliding", False, 0.0, tube - radius, 0.6),
        ("across, rolling", False, 5.0, tube - radius, 0.6),
        ("along, rolling", True, 5.0, ring + tube - radius, 0.4),
    ):
        scene = Scene()
        place = ((0.0, 0.0, 0.0), (0.5 * math.pi if stands else 0.0, 0.0, 0.0))
        scene.add_torus("channel", ring, tube, free=False, hollow=True, placement=place)
        scene.add_sphere("ball", radius)
        scene.set_contact(restitution=0.0, friction=friction)
        middle = 0.0 if stands else ring
        start = [middle + length * math.sin(angle), 0.0, -length * math.cos(angle), 0.0, 0.0, 0.0, 1.0]
        traj = runs.simulate(scene, start, None, 1.6, 4e-3, order=4)
        gravity = _GRAVITY / (1.4 if friction else 1.0)
        quarter = 0.25 * _period(length, angle, gravity)
        checks.append(near(f"quarter of the period, {what} [s]", quarter, _crossing(traj, middle), 1e-7, "order 4"))
    return checks


def wheel_over_step(runs: Runs) -> list[Check]:
    """A ball rolls over a step, of boxes and of a height field of triangles; a cylinder over that of boxes.

    The ramp of the field is steeper than the tangent of the wheel where it meets the edge, so that it meets the edge.
    Without a rebound it then turns about that, with L = (1 + k) m R^2 w kept through the impact but for m v h.
    """
    radius, step, cell, speed, before = 0.3, 0.06, 0.05, 1.5, 0.5
    touches = (before - math.sqrt(radius**2 - (radius - step) ** 2)) / speed
    checks = []
    for what, share, ground in (("ball, boxes", 0.4, "boxes"), ("ball, field", 0.4, "field"), ("wheel", 0.5, "boxes")):
        scene = Scene()
        if ground == "field":
            x = cell * np.arange(-20, 21)
            heights = np.tile(np.where(x < -0.5 * cell, 0.0, step), (3, 1))
            scene.add_heightfield("ground", heights, (40.0 * cell, 2.0), smooth=False)
        else:
            scene.add_box("low", (1.0, 2.0, 0.5), free=False, placement=(-0.5, 0.0, -0.25))
            scene.add_box("high", (1.0, 2.0, 0.5), free=False, placement=(0.5, 0.0, step - 0.25))
        if what == "wheel":
            scene.add_cylinder("wheel", radius, 0.1)
            turn = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
        else:
            scene.add_sphere("wheel", radius)
            turn = [0.0, 0.0, 0.0, 1.0]
        scene.set_contact(restitution=0.0, friction=1.0)
        q = np.array([-before, 0.013, radius, *turn])
        v = scene.velocity({"wheel": ([speed, 0.0, 0.0], [0.0, speed / radius, 0.0])}, q)
        traj = runs.simulate(scene, q, v, 0.7, 5e-3, order=4)
        hits = [event for event in traj.events if event.gamma_minus < -1e-3]
        about = speed * (1.0 - step / (radius * (1.0 + share)))
        over = math.sqrt(about**2 - 2.0 * _GRAVITY * step / (1.0 + share))
        # Edges of pairs of a box and a cylinder are rounded by 1e-6 m, as limits.md says.
        rounded = 5e-6 if what == "wheel" else 1e-7
        checks += [
            near(f"time of the impact, {what} [s]", touches, hits[0].time, rounded, "distance by the speed"),
            near(
                f"speed after the step, {what} [m/s]", over, float(np.linalg.norm(traj.v[-1, :3])), rounded, "order 4"
            ),
            near(f"height after the step, {what} [m]", step + radius, traj.q[-1, 2], 1e-9, "gaps of 1e-9 m"),
        ]
    return checks


def _period(length: float, angle: float, gravity: float) -> float:
    """Return that of a pendulum that swings to this angle, by the arithmetic-geometric mean."""
    a, b = 1.0, math.cos(0.5 * angle)
    for _ in range(8):
        a, b = 0.5 * (a + b), math.sqrt(a * b)
    return 2.0 * math.pi * math.sqrt(length / gravity) / a


def _crossing(traj: Trajectory, middle: float) -> float:
    """Return the first instant at which the ball passes the middle, on Hermite's cubic between two nodes."""
    k = int(np.flatnonzero(traj.q[:, 0] < middle)[0]) - 1
    h = float(traj.t[k + 1] - traj.t[k])
    place = traj.q[k : k + 2, 0] - middle
    turns = [pin.Quaternion(q[3:7]).toRotationMatrix() for q in traj.q[k : k + 2]]
    rate = [h * float((turn @ v[:3])[0]) for turn, v in zip(turns, traj.v[k : k + 2], strict=True)]
    s = 0.5
    for _ in range(50):
        value = (
            (1.0 + 2.0 * s) * (1.0 - s) ** 2 * place[0] + s * (1.0 - s) ** 2 * rate[0]
            + s * s * (3.0 - 2.0 * s) * place[1] + s * s * (s - 1.0) * rate[1]
        )  # fmt: skip
        s -= value / (place[1] - place[0])
    return float(traj.t[k]) + h * s


CASES = (
    Case("plane-of-heights", "a ball slips and rolls over a height field that is a plane", plane_of_heights),
    Case("ball-on-rails", "a ball rolls down a groove of a height field on two points", ball_on_rails),
    Case("wheel-over-step", "a wheel rolls over a step of a height field and of boxes", wheel_over_step),
    Case("torus-channel", "a ball swings in a channel of the shape of a torus", torus_channel),
)
