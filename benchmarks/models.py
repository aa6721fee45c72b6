"""The models of the timing benchmarks, as pin.Model, and a floor under any of them."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi import _core

ROBOTS = "example-robot-data://robots/"


def chain(links: int) -> pin.Model:
    """Hanging chain of uniform rods, length 1 m and mass 1 kg in all, revolute joints about y."""
    model = pin.Model()
    parent, length = 0, 1.0 / links
    inertia = pin.Inertia(1.0 / links, np.array([0.0, 0.0, -length / 2]), length**2 / (12 * links) * np.eye(3))
    for k in range(links):
        offset = np.array([0.0, 0.0, -length if k else 0.0])
        parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), offset), f"joint_{k}")
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model


def urdf_model(path: str, base: str) -> pin.Model:
    """pin.Model of a robot of example-robot-data, without its joint damping."""
    scene = cvi.Scene()
    scene.add_urdf(ROBOTS + path, base=base, mimic=False)
    model = pin.Model(scene.model)
    model.damping[:] = 0.0
    return model


def all_models() -> dict[str, pin.Model]:
    return {
        "double pendulum": chain(2),
        "Allegro hand": urdf_model("allegro_hand_description/urdf/allegro_right_hand.urdf", "fixed"),
        "Talos, free base": urdf_model("talos_data/robots/talos_full_v2.urdf", "free"),
        "chain of 100": chain(100),
    }


def start(model: pin.Model, seed: int = 1, size: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Random state; a long chain starts straight and aslant: random angles only excite its fastest modes."""
    if model.nv == 100:
        return 0.5 * np.eye(1, model.nv)[0], np.zeros(model.nv)
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), size * rng.normal(size=model.nv))
    return q, size * rng.normal(size=model.nv)


def evaluation_seconds(scene: cvi.Scene, q: np.ndarray, v: np.ndarray) -> float:
    """Time of contactvi's own scalar evaluation (M^-1 p, dT/dq - g), fastest instruction set."""
    return min(_core.kernel_seconds(scene.core(), q, v, 1, name)["f"] for name in _core.instruction_sets())


def with_floor(model: pin.Model, q: np.ndarray, below: float = 0.005) -> cvi.Scene:
    """Elastic floor `below` metres under the lowest of small spheres at the ends of all branches."""
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    leaves = [i for i in range(1, model.njoints) if i not in set(model.parents)]
    centers = {i: model.inertias[i].lever for i in leaves}
    radius = 0.005
    lowest = min((data.oMi[i].act(c))[2] for i, c in centers.items()) - radius
    geometry = pin.GeometryModel()
    floor = geometry.addGeometryObject(
        pin.GeometryObject(
            "floor", 0, pin.SE3.Identity(), coal.Halfspace(np.array([0.0, 0.0, 1.0]), float(lowest - below))
        )
    )
    for i, c in centers.items():
        tip = pin.GeometryObject(f"tip_{i}", i, pin.SE3(np.eye(3), c), coal.Sphere(radius))
        geometry.addCollisionPair(pin.CollisionPair(geometry.addGeometryObject(tip), floor))
    scene = cvi.Scene.from_pinocchio(model, geometry)
    scene.set_contact(restitution=1.0)
    for joint in model.names[1:]:
        scene.set_joint(joint, limits=False)
    return scene
