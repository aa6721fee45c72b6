"""Placements, motions and Jacobians of a model's joints, without pin.Data.

A pin.Data holds tensors of the size nv^3: 1.7 GB for a chain of 300 links, 14 GB for 200 free bodies. What is asked
once per scene or per call is found here by passes over the joints, each with a pin.JointData of its own, in time and
memory of their number (of its square for the Jacobians of all joints).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin


class JointState(NamedTuple):
    """A joint at q, v: its frame in that of its parent, what it adds to the twist of its parent (in its own frame), the
    acceleration that it adds to the parent's for dv/dt = 0, and its motion subspace (6, dofs) in its own frame."""

    in_parent: pin.SE3
    twist: pin.Motion
    bias: pin.Motion
    subspace: np.ndarray


class JointMotion(NamedTuple):
    """The motion of a joint's frame at q, v.

    Attributes:
        place: X_WJ, where it is.
        twist: in its own frame.
        acceleration: spatial, the derivative of the twist for dv/dt = 0, in its own frame.
    """

    place: pin.SE3
    twist: pin.Motion
    acceleration: pin.Motion


class Joints:
    """Some joints of a model, each with the pin.JointData in which its numbers are found."""

    def __init__(self, model: pin.Model, numbers: Iterable[int]) -> None:
        """Take the joints of these numbers, some of 1, ..., njoints - 1."""
        joints, placements = list(model.joints), list(model.jointPlacements)
        self._joints = [(joints[k], joints[k].createData(), placements[k]) for k in numbers]

    def at(self, q: np.ndarray, v: np.ndarray | None = None) -> Iterator[JointState]:
        """Yield their states at q (nq,), v (nv,); v = None: at rest."""
        for joint, data, placement in self._joints:
            if v is None:
                joint.calc(data, q)
            else:
                joint.calc(data, q, v)
            yield JointState(placement * data.M, data.v, data.c, np.asarray(data.S).reshape(6, -1))


def joint_placements(model: pin.Model, q: np.ndarray) -> list[pin.SE3]:
    """Return where the joint frames are in the world at q (nq,), one for each joint, the universe first."""
    parents, places = list(model.parents), [pin.SE3.Identity()]
    for i, joint in enumerate(Joints(model, range(1, len(parents))).at(q), 1):
        places.append(places[parents[i]] * joint.in_parent)
    return places


class JointChains:
    """Some joints of a model and those that carry them, at one state after the other.

    Nothing is found for bodies that are not asked for.
    """

    def __init__(self, model: pin.Model, joints: Sequence[int]) -> None:
        """Take the joints that are asked for, some of 0, ..., njoints - 1; 0 is the world."""
        self._model, self._parents = model, list(model.parents)
        self._wanted = [int(joint) for joint in joints]
        needed: set[int] = set()
        for joint in self._wanted:
            needed.update(self._chain(joint))
        self._needed = sorted(needed)
        self._joints = Joints(model, self._needed)

    def _chain(self, joint: int) -> list[int]:
        """Return a joint and those that carry it, the first one last."""
        found = []
        while joint:
            found.append(joint)
            joint = self._parents[joint]
        return found

    def poses(self, q: np.ndarray) -> np.ndarray:
        """Return positions [m] and quaternions x y z w of the joints asked for at q (nq,), shape (joints, 7)."""
        return np.array([pin.SE3ToXYZQUAT(place) for place in self.places(q)]).reshape(-1, 7)

    def places(self, q: np.ndarray) -> list[pin.SE3]:
        """Return the placements of the joints asked for in the world at q (nq,)."""
        found = {0: pin.SE3.Identity()}
        for k, joint in zip(self._needed, self._joints.at(q), strict=True):
            found[k] = found[self._parents[k]] * joint.in_parent
        return [found[k] for k in self._wanted]

    def motions(self, q: np.ndarray, v: np.ndarray) -> list[JointMotion]:
        """Return how the joints asked for move at q (nq,), v (nv,)."""
        found = {0: JointMotion(pin.SE3.Identity(), pin.Motion.Zero(), pin.Motion.Zero())}
        for k, joint in zip(self._needed, self._joints.at(q, v), strict=True):
            below = found[self._parents[k]]
            twist = joint.in_parent.actInv(below.twist) + joint.twist
            acceleration = joint.in_parent.actInv(below.acceleration) + joint.bias + twist.cross(joint.twist)
            found[k] = JointMotion(below.place * joint.in_parent, twist, acceleration)
        return [found[k] for k in self._wanted]

    def jacobians(self, q: np.ndarray) -> tuple[list[pin.SE3], np.ndarray]:
        """Return places of the joints asked for, and Jacobians (joints, 6, nv) of their twists in their own frames."""
        places, columns = {0: pin.SE3.Identity()}, np.zeros((6, self._model.nv))  # of each dof alone, in the world
        dofs = {k: np.arange(self._model.idx_vs[k], self._model.idx_vs[k] + self._model.nvs[k]) for k in self._needed}
        for k, joint in zip(self._needed, self._joints.at(q), strict=True):
            places[k] = places[self._parents[k]] * joint.in_parent
            columns[:, dofs[k]] = places[k].action @ joint.subspace
        J = np.zeros((len(self._wanted), 6, self._model.nv))
        for row, joint_number in zip(J, self._wanted, strict=True):
            if joint_number:
                moved_by = np.concatenate([dofs[k] for k in self._chain(joint_number)])
                row[:, moved_by] = places[joint_number].actionInverse @ columns[:, moved_by]
        return [places[k] for k in self._wanted], J
