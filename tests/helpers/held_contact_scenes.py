"""The motions of tests/oracles/held_contact.py as scenes: start, exact answer, what of a run is compared with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import contactvi as cvi
from contactvi.verify import systems
from helpers.contact_models import halfspace, place
from helpers.persistent_runs import normal, pose, turned
from oracles import held_contact as oracle
from oracles import joint_friction
from oracles.switched_modes import Change

Array = NDArray[np.float64]
Observe = Callable[[Array, Array], Array]

RADIUS = 0.1  # of balls [m]


@dataclass(frozen=True)
class Held:
    """A motion in lasting contact whose answer is known.

    exact: rows of what is compared at times [s]; observe: the same rows of a run, of its q (n, nq) and v (n, nv);
    places: which of their numbers are coordinates; changes: times when a contact begins or ceases to stick, or ends;
    slip_ends: those of them when a slip comes to zero.
    """

    scene: cvi.Scene
    q: Array
    v: Array
    duration: float
    exact: Callable[[Array], Array]
    observe: Observe
    places: tuple[int, ...] = (0,)
    changes: tuple[float, ...] = ()
    slip_ends: tuple[float, ...] = ()

    def errors(self, traj: cvi.Trajectory, times: Array, exact: Array) -> Array:
        """Return the largest error of each number of the rows at times [s] at which the run has nodes."""
        at = np.searchsorted(traj.t, times - 1e-9)
        assert np.abs(traj.t[at] - times).max() < 1e-9
        return np.asarray(np.abs(self.observe(traj.q[at], traj.v[at]) - exact).max(axis=0))

    def run(self, steps: int, order: int) -> cvi.Trajectory:
        dt = self.duration / steps
        return cvi.simulate(self.scene, self.q, self.v, duration=self.duration, dt=dt, order=order, solver_tol=1e-14)

    def run_auto(self, tol: float) -> cvi.Trajectory:
        return cvi.simulate(self.scene, self.q, self.v, duration=self.duration, dt="auto", tol=tol)


def _turns(q: Array) -> Array:
    """Rotation matrices of the first free body of rows of q."""
    return np.array([pin.Quaternion(*row[[6, 3, 4, 5]]).matrix() for row in q])


def _switched(
    scene: cvi.Scene, q: Array, v: Array, duration: float, states: Callable[[Array], tuple[Array, list[Change]]],
    observe: Observe, places: tuple[int, ...] = (0,),
) -> Held:  # fmt: skip
    """Return a motion that an oracle of modes knows."""
    changes, sliding = states(np.array([0.0, duration]))[1], ("forward", "backward")
    before = ["forward", *(change.mode for change in changes)]  # a rod slides at first
    ends = tuple(
        change.t for mode, change in zip(before, changes, strict=False)
        if mode in sliding and change.mode in (*sliding, "sticks")
    )  # fmt: skip
    every = tuple(change.t for change in changes)
    return Held(scene, q, v, duration, lambda times: states(times)[0], observe, places, every, ends)


def _ball_on_plane(
    slope: float, friction: float, velocity: Sequence[float], spin: Sequence[float], duration: float,
    exact: Callable[[Array], Array], changes: Sequence[float] = (),
) -> Held:  # fmt: skip
    """A ball on a slope, with a velocity (down, across) and a spin in the axes of the slope."""
    scene = cvi.Scene()
    scene.add_halfspace(normal(slope), 0.0, name="ground")
    scene.add_sphere("ball", radius=RADIUS)
    scene.set_contact(restitution=0.0, friction=friction)
    axes, start = turned(slope), pin.exp3(np.array([0.3, -0.8, 0.5]))
    v = np.concatenate([start.T @ axes @ np.append(velocity, 0.0), start.T @ axes @ spin])

    def observe(q: Array, v: Array) -> Array:
        turns = _turns(q)
        speed, spun = (np.einsum("nij,nj->ni", turns, v[:, k : k + 3]) @ axes for k in (0, 3))
        return np.concatenate([(q[:, :3] @ axes)[:, :2], speed[:, :2], spun], axis=1)

    ends = tuple(changes)
    return Held(scene, pose(RADIUS * normal(slope), start), v, duration, exact, observe, (0, 1), ends, ends)


def slides_then_rolls(friction: float = 0.2) -> Held:
    ball = oracle.SlidingBall(RADIUS, friction, (1.0, 0.4), (3.0, -2.0, 5.0))
    changes = [ball.rolls_from()] if friction else []
    return _ball_on_plane(0.0, friction, ball.velocity, ball.spin, 1.0, ball.states, changes)


def rolls_down() -> Held:
    start = (0.3, 0.5)
    spin = (-start[1] / RADIUS, start[0] / RADIUS, 0.0)
    return _ball_on_plane(0.4, 0.5, start, spin, 1.0, lambda times: oracle.rolling_down(RADIUS, 0.4, start, times))


def turning_slip(k: float, part: float) -> Held:
    """A slip that turns; the run takes this part of the time that it lasts."""
    ball = oracle.TurningSlip(RADIUS, 0.3, k, (1.0, 0.5), (0.6, 0.9))
    across = (np.array(ball.velocity) - ball.slip) / RADIUS
    spin = (-across[1], across[0], 0.0)
    end = ball.rolls_from()
    changes = [end] if part > 1.0 else []
    return _ball_on_plane(ball.slope, ball.friction, ball.velocity, spin, part * end, ball.states, changes)


def box_slides(slope: float, friction: float, speed: float, duration: float) -> Held:
    """A box sent up a slope at this speed. Rows: way up the slope, speed, and what should be zero."""
    size = (0.4, 0.3, 0.1)
    scene = cvi.Scene()
    scene.add_halfspace(normal(slope), 0.0, name="ground")
    scene.add_box("box", size, mass=2.0)
    scene.set_contact(restitution=0.0, friction=friction)
    start = 0.5 * size[2] * normal(slope)
    slide = joint_friction.block_on_slope(speed, friction, slope, mass=2.0)
    up = turned(slope) @ [-1.0, 0.0, 0.0]

    def exact(times: Array) -> Array:
        return np.array([[*slide.state(t), 0.0, 0.0] for t in times])

    def observe(q: Array, v: Array) -> Array:
        moved = q[:, :3] - start
        along = moved @ up
        turns = _turns(q)
        return np.stack([
            along, np.einsum("nij,nj->ni", turns, v[:, :3]) @ up,
            np.linalg.norm(moved - np.outer(along, up), axis=1), np.abs(turns - turned(slope)).max(axis=(1, 2)),
        ], axis=1)  # fmt: skip

    v = np.append([-speed, 0.0, 0.0], np.zeros(3))
    return Held(scene, pose(start, turned(slope)), v, duration, exact, observe)


def _turning_plane(joint: pin.JointModel, rate: float) -> cvi.Scene:
    """Return a scene with the halfspace z <= 0 of a joint that is driven at this rate [rad/s] from zero."""
    model = systems.empty_model(systems.GRAVITY)
    moved = model.addJoint(0, joint, place(), "plane")
    model.appendBodyToJoint(moved, pin.Inertia.FromSphere(1.0, 0.3), place())
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("top", moved, place(), halfspace(0.0, 0.0, 1.0, 0.0)))
    scene = cvi.Scene.from_pinocchio(model, geometry)
    scene.prescribe("plane", lambda t: (rate * t, rate, 0.0))
    return scene


def turntable() -> Held:
    """A ball that rolls on a table driven round: a contact of two moving bodies."""
    rate, start, velocity = 4.0, np.array([0.2, 0.1]), np.array([0.3, -0.2])
    scene = _turning_plane(pin.JointModelRZ(), rate)
    scene.add_sphere("ball", radius=RADIUS)
    scene.set_contact(restitution=0.0, friction=0.8)
    # the contact point of the ball moves with the table
    slip = velocity - rate * np.array([-start[1], start[0]])
    spin = np.array([-slip[1], slip[0], 0.0]) / RADIUS
    q = np.append(0.0, pose([*start, RADIUS]))
    v = np.concatenate([[rate], velocity, [0.0], spin])

    def exact(times: Array) -> Array:
        return oracle.on_turntable(rate, start.tolist(), velocity.tolist(), times)

    return Held(scene, q, v, 2.0, exact, lambda q, v: q[:, 1:3], (0, 1))


def point_on_sphere(friction: float, speed: float, duration: float) -> Held:
    """A point mass, with a ball about it, on a fixed sphere, with a speed across the way down."""
    distance, theta = 1.0, 0.3
    model = systems.empty_model(systems.GRAVITY)
    joint = model.addJoint(0, pin.JointModelTranslation(), place(), "point")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), place())
    shapes = {
        "point": (joint, place(), coal.Sphere(RADIUS)),
        "support": (0, place(), coal.Sphere(distance - RADIUS)),
    }
    scene = systems.built(model, shapes, [("support", "point")], 0.0, friction)
    q = distance * np.array([math.sin(theta), 0.0, math.cos(theta)])
    v = np.array([0.0, speed, 0.0])
    point = oracle.PointOnSphere(distance, friction)

    def states(times: Array) -> tuple[Array, list[Change]]:
        return point.states(np.append(q, v), times)

    return _switched(scene, q, v, duration, states, lambda q, v: np.concatenate([q, v], axis=1), (0, 1, 2))


def _in_plane(found: tuple[Array, list[Change]]) -> tuple[Array, list[Change]]:
    rows, changes = found
    return np.column_stack([rows[:, :5], np.cos(rows[:, 5]), np.sin(rows[:, 5])]), changes


def _observe_in_plane(start: Array) -> Observe:
    """Centre, velocity, spin and angle of a body that moves in the plane y = 0 from this orientation."""

    def observe(q: Array, v: Array) -> Array:
        turns = _turns(q)
        velocity, spin = (np.einsum("nij,nj->ni", turns, v[:, k : k + 3]) for k in (0, 3))
        turned = turns @ start.T
        return np.stack(
            [q[:, 0], q[:, 2], velocity[:, 0], velocity[:, 2], spin[:, 1], turned[:, 0, 0], turned[:, 0, 2]], axis=1
        )

    return observe


def ball_off_sphere() -> Held:
    """A ball that rolls down a fixed sphere, slides and flies."""
    distance, theta, friction = 0.6, 0.3, 0.3
    scene = cvi.Scene()
    scene.add_sphere("support", radius=distance - RADIUS, free=False)
    scene.add_sphere("ball", radius=RADIUS)
    scene.set_contact(restitution=0.0, friction=friction)
    ball = oracle.BallOffSphere(RADIUS, distance, friction)
    q = pose(distance * np.array([math.sin(theta), 0.0, math.cos(theta)]))
    return _switched(
        scene, q, np.zeros(6), 0.8, lambda times: _in_plane(ball.states(theta, 0.0, times)),
        _observe_in_plane(np.eye(3)), (0, 1, 5, 6),
    )  # fmt: skip


# What a body may roll over, by name: adds it to a scene, so that its edge is at x = 0. The radius of that is given.
ALONG_X = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
ALONG_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
EDGES: dict[str, tuple[float, Callable[[cvi.Scene], object]]] = {
    "box": (0.0, lambda scene: scene.add_box("table", (2.0, 1.0, 0.4), free=False, placement=place(-1.0, 0.0, -0.2))),
    "end of a cylinder": (0.0, lambda scene: scene.add_cylinder(
        "table", 1.0, 0.4, free=False, placement=place(-1.0, 0.0, -0.2))),
    "side of a cylinder": (0.0, lambda scene: scene.add_cylinder(
        "table", 0.3, 2.0, free=False, placement=pin.SE3(ALONG_X, np.array([-1.0, 0.0, -0.3])))),
    "capsule": (0.3, lambda scene: scene.add_capsule(
        "table", 0.3, 2.0, free=False, placement=pin.SE3(ALONG_X, np.array([-1.0, 0.0, 0.0])))),
}  # fmt: skip
# What rolls, by name: adds it to a scene. Its moment of inertia over m r^2 is given; a solid capsule is a cylinder of
# twice its length over its radius and two halves of a ball, which has 4/3 of that unit of mass. A cylinder is left out:
# against a box both are rounded.
LENGTH = 0.4  # of a capsule that lies [m]
ROLLERS: dict[str, tuple[float, Callable[[cvi.Scene], object]]] = {
    "ball": (0.4, lambda scene: scene.add_sphere("body", RADIUS)),
    "capsule": ((0.5 * LENGTH / RADIUS + 0.4 * 4.0 / 3.0) / (LENGTH / RADIUS + 4.0 / 3.0),
                lambda scene: scene.add_capsule("body", RADIUS, LENGTH)),
}  # fmt: skip


def over_edge(roller: str, kind: str, flies: bool = False) -> Held:
    """A body that rolls along a level line and over the edge or the end of a shape; later it slides, and flies."""
    speed, start, friction = 0.3, -0.12, 2.0
    edge, add = EDGES[kind]
    inertia, add_roller = ROLLERS[roller]
    scene = cvi.Scene()
    add(scene)
    add_roller(scene)
    scene.set_contact(restitution=0.0, friction=friction)
    body = oracle.BallOffSphere(RADIUS, RADIUS + edge, friction, inertia)
    axes = np.eye(3) if roller == "ball" else ALONG_Y
    v = np.concatenate([axes.T @ [speed, 0.0, 0.0], axes.T @ [0.0, speed / RADIUS, 0.0]])
    return _switched(
        scene, pose(np.array([start, 0.0, RADIUS + edge]), axes), v, (0.8 if flies else 0.56) + edge,
        lambda times: _in_plane(oracle.ball_over_edge(body, speed, start, times)), _observe_in_plane(axes),
        (0, 1, 5, 6),
    )  # fmt: skip


def rod_on_tip(friction: float, speed: float, duration: float) -> Held:
    """A rod whose lower end slides along the ground, with a speed of its centre along x."""
    theta, tip = 1.0, 0.02
    scene, q = systems.rod_on_ground(theta, tip, 0.0, friction, systems.GRAVITY)
    rod = oracle.RodOnTip(friction, tip)

    def states(times: Array) -> tuple[Array, list[Change]]:
        return rod.states(np.array([0.0, theta, speed, 0.0]), times)

    def observe(q: Array, v: Array) -> Array:
        return np.stack([q[:, 0], -q[:, 2], v[:, 0], -v[:, 2]], axis=1)

    return _switched(scene, q, np.array([speed, 0.0, 0.0]), duration, states, observe, (0, 1))


def block_on_belt(block: oracle.BlockOnBelt, start: float, duration: float) -> Held:
    """A block with a spring on a driven belt, at x = 0 with the velocity `start`."""
    model = systems.empty_model(systems.GRAVITY)
    inertia = pin.Inertia(1.0, np.zeros(3), np.eye(3))
    belt = model.addJoint(0, pin.JointModelPX(), place(), "belt")
    model.appendBodyToJoint(belt, inertia, place())
    along = model.addJoint(0, pin.JointModelPX(), place(), "along")
    model.appendBodyToJoint(along, pin.Inertia.Zero(), place())
    up = model.addJoint(along, pin.JointModelPZ(), place(z=RADIUS), "up")
    model.appendBodyToJoint(up, inertia, place())
    shapes = {"belt": (belt, place(), halfspace(0.0, 0.0, 1.0, 0.0)), "block": (up, place(), coal.Sphere(RADIUS))}
    scene = systems.built(model, shapes, [("belt", "block")], 0.0, block.friction)
    scene.set_joint("along", stiffness=block.stiffness)
    scene.prescribe("belt", block.belt)
    v = np.array([block.belt(0.0)[1], start, 0.0])
    pieces = block.pieces(0.0, start, duration)
    changes = tuple(piece[0] for piece in pieces[1:])
    ends = tuple(later[0] for piece, later in zip(pieces, pieces[1:], strict=False) if piece[1])

    def observe(q: Array, v: Array) -> Array:
        return np.stack([q[:, 1], v[:, 1]], axis=1)

    def exact(times: Array) -> Array:
        return block.states(0.0, start, times)

    return Held(scene, np.zeros(3), v, duration, exact, observe, (0,), changes, ends)


def steady_belt() -> Held:
    return block_on_belt(oracle.BlockOnBelt(40.0, 0.4, 0.5), 0.0, 2.0)


def shaking_belt(duration: float = 2.0) -> Held:
    block = oracle.BlockOnBelt(10.0, 0.3, 0.0, 0.1, 7.0)
    return block_on_belt(block, block.belt(0.0)[1], duration)


def tilting_plane() -> Held:
    """A box on a driven plane that tilts until the box slips."""
    size, friction, turning, place_on = (0.4, 0.3, 0.1), 0.4, 0.5, 0.2
    scene = _turning_plane(pin.JointModelRY(), turning)
    scene.add_box("box", size, mass=2.0)
    scene.set_contact(restitution=0.0, friction=friction)
    box = oracle.BoxOnTiltingPlane(friction, turning, 0.5 * size[2])
    q = np.append(0.0, pose([place_on, 0.0, box.half_height]))
    # the box turns with the plane
    v = np.array([turning, turning * box.half_height, 0.0, -turning * place_on, 0.0, turning, 0.0])

    def observe(q: Array, v: Array) -> Array:
        down = np.stack([np.cos(q[:, 0]), 0.0 * q[:, 0], -np.sin(q[:, 0])], axis=1)
        velocity = np.einsum("nij,nj->ni", _turns(q[:, 1:]), v[:, 1:4])
        return np.stack([
            np.einsum("ni,ni->n", q[:, 1:4], down),
            np.einsum("ni,ni->n", velocity, down) - turning * box.half_height,
        ], axis=1)  # fmt: skip

    return _switched(scene, q, v, 1.2, lambda times: box.states(place_on, times), observe)


def rubbing_pendulum() -> Held:
    model = systems.empty_model(systems.GRAVITY)
    joint = model.addJoint(0, systems.hinge(), place(), "hinge")
    systems.append_point_mass(model, joint)
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("hinge", friction=0.8)
    pendulum = oracle.RubbingPendulum(1.0, systems.GRAVITY, 0.8)

    def exact(times: Array) -> Array:
        return pendulum.states(1.2, times)[0]

    return Held(scene, np.array([1.2]), np.zeros(1), 8.0, exact, lambda q, v: np.concatenate([q, v], axis=1))


def rubbing_spring() -> Held:
    """A mass on a spring and a rubbing guide, until it sticks."""
    spring = joint_friction.SpringMass(1.5, 30.0, 2.0, 0.5)
    model = systems.empty_model()
    joint = model.addJoint(0, pin.JointModelPX(), place(), "guide")
    model.appendBodyToJoint(joint, pin.Inertia(spring.mass, np.zeros(3), np.eye(3)), place())
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("guide", stiffness=spring.stiffness, friction=spring.friction)

    def exact(times: Array) -> Array:
        return np.array([spring.state(t) for t in times])

    return Held(scene, np.array([spring.x0]), np.zeros(1), 3.0, exact, lambda q, v: np.concatenate([q, v], axis=1))


COIN = oracle.RollingCoin(0.1, 0.02)
TILT = 0.9  # of the axis from the vertical [rad]
PRECESSION = 4.0  # [rad/s]


def rolling_coin(nudge: float = 0.0) -> Held:
    """A coin that rolls on its rim: steadily round a circle, or with a spin about its diameter more, it wobbles."""
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_cylinder("coin", radius=COIN.radius, length=COIN.height)
    scene.set_contact(restitution=0.0, friction=0.8)
    axis, spin = COIN.steady(TILT, PRECESSION)
    spin = spin + nudge * np.array([0.0, 1.0, 0.0])
    start, centre = turned(TILT), np.array([0.0, 0.0, -COIN.arm(axis)[2]])
    velocity = -np.cross(spin, COIN.arm(axis))

    def observe(q: Array, v: Array) -> Array:
        turns = _turns(q)
        return np.concatenate([q[:, :3], turns[:, :, 2], np.einsum("nij,nj->ni", turns, v[:, 3:6])], axis=1)

    def exact(times: Array) -> Array:
        return COIN.states(axis, spin, times) if nudge else oracle.circling(COIN, TILT, PRECESSION, times)

    v = np.concatenate([start.T @ velocity, start.T @ spin])
    return Held(scene, pose(centre, start), v, 1.0, exact, observe, (0, 1, 2, 3, 4, 5))
