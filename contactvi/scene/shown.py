"""What a scene shows of itself: as a line, as a text, in a notebook, and where an attribute is set that it has not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn, Protocol

import numpy as np

from contactvi.elements.element import Element
from contactvi.errors import ContactviError, InputError, did_you_mean
from contactvi.html import folded, html_fields, html_table, shown_rows
from contactvi.scene.build import Built
from contactvi.scene.selection import PartHandle

_MOST = 12  # parts, elements of a list


class Shown(Protocol):
    """What is shown; contactvi.Scene has it."""

    settings: dict[str, Any]

    @property
    def parts(self) -> list[PartHandle]: ...
    @property
    def elements(self) -> list[Element]: ...
    @property
    def gravity(self) -> np.ndarray: ...
    @property
    def missing(self) -> list[str]: ...
    @property
    def nq(self) -> int: ...
    @property
    def nv(self) -> int: ...
    def built(self) -> Built: ...


def scene_line(scene: Shown, pairs: Sequence[tuple[str, str]] | None) -> str:
    """Return a scene in one line; pairs: that are tested, None where the scene is not built yet."""
    bodies = sum(len(part.bodies) for part in scene.parts)
    tested = "" if pairs is None else f", {counted(len(pairs), 'pair')}"
    return (
        f"<Scene: nq {scene.nq}, nv {scene.nv}, {counted(bodies, 'body', 'bodies')}{tested},"
        f" {counted(len(scene.parts), 'part')}, {counted(len(scene.elements), 'element')}>"
    )


def scene_text(scene: Shown) -> str:
    """Return what a scene consists of, line by line, and why it cannot be run if it cannot."""
    try:
        pairs, problem = scene.built().pairs, []
    except ContactviError as error:
        pairs, problem = None, [f"cannot be run: {error}"]
    lines = [scene_line(scene, pairs)]
    for part in scene.parts[:_MOST]:
        counts = ((part.bodies, "body", "bodies"), (part.joints, "joint", ""), (part.geometries, "shape", ""))
        lines.append(f"  {part.name}: " + ", ".join(counted(len(names), one, many) for names, one, many in counts))
    if len(scene.parts) > _MOST:
        lines.append(f"  and {len(scene.parts) - _MOST} more")
    if scene.elements:
        shown = ", ".join(f"{element.name} ({element.kind})" for element in scene.elements[:_MOST])
        lines.append(f"  elements: {shown}" + (", ..." if len(scene.elements) > _MOST else ""))
    return "\n".join([*lines, *problem])


def counted(number: int, one: str, many: str = "") -> str:
    """Return a number with its word."""
    return f"{number} {one if number == 1 else many or one + 's'}"


# What is set on scenes of other programs -> how it is set here.
_ELSEWHERE = {
    "restitution": "scene.set_contact(restitution=...)",
    "friction": "scene.set_contact(friction=...)",
    "mu": "scene.set_contact(friction=...)",
    "gravity": "Scene(gravity=(0, 0, -9.81)), when the scene is made",
    "dt": 'scene.settings["dt"] = ..., or dt=... of the run',
    "timestep": 'scene.settings["dt"] = ..., or dt=... of the run',
    "duration": 'scene.settings["duration"] = ..., or duration=... of the run',
    "q": "scene.q0 = ...",
    "v": "scene.v0 = ...",
}


def refuse_attribute(name: str, kind: type, settable: Sequence[str]) -> NoReturn:
    """Raise InputError for an attribute that cannot be set, with what may have been meant."""
    known = [attribute for attribute in settable if attribute != "compiled"]
    there = hasattr(kind, name)
    remedy = f"Write {_ELSEWHERE[name]}" if name in _ELSEWHERE else did_you_mean(name, known)
    if there and name not in _ELSEWHERE:
        remedy = "Call it" if callable(getattr(kind, name)) else "It follows from what was added to the scene"
    raise InputError(
        f"The attribute {name!r} of a scene cannot be set" if there else f"A scene has no attribute {name!r}",
        name=name, expected="one of " + ", ".join(known), got=name, remedy=remedy,
    )  # fmt: skip


def scene_html(scene: Shown) -> str:
    """Return parts, sizes and joints of a scene, and why it cannot be run if it cannot."""
    parts = scene.parts
    fields: dict[str, object] = {"gravity": "({:.6g}, {:.6g}, {:.6g}) m/s²".format(*scene.gravity)}
    folds = [folded(f"parts ({len(parts)})", html_table("", ("part", "bodies", "joints", "shapes"), [
        None if k is None else (parts[k].name, *map(_listed, (parts[k].bodies, parts[k].joints, parts[k].geometries)))
        for k in shown_rows(len(parts), _MOST)
    ]))]  # fmt: skip
    if scene.elements:
        elements = scene.elements
        rows = [None if k is None else (elements[k].name, elements[k].kind) for k in shown_rows(len(elements), _MOST)]
        folds.append(folded(f"elements ({len(elements)})", html_table("", ("element", "kind"), rows)))
    try:
        built = scene.built()
        fields |= {"coordinates": f"nq {scene.nq}, nv {scene.nv}", "collision pairs": len(built.pairs)}
        if scene.missing:
            fields["cannot be run without"] = ", ".join(scene.missing)
    except ContactviError as error:
        fields["cannot be run"] = str(error)
    if scene.settings:
        fields["settings of the file"] = ", ".join(f"{name} = {value}" for name, value in scene.settings.items())
    return html_fields(f"Scene of {len(parts)} part{'s' * (len(parts) != 1)}", fields, folds)


def _listed(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + more
