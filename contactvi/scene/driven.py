"""What a prescribed motion moves: a joint with one degree of freedom, or a body in the world."""

from __future__ import annotations

from typing import NamedTuple

import pinocchio as pin

from contactvi.elements.element import WORLD
from contactvi.errors import InputError
from contactvi.importing.joint_kinds import joint_kind
from contactvi.scene.joints import one_dof
from contactvi.scene.selection import Names, Selector


class Driven(NamedTuple):
    """A joint with one degree of freedom, or a body; the other one is None."""

    joint: str | None
    body: str | None


def driven_by(model: pin.Model, names: Names, what: Selector) -> Driven:
    """Return what is meant: joints come first, free joints and free bases stand for their bodies.

    Raises:
        InputError: unknown name, the world, a part without a free base, another joint.
    """
    named = isinstance(what, str) and what in names.bodies and what not in names.by_joint and what not in names.parts
    if named or what == WORLD:
        if names.select_body(what) == WORLD:
            raise InputError(
                "The world does not move", name="joint", expected="a body or a joint", got=repr(what),
                remedy="Name the body that is to follow the motion",
            )  # fmt: skip
        return Driven(None, str(what))
    joint = names.select_joint(what)
    index = model.getJointId(joint)
    if joint_kind(model.joints[index]) != "free":
        one_dof(model, joint, "A motion", "Name its body, or a free base: they follow poses")
        return Driven(joint, None)
    body = next((f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == index), None)
    if body is None:
        raise InputError(
            f"Joint {joint!r} carries no body", name="joint", expected="a joint with a body", got="none",
            remedy="Add a frame of type BODY to the model",
        )  # fmt: skip
    return Driven(None, body)
