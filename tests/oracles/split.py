"""A Pinocchio model rewritten so that no joint couples spin with translation.

free-flyer -> translation + spherical joint, planar -> prismatic x, prismatic y, revolute-unbounded z.
The numbers of q stay; the tangent velocity of a split joint becomes (parent-frame linear, body
angular). Also the group operations joint by joint, with our own SO(3) functions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from . import so3

REFUSED = ("SphericalZYX", "Universal", "Ellipsoid", "Composite", "Mimic")


@dataclass(frozen=True)
class Joint:
    """One joint of the split model: kind is 'line', 'circle', 'rotation' or 'space'."""

    kind: str
    q: slice
    v: slice


def _kind(joint: pin.JointModel) -> str:
    name = joint.shortname()
    if any(r in name for r in REFUSED):
        raise ValueError(f"joint type {name} is not constant-S")
    if "Translation" in name:
        return "space"
    if "Spherical" in name:
        return "rotation"
    if (joint.nq, joint.nv) == (2, 1):
        return "circle"
    assert (joint.nq, joint.nv) == (1, 1), name
    return "line"


class SplitModel:
    """Split copy of `original`, with conversions of v, p between the two.

    Attributes: model (the split pin.Model), joints (list of Joint), last (split joint id of the body
    of each original joint), rigid (list of (kind, q slice, v slice) of split free-flyers and planars).
    """

    def __init__(self, original: pin.Model):
        self.original, self.model = original, pin.Model()
        self.model.gravity = original.gravity
        self.last, self.rigid, self.joints = [0], [], []
        for i in range(1, original.njoints):
            self._add(i)
        for i in range(1, self.model.njoints):
            j = self.model.joints[i]
            self.joints.append(Joint(_kind(j), slice(j.idx_q, j.idx_q + j.nq), slice(j.idx_v, j.idx_v + j.nv)))
        self.model.armature = original.armature.copy()
        self.data = self.model.createData()
        self.nq, self.nv = self.model.nq, self.model.nv
        assert (self.nq, self.nv) == (original.nq, original.nv)

    def _add(self, i: int) -> None:
        o, m = self.original, self.model
        joint, name = o.joints[i], o.joints[i].shortname()
        chain = [joint]
        if name == "JointModelFreeFlyer":
            chain = [pin.JointModelTranslation(), pin.JointModelSpherical()]
        elif name == "JointModelPlanar":
            chain = [pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRUBZ()]
        if len(chain) > 1:
            v = slice(joint.idx_v, joint.idx_v + joint.nv)
            self.rigid.append((name[10:], slice(joint.idx_q, joint.idx_q + joint.nq), v))
        parent, placement = self.last[o.parents[i]], o.jointPlacements[i]
        for k, jm in enumerate(chain):
            parent = m.addJoint(parent, jm, placement, f"{o.names[i]}/{k}")
            placement = pin.SE3.Identity()
        m.appendBodyToJoint(parent, o.inertias[i], pin.SE3.Identity())
        self.last.append(parent)

    def tangent_map(self, q: np.ndarray) -> np.ndarray:
        """T(q) with v_split = T v_public, orthogonal, shape (nv, nv)."""
        t = np.eye(self.nv)
        for kind, iq, iv in self.rigid:
            x = q[iq]
            if kind == "FreeFlyer":
                rotation = pin.Quaternion(x[3:] / np.linalg.norm(x[3:])).matrix()
                t[iv.start : iv.start + 3, iv.start : iv.start + 3] = rotation
            else:
                c, s = x[2:] / math.hypot(x[2], x[3])
                t[iv.start : iv.start + 2, iv.start : iv.start + 2] = [[c, -s], [s, c]]
        return t

    def integrate(self, q: np.ndarray, w: np.ndarray) -> np.ndarray:
        """q (+) w, w in split tangent coordinates."""
        out = q.copy()
        for j in self.joints:
            if j.kind in ("line", "space"):
                out[j.q] += w[j.v]
            elif j.kind == "circle":
                c, s = math.cos(w[j.v][0]), math.sin(w[j.v][0])
                x, y = q[j.q]
                out[j.q] = np.array([c * x - s * y, s * x + c * y]) / math.hypot(x, y)
            else:
                u = so3.quat_product(q[j.q], so3.quat_exp(w[j.v]))
                out[j.q] = u / np.linalg.norm(u)
        return out

    def difference(self, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        """w with q1 = q0 (+) w, shape (nv,)."""
        w = np.empty(self.nv)
        for j in self.joints:
            a, b = q0[j.q], q1[j.q]
            if j.kind in ("line", "space"):
                w[j.v] = b - a
            elif j.kind == "circle":
                w[j.v] = math.atan2(a[0] * b[1] - a[1] * b[0], a @ b)
            else:
                w[j.v] = so3.quat_difference(a, b)
        return w

    def jacobians(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of q (+) w with respect to q and w, left-trivialised, each (nv, nv)."""
        jq, jw = np.eye(self.nv), np.eye(self.nv)
        for j in self.joints:
            if j.kind == "rotation":
                jq[j.v, j.v], jw[j.v, j.v] = so3.exp(w[j.v]).T, so3.right_jacobian(w[j.v])
        return jq, jw

    def bracket(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Lie bracket [a, b] of the split group, shape (nv,)."""
        c = np.zeros(self.nv)
        for j in self.joints:
            if j.kind == "rotation":
                c[j.v] = np.cross(a[j.v], b[j.v])
        return c

    def ad_star(self, v: np.ndarray, p: np.ndarray) -> np.ndarray:
        """ad*_v p, defined by <ad*_v p, w> = <p, [v, w]>, shape (nv,)."""
        c = np.zeros(self.nv)
        for j in self.joints:
            if j.kind == "rotation":
                c[j.v] = np.cross(p[j.v], v[j.v])
        return c

    def rate(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Plain time derivative of the numbers of q, shape (nq,)."""
        out = np.empty(self.nq)
        for j in self.joints:
            if j.kind in ("line", "space"):
                out[j.q] = v[j.v]
            elif j.kind == "circle":
                out[j.q] = v[j.v][0] * np.array([-q[j.q][1], q[j.q][0]])
            else:
                out[j.q] = 0.5 * so3.quat_product(q[j.q], np.append(v[j.v], 0.0))
        return out

    def normalize(self, q: np.ndarray) -> np.ndarray:
        """q with unit quaternions and unit complex numbers."""
        out = q.copy()
        for j in self.joints:
            if j.kind in ("circle", "rotation"):
                out[j.q] /= np.linalg.norm(out[j.q])
        return out
