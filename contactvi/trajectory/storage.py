"""The file of a run: one npz (a zip of npy arrays), schema 9. Nothing in it is pickled, nothing is executed on loading.

N nodes, n events, c contacts, m segments, s stages (order / 2), nq and nv sizes of configuration and velocity; SI
units; every entry is float64 unless int64 is given.

===================== ============== ===========================================================================
entry                 shape          meaning
===================== ============== ===========================================================================
header                ()             JSON text, see below
t                     (N,)           times [s], increasing
q                     (N, nq)        configurations, Pinocchio's numbers (quaternions x y z w)
p                     (N, nv)        momenta M(q) v
v                     (N, nv)        Pinocchio's tangent velocities (body twist for a free body) [m/s, rad/s]
kinetic_energy        (N,)           T [J]
potential_energy      (N,)           V [J], of gravity, springs and potentials
modified_energy       (N,)           modified Hamiltonian of the midpoint rule, from order 4 on H [J]
discrete_energy       (N,)           of the step that starts at the node [J], NaN without one; only in runs with DTEC
effort                (N, nv)        of servos and inputs [N, N m]; only in runs where they are known and not zero
gap/time              (M,)           times at which gaps were measured [s], M <= 2000
gap/value             (M, K)         signed distance [m] of the K pairs header["gap_pairs"], those that touched
event/time            (n,)           [s]
event/step            (n,) int64     index of the step
event/kind            (n,) int64     0 contact, 1 joint limit
event/index           (n,) int64     pair index (header["pair_names"]), or 2 * joint + {0 lower, 1 upper}
event/point           (n, 3)         contact point [m], world frame; zero for limits
event/normal          (n, 3)         unit normal from the first shape to the second, world frame; zero for limits
event/impulse         (n,)           [N s], or [N m s] for the limit of a revolute joint
event/gamma_minus     (n,)           normal speed before [m/s or rad/s]
event/gamma_plus      (n,)           normal speed after
event/G_c             (n,)           inverse inertia W M^-1 W^T [1/kg or 1/(kg m^2)]
event/gap             (n,)           signed distance at the located configuration [m or rad]
event/restitution     (n,)           coefficient used
event/method          (n,) int64     impact map: 0 CTEC, 1 DTEC, 2 MHC
event/iterations      (n,) int64     evaluations of the map's scalar equation; 0 for CTEC
event/fallback        (n,) int64     why the impulse is CTEC's: 0 it is not, else records.codes.Fallback
event/jump            (n,)           what is left of the map's own scalar equation [J]
event/before          (n,)           length of the partial step that ends at the impact [s]
event/after           (n,)           length of the rest of the step after it [s]
event/q               (n, nq)        configuration at the impact
event/p_minus         (n, nv)        momentum before
event/p_plus          (n, nv)        momentum after
event/impulse_vector  (n, 3)         on the second shape, friction included [N s], world axes; zero for limits
event/points          (n,) int64     points of the pair that took part
event/friction        (n,)           Coulomb coefficient used
event/loss            (n,)           what the law of the impact takes from the kinetic energy [J]
event/energy_change   (n,)           H after less H before [J]
contact/t             (c,)           start of a step, or time of an impact [s]; only in runs with contacts
contact/h             (c,)           length of the step [s], 0 for an impact
contact/step          (c,) int64     index of the step
contact/kind          (c,) int64     as event/kind
contact/index         (c,) int64     as event/index
contact/point         (c,) int64     number of the point within the pair
contact/feature       (c,) int64     the engine's number of what touches there (core/geometry/contact_features.hpp)
contact/mode          (c,) int64     0 stick, 1 slip, 2 frictionless, 3 impact
contact/dense         (c,) int64     1 for a row of a dense step
contact/position      (c, 3)         contact point at the end of the step [m], world frame
contact/normal        (c, 3)         unit normal there, from the first shape to the second
contact/start         (c, 3)         position impulse of the step on the second shape [N s], of an impact all of it
contact/end           (c, 3)         velocity impulse of the step [N s]; of limits the first component counts
contact/gap           (c,)           signed distance at the end [m or rad]
contact/slip          (c, 3)         tangential velocity of the second shape against the first at the end [m/s]
contact/work          (c,)           what friction did in the step [J]; 0 in impacts and dense steps
change/time           (d,)           when a contact changed [s]; changes only in runs that have some
change/kind           (d,) int64     as event/kind
change/index          (d,) int64     as event/index
change/point          (d,) int64     number of the point within the pair
change/change         (d,) int64     what became of it, contactvi.records.codes.Change
change/value          (d,)           see contactvi.records.contacts.ContactChange
phase/t               (r,)           from these times on [s]; phases only in runs with contacts
phase/dt              (r,)           the steps have these lengths [s]
phase/held            (r,)           and are free (0), with persistent contacts (1) or dense (2)
dense/t               (u,)           start of a dense step [s]; only in runs with some
dense/h               (u,)           its length [s]
dense/step            (u,) int64     index of the step
dense/island          (u,) int64     first joint of the island that it belongs to
dense/residual        (u,)           of Coulomb's law, over the largest free speed of a contact
dense/gap             (u,)           least gap at its end [m or rad]
dense/energy_rise     (u,)           rise of the energy beyond energy_error [J]
dense/energy_loss     (u,)           what contacts took [J]
dense/energy_error    (u,)           how much the energy may rise [J]
dense/contacts        (u,) int64     contact points that carried an impulse
dense/repaired        (u,) int64     contact problems whose answer was repaired
segment/t             (m,)           start of a solved step or partial step [s]; segments only in runs that kept them
segment/h             (m,)           its length [s]
segment/q             (m, nq)        configuration at its start
segment/p             (m, nv)        momentum at its start, this and the next two in the engine's coordinates
segment/p1            (m, nv)        momentum at its end, before an impact there
segment/rates         (m, s nv)      chart rates at the Gauss stages (core/step/path.hpp)
segment/held          (m,)           1: a contact step or a dense one, of order 2; 2: a smooth step that holds contacts
segmentK/trees        (b,) int64     instead of segment/..., K = 0, 1, ...: static trees that are advanced together
segmentK/t ...                       the other entries of segment/..., for these alone, with their sizes
arc/t                 (k,)           with dt "auto" only: from these times on [s]
arc/dt                (k,)           the steps have these lengths [s]
frame/time            (f,)           times of frames for pictures between nodes far apart [s], f may be 0
frame/q               (f, nq)        configurations there
force/work            (N, 4)         work since the start [J]: input, damping, joint friction, prescribed motions
force/reactions       (N, r)         mean forces of header["constraints"] since the node before [N; N m]
input/saturated       () int64       steps whose actuators or ropes have no derivatives; with record="gradient" only
input/control         (k, nv)        generalized forces of the steps, if there were some [N, N m]
input/target          (k, 2 nv)      references of the servos, positions and then velocities, if there were some
input/contact_steps   (i,)           steps with persistent contacts (core/sensitivity/contact_step_numbers.hpp)
input/impact_blocks   (j,)           impacts of several points, in the same file
input/dense_steps     (d,)           dense steps, in the same file
input/held_steps      (e,)           smooth steps with constraints, in the same file
input/contact_laws    (k,)           what laws of contact need of the contact steps, and
input/held_laws       (l,)           of the smooth steps; in the same file
array/0, array/1 ...  any            arrays (meshes) that the header refers to
===================== ============== ===========================================================================

The header is an object with the keys

- format: "contactvi-trajectory"; schema: 9; version: of the contactvi that wrote it
- options: the settings (contactvi.Options); status: {code, message, time}; stats: the counts (Stats.to_dict)
- method: impact map of the run; pair_names: [[shape, shape], ...]; joint_names: [...]; gap_pairs: like pair_names
- undriven: whether it is known that nothing drives a joint; then there is no entry effort. Older files lack it
- forced: whether the run had inputs; error_estimate: measured error of q with dt "auto" [m, rad], else NaN
- constraints: [[name, kind, rows], ...] of the columns of force/reactions, in runs with force/work
- scene: Scene.to_dict(); visuals: what the viewer draws, a list of contactvi.playback.visuals.Visual fields

in which {"$array": k} stands for the entry array/k, and NaN, Infinity, -Infinity are written as such.

Meshes are stored as they are drawn: thinned out to what a viewer turns, float32 and uint32, equal ones once. So a run
is shown where the files of its model are not, and reading it parses none. Nothing is compressed, which would take
longer than all else of saving; what takes its time is reading the files of the pictures, if they are not in the cache
(contactvi/cache.py) and the run has not been shown before.

The numbers in event/kind, event/method, event/fallback, contact/mode and change/change are those of
contactvi.records.codes.
"""

from __future__ import annotations

import json
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import ContactviError, SceneError
from contactvi.files import UNREADABLE, as_a_path, check_free, checked_path, told, write_atomic
from contactvi.inputs import short
from contactvi.options import Options
from contactvi.playback.visuals import Visual
from contactvi.records.contacts import ChangeLog, ContactLog
from contactvi.records.dense_steps import DenseSteps
from contactvi.records.events import EventLog
from contactvi.records.inputs import RunInputs
from contactvi.records.work import Forces
from contactvi.scene.fingerprint import fingerprint
from contactvi.scene.scene import Scene
from contactvi.status import Stats, Status, StatusCode
from contactvi.trajectory.entry_reader import PHASES, Entries, EntryReader, of_a_run, refuse, stored_name
from contactvi.trajectory.polynomials import Segments, SegmentsApart
from contactvi.version import version

FORMAT = "contactvi-trajectory"
SCHEMA = 9
_NODES: dict[str, str | None] = {
    "t": None,
    "q": "q",
    "p": "v",
    "v": "v",
    "kinetic_energy": None,
    "potential_energy": None,
    "modified_energy": None,
}


class Run(Protocol):
    """What is stored of a run: contactvi.Trajectory has it (besides the entries per node of the table above)."""

    options: Options
    events: EventLog
    status: Status
    stats: Stats
    forced: bool
    segments: Segments | SegmentsApart | None
    adaptive_steps: dict[str, NDArray[np.float64]] | None
    phases: dict[str, NDArray[np.float64]] | None
    contacts: ContactLog
    contact_changes: ChangeLog
    dense_steps: DenseSteps
    error_estimate: float
    forces: Forces | None
    inputs: RunInputs | None

    def all_forces(self) -> Forces: ...
    @property
    def scene(self) -> Scene: ...

    @property
    def frames(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]: ...

    @property
    def gaps(self) -> tuple[NDArray[np.float64], list[tuple[str, str]], NDArray[np.float64]]: ...

    @property
    def visuals(self) -> list[Visual]: ...

    @property
    def drives(self) -> bool: ...
    @property
    def efforts_known(self) -> bool: ...
    def all_efforts(self) -> NDArray[np.float64]: ...


def save(traj: Run, path: str | os.PathLike[str], overwrite: bool = False) -> Path:
    """Write `traj` to `path` atomically; return the path. v, energies and gaps are computed if they were not.

    Raises:
        OverwriteError: there is such a file, without `overwrite`.
    """
    check_free(path, overwrite)
    arrays: list[NDArray[Any]] = []
    gap_time, gap_pairs, gap_value = traj.gaps
    scene = traj.scene.to_dict()
    header = {
        "format": FORMAT,
        "schema": SCHEMA,
        "fingerprint": fingerprint(scene),
        "version": version(),
        "options": traj.options.to_dict(),
        "status": {"code": int(traj.status.code), "message": traj.status.message, "time": traj.status.time},
        "stats": traj.stats.to_dict(),
        "method": traj.events.method,
        "forced": traj.forced,
        "error_estimate": traj.error_estimate,
        "pair_names": traj.scene.pair_names,
        "joint_names": list(traj.scene.model.names),
        "gap_pairs": gap_pairs,
        "constraints": [] if traj.forces is None else [list(row) for row in traj.all_forces().constraints],
        "undriven": traj.efforts_known and not traj.drives,
        "scene": scene,
        "visuals": [visual.to_dict() for visual in traj.visuals],
    }
    text = json.dumps(_pack(header, arrays, {}))
    entries: dict[str, Any] = {name: getattr(traj, name) for name in _stored_nodes(traj.options)}
    if traj.drives:
        entries["effort"] = traj.all_efforts()
    entries |= {"gap/time": gap_time, "gap/value": gap_value, "frame/time": traj.frames[0], "frame/q": traj.frames[1]}
    if traj.segments is not None:
        entries |= _segment_entries(traj.segments)
    entries |= {f"arc/{name}": values for name, values in (traj.adaptive_steps or {}).items()}
    entries |= {f"event/{name}": values for name, values in traj.events.arrays.items()}
    if traj.phases is not None:
        entries |= {stored_name("phase", name): traj.phases[name] for name in PHASES}
    logs = ("contact", traj.contacts), ("change", traj.contact_changes), ("dense", traj.dense_steps)
    for group, log in logs:
        entries |= {f"{group}/{name}": values for name, values in log.arrays.items() if len(log)}
    if traj.forces is not None:
        entries |= {"force/work": traj.forces.values, "force/reactions": traj.all_forces().reactions}
    if traj.inputs is not None:
        entries |= {f"input/{name}": values for name, values in traj.inputs.stored().items()}
    entries |= {f"array/{k}": values for k, values in enumerate(arrays)}
    return write_atomic(path, lambda file: np.savez(file, header=np.array(text), **entries), overwrite)


def _segment_entries(segments: Segments | SegmentsApart) -> dict[str, NDArray[Any]]:
    if isinstance(segments, Segments):
        return {stored_name("segment", name): values for name, values in segments.arrays.items()}
    entries: dict[str, NDArray[Any]] = {}
    for k, (trees, part) in enumerate(segments.parts):
        entries[f"segment{k}/trees"] = np.array(trees, dtype=np.int64)
        entries |= {stored_name(f"segment{k}", name): values for name, values in part.arrays.items()}
    return entries


_UNPACKED, _MOST_PACKED = 1e9, 100.0  # [bytes] that any file may unpack to; times its own size


def load(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a run: the arguments of contactvi.Trajectory. Needs neither the engine nor the files of the scene.

    Raises:
        ContactviError: for a file that is missing, damaged, of another format or schema, or inconsistent.
    """
    path = checked_path(path)
    with as_a_path(path):
        if not path.is_file():
            refuse(path, "there is no such file", remedy="Correct the path, or write the file first: traj.save(path)")
        _check_size(path)
    try:
        file = np.load(path, allow_pickle=False)
        if isinstance(file, np.ndarray):
            refuse(path, "one array, not an npz")
        with file:
            entries = {name: file[name] for name in file.files}
    except (*UNREADABLE, pickle.UnpicklingError) as error:
        refuse(path, told(error), error)
    header = _read_header(path, entries)
    try:
        return _build(path, entries, _unpack(header, entries))
    except ContactviError as error:
        if isinstance(error, SceneError) and error.path is not None:
            raise
        refuse(path, str(error).rstrip("."), error)
    except Exception as error:  # whatever a wrong header makes the scene or the options stumble over
        refuse(path, f"{type(error).__name__}: {error}", error)


def stored_fingerprint(path: Path) -> str | None:
    """Return the fingerprint of the scene of a stored run, None for a file that is none, or tells none."""
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(str(file["header"]))
        return str(header["fingerprint"]) if header["format"] == FORMAT else None
    except (*UNREADABLE, pickle.UnpicklingError, TypeError, AttributeError, RecursionError):
        return None


def _check_size(path: Path) -> None:
    """Refuse a file that unpacks to very much more than it is: `save` does not compress."""
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
    except (zipfile.BadZipFile, OSError, ValueError):
        return  # np.load says what it is
    if unpacked > max(_UNPACKED, _MOST_PACKED * path.stat().st_size):
        refuse(path, f"an archive that unpacks to {unpacked / 1e9:.3g} GB")


def _read_header(path: Path, entries: Entries) -> dict[str, Any]:
    text = entries.get("header")
    if text is None or text.ndim != 0 or text.dtype.kind != "U":
        refuse(path, "an npz without the entry 'header'")
    try:
        header = json.loads(str(text))
    except (ValueError, RecursionError) as error:
        refuse(path, "a header that is not JSON", error)
    if isinstance(header, dict) and header.get("format") == "contactvi-batch":
        raise SceneError(
            f"{path} is a batch of runs", path=path, expected="one run, written by Trajectory.save", got="several",
            remedy=f'Save one of them: cvi.load("{path.name}")[0].save("run.npz")',
        )  # fmt: skip
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        refuse(path, f"an npz of another format, {short(header.get('format') if isinstance(header, dict) else header)}")
    if header.get("schema") != SCHEMA:
        raise SceneError(
            f"{path} has another schema",
            path=path,
            expected=f"schema {SCHEMA}",
            got=f"schema {header.get('schema')!r}, written by contactvi {header.get('version')}",
            remedy="Read it with the contactvi that wrote it, or run the scene again",
        )
    return header


def _build(path: Path, entries: Entries, header: dict[str, Any]) -> dict[str, Any]:
    scene = Scene.from_dict(header["scene"])
    sizes = {"q": int(scene.model.nq), "v": int(scene.model.nv)}
    options = Options.from_stored(header["options"])
    read = EntryReader(path, entries, sizes)
    nodes = read.nodes(_stored_nodes(options) | ({"effort": "v"} if "effort" in entries else {}))
    t = nodes.pop("t")
    if header.get("undriven") is True:
        nodes["effort"] = np.broadcast_to(0.0, (len(t), sizes["v"]))
    # The engine's states are finite; so are energies, save in a run that ended because a number was too large.
    status = header["status"]
    ended = Status(StatusCode(status["code"]), str(status["message"]), float(status["time"]))
    for name in ("q", "p", "v", "kinetic_energy", "potential_energy"):
        values = nodes.get(name, np.zeros(0))
        large = len(name) == 1 and not (np.all(np.isfinite(values)) if name == "v" else of_a_run(values))
        if large or np.any(np.isnan(values)):
            refuse(path, f"numbers in {name!r} that are not finite, or larger than those of any run")
        if ended.code == StatusCode.SUCCESS and not np.all(np.isfinite(values)):
            refuse(path, f"numbers in {name!r} that are not finite, of a run that reached its end")
    names = [(str(a), str(b)) for a, b in header["pair_names"]], list(header["joint_names"])
    gap_pairs = [(str(a), str(b)) for a, b in header["gap_pairs"]]
    visuals = [Visual.from_dict(fields) for fields in header["visuals"]]
    if not all(0 <= visual.joint < scene.model.njoints for visual in visuals):
        refuse(path, "pictures on joints that do not exist")
    return {
        "scene": scene,
        "options": options,
        "t": t,
        "q": nodes.pop("q"),
        "p": nodes.pop("p"),
        "events": read.events(names, header["method"]),
        "status": ended,
        "stats": Stats.from_dict(header["stats"]),
        "forced": bool(header["forced"]),
        "segments": read.segments(options.order, options.stage_tol),
        "adaptive_steps": read.group("arc", ("t", "dt")),
        "error_estimate": float(header["error_estimate"]),
        "frames": read.frames(),
        "derived": nodes,
        "gaps": read.gaps(gap_pairs),
        "visuals": visuals,
        "forces": read.forces(t, header["constraints"]),
        "contacts": read.contacts(names, scene.names.shape_groups),
        "changes": read.changes(names),
        "phases": read.phases(),
        "dense_steps": read.dense_steps(),
        "inputs": read.inputs(),
    }


def _stored_nodes(options: Options) -> dict[str, str | None]:
    """Return the entries per node; the discrete energy costs a step per node and is kept where it is conserved."""
    return _NODES | {"discrete_energy": None} if options.impact == "dtec" else _NODES


def _pack(item: Any, arrays: list[NDArray[Any]], seen: dict[tuple[Any, ...], int]) -> Any:
    """Return `item` as plain JSON data; arrays go to `arrays`, equal ones once (a hand has four equal fingers)."""
    if isinstance(item, np.ndarray):
        values = np.ascontiguousarray(item)
        key = (values.shape, values.dtype.str, values.tobytes())
        if key not in seen:
            seen[key] = len(arrays)
            arrays.append(values)
        return {"$array": seen[key]}
    if isinstance(item, dict):
        return {str(name): _pack(value, arrays, seen) for name, value in item.items()}
    if isinstance(item, (list, tuple)):
        return [_pack(value, arrays, seen) for value in item]
    if isinstance(item, np.generic):
        return item.item()
    return item


def _unpack(item: Any, entries: Entries) -> Any:
    if isinstance(item, dict):
        if set(item) == {"$array"}:
            values = entries[f"array/{item['$array']}"]
            if values.dtype.kind not in "fiu":
                raise SceneError(
                    f"Array {item['$array']} of a stored scene",
                    expected="real numbers",
                    got=f"kind {values.dtype.kind!r}",
                    remedy="Write the file again, from the run",
                )
            return values
        return {name: _unpack(value, entries) for name, value in item.items()}
    if isinstance(item, list):
        return [_unpack(value, entries) for value in item]
    return item
