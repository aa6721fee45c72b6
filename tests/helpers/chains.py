"""Chains of joints of every type with random bodies, and with all forces that have derivatives."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import contactvi as cvi

JOINTS = {
    "revolute": [pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ()],
    "unaligned": [
        pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])),
        pin.JointModelPrismaticUnaligned(np.array([0.0, 0.6, 0.8])),
    ],
    "continuous": [pin.JointModelRUBX(), pin.JointModelPY(), pin.JointModelRUBY()],
    "helical": [pin.JointModelHX(0.1), pin.JointModelRY()],
    "translation": [pin.JointModelTranslation(), pin.JointModelRY()],
    "spherical": [pin.JointModelSpherical(), pin.JointModelRY(), pin.JointModelSpherical()],
    "free": [pin.JointModelFreeFlyer(), pin.JointModelRY(), pin.JointModelSpherical()],
    "planar": [pin.JointModelPlanar(), pin.JointModelRY()],
}


def chain(kinds: list, seed: int = 0) -> tuple[cvi.Scene, np.random.Generator]:
    """Return a chain of joints with random bodies."""
    rng, model, parent = np.random.default_rng(seed), pin.Model(), 0
    for k, kind in enumerate(kinds):
        placement = pin.SE3(pin.exp3(rng.uniform(-1, 1, 3)), rng.uniform(-0.4, 0.4, 3))
        parent = model.addJoint(parent, kind, placement, f"j{k}")
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.2, 0.2, 3), np.diag(rng.uniform(0.05, 0.1, 3)))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"b{k}", parent, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    return cvi.Scene.from_pinocchio(model, name="chain"), rng


def state_of(scene: cvi.Scene, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q = pin.integrate(scene.model, pin.neutral(scene.model), rng.uniform(-1, 1, scene.nv))
    return q, rng.uniform(-2, 2, scene.nv), rng.uniform(-3, 3, scene.nv)


def with_elements(joints: str) -> tuple[cvi.Scene, np.random.Generator]:
    """Return a chain with springs and dampers of joints, lines through points, wrenches and functions of the user."""
    scene, rng = chain(JOINTS[joints], 1)
    bodies = [f"b{k}" for k in range(len(JOINTS[joints]))]
    for k, kind in enumerate(JOINTS[joints]):
        whole = kind.shortname() in ("JointModelFreeFlyer", "JointModelPlanar")  # these have no springs
        scene.set_joint(f"j{k}", damping=0.4, **({} if whole else {"stiffness": 3.0}))
    scene.add_spring(bodies[-1], "world", 40.0, point_a=(0.1, 0.2, 0.0), point_b=(1.0, 0.0, 0.5), damping=1.5)
    scene.add_wrench(bodies[-1], force=(1.0, -2.0, 0.5), torque=(0.3, 0.1, -0.2), point=(0.1, 0.0, 0.3))
    scene.add_wrench(bodies[0], force=(0.5, 1.0, 0.0), torque=(0.0, 0.2, 0.1), axes="body")
    n = scene.nv
    K, D = rng.uniform(-1, 1, (n, n)), rng.uniform(-0.3, 0.3, (n, n))
    scene.add_force(lambda t, q, v: D @ v + K[0], lambda t, q, v: (np.zeros((n, n)), D))
    return scene, rng


def form(scene: cvi.Scene, p: np.ndarray) -> np.ndarray:
    """The canonical two-form at (q, p) in left-trivialised coordinates: [[hat p, -1], [1, 0]] with the bracket of each
    joint's group, ad* of p."""
    n, model = scene.nv, scene.model
    result = np.zeros((2 * n, 2 * n))
    result[:n, n:], result[n:, :n] = -np.eye(n), np.eye(n)
    for k in range(1, model.njoints):
        i, kind = model.idx_vs[k], model.joints[k].shortname()
        if "Spherical" in kind:
            result[i : i + 3, i : i + 3] = pin.skew(p[i : i + 3])
        elif "FreeFlyer" in kind:
            result[i : i + 3, i + 3 : i + 6] = result[i + 3 : i + 6, i : i + 3] = pin.skew(p[i : i + 3])
            result[i + 3 : i + 6, i + 3 : i + 6] = pin.skew(p[i + 3 : i + 6])
        elif "Planar" in kind:
            result[i, i + 2], result[i + 2, i] = p[i + 1], -p[i + 1]
            result[i + 1, i + 2], result[i + 2, i + 1] = -p[i], p[i]
    return result
