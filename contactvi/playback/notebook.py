"""Views in the cells of a notebook: one cell brings the player along, which is large, and the views of others take it.

A view is a document of its own in an iframe. The one that carries the player puts it into the page of the notebook,
that of Jupyter or a static one (`jupyter nbconvert --to html`), where the others find it: they have the same origin. So
a notebook that is stored, opened and trusted shows all views, and holds the player once.

The first cell that shows a view carries it. So does a cell that is run again, because the output that carried the
player may be gone; and so does every view where cells are not known.
"""

from __future__ import annotations

import html
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

from contactvi.playback.page import carrying_page, taking_page


class Execution(NamedTuple):
    """A cell that runs: which one, and for which time."""

    cell: str
    number: str


class Carriers:
    """The cells of a session that carry the player."""

    def __init__(self) -> None:
        self._last: dict[str, str] = {}  # of each cell with views the last execution that has shown one
        self._carriers: set[str] = set()

    def carries(self, now: Execution | None) -> bool:
        """Return whether a view that is shown now carries the player; None: outside of a known cell."""
        if now is None:
            return True
        again = self._last.get(now.cell, now.number) != now.number
        if again or not self._last:
            self._carriers.add(now.cell)
        self._last[now.cell] = now.number
        return now.cell in self._carriers


_SESSION = Carriers()


def inline(data: dict[str, Any]) -> str:
    """Return the HTML of a view in a cell; data as those of `contactvi.playback.page.page_data`."""
    page = carrying_page(data) if _SESSION.carries(execution()) else taking_page(data)
    frame = "width: 100%; height: 480px; border: none"
    return f'<iframe srcdoc="{html.escape(page, quote=True)}" style="{frame}"></iframe>'


def execution() -> Execution | None:
    """Return which cell runs; None outside of notebooks, and where the program that shows them does not tell.

    JupyterLab, Notebook 7 and VS Code name the cell. Programs that run whole notebooks (nbclient, `jupyter nbconvert
    --execute`) do not, but run each cell once; they cannot be asked for input, which tells them from the others.
    """
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    request: Mapping[str, Any] = getattr(shell, "get_parent", dict)()
    parts = [request.get(name) for name in ("header", "metadata", "content")]
    header, metadata, content = (part if isinstance(part, Mapping) else {} for part in parts)
    number, cell = header.get("msg_id"), metadata.get("cellId")
    if not isinstance(number, str):
        return None
    if cell is None and content.get("allow_stdin") is False:
        cell = number
    return Execution(cell, number) if isinstance(cell, str) else None
