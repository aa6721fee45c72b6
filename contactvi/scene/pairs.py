"""Pairs of geometries: which are tested for contact and why the others are not.

By default every pair on two different bodies, except
- adjacent bodies (one joint apart); the links of one robot base, fixed to the world, count as one body, while
  halfspaces, fixed primitives and shapes attached to the world itself are scenery and adjacent to nothing;
- two halfspaces;
- the links of one model that was added with self_collision=False, as far as they hang on one base;
- pairs disabled by the part's SRDF or by disable_pair; an MJCF says itself which of its pairs are tested;
- pairs that overlap at the neutral pose, when their relative pose there is the model's own: two bodies of which one
  hangs on a free, planar, translation or prismatic root joint of another tree are placed by the start of a run, where
  an overlap is an error and not a property of the model; but what slides on the base of its own model is joined to it.
  Such pairs are kept apart (`NeutralOverlaps`): a run tests those that do not overlap in its start.
Every removal is recorded with its reason.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from contactvi.importing.joint_kinds import joint_kind
from contactvi.importing.kinematics import JointChains, joint_placements
from contactvi.importing.part import Part
from contactvi.importing.report import (
    ADJACENT,
    BY_FILE,
    BY_USER,
    HALFSPACES,
    NOT_GIVEN,
    OVERLAP,
    SAME_BODY,
    SELF_COLLISION,
    RemovedPair,
)
from contactvi.scene.assembly import Assembly

TOUCHING = 1e-6  # [m] largest overlap at the neutral pose of shapes that merely touch
ENABLED_BY_USER = (ADJACENT, BY_FILE, BY_USER, NOT_GIVEN, SELF_COLLISION)  # reasons that enable_pair overrules


@dataclass(frozen=True, eq=False)
class NeutralOverlaps:
    """The pairs that overlap at the neutral pose, where it is the model's own: a run tests those apart in its start.

    Attributes:
        model, geometry: the assembled model and its shapes. neutral: configuration, shape (nq,).
        numbers: of the geometries, int32 of shape (n, 2), ascending.
        depths: how deep each overlaps at the neutral pose, as text.
        tested: whether the pair is tested in this scene, shape (n,).
        same_part: whether both shapes are of one part, shape (n,).
    """

    model: pin.Model
    geometry: pin.GeometryModel
    neutral: np.ndarray
    numbers: np.ndarray
    depths: list[str]
    tested: np.ndarray
    same_part: np.ndarray
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __len__(self) -> int:
        return len(self.numbers)

    @cached_property
    def names(self) -> list[tuple[str, str]]:
        """The names of the shapes of each pair."""
        objects = self.geometry.geometryObjects
        return [(objects[int(a)].name, objects[int(b)].name) for a, b in self.numbers]

    def apart(self, q: np.ndarray) -> np.ndarray:
        """Return which pairs do not overlap at q (nq,), or merely touch there, shape (n,)."""
        if not len(self) or not np.isfinite(q).all() or np.array_equal(q, self.neutral):
            return np.zeros(len(self), dtype=bool)
        with self._lock:  # The joints' data are written.
            chains, joints, shapes, geometry = self._measured
            places = dict(zip(joints, chains.places(q), strict=True))
            data = geometry.createData()
        for k, shape in enumerate(shapes):
            data.oMg[k] = places[shape.parentJoint] * shape.placement
        return _depths(geometry, data) <= TOUCHING

    @cached_property
    def _measured(self) -> tuple[JointChains, list[int], list[pin.GeometryObject], pin.GeometryModel]:
        """The shapes of the pairs alone, and the joints that carry them."""
        geometry, place = pin.GeometryModel(), {}
        for k in sorted({int(k) for k in self.numbers.ravel()}):
            place[k] = int(geometry.addGeometryObject(self.geometry.geometryObjects[k].copy()))
        for a, b in self.numbers:
            geometry.addCollisionPair(pin.CollisionPair(place[int(a)], place[int(b)]))
        shapes = list(geometry.geometryObjects)
        joints = sorted({int(shape.parentJoint) for shape in shapes})
        return JointChains(self.model, joints), joints, shapes, geometry


class Choice(NamedTuple):
    """Which pairs are tested.

    Attributes:
        pairs: indices of geometries, int32 of shape (npairs, 2), ascending as the pairs of the geometry are.
        removed: the pairs that are not tested, with the reasons.
        overlaps: those that overlap at the neutral pose, tested or not.
        compliant: pairs that would be tested but are compliant, which may overlap, as `pairs`.
    """

    pairs: np.ndarray
    removed: list[RemovedPair]
    overlaps: NeutralOverlaps
    compliant: np.ndarray


def choose_pairs(
    assembly: Assembly,
    parts: Sequence[Part],
    disabled: Iterable[tuple[int, int]] = (),
    enabled: Iterable[tuple[int, int]] = (),
    apart: Collection[tuple[int, int]] = (),
    compliant: np.ndarray | None = None,
) -> Choice:
    """Set the collision pairs of the assembled geometry, and return them.

    Args:
        disabled, enabled: pairs of geometry indices switched off or on by the user, against every other reason.
        apart: pairs that are tested although they overlap at the neutral pose.
        compliant: which pairs are compliant if they may touch, as ComplianceRule.mask returns it.
    """
    geometry = assembly.collision
    names = [g.name for g in geometry.geometryObjects]
    joints = np.array([g.parentJoint for g in geometry.geometryObjects], dtype=int)
    count = len(names)
    keep = np.triu(joints[:, None] != joints[None, :], 1)
    removed: list[RemovedPair] = []
    forced = np.zeros((count, count), dtype=bool)
    for a, b in enabled:
        forced[min(a, b), max(a, b)] = joints[a] != joints[b]

    def drop(mask: np.ndarray, reason: str, details: dict[tuple[int, int], str] | None = None) -> None:
        for i, j in np.argwhere(mask & keep & ~forced):
            detail = (details or {}).get((int(i), int(j)), "")
            removed.append(RemovedPair(names[i], names[j], reason, detail))
            keep[i, j] = False

    by_user = np.zeros((count, count), dtype=bool)
    for a, b in disabled:
        by_user[min(a, b), max(a, b)] = True
    surfaces = {part.prefix + name for part in parts for name in part.surfaces}
    by_function = np.array([name in surfaces for name in names], dtype=bool)
    solid = np.array([not isinstance(g.geometry, coal.Halfspace) for g in geometry.geometryObjects], dtype=bool)
    solid |= by_function
    endless = ~(solid[:, None] | solid[None, :])
    forced &= ~by_user & ~endless
    drop(endless, HALFSPACES)
    drop(by_user, BY_USER)
    drop(_within_quiet_parts(assembly, parts), SELF_COLLISION)
    given = _given(assembly, parts)
    drop(_adjacent(assembly, parts, joints) & ~given, ADJACENT)
    drop(*_disabled_by_file(assembly, parts))
    drop(_not_given(assembly, parts) & ~given, NOT_GIVEN)
    soft = (keep | forced) & (False if compliant is None else compliant)
    rigid = keep & ~forced & ~soft
    known = ~(by_function[:, None] | by_function[None, :])  # coal knows no surfaces that functions give
    details = _overlaps(assembly, parts, rigid & known & ~(given & ~_checked(assembly, parts)))
    stored = _stored_overlaps(assembly, parts)
    details |= {pair: row[0] for pair, row in stored.items() if rigid[pair]}
    mask = np.zeros((count, count), dtype=bool)
    for pair in details:
        mask[pair] = pair not in apart
    drop(mask, OVERLAP, details)
    tested = (keep | forced) & ~soft
    geometry.setCollisionPairs(tested)
    pairs, part = sorted(details), assembly.part_of_geometry
    overlaps = NeutralOverlaps(
        assembly.model, geometry, assembly.start, np.array(pairs, dtype=np.int32).reshape(-1, 2),
        [details[pair] for pair in pairs], np.array([pair in apart for pair in pairs], dtype=bool),
        np.array([stored[a, b][1] if (a, b) in stored else part[a] == part[b] for a, b in pairs], dtype=bool),
    )  # fmt: skip
    chosen, yielding = (np.argwhere(mask).astype(np.int32) for mask in (tested, soft))
    return Choice(chosen, removed, overlaps, yielding)


def untested_reason(
    assembly: Assembly,
    parts: Sequence[Part],
    disabled: Iterable[tuple[int, int]],
    enabled: Iterable[tuple[int, int]],
    pairs: Iterable[tuple[int, int]],
) -> str | None:
    """Return why none of these pairs of geometry indices is tested, whatever the start; None where one may be.

    The reason is that of the first pair. No distance is looked at: a pair that overlaps at the neutral pose may be
    apart in the start of a run.
    """
    objects, part = assembly.collision.geometryObjects, assembly.part_of_geometry
    joints = np.array([g.parentJoint for g in objects], dtype=int)
    off, on = {_ordered(*pair) for pair in disabled}, {_ordered(*pair) for pair in enabled}
    masks: list[tuple[np.ndarray, str]] | None = None
    first: str | None = None
    for pair in pairs:
        i, j = _ordered(*pair)
        reason = _reason_at_once(objects, joints, (i, j), off, on)
        if reason is None and (i, j) not in on and part[i] == part[j]:
            masks = _masks_within_parts(assembly, parts, joints) if masks is None else masks
            reason = next((text for mask, text in masks if mask[i, j]), None)
        if reason is None:
            return None
        first = reason if first is None else first
    return first


def _ordered(a: int, b: int) -> tuple[int, int]:
    return (a, b) if a < b else (b, a)


def _reason_at_once(
    objects: Sequence[pin.GeometryObject],
    joints: np.ndarray,
    pair: tuple[int, int],
    off: Collection[tuple[int, int]],
    on: Collection[tuple[int, int]],
) -> str | None:
    """Return why a pair is not tested, of the reasons that need no look at the whole scene."""
    a, b = pair
    if isinstance(objects[a].geometry, coal.Halfspace) and isinstance(objects[b].geometry, coal.Halfspace):
        return HALFSPACES
    if joints[a] == joints[b]:
        return SAME_BODY
    return BY_USER if pair in off and pair not in on else None


def _masks_within_parts(assembly: Assembly, parts: Sequence[Part], joints: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Return the reasons that concern pairs within one part, with their masks."""
    given = _given(assembly, parts)
    return [
        (_within_quiet_parts(assembly, parts), SELF_COLLISION),
        (_adjacent(assembly, parts, joints) & ~given, ADJACENT),
        (_disabled_by_file(assembly, parts)[0], BY_FILE),
        (_not_given(assembly, parts) & ~given, NOT_GIVEN),
    ]


def _same_part(assembly: Assembly) -> np.ndarray:
    part = assembly.part_of_geometry
    return np.asarray(part[:, None] == part[None, :])


def _adjacent(assembly: Assembly, parts: Sequence[Part], joints: np.ndarray) -> np.ndarray:
    """Return the mask (ngeoms, ngeoms) of pairs of one part whose bodies are one joint apart."""
    parents = np.array(list(assembly.model.parents), dtype=int)
    above = parents[joints]
    base = (joints == 0) & ~_scenery(assembly, parts)
    # The start places such a body; it is not joined to the base, and a floor of the base must support it.
    child = ~((above == 0) & assembly.placed[joints] & ~_slides(assembly)[joints])
    real = (above[:, None] == joints[None, :]) & child[:, None] & (base | (joints != 0))[None, :]
    real &= (joints != 0)[:, None]
    return np.asarray((real | real.T) & _same_part(assembly))


def within_models(assembly: Assembly) -> Callable[[str, str], bool]:
    """Return whether two geometries, by name, are of one model and hang on one floating root, or on its fixed base."""
    names = [geometry.name for geometry in assembly.collision.geometryObjects]
    bases = dict(zip(names, _bases(assembly), strict=True))
    return lambda a, b: bases[a] == bases[b]


def _bases(assembly: Assembly) -> list[tuple[int, int]]:
    """Return what each geometry hangs on: its part, and its floating root or 0 for the part's fixed base."""
    model, found = assembly.model, []
    for geometry, part in zip(assembly.collision.geometryObjects, assembly.part_of_geometry, strict=True):
        root = int(assembly.root_of_joint[geometry.parentJoint])
        floats = root > 0 and joint_kind(model.joints[root]) in ("free", "planar", "translation")
        found.append((int(part), root if floats else 0))
    return found


def _within_quiet_parts(assembly: Assembly, parts: Sequence[Part]) -> np.ndarray:
    """Return the mask of pairs of links of one robot, of the parts without self-collision."""
    quiet = np.array([not part.self_collision for part in parts], dtype=bool)
    if not quiet.any():
        return np.zeros((len(assembly.part_of_geometry),) * 2, dtype=bool)
    bases = np.array(_bases(assembly), dtype=int).reshape(-1, 2)
    link = quiet[assembly.part_of_geometry] & ~_scenery(assembly, parts)
    return np.asarray(np.all(bases[:, None] == bases[None, :], axis=2) & link[:, None] & link[None, :])


def _slides(assembly: Assembly) -> np.ndarray:
    """Return the mask (njoints,) of prismatic joints.

    What slides on the base of its own model is joined to it, as a torso that is lifted out of a column; the start
    places it beside all else.
    """
    return np.array([joint_kind(joint) == "prismatic" for joint in assembly.model.joints], dtype=bool)


def _scenery(assembly: Assembly, parts: Sequence[Part]) -> np.ndarray:
    """Return the mask of geometries that are fixed to the world and belong to no robot base."""
    result = []
    for index, geometry in zip(assembly.part_of_geometry, assembly.collision.geometryObjects, strict=True):
        in_world = geometry.parentFrame == 0
        result.append(parts[index].kind == "primitive" or in_world or isinstance(geometry.geometry, coal.Halfspace))
    return np.array(result, dtype=bool)


def _given(assembly: Assembly, parts: Sequence[Part]) -> np.ndarray:
    """Return the mask of pairs given with a model."""
    count = len(assembly.part_of_geometry)
    mask = np.zeros((count, count), dtype=bool)
    for index, part in enumerate(parts):
        own = np.flatnonzero(assembly.part_of_geometry == index)
        for a, b in (*(part.given_pairs or ()), *part.neutral_overlaps):
            i, j = sorted((int(own[a]), int(own[b])))
            mask[i, j] = True
    return mask


def _stored_overlaps(assembly: Assembly, parts: Sequence[Part]) -> dict[tuple[int, int], tuple[str, bool]]:
    """Return the pairs that overlap at the neutral pose of stored scenes: depth, and whether of one part."""
    found = {}
    for index, part in enumerate(parts):
        own = np.flatnonzero(assembly.part_of_geometry == index)
        for (a, b), row in part.neutral_overlaps.items():
            found[_ordered(int(own[a]), int(own[b]))] = row
    return found


def _checked(assembly: Assembly, parts: Sequence[Part]) -> np.ndarray:
    """Return the mask of inner pairs of the parts whose given pairs may overlap in the model's own pose."""
    checked = np.array([part.checks_overlaps for part in parts], dtype=bool)
    if not checked.any():
        return np.zeros((len(assembly.part_of_geometry),) * 2, dtype=bool)
    return np.asarray(_same_part(assembly) & checked[assembly.part_of_geometry][:, None])


def _not_given(assembly: Assembly, parts: Sequence[Part]) -> np.ndarray:
    """Return the mask of inner pairs of the parts that came with their own choice."""
    closed = np.array([p.given_pairs is not None for p in parts], dtype=bool)
    if not closed.any():
        return np.zeros((len(assembly.part_of_geometry),) * 2, dtype=bool)
    return np.asarray(_same_part(assembly) & closed[assembly.part_of_geometry][:, None])


def _disabled_by_file(assembly: Assembly, parts: Sequence[Part]) -> tuple[np.ndarray, str, dict[tuple[int, int], str]]:
    count = len(assembly.part_of_geometry)
    mask = np.zeros((count, count), dtype=bool)
    details: dict[tuple[int, int], str] = {}
    for index, part in enumerate(parts):
        if not part.disabled:
            continue
        of_link: dict[str, list[int]] = {}
        for k in np.flatnonzero(assembly.part_of_geometry == index):
            frame = assembly.collision.geometryObjects[int(k)].parentFrame
            of_link.setdefault(assembly.model.frames[frame].name, []).append(int(k))
        for first, second, reason in part.disabled:
            for a in of_link.get(part.prefix + first, ()):
                for b in of_link.get(part.prefix + second, ()):
                    pair = (min(a, b), max(a, b))
                    mask[pair] = True
                    details[pair] = reason
    return mask, BY_FILE, details


def _overlaps(assembly: Assembly, parts: Sequence[Part], candidates: np.ndarray) -> dict[tuple[int, int], str]:
    """Return the candidate pairs that overlap at the neutral pose, with their depth as text."""
    geometry = assembly.collision
    joints = np.array([g.parentJoint for g in geometry.geometryObjects], dtype=int)
    root, placed = assembly.root_of_joint[joints], assembly.placed[joints]
    own_pose = (root[:, None] == root[None, :]) | ~(placed[:, None] | placed[None, :])
    base, on_slide = (joints == 0) & ~_scenery(assembly, parts), _slides(assembly)[root]
    lifted = base[:, None] & on_slide[None, :]
    own_pose |= _same_part(assembly) & (lifted | lifted.T)
    places = _geometry_placements(assembly)
    geometry.setCollisionPairs(candidates & own_pose & _near(assembly, places))
    if not len(geometry.collisionPairs):
        return {}
    shapes = geometry.createData()
    for k, place in enumerate(places):
        shapes.oMg[k] = place
    found = {}
    for pair, depth in zip(geometry.collisionPairs, _depths(geometry, shapes), strict=True):
        if depth > TOUCHING:
            found[int(pair.first), int(pair.second)] = f"{1e3 * depth:.3g} mm deep"
    return found


def _depths(geometry: pin.GeometryModel, shapes: pin.GeometryData) -> np.ndarray:
    """Return how deep the collision pairs overlap [m], 0 where they do not, with shapes that are placed."""
    for request in shapes.collisionRequests:
        request.enable_contact = True  # The depth stays zero otherwise.
    pin.computeCollisions(geometry, shapes, False)
    return np.array(
        [-r.getContact(0).penetration_depth if r.isCollision() else 0.0 for r in shapes.collisionResults], dtype=float
    )


def _geometry_placements(assembly: Assembly) -> list[pin.SE3]:
    """Return where the geometries are at the neutral pose."""
    joints = joint_placements(assembly.model, assembly.start)
    return [joints[geometry.parentJoint] * geometry.placement for geometry in assembly.collision.geometryObjects]


def _near(assembly: Assembly, places: Sequence[pin.SE3]) -> np.ndarray:
    """Return the mask of pairs whose boxes along the world's axes overlap: only such shapes can.

    Coal keeps a request and a result for each pair, a thousand times the memory of an entry of this mask.
    """
    low, high = np.zeros((2, len(places), 3))
    for k, (geometry, place) in enumerate(zip(assembly.collision.geometryObjects, places, strict=True)):
        shape = geometry.geometry
        if isinstance(shape, coal.Halfspace):
            low[k], high[k] = -np.inf, np.inf
            continue
        if not isinstance(shape, coal.Convex):  # Hulls have their boxes, which take a look at all vertices.
            shape = shape.clone()  # It may be the user's.
            shape.computeLocalAABB()
        box = shape.aabb_local
        center, half = 0.5 * (box.max_ + box.min_), 0.5 * (box.max_ - box.min_)
        center, half = place.act(center), np.abs(place.rotation) @ half
        low[k], high[k] = center - half, center + half
    near = np.ones((len(places),) * 2, dtype=bool)
    for k in range(3):
        near &= (low[:, None, k] <= high[None, :, k]) & (low[None, :, k] <= high[:, None, k])
    return near
