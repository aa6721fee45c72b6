"""Small mechanisms with contact whose answers are known, as (pin.Model, pin.GeometryModel) or cvi.Scene."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from batteries.models import Builder, double_pendulum

GRAVITY = 9.81
ROOM = 1.1  # half the size of the room [m]


def place(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    """Pure translation [m]."""
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def halfspace(x: float, y: float, z: float, offset: float) -> coal.Halfspace:
    """Solid side n.x <= offset."""
    return coal.Halfspace(np.array([x, y, z]), offset)


def geometry(shapes: dict, pairs: list[tuple[str, str]]) -> pin.GeometryModel:
    """Geometry model from {name: (joint, placement, shape)} with exactly these collision pairs."""
    g = pin.GeometryModel()
    index = {}
    for name, (joint, placement, shape) in shapes.items():
        index[name] = g.addGeometryObject(pin.GeometryObject(name, joint, placement, shape))
    for a, b in pairs:
        g.addCollisionPair(pin.CollisionPair(index[a], index[b]))
    return g


def scene(model: pin.Model, geometry_model: pin.GeometryModel, restitution: float = 1.0):
    """The public scene of a pin model, one restitution for all contacts."""
    import contactvi as cvi

    s = cvi.Scene.from_pinocchio(model, geometry_model)
    s.set_contact(restitution=restitution)
    return s


def problem_b(radius: float = 0.05) -> tuple[pin.Model, pin.GeometryModel]:
    """Double pendulum whose tip may not cross x = 0: a sphere at the tip, the wall set back by its radius."""
    model = double_pendulum()
    tip = (2, place(z=-1.0), coal.Sphere(radius))
    wall = (0, pin.SE3.Identity(), halfspace(1.0, 0.0, 0.0, -radius))
    return model, geometry({"tip": tip, "wall": wall}, [("wall", "tip")])


def pendulum_at_wall(radius: float = 0.1) -> tuple[pin.Model, pin.GeometryModel]:
    """Pendulum: point mass on a rod of 1 m, angle from the downward vertical, wall reached at angle 0."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRevoluteUnaligned(np.array([0.0, -1.0, 0.0])), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3))), pin.SE3.Identity())
    bob = (1, place(z=-1.0), coal.Sphere(radius))
    wall = (0, pin.SE3.Identity(), halfspace(1.0, 0.0, 0.0, -radius))
    return model, geometry({"bob": bob, "wall": wall}, [("wall", "bob")])


def slider_blocks(masses: tuple[float, ...], half: float, shape: str) -> tuple[pin.Model, pin.GeometryModel]:
    """Blocks on prismatic joints along x, numbered from the wall x = 0; no gravity. shape: 'sphere' or 'box'."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    body = coal.Sphere(half) if shape == "sphere" else coal.Box(2 * half, 2 * half, 2 * half)
    shapes = {"wall": (0, pin.SE3.Identity(), halfspace(1.0, 0.0, 0.0, 0.0))}
    for i, mass in enumerate(masses):
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), f"slider{i}")
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        shapes[f"block{i}"] = (joint, pin.SE3.Identity(), body)
    names = list(shapes)
    return model, geometry(shapes, list(zip(names, names[1:], strict=False)))


def rod(free: bool, radius: float = 0.01) -> tuple[pin.Model, pin.GeometryModel]:
    """Uniform rod m = l = 1 along body x with a small sphere at the end -x, over the ground z = 0; no gravity.

    The contact point lies below the sphere's centre, so its arm is exactly half a cos(theta). free: a free-flyer,
    else translation and a hinge about y.
    """
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1.0 / 12.0, 1.0 / 12.0]))
    if free:
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "rod")
    else:
        joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "slide")
        joint = model.addJoint(joint, pin.JointModelRY(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    end = (joint, place(x=-0.5), coal.Sphere(radius))
    ground = (0, pin.SE3.Identity(), halfspace(0.0, 0.0, 1.0, 0.0))
    return model, geometry({"end": end, "ground": ground}, [("ground", "end")])


def room(gravity: bool = True) -> tuple[pin.Model, pin.GeometryModel]:
    """An arm with a spherical joint and free bodies (sphere, capsule, box, ellipsoid) between six walls."""
    b = Builder(11)
    b.chain("revolute_z", "spherical", "revolute_x")
    for _ in range(4):
        b.add("free_flyer", placement=pin.SE3.Identity())
    model = b.model
    if not gravity:
        model.gravity = pin.Motion.Zero()
    centre = pin.SE3.Identity()
    shapes = {
        "hand": (3, place(0.1, 0.1, 0.2), coal.Sphere(0.15)),
        "ball": (4, centre, coal.Sphere(0.2)),
        "capsule": (5, place(0.05), coal.Capsule(0.12, 0.4)),
        "box": (6, place(0.0, 0.03), coal.Box(0.3, 0.4, 0.2)),
        "ellipsoid": (7, centre, coal.Ellipsoid(0.2, 0.15, 0.1)),
    }
    moving, walls = list(shapes), []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            n = np.zeros(3)
            n[axis] = -sign
            walls.append(f"wall{axis}{'-+'[sign > 0]}")
            shapes[walls[-1]] = (0, centre, halfspace(*n, -ROOM))
    pairs = [(w, m) for w in walls for m in moving] + [(a, c) for i, a in enumerate(moving) for c in moving[i + 1 :]]
    return model, geometry(shapes, pairs)


def room_start(model: pin.Model, speed: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(q, v) with the free bodies apart and flying at each other."""
    rng = np.random.default_rng([17, seed])
    q, v = pin.neutral(model), speed * rng.uniform(-1, 1, model.nv)
    corners = np.array([(-1, -1, -1), (1, -1, -1), (-1, 1, 1), (1, 1, -1)]) * 0.55 * ROOM
    for joint, corner in zip(range(4, 8), corners, strict=True):
        j = model.joints[joint]
        rotation = pin.exp3(rng.uniform(-1, 1, 3))
        q[j.idx_q : j.idx_q + 3] = corner
        q[j.idx_q + 3 : j.idx_q + 7] = pin.Quaternion(rotation).coeffs()
        v[j.idx_v : j.idx_v + 3] -= 2.0 * speed * rotation.T @ corner  # towards the middle, so that bodies meet
    return q, v
