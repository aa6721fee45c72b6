"""The tables of a run, with named columns: states, poses, energies, events, contacts, forces, changes, dense steps.

===========  =========  =====================================================================================
table        a row is   columns, besides the time t [s]
===========  =========  =====================================================================================
states       a node     the numbers of q and v by name (contactvi.scene.coordinates.Coordinates), and JOINT.angle
                        [rad] of joints without end, over whole turns (contactvi.trajectory.angles)
poses        a node     position x, y, z [m] and quaternion qx, qy, qz, qw of every body that moves, world frame
energies     a node     kinetic, potential and modified energy, losses so far, works so far [J]
efforts      a node     of each joint that is driven what its servo and its input do [N m or N]
events       an impact  as in contactvi.Event, vectors by components
contacts     a contact  as in contactvi.Contact: of a point and a step, or of a point in an impact (h = 0)
forces       a window   of time, from t on and of length h [s]: the mean force of each pair, impacts included
changes      a change   as in contactvi.ContactChange
dense_steps  a step     as in contactvi.records.dense_steps
===========  =========  =====================================================================================

Contacts, events and changes have the pair as one column, its two shapes (of a limit: the joint and which limit) as
`first` and `second`, and the bodies of these as `first_body` and `second_body` (of a limit both empty). Contact points
x, y, z [m], normals nx, ny, nz from the first shape to the second, impulses ix, iy, iz [N s], forces fx, fy, fz [N] and
slips sx, sy, sz [m/s] are in world axes; impulse and force act on the second shape. normal_force and friction_force [N]
are what they sound like, friction_ratio is friction_force / (mu normal_force), 1 on the friction cone. An impact has no
force, and a point without friction, or with another law than Coulomb's with one number, no ratio: NaN. has_force tells
the rows whose step is long enough for a force to mean something. What a limit does to its joint [N; N m] is its
normal_force.

t of a contact or a force is the start of its step or window, of an impact its time. Windows of forces are those between
the nodes, or have the length that is asked for; columns are FIRST | SECOND.x, .y, .z, on the second shape in world
axes, and JOINT | LIMIT.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.inputs import check_choice, real, short
from contactvi.records.codes import CHANGES, FALLBACKS, KINDS, METHODS, MODES, GuardKind
from contactvi.records.contacts import ChangeLog, ContactLog
from contactvi.records.dense_steps import DenseSteps
from contactvi.records.events import EventLog
from contactvi.records.table import Column, Table, Words
from contactvi.records.work import WORKS, Forces
from contactvi.scene.coordinates import coordinates
from contactvi.scene.scene import Scene
from contactvi.trajectory.angles import turned_angles
from contactvi.trajectory.efforts import Efforts
from contactvi.trajectory.force_table import force_table
from contactvi.trajectory.polynomials import sample_times
from contactvi.trajectory.poses import body_poses, moving_bodies

Array = NDArray[np.float64]

_XYZ = ("x", "y", "z")
_OF_EVENTS = (
    "gamma_minus", "gamma_plus", "G_c", "gap", "restitution", "friction", "points", "loss", "energy_change",
)  # fmt: skip
QUATERNION = ("qx", "qy", "qz", "qw")


class Run(Protocol):
    """What tables are made of; contactvi.Trajectory has it."""

    t: Array
    q: Array
    events: EventLog
    contacts: ContactLog
    contact_changes: ChangeLog
    dense_steps: DenseSteps
    forces: Forces | None

    @property
    def scene(self) -> Scene: ...
    @property
    def v(self) -> Array: ...
    @property
    def kinetic_energy(self) -> Array: ...
    @property
    def potential_energy(self) -> Array: ...
    @property
    def modified_energy(self) -> Array: ...
    @property
    def impact_energy(self) -> Array: ...
    @property
    def impact_loss(self) -> Array: ...
    @property
    def friction_loss(self) -> Array: ...
    @property
    def drives(self) -> bool: ...
    def efforts(self) -> Efforts: ...


def table(traj: Run, name: str, sample_dt: float | None = None) -> Table:
    """Return a table of a run.

    Args:
        sample_dt: length of the windows of "forces" [s], by default the times between the nodes.

    Raises:
        InputError: an unknown name, a length that is not usable, or one for another table.
    """
    check_choice("table", name, tuple(TABLES), "Unknown table of a run")
    if sample_dt is None:
        return TABLES[name](traj)
    if name != "forces":
        raise InputError(
            f"The table {name!r} has no windows", name="sample_dt", expected="it with the table 'forces' alone",
            got=short(sample_dt), remedy="Leave it out; simulate(sample_dt=) keeps states at such times",
        )  # fmt: skip
    span = float(traj.t[-1] - traj.t[0])
    step = real("sample_dt", sample_dt, max(span * 1e-7, 1e-300), expected="seconds, at most 1e7 windows in the run")
    return force_table(traj, sample_times(float(traj.t[0]), float(traj.t[-1]), step))


def states(traj: Run) -> Table:
    """Return q and v at the nodes, a column for each number, and the angles of joints without end over whole turns."""
    named = coordinates(traj.scene.model)
    columns: dict[str, Column] = {"t": traj.t}
    for names, values in ((named.q, traj.q), (named.v, traj.v)):
        columns |= dict(zip(names, values.T, strict=True))
    angles = turned_angles(traj)
    return Table("states", columns | angles, {"t": "s", **named.q, **named.v, **dict.fromkeys(angles, "rad")})


def poses(traj: Run) -> Table:
    """Return position and quaternion of every moving body at the nodes."""
    model = traj.scene.model
    bodies = moving_bodies(model)
    position, quaternion = body_poses(model, traj.q, bodies)
    columns: dict[str, Column] = {"t": traj.t}
    units = {"t": "s"}
    for k, body in enumerate(bodies):
        columns |= {f"{body}.{axis}": position[:, k, i] for i, axis in enumerate(_XYZ)}
        columns |= {f"{body}.{part}": quaternion[:, k, i] for i, part in enumerate(QUATERNION)}
        units |= {f"{body}.{axis}": "m" for axis in _XYZ} | {f"{body}.{part}": "1" for part in QUATERNION}
    return Table("poses", columns, units)


def energies(traj: Run) -> Table:
    """Return energies, losses and works at the nodes."""
    columns: dict[str, Column] = {
        "t": traj.t,
        "kinetic_energy": traj.kinetic_energy,
        "potential_energy": traj.potential_energy,
        "energy": traj.kinetic_energy + traj.potential_energy,
        "modified_energy": traj.modified_energy,
        "impact_energy": traj.impact_energy,
        "impact_loss": traj.impact_loss,
        "friction_loss": traj.friction_loss,
    }
    if traj.forces is not None:
        columns |= {f"work_{name}": work for name, work in zip(WORKS, traj.forces.work, strict=True)}
    return Table("energies", columns, {"t": "s"} | dict.fromkeys(list(columns)[1:], "J"))


def efforts(traj: Run) -> Table:
    """Return the efforts of driven joints at the nodes, a column for each; raises InputError where they are unknown."""
    found = traj.efforts()
    columns: dict[str, Column] = {"t": found.t, **dict(zip(found.joints, found.values.T, strict=True))}
    return Table("efforts", columns, {"t": "s", **found.joints})


def events(traj: Run) -> Table:
    """Return the impacts."""
    log = traj.events
    arrays = log.arrays
    columns: dict[str, Column] = {"t": arrays["time"], "step": arrays["step"]}
    columns |= _guards(traj.scene, log, arrays["kind"], arrays["index"])
    columns |= _vector(arrays["point"], "") | _vector(arrays["normal"], "n")
    columns |= {"impulse": arrays["impulse"]} | _vector(arrays["impulse_vector"], "i")
    columns |= {name: arrays[name] for name in _OF_EVENTS}
    columns["method"] = Words(arrays["method"], METHODS)
    columns["fallback"] = Words(arrays["fallback"], tuple(text or "" for text in FALLBACKS))
    # Of a limit of a revolute joint lengths are angles and impulses those of torques.
    units = {"t": "s", "impulse": "N s", "gamma_minus": "m/s", "gamma_plus": "m/s", "G_c": "1/kg", "gap": "m"}
    units |= {"loss": "J", "energy_change": "J", "restitution": "1", "friction": "1"}
    return Table("events", columns, units | _units("", "m") | _units("n", "1") | _units("i", "N s"))


def contacts(traj: Run) -> Table:
    """Return the contacts, a row per point and step, and per point of an impact."""
    log, scene = traj.contacts, traj.scene
    arrays = log.arrays
    normal_impulse, friction = log.normal_impulse, log.friction_impulse
    with np.errstate(divide="ignore", invalid="ignore"):
        forces = [np.where(log.h > 0.0, impulse / log.h, np.nan) for impulse in (normal_impulse, friction)]
    columns: dict[str, Column] = {"t": log.t, "h": log.h, "step": arrays["step"]}
    columns |= _guards(scene, log, arrays["kind"], arrays["index"])
    columns |= {"point": arrays["point"], "mode": Words(arrays["mode"], MODES), "dense": arrays["dense"] == 1}
    columns |= _vector(log.position, "") | _vector(arrays["normal"], "n")
    columns |= _vector(log.impulse, "i") | {"normal_impulse": normal_impulse}
    columns |= _vector(log.force, "f") | {"normal_force": forces[0], "friction_force": forces[1]}
    columns |= {"friction_ratio": friction_ratio(scene, log), "gap": arrays["gap"]} | _vector(arrays["slip"], "s")
    columns["has_force"] = log.has_force
    units = {"t": "s", "h": "s", "normal_impulse": "N s", "gap": "m", "friction_ratio": "1"}
    units |= dict.fromkeys(("normal_force", "friction_force"), "N")
    for prefix, unit in (("", "m"), ("n", "1"), ("i", "N s"), ("f", "N"), ("s", "m/s")):
        units |= _units(prefix, unit)
    return Table("contacts", columns, units)


def friction_ratio(scene: Scene, log: ContactLog) -> Array:
    """Return |friction| / (mu normal) of every row, shape (m,).

    NaN without a force, friction or a pressing one, and where the bound is not one number times the normal force.
    """
    mu = np.array(scene.pair_friction, dtype=float)
    for law, places in scene.built().laws:
        if law.varies("friction") or law.adheres:
            mu[places] = 0.0
    of_pair = (log.array("kind") == GuardKind.CONTACT) & (log.h > 0.0)
    most = np.zeros(len(log))
    most[of_pair] = mu[log.array("index")[of_pair]] * log.normal_impulse[of_pair]
    ratio: Array = np.divide(log.friction_impulse, most, out=np.full(len(log), np.nan), where=most > 0.0)
    return ratio


def changes(traj: Run) -> Table:
    """Return the changes of contacts."""
    log = traj.contact_changes
    arrays = log.arrays
    columns: dict[str, Column] = {"t": arrays["time"]}
    columns |= _guards(traj.scene, log, arrays["kind"], arrays["index"])
    columns |= {"point": arrays["point"], "change": Words(arrays["change"], CHANGES), "value": arrays["value"]}
    return Table("changes", columns, {"t": "s"})


def dense_steps(traj: Run) -> Table:
    """Return the dense steps."""
    units = {"t": "s", "h": "s", "residual": "1", "gap": "m"}
    units |= dict.fromkeys(("energy_rise", "energy_loss", "energy_error"), "J")
    return Table("dense_steps", dict(traj.dense_steps.arrays), units)


def _guards(
    scene: Scene, log: EventLog | ContactLog | ChangeLog, kind: NDArray[np.int64], index: NDArray[np.int64]
) -> dict[str, Column]:
    """Return the columns that tell what an event or a contact is about."""
    guards, of_row = np.unique(2 * index + kind, return_inverse=True)
    pairs = [log.label(int(guard % 2), int(guard // 2)) for guard in guards]
    shapes = _bodies_of_shapes(scene)
    bodies = [("", "") if guard % 2 else (shapes[a], shapes[b]) for guard, (a, b) in zip(guards, pairs, strict=True)]
    columns: dict[str, Column] = {"kind": Words(kind, KINDS)}
    columns["pair"] = _words([" | ".join(pair) for pair in pairs], of_row)
    for k, side in enumerate(("first", "second")):
        columns[side] = _words([pair[k] for pair in pairs], of_row)
        columns[f"{side}_body"] = _words([pair[k] for pair in bodies], of_row)
    return columns


def _bodies_of_shapes(scene: Scene) -> dict[str, str]:
    frames = scene.model.frames
    found = {str(g.name): str(frames[g.parentFrame].name) for g in scene.collision_model.geometryObjects}
    return {name: "world" if body == "universe" else body for name, body in found.items()}


def _words(of_guard: Sequence[str], of_row: NDArray[Any]) -> Words:
    words = tuple(dict.fromkeys(of_guard))
    codes = np.array([words.index(word) for word in of_guard], dtype=np.int64)
    return Words(codes[of_row.reshape(-1)], words)


def _vector(values: Array, prefix: str) -> dict[str, Column]:
    return {prefix + axis: values[:, k] for k, axis in enumerate(_XYZ)}


def _units(prefix: str, unit: str) -> dict[str, str]:
    return {prefix + axis: unit for axis in _XYZ}


OF_NODES = ("states", "poses", "energies", "efforts")  # tables with a row for each node
TABLES: dict[str, Callable[[Run], Table]] = {
    "states": states, "poses": poses, "energies": energies, "efforts": efforts, "events": events, "contacts": contacts,
    "forces": force_table, "changes": changes, "dense_steps": dense_steps,
}  # fmt: skip
