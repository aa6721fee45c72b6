"""Energy of a run with contact: it never rises by more than the error of a midpoint step.

For a motion that turns at a rate Omega the energy error of a step of length h is at most (h Omega)^2 / 12 of that
energy (the midpoint rule on an oscillator). Three rates count: that at which bodies turn, that at which a contact
point moves over the body (fast for a rim that falls flat though the body hardly turns) and sqrt(g / R) of gravity, R
the least of all radii; a quarter is three twelfths. The part of joints and springs is the difference of the step's
modified Hamiltonian at both ends. A wrong impact or contact step raises none of these rates, so that its gain exceeds
the bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import coal
import numpy as np

import contactvi as cvi
from batteries.contact_laws import GAP, Array, Finding, worst
from batteries.contact_scenes import GRAVITY


def turning_rates(traj: cvi.Trajectory) -> Array:
    """Largest angular speed of a joint at each node [1/s], shape (N,)."""
    rates = np.zeros(len(traj.t))
    for joint in traj.scene.model.joints[1:]:
        kind = joint.shortname()
        if not kind.startswith("JointModelP"):  # prismatic
            start = joint.idx_v + (3 if "FreeFlyer" in kind else 0)
            rates = np.maximum(rates, np.linalg.norm(traj.v[:, start : joint.idx_v + joint.nv], axis=1))
    return rates


def running_rates(traj: cvi.Trajectory, radius: float) -> Array:
    """Speed of the contact points over the body / radius, the largest of each step [1/s], shape (N - 1,)."""
    log, steps = traj.contacts, len(traj.t) - 1
    keys = [log.array(name) for name in ("kind", "index", "point")]
    order = np.lexsort((log.h, log.t, *keys))
    same = np.all([np.diff(key[order]) == 0 for key in keys], axis=0)
    before, after = order[:-1][same], order[1:][same]
    next_to = (np.abs(log.end[before] - log.t[after]) <= 1e-9) & (log.h[after] > 0.0)
    before, after = before[next_to], after[next_to]
    speed = np.linalg.norm(log.position[after] - log.position[before], axis=1) / log.h[after]
    rates = np.zeros(steps)
    np.maximum.at(rates, np.clip(log.array("step")[after], 0, steps - 1), speed / radius)
    return rates


def half_extent(shape: Any) -> float:
    """The smallest of a shape's own axes [m]."""
    shape.computeLocalAABB()
    return 0.5 * float(np.min(shape.aabb_local.max_ - shape.aabb_local.min_))


def allowed_rises(traj: cvi.Trajectory, dt: float) -> Array:
    """Bound on the rise of H in each step [J], shape (N - 1,). dt: longest step in persistent contact [s]."""
    shapes = (g.geometry for g in traj.scene.collision_model.geometryObjects)
    radius = min(half_extent(shape) for shape in shapes if not isinstance(shape, coal.Halfspace))
    turning, kinetic = turning_rates(traj), traj.kinetic_energy
    turning, kinetic = np.maximum(turning[1:], turning[:-1]), np.maximum(kinetic[1:], kinetic[:-1])
    running = np.minimum(dt * running_rates(traj, radius), 1.0)  # one radian a step at most
    angles = dt**2 * (turning**2 + GRAVITY / radius) + running**2
    moving, resting = modification(traj, dt)
    forces = np.abs(np.diff(resting))
    if traj.events.method == "dtec":  # every impact compares parts of different lengths, whose force errors differ
        impacts = np.bincount(traj.events.array("step"), minlength=len(forces))[: len(forces)]
        forces += np.maximum(1, impacts) * (np.abs(resting[1:]) + np.abs(resting[:-1]))
    weight = GRAVITY * sum(inertia.mass for inertia in traj.scene.model.inertias)
    rounding = 1e-12 * kinetic.max() + 1e-14 * np.abs(traj.energy).max() + GAP * weight  # gaps within their tolerance
    return 0.25 * angles * kinetic + moving[1:] + moving[:-1] + forces + rounding


def modification(traj: cvi.Trajectory, dt: float) -> tuple[Array, Array]:
    """By how much the modified Hamiltonian of a step dt [s] differs from H at the nodes [J], shapes (N,).

    First what is due to the motion, as size; then what forces make of a body at rest: under gravity the same all the
    time, so that only its changes are an error.
    """
    core, still = traj.scene.core(), np.zeros_like(traj.p)
    resting, whole = (
        core.modified_energy(traj.q, p, dt, 2) - core.energy(traj.q, p).sum(axis=1) for p in (still, traj.p)
    )
    return np.abs(whole - resting), resting


def energy_laws(traj: cvi.Trajectory, dt: float) -> Iterator[Finding]:
    """H never rises, over a step and over the run; in free undamped motion with CTEC it falls by the losses alone."""
    if len(traj.t) < 2:
        return
    allowed, energy = allowed_rises(traj, dt), traj.energy
    yield from worst("energy rises in a step", np.diff(energy), allowed, traj.t[:-1])
    if traj.events.method != "dtec":  # its energy drifts by the errors of its steps (docs/theory/impacts.md)
        # the errors of the steps add up to an oscillation of (h Omega)^2 of the energy, without the quarter
        rise = (energy - np.minimum.accumulate(energy))[1:]
        yield from worst("energy rises", rise, 4.0 * np.maximum.accumulate(allowed), traj.t[1:])
    if traj.events.method == "ctec" and not np.any(traj.scene.model.damping > 0.0):
        touched = np.isin(np.arange(len(allowed)), traj.contacts.array("step")[traj.contacts.h > 0.0])
        change = np.abs(np.diff(energy + traj.ledger.loss))
        change[touched] = 0.0
        yield from worst("energy lost without a loss", change, allowed, traj.t[:-1])
