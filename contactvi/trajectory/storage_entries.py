"""The entries of the file of a run (contactvi.trajectory.storage says what they are), read and checked kind by kind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import SceneError
from contactvi.options import Options
from contactvi.records import contacts
from contactvi.records import events as event_log
from contactvi.records.work import WORKS, ConstraintRows, Forces
from contactvi.trajectory import polynomials as dense

NEW_EVENTS = ("impulse_vector", "points", "friction", "loss", "energy_change")  # of schema 4


def nodes(
    path: Path, entries: dict[str, NDArray[Any]], sizes: dict[str, int], names: dict[str, str | None]
) -> dict[str, NDArray[Any]]:
    """Return the entries per node: t, and `names` with "q", "v" or None as width."""
    t = entry(path, entries, "t", (None,), float)
    if len(t) == 0 or not np.all(np.isfinite(t)) or np.any(np.diff(t) <= 0):
        refuse(path, "times that do not increase")
    nodes = {"t": t}
    for name, width in names.items():
        shape = (len(t),) if width is None else (len(t), sizes[width])
        nodes[name] = entry(path, entries, name, shape, float)
    if not np.all(np.isfinite(nodes["q"])):
        refuse(path, "configurations that are not finite")
    return nodes


def segments(
    path: Path, entries: dict[str, NDArray[Any]], sizes: dict[str, int], options: Options, schema: int
) -> dense.Segments:
    """Return the polynomials of the steps."""
    count = len(entry(path, entries, "segment/t", (None,), float))
    sizes = sizes | {"sv": options.order // 2 * sizes["v"]}
    arrays = {}
    for name, axes in dense.FIELDS.items():
        if schema < 4 and name == "held":
            continue
        arrays[name] = entry(path, entries, f"segment/{name}", (count, *(sizes[axis] for axis in axes)), float)
        if not np.all(np.isfinite(arrays[name])):
            refuse(path, "segments that are not finite")
    if (
        count == 0
        or np.any(np.diff(arrays["t"]) < -8.0 * np.finfo(float).eps * np.abs(arrays["t"][1:]))
        or np.any(arrays["h"] <= 0)
    ):
        refuse(path, "segments that do not follow each other")
    return dense.Segments(arrays, options.order)


def arcs(path: Path, entries: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return {"t", "dt"} of a run with dt "auto"."""
    count = len(entry(path, entries, "arc/t", (None,), float))
    return {name: entry(path, entries, f"arc/{name}", (count,), float) for name in ("t", "dt")}


def forces(path: Path, entries: dict[str, NDArray[Any]], t: NDArray[np.float64], constraints: list[Any]) -> Forces:
    """Return the work and the reactions of a run with nodes t (N,) [s]; constraints: (name, kind, rows) of columns."""
    rows = [ConstraintRows(str(name), str(kind), int(count)) for name, kind, count in constraints]
    work = entry(path, entries, "force/work", (len(t), len(WORKS)), float)
    reactions = entry(path, entries, "force/reactions", (len(t), sum(row.rows for row in rows)), float)
    return Forces(t, work, reactions, rows)


def frames(
    path: Path, entries: dict[str, NDArray[Any]], sizes: dict[str, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (times (f,) [s], configurations (f, nq)) of the frames for pictures."""
    times = entry(path, entries, "frame/time", (None,), float)
    values = entry(path, entries, "frame/q", (len(times), sizes["q"]), float)
    if not np.all(np.isfinite(times)) or not np.all(np.isfinite(values)):
        refuse(path, "frames that are not finite")
    return times, values


def events(path: Path, entries: dict[str, NDArray[Any]], sizes: dict[str, int], schema: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of the events; what an old schema did not have is left out."""
    count = len(entry(path, entries, "event/time", (None,), float))
    arrays = {}
    for name, (width, kind) in event_log.FIELDS.items():
        if schema < 4 and name in NEW_EVENTS:
            continue
        size = sizes[width] if isinstance(width, str) else width
        shape = (count, size) if width else (count,)
        arrays[name] = entry(path, entries, f"event/{name}", shape, kind)
    return arrays


def check_indices(path: Path, log: event_log.EventLog, pairs: int, joints: int) -> None:
    """Refuse events that name unknown pairs, maps or reasons."""
    for name, known in (("method", len(event_log.METHODS)), ("fallback", len(event_log.FALLBACKS))):
        if not np.all((log.array(name) >= 0) & (log.array(name) < known)):
            refuse(path, f"events of an unknown {name}")
    _check_guards(path, log.array("kind"), log.array("index"), pairs, joints, "events")


def entry(
    path: Path, entries: dict[str, NDArray[Any]], name: str, shape: tuple[int | None, ...], kind: type
) -> NDArray[Any]:
    """Return an entry of this shape (None: any) and type."""
    values = entries.get(name)
    if values is None:
        refuse(path, f"a file without the entry {name!r}")
    fits = values.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(values.shape, shape, strict=True)
    )
    if not fits or values.dtype != np.dtype(kind):
        refuse(path, f"{name!r} of shape {values.shape} and type {values.dtype}, not {shape} {np.dtype(kind)}")
    return values


def refuse(path: Path, got: str, cause: BaseException | None = None) -> NoReturn:
    """Raise SceneError: the file is none that Trajectory.save has written; `got` says why."""
    raise SceneError(
        f"Cannot read the run {path}",
        path=path,
        expected="an npz file written by Trajectory.save",
        got=got,
        remedy="Check the path; a damaged file has to be computed again",
    ) from cause


def contact_logs(
    path: Path, entries: dict[str, NDArray[Any]], names: tuple[list[tuple[str, str]], list[str]]
) -> dict[str, Any]:
    """Return the contacts, their changes and the phases of a run as arguments of contactvi.Trajectory."""
    rows = _rows(path, entries, "contact", "t", contacts.FIELDS)
    changes = _rows(path, entries, "change", "time", contacts.CHANGE_FIELDS)
    for log, choices in ((rows, {"mode": len(contacts.MODES)}), (changes, {"change": len(contacts.CHANGES)})):
        for name, known in choices.items():
            if not np.all((log[name] >= 0) & (log[name] < known)):
                refuse(path, f"contacts of an unknown {name}")
        _check_guards(path, log["kind"], log["index"], len(names[0]), len(names[1]), "contacts")
    phases = None
    if "phase/t" in entries:
        count = len(entry(path, entries, "phase/t", (None,), float))
        phases = {name: entry(path, entries, f"phase/{name}", (count,), float) for name in ("t", "dt", "held")}
    return {
        "contacts": contacts.ContactLog(rows, *names),
        "changes": contacts.ChangeLog(changes, *names),
        "phases": phases,
    }


def _rows(
    path: Path, entries: dict[str, NDArray[Any]], group: str, first: str, fields: Mapping[str, tuple[int, type]]
) -> dict[str, NDArray[Any]]:
    if f"{group}/{first}" not in entries:
        return contacts.joined((), fields)
    count = len(entry(path, entries, f"{group}/{first}", (None,), float))
    return {
        name: entry(path, entries, f"{group}/{name}", (count, width) if width else (count,), kind)
        for name, (width, kind) in fields.items()
    }


def _check_guards(path: Path, kind: NDArray[Any], index: NDArray[Any], pairs: int, joints: int, what: str) -> None:
    bound = np.where(kind == 0, pairs, 2 * joints)
    if not np.all(np.isin(kind, (0, 1)) & (index >= 0) & (index < bound)):
        refuse(path, f"{what} that name unknown pairs")
