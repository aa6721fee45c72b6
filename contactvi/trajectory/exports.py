"""A run as what other packages take: pandas, xarray, CSV files."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from contactvi.errors import InputError, missing_package
from contactvi.files import checked_path, write_atomic
from contactvi.records.table import Table
from contactvi.scene.coordinates import coordinates
from contactvi.trajectory.poses import body_poses, moving_bodies
from contactvi.trajectory.tables import QUATERNION, TABLES, Run, table

if TYPE_CHECKING:
    import xarray

_ROWS_OF = {"events": "event", "contacts": "contact", "changes": "change", "dense_steps": "dense_step"}


def write_csv(traj: Run, folder: str | os.PathLike[str], tables: Sequence[str] | None = None) -> list[Path]:
    """Write tables of a run as NAME.csv, by default those with rows, and their units as units.csv; return the paths.

    Raises:
        InputError: unknown table, or a folder that cannot be made.
    """
    folder = made_folder(folder)
    wanted = [table(traj, name) for name in (TABLES if tables is None else tables)]
    wanted = [found for found in wanted if len(found) or tables is not None]
    written = [write_atomic(folder / f"{found.name}.csv", found.write_csv) for found in wanted]
    return [*written, write_atomic(folder / "units.csv", lambda file: _write_units(file, wanted))]


def made_folder(folder: str | os.PathLike[str]) -> Path:
    """Return a folder, which is made if there is none; raise InputError where that cannot be."""
    path = checked_path(folder, "folder")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"Cannot make the folder {path}", name="folder", expected="a folder that can be written",
            got=error.strerror or str(error), remedy="Choose another folder",
        ) from error  # fmt: skip
    return path


def _write_units(file: IO[bytes], tables: Sequence[Table]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("table", "column", "unit"))
    for found in tables:
        writer.writerows((found.name, column, found.units.get(column, "")) for column in found.columns)
    file.write(text.getvalue().encode())


def to_xarray(traj: Run) -> xarray.Dataset:
    """Return a run as one xarray.Dataset; see Trajectory.to_xarray."""
    try:
        import xarray
    except ImportError as error:
        raise missing_package("xarray", "xarray") from error
    model = traj.scene.model
    named, bodies = coordinates(model), moving_bodies(model)
    position, quaternion = body_poses(model, traj.q, bodies)
    nodes = {name: (("t", *dims), values, {"units": unit}) for name, dims, values, unit in (
        ("q", ("coordinate",), traj.q, "see q_unit"), ("v", ("dof",), traj.v, "see v_unit"),
        ("position", ("body", "axis"), position, "m"), ("quaternion", ("body", "component"), quaternion, "1"),
    )}  # fmt: skip
    energies = table(traj, "energies")
    variables: dict[str, Any] = nodes | {
        name: ("t", energies.column(name), {"units": "J"}) for name in list(energies.columns)[1:]
    }
    for name, row in _ROWS_OF.items():
        found = table(traj, name)
        if len(found):
            variables |= {f"{row}_{column}": _variable(found, column, row) for column in found.columns}
    coords: dict[str, Any] = {
        "t": ("t", traj.t, {"units": "s"}), "coordinate": _labels(named.q), "dof": _labels(named.v),
        "body": _labels(bodies), "axis": ["x", "y", "z"], "component": list(QUATERNION),
        "q_unit": ("coordinate", _labels(named.q.values())), "v_unit": ("dof", _labels(named.v.values())),
    }  # fmt: skip
    return xarray.Dataset(variables, coords)


def _variable(found: Table, column: str, row: str) -> tuple[str, Any, dict[str, str]]:
    values = found.column(column)
    values = values.astype(str) if values.dtype == object else values
    return row, values, {"units": found.units[column]} if column in found.units else {}


def _labels(names: Any) -> Any:
    return np.array(list(names), dtype=str)
