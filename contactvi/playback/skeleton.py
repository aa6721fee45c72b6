"""What is drawn of models without any shape: lines from joint to joint, and a ball at each joint.

A tree of joints that carries one shape is drawn by its shapes alone. Lines go from the frame of the parent to the frame
of the joint, at the end of a chain to the links that are fixed there and to the points that close loops, else to the
centre of mass. A free body has a ball at its centre of mass.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.playback.open_side import trees_of
from contactvi.playback.visuals import NO_SHAPE_COLOR, Visual, line

Array = NDArray[np.float64]
_BALL = 0.06  # radius, of the length of an ordinary line
_LONE = 0.05  # [m] radius of a ball without a line
_SHORT = 1e-6  # [m] no line


class _Line(NamedTuple):
    """A line between two points, each in the frame of its joint [m]."""

    name: str
    joints: tuple[int, int]
    points: tuple[Array, Array]


def skeletons(
    model: pin.Model, shapes: Sequence[Visual], held: Mapping[int, Sequence[Array]] | None = None
) -> list[Visual]:
    """Return what is drawn of the trees of a model on which there are none of the shapes.

    Args:
        held: points of joints at which constraints hold them, each in the frame of its joint [m].
    """
    trees = trees_of(model)
    shaped = {int(trees[visual.joint]) for visual in shapes}
    bare = [joint for joint in range(1, model.njoints) if int(trees[joint]) not in shaped]
    lines = [found for joint in bare for found in _lines(model, joint, (held or {}).get(joint, ()))]
    lengths = [length for found in lines if (length := _length(model, found)) > _SHORT]
    radius = _BALL * float(np.median(lengths)) if lengths else _LONE
    drawn = [line(x.name, x.joints, x.points, NO_SHAPE_COLOR) for x in lines if _length(model, x) > _SHORT]
    return drawn + [_ball(model, joint, radius) for joint in bare]


def _lines(model: pin.Model, joint: int, held: Sequence[Array]) -> Iterator[_Line]:
    """Return the line to a joint, and from one without others behind it those to what it carries."""
    name, parent, origin = str(model.names[joint]), int(model.parents[joint]), np.zeros(3)
    if parent:
        yield _Line(f"to {name}", (parent, joint), (origin, origin))
    elif not _is_free(model, joint):
        yield _Line(f"to {name}", (0, joint), (_root(model, name), origin))
    if any(int(other) == joint for other in model.parents[joint + 1 :]):
        return
    carried = [frame for frame in model.frames if frame.parentJoint == joint and frame.type == pin.FrameType.BODY]
    ends = [frame.placement.translation for frame in carried if np.linalg.norm(frame.placement.translation) > _SHORT]
    ends += [point for point in held if np.linalg.norm(point) > _SHORT]
    if not ends and not _is_free(model, joint):
        ends = [model.inertias[joint].lever]
    for end in ends:
        yield _Line(f"of {name}", (joint, joint), (_middle(model, joint), end))


def _root(model: pin.Model, name: str) -> Array:
    """Return where the link stands that carries a joint in the world [m]: the origin where the model names none."""
    if not model.existFrame(name, pin.FrameType.JOINT):
        return np.zeros(3)
    carrier = model.frames[model.getFrameId(name, pin.FrameType.JOINT)].parentFrame
    return np.array(model.frames[carrier].placement.translation)


def _ball(model: pin.Model, joint: int, radius: float) -> Visual:
    placement = np.eye(4)
    placement[:3, 3] = _middle(model, joint)
    none = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32)
    return Visual(str(model.names[joint]), joint, placement, "sphere", (radius,), None, *none)


def _middle(model: pin.Model, joint: int) -> Array:
    """Return where the ball of a joint is, in its frame [m]."""
    return np.array(model.inertias[joint].lever) if _is_free(model, joint) else np.zeros(3)


def _is_free(model: pin.Model, joint: int) -> bool:
    return int(model.nvs[joint]) == 6 and model.parents[joint] == 0


def _length(model: pin.Model, found: _Line) -> float:
    """Return the length of a line where all joints are at their zeros [m]."""
    (first, second), (a, b) = found.joints, found.points
    if first == second:
        return float(np.linalg.norm(b - a))
    return float(np.linalg.norm(model.jointPlacements[second].act(b) - a))
