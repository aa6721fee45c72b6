"""Names and units of the numbers in q and v: the joint's name, with the coordinate where a joint has several."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import pinocchio as pin

from contactvi.importing.joint_kinds import joint_kind

_TURN = ("qx", "qy", "qz", "qw")
_SPIN = tuple((name, "rad/s") for name in ("wx", "wy", "wz"))
# kind -> names and units of its numbers in q, and of those in v; "" is the joint alone.
_OF_KIND: dict[str, tuple[tuple[tuple[str, str], ...], tuple[tuple[str, str], ...]]] = {
    "revolute": ((("", "rad"),), (("v", "rad/s"),)),
    "continuous": ((("cos", "1"), ("sin", "1")), (("v", "rad/s"),)),
    "prismatic": ((("", "m"),), (("v", "m/s"),)),
    "helical": ((("", "rad"),), (("v", "rad/s"),)),
    "planar": ((("x", "m"), ("y", "m"), ("cos", "1"), ("sin", "1")), (("vx", "m/s"), ("vy", "m/s"), ("wz", "rad/s"))),
    "translation": ((("x", "m"), ("y", "m"), ("z", "m")), (("vx", "m/s"), ("vy", "m/s"), ("vz", "m/s"))),
    "spherical": (tuple((name, "1") for name in _TURN), _SPIN),
    "free": (
        (("x", "m"), ("y", "m"), ("z", "m"), *((name, "1") for name in _TURN)),
        (("vx", "m/s"), ("vy", "m/s"), ("vz", "m/s"), *_SPIN),
    ),
}


class Coordinates(NamedTuple):
    """Names of the numbers of q (nq) and v (nv) of a model, each with its unit.

    The numbers of a joint "j" are called j.x, j.y, j.z, j.qx, j.qy, j.qz, j.qw (positions [m], quaternion), j.cos and
    j.sin (continuous and planar joints), or j where there is one [rad or m]; its velocities j.vx, j.vy, j.vz [m/s] and
    j.wx, j.wy, j.wz [rad/s], Pinocchio's (the body twist of a free joint), or j.v where there is one.
    """

    q: dict[str, str]
    v: dict[str, str]


def coordinates(model: pin.Model) -> Coordinates:
    """Return the names of the numbers of q and v with their units, in their order; no two of them have one name."""
    found = Coordinates({}, {})
    for part, units in enumerate(found):
        for name, unit in _named(model, part):
            while name in found.q or name in found.v:  # a joint may be called "j.v"
                name += "'"
            units[name] = unit
    return found


def _named(model: pin.Model, part: int) -> Iterator[tuple[str, str]]:
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        for suffix, unit in _OF_KIND[str(joint_kind(joint))][part]:
            yield f"{name}.{suffix}" if suffix else str(name), unit
