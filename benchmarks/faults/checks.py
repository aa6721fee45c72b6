"""What is right and wrong in a run of a recipe, judged by its states alone, and how long it took beside MuJoCo.

- Gaps: the least of `scene.gaps` over all nodes, and that of `distances`, which does not use the engine.
- Energy, of scenes without inputs: computed by Pinocchio from the states. In a step it may rise by the error of a
  midpoint step, (h w)^2 / 4 of the kinetic energy with w the fastest turning, by dv.M dv / 12 with dv what the forces
  change the velocity by (in a step with an impact those of the step after it, if that has none, since what the impact
  changes is no part of it), and by the weight times the gap that may be left; over the run by four times the largest.
  A step whose impulses are wrong must not allow itself what they gain: dv.M dv counts PRESSED times that of the free
  motion and turning at most where the forces of one part of the step are a SPIKE, and where the energy comes to be more
  than it was in the BEFORE steps before.
- Losses: no increment of `friction_loss` or `impact_loss` is below zero, both together are what the energy falls by.
- What the run itself says: status, warnings, the gaps and rises that its records have.

A run is `wrong` where gaps or energy are and nothing in its status or records says as much as that, `told` where its
records do; `ledger` where losses or residuals alone are not as they should be; `reported` where it ends with another
status than SUCCESS, `time` where it took too long, `refused` where it did not start, `crash` where its process ended;
`slow` beyond SLOW times the time of MuJoCo; else `ok`.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import distances
import numpy as np
import pinocchio as pin
from recipes import Recipe

import contactvi as cvi
from contactvi.bench.mujoco_peer import MujocoPeer

Array = np.ndarray
DT, PEER_DT = 1e-3, 2e-3  # [s]
GAP, ENERGY, SLOW = 1e-9, 1e-6, 50.0  # [m], of the largest energy, times
RESIDUAL = 0.5  # of Coulomb's law in dense steps, over the largest free speed: docs/limits.md speaks of 0.2
PRESSED, SPIKE, BEFORE = 10.0, 30.0, 5  # times h^2 (a.M a + T w^2) of the free motion, times the forces about it, steps
SHORT = 0.2  # [s] of a run that is made again, so that its time is not that of a cold start


def measure(recipe: Recipe) -> dict[str, Any]:
    """Run a recipe and return all that is known of the run."""
    found = {"family": recipe.family, "seed": recipe.seed, "kinds": kinds(recipe), "e": recipe.restitution,
             "mu": recipe.friction}  # fmt: skip
    try:
        scene, q0, v0 = recipe.build()
        scene.core()
        traj, said, took = run(scene, q0, v0, recipe.duration)
    except cvi.ContactviError as error:
        return found | {"class": "refused", "message": f"{type(error).__name__}: {error}"[:300]}
    found |= {"status": traj.status.code.name, "reached": traj.status.time, "impacts": len(traj.events)}
    found |= {"dense": traj.stats.dense_steps, "said": said, "message": "" if traj.status.ok else traj.status.message}
    found |= gaps(scene, traj) | energies(scene, traj) | losses(traj, size(scene, traj)) | records(traj)
    seconds = min(traj.stats.seconds, took)
    if seconds < SHORT and found["reached"]:
        again, _, took = run(scene, q0, v0, recipe.duration)
        seconds = min(seconds, again.stats.seconds, took)
    found["seconds"] = seconds
    try:
        share = max(found["reached"], DT) / recipe.duration
        found["peer"] = peer_seconds(scene, q0, v0, recipe.duration)
        found["ratio"] = seconds / (found["peer"] * share)
    except cvi.ContactviError as error:
        found["message"] += f" MuJoCo: {error}"[:200]
    found["class"], found["faults"] = judge(found)
    return found


def run(scene: cvi.Scene, q0: Array, v0: Array, duration: float) -> tuple[cvi.Trajectory, list[str], float]:
    """Return a run, what it warned of, and the processor time of all of it [s]."""
    began = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        traj = cvi.simulate(scene, q0, v0, duration, dt=DT, throw=False)
    return traj, [f"{entry.category.__name__}: {entry.message}" for entry in caught], time.process_time() - began


def kinds(recipe: Recipe) -> str:
    return " ".join(item.shape + ("" if item.free else "|fixed") for item in recipe.items)


# --- gaps -------------------------------------------------------------------------------------------------------------
def gaps(scene: cvi.Scene, traj: cvi.Trajectory) -> dict[str, Any]:
    """The least gap by the engine and without it, when, of which pair, and where both differ most."""
    own = np.array([scene.gaps(q) for q in traj.q])
    names = scene.gap_names
    if not own.size:
        return {"gap": np.inf, "pair": "", "gap_time": 0.0, "free_gap": np.inf, "free_pair": "", "difference": 0.0}
    k, pair = np.unravel_index(np.nanargmin(own), own.shape)
    other = distances.Gaps(scene)
    apart = other.at(traj.q)
    count = len(other.pairs)
    row, worst = np.unravel_index(np.argmin(apart / other.slack), apart.shape) if count else (0, 0)
    near = (own[:, :count] < 1e-4) & (own[:, :count] > -1e-5) & other.exact & np.isfinite(apart)
    difference = np.abs(own[:, :count] - apart)[near].max(initial=0.0)
    return {
        "gap": float(own[k, pair]), "gap_time": float(traj.t[k]), "pair": " - ".join(names[pair]),
        "deep_time": float(traj.t[np.argmax(own.min(axis=1) < -GAP)]) if own.min() < -GAP else None,
        "free_gap": float(apart[row, worst]) if count else np.inf,
        "free_slack": float(other.slack[worst]) if count else 0.0,
        "free_time": float(traj.t[row]),
        "free_pair": " - ".join(names[worst]) if count else "", "difference": float(difference),
    }  # fmt: skip


# --- energy -----------------------------------------------------------------------------------------------------------
def energies(scene: cvi.Scene, traj: cvi.Trajectory) -> dict[str, Any]:
    """The largest rise of the energy in a step and over the run, beyond the error of the steps [J]."""
    model = scene.built().model
    data = model.createData()
    kinetic = np.array([pin.computeKineticEnergy(model, data, q, v) for q, v in zip(traj.q, traj.v, strict=True)])
    energy = kinetic + np.array([pin.computePotentialEnergy(model, data, q) for q in traj.q])
    formal, capped = allowed_rises(model, traj, kinetic, energy)
    rises, largest = np.diff(energy), size(scene, traj)
    before = np.array([energy[max(0, k - BEFORE) : k + 1].max() for k in range(len(rises))])
    net = energy[1:] - before - capped
    beyond = np.maximum(rises - np.where(spikes(traj), capped, formal), net)
    over = energy - np.minimum.accumulate(energy) - 4.0 * formal.max(initial=0.0)
    k = int(np.argmax(beyond)) if len(beyond) else 0
    return {
        "energy": float(max(beyond.max(initial=0.0), 0.0) / largest), "energy_time": float(traj.t[k]),
        "rise": float(rises.max(initial=0.0)), "allowed": float(formal[k]) if len(beyond) else 0.0,
        "over_run": float(max(over.max(), 0.0) / largest), "over_time": float(traj.t[np.argmax(over)]),
        "largest": largest, "mismatch": float(np.abs(energy - traj.energy).max() / largest),
        "dense_there": in_dense(traj, float(traj.t[k])),
    }  # fmt: skip


def in_dense(traj: cvi.Trajectory, t: float) -> bool:
    steps = traj.dense_steps
    return bool(len(steps) and np.any((steps["t"] >= t - 1e-12) & (steps["t"] < t + DT)))


def spikes(traj: cvi.Trajectory) -> Array:
    """Whether the forces of a part of each step were far larger than those about it, impacts left out, (N - 1,)."""
    rows, steps = traj.contacts, len(traj.t) - 1
    found = np.zeros(steps, dtype=bool)
    lasting = rows.h > 0.0
    starts, part = np.unique(rows.t[lasting], return_inverse=True)
    force = np.zeros(len(starts))
    np.add.at(force, part, np.linalg.norm(rows.impulse[lasting], axis=1) / rows.h[lasting])
    step = np.clip(np.searchsorted(traj.t, starts + 1e-12, side="right") - 1, 0, max(steps - 1, 0))
    for k in np.unique(step):
        about = force[np.abs(step - k) <= 1]
        found[k] = force[step == k].max() > SPIKE * np.median(about)
    return found


def allowed_rises(model: pin.Model, traj: cvi.Trajectory, kinetic: Array, energy: Array) -> tuple[Array, Array]:
    """Bounds on the rise of the energy in each step [J], shapes (N - 1,): the documented one, and the capped one."""
    data, steps = model.createData(), len(traj.t) - 1
    h = np.diff(traj.t)
    hit = np.zeros(steps, dtype=bool)
    if len(traj.events):
        hit[np.clip(np.searchsorted(traj.t, traj.events.array("time"), side="right") - 1, 0, steps - 1)] = True
    if len(traj.dense_steps):
        hit[np.clip(np.searchsorted(traj.t, traj.dense_steps["t"] + 1e-9, side="right") - 1, 0, steps - 1)] = True
    rates = np.array([turning(model, data, q, v) for q, v in zip(traj.q, traj.v, strict=True)])
    rates = np.maximum(rates[1:], rates[:-1])
    error = 0.25 * (h * rates) ** 2 * np.maximum(kinetic[1:], kinetic[:-1])
    forces, free_only = np.zeros(steps), np.zeros(steps)
    for k in range(steps):
        mass = np.triu(pin.crba(model, data, traj.q[k]))
        mass += np.triu(mass, 1).T
        free = -h[k] * np.linalg.solve(mass, pin.nonLinearEffects(model, data, traj.q[k], traj.v[k]))
        dv, own = traj.v[k + 1] - traj.v[k], free @ mass @ free
        forces[k] = own if hit[k] else max(dv @ mass @ dv, own)
        free_only[k] = own + (h[k] * rates[k]) ** 2 * max(kinetic[k], kinetic[k + 1])
    after = np.append(hit[1:], True)
    forces[:-1] = np.where(hit[:-1] & ~after[:-1], np.maximum(forces[:-1], forces[1:]), forces[:-1])
    capped = np.minimum(forces, PRESSED * free_only)
    weight = 9.81 * sum(inertia.mass for inertia in list(model.inertias)[1:])
    error += GAP * weight + 1e-12 * np.abs(energy).max()
    return error + forces / 12.0, error + capped / 12.0


def turning(model: pin.Model, data: pin.Data, q: Array, v: Array) -> float:
    """Return the fastest turning of a body at a state [rad/s]."""
    pin.forwardKinematics(model, data, q, v)
    return max(np.linalg.norm(data.v[i].angular) for i in range(1, model.njoints))


def size(scene: cvi.Scene, traj: cvi.Trajectory) -> float:
    """The energy that others are compared with [J]: the largest kinetic one, the largest change, or a fall by 1 mm."""
    fall = 1e-3 * 9.81 * sum(inertia.mass for inertia in list(scene.built().model.inertias)[1:])
    return float(max(traj.kinetic_energy.max(), np.ptp(traj.energy), fall))


def losses(traj: cvi.Trajectory, size: float) -> dict[str, Any]:
    """The least increment of each loss, and what both together say beyond the fall of the energy, over the size."""
    found: dict[str, Any] = {}
    both = np.zeros(len(traj.t))
    error = np.zeros(len(traj.t))  # of dense steps, which say how far their losses may be wrong
    ends = np.searchsorted(traj.t, traj.dense_steps.end - 1e-9)
    np.add.at(error, np.minimum(ends, len(error) - 1), traj.dense_steps["energy_error"])
    for name in ("friction_loss", "impact_loss"):
        loss = getattr(traj, name)
        both += loss
        steps = np.diff(loss) + error[1:]
        found |= {name: float(min(steps.min(initial=0.0), 0.0) / size)}
        found |= {f"{name}_time": float(traj.t[int(np.argmin(steps))]) if len(steps) else 0.0}
    work = traj.work
    balance = np.diff(traj.energy + both + work.damping + work.joint_friction)
    k = int(np.argmax(np.abs(balance))) if len(balance) else 0
    return found | {"balance": float(balance[k] / size) if len(balance) else 0.0, "balance_time": float(traj.t[k])}


def records(traj: cvi.Trajectory) -> dict[str, Any]:
    """What the run's records admit: least gap [m] and the rise of the energy over the largest kinetic energy."""
    steps, rows = traj.dense_steps, traj.contacts
    least = min(steps["gap"].min(initial=0.0), rows.array("gap").min(initial=0.0))
    rise = steps["energy_rise"].max(initial=0.0) / max(traj.kinetic_energy.max(), 1e-12)
    residual = steps["residual"].max(initial=0.0)
    return {"said_gap": float(least), "said_rise": float(rise), "residual": float(residual),
            "halved": traj.stats.halved}  # fmt: skip


# --- MuJoCo -----------------------------------------------------------------------------------------------------------
def peer_seconds(scene: cvi.Scene, q0: Array, v0: Array, duration: float) -> float:
    """Return the time of MuJoCo's steps of 2 ms for the same scene, the least of three runs [s]."""
    peer = MujocoPeer(scene, PEER_DT)
    steps, seconds = round(duration / PEER_DT), np.inf
    for _ in range(3):
        data = peer.data(q0, v0)
        began = time.process_time()
        peer.mujoco.mj_step(peer.model, data, nstep=steps)
        seconds = min(seconds, time.process_time() - began)
    return seconds


# --- judgement --------------------------------------------------------------------------------------------------------
def judge(found: dict[str, Any]) -> tuple[str, list[str]]:
    """Return the class of a run, and its faults in words."""
    faults, silent = [], False
    if found["gap"] < -GAP:
        faults.append(f"gap {found['gap']:.1e} m of {found['pair']} at {found['gap_time']:.4f} s")
        silent |= found["said_gap"] > 0.5 * found["gap"]
    if found["free_gap"] < -found["free_slack"] and found["gap"] > found["free_gap"] / 2:
        faults.append(
            f"gap by closed form {found['free_gap']:.1e} m of {found['free_pair']} at {found['free_time']:.4f} s"
        )
        silent = True
    if found["difference"] > 1e-8:
        faults.append(f"distances differ by {found['difference']:.1e} m near contact")
        silent = True
    for name, when in (("energy", "energy_time"), ("over_run", "over_time")):
        if found[name] > ENERGY:
            where = " in a dense step" if name == "energy" and found["dense_there"] else ""
            faults.append(f"{name} rises by {found[name]:.1e} of the largest at {found[when]:.4f} s{where}")
            silent |= found["said_rise"] < 0.1 * found[name]
    for name in ("friction_loss", "impact_loss"):
        if found[name] < -1e-5:
            faults.append(f"{name} falls by {-found[name]:.1e} of the largest energy at {found[name + '_time']:.4f} s")
    if abs(found["balance"]) > 1e-3:
        faults.append(f"losses and energy differ by {found['balance']:.1e} of it at {found['balance_time']:.4f} s")
    if found["residual"] > RESIDUAL:
        faults.append(f"residual of Coulomb's law {found['residual']:.1e} of the largest free speed")
    if found["mismatch"] > 1e-9:
        faults.append(f"traj.energy differs by {found['mismatch']:.1e}")
        silent = True
    slow = found.get("ratio", 0.0) > SLOW
    if slow:
        faults.append(f"{found['ratio']:.0f} times MuJoCo's time, {found['seconds']:.2f} s")
    if found["status"] == "INTERRUPTED":
        return "time", faults
    if found["status"] != "SUCCESS":
        return "reported", [found["status"], *faults]
    if silent:
        return "wrong", faults
    hard = [
        fault
        for fault in faults
        if not fault.startswith(("friction", "impact", "losses", "residual")) and "MuJoCo" not in fault
    ]
    if hard:
        return "told", faults
    if slow:
        return "slow", faults
    return ("ledger" if faults else "ok"), faults
