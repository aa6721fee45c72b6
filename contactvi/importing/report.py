"""The import report: what of a model is used, changed, ignored or refused, and which of its data look wrong.

Importers fill it, `scene.report` adds the collision pairs and settings of the scene, `contactvi check` prints it.
"""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Container, Iterator
from dataclasses import dataclass, field, replace
from typing import Literal

from contactvi.html import folded, html_table, preformatted
from contactvi.inputs import check_choice

_SHOWN, _LINES = 10, 150  # findings and lines of text that a notebook shows
Use = Literal["used", "changed", "ignored", "refused", "suspicious"]
USES: tuple[Use, ...] = ("refused", "suspicious", "changed", "ignored", "used")
HEADINGS: dict[str, str] = {
    "refused": "Refused (this model cannot be simulated as it is)",
    "suspicious": "Suspicious data",
    "changed": "Changed on import",
    "ignored": "Ignored",
    "used": "Used",
}


@dataclass(frozen=True)
class Note:
    """One finding about `name`: what became of it (`use`), and its kind (`topic`: body, joint, geometry, file, ...)."""

    use: Use
    topic: str
    name: str
    text: str


@dataclass(frozen=True)
class BodyRow:
    """A link of the model: the moving joint that carries it ("universe" = fixed to the world), mass [kg]."""

    name: str
    joint: str
    mass: float


@dataclass(frozen=True)
class JointRow:
    """A joint: limits [rad or m] (nan = none), damping and friction of the file [N m s, N m or N s/m, N]."""

    name: str
    type: str
    parent: str
    lower: float
    upper: float
    damping: float
    friction: float
    limited: bool
    mimic: str = ""


@dataclass(frozen=True)
class GeometryRow:
    """A collision geometry: its body, its shape with sizes [m], and how it was changed."""

    name: str
    body: str
    shape: str
    note: str = ""


@dataclass(frozen=True)
class RemovedPair:
    """A collision pair that is not tested, and why."""

    first: str
    second: str
    reason: str
    detail: str = ""


@dataclass
class PartReport:
    """Everything found in one added model or primitive."""

    title: str
    bodies: list[BodyRow] = field(default_factory=list)
    joints: list[JointRow] = field(default_factory=list)
    geometries: list[GeometryRow] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._noted = set(self.notes)

    def note(self, use: Use, topic: str, name: str, text: str) -> None:
        """Add a finding once."""
        found = Note(use, topic, name, text)
        if found not in self._noted:
            self._noted.add(found)
            self.notes.append(found)

    def prefix_names(self, prefix: str) -> None:
        """Put a prefix before the names in the findings so far, for which readers use the names of the file."""
        topics = ("joint", "body", "geom", "visual", "equality", "actuator", "tendon", "keyframe")
        self.notes = [replace(n, name=prefix + n.name) if n.topic in topics else n for n in self.notes]
        self._noted = set(self.notes)

    def without(self, use: Use, names: Container[str], start: str) -> PartReport:
        """Return a copy without the findings about `names` whose text begins with `start`, which no longer hold."""
        kept = [n for n in self.notes if not (n.use == use and n.name in names and n.text.startswith(start))]
        return replace(self, notes=kept)


@dataclass
class ImportReport:
    """The report of a whole scene. `str(report)` is the readable text."""

    parts: list[PartReport] = field(default_factory=list)
    pairs: list[tuple[str, str]] = field(default_factory=list)
    removed: list[RemovedPair] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)

    def all_notes(self, use: Use | None = None, topic: str | None = None) -> Iterator[Note]:
        """Return the findings of all parts and of the scene, filtered by use and topic. InputError: another use."""
        if use is not None:
            check_choice("use", use, USES, "What a finding says")
        notes = [note for part in self.parts for note in part.notes] + self.notes
        return (n for n in notes if use in (None, n.use) and topic in (None, n.topic))

    @property
    def ignored(self) -> list[Note]:
        return list(self.all_notes("ignored"))

    @property
    def refused(self) -> list[Note]:
        return list(self.all_notes("refused"))

    @property
    def suspicious(self) -> list[Note]:
        return list(self.all_notes("suspicious"))

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        """Return what a notebook shows: what is refused or suspicious, and the text when it is unfolded."""
        counts = Counter(note.use for note in self.all_notes())
        title = "Import report: " + ", ".join(f"{counts[use]} {use}" for use in USES if use != "used")
        rows = [(note.use, note.topic, note.name, note.text) for note in [*self.refused, *self.suspicious]]
        more = f"and {len(rows) - _SHOWN} more" if len(rows) > _SHOWN else ""
        found = html_table(title, ("", "", "name", "finding"), rows[:_SHOWN], more)
        lines = self.text(6).splitlines()
        if len(lines) > _LINES:
            lines = [*lines[:_LINES], f"... and {len(lines) - _LINES} more lines: print(report)"]
        return found + folded("report", preformatted("\n".join(lines)))

    def text(self, most: int = 12) -> str:
        """Return the report as text; of each list of findings of one kind at most `most` are spelled out."""
        lines: list[str] = []
        for part in self.parts:
            lines += _part_text(part, most)
        lines += _pairs_text(self, most)
        lines += _notes_text(self.notes, most)
        counts = Counter(note.use for note in self.all_notes())
        lines.append("Findings: " + ", ".join(f"{counts[use]} {use}" for use in USES if use != "used"))
        return "\n".join(lines)


def number(value: float) -> str:
    """Return a short number, `-` where there is none."""
    if math.isnan(value):
        return "-"
    return f"{value:.4g}"


def table(head: list[str], rows: list[list[str]], indent: str = "  ") -> list[str]:
    """Return aligned columns as lines."""
    widths = [max(len(row[k]) for row in [head, *rows]) for k in range(len(head))]
    lines = []
    for row in [head, *rows]:
        lines.append((indent + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))).rstrip())
    return lines


def _part_text(part: PartReport, most: int) -> list[str]:
    lines = [part.title]
    if part.bodies:
        mass = sum(body.mass for body in part.bodies)
        lines.append(f" Bodies ({len(part.bodies)}, {number(mass)} kg)")
        rows = [[b.name, b.joint, number(b.mass)] for b in part.bodies]
        lines += table(["body", "moves with joint", "mass [kg]"], rows)
    if part.joints:
        lines.append(f" Joints ({len(part.joints)})")
        head = ["joint", "type", "parent", "lower", "upper", "limits", "damping", "friction", "mimic"]
        rows = [_joint_cells(joint) for joint in part.joints]
        if not any(joint.mimic for joint in part.joints):
            head, rows = head[:-1], [row[:-1] for row in rows]
        lines += table(head, rows)
    if part.geometries:
        lines.append(f" Collision geometries ({len(part.geometries)})")
        rows = [[g.name, g.body, g.shape, g.note] for g in part.geometries]
        lines += table(["geometry", "body", "shape [m]", ""], rows)
    lines += _notes_text(part.notes, most)
    return [*lines, ""]


def _joint_cells(joint: JointRow) -> list[str]:
    return [
        joint.name,
        joint.type,
        joint.parent,
        number(joint.lower),
        number(joint.upper),
        "used" if joint.limited else "none",
        number(joint.damping),
        number(joint.friction),
        joint.mimic,
    ]


def _notes_text(notes: list[Note], most: int) -> list[str]:
    lines: list[str] = []
    for use in USES:
        chosen = [note for note in notes if note.use == use]
        if not chosen:
            continue
        lines.append(f" {HEADINGS[use]} ({len(chosen)})")
        groups: dict[tuple[str, str], list[str]] = {}
        for note in chosen:
            groups.setdefault((note.topic, note.text), []).append(note.name)
        shown = list(groups.items())[: 4 * most]
        for (topic, text), names in shown:
            if len(names) == 1:
                lines.append(f"  {topic} {names[0]}: {text}" if names[0] else f"  {topic}: {text}")
                continue
            lines.append(f"  {text}")
            listed = f"{topic} {_some(names, most)}"
            lines += textwrap.wrap(listed, 110, initial_indent=6 * " ", subsequent_indent=8 * " ")
        if len(groups) > len(shown):
            lines.append(f"  ... and {len(groups) - len(shown)} more")
    return lines


def _some(names: list[str], most: int) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _pairs_text(report: ImportReport, most: int) -> list[str]:
    if not report.pairs and not report.removed:
        return ["Collision pairs: none"]
    lines = [f"Collision pairs: {len(report.pairs)} tested, {len(report.removed)} not"]
    reasons: dict[str, list[RemovedPair]] = {}
    for pair in report.removed:
        reasons.setdefault(pair.reason, []).append(pair)
    for reason, pairs in reasons.items():
        lines.append(f" {reason} ({len(pairs)})")
        # Adjacent pairs are many, and removed by a rule: a few examples are enough. The others are single decisions.
        shown = pairs[: 3 if reason == ADJACENT else most]
        for pair in shown:
            detail = f"  ({pair.detail})" if pair.detail else ""
            lines.append(f"  {pair.first} - {pair.second}{detail}")
        if len(pairs) > len(shown):
            lines.append(f"  ... and {len(pairs) - len(shown)} more")
    return lines


ADJACENT = "adjacent bodies (joined by one joint)"
OVERLAP = "overlapping at the neutral pose: tested in runs that start where they are apart"
SAME_BODY = "fixed to each other"
BY_FILE = "disabled by the model's files"
BY_USER = "disabled by disable_pair"
HALFSPACES = "two halfspaces, which always overlap"
SELF_COLLISION = "added with self_collision=False"
NOT_GIVEN = "not among the given collision pairs"
