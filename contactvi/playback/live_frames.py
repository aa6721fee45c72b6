"""The frames of a live view as JSON: where bodies are now, the present contacts, what has happened.

World frame, simulated time. Arrays are numbers in base64.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.importing.kinematics import JointChains
from contactvi.playback.animation import drawn_side, is_free
from contactvi.playback.arrays import packed
from contactvi.playback.event_list import happenings
from contactvi.playback.page import event_data
from contactvi.records.codes import GuardKind
from contactvi.records.contacts import ChangeLog, ContactLog
from contactvi.records.events import EventLog
from contactvi.records.pair_colors import pair_color
from contactvi.records.recent import Recent
from contactvi.scene.scene import Scene
from contactvi.status import Status

Array = NDArray[np.float64]

_BRIEF = 1e-3  # of the longest step: shorter parts of steps have no force that means something (ContactLog.has_force)


class Stepped(Protocol):
    """The part of a simulator that is shown; contactvi.Simulator has it."""

    @property
    def scene(self) -> Scene: ...

    @property
    def t(self) -> float: ...

    @property
    def q(self) -> Array: ...

    @property
    def status(self) -> Status | None: ...

    def step(self) -> Status: ...

    def recent(self, since: float) -> Recent: ...


class BodyPoses:
    """Where joint frames are at a configuration. Free bodies are read off it, the others need forward kinematics."""

    def __init__(self, model: pin.Model, joints: Sequence[int]) -> None:
        self._count = len(joints)
        free = [k for k, joint in enumerate(joints) if is_free(model, joint)]
        self._free = np.array(free, dtype=np.int64)
        places = [model.jointPlacements[joints[k]] for k in free]
        self._turn = np.array([place.rotation for place in places]).reshape(-1, 3, 3)
        self._origin = np.array([place.translation for place in places]).reshape(-1, 3)
        self._product = np.array([_product(pin.Quaternion(place.rotation).coeffs()) for place in places])
        self._product = self._product.reshape(-1, 4, 4)
        starts = np.array([model.idx_qs[joints[k]] for k in free], dtype=np.int64)
        self._entries = starts[:, None] + np.arange(7)
        linked = [(k, joint) for k, joint in enumerate(joints) if joint and k not in set(free)]
        self._links = [k for k, _ in linked]
        self._link_places = JointChains(model, [joint for _, joint in linked])

    def at(self, q: Array) -> Array:
        """Return position [m] and quaternion x y z w of every joint at q (nq,), shape (joints, 7)."""
        poses = np.zeros((self._count, 7))
        poses[:, 6] = 1.0
        if len(self._free):
            own = q[self._entries]
            poses[self._free, :3] = np.einsum("nij,nj->ni", self._turn, own[:, :3]) + self._origin
            poses[self._free, 3:] = np.einsum("nij,nj->ni", self._product, own[:, 3:])
        if self._links:
            poses[self._links] = self._link_places.poses(q)
        return poses


def _product(base: Array) -> Array:
    """Return the matrix (4, 4) that multiplies a quaternion x y z w by `base` from the left."""
    x, y, z, w = base
    return np.array([[w, -z, y, x], [z, w, -x, y], [-y, x, w, z], [-x, -y, -z, w]])


@dataclass(frozen=True)
class _Happened:
    """What has happened since a frame, with its scene."""

    scene: Scene
    events: EventLog
    contact_changes: ChangeLog


class FrameWriter:
    """Writes the frames of a simulator, each from what is new since the one before."""

    def __init__(self, sim: Stepped, joints: Sequence[int], forces: bool) -> None:
        self._sim, self._scene, self._forces = sim, sim.scene, forces
        self.poses = BodyPoses(self._scene.model, joints)
        self._places = {joint: k for k, joint in enumerate(joints)}
        self._pairs: dict[int, tuple[float, int, int]] = {}
        self._colors: dict[tuple[str, str], str] = {}  # of pairs, in the order in which they come
        self._longest = 0.0  # [s] step that was seen
        self._known: dict[tuple[int, int], Array] = {}  # point -> the force that it had last
        self.run = 0
        self.t = sim.t
        self._since = sim.t

    def skip(self) -> None:
        """Go on without a frame: nobody sees it."""
        self._look()
        self._since = self.t

    def _look(self) -> bool:
        """Look at the time; return whether the simulator has gone back: to a new start, or to a saved state."""
        t, before = self._sim.t, self.t
        self.t = t
        if t >= before:
            return False
        self.run += 1
        self._since = -np.inf
        self._known = {}
        return True

    def write(self) -> tuple[str, str | None, bool]:
        """Return the frame of now, what has happened since the one before (None: nothing), and whether all is new."""
        restart = self._look()
        recent = self._sim.recent(self._since)
        self._since = self.t
        status = self._sim.status
        frame = {
            "run": self.run,
            "t": self.t,
            "impacts": recent.impacts,
            "pose": packed(self.poses.at(self._sim.q), "f4"),
            "contacts": self._contacts(recent.contacts) if self._forces else None,
            "bad": "" if status is None or status.ok else str(status),
        }
        happened = None
        if recent.happened:
            new = _Happened(self._scene, recent.events, recent.contact_changes)
            for log in (recent.events, recent.contact_changes):
                for index in np.unique(log.array("index")[log.array("kind") == GuardKind.CONTACT]).tolist():
                    self._tone(recent.events.label(int(GuardKind.CONTACT), index))
            happened = json.dumps(event_data(happenings(new), 0.0, self._colors), allow_nan=False)
        return json.dumps(frame, allow_nan=False), happened, restart

    def _contacts(self, log: ContactLog) -> dict[str, Any] | None:
        drawn = (log.array("kind") == GuardKind.CONTACT) & (log.h > 0.0) & np.isfinite(log.position).all(axis=1)
        rows = np.flatnonzero(drawn)
        if not len(rows):
            self._known = {}
            return None
        index, number = log.array("index")[rows], log.array("point")[rows]
        pairs = np.array([self._pair(k) for k in index.tolist()])
        force = pairs[:, :1] * log.force[rows]
        self._longest = max(self._longest, float(log.h.max()))
        points = list(zip(index.tolist(), number.tolist(), strict=True))
        for k in np.flatnonzero(log.h[rows] <= _BRIEF * self._longest).tolist():
            force[k] = self._known.get(points[k], np.zeros(3))
        self._known = dict(zip(points, force, strict=True))
        tones = {k: self._tone(log.label(int(GuardKind.CONTACT), k)) for k in np.unique(index).tolist()}
        numbers = np.column_stack([log.array("mode")[rows], index, number, pairs[:, 1:]])
        return {
            "vectors": packed(np.column_stack([log.position[rows], force]), "f4"),  # point, force
            "numbers": packed(numbers, "i4"),  # mode, pair, number of the point, places of the two bodies
            "colors": tones,  # of the pairs
        }

    def _tone(self, pair: tuple[str, str]) -> str:
        """Return the colour of a pair; a new one gets the next."""
        return self._colors.setdefault(pair, pair_color(len(self._colors)))

    def _pair(self, index: int) -> tuple[float, int, int]:
        """Return for a pair the side on which its force is drawn, and the places of its bodies, -1: not drawn."""
        if index not in self._pairs:
            solids, pairs = self._scene.collision_model.geometryObjects, self._scene.collision_model.collisionPairs
            joints = (solids[pairs[index].first].parentJoint, solids[pairs[index].second].parentJoint)
            first, second = (self._places.get(int(joint), -1) for joint in joints)
            self._pairs[index] = drawn_side(self._scene, index), first, second
        return self._pairs[index]
