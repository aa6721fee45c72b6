"""What a scene becomes once it is complete: one model with its pairs, joint arrays, elements and engine scene."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from contactvi.elements.elements import Element, EqualityConstraint
from contactvi.errors import SceneError
from contactvi.importing.part import Part
from contactvi.importing.report import RemovedPair
from contactvi.scene.assembly import Assembly
from contactvi.scene.contact_rules import Rule
from contactvi.scene.element_rows import Resolved, install, resolve
from contactvi.scene.joints import JointArrays, JointSettings, apply_settings
from contactvi.scene.pairs import choose_pairs
from contactvi.scene.selection import Names

if TYPE_CHECKING:
    from contactvi import _core


@dataclass
class Edits:
    """What the user said beyond the parts: contact rules, joint settings, pairs off and on (by name), elements.

    Attributes:
        missing: names of elements that a stored scene had and could not keep: functions of the user.
    """

    restitution: Rule
    friction: Rule
    joints: dict[str, JointSettings] = field(default_factory=dict)
    disabled: list[tuple[str, str]] = field(default_factory=list)
    enabled: list[tuple[str, str]] = field(default_factory=list)
    elements: list[Element] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)


@dataclass
class Built:
    """A complete scene. `start`: neutral configuration (nq,); `pairs`: names of the tested pairs, engine order."""

    model: pin.Model
    collision: pin.GeometryModel
    start: np.ndarray
    arrays: JointArrays
    pairs: list[tuple[str, str]]
    removed: list[RemovedPair]
    restitution: np.ndarray
    friction: np.ndarray
    elements: Resolved
    core: _core.Scene | None = None  # made on first use

    @property
    def constrained(self) -> bool:
        """Whether every step has to satisfy something: constraints, dry friction of joints."""
        return bool(self.elements.constraints) or bool(np.any(self.arrays.dry_friction))

    @property
    def needs_fixed_step(self) -> str | None:
        """What of the scene needs steps of one length, in words; None where nothing does."""
        found, arrays = self.elements, self.arrays
        reasons = {
            "constraints": bool(found.constraints),
            "dry friction of joints": bool(np.any(arrays.dry_friction)),
            "servos": bool(np.any(arrays.servo[:2])),
            "wrenches that vary": found.time_varying,
            "forces given in Python": bool(found.forces),
        }
        return next((what for what, is_there in reasons.items() if is_there), None)

    @property
    def servo_joints(self) -> list[str]:
        """The joints with a servo, in the order of v."""
        some = np.any(self.arrays.servo[:2] != 0.0, axis=0)
        model = self.model
        return [model.names[i] for i in range(1, model.njoints) if some[model.idx_vs[i] : model.idx_vs[i] + 1].any()]


def build(base: Assembly, parts: Sequence[Part], names: Names, edits: Edits) -> Built:
    """Return the complete scene; `base` is left as it is."""
    model, start = base.model.copy(), base.start.copy()
    equalities = [element for element in edits.elements if isinstance(element, EqualityConstraint)]
    arrays = apply_settings(model, start, edits.joints, edits.restitution.default, equalities)
    collision = pin.GeometryModel(base.collision)
    assembly = Assembly(
        model, collision, start, base.part_of_joint, base.part_of_geometry, base.root_of_joint, base.placed
    )
    if any(part.given_pairs is None for part in parts):
        # Loaded for its side effect before the first question to coal (settle_box_support in core/geometry/guard.hpp).
        # Stored scenes bring their pairs, ask coal nothing and are replayed without the engine.
        importlib.import_module("contactvi._core")
    index = names.geometries
    disabled = [(index[a], index[b]) for a, b in edits.disabled]
    removed = choose_pairs(assembly, parts, disabled, [(index[a], index[b]) for a, b in edits.enabled])
    geometry_names = list(index)
    pairs = [(geometry_names[p.first], geometry_names[p.second]) for p in collision.collisionPairs]
    return Built(
        model,
        collision,
        start,
        arrays,
        pairs,
        removed,
        edits.restitution.values(pairs),
        edits.friction.values(pairs),
        resolve(edits.elements, model, start),
    )


def engine_scene(built: Built) -> _core.Scene:
    """Return the engine's constant scene (_core.Scene), made once; its faults become SceneErrors."""
    from contactvi import _core

    if built.core is not None:
        return built.core
    try:
        core = _core.Scene(
            to_bytes(built.model),
            to_bytes(built.collision),
            built.restitution,
            built.arrays.stiffness,
            built.arrays.rest,
            np.asarray(built.model.damping),
            built.arrays.limits,
            built.arrays.limit_restitution,
            built.friction,
        )
        install(core, built.model, built.arrays, built.elements)
        built.core = core
    except RuntimeError as error:  # CoreError is one; Pinocchio and coal raise others
        raise SceneError("The engine refuses the scene", got=str(error).strip().splitlines()[-1]) from error
    return built.core


def engine_states(
    core: _core.Scene, segments: Mapping[str, np.ndarray], times: np.ndarray, order: int, exact: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return q (N, nq), v (N, nv) at times [s] from segments of a run (contactvi.trajectory.polynomials).

    Args:
        core: from engine_scene.
        exact: by partial steps, for runs without inputs; else from the polynomials.
    """
    from contactvi import _core

    q, v = _core.dense(core, dict(segments), times, order, exact)
    return np.asarray(q), np.asarray(v)


def engine_points(
    core: _core.Scene, q: np.ndarray, pair: int, margin: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the points at which a pair touches at q: on its first and second shape and their normals, (n, 3) [m].

    World frame. Up to four, chosen to span a face; none where the gap is above `margin` [m]. `core`: from engine_scene.
    """
    from contactvi import _core

    found = _core.contact_points(core, q, pair, margin)
    return tuple(np.asarray(found[name]) for name in ("point_a", "point_b", "normal"))  # type: ignore[return-value]


def to_bytes(item: pin.Model | pin.GeometryModel) -> bytes:
    """Return Pinocchio's own binary archive, the only form in which models cross to C++ (in one process)."""
    buffer = pin.serialization.StreamBuffer()
    item.saveToBinary(buffer)
    return bytes(buffer.tobytes())
