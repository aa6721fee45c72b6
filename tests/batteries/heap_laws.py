"""Laws of a run of a heap (contactvi.bench.heaps), whatever the way in which its contacts were solved.

Numbers are finite; no shapes overlap at a node; impulses push inside of their cones and add up to the motion; the
energy never rises by more than the error of a midpoint step. None of the laws uses the engine's own intermediate
results: gaps are coal's and closed forms, energies those of rigid bodies.

The energy error of a midpoint step of a motion that turns at a rate w is at most (h w)^2 / 12 of its kinetic energy
(batteries.energy_laws); 3 / 12 are allowed, body by body. The rate is that at which the body turns, and sqrt(g / r) of
gravity, r its least half size; of a cylinder also that at which a contact runs around its rim. The forces of persistent
contacts, which change the velocity by dv in the step, err by dv.M dv / 12 (docs/theory/contact_problems.md). An
impact and a dense step may not gain anything. Where a body is moved out of an overlap within the tolerance of gaps, it
is lifted by that.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import contactvi as cvi
from batteries.contact_laws import Array, Finding, contact_laws, momentum_laws, number_laws, worst
from contactvi.bench.heap_gaps import GapCheck
from contactvi.bench.heaps import Heap, rotation_of

GRAVITY = 9.81
GAP = 1e-9  # [m] that shapes may overlap
NOISE = 1e-9  # [m] of coal's distances near contact where GJK iterates towards a cylinder; else 1e-14
ROUNDING = 1e-12  # of the largest energy
IMPULSES = ("impulse pulls", "cone")


def tolerance(kinds: tuple[str, str]) -> float:
    """How far two shapes may seem to overlap [m]."""
    iterated = "cylinder" in kinds and not {"plane", "sphere"} & set(kinds)
    return GAP + (NOISE if iterated else 0.0)


def gap_laws(heap: Heap, traj: cvi.Trajectory, every: int = 1) -> Iterator[Finding]:
    """No shapes overlap at every so many nodes and at the last one; no recorded gap is less."""
    check = GapCheck(heap)
    deepest, where = 0.0, ""
    for k in sorted({*range(0, len(traj.t), every), len(traj.t) - 1}):
        for gap, names in check.below(traj.q[k], -GAP):
            if -gap > max(deepest, tolerance((check.kind(names[0]), check.kind(names[1])))):
                deepest, where = -gap, f"t = {traj.t[k]:.9g}, {names}"
    if where:
        yield Finding("overlap", deepest, where)
    rows = traj.contacts
    if len(rows):
        bounds = np.array([tolerance(kinds_of(check, traj, pair)) for pair in range(len(traj.scene.pair_names))])
        yield from worst("gap of a contact", -rows.array("gap"), bounds[rows.array("index")], rows.t)


def kinds_of(check: GapCheck, traj: cvi.Trajectory, pair: int) -> tuple[str, str]:
    a, b = traj.scene.pair_names[pair]
    return check.kind(a), check.kind(b)


def impulse_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """Impulses lie in their cones."""
    for found in contact_laws(traj):
        if found.law.startswith(IMPULSES):
            yield found


# --- energy -----------------------------------------------------------------------------------------------------------
def energies(heap: Heap, traj: cvi.Trajectory) -> tuple[Array, Array]:
    """Kinetic and potential energy of each body at each node [J], shapes (N, bodies)."""
    mass = np.array([body.mass for body in heap.bodies])
    q, v = traj.q.reshape(len(traj.t), -1, 7), traj.v.reshape(len(traj.t), -1, 6)
    inertias = np.array([moments(heap, k) for k in range(len(heap.bodies))])
    kinetic = 0.5 * (mass * (v[:, :, :3] ** 2).sum(axis=2) + (inertias * v[:, :, 3:] ** 2).sum(axis=2))
    return kinetic, GRAVITY * mass * q[:, :, 2]


def moments(heap: Heap, k: int) -> Array:
    """Principal moments of inertia of a solid body about its own axes [kg m^2], shape (3,)."""
    body = heap.bodies[k]
    assert body.mass is not None
    if body.kind == "box":
        x, y, z = np.square(body.size)
        return body.mass / 12.0 * np.array([y + z, x + z, x + y])
    r = body.size[0]
    if body.kind == "sphere":
        return np.full(3, 0.4 * body.mass * r**2)
    length = body.size[1]
    rod, ball = np.pi * r**2 * length, 4.0 / 3.0 * np.pi * r**3 * (body.kind == "capsule")
    rod, ball = body.mass * np.array([rod, ball]) / (rod + ball)
    axial = 0.5 * rod * r**2 + 0.4 * ball * r**2
    # Half balls of the ends: their centres of mass are 3 r / 8 beyond the ends of the rod.
    cap = ball * (0.4 * r**2 + 0.25 * length**2 + 0.375 * r * length)
    across = rod * (0.25 * r**2 + length**2 / 12.0) + cap
    return np.array([across, across, axial])


def allowed_rises(heap: Heap, traj: cvi.Trajectory, dt: float) -> Array:
    """Bound on the rise of the energy in each step [J], shape (N - 1,)."""
    kinetic, potential = energies(heap, traj)
    kinetic = np.maximum(kinetic[1:], kinetic[:-1])
    spin = np.linalg.norm(traj.v.reshape(len(traj.t), -1, 6)[:, :, 3:], axis=2)
    least = np.array([least_half_size(heap, k) for k in range(len(heap.bodies))])
    squares = np.maximum(spin[1:], spin[:-1]) ** 2 + GRAVITY / least + running_rates(heap, traj, least, dt) ** 2
    weight = GRAVITY * sum(body.mass or 0.0 for body in heap.bodies)
    size = float((kinetic.sum(axis=1)).max() + np.abs(potential).sum(axis=1).max())
    error = 0.25 * dt**2 * squares * kinetic + changes_by_forces(heap, traj) / 12.0
    return error.sum(axis=1) + GAP * weight + ROUNDING * size


def changes_by_forces(heap: Heap, traj: cvi.Trajectory) -> Array:
    """dv.M dv of each step and body [J], shape (N - 1, bodies); zero where the body has an impact or a dense step."""
    steps, count = len(traj.t) - 1, len(heap.bodies)
    change = np.diff(traj.v.reshape(steps + 1, count, 6), axis=0)
    mass = np.array([body.mass for body in heap.bodies])
    inertias = np.array([moments(heap, k) for k in range(count)])
    work = mass * (change[:, :, :3] ** 2).sum(axis=2) + (inertias * change[:, :, 3:] ** 2).sum(axis=2)
    rows = traj.contacts
    sudden = (rows.h == 0.0) | (rows.array("dense") != 0)
    step = np.clip(np.searchsorted(traj.t, rows.t[sudden], side="right") - 1, 0, steps - 1)
    names = np.array([[f"body{k}" in pair for k in range(count)] for pair in traj.scene.pair_names])
    hit = np.zeros((steps, count), dtype=bool)
    np.logical_or.at(hit, step, names[rows.array("index")[sudden]])
    return np.where(hit, 0.0, work)


def least_half_size(heap: Heap, k: int) -> float:
    body = heap.bodies[k]
    half = {"box": [0.5 * x for x in body.size], "cylinder": [body.size[0], 0.5 * body.size[-1]]}
    return min(half.get(body.kind, body.size[:1]))


def running_rates(heap: Heap, traj: cvi.Trajectory, least: Array, dt: float) -> Array:
    """Rates at which contacts run over cylinders [1/s], at most a radian a step, shape (N - 1, bodies)."""
    log, steps = traj.contacts, len(traj.t) - 1
    rates = np.zeros((steps, len(heap.bodies)))
    order = np.lexsort((log.h, log.t, log.array("index"), log.array("point")))
    same = np.all([np.diff(log.array(name)[order]) == 0 for name in ("index", "point")], axis=0)
    before, after = order[:-1][same], order[1:][same]
    next_to = (np.abs(log.end[before] - log.t[after]) <= 1e-9) & (log.h[after] > 0.0)
    before, after = before[next_to], after[next_to]
    turns = rotation_of(traj.q.reshape(len(traj.t), -1, 7)[:, :, 3:])
    for k, body in enumerate(heap.bodies):
        if body.kind != "cylinder":
            continue
        mine = np.array([f"body{k}" in pair for pair in traj.scene.pair_names])[log.array("index")[after]]
        a, b = before[mine], after[mine]
        step = np.clip(log.array("step")[b], 0, steps - 1)
        velocity = np.einsum("nij,nj->ni", turns[step, k], traj.v[step, 6 * k : 6 * k + 3])
        speed = np.linalg.norm((log.position[b] - log.position[a]) / log.h[b][:, None] - velocity, axis=1)
        np.maximum.at(rates[:, k], step, np.minimum(speed / least[k], 1.0 / dt))
    return rates


def energy_laws(heap: Heap, traj: cvi.Trajectory, dt: float) -> Iterator[Finding]:
    """The energy rises neither in a step nor over the run."""
    if len(traj.t) < 2:
        return
    energy, allowed = sum(energies(heap, traj)).sum(axis=1), allowed_rises(heap, traj, dt)
    yield from worst("energy rises in a step", np.diff(energy), allowed, traj.t[:-1])
    # The errors of the steps add up to an oscillation of (h w)^2 of the energy, without the quarter.
    rise = (energy - np.minimum.accumulate(energy))[1:]
    yield from worst("energy rises", rise, 4.0 * np.maximum.accumulate(allowed), traj.t[1:])


def broken(heap: Heap, traj: cvi.Trajectory, dt: float, every: int = 1) -> list[Finding]:
    """Violations of all laws; after NaN only those of the numbers. dt: the step [s]; every: of the nodes for gaps."""
    found = list(number_laws(traj))
    if not found:
        found = [*gap_laws(heap, traj, every), *impulse_laws(traj), *momentum_laws(traj)]
        found += energy_laws(heap, traj, dt)
    return found
