"""Scenes with persistent contact and known motion: each returns (scene, q0, v0). Laws of every such run."""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi
from batteries.models import double_pendulum
from helpers.contact_models import geometry, halfspace, place

GRAVITY = 9.81
Start = tuple[cvi.Scene, np.ndarray, np.ndarray]
ROD = pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1.0 / 12.0, 1.0 / 12.0]))
TIP = 0.01  # radius of the ends of rods [m]


def down(slope: float) -> np.ndarray:
    """Unit vector down a slope about the y axis."""
    return np.array([math.cos(slope), 0.0, -math.sin(slope)])


def normal(slope: float) -> np.ndarray:
    return np.array([math.sin(slope), 0.0, math.cos(slope)])


def pose(xyz, rotation: np.ndarray | None = None) -> np.ndarray:
    """Numbers of a free body in q."""
    return np.append(xyz, pin.Quaternion(np.eye(3) if rotation is None else rotation).coeffs())


def turned(angle: float) -> np.ndarray:
    """Rotation about y."""
    return pin.exp3(np.array([0.0, angle, 0.0]))


def _slope_scene(mu: float, slope: float, restitution: float) -> cvi.Scene:
    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    scene.add_halfspace(normal(slope), 0.0, name="ground")
    scene.set_contact(restitution=restitution, friction=mu)
    return scene


def ball(mu=0.0, slope=0.0, gap=0.0, restitution=0.0, radius=0.1, mass=1.0) -> Start:
    """A ball at rest, its gap to the ground given."""
    scene = _slope_scene(mu, slope, restitution)
    scene.add_sphere("ball", radius=radius, mass=mass)
    return scene, pose((radius + gap) * normal(slope), turned(slope)), np.zeros(6)


def box(mu=0.0, slope=0.0, gap=0.0, restitution=0.0, size=(0.2, 0.3, 0.1), mass=2.0) -> Start:
    """A box at rest, flat over the ground, its gap given."""
    scene = _slope_scene(mu, slope, restitution)
    scene.add_box("box", size, mass=mass)
    return scene, pose((0.5 * size[2] + gap) * normal(slope), turned(slope)), np.zeros(6)


def cylinder(mu=0.5, slope=0.0, radius=0.1, length=0.3, mass=1.5) -> Start:
    """A cylinder lying on the slope, its axis along y."""
    scene = _slope_scene(mu, slope, 0.0)
    scene.add_cylinder("cylinder", radius=radius, length=length, mass=mass)
    lying = turned(slope) @ pin.exp3(np.array([0.5 * math.pi, 0.0, 0.0]))
    return scene, pose(radius * normal(slope), lying), np.zeros(6)


def groove(mu: float, slope: float, opening: float, radius=0.1) -> Start:
    """A ball between two sides at `opening` to the horizontal, which fall with the slope."""
    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    for sign, name in ((-1.0, "left"), (1.0, "right")):
        scene.add_halfspace(turned(slope) @ [0.0, sign * math.sin(opening), math.cos(opening)], 0.0, name=name)
    scene.add_sphere("ball", radius=radius)
    scene.set_contact(restitution=0.0, friction=mu)
    return scene, pose(turned(slope) @ [0.0, 0.0, radius / math.cos(opening)]), np.zeros(6)


def stack(count: int, mu=0.5, size=(0.2, 0.2, 0.1), mass=1.0) -> Start:
    """Boxes on each other, b0 the lowest."""
    scene, q = _slope_scene(mu, 0.0, 0.0), []
    for k in range(count):
        scene.add_box(f"b{k}", size, mass=mass)
        q.append(pose([0.0, 0.0, (k + 0.5) * size[2]]))
    return scene, np.concatenate(q), np.zeros(6 * count)


def ball_on_ball(angle: float, mu: float, radius=0.1, support=0.5) -> Start:
    """A ball at rest on a fixed one, at this angle from its top."""
    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    scene.add_sphere("support", radius=support, free=False)
    scene.add_sphere("ball", radius=radius)
    scene.set_contact(restitution=0.0, friction=mu)
    return scene, pose((radius + support) * np.array([math.sin(angle), 0.0, math.cos(angle)])), np.zeros(6)


def rod(shapes: dict, pairs, mu: float, restitution: float, gravity: float = GRAVITY) -> cvi.Scene:
    """A free uniform rod, m = l = 1 along its x, with these shapes (joint 1 is the rod)."""
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, 0.0, -gravity]), np.zeros(3))
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "rod")
    model.appendBodyToJoint(1, ROD, pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model, geometry(shapes, pairs))
    scene.set_contact(restitution=restitution, friction=mu)
    return scene


def ladder(theta0: float) -> Start:
    """A rod at rest against a wall x = 0 and on a floor z = 0, without friction; its ends are small balls."""
    shapes = {
        "floor": (0, pin.SE3.Identity(), halfspace(0.0, 0.0, 1.0, 0.0)),
        "wall": (0, pin.SE3.Identity(), halfspace(1.0, 0.0, 0.0, 0.0)),
        "foot": (1, place(x=0.5), coal.Sphere(TIP)),
        "head": (1, place(x=-0.5), coal.Sphere(TIP)),
    }
    scene = rod(shapes, [("floor", "foot"), ("wall", "head")], 0.0, 0.0)
    centre = [TIP + 0.5 * math.cos(theta0), 0.0, TIP + 0.5 * math.sin(theta0)]
    return scene, pose(centre, turned(theta0)), np.zeros(6)


def falling_rod(theta: float, gap: float, speed: float, mu: float, restitution: float, gravity=0.0) -> Start:
    """A rod that moves along -z at 1 m/s and along x at `speed`, its lower end, left, `gap` over the ground."""
    shapes = {
        "ground": (0, pin.SE3.Identity(), halfspace(0.0, 0.0, 1.0, 0.0)),
        # a flat end: a corner, so that the point of contact is the end itself
        "end": (1, place(x=-0.5), coal.Sphere(TIP)),
    }
    scene = rod(shapes, [("ground", "end")], mu, restitution, gravity)
    turn = turned(-theta)
    q = pose([0.0, 0.0, 0.5 * math.sin(theta) + TIP + gap], turn)
    return scene, q, np.append(turn.T @ [speed, 0.0, -1.0], np.zeros(3))


def tipping(tilt: float, size=(0.2, 0.3, 0.4), mu=3.0) -> Start:
    """A box that stands on one lower edge (along y, at x = 0), tilted to +x; at rest."""
    scene, _, v = box(mu=mu, size=size)
    turn = turned(tilt)
    return scene, pose(-turn @ [0.5 * size[0], 0.0, -0.5 * size[2]], turn), v


def spring_arm(restitution: float = 0.0) -> Start:
    """A double pendulum whose tip slides along the floor z = -1.5, with a spring; it swings in contact for ever."""
    model = double_pendulum()
    shapes = {
        "tip": (2, place(z=-1.0), coal.Sphere(0.05)),
        "floor": (0, pin.SE3.Identity(), halfspace(0.0, 0.0, 1.0, -1.5)),
    }
    scene = cvi.Scene.from_pinocchio(model, geometry(shapes, [("floor", "tip")]))
    scene.set_contact(restitution=restitution, friction=0.0)
    scene.set_joint(str(model.names[1]), stiffness=4.0)
    q = np.array([0.5, 0.0])
    core = scene.core()
    for _ in range(60):  # the second joint closes the gap, by secants
        gap, moved = (float(core.gaps(q + [0.0, d])[0][0]) for d in (0.0, 1e-7))
        q[1] -= gap * 1e-7 / (moved - gap)
        if abs(gap) < 1e-15:
            break
    return scene, q, np.zeros(2)


def pendulum_over_limit(limit: float, restitution: float) -> Start:
    """A point mass on a rod of 1 m, horizontal at rest; its hinge stops `limit` [rad] below the horizontal."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0])), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), pin.SE3.Identity())
    model.lowerPositionLimit = np.array([0.5 * math.pi - limit])
    model.upperPositionLimit = np.array([3.0])
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_contact(restitution=restitution)
    return scene, np.array([0.5 * math.pi]), np.zeros(1)


# --- laws -------------------------------------------------------------------------------------------------------------
def world_momentum(traj: cvi.Trajectory, body: int = 0) -> np.ndarray:
    """Linear momentum of the body-th free body, world frame, (N, 3)."""
    q, p = traj.q[:, 7 * body : 7 * body + 7], traj.p[:, 6 * body : 6 * body + 3]
    return np.array([pin.Quaternion(x[3:]).matrix() @ y for x, y in zip(q, p, strict=True)])


def start_normals(log: cvi.ContactLog) -> np.ndarray:
    """Normals at the starts of the steps: of the point at the end of the step before; NaN in its first step."""
    result = np.full_like(log.array("normal"), np.nan)
    keys = np.column_stack([log.array(name) for name in ("kind", "index", "point")])
    ends = log.end
    for key in np.unique(keys, axis=0):
        rows = np.flatnonzero(np.all(keys == key, axis=1))
        for before, row in zip(rows[:-1], rows[1:], strict=True):
            if abs(ends[before] - log.t[row]) <= 1e-9:
                result[row] = log.array("normal")[before]
    impacts = log.h == 0.0
    result[impacts] = log.array("normal")[impacts]
    return result


def check_contacts(traj: cvi.Trajectory, mu: float = 0.0) -> None:
    """Every row: phi >= -1e-10, lambda >= 0, |phi lambda| <= 1e-12; with a force in persistent contact |phi| <= 1e-10.

    Friction: within the cone, to the solver's tolerance; no slip where it sticks.
    """
    log = traj.contacts
    assert len(log) > 0
    gap, limit, persistent = log.array("gap"), log.array("kind") == 1, log.h > 0.0
    for name, normals in (("start", start_normals(log)), ("end", log.array("normal"))):
        impulse = log.array(name)
        unit = np.where(limit[:, None], [1.0, 0.0, 0.0], normals)  # the impulse of a limit is its first component
        known = np.isfinite(unit).all(axis=1)
        along = np.einsum("ij,ij->i", impulse, unit)[known]
        assert along.min() >= -1e-15
        assert np.abs(along * gap[known]).max() <= 1e-12
        across = np.linalg.norm(impulse[known] - along[:, None] * unit[known], axis=1)
        # the cone's residual, 1e-12, is relative to the largest impulse of a problem
        excess = across - mu * along * (1 + 1e-9)
        assert excess.max() <= 1e-12 * max(1e-2, float(np.abs(impulse).max())), excess.max()
    assert gap.min() >= -1e-10
    assert np.abs(gap[persistent & (log.normal_impulse > 0.0)]).max(initial=0.0) <= 1e-10
    sticking = persistent & (log.array("mode") == 0)
    # at the node a sticking point has no speed; tests of the body's position check its displacement in the step
    assert np.linalg.norm(log.array("slip")[sticking], axis=1).max(initial=0.0) <= 1e-10


def check_sums(traj: cvi.Trajectory, masses: list[float], names: list[str]) -> None:
    """Impulses on each free body = change of its momentum - weight x time, 1e-12 of the largest term."""
    for k, (mass, name) in enumerate(zip(masses, names, strict=True)):
        p, weight = world_momentum(traj, k), mass * GRAVITY * (traj.t[-1] - traj.t[0])
        change = p[-1] - p[0] + [0.0, 0.0, weight]
        scale = max(weight, float(np.abs(p).max()))
        assert np.abs(traj.contacts.impulse_on(name) - change).max() <= 1e-12 * scale


def changes(traj: cvi.Trajectory, kind: str, name: str | None = None) -> list:
    """The changes of one kind, of pairs with this name."""
    return [c for c in traj.contact_changes if c.change == kind and (name is None or name in c.pair)]


def same(a: cvi.Trajectory, b: cvi.Trajectory) -> None:
    """Two runs are equal in all bits, contacts included."""
    for name in ("t", "q", "p"):
        assert np.array_equal(getattr(a, name), getattr(b, name))
    for log, other in ((a.contacts, b.contacts), (a.contact_changes, b.contact_changes), (a.events, b.events)):
        for name, values in log.arrays.items():
            assert np.array_equal(values, other.arrays[name], equal_nan=values.dtype == float), name
