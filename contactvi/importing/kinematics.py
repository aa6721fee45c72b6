"""Where a model's joints are: for pictures, which are made without the engine, and for scenes that are being built.

Each joint has a pin.JointData of its own; engine_model.py says why there is no pin.Data of the model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin


def joint_placements(model: pin.Model, q: np.ndarray) -> list[pin.SE3]:
    """Return where the joint frames are in the world at q (nq,), one for each joint, the universe first."""
    return JointChains(model, range(int(model.njoints))).places(q)


class JointChains:
    """Some joints of a model and those that carry them, at one configuration after the other.

    Nothing is found for bodies that are not asked for.
    """

    def __init__(self, model: pin.Model, joints: Sequence[int]) -> None:
        """Take the joints that are asked for, some of 0, ..., njoints - 1; 0 is the world."""
        parents = list(model.parents)
        self._wanted = [int(joint) for joint in joints]
        needed: set[int] = set()
        for joint in self._wanted:
            while joint and joint not in needed:
                needed.add(joint)
                joint = parents[joint]
        all_joints, placements = list(model.joints), list(model.jointPlacements)
        self._needed = [
            (k, parents[k], all_joints[k], all_joints[k].createData(), placements[k]) for k in sorted(needed)
        ]

    def poses(self, q: np.ndarray) -> np.ndarray:
        """Return positions [m] and quaternions x y z w of the joints asked for at q (nq,), shape (joints, 7)."""
        return np.array([pin.SE3ToXYZQUAT(place) for place in self.places(q)]).reshape(-1, 7)

    def places(self, q: np.ndarray) -> list[pin.SE3]:
        """Return the placements of the joints asked for in the world at q (nq,)."""
        found = {0: pin.SE3.Identity()}
        for k, parent, joint, data, placement in self._needed:
            joint.calc(data, q)
            found[k] = found[parent] * (placement * data.M)
        return [found[k] for k in self._wanted]
