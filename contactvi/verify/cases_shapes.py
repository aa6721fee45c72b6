"""Cases of bodies that are not convex: hung by a handle, on three feet, and a peg in a hole with play."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.reproduce.check import Check, near
from contactvi.scene.scene import Scene
from contactvi.scene.scene_shapes import SurfaceFunction
from contactvi.verify.case import Case, Runs

_GRAVITY = 9.81
_FIELDS = "a field meets no other field"


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
    """A torque tilts a peg in a hole with play until both ends touch: sin(tilt) = 2 play / length."""
    hole, half, peg, length, torque = 0.06, 0.2, 0.05, 0.2, 0.1
    scene = Scene(np.zeros(3))

    def distance(points: NDArray[np.float64]) -> NDArray[np.float64]:
        beyond = np.maximum(np.abs(points[:, 2]) - half, 0.0)
        out: NDArray[np.float64] = np.hypot(np.hypot(points[:, 0], points[:, 1]), beyond) - hole
        return out

    box = np.outer([1.3 * hole, 1.3 * hole, half + 1.3 * hole], [-1.0, 1.0])
    scene.add_solid("hole", distance, box, 0.01, hollow=True)
    scene.add_capsule("peg", peg, length, 1.0)
    scene.add_wrench("peg", torque=(0.0, torque, 0.0))
    scene.set_contact(restitution=0.0, friction=0.0)
    traj = runs.simulate(scene, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], None, 0.15, 2e-3)
    axis = pin.XYZQUATToSE3(traj.q[-1]).rotation[:, 2]
    known = 2.0 * (hole - peg) / length
    pushes = np.linalg.norm(traj.contacts.force[-2:], axis=1)
    pair = np.full(2, torque / (length * math.sqrt(1.0 - known**2)))
    return [
        near("sine of the tilt", known, float(np.hypot(axis[0], axis[1])), 1e-4, "the spline of the hole"),
        near("forces at the ends [N]", pair, pushes, 1e-3, "the same"),
    ]


CASES = (
    Case("mug-by-handle", "a mug hangs by its ring on a hook", mug_by_handle),
    Case("three-feet", "a ring with its mass aside rests on three balls", three_feet),
    Case("peg-in-hole", "a peg tilts in a hole with play", peg_in_hole),
    Case("gears-with-play", "two gears with play turn by their ratio in the mean", None, _FIELDS),
    Case("nut-on-thread", "a nut moves on its thread by the pitch times its turns", None, _FIELDS),
)
