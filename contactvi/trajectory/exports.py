"""A run as what other packages take: pandas, xarray, CSV files."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError, missing_package
from contactvi.files import check_free, checked_path, write_atomic
from contactvi.inputs import listed
from contactvi.records.table import Table
from contactvi.scene.coordinates import coordinates
from contactvi.trajectory import tables
from contactvi.trajectory.efforts import Efforts, effort_of
from contactvi.trajectory.polynomials import State
from contactvi.trajectory.poses import Poses, body_poses, moving_bodies
from contactvi.trajectory.tables import QUATERNION, TABLES, Run, table

if TYPE_CHECKING:
    import pandas
    import xarray

_ROWS_OF = {"events": "event", "contacts": "contact", "changes": "change", "dense_steps": "dense_step"}


class _Run(Run, Protocol):
    """What the exports need; contactvi.Trajectory has it."""

    def at(self, t: ArrayLike) -> State: ...
    def efforts(self) -> Efforts: ...


class Exports:
    """The part of contactvi.Trajectory that gives it to other packages."""

    def poses(self: _Run, body: Any, t: ArrayLike | None = None) -> Poses:
        """Return where a body is at the nodes: t (n,) [s], position (n, 3) [m], quaternion (n, 4), x y z w (`Poses`).

        Position and quaternion are those of the frame of the body, in the world; every body that moves is in
        `to_pandas("poses")` and in `to_xarray`.

        Args:
            body: name of a body, or the handle of a part with one body.
            t: times instead of the nodes [s], (n,) or one; the states there are those of `at`, with its errors.

        Raises:
            InputError: unknown body.
        """
        name = self.scene.names.select_body(body)
        state = self if t is None else self.at(t)
        position, quaternion = body_poses(self.scene.model, np.atleast_2d(state.q), [name])
        return Poses(np.atleast_1d(state.t), position[:, 0], quaternion[:, 0])

    def effort(self: _Run, joint: Any) -> NDArray[np.float64]:
        """Return what a servo and an input do at a joint, within the limits of effort and speed, (N,) [N m or N].

        At each node it is the effort with which the step that begins there starts; at the last one that of the last
        references and inputs. Springs, damping and friction of the joint are not in it. All joints that are driven, and
        have one degree of freedom, are in `to_pandas("efforts")`.

        Args:
            joint: name of a joint, or a handle of a part with one.

        Raises:
            InputError: unknown joint, one that nothing drives, or a run whose inputs were not kept: of a simulator
                whose single steps had inputs and no servos, of `step_together`, or with record=n.
        """
        return effort_of(self.efforts(), self.scene, joint)

    def table(self: _Run, name: str = "states", sample_dt: float | None = None) -> Table:
        """Return a table of the run, one of contactvi.trajectory.tables: named columns with units, without pandas.

        Args:
            sample_dt: length of the windows of the table "forces" [s], by default the times between the nodes.

        Raises:
            InputError: for an unknown name, and for sample_dt with another table.
        """
        return tables.table(self, name, sample_dt)

    def to_pandas(self: _Run, table: str = "states", sample_dt: float | None = None) -> pandas.DataFrame:
        """Return a table of the run as a DataFrame, needs `pip install "contactvi[pandas]"`.

        Args:
            table: "states", "poses", "energies", "efforts", with the time as index; "events", "contacts", "forces",
                "changes" or "dense_steps", with the time as column t (contactvi.trajectory.tables). `attrs["units"]`
                has the units.
            sample_dt: as of `table`.

        Raises:
            InputError: unknown table, or sample_dt with another one than "forces". ContactviError: pandas is not
                installed.
        """
        return tables.table(self, table, sample_dt).to_pandas("t" if table in tables.OF_NODES else None)

    def to_xarray(self: _Run) -> xarray.Dataset:
        """Return the run as an xarray.Dataset, needs `pip install "contactvi[xarray]"`.

        Variables over the time t: q (t, coordinate), v (t, dof), position (t, body, axis) [m] and quaternion (t, body,
        component) of every moving body, and the columns of the table "energies". Those of the tables "events",
        "contacts", "changes" and "dense_steps" are event_NAME (event), contact_NAME (contact), ..., where the run has
        some. `attrs["units"]` of each has its unit; q_unit and v_unit are those of the coordinates and dofs.

        Raises:
            ContactviError: xarray is not installed.
        """
        return to_xarray(self)

    def to_csv(
        self: _Run,
        folder: str | os.PathLike[str],
        names: Sequence[str] | None = None,
        sample_dt: float | None = None,
        *,
        overwrite: bool = False,
    ) -> list[Path]:
        """Write tables of the run as folder/NAME.csv, and their units as folder/units.csv; return the paths.

        Args:
            folder: is made where there is none.
            names: of the tables (contactvi.trajectory.tables), by default all that have rows, "forces" with sample_dt
                alone: it has columns for every pair, and "efforts" where joints are driven.
            sample_dt: length of the windows of "forces" [s], by default the times between the nodes.
            overwrite: whether tables that are there are replaced.

        Raises:
            OverwriteError: one of the files is there, without `overwrite`; none is written then.
            InputError: unknown table, or a folder or file that cannot be written.
        """
        return write_csv(self, folder, names, sample_dt, overwrite)


def write_csv(
    traj: Run,
    folder: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    sample_dt: float | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write tables of a run as NAME.csv, and their units as units.csv; return the paths. See Trajectory.to_csv.

    Raises:
        InputError: unknown table, or a folder that cannot be made. OverwriteError: as there.
    """
    usual = [name for name in TABLES if name != "forces" or sample_dt is not None]
    if not traj.drives:
        usual.remove("efforts")
    chosen = usual if names is None else listed("names", names, "names of tables")
    wanted = [table(traj, name, sample_dt if name == "forces" else None) for name in chosen]
    wanted = [found for found in wanted if len(found) or names is not None]
    folder = made_folder(folder)
    for name in (*(found.name for found in wanted), "units"):
        check_free(folder / f"{name}.csv", overwrite)
    written = [write_atomic(folder / f"{found.name}.csv", found.write_csv, overwrite) for found in wanted]
    return [*written, write_atomic(folder / "units.csv", lambda file: _write_units(file, wanted), overwrite)]


def made_folder(folder: str | os.PathLike[str]) -> Path:
    """Return a folder, which is made if there is none; raise InputError where that cannot be."""
    path = checked_path(folder, "folder")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"Cannot make the folder {path}", name="folder", expected="a folder that can be written",
            got="a file of this name" if path.is_file() else error.strerror or str(error),
            remedy="Choose another folder",
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
