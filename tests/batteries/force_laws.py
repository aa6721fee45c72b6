"""Laws that hold for every run with forces and constraints, besides the laws of contact in contact_laws.

Constraints at position and velocity level, restitution in constrained systems, dissipated work, stick without creep,
effort limits, momentum, energy. None of the laws uses the engine's own intermediate results.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from batteries import contact_laws as laws_of_contact
from batteries.contact_laws import Array, Finding, worst
from batteries.elements import Built
from batteries.energy_laws import turning_rates

PHI = 1e-10  # [m, rad] to which constraints are satisfied at every node
# [m/s, rad/s] of 1 + |v|: momenta are solved to 1e-12, and the constraints' gradients may nearly depend on each other
RATE = 1e-9
# of 1 + |gamma_minus|: rounding of p_plus, a sum of some tens of terms, multiplied by the inverse mass matrix
GAMMA = 1e-10
STILL = 1e-12  # [m/s, rad/s] of a joint that sticks: rounding of momenta over the mass
CREEP = 1e-12  # [m, rad] over a whole rest: rounding of positions, where every step satisfies constraints anew


def constraint_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """phi = 0 and its rate 0 at nodes and impacts."""
    core, log = traj.scene.core(), traj.events
    if not traj.constraints:
        return
    phi = np.array([np.abs(core.constraint_residual(q, t)).max() for q, t in zip(traj.q, traj.t, strict=True)])
    yield from worst("constraint", phi, PHI, traj.t)
    speeds = 1.0 + np.abs(traj.v).max(axis=1)
    rate = np.array([np.abs(rates(core, *at)).max() for at in zip(traj.q, traj.v, traj.t, strict=True)])
    yield from worst("rate of a constraint", rate / speeds, RATE, traj.t)
    if len(log):
        q, t = log.array("q"), log.array("time")
        v = core.velocity(q, log.array("p_plus"))
        phi = np.array([np.abs(core.constraint_residual(x, s)).max() for x, s in zip(q, t, strict=True)])
        yield from worst("constraint at an impact", phi, PHI, t)
        rate = np.array([np.abs(rates(core, *at)).max() for at in zip(q, v, t, strict=True)])
        yield from worst("rate after an impact", rate / (1.0 + np.abs(v).max(axis=1)), RATE, t)


def rates(core: Any, q: Array, v: Array, t: float) -> Array:
    """d phi/dt."""
    return core.constraint_jacobian(q, t) @ v + core.constraint_rate(q, t)


def gradients(traj: cvi.Trajectory) -> Array:
    """Gradients of the gaps at the impacts, shape (n, nv)."""
    log, core, model = traj.events, traj.scene.core(), traj.scene.model
    rows = np.zeros((len(log), model.nv))
    for k, (kind, index, q) in enumerate(zip(*(log.array(n) for n in ("kind", "index", "q")), strict=True)):
        if kind == 0:
            rows[k] = core.gap_gradients(q)[index]
        else:
            rows[k, model.joints[int(index) // 2].idx_v] = -1.0 if index % 2 else 1.0
    return rows


def restitution_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """Single points without friction: gamma+ = -e gamma-, e of the pair or 0; the impulse is along the gradient."""
    log, core = traj.events, traj.scene.core()
    if not len(log):
        return
    a = log.arrays
    once = (np.diff(a["time"], prepend=-1.0) > 0.0) & (np.diff(a["time"], append=np.inf) > 0.0)
    explicit = (a["method"] == laws_of_contact.EXPLICIT) | (a["fallback"] != 0)
    single = (a["points"] == 1) & (a["friction"] == 0.0) & (once | (a["restitution"] > 0.0))
    if not single.any():
        return
    W = gradients(traj)
    before, after = (np.einsum("ij,ij->i", W, core.velocity(a["q"], a[name])) for name in ("p_minus", "p_plus"))
    scale = 1.0 + np.abs(before)
    k, t = single & explicit, a["time"]
    yield from worst("restitution", (np.abs(after + a["restitution"] * before) / scale)[k], GAMMA, t[k])
    yield from worst("speed of an impact", (np.abs(before - a["gamma_minus"]) / scale)[single], GAMMA, t[single])
    own = own_restitution(traj)
    other = np.abs(a["restitution"] - own) * (a["restitution"] > 0.0)
    yield from worst("another restitution", other[single], 0.0, t[single])
    rest = np.zeros(len(log))
    for i in np.flatnonzero(single):
        rows = np.vstack([W[i], core.constraint_jacobian(a["q"][i], t[i])]) if traj.constraints else W[i : i + 1]
        impulse = a["p_plus"][i] - a["p_minus"][i]
        rest[i] = np.linalg.norm(impulse - rows.T @ np.linalg.lstsq(rows.T, impulse, rcond=None)[0])
        rest[i] /= 1e-3 + np.linalg.norm(impulse)
    if not np.any(traj.scene.built().arrays.joint_friction):
        yield from worst("an impulse from elsewhere", rest[single], GAMMA, t[single])


def own_restitution(traj: cvi.Trajectory) -> Array:
    """Restitution that the scene gives for the contacts of the impacts, shape (n,)."""
    log, arrays = traj.events, traj.scene.built().arrays
    pairs = traj.scene.pair_restitution
    kinds = zip(log.array("kind"), log.array("index"), strict=True)
    return np.array([arrays.limit_restitution[i // 2] if kind else pairs[i] for kind, i in kinds])


def work_laws(traj: cvi.Trajectory, b: Built) -> Iterator[Finding]:
    """Damping and joint friction dissipate; without inputs and prescribed motions they do no work."""
    work, size = traj.work, np.abs(traj.energy).max()
    for name in ("damping", "joint_friction"):
        yield from worst(f"{name} gives", -np.diff(getattr(work, name)), 1e-13 * size, traj.t[1:])
    if not b.inputs:
        yield from worst("input without any", np.abs(work.input), 0.0, traj.t)
    if not b.driven:
        yield from worst("work of a prescribed motion without any", np.abs(work.prescribed), 1e-9 * size, traj.t)


def rest_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """A joint that sticks by its friction does not move until an impact."""
    model, limits = traj.scene.model, traj.scene.built().arrays.joint_friction
    for joint in model.joints[1:]:
        if joint.nv == 1 and limits[joint.idx_v] > 0.0:
            q, still = traj.q[:, joint.idx_q], np.abs(traj.v[:, joint.idx_v]) <= STILL
            ends = np.flatnonzero(~still | np.isin(np.arange(len(q)) - 1, traj.events.array("step")))
            for nodes in np.split(np.arange(len(q)), ends):
                inner = nodes[still[nodes]]
                inner = inner[: None if still[-1] and len(q) - 1 in inner else -1]  # at the last node it begins to slip
                yield from worst("creep", np.abs(q[inner] - q[inner[:1]]), CREEP, traj.t[inner])


def effort_laws(traj: cvi.Trajectory, b: Built) -> Iterator[Finding]:
    """Where only servos do work it is at most effort times displacement, in steps without impacts.

    Where a joint turns back in a step its way is longer than the displacement, by twice the lesser of the ways there
    and back, each of which is at most the speed at its end of the step over all of it.
    """
    kp, kd, effort = traj.scene.built().arrays.servo
    used = np.flatnonzero((kp > 0.0) | (kd > 0.0))
    others = {"push", "shake", "drag"} & set(b.elements)
    if not len(used) or others:
        return
    places = {j.idx_v: j.idx_q for j in traj.scene.model.joints[1:] if j.nv == 1}
    v = traj.v[:, used]
    back = np.where(v[1:] * v[:-1] < 0.0, np.minimum(np.abs(v[1:]), np.abs(v[:-1])), 0.0) * np.diff(traj.t)[:, None]
    way = (np.abs(np.diff(traj.q[:, [places[d] for d in used]], axis=0)) + 2.0 * back) @ effort[used]
    smooth = ~np.isin(np.arange(len(way)), traj.events.array("step"))
    smooth &= ~np.isin(np.arange(len(way)), traj.contacts.array("step"))
    excess = np.abs(np.diff(traj.work.input)) - way
    yield from worst("effort", excess[smooth], 1e-11 * (1.0 + np.abs(traj.energy).max()), traj.t[1:][smooth])


def momentum_laws(traj: cvi.Trajectory, b: Built) -> Iterator[Finding]:
    """The total momentum of free bodies changes by weights, constant forces and the impulses of ground and walls."""
    log, model = traj.contacts, traj.scene.model
    if not b.closed or len(traj.t) < 2:
        return
    places = [(j.idx_q, j.idx_v) for j in model.joints[1:]]
    momentum = np.zeros((len(traj.t), 3))
    for iq, iv in places:
        turns = [pin.Quaternion(q[iq + 3 : iq + 7]).matrix() for q in traj.q]
        momentum += np.array([turn @ p[iv : iv + 3] for turn, p in zip(turns, traj.p, strict=True)])
    steps = len(traj.t) - 1
    first = np.array([b.scene.pair_names[i][0] in ("ground", "wall") for i in range(len(b.scene.pair_names))])
    second = np.array([b.scene.pair_names[i][1] in ("ground", "wall") for i in range(len(b.scene.pair_names))])
    rows = (log.array("kind") == 0) & (log.array("step") < steps)
    sign = (1.0 * first - 1.0 * second)[log.array("index")[rows]] if rows.any() else np.zeros(0)
    pushed, size = np.zeros((steps, 3)), np.zeros(steps)
    np.add.at(pushed, log.array("step")[rows], sign[:, None] * log.impulse[rows])
    np.add.at(size, log.array("step")[rows], np.linalg.norm(log.impulse[rows], axis=1))
    mass = sum(inertia.mass for inertia in model.inertias)
    known = np.diff(traj.t)[:, None] * (mass * np.array(model.gravity.linear) + b.pushes) + pushed
    rest = np.linalg.norm(np.diff(momentum, axis=0) - known, axis=1)
    # steps are solved to 1e-12, relative to all momenta and to all terms of the sum
    bound = 1e-11 * (np.abs(traj.p).max() + size + mass * 1e-3)
    yield from worst("momentum of all", rest, bound, traj.t[1:])


def reaction_laws(traj: cvi.Trajectory) -> Iterator[Finding]:
    """The reaction of a driven slide is the change of momentum along it of all its bodies less the impulses on them."""
    model, log = traj.scene.model, traj.contacts
    if "slide" not in list(model.names) or len(traj.t) < 2:
        return
    root = model.getJointId("slide")
    below = {i for i in range(1, model.njoints) if root in list(model.supports[i])}
    shapes = {g.name for g in traj.scene.collision_model.geometryObjects if g.parentJoint in below}
    signs = np.array([1.0 * (b in shapes) - 1.0 * (a in shapes) for a, b in traj.scene.pair_names])
    steps = len(traj.t) - 1
    rows = (log.array("kind") == 0) & (log.array("step") < steps)
    pushed, size = np.zeros(steps), np.zeros(steps)
    along = signs[log.array("index")[rows]] * log.impulse[rows][:, 0] if rows.any() else np.zeros(0)
    np.add.at(pushed, log.array("step")[rows], along)
    np.add.at(size, log.array("step")[rows], np.abs(along))
    p = traj.p[:, model.joints[root].idx_v]
    impulse = traj.reactions("drive")[1:, 0] * np.diff(traj.t)
    bound = 1e-10 * (np.abs(traj.p).max() + size + np.abs(impulse))
    yield from worst("reaction of a prescribed motion", np.abs(np.diff(p) - impulse - pushed), bound, traj.t[1:])


def energy_scale(traj: cvi.Trajectory) -> float:
    """The larger one of the kinetic energy and of the range of the potential energy [J]."""
    return max(float(traj.kinetic_energy.max()), float(np.ptp(traj.potential_energy)), 1e-3)


def rate_of(traj: cvi.Trajectory, dt: float) -> float:
    """The largest rate at which bodies turn or speeds change in a step without impacts [1/s], 10 at least (gravity)."""
    change = np.linalg.norm(np.diff(traj.v, axis=0), axis=1)
    change[traj.events.array("step")[traj.events.array("step") < len(change)]] = 0.0
    speed = max(1.0, float(np.linalg.norm(traj.v, axis=1).max()))
    return max(10.0, float(turning_rates(traj).max()), float(change.max(initial=0.0)) / (dt * speed))


def energy_laws(traj: cvi.Trajectory, b: Built, dt: float) -> Iterator[Finding]:
    """H - H(0) = work of inputs and prescribed motions - damping - joint friction - losses of contact, to O(h^2).

    The bound is (h Omega)^2 of the energy; the largest error of 640 scenes was 0.46 of it. In a run without inputs and
    prescribed motions the energy does not rise by more than twice the bound.
    """
    if len(traj.t) < 3:
        return
    allowed = (dt * rate_of(traj, dt)) ** 2 * energy_scale(traj)
    yield from worst("energy balance", np.abs(traj.ledger.energy_balance), allowed, traj.t)
    if not (b.inputs or b.driven):
        rise = traj.energy - np.minimum.accumulate(traj.energy)
        yield from worst("energy rises", rise, 2.0 * allowed, traj.t)


def force_laws(traj: cvi.Trajectory, b: Built) -> Iterator[Finding]:
    """Contact forces and reactions are bounded also where constraints and contacts do not determine them uniquely.

    The bound is a thousand times (a toggle joint at 1 mrad) the impulse that stops all motion and bears the weight in a
    step.
    """
    log, dt = traj.contacts, traj.options.fixed_dt
    if b.driven or len(traj.t) < 2:
        return
    springs = np.abs(np.diff(traj.p, axis=0)).max() + np.ptp(traj.potential_energy) * dt
    weight = sum(inertia.mass for inertia in traj.scene.model.inertias) * 10.0 * dt
    bound = 1e3 * (np.abs(traj.p).max() + weight + springs)
    yield from worst("contact force", np.linalg.norm(log.impulse, axis=1), bound, log.t)
    if traj.constraints:
        reactions = np.abs(traj.forces.reactions).max(axis=1) * dt
        yield from worst("reaction", reactions, bound, traj.t)


def jams(traj: cvi.Trajectory, b: Built) -> bool:
    """Whether a prescribed motion jammed: the energy of the run grew without bound in its last step."""
    kinetic = traj.kinetic_energy
    return b.driven and not traj.status.ok and bool(kinetic[-1] > 1e3 * np.median(kinetic))


def contact_laws(traj: cvi.Trajectory, b: Built) -> Iterator[Finding]:
    """The laws of batteries.contact_laws; prescribed motions may do work in an impact."""
    found = [*laws_of_contact.gap_laws(traj), *laws_of_contact.event_laws(traj), *laws_of_contact.contact_laws(traj)]
    yield from (f for f in found if not (b.driven and f.law in ("impact gains energy", "loss < 0")))


def broken(traj: cvi.Trajectory, b: Built) -> list[Finding]:
    """Violations of all laws but those that need a second run; after NaN only those of the numbers.

    The energy laws are for runs that reached their end; for one that jams only the laws of the numbers.
    """
    found = list(laws_of_contact.number_laws(traj))
    if not found and not jams(traj, b):
        found = [
            *contact_laws(traj, b), *constraint_laws(traj), *restitution_laws(traj), *work_laws(traj, b),
            *rest_laws(traj), *effort_laws(traj, b), *momentum_laws(traj, b), *reaction_laws(traj),
            *force_laws(traj, b),
        ]  # fmt: skip
        if traj.status.ok:
            found += energy_laws(traj, b, traj.options.fixed_dt)
    return found
