"""Parts with a free base, put so that they touch a halfspace."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.importing.joint_kinds import joint_kind
from contactvi.scene.build import Built
from contactvi.scene.selection import Names, Selector

Array = NDArray[np.float64]

_ROUNDS = 3  # The gap is linear in the displacement: the first round places the part, the others remove rounding.


def place_on_ground(
    built: Built, roots: NDArray[np.int64], names: Names, part: Selector | None, q: Array, ground: Selector | None
) -> Array:
    """Return q (nq,) with the tree that carries `part` moved along the normal of a halfspace, so that it touches it.

    Args:
        roots: first joint on the way from the world to each joint, shape (njoints,).
        part: a part, joint or body; None: the only tree that is free.
        ground: the halfspace, by name or handle; None: the only one that the part has pairs with.

    Raises:
        InputError: the part has no free base, or several; there is no such halfspace, or several.
    """
    root = _free_root(built, roots, names, part)
    carried = {name for name, joint in built.carriers.items() if roots[joint] == root}
    meets = _halfspaces(built, carried)
    if ground is not None:
        index = names.select_geometries(ground, "ground")
        chosen = {list(names.geometries)[k] for k in index}
        meets = {name: pairs for name, pairs in meets.items() if name in chosen}
    if len(meets) != 1:
        fact, remedy = "meets several halfspaces", "Name one: ground=..."
        if not meets:
            fact = "has no ground to stand on"
            remedy = "Add one: scene.add_halfspace(), or put its pairs back: scene.enable_pair(part, ground)"
        what = "What is free" if part is None else repr(_called(part))
        raise InputError(
            f"{what} {fact}", name="ground", got=", ".join(map(repr, meets)) or "none",
            expected="one halfspace, fixed to the world, that the part has pairs with", remedy=remedy,
        )  # fmt: skip
    ((name, pairs),) = meets.items()
    joint = built.model.joints[root]
    axes = built.model.jointPlacements[root].rotation  # those of the base's position in q
    up = axes.T @ _normal(built, name)
    q = q.copy()
    for _ in range(_ROUNDS):
        gaps = np.asarray(built.engine.gaps(q)[0])
        soft, depths = np.asarray(built.engine.compliant_gaps(q)).T
        gap = min([*gaps[[k for k in pairs if k < len(gaps)]], *depths[np.isin(soft + len(gaps), pairs)]])
        q[joint.idx_q : joint.idx_q + 3] -= gap * up
    return q


def _free_root(built: Built, roots: NDArray[np.int64], names: Names, part: Selector | None) -> int:
    """Return the root joint of a part; raise InputError where it is not one that moves freely."""
    model = built.model
    joints = range(1, model.njoints) if part is None else _joints(built, names, part)
    found = sorted({int(roots[joint]) for joint in joints if joint})
    free = [root for root in found if joint_kind(model.joints[root]) in ("free", "translation")]
    found = free if part is None else found
    if len(found) == 1 and free:
        return found[0]
    raise InputError(
        "The part that is to be placed is not given" if part is None else
        f"{_called(part)!r} cannot be placed on the ground", name="part", expected="a part with one free base",
        got="none" if not free else f"bases {', '.join(repr(model.names[root]) for root in found)}",
        remedy="Add it with base='free' (a primitive with free=True), or name one joint or body of what is to be moved",
    )  # fmt: skip


def _joints(built: Built, names: Names, part: Selector) -> list[int]:
    """Return the joints of a part, which may have none, of a pattern or of a body: that which carries it."""
    model = built.model
    if len(getattr(part, "joints", (part,))) == 0 or (part in names.parts and not names.parts[str(part)].joints):
        return []
    if isinstance(part, str) and part in names.bodies and part not in names.parts and part not in names.by_joint:
        return [int(model.frames[model.getFrameId(part, pin.FrameType.BODY)].parentJoint)]
    return [int(model.getJointId(name)) for name in names.select_joints(part, "part")]


def _halfspaces(built: Built, carried: set[str]) -> dict[str, list[int]]:
    """Return the pairs of these geometries with each halfspace that is fixed to the world: tested, then compliant."""
    shapes = {g.name: g.geometry for g in built.collision.geometryObjects}
    found: dict[str, list[int]] = {}
    for k, (a, b) in enumerate((*built.pairs, *(row.names for row in built.elements.compliances))):
        for own, other in ((a, b), (b, a)):
            if (
                own in carried
                and isinstance(shapes[other], coal.Halfspace)
                and built.carriers[other] == 0
                and other not in built.surfaces
            ):
                found.setdefault(other, []).append(k)
    return found


def _normal(built: Built, halfspace: str) -> Array:
    """Return the normal of a halfspace that is fixed to the world, (3,)."""
    geometry = built.collision.geometryObjects[built.collision.getGeometryId(halfspace)]
    return np.asarray(geometry.placement.rotation @ geometry.geometry.n)


def _called(part: Selector) -> str:
    return str(getattr(part, "name", part))
