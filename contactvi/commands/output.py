"""What `contactvi run` leaves behind: the files of a run, its summary, and how long each part took."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape

from contactvi.commands.console import err, out
from contactvi.tables import name_table, print_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from contactvi.scene.scene import Scene
    from contactvi.trajectory.trajectory import Trajectory


class Phases:
    """The wall times of the parts of a command, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def of(self, name: str) -> Iterator[None]:
        """Add the time of the block to this part."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started

    def __str__(self) -> str:
        return ", ".join(f"{name} {seconds:.2g} s" for name, seconds in self.seconds.items())


RUN, PAGE = "trajectory.npz", "playback.html"
PLOTS = ENERGY, FORCES, REACTIONS = "energy.png", "forces.png", "reactions.png"


def own_folder(folder: Path, scene: Scene) -> bool:
    """Return whether the run in a folder is one of this scene, which may replace what it has left there."""
    if not (folder / RUN).is_file():
        return False
    from contactvi.scene.fingerprint import fingerprint
    from contactvi.trajectory.storage import stored_fingerprint

    return stored_fingerprint(folder / RUN) == fingerprint(scene.to_dict())


def write_files(
    traj: Trajectory, folder: Path, title: str, fps: float | None, plot: bool, phases: Phases
) -> list[Path]:
    """Write the files of a run, the playback where it has a frame rate; return their paths."""
    with phases.of("save"):
        written = [traj.save(folder / RUN, overwrite=True)]
    if fps is not None:
        with phases.of("playback"):
            written.append(traj.to_html(folder / PAGE, fps=fps, title=title, overwrite=True))
    if plot:
        with phases.of("plots"):
            written += draw_plots(traj, folder, "png", overwrite=True)
    return written


def draw_plots(traj: Trajectory, folder: Path, kind: str, overwrite: bool, **style: Any) -> list[Path]:
    """Draw the energy of a run, and contact forces and reactions of constraints if it has some; return the paths.

    Args:
        kind: png or svg.
        style: dpi and transparent of `save_figure`.
    """
    from contactvi.files import check_free
    from contactvi.trajectory.plots import plot, plot_forces, plot_reactions, save_figure

    drawn: dict[Path, Callable[[Trajectory], Figure]] = {(folder / ENERGY).with_suffix(f".{kind}"): plot}
    if np.any(traj.contacts.h > 0.0):
        drawn[(folder / FORCES).with_suffix(f".{kind}")] = plot_forces
    if traj.constraints:
        drawn[(folder / REACTIONS).with_suffix(f".{kind}")] = plot_reactions
    for name in drawn:
        check_free(name, overwrite)
    return [save_figure(figure(traj), name, overwrite=True, **style) for name, figure in drawn.items()]


def run_file(run: Path) -> Path:
    """Return the file of a run that is given as its file or as the folder that `contactvi run` has made."""
    return run / RUN if run.is_dir() else run


def run_title(file: Path) -> str:
    """Return a name for the playback: the file's, or its folder's where the file has the name every run has."""
    parent = file.resolve().parent.name
    return parent if file.stem == "trajectory" and parent else file.stem


def print_summary(traj: Trajectory, written: list[Path], phases: Phases, folder: Path | None = None) -> None:
    """Print what a run did, the files, the times of the parts of the command, and what a user has to be warned of.

    Args:
        folder: of the run, where its plots are not drawn yet.
    """
    from contactvi.commands.summary import summary

    lines = summary(traj)
    for k, path in enumerate(written):
        lines.append(("" if k else "written", f"{path}  ({path.stat().st_size / 1e6:.2g} MB)"))
    if folder is not None:
        lines.append(("plots", f"contactvi plot {shlex.quote(str(folder))}"))
    lines.append(("took", str(phases)))
    print_table(out, name_table(lines))
    if traj.status.ok and traj.options.auto and not traj.error_estimate <= traj.options.tol:
        err.print(
            f"[bold yellow]The accuracy asked for was not reached:[/] error of q about {traj.error_estimate:.2g}, "
            f"tol = {traj.options.tol:.2g}"
        )
    if traj.options.contact_mode == "auto" and len(traj.dense_steps):
        err.print(
            f"[bold yellow]Dense contact:[/] dense steps for {traj.dense_steps.span:.4g} s, in which impacts have "
            f"no times; {traj.dense_steps.worst()}"
        )
    if not traj.status.ok:
        err.print(f"[bold yellow]The run ended early:[/] {escape(str(traj.status))}")
