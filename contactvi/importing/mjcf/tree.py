"""Bodies and joints of a compiled MJCF as a pin.Model.

Joint values, their zero and their limits are the file's: a `ref` goes into the placement of the joint. A body with
several joints becomes a chain of which the last one carries its mass.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from contactvi.importing.joint_kinds import MANY_DOFS, joint_model
from contactvi.importing.mjcf.compiler import Source, pose

_KINDS = {"free": "free", "ball": "spherical", "slide": "prismatic", "hinge": "revolute"}


@dataclass
class Tree:
    """The model, and where the bodies of the file are in it.

    Attributes:
        joint: pin joint that moves each body, shape (nbody,).
        frame: its body frame, shape (nbody,).
        place: placement of the body's frame in the frame of that joint, nbody of them.
        joints: pin joint of each joint of the file, shape (njnt,).
    """

    model: pin.Model
    joint: list[int]
    frame: list[int]
    place: list[pin.SE3]
    joints: list[int]

    def at(self, body: int, position: np.ndarray, wxyz: np.ndarray) -> pin.SE3:
        """Return the placement in the joint of what has this pose in the body."""
        return self.place[body] * pose(position, wxyz)


def build_tree(source: Source) -> Tree:
    """Return bodies, joints with their data, and sites as frames."""
    m, model = source.m, pin.Model()
    tree = Tree(model, [0] * m.nbody, [0] * m.nbody, [pin.SE3.Identity()] * m.nbody, [0] * m.njnt)
    for body in range(1, m.nbody):
        _add_body(source, tree, body)
    for j in range(m.njnt):
        _set_joint(source, tree, j)
    for site in range(m.nsite):
        body = int(m.site_bodyid[site])
        place = tree.at(body, m.site_pos[site], m.site_quat[site])
        name = source.names["site"][site]
        model.addFrame(pin.Frame(name, tree.joint[body], tree.frame[body], place, pin.FrameType.OP_FRAME), False)
    return tree


def _add_body(source: Source, tree: Tree, body: int) -> None:
    m, model, name = source.m, tree.model, source.names["body"][body]
    above = int(m.body_parentid[body])
    parent, frame = tree.joint[above], tree.frame[above]
    place = tree.at(above, m.body_pos[body], m.body_quat[body])  # of the body before its joints, in the parent joint
    inertia = pin.Inertia(float(m.body_mass[body]), np.zeros(3), np.diag(m.body_inertia[body]))
    inertia = pose(m.body_ipos[body], m.body_iquat[body]).act(inertia)
    first, count = int(m.body_jntadr[body]), int(m.body_jntnum[body])
    if count == 0:
        fixed = pin.Frame(f"{name}_fixed", parent, frame, place, pin.FrameType.FIXED_JOINT, inertia)
        frame = model.addFrame(fixed)  # adds the inertia to that of the joint
    for j in range(first, first + count):
        before, after = _placements(source, j)
        place = before if _is(source, j, "FREE") else place * before
        parent = model.addJoint(parent, _joint_model(source, j), place, source.names["joint"][j])
        frame = model.addJointFrame(parent, frame)
        tree.joints[j], place = parent, after
    if count:
        model.appendBodyToJoint(parent, inertia, place)
    tree.joint[body], tree.place[body] = parent, place
    tree.frame[body] = model.addBodyFrame(name, parent, place, frame)


def _placements(source: Source, j: int) -> tuple[pin.SE3, pin.SE3]:
    """Return the placement of a joint in the body before it moves, and that of the body in the frame of the joint.

    The value of a free joint is the pose in the world. A slide turns nothing: its anchor does not matter.
    """
    m, one = source.m, np.eye(3)
    if _is(source, j, "FREE"):
        return pin.SE3.Identity(), pin.SE3.Identity()
    axis, anchor, zero = np.array(m.jnt_axis[j]), np.array(m.jnt_pos[j]), float(m.qpos0[m.jnt_qposadr[j]])
    if _is(source, j, "SLIDE"):
        return pin.SE3(one, -zero * axis), pin.SE3.Identity()
    turn = pin.exp3(-zero * axis) if _is(source, j, "HINGE") else one
    return pin.SE3(turn, anchor), pin.SE3(one, -anchor)


def _is(source: Source, j: int, kind: str) -> bool:
    return int(source.m.jnt_type[j]) == source.number("Joint", kind)


def _joint_model(source: Source, j: int) -> pin.JointModel:
    kind = _KINDS[source.word("Joint", source.m.jnt_type[j])]
    return joint_model(kind, None if kind in MANY_DOFS else np.array(source.m.jnt_axis[j]))


def _set_joint(source: Source, tree: Tree, j: int) -> None:
    """Set armature, damping, friction, range and effort of a joint."""
    m, model, name = source.m, tree.model, source.names["joint"][j]
    joint, first = model.joints[tree.joints[j]], int(m.jnt_dofadr[j])
    own, dofs = slice(first, first + joint.nv), slice(joint.idx_v, joint.idx_v + joint.nv)
    if not (_is(source, j, "FREE") and np.any(m.dof_armature[own])):
        _write(model, "armature", dofs, m.dof_armature[own])
    else:
        source.lose("joint", name, "armature of a free joint")
    if not source.off("DAMPER"):
        _write(model, "damping", dofs, m.dof_damping[own])
        if np.any(m.dof_dampingpoly[own]):
            source.lose("joint", name, "damping that is no constant (dampingpoly)")
    if not source.off("FRICTIONLOSS") and np.any(m.dof_frictionloss[own]):
        if joint.nv > 1:
            source.lose("joint", name, "frictionloss of a ball or free joint")
        else:
            _write(model, "upperDryFrictionLimit", dofs, m.dof_frictionloss[own])
            _write(model, "lowerDryFrictionLimit", dofs, -m.dof_frictionloss[own])
    limited = bool(m.jnt_limited[j]) and not source.off("LIMIT")
    if joint.nq == 1:
        low, high = m.jnt_range[j] if limited else (-np.inf, np.inf)
        place = slice(joint.idx_q, joint.idx_q + 1)
        _write(model, "lowerPositionLimit", place, low)
        _write(model, "upperPositionLimit", place, high)
        if limited and m.jnt_margin[j]:
            source.lose("joint", name, "margin of its limit")
        _set_effort(source, model, dofs, j)
    elif limited:
        source.lose("joint", name, "limit of a ball joint")


def _set_effort(source: Source, model: pin.Model, dofs: slice, j: int) -> None:
    m = source.m
    if not m.jnt_actfrclimited[j]:
        return
    low, high = (float(x) for x in m.jnt_actfrcrange[j])
    _write(model, "upperEffortLimit", dofs, min(-low, high))
    _write(model, "lowerEffortLimit", dofs, -min(-low, high))
    if -low != high:
        text = "actuatorfrcrange that is not symmetric: the smaller bound is the effort limit"
        source.report.note("changed", "joint", source.names["joint"][j], text)


def _write(model: pin.Model, field: str, where: slice, value: object) -> None:
    """Put numbers into an array of the model, which Pinocchio hands out as a copy."""
    array = np.array(getattr(model, field))
    array[where] = value
    setattr(model, field, array)
