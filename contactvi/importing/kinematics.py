"""Placements and mass matrix of a model, without the pin.Data of all of it.

A pin.Data holds tensors of the size nv^3: 1.7 GB for a chain of 300 links. What is asked once per scene is found here
by passes over the joints, in time and memory of their number (of its square for the mass matrix).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin


def joint_placements(model: pin.Model, q: np.ndarray) -> list[pin.SE3]:
    """Return where the joint frames are in the world at q (nq,), one for each joint, the universe first."""
    places = [pin.SE3.Identity()]
    for i, (in_parent, _) in enumerate(_joints(model, q), 1):
        places.append(places[model.parents[i]] * in_parent)
    return places


class JointPlaces:
    """Where some joint frames are in the world, at one configuration after the other.

    It has a model of its own with these joints and those that carry them: the pin.Data of all would have tensors of the
    size nv^3 for bodies that are not asked for, 14 GB each where these are 200 free ones.
    """

    def __init__(self, model: pin.Model, joints: Sequence[int]) -> None:
        """Take the joints that are asked for, some of 1, ..., njoints - 1."""
        parents = list(model.parents)
        needed: set[int] = set()
        for joint in joints:
            above = int(joint)
            while above and above not in needed:
                needed.add(above)
                above = int(parents[above])
        self._model, number, entries = pin.Model(), {0: 0}, [np.zeros(0, dtype=np.int64)]
        for k in sorted(needed):
            number[k] = self._model.addJoint(
                number[int(parents[k])], model.joints[k], model.jointPlacements[k], str(model.names[k])
            )
            entries.append(model.idx_qs[k] + np.arange(model.nqs[k]))
        self._wanted = [number[int(joint)] for joint in joints]
        self._entries = np.concatenate(entries)  # of q that are those of the own model
        self._data = self._model.createData()

    def at(self, q: np.ndarray) -> np.ndarray:
        """Return positions [m] and quaternions x y z w of the joints asked for at q (nq,), shape (joints, 7)."""
        pin.forwardKinematics(self._model, self._data, q[self._entries])
        places = self._data.oMi
        return np.array([pin.SE3ToXYZQUAT(places[k]) for k in self._wanted]).reshape(-1, 7)


def mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    """Return M(q), shape (nv, nv), of a model with joints in depth-first order; q: (nq,).

    The algorithm of composite bodies, each in the frame of its joint: about the world's origin a small inertia far from
    there would lose its digits.
    """
    bodies = [pin.Inertia(inertia) for inertia in model.inertias]
    parents = list(model.parents)
    starts, sizes = list(model.idx_vs), list(model.nvs)
    ends = [start + size for start, size in zip(starts, sizes, strict=True)]  # of the dofs that a joint carries
    M, F = np.zeros((model.nv, model.nv)), np.zeros((6, model.nv))
    for i, (in_parent, S) in reversed(list(enumerate(_joints(model, q), 1))):
        own, carried = slice(starts[i], starts[i] + sizes[i]), slice(starts[i], ends[i])
        F[:, own] = bodies[i].matrix() @ S
        M[own, carried] = S.T @ F[:, carried]
        F[:, carried] = in_parent.toDualActionMatrix() @ F[:, carried]
        bodies[parents[i]] = bodies[parents[i]] + in_parent.act(bodies[i])
        ends[parents[i]] = max(ends[parents[i]], ends[i])
    return np.asarray(np.triu(M) + np.triu(M, 1).T + np.diag(model.armature))


def _joints(model: pin.Model, q: np.ndarray) -> Iterator[tuple[pin.SE3, np.ndarray]]:
    """Yield of each joint but the universe its frame in the parent's, and its motion subspace in its own, (6, dofs)."""
    for joint, placement in zip(list(model.joints)[1:], list(model.jointPlacements)[1:], strict=True):
        data = joint.createData()
        joint.calc(data, q)
        yield placement * data.M, np.asarray(data.S).reshape(6, -1)
