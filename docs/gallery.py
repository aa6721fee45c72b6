"""Sphinx extension: the pictures of the gallery are drawn when the pages are built, from runs of models and examples.

    ```{shown} models/newtons_cradle.toml
    :at: 0.35
    What the caption says.
    ```

The directive runs a scene file, or an example, whose run is the variable `run` (by default `traj`) when it has ended;
it draws the run at a time [s], with a camera as of `Trajectory.render` in JSON, and writes the page that plays it, to
which the picture is a link. Without a browser the picture is the plot of the energies; the picture of an example that
takes too long here, or needs more than the pages do, is a stored file (`stored`, a path in docs/). The caption says so.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import runpy
import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

import contactvi as cvi
from contactvi.playback.browser import find_browser

ROOT = Path(__file__).resolve().parents[1]
SIZE = 640, 400  # [pixels]
MADE = "gallery_pictures"  # folder of docs/ and of the pages: what is drawn, which is not stored
PLOTTED = "The pages were built without a browser: this is the plot of its energies."
log = logging.getLogger(__name__)


def run_of(source: str, variable: str) -> cvi.Trajectory:
    """Return the run of a scene file or of an example, a path in the repository; what it prints is not shown."""
    path = ROOT / source
    if path.suffix == ".toml":
        return cvi.simulate(cvi.load_scene(path))
    arguments, folder = sys.argv, os.getcwd()
    try:
        sys.argv = [str(path)]
        os.chdir(path.parent)
        with contextlib.redirect_stdout(io.StringIO()):
            return runpy.run_path(str(path), run_name="__main__")[variable]
    finally:
        sys.argv = arguments
        os.chdir(folder)


def draw(traj: cvi.Trajectory, path: Path, at: float, camera: Any) -> bool:
    """Draw a run at a time [s]; return whether there is a browser, without which its energies are plotted."""
    try:
        find_browser()
    except cvi.ContactviError:
        figure = cvi.plot(traj)
        figure.savefig(path, dpi=80)
        plt.close(figure)
        return False
    traj.render(path, size=SIZE, at=at, camera=camera, overwrite=True)
    return True


class Shown(SphinxDirective):
    """A picture of a run with a caption, and where the run comes from."""

    required_arguments = 1
    has_content = True
    option_spec = {
        "at": float,
        "camera": json.loads,
        "run": directives.unchanged,
        "stored": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        """Called by Sphinx."""
        source = self.arguments[0]
        self.env.note_dependency(str(ROOT / source))
        image, page, note = self._stored() if "stored" in self.options else self._drawn(source)
        picture: nodes.Element = nodes.image(uri=image, alt=f"A picture of {source}")
        if page:
            picture = nodes.reference("", "", picture, refuri=page)
        words, messages = self.parse_inline(" ".join([*self.content, f"`{source}`.", note]).strip(), lineno=self.lineno)
        return [nodes.figure("", picture, nodes.caption("", "", *words)), *messages]

    def _stored(self) -> tuple[str, str, str]:
        return self.options["stored"], "", "A stored picture: the pages do not run it."

    def _drawn(self, source: str) -> tuple[str, str, str]:
        name = Path(source).stem
        here, pages = Path(self.env.srcdir) / MADE, Path(self.env.app.outdir) / MADE
        for folder in (here, pages):
            folder.mkdir(parents=True, exist_ok=True)
        traj = run_of(source, self.options.get("run", "traj"))
        drawn = draw(traj, here / f"{name}.png", self.options.get("at", float(traj.t[0])), self.options.get("camera"))
        traj.to_html(pages / f"{name}.html", title=name.replace("_", " "), overwrite=True)
        log.info("%s: %s", source, "drawn" if drawn else "plotted, for want of a browser")
        return f"{MADE}/{name}.png", f"{MADE}/{name}.html", "" if drawn else PLOTTED


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.add_directive("shown", Shown)
    return {"parallel_read_safe": False}
