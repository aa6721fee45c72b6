"""Mass matrix and bias forces of a model by passes over its joints, without pin.Data (see kinematics.py)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from contactvi.importing.kinematics import Joints


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
    for i, joint in reversed(list(enumerate(Joints(model, range(1, len(parents))).at(q), 1))):
        own, carried = slice(starts[i], starts[i] + sizes[i]), slice(starts[i], ends[i])
        F[:, own] = bodies[i].matrix() @ joint.subspace
        M[own, carried] = joint.subspace.T @ F[:, carried]
        F[:, carried] = joint.in_parent.toDualActionMatrix() @ F[:, carried]
        bodies[parents[i]] = bodies[parents[i]] + joint.in_parent.act(bodies[i])
        ends[parents[i]] = max(ends[parents[i]], ends[i])
    return np.asarray(np.triu(M) + np.triu(M, 1).T + np.diag(model.armature))


def bias_forces(model: pin.Model, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return b(q, v), shape (nv,): Coriolis, centrifugal and gravity forces; q: (nq,), v: (nv,).

    The recursive Newton-Euler algorithm for dv/dt = 0, in which the world accelerates against gravity.
    """
    parents, inertias = list(model.parents), list(model.inertias)
    joints = list(Joints(model, range(1, len(parents))).at(q, v))
    twists, accelerations, forces = [pin.Motion.Zero()], [-model.gravity], [pin.Force.Zero()]
    for i, joint in enumerate(joints, 1):
        twist = joint.in_parent.actInv(twists[parents[i]]) + joint.twist
        acceleration = joint.in_parent.actInv(accelerations[parents[i]]) + joint.bias + twist.cross(joint.twist)
        twists.append(twist)
        accelerations.append(acceleration)
        forces.append(inertias[i] * acceleration + twist.cross(inertias[i] * twist))
    b = np.zeros(model.nv)
    for i, joint in reversed(list(enumerate(joints, 1))):
        b[model.idx_vs[i] : model.idx_vs[i] + model.nvs[i]] = joint.subspace.T @ forces[i].vector
        forces[parents[i]] = forces[parents[i]] + joint.in_parent.act(forces[i])
    return b
