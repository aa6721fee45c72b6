"""`contactvi export`: the tables of a stored run as CSV files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from contactvi.commands.console import Force
from contactvi.commands.output import run_file
from contactvi.commands.pictures import RunFile
from contactvi.tables import name_table, print_table

_out = Console(highlight=False, soft_wrap=True)


def export(
    run: RunFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Folder for the tables, by default the run's name without .npz."
        ),
    ] = None,
    table: Annotated[
        list[str] | None,
        typer.Option("--table", metavar="NAME", help="Only this table; repeatable. By default all that have rows."),
    ] = None,
    sample_dt: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Write the table forces, too: means over windows of this length."),
    ] = None,
    force: Force = False,
) -> None:
    """Write tables of a run as CSV, and their units as units.csv.

    Tables are states, poses, energies, efforts, events, contacts, changes and dense_steps, with --sample-dt or --table
    forces.
    """
    import contactvi as cvi

    file = run_file(run)
    traj = cvi.Trajectory.load(file)
    written = traj.to_csv(
        output if output is not None else file.with_suffix(""), table or None, sample_dt, overwrite=force
    )
    rows = [("" if k else "written", f"{path}  ({path.stat().st_size / 1e6:.2g} MB)") for k, path in enumerate(written)]
    print_table(_out, name_table(rows))
