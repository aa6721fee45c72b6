"""The complete scene: one model with its tested pairs, joint arrays, resolved elements and the engine's scene."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from contactvi.elements.constraints import EqualityConstraint
from contactvi.elements.element import Element
from contactvi.errors import SceneError
from contactvi.importing.given_surfaces import GivenSurface
from contactvi.importing.report import RemovedPair
from contactvi.scene.assembly import Assembly
from contactvi.scene.compliance import compliance_rows
from contactvi.scene.contact_laws import PairLaw, check_friction, check_restitution
from contactvi.scene.contact_rules import ContactRules
from contactvi.scene.element_rows import Resolved, resolve
from contactvi.scene.engine import EngineScene, make_engine_scene
from contactvi.scene.joint_arrays import JointArrays, apply_settings
from contactvi.scene.joints import JointTable
from contactvi.scene.pair_names import PairNames
from contactvi.scene.pairs import NeutralOverlaps, choose_pairs
from contactvi.scene.parts import PartList
from contactvi.scene.selection import Names
from contactvi.scene.surface_motion import SurfaceMotion
from contactvi.scene.surfaces import refuse_untouchable
from contactvi.states import States


@dataclass(frozen=True, eq=False)
class LimitGaps:
    """The joint limits that are guards.

    Attributes:
        names: (joint, "lower limit" or "upper limit").
        at, bound, side: place in q, value [rad, m], +1 for a lower one and -1 for an upper one, shapes (n,).
    """

    names: list[tuple[str, str]]
    at: np.ndarray
    bound: np.ndarray
    side: np.ndarray

    def gaps(self, q: np.ndarray) -> np.ndarray:
        """Return the distances from the limits at q (nq,), shape (n,) [rad, m]."""
        return np.asarray(self.side * (q[self.at] - self.bound))


@dataclass
class Built:
    """A complete scene; it is constant.

    Attributes:
        model, collision: The assembled model as it is simulated, and its geometry with the tested pairs.
        start: Neutral configuration, shape (nq,).
        arrays: Joint settings as arrays.
        pairs: Names of the tested pairs, in the engine's order.
        removed: Pairs that are not tested, with the reasons.
        overlaps: Pairs that overlap at the neutral pose, of which a run tests those that are apart in its start.
        restitution, friction: Of the tested pairs, shapes (npairs,); what depends on the speed, at a closing speed of
            1 m/s and a slip of zero.
        overlap_values: Restitution and friction of the pairs of `overlaps`, shape (2, n).
        laws: Laws of contact of the pairs that have one, each with the places of its pairs.
        surface_motions: Of the geometries whose surfaces move along themselves, by their names.
        elements: Constraints, springs and forces as the engine takes them.
        names: What selectors mean.
        surfaces: Surfaces given by functions, by the names of their geometries.
    """

    model: pin.Model
    collision: pin.GeometryModel
    start: np.ndarray
    arrays: JointArrays
    pairs: PairNames
    removed: list[RemovedPair]
    overlaps: NeutralOverlaps
    restitution: np.ndarray
    friction: np.ndarray
    overlap_values: np.ndarray
    laws: list[tuple[PairLaw, list[int]]]
    surface_motions: dict[str, SurfaceMotion]
    elements: Resolved
    names: Names
    surfaces: dict[str, GivenSurface]

    @cached_property
    def engine(self) -> EngineScene:
        """The engine's scene (contactvi._core.Scene), made on first use; raises SceneError where it refuses."""
        return make_engine_scene(
            self.model, self.collision, self.pairs.numbers, self.restitution, self.friction, self.laws,
            self.surface_motions, self.arrays, self.elements, self.surfaces,
        )  # fmt: skip

    def coefficients(self, kind: str) -> list[tuple[tuple[str, str], float]]:
        """Return the tested pairs whose "restitution" or "friction" is a number, with the numbers."""
        values = self.restitution if kind == "restitution" else self.friction
        varies = {k for law, places in self.laws if law.varies(kind) for k in places}
        rows = enumerate(zip(self.pairs, values, strict=True))
        return [(names, float(value)) for k, (names, value) in rows if k not in varies]

    @cached_property
    def states(self) -> States:
        """Checks of states and forces."""
        return States(self.model)

    @cached_property
    def constrained(self) -> bool:
        """Whether every step solves for constraint forces: there are constraints or joint friction."""
        return bool(self.elements.equations) or bool(np.any(self.arrays.joint_friction))

    @cached_property
    def limits(self) -> LimitGaps:
        """The joint limits in the engine's order."""
        model, found = self.model, []
        for i in map(int, np.flatnonzero(self.arrays.limits)):
            at, name = int(model.idx_qs[i]), str(model.names[i])
            bounds = ((model.lowerPositionLimit[at], 1.0), (model.upperPositionLimit[at], -1.0))
            found += [(name, at, bound, side) for bound, side in bounds if np.isfinite(bound)]
        names = [(name, "lower limit" if side > 0.0 else "upper limit") for name, _, _, side in found]
        places = np.array([at for _, at, _, _ in found], dtype=int)
        bounds_and_sides = np.array([row[2:] for row in found], dtype=float).reshape(-1, 2)
        return LimitGaps(names, places, *bounds_and_sides.T)

    @cached_property
    def carriers(self) -> dict[str, int]:
        """The joint that carries a geometry, by its name; 0 is the world."""
        return {str(geometry.name): int(geometry.parentJoint) for geometry in self.collision.geometryObjects}

    @cached_property
    def pair_numbers(self) -> dict[tuple[str, str], int]:
        """The place of each tested pair in `pairs`."""
        return {pair: k for k, pair in enumerate(self.pairs)}

    @cached_property
    def servo_joints(self) -> list[str]:
        """The joints with a servo, in the order of v."""
        some = np.any(self.arrays.servo[:2] != 0.0, axis=0)
        model = self.model
        return [model.names[i] for i in range(1, model.njoints) if some[model.idx_vs[i] : model.idx_vs[i] + 1].any()]


def build(
    parts: PartList,
    contact: ContactRules,
    joints: JointTable,
    elements: Sequence[Element],
    apart: Collection[tuple[str, str]] = (),
) -> Built:
    """Return the complete scene; the assembly of the parts is left as it is.

    Args:
        apart: pairs, by name, that are tested although they overlap at the neutral pose.
    """
    base = parts.assembly
    model, start = base.model.copy(), base.start.copy()
    equalities = [element for element in elements if isinstance(element, EqualityConstraint)]
    arrays = apply_settings(model, start, joints, contact.restitution.default, equalities)
    collision = pin.GeometryModel(base.collision)
    assembly = Assembly(
        model, collision, start, base.part_of_joint, base.part_of_geometry, base.root_of_joint, base.placed
    )
    if any(part.given_pairs is None for part in parts.parts):
        # Loading the engine sets a choice inside coal for the whole process (settle_box_support in
        # core/geometry/guard.hpp), which has to precede the first distance query. Stored scenes bring their pairs: they
        # need no query, and are replayed without the engine.
        importlib.import_module("contactvi._core")
    index = parts.names.geometries
    disabled, enabled = ([(index[a], index[b]) for a, b in pairs] for pairs in (contact.disabled, contact.enabled))
    tested = {(min(index[a], index[b]), max(index[a], index[b])) for a, b in apart}
    names = list(index)
    soft = contact.compliance.mask(names)
    chosen, removed, overlaps, compliant = choose_pairs(assembly, parts.parts, disabled, enabled, tested, soft)
    surfaces = parts.surfaces
    refuse_untouchable(chosen, compliant, list(collision.geometryObjects), surfaces)
    resolved = resolve(elements, model, start)
    mu = contact.friction.values(names, compliant)
    resolved.compliances = compliance_rows(contact.compliance, names, compliant, mu)
    tested_pairs = PairNames(names, chosen)
    laws = contact.laws.laws(tested_pairs)
    restitution, friction = (np.array(rule.values(names, chosen)) for rule in (contact.restitution, contact.friction))
    for law, places in laws:
        if law.restitution_of_speed is not None:
            restitution[places] = law.restitution_of_speed.at(1.0, "a law of restitution")
        if law.restitution_of_state is not None:
            restitution[places] = law.restitution_of_state.values(np.array([[1.0, 0.0, 0.0]]))[0]
        if law.friction_of_speed is not None:
            friction[places] = law.friction_of_speed.at(0.0, "a law of friction")
        if law.friction_of_state is not None:  # that of what begins to slide under 1 N, larger than zero
            friction[places] = max(1e-9, law.friction_of_state.values(np.array([[0.0, 1.0, 0.0]]))[0])
        check_friction(law, friction[places], tested_pairs[places[0]])
        check_restitution(law, friction[places], tested_pairs[places[0]])
        if law.turning and not friction[places].all():
            a, b = tested_pairs[places[int(np.argmin(friction[places]))]]
            raise SceneError(
                f"The contact of {a!r} and {b!r} has friction against spinning or rolling, but none against slip",
                expected="friction > 0", got="friction 0",
                remedy=f"scene.set_contact({a!r}, {b!r}, friction=...), or spinning_radius=0, rolling_radius=0",
            )  # fmt: skip
    return Built(
        model,
        collision,
        start,
        arrays,
        tested_pairs,
        removed,
        overlaps,
        restitution,
        friction,
        np.array([rule.values(names, overlaps.numbers) for rule in (contact.restitution, contact.friction)]),
        laws,
        {name: motion for name, motion in contact.surface_motions.items() if name in index},
        resolved,
        parts.names,
        surfaces,
    )
