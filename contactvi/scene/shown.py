"""What a notebook shows of a scene."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from contactvi.elements.element import Element
from contactvi.errors import ContactviError
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
