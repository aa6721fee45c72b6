"""Angles of joints without end over a run: of continuous joints, and of planar ones, whose numbers in q are a cosine
and a sine."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.importing.joint_kinds import joint_kind
from contactvi.scene.coordinates import coordinates
from contactvi.scene.scene import Scene

Array = NDArray[np.float64]

_PLACES = {"continuous": (0, 0), "planar": (2, 2)}  # of the cosine in the joint's q, of its rate in the joint's v


class Run(Protocol):
    """What angles are computed from; contactvi.Trajectory has it."""

    t: Array
    q: Array

    @property
    def scene(self) -> Scene: ...
    @property
    def v(self) -> Array: ...


def turned_angles(traj: Run) -> dict[str, Array]:
    """Return the angle (N,) [rad] of each joint without end at the nodes by its name, JOINT.angle.

    It starts in (-pi, pi] and goes on over whole turns: between two nodes it is that angle, of those which the two
    cosines and sines allow, which is nearest to the mean of the two velocities times the time between them.
    """
    model = traj.scene.model
    named = coordinates(model)
    found: dict[str, Array] = {}
    for index in range(1, model.njoints):
        places = _PLACES.get(str(joint_kind(model.joints[index])))
        if places is None:
            continue
        cosine, rate = model.idx_qs[index] + places[0], traj.v[:, model.idx_vs[index] + places[1]]
        angle = np.arctan2(traj.q[:, cosine + 1], traj.q[:, cosine])
        steps, turned = np.diff(angle), 0.5 * (rate[1:] + rate[:-1]) * np.diff(traj.t)
        steps += 2.0 * np.pi * np.rint((turned - steps) / (2.0 * np.pi))
        name = f"{model.names[index]}.angle"
        while name in named.q or name in named.v or name in found:  # a joint may be called so
            name += "'"
        found[name] = angle[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return found
