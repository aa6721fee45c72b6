"""Trees with joints of all kinds that branch."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from helpers.chains import JOINTS


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
