"""Cases of bodies that are not convex: hung by a handle, on three feet, and a peg in a hole with play."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import brentq, root

from contactvi.importing.solids import Solid, sampled_solid, superellipsoid, thread
from contactvi.reproduce.check import Check, near
from contactvi.scene.scene import Scene
from contactvi.scene.scene_shapes import SurfaceFunction
from contactvi.verify import systems
from contactvi.verify.case import Case, Runs

_GRAVITY = 9.81
_TURNS = 10  # the last nodes of a run of wheels, in which the small one turns by half of a tooth


def _ring(ring: float, tube: float) -> tuple[SurfaceFunction, NDArray[np.float64]]:
    """Return the distance from a torus about z as a function of points (n, 3), and a box around it."""

    def distance(points: NDArray[np.float64]) -> NDArray[np.float64]:
        out: NDArray[np.float64] = np.hypot(np.hypot(points[:, 0], points[:, 1]) - ring, points[:, 2]) - tube
        return out

    across = 2.0 * tube
    return distance, np.outer([ring + across, ring + across, across], [-1.0, 1.0])


def mug_by_handle(runs: Runs) -> list[Check]:
    """A mug hangs by its ring on a ball that is smaller than the hole: statics, and the mode of a double pendulum.

    The middle of the ring hangs from that of the ball by what the ball has of room, the mug hangs below it.
    """
    ring, tube, ball, mass, low, about = 0.04, 0.01, 0.02, 0.3, 0.05, 4e-4
    room = ring - tube - ball
    scene = Scene()
    function, box = _ring(ring, tube)
    inertia = pin.Inertia(mass, np.array([0.0, -low, 0.0]), about * np.eye(3))
    scene.add_solid("mug", function, box, 0.002, inertia=inertia)
    scene.add_sphere("hook", ball, free=False)
    scene.set_contact(restitution=0.0, friction=0.0)
    upright = math.sqrt(0.5)  # the frame is turned about x by a right angle: its y is up
    swing = 1e-3
    # The slow mode of the two links, small angles (a, b): K x = w^2 M x.
    M = mass * np.array([[room**2, room * low], [room * low, low**2 + about / mass]])
    K = mass * _GRAVITY * np.diag([room, low])
    squares, modes = np.linalg.eig(np.linalg.solve(M, K))
    slow = int(np.argmin(squares))
    a, b = swing * modes[:, slow] / np.abs(modes[:, slow]).max()
    found = []
    for first, second in ((0.0, 0.0), (a, b)):
        place = [room * math.sin(first), 0.0, -room * math.cos(first)]
        turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, -second, 0.0)) * pin.Quaternion(upright, upright, 0.0, 0.0)
        q = [*place, *turn.coeffs()]
        quarter = 0.5 * math.pi / math.sqrt(float(squares[slow]))
        found.append(runs.simulate(scene, q, None, quarter, quarter / 150.0, start="separate"))
    rest, swung = found
    end = pin.XYZQUATToSE3(swung.q[-1]).rotation
    tilt = math.atan2(float(end[0, 1]), float(end[2, 1]))
    force = float(rest.contacts.force_of("mug", "hook")[1][-1, 2])
    return [
        near("load of the hook [N]", mass * _GRAVITY, abs(force), 1e-6, "1e-6 m: the spline of the ring"),
        near("height of the ring [m]", -room, rest.q[-1, 2], 2e-6, "the same"),
        near("tilt after a quarter of the period", 0.0, tilt / swing, 3e-4, "1e-6 m in 1e-2 m of room"),
    ]


def three_feet(runs: Runs) -> list[Check]:
    """A ring whose centre of mass is not in its middle rests on three balls: the lever rule gives what each carries."""
    ring, tube, ball, mass = 0.2, 0.05, 0.03, 2.0
    centre = np.array([0.06, -0.03, 0.0])
    scene = Scene()
    function, box = _ring(ring, tube)
    scene.add_solid("ring", function, box, 0.01, inertia=pin.Inertia(mass, centre, 0.02 * np.eye(3)))
    feet = []
    for k, angle in enumerate((0.2, 2.5, 4.4)):
        feet.append(ring * np.array([math.cos(angle), math.sin(angle)]))
        scene.add_sphere(f"foot{k}", ball, free=False, placement=(*feet[-1], -tube - ball))
    scene.set_contact(restitution=0.0, friction=0.5)
    traj = runs.simulate(scene, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], None, 0.3, 1e-3, start="separate")
    # Their sum is the weight, and their moments that of the weight.
    known = np.linalg.solve(np.vstack([np.ones(3), np.array(feet).T]), mass * _GRAVITY * np.array([1.0, *centre[:2]]))
    loads = [abs(float(traj.contacts.force_of("ring", f"foot{k}")[1][-1, 2])) for k in range(3)]
    return [near("loads of the feet [N]", known, np.array(loads), 1e-3, "1e-5: the spline of the ring")]


def peg_in_hole(runs: Runs) -> list[Check]:
    """A torque tilts a peg in a hole with play until both ends touch, by balls or, of a cylinder, by its rims.

    Balls: sin(tilt) = 2 play / length, with that of the radii. Rims: the width of the peg as seen from the side,
    l sin + 2 r cos, is that of the hole, and their forces are l cos - 2 r sin apart.
    """
    torque, checks = 0.1, []
    for what, rims, hole, peg, spacing, end in (
        ("10 mm of play", False, 0.06, 0.05, 0.01, 0.15),
        ("0.1 mm of play", False, 0.05005, 0.05, 0.01, 0.05),
        ("0.1 mm of play, rims", True, 0.05005, 0.05, 0.01, 0.01),
    ):
        half, length = 0.2, 0.2
        scene = Scene(np.zeros(3))

        def distance(points: NDArray[np.float64], half: float = half, hole: float = hole) -> NDArray[np.float64]:
            beyond = np.maximum(np.abs(points[:, 2]) - half, 0.0)
            away: NDArray[np.float64] = np.hypot(np.hypot(points[:, 0], points[:, 1]), beyond) - hole
            return away

        # Three samples beyond the surface: the end conditions of the spline show in the ones next to it.
        out = hole + 3.0 * spacing
        box = np.outer([out, out, half + out], [-1.0, 1.0])
        scene.add_solid("hole", distance, box, spacing, hollow=True)
        if rims:
            scene.add_cylinder("peg", peg, length, 1.0)
        else:
            scene.add_capsule("peg", peg, length, 1.0)
        scene.add_wrench("peg", torque=(0.0, torque, 0.0))
        scene.set_contact(restitution=0.0, friction=0.0)
        traj = runs.simulate(scene, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], None, end, 2e-3)
        axis = pin.XYZQUATToSE3(traj.q[-1]).rotation[:, 2]
        known = 2.0 * (hole - peg) / length
        if rims:
            tilt = brentq(
                lambda a, hole=hole, peg=peg, length=length: length * math.sin(a) + 2.0 * (peg * math.cos(a) - hole),
                0.0, 0.1, xtol=1e-15,
            )  # fmt: skip
            known = math.sin(tilt)
        pushes = np.linalg.norm(traj.contacts.force[-2:], axis=1)
        arm = length * math.sqrt(1.0 - known**2) - (2.0 * peg * known if rims else 0.0)
        pair = np.full(2, torque / arm)
        checks += [
            near(f"sine of the tilt, {what}", known, float(np.hypot(axis[0], axis[1])), 4e-6, "the spline of the hole"),
            near(f"forces at the ends, {what} [N]", pair, pushes, 1e-5, "the same"),
        ]
    return checks


def _wheel(radius: float, depth: float, teeth: int, half: float) -> Solid:
    """Return a wheel about z whose teeth are waves of its radius, and which is barrelled: thickest in its middle."""

    def function(points: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y, z = points.T
        out = np.hypot(np.hypot(x, y), radius / half * z)
        square = (x * x + y * y) / radius**2
        waves = depth * (2.0 * square / (1.0 + square**2)) ** 2 * np.cos(teeth * np.arctan2(y, x))
        distance: NDArray[np.float64] = out - radius - waves
        return distance

    across = radius + 2.0 * depth
    return sampled_solid(function, np.outer([across, across, 1.2 * half], [-1.0, 1.0]), 0.35 * depth, False)


def _gap(scene: Scene, large: float, small: float) -> float:
    """Return the gap of the wheels at their angles."""
    return float(scene.core().gaps(np.array([small, large]))[0][0])


def gears_with_play(runs: Runs) -> list[Check]:
    """A wheel of 8 teeth drives one of 16: they turn by exactly 1 to 2 in the mean, and hit where the drive reverses.

    Teeth are waves, not involutes, so that the ratio differs within each tooth. After half a turn of the small wheel,
    and a quarter of the large one, both lie as before, also their samples: there the ratio is that of the teeth.
    """
    radius, depth, teeth, play, speed, h = 0.06, 0.007, 8, 1e-3, 2.0 * math.pi, 0.00625
    wheels = [_wheel(radius, depth, teeth, 0.03), _wheel(2.0 * radius, depth, 2 * teeth, 0.03)]

    def driven(start: float, rate: float) -> Scene:
        model = systems.empty_model()
        solids: dict[str, tuple[int, pin.SE3, Solid]] = {}
        for name, wheel, x in zip(("small", "large"), wheels, (0.0, 3.0 * radius + play), strict=True):
            joint = model.addJoint(0, pin.JointModelRZ(), systems.place(x), name)
            model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
            solids[f"wheel_{name}"] = (joint, systems.place(), wheel)
        scene = systems.of_solids(model, solids)
        scene.set_joint("large", damping=0.1)
        scene.set_contact(restitution=0.0, friction=0.0)
        scene.prescribe("small", lambda t: start + rate * t)
        return scene

    # A tooth of the small wheel points at a gap of the large one.
    before = np.array([0.0, math.pi + 0.5 * math.pi / teeth])
    forward = runs.simulate(driven(0.0, speed), before, [speed, -0.5 * speed], 0.625, h)
    half = round(0.5 / h)
    turned = forward.q[-_TURNS:] - forward.q[-_TURNS - half : -half]
    before = forward.q[-1]
    back = driven(float(before[0]), -speed)
    gap = partial(_gap, back, float(before[1]))
    touching = brentq(gap, before[0] - 1e-3, before[0] - 0.5 * math.pi / teeth, xtol=1e-14)
    reversed_ = runs.simulate(back, before, [-speed, 0.0], 4.0 * h, h)
    return [
        near("turn of the small wheel [rad]", np.full(_TURNS, math.pi), turned[:, 0], 1e-9, "driven"),
        near(
            "turn of the large wheel meanwhile [rad]",
            np.full(_TURNS, -0.5 * math.pi),
            turned[:, 1],
            1e-8,
            "gaps of 1e-9 m",
        ),
        near(
            "play until the wheels hit [rad]",
            before[0] - touching,
            speed * reversed_.events[0].time,
            1e-9,
            "a root of the engine's gap",
        ),
    ]


def nut_on_thread(runs: Runs) -> list[Check]:
    """A nut with a round tooth goes down a thread by its weight, by the pitch times its turns, or holds itself.

    With k = 2 pi / pitch, the normal n of the flank at the tooth and the tangent (0, cos b, sin b) of the helix there,
    at the distance s from the axis, the nut is held from mu = -n_phi / cos b on. Below, with the force N of the tooth,
    m z'' = N (n_z + mu sin b) - m g and I k z'' = N s (n_phi + mu cos b).
    """
    radius, depth, pitch, tooth, middle, mass, about = 0.02, 0.004, 0.012, 0.003, 0.022, 0.3, 1e-6
    k, end = 2.0 * math.pi / pitch, 0.05
    low, s, (_, n_phi, n_z) = _on_flank(radius, depth, k, middle, tooth)
    b = math.atan(1.0 / (k * s))
    limit = -n_phi / math.cos(b)
    checks = []
    for what, mu in (("", 0.0), (", half of the friction that holds it", 0.5 * limit), (", held", 2.0 * limit)):
        model = systems.empty_model(_GRAVITY)
        slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
        turn = model.addJoint(slide, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
        model.appendBodyToJoint(turn, pin.Inertia(mass, np.zeros(3), about * np.eye(3)), pin.SE3.Identity())
        solids: dict[str, tuple[int, pin.SE3, Solid]] = {
            "bolt": (0, systems.place(), thread(radius, depth, pitch, 0.1, False)),
            "tooth": (turn, systems.place(middle, 0.0, low), superellipsoid([tooth] * 3, 2.0, False)),
        }
        scene = systems.of_solids(model, solids)
        scene.set_contact(restitution=0.0, friction=mu)
        traj = runs.simulate(scene, [0.0, 0.0], None, end, 1e-3, start="separate")
        lift = np.array([n_z + mu * math.sin(b), s * (n_phi + mu * math.cos(b))])
        matrix = np.array([[mass, -lift[0]], [about * k, -lift[1]]])
        known = 0.0 if mu > limit else float(np.linalg.solve(matrix, [-mass * _GRAVITY, 0.0])[0])
        down, turns = traj.q[-1] - traj.q[0]
        checks += [
            near(f"way by the turns{what} [m]", turns / k, down, 1e-9, "gaps of 1e-9 m"),
            near(
                f"way{what} [m]", 0.5 * known * end**2, down, 2e-6 if mu else 2e-9, "order 2 where it slips and turns"
            ),
        ]
    return checks


def _on_flank(
    radius: float, depth: float, k: float, middle: float, ball: float
) -> tuple[float, float, NDArray[np.float64]]:
    """Return how high a ball lies on the flank below it, where it touches from the axis, and the normal there.

    Its middle is at the angle 0, `middle` from the axis of the thread radius + depth cos(angle - k z). The normal is
    along the axis' radius, around it, and along it.
    """

    def foot(height: float) -> tuple[float, NDArray[np.float64]]:
        center = np.array([middle, 0.0, height])

        def place(u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
            angle, turn = u[0], u[0] - u[1]
            out, slope = radius + depth * math.cos(turn), -depth * math.sin(turn)
            along, across = np.array([math.cos(angle), math.sin(angle), 0.0]), [-math.sin(angle), math.cos(angle), 0.0]
            rows = np.array([slope * along + out * np.array(across), -slope * along + [0.0, 0.0, 1.0 / k]])
            return out * along + [0.0, 0.0, u[1] / k] - center, rows

        # In (angle, k z), from below the middle of the groove, where k z = pi.
        found = root(lambda u: place(u)[1] @ place(u)[0] / ball, np.array([0.0, math.pi - 1.5]), tol=1e-15)
        return float(np.linalg.norm(place(found.x)[0])), np.asarray(found.x)

    low = float(brentq(lambda z: foot(z)[0] - ball, (math.pi - 1.0) / k, math.pi / k, xtol=1e-15))
    angle, z = foot(low)[1] / [1.0, k]
    out = radius + depth * math.cos(angle - k * z)
    normal = (np.array([middle, 0.0, low]) - [out * math.cos(angle), out * math.sin(angle), z]) / ball
    turn = np.array(
        [[math.cos(angle), math.sin(angle), 0.0], [-math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    return low, out, turn @ normal


CASES = (
    Case("mug-by-handle", "a mug hangs by its ring on a hook", mug_by_handle),
    Case("three-feet", "a ring with its mass aside rests on three balls", three_feet),
    Case("peg-in-hole", "a peg tilts in a hole with play", peg_in_hole),
    Case("gears-with-play", "two gears with play turn by their ratio in the mean", gears_with_play),
    Case("nut-on-thread", "a nut moves on its thread by the pitch times its turns", nut_on_thread),
)
