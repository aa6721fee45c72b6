"""MuJoCo's own numbers of a model, in the coordinates of the scene that contactvi made of it: an independent oracle.

Nothing of the importer is used: joints, bodies and geoms are matched by their order, which both keep.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import contactvi as cvi
from helpers.extras import mujoco_module

mujoco = mujoco_module()

FREE, BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
EVERYTHING = 1e3  # [m] a margin at which all tested pairs are in contact


@dataclass
class Differences:
    """Largest differences between a scene and MuJoCo's model of the same file.

    Attributes:
        mass: of the sums, relative.
        matrix: of the mass matrix, relative to sqrt(M_ii M_jj).
        bias: of bias forces and gravity, relative to the largest.
        places: of geoms, positions [m] relative to the largest coordinate (1 m at least) and rotation matrices.
        ranges: of joint limits [rad or m].
    """

    mass: float
    matrix: float
    bias: float
    places: float
    ranges: float

    def largest(self) -> float:
        return max(vars(self).values())


def random_state(m: mujoco.MjModel, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (qpos, qvel) somewhere around qpos0."""
    rng = np.random.default_rng(seed)
    qpos = np.array(m.qpos0)
    mujoco.mj_integratePos(m, qpos, rng.normal(size=m.nv), 0.7)
    return qpos, rng.normal(size=m.nv)


def to_q(m: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Return Pinocchio's numbers of a qpos."""
    q = np.array(qpos)
    for kind, first in zip(m.jnt_type, m.jnt_qposadr, strict=True):
        if kind in (FREE, BALL):
            w = slice(first + (3 if kind == FREE else 0), first + (7 if kind == FREE else 4))
            q[w] = np.roll(qpos[w] / np.linalg.norm(qpos[w]), -1)
    return q


def to_v(m: mujoco.MjModel, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return S (nv, nv) with v = S qvel at qpos, and the joints' first dofs that are free, shape (nfree,)."""
    S, free = np.eye(m.nv), []
    for kind, first, dof in zip(m.jnt_type, m.jnt_qposadr, m.jnt_dofadr, strict=True):
        if kind == FREE:
            flat = np.zeros(9)
            mujoco.mju_quat2Mat(flat, qpos[first + 3 : first + 7] / np.linalg.norm(qpos[first + 3 : first + 7]))
            S[dof : dof + 3, dof : dof + 3] = flat.reshape(3, 3).T
            free.append(int(dof))
    return S, np.array(free, dtype=int)


def differences(scene: cvi.Scene, m: mujoco.MjModel, states: int = 3) -> Differences:
    """Return how far the scene's model (in its own units and axes) is from MuJoCo's at random states."""
    model, d = scene.model, mujoco.MjData(m)
    data = model.createData()
    assert (model.nq, model.nv) == (m.nq, m.nv)
    found = Differences(_mass(model, m), 0.0, 0.0, 0.0, _ranges(model, m))
    for seed in range(states):
        qpos, qvel = random_state(m, seed)
        d.qpos[:], d.qvel[:] = qpos, qvel
        mujoco.mj_forward(m, d)
        q, (S, free) = to_q(m, qpos), to_v(m, qpos)
        if m.nv:
            matrix = S.T @ _full(pin.crba(model, data, q)) @ S
            wanted = np.zeros((m.nv, m.nv))
            mujoco.mj_fullM(m, d, wanted)
            armature = [int(dof) + k for dof in free for k in range(6)]
            wanted[armature, armature] -= m.dof_armature[armature]  # the engine has none there, and reports it
            size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
            found.matrix = max(found.matrix, float(np.abs((matrix - wanted) / size).max()))
            found.bias = max(found.bias, _bias(model, data, m, d, q, S, free))
        found.places = max(found.places, _places(scene, data, m, d, q))
    return found


def _full(upper: np.ndarray) -> np.ndarray:
    return np.triu(upper) + np.triu(upper, 1).T


def _mass(model: pin.Model, m: mujoco.MjModel) -> float:
    total = float(np.sum(m.body_mass))
    return abs(sum(inertia.mass for inertia in model.inertias) - total) / max(total, 1e-300)


def _ranges(model: pin.Model, m: mujoco.MjModel) -> float:
    worst = 0.0
    off = bool(m.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_LIMIT))
    for j in range(m.njnt):
        if m.jnt_type[j] in (FREE, BALL) or not m.jnt_limited[j] or off:
            continue
        k = m.jnt_qposadr[j]
        own = np.array([model.lowerPositionLimit[k], model.upperPositionLimit[k]])
        worst = max(worst, float(np.abs(own - m.jnt_range[j]).max()))
    return worst


def _bias(
    model: pin.Model,
    data: pin.Data,
    m: mujoco.MjModel,
    d: mujoco.MjData,
    q: np.ndarray,
    S: np.ndarray,
    free: np.ndarray,
) -> float:
    """Difference of Coriolis, centrifugal and gravity forces: S^T (nle + M dS/dt qvel) against qfrc_bias."""
    turning, qvel = np.zeros(m.nv), np.array(d.qvel)
    for dof in free:
        turning[dof : dof + 3] = -np.cross(
            qvel[dof + 3 : dof + 6], S[dof : dof + 3, dof : dof + 3] @ qvel[dof : dof + 3]
        )
    forces = pin.nonLinearEffects(model, data, q, S @ qvel) + _full(pin.crba(model, data, q)) @ turning
    size = max(float(np.abs(d.qfrc_bias).max()), 1e-6 * float(np.diag(_full(pin.crba(model, data, q))).max()))
    return float(np.abs(S.T @ forces - d.qfrc_bias).max()) / size


def _places(scene: cvi.Scene, data: pin.Data, m: mujoco.MjModel, d: mujoco.MjData, q: np.ndarray) -> float:
    """Difference of the places of the collision geometries, whose order is that of the geoms they belong to."""
    pin.forwardKinematics(scene.model, data, q)
    worst, size = 0.0, max(1.0, float(np.abs(d.geom_xpos).max(initial=0.0)))
    for geometry in scene.collision_model.geometryObjects:
        geom = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_GEOM, geometry.name)
        if geom < 0 or m.geom_sameframe[geom]:
            continue  # without a name; or where MuJoCo takes the body's frame, which is 1e-6 from the geom's
        at = data.oMi[geometry.parentJoint] * geometry.placement
        worst = max(worst, float(np.abs(at.translation - d.geom_xpos[geom]).max()) / size)
        worst = max(worst, float(np.abs(at.rotation.ravel() - d.geom_xmat[geom]).max()))
    return worst


def tested_pairs(m: mujoco.MjModel) -> dict[tuple[int, int], tuple[float, int]]:
    """Return the pairs (geom, geom) that MuJoCo tests, found by margins so wide that all of them are in contact.

    The values are sliding friction and the contact dimension. All shapes but planes and height fields become spheres.
    """
    m = m.__copy__()
    flat = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
    m.geom_type[~np.isin(m.geom_type, flat)] = int(mujoco.mjtGeom.mjGEOM_SPHERE)
    m.geom_margin[:], m.geom_gap[:], m.pair_margin[:], m.pair_gap[:], m.body_margin[:] = (
        EVERYTHING,
        0,
        EVERYTHING,
        0,
        EVERYTHING,
    )
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    d = mujoco.MjData(m)
    mujoco.mj_kinematics(m, d)
    mujoco.mj_comPos(m, d)
    mujoco.mj_collision(m, d)
    found = {}
    for k in range(d.ncon):
        contact = d.contact[k]
        a, b = sorted(int(g) for g in contact.geom)
        found[a, b] = (float(contact.friction[0]) if contact.dim > 1 else 0.0, int(contact.dim))
    return found
