"""What the user gives about contacts: numbers, laws, compliance, and pairs switched off or on."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field

from contactvi.importing.part import Part
from contactvi.scene.body_adhesion import BodyAdhesion
from contactvi.scene.compliance import ComplianceRule
from contactvi.scene.contact_laws import LawRules
from contactvi.scene.pair_rules import Rule
from contactvi.scene.surface_motion import SurfaceMotion

RESTITUTION = 0.5  # default: neither plastic nor elastic
FRICTION = 0.0


@dataclass
class ContactRules:
    """What the user gives about contacts: numbers, compliance, laws, and pairs switched off or on by name.

    Attributes:
        surface_motions: Of the geometries whose surfaces move along themselves, by their names.
    """

    restitution: Rule = field(default_factory=lambda: Rule(RESTITUTION))
    friction: Rule = field(default_factory=lambda: Rule(FRICTION))
    compliance: ComplianceRule = field(default_factory=ComplianceRule)
    disabled: list[tuple[str, str]] = field(default_factory=list)
    enabled: list[tuple[str, str]] = field(default_factory=list)
    laws: LawRules = field(default_factory=LawRules)
    surface_motions: dict[str, SurfaceMotion] = field(default_factory=dict)

    def add_part(self, part: Part) -> None:
        """Take over what a model's file says of contacts; what is set for geometries and pairs counts more."""
        for names, (friction, restitution) in part.data.contact.items():
            scene_names = [part.prefix + name for name in names]
            self.friction.set_from_file(scene_names, friction)
            if restitution is not None:
                self.restitution.set_from_file(scene_names, restitution)
        for names, pull in part.data.adhesion.items():
            self.laws.rule("adhesion").set_from_file([part.prefix + name for name in names], pull)
        for name, (linear, angular) in part.data.surface_velocities.items():
            motion = SurfaceMotion.checked(linear, angular, None)
            self.surface_motions.setdefault(part.prefix + name, motion)
        for names, radii in part.data.turning.items():
            for setting, radius in zip(("spinning_radius", "rolling_radius"), radii, strict=True):
                self.laws.rule(setting).set_from_file([part.prefix + name for name in names], radius)

    def set_body_adhesion(self, shapes: frozenset[str], adhesion: BodyAdhesion | None) -> None:
        """Let the body of these geometries pull at all that it touches, in place of how it did so far; None: not."""
        self.laws.bodies = [(names, other) for names, other in self.laws.bodies if names != shapes]
        if adhesion is not None:
            self.laws.bodies.append((shapes, adhesion))

    def disable(self, first: Sequence[str], second: Sequence[str]) -> None:
        """Switch off all pairs of one of `first` and one of `second`."""
        self._switch(first, second, self.disabled)

    def enable(self, first: Sequence[str], second: Sequence[str]) -> None:
        """Switch on all pairs of one of `first` and one of `second`."""
        self._switch(first, second, self.enabled)

    def _switch(self, first: Sequence[str], second: Sequence[str], chosen: list[tuple[str, str]]) -> None:
        new = [(a, b) for a in first for b in second if a != b]
        for listed in (self.disabled, self.enabled):  # A pair follows the last call that named it.
            listed[:] = [pair for pair in listed if pair not in new and pair[::-1] not in new]
        chosen += new

    def copy(self) -> ContactRules:
        """Return rules that are edited apart from these."""
        return copy.deepcopy(self)
