"""What a scene becomes once it is complete: one model with its pairs, joint arrays, report and engine scene."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.assembly import Assembly
from contactvi.contact_rules import Rule
from contactvi.errors import SceneError
from contactvi.joints import JointArrays, JointSettings, apply_settings
from contactvi.pairs import choose_pairs
from contactvi.parts import Part
from contactvi.report import ImportReport, Note, PartReport, RemovedPair, number
from contactvi.selection import Names


@dataclass
class Edits:
    """What the user said beyond the parts: contact rules, joint settings, pairs switched off and on (by name)."""

    restitution: Rule
    friction: Rule
    joints: dict[str, JointSettings] = field(default_factory=dict)
    disabled: list[tuple[str, str]] = field(default_factory=list)
    enabled: list[tuple[str, str]] = field(default_factory=list)


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
    core: Any = None  # _core.Scene, made on first use


def build(base: Assembly, parts: Sequence[Part], names: Names, edits: Edits) -> Built:
    """Return the complete scene; `base` is left as it is."""
    model, start = base.model.copy(), base.start.copy()
    arrays = apply_settings(model, start, edits.joints, edits.restitution.default)
    collision = pin.GeometryModel(base.collision)
    assembly = Assembly(
        model, collision, start, base.part_of_joint, base.part_of_geometry, base.root_of_joint, base.placed
    )
    if any(part.given_pairs is None for part in parts):
        # Loaded for its side effect before the first question to coal: see settle_box_support in core/guard.hpp.
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
    )


def engine_scene(built: Built) -> Any:
    """Return the engine's constant scene (_core.Scene), made once; its faults become SceneErrors."""
    from contactvi import _core

    if built.core is not None:
        return built.core
    try:
        built.core = _core.Scene(
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
    except RuntimeError as error:  # CoreError is one; Pinocchio and coal raise others
        raise SceneError("The engine refuses the scene", got=str(error).strip().splitlines()[-1]) from error
    return built.core


def engine_states(
    core: Any, segments: Mapping[str, np.ndarray], times: np.ndarray, order: int, exact: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return q (N, nq), v (N, nv) at times [s] from segments of a run (contactvi.dense); `core`: from engine_scene.

    exact : by partial steps, for runs without inputs; else from the polynomials.
    """
    from contactvi import _core

    q, v = _core.dense(core, dict(segments), times, order, exact)
    return np.asarray(q), np.asarray(v)


def engine_points(core: Any, q: np.ndarray, pair: int, margin: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def scene_report(parts: Sequence[Part], built: Built, joints: Mapping[str, JointSettings]) -> ImportReport:
    """Return the report: what the parts found, joint settings that replace file data, pairs, rounded shapes."""
    damped = {name for name, settings in joints.items() if settings.damping is not None}
    limited = dict(zip(built.model.names, built.arrays.limits, strict=True))
    found = [_with_limits(part.report.without("suspicious", damped, "damping"), limited) for part in parts]
    report = ImportReport(found, list(built.pairs), list(built.removed))
    for name, settings in joints.items():
        if settings.damping is not None:
            text = f"damping set to {number(float(np.max(settings.damping)))}, whatever the file says"
            report.notes.append(Note("changed", "joint", name, text))
        if settings.limits is not None:
            text = "limits not used" if settings.limits is False else "limits set"
            report.notes.append(Note("changed", "joint", name, text))
        if settings.stiffness:
            text = f"spring of {number(settings.stiffness)} N m/rad or N/m"
            report.notes.append(Note("used", "joint", name, text))
    if built.pairs:
        text = f"restitution {_range(built.restitution)}, Coulomb friction {_range(built.friction)}"
        report.notes.append(Note("used", "pairs", f"{len(built.pairs)}", text))
    try:
        rounding = list(engine_scene(built).rounding)
    except SceneError as error:
        report.notes.append(Note("refused", "scene", "", str(error)))
        rounding = []
    rounded = [float(r) for r in rounding if r > 0.0]
    if rounded:
        text = f"edges rounded with radius {_range(rounded)} m inside the shape, for exact normals"
        report.notes.append(Note("changed", "pairs", f"{len(rounded)} of {len(rounding)}", text))
    return report


def _with_limits(report: PartReport, limited: Mapping[str, bool]) -> PartReport:
    """Return the report with the limits that are simulated: the scene may switch them off, or give others."""
    rows = [replace(row, limited=bool(limited.get(row.name, row.limited))) for row in report.joints]
    return replace(report, joints=rows)


def _range(values: Sequence[float] | np.ndarray) -> str:
    low, high = number(float(min(values))), number(float(max(values)))
    return low if low == high else f"{low} to {high}"
