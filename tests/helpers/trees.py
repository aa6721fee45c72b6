"""Trees with joints of all kinds that branch."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from helpers.chains import JOINTS, chain


def bushy_model() -> pin.Model:
    """A tree of fifteen joints of all kinds with two children each, in depth-first order."""
    rng, model = np.random.default_rng(11), pin.Model()
    kinds = [kind for group in JOINTS.values() for kind in group]

    def add(parent: int, depth: int) -> None:
        placement = pin.SE3(pin.exp3(rng.uniform(-1, 1, 3)), rng.uniform(-0.4, 0.4, 3))
        joint = model.addJoint(parent, kinds[model.njoints % len(kinds)], placement, f"j{model.njoints}")
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.2, 0.2, 3), np.diag(rng.uniform(0.05, 0.1, 3)))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        for _ in range(2 if depth else 0):
            add(joint, depth - 1)

    add(0, 3)
    return model


def models() -> dict[str, pin.Model]:
    """Trees of all kinds by name; joints of "all" are not in depth-first order."""
    long = pin.Model()
    for k in range(60):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -3.0]))
        joint = long.addJoint(k, (pin.JointModelRX, pin.JointModelRY)[k % 2](), place, f"j{k}")
        long.appendBodyToJoint(joint, pin.Inertia.FromBox(1e-6, 1e-3, 2e-3, 3e-3), pin.SE3.Random())
    long.armature = 1e-9 * np.ones(long.nv)
    joints = pin.Model()
    kinds = (
        pin.JointModelFreeFlyer(), pin.JointModelPlanar(), pin.JointModelTranslation(), pin.JointModelSpherical(),
        pin.JointModelRUBZ(), pin.JointModelHX(0.1), pin.JointModelPY(),
        pin.JointModelRevoluteUnaligned(np.array([0.6, 0.0, 0.8])), pin.JointModelHelicalUnaligned(np.eye(3)[1], 0.2),
    )  # fmt: skip
    for k, kind in enumerate(kinds):
        joint = joints.addJoint(k // 2, kind, pin.SE3.Random(), f"j{k}")
        joints.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
    return {
        "long": long, "empty": pin.Model(), "humanoid": pin.buildSampleModelHumanoidRandom(), "all": joints,
        "bush": bushy_model(), **{name: chain(kinds)[0].model for name, kinds in JOINTS.items()},
    }  # fmt: skip


def depth_first(model: pin.Model) -> pin.Model:
    """Return the model with each joint's whole subtree before its next sibling."""
    result, number = pin.Model(), {0: 0}

    def add(i: int) -> None:
        parent = number[model.parents[i]]
        number[i] = result.addJoint(parent, model.joints[i], model.jointPlacements[i], model.names[i])
        result.appendBodyToJoint(number[i], model.inertias[i], pin.SE3.Identity())
        for k in range(i + 1, model.njoints):
            if model.parents[k] == i:
                add(k)

    for k in range(1, model.njoints):
        if model.parents[k] == 0:
            add(k)
    return result
