"""The summary of a run on the command line, as pairs of a name and a text."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from contactvi.status import Stats
    from contactvi.trajectory.trajectory import Trajectory


def summary(traj: Trajectory) -> list[tuple[str, str]]:
    """Return the summary of a run: names and texts, an empty name continues the line above."""
    stats, events = traj.stats, traj.events
    limits = int((events.array("kind") == 1).sum())
    span = float(traj.t[-1] - traj.t[0])
    energy, taken = traj.energy, _by_impacts(traj)
    dense = float(traj.dense_steps["energy_loss"].sum())
    slid = float(traj.friction_loss[-1]) - dense
    put_in, known = _works(traj)
    lost = _lost(slid, "sliding") + _lost(dense, "dense steps")
    rest = float(energy[-1] - energy[0]) - taken + slid + dense - known
    scale = float(traj.kinetic_energy.max())
    share = f" ({rest / scale:+.2g} of the largest kinetic energy)" if scale > 0 else ""
    cause = "integration error" if traj.forces is not None else "damping, inputs and integration error"
    guards = stats.guards_evaluated + stats.guards_skipped
    skipped = f", {100.0 * stats.guards_skipped / guards:.3g} % of the guards skipped" if guards else ""
    iterations = f"{stats.stage_iterations} stage iterations"
    distances = f", {stats.distances / stats.steps:.3g} distances per step" if stats.distances and stats.steps else ""
    factor = f"{span / stats.seconds:.4g} x real time" if stats.seconds > 0 else ""
    return [
        ("status", f"{traj.status.code.name}: {traj.status.message}"),
        ("time", f"{span:.9g} s simulated in {stats.steps} steps{_rejected(stats)}"),
        ("method", traj.stepping),
        ("impacts", f"{len(events)}" + (f", {limits} of them at joint limits" if limits else "")),
        *_map_lines(traj, scale),
        *_contact_lines(traj),
        *_dense_lines(traj),
        *_constraint_lines(traj),
        ("energy", f"{energy[0]:.9g} J at the start, {energy[-1]:.9g} J at the end"),
        ("", f"{taken:+.6g} J by impacts{lost}{put_in}, {rest:+.3g} J by {cause}{share}"),
        ("wall time", f"{stats.seconds:.3g} s, {factor}"),
        ("work", f"{iterations}, {stats.factorizations} factorizations{skipped}{distances}"),
    ]


def _rejected(stats: Stats) -> str:
    """Return how many steps were repeated with a shorter length, in words."""
    texts = [f"{stats.halved} halved" * bool(stats.halved), f"{stats.rejected} rejected" * bool(stats.rejected)]
    repeated = ", ".join(text for text in texts if text)
    return f" ({repeated})" if repeated else ""


def _map_lines(traj: Trajectory, scale: float) -> list[tuple[str, str]]:
    """Return the line of the impact map of a run, none for CTEC."""
    events = traj.events
    if events.method == "ctec" or not len(events):
        return []
    fallbacks = int((events.array("fallback") != 0).sum())
    solved = np.abs(events.array("jump")[events.array("fallback") == 0])
    own = {"dtec": "discrete energy", "mhc": "modified Hamiltonian"}.get(events.method, "its own scalar")
    text = f"{events.method.upper()}, {int(events.array('iterations').sum())} evaluations"
    if len(solved) and scale > 0:
        text += f", {own} kept to {solved.max() / scale:.2g} of the largest kinetic energy"
    if fallbacks:
        text += f", {fallbacks} fallbacks to CTEC"
    return [("map", text)]


def _by_impacts(traj: Trajectory) -> float:
    """Return the change of the energy by impacts [J], without the work that prescribed motion does in them."""
    driven = any(row.driven for row in traj.scene.built().elements.constraints)
    return -float(traj.impact_loss[-1]) if driven else float(traj.impact_energy[-1])


def _works(traj: Trajectory) -> tuple[str, float]:
    """Return the work of inputs, prescribed motion, damping and joint friction in words, and their sum [J]."""
    if traj.forces is None:
        return "", 0.0
    work = traj.work
    parts = {
        "inputs": float(work.input[-1]),
        "prescribed motion": float(work.prescribed[-1]),
        "damping": -float(work.damping[-1]),
        "joint friction": -float(work.joint_friction[-1]),
    }
    return "".join(f", {value:+.6g} J by {name}" for name, value in parts.items() if value), sum(parts.values())


def _constraint_lines(traj: Trajectory) -> list[tuple[str, str]]:
    """Return the line of the constraints: how many there are, and the largest reaction."""
    if not traj.constraints:
        return []
    largest = {row.name: float(np.abs(traj.reactions(row.name)).max()) for row in traj.constraints}
    name = max(largest, key=lambda key: largest[key])
    count, rows = len(largest), sum(row.rows for row in traj.constraints)
    text = f"{count} constraints with {rows} equations, largest {largest[name]:.4g} N or N m at {name!r}"
    return [("reactions", text)]


def _lost(loss: float, cause: str) -> str:
    return f", {-loss:+.6g} J by {cause}" if loss else ""


def _dense_lines(traj: Trajectory) -> list[tuple[str, str]]:
    """Return the line of dense steps: how many, how long, how exact."""
    steps = traj.dense_steps
    if not len(steps):
        return []
    span = float(traj.status.time - traj.t[0])
    count = f"{len(steps)} dense {'steps' if len(steps) > 1 else 'step'} for {steps.span:.4g} s of {span:.4g} s"
    return [("dense", f"{count}: impacts inside them have no times"), ("", steps.worst())]


def _contact_lines(traj: Trajectory) -> list[tuple[str, str]]:
    """Return the lines of persistent contact and constrained steps: how long, how exact, at what cost."""
    stats = traj.stats
    if not stats.contact_steps:
        return []
    lines = []
    if len(traj.contacts):
        ledger = traj.ledger.contacts
        gap, complementarity = (float(np.abs(values).max()) for values in (ledger.gap, ledger.complementarity))
        force = np.linalg.norm(traj.contacts.force[traj.contacts.has_force], axis=1)
        strongest = float(force.max(initial=0.0))
        pairs = len(traj.contacts.pairs)
        text = f"{pairs} {'pairs' if pairs > 1 else 'pair'} touched, largest force at a point {strongest:.4g} N"
        lines.append(text)
        lines.append(f"gaps kept to {gap:.2g} m, gap times impulse to {complementarity:.2g} N s m")
    what = "constrained steps" if traj.scene.built().constrained else "steps in contact"
    each = 1e6 * stats.contact_seconds / stats.contact_steps
    rounds = f"{stats.contact_iterations / stats.contact_steps:.3g} iterations of its contact equations"
    work = f"{rounds} and {each:.3g} us per step"
    solver = f"{stats.cone_problems} contact problems, {stats.cone_iterations} Newton iterations for them"
    fallbacks = f", {stats.cone_fallbacks} by another solver" if stats.cone_fallbacks else ""
    lines.append(f"{stats.contact_steps} {what}, {work}, {solver}{fallbacks}")
    return [("" if k else "contact", line) for k, line in enumerate(lines)]
