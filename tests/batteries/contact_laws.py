"""Laws that hold for every run with contact, whatever its status: finite numbers, gaps, limits, impacts, contact rows,
momentum.

Laws of the energy are in batteries.energy_laws. A law yields the violations that it finds; none of them uses the
engine's own intermediate results.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.trajectory.contact_ledger import free_trees

Array = np.ndarray
EXPLICIT = 0  # impact map "ctec", as in EventLog
STICK, LIMIT = 0, 1  # mode and kind, as in ContactLog
FEATURE_BITS, CROSSING = 40, 1  # the number of a feature begins with its kind: 0 is coal's, 1 a crossing of edges
# [m] accuracy of gaps: of closed forms, and of distances from coal's nearest points
GAP, GAP_ITERATED = 1e-10, 1e-9
PROMISED = 1e-9  # [m] at nodes of dense steps
CONE = 1e-8  # of the largest impulse of the step: its contact problem is solved to 1e-9 of its terms at worst
# [m] rounding of positions of some metres, and of the distances that coal iterates
PLACE, PLACE_ITERATED = 1e-14, 1e-11
COMPLEMENTARITY = 1e-12  # [N s m]
ROUND = ("Sphere", "Capsule")


@dataclass
class Finding:
    """A law that a run violates: by how much, and where."""

    law: str
    value: float
    where: str

    def __str__(self) -> str:
        return f"{self.law}: {self.value:.3g} ({self.where})"


def worst(law: str, values: Array, bound: Array | float, times: Array) -> Iterator[Finding]:
    """The value that exceeds its bound most, if there is one; NaN exceeds any bound."""
    if len(values):
        excess = np.where(np.isnan(values), np.inf, values - bound)
        k = int(np.argmax(excess))
        if excess[k] > 0.0:
            yield Finding(law, float(values[k]), f"t = {times[k]:.9g}")


# --- numbers, gaps --------------------------------------------------------------------------------------------------
def number_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """No NaN in nodes, events and contact rows (no slip and no gap is known at the impacts of a limit)."""
    log, rows = traj.events, traj.contacts
    for name in ("t", "q", "p", "v"):
        if not np.isfinite(getattr(traj, name)).all():
            yield Finding("finite nodes", np.nan, name)
    for name in ("time", "impulse", "gamma_minus", "gamma_plus", "q", "p_minus", "p_plus", "G_c", "loss"):
        if not np.isfinite(log.array(name)).all():
            yield Finding("finite events", np.nan, name)
    for name in ("t", "h", "position", "normal", "start", "end", "gap", "slip"):
        if not np.isfinite(rows.array(name)).all():
            yield Finding("finite contact rows", np.nan, name)


def pair_tolerances(scene: cvi.Scene) -> Array:
    """How far each pair may overlap [m], shape (npairs,)."""
    kind = {g.name: type(g.geometry).__name__ for g in scene.collision_model.geometryObjects}
    bounds = []
    for pair in scene.pair_names:
        kinds = [kind[name] for name in pair]
        exact = "Halfspace" in kinds or ("Sphere" in kinds and all(k in ROUND for k in kinds))
        bounds.append(GAP if exact else GAP_ITERATED)
    return np.array(bounds)


def gap_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """No pair and no limit overlaps at a node."""
    core, bound = traj.scene.core(), pair_tolerances(traj.scene)
    if len(traj.dense_steps):
        bound = np.maximum(bound, PROMISED)
    if len(bound):
        gaps = np.array([core.gaps(q)[0][: len(bound)] for q in traj.q])
        pair = np.argmax(-gaps - bound, axis=1)
        depth = -gaps[np.arange(len(gaps)), pair]
        for found in worst("penetration", depth, bound[pair], traj.t):
            found.where += f", {traj.scene.pair_names[pair[int(np.argmax(depth - bound[pair]))]]}"
            yield found
    model = traj.scene.model
    for joint in model.joints[1:]:
        low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        if joint.nq == 1 and low < high:
            x = traj.q[:, joint.idx_q]
            yield from worst("beyond a limit", np.maximum(low - x, x - high), GAP, traj.t)


# --- impacts ----------------------------------------------------------------------------------------------------------
def event_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """Impacts are in order, at zero gap, close, push and separate; their energy loss is that of their law and >= 0."""
    log = traj.events
    if not len(log):
        return
    a = log.arrays
    times, scale = a["time"], np.abs(a["impulse"]).max()
    if np.any(np.diff(times) < 0.0):
        yield Finding("events in order", float(np.diff(times).min()), "")
    yield from worst("impulse of an impact", -a["impulse"], 1e-15 * scale, times)
    yield from worst("impact without closing", a["gamma_minus"], 0.0, times)
    yield from worst("impact does not separate", -a["gamma_plus"], 1e-11 * (1.0 + np.abs(a["gamma_minus"])), times)
    pairs = a["kind"] == 0
    overlap = pair_tolerances(traj.scene)[np.where(pairs, a["index"], 0)] if pairs.any() else GAP
    yield from worst("gap of an impact", np.abs(a["gap"]), np.where(pairs, overlap, GAP), times)
    yield from energy_at_impacts(traj)


def energy_at_impacts(traj: cvi.Trajectory) -> Iterator[Finding]:
    """Energies of all impacts at one instant together: the impulses of one plastic problem are separate events."""
    a, core, ledger = traj.events.arrays, traj.scene.core(), traj.ledger
    times = a["time"]
    first = np.flatnonzero(np.append(True, np.diff(times) > 0.0))
    last = np.append(first[1:], len(times)) - 1
    before = core.energy(a["q"][first], a["p_minus"][first])[:, 0]
    after = core.energy(a["q"][last], a["p_plus"][last])[:, 0]
    # CTEC, or the fallback of another map to it. DTEC and MHC conserve their own scalars, and T only to O(h^2).
    explicit = np.logical_and.reduceat((a["fallback"] != 0) | (a["method"] == EXPLICIT), first)
    rounding = 1e-12 * before + 1e-15
    yield from worst("impact gains energy", (after - before)[explicit], rounding[explicit], times[first][explicit])
    yield from worst("loss < 0", -np.add.reduceat(a["loss"], first), rounding, times[first])
    own = (a["fallback"] == 0) & (a["method"] != EXPLICIT)
    if own.any():
        size = np.abs(core.energy(traj.q, traj.p)).sum(axis=1).max()
        yield from worst("jump of the map's own energy", np.abs(ledger.own_jump[own]), 1e-11 * size, times[own])


# --- contact rows -----------------------------------------------------------------------------------------------------
def starts(log: cvi.ContactLog, opened: Array) -> tuple[Array, Array, Array]:
    """Normals (m, 3), gaps (m,) and what the residual of a dense step may have opened them by (m,), of first impulses.

    They are those of the point at the end of the row before; NaN in the first row of a point, and, where the point is
    coal's, in a dense step and after one: each such step takes the plane between the shapes anew. Impacts have one
    normal. The first impulse of a dense step acts along the normal at its start and belongs to the gap at its end,
    which it closes. A smooth step that holds contacts has one impulse, half of it at either end, and the mean of its
    normals.
    """
    normal, gap = np.full_like(log.array("normal"), np.nan), np.full(len(log), np.nan)
    opened_before = np.zeros(len(log))
    keys = [log.array(name) for name in ("kind", "index", "point")]
    order = np.lexsort((log.h, log.t, *keys))  # an impact before the step after it
    same = np.all([np.diff(key[order]) == 0 for key in keys], axis=0)
    before, after = order[:-1][same], order[1:][same]
    near = np.abs(log.end[before] - log.t[after]) <= 1e-12
    normal[after[near]] = log.array("normal")[before[near]]
    gap[after[near]] = log.array("gap")[before[near]]
    opened_before[after[near]] = opened[before[near]]
    dense = log.array("dense") == 1
    anew = after[(dense[before] | dense[after]) & (log.array("feature")[after] == 0)]
    normal[anew], gap[anew] = np.nan, np.nan
    held = (log.h > 0.0) & ~dense & (log.array("start") == log.array("end")).all(axis=1)
    normal[after[held[before]]] = np.nan
    normal[held] = log.array("normal")[held]
    impact = log.h == 0.0
    normal[impact], gap[impact] = log.array("normal")[impact], log.array("gap")[impact]
    gap[dense], opened_before[dense] = log.array("gap")[dense], opened[dense]
    return normal, gap, opened_before


def contact_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """Every row pushes inside the friction cone; persistent contacts do not penetrate, sticking ones do not slip."""
    log = traj.contacts
    if not len(log):
        return
    limit, persistent, t = log.array("kind") == LIMIT, log.h > 0.0, log.t
    pair = np.where(limit, 0, log.array("index"))
    known = len(traj.scene.pair_names) > 0
    mu = np.where(limit | (not known), 0.0, traj.scene.pair_friction[pair] if known else 0.0)
    overlap = np.where(limit | (not known), GAP, pair_tolerances(traj.scene)[pair] if known else GAP)
    overlap = of_the_step(log, overlap)  # a step with an iterated pair is as accurate as that pair
    opened = left_open(traj)
    sides = (("start", *starts(log, opened)), ("end", log.array("normal"), log.array("gap"), opened))
    # a step's problem is solved relative to all its impulses; the rounding of positions over the step is a speed
    sizes = np.maximum(*(np.linalg.norm(log.array(name), axis=1) for name in ("start", "end")))
    place = np.where(overlap > GAP, PLACE_ITERATED, PLACE)
    rounding = CONE * of_the_step(log, sizes) + place * mass_of(traj) / np.where(persistent, log.h, 1.0)
    # A dense step takes the plane of a crossing of nearly parallel edges anew, and fixes it to a body.
    crossing = (log.array("dense") == 1) & (log.array("feature") >> FEATURE_BITS == CROSSING)
    turns = np.linalg.norm(sides[1][1] - sides[0][1], axis=1)
    for name, normal, gap, away in sides:
        turned = np.where(crossing & np.isfinite(turns) & (name == "start"), turns, 0.0)
        unit = np.where(limit[:, None], [1.0, 0.0, 0.0], normal)  # the impulse of a limit is its first component
        impulse = log.array(name)
        along = np.einsum("ij,ij->i", impulse, unit)
        across = np.linalg.norm(impulse - along[:, None] * unit, axis=1)
        k = np.isfinite(along)
        yield from worst(f"impulse pulls ({name})", -along[k], rounding[k], t[k])
        yield from worst(f"cone ({name})", (across - mu * along)[k], (rounding + turned * along)[k], t[k])
        k &= persistent & np.isfinite(gap)
        least = np.maximum((overlap + away) * along, COMPLEMENTARITY)
        yield from worst(f"complementarity ({name})", np.abs(along * gap)[k], least[k], t[k])
    yield from worst("gap of a persistent contact", -log.array("gap")[persistent], overlap[persistent], t[persistent])
    sticking = persistent & (log.array("mode") == STICK) & ~limit
    yield from worst("slip where it sticks", np.linalg.norm(log.array("slip")[sticking], axis=1), 1e-9, t[sticking])


def left_open(traj: cvi.Trajectory) -> Array:
    """What the residual of a dense step may leave a loaded gap open by [m], shape (m,); 0 for other rows of contacts.

    The residual is a speed over the largest speed that a contact would have without impulses, which is below that of
    two bodies of 1 m with the largest velocity of the run.
    """
    log, steps = traj.contacts, traj.dense_steps
    reached: dict[tuple[float, float], float] = {}
    for t, h, residual in zip(steps["t"], steps["h"], steps["residual"], strict=True):
        reached[t, h] = max(residual, reached.get((t, h), 0.0))
    speed = 2.0 * np.abs(traj.v).sum(axis=1).max()
    dense = log.array("dense") == 1
    return np.where(dense, [h * speed * reached.get((t, h), 0.0) for t, h in zip(log.t, log.h, strict=True)], 0.0)


def of_the_step(log: cvi.ContactLog, values: Array) -> Array:
    """Largest of the values (m,) of all rows of the same step or instant, shape (m,)."""
    _, step = np.unique(np.column_stack([log.t, log.h]), axis=0, return_inverse=True)
    largest = np.zeros(len(log))
    np.maximum.at(largest, step.reshape(-1), values)
    return largest[step.reshape(-1)]


def mass_of(traj: cvi.Trajectory) -> float:
    """Mass of the heaviest body [kg]."""
    return max(inertia.mass for inertia in traj.scene.model.inertias)


# --- momentum ---------------------------------------------------------------------------------------------------------
def momentum_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """Impulses on each free body in a step = change of its momentum - weight x time, step by step."""
    log, model = traj.contacts, traj.scene.model
    steps = len(traj.t) - 1
    if steps < 1:
        return
    rows = (log.array("kind") == 0) & (log.array("step") < steps)
    gravity = np.array(model.gravity.linear)
    for tree in free_trees(model, traj.scene.collision_model):
        turns = [pin.Quaternion(q[tree.idx_q + 3 : tree.idx_q + 7]).matrix() for q in traj.q]
        local = traj.p[:, tree.idx_v : tree.idx_v + 3]
        momentum = np.array([turn @ x for turn, x in zip(turns, local, strict=True)])
        pushed, size = np.zeros((steps, 3)), np.zeros(steps)
        impulses = tree.signs[log.array("index")[rows], None] * log.impulse[rows]
        np.add.at(pushed, log.array("step")[rows], impulses)
        np.add.at(size, log.array("step")[rows], np.linalg.norm(impulses, axis=1))
        weight = tree.mass * np.diff(traj.t)[:, None] * gravity
        rest = np.linalg.norm(np.diff(momentum, axis=0) - weight - pushed, axis=1)
        # steps are solved to 1e-12, relative to the momentum and to all terms of the sum
        bound = 1e-11 * (np.abs(momentum).max() + size + tree.mass * 1e-3)
        yield from worst(f"momentum (v index {tree.idx_v})", rest, bound, traj.t[1:])


def broken(traj: cvi.Trajectory) -> list[Finding]:
    """Violations of all laws but those of energy over steps; after NaN only those of the numbers."""
    found = list(number_laws(traj))
    if not found:
        found = [*gap_laws(traj), *event_laws(traj), *contact_laws(traj), *momentum_laws(traj)]
    return found
