"""The law of every case: it is refused with an error of ours, or what comes of it is finite and ends as documented."""

from __future__ import annotations

import math
import traceback
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from fuzz.draws import Case

# Of a case that is accepted; "ran": it also made steps.
ACCEPTED, RAN, REFUSED = "accepted", "ran", "refused"
# Findings.
FOREIGN, WARNED, NOT_FINITE = "foreign", "warned", "not finite"


class NotFiniteError(Exception):
    """A result has numbers that are not finite, or a status that is not documented."""


def judge(attempt: Callable[[Case], bool], case: Case) -> tuple[str, str, str]:
    """Make the case; return the outcome, a line that tells findings of one kind from others, and details."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            outcome, where, text = (RAN if attempt(case) else ACCEPTED), "", ""
        except cvi.ContactviError as error:
            outcome, where, text = REFUSED, "", str(error)
        except NotFiniteError as error:
            outcome, where, text = NOT_FINITE, str(error).partition(":")[0], str(error)
        except (Exception, RecursionError) as error:
            outcome, where, text = FOREIGN, _place(error), "".join(traceback.format_exception(error))
    leaked = [entry for entry in heard if issubclass(entry.category, RuntimeWarning)]
    if leaked and outcome in (RAN, ACCEPTED, REFUSED):
        first = leaked[0]
        where = f"{first.category.__name__} {_short(first.filename)}:{first.lineno} {first.message}"
        return WARNED, where, where
    return outcome, where, text


def _place(error: BaseException) -> str:
    """Return the kind of an error and the last line of the package that it went through."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "/contactvi/" in frame.filename] or frames[-1:]
    last = own[-1]
    return f"{type(error).__name__} {_short(last.filename)}:{last.lineno} {last.name}"


def _short(file: str) -> str:
    return "/".join(file.split("/")[-2:])


# --- runs -------------------------------------------------------------------------------------------------------------


def run_briefly(scene: cvi.Scene, settings: Case) -> bool:
    """Run an accepted scene for a few steps and check the run; return whether it made any. It may be refused."""
    dt, steps = settings["dt"], settings["steps"]
    names = ("order", "impact", "contact_mode")
    chosen = {name: settings[name] for name in names if settings[name] is not None}
    try:
        q0 = (
            None
            if settings["dq"] is None
            else pin.integrate(scene.model, scene.neutral(), _fill(settings["dq"], scene))
        )
        v0 = None if settings["v"] is None else _fill(settings["v"], scene)
        tau = None if settings["tau"] is None else np.tile(_fill(settings["tau"], scene), (steps, 1))
        traj = cvi.simulate(scene, q0, v0, duration=steps * dt, dt=dt, control=tau, throw=False, **chosen)
    except cvi.ContactviError:
        return False
    check_run(traj)
    return traj.stats.steps > 0


def _fill(values: list[float], scene: cvi.Scene) -> np.ndarray:
    return np.resize(np.array(values, dtype=float), scene.nv)


def check_run(traj: cvi.Trajectory) -> None:
    """Raise NotFiniteError where a run has numbers that are not finite, or no documented status."""
    if not isinstance(traj.status.code, cvi.StatusCode) or not math.isfinite(traj.status.time):
        raise NotFiniteError(f"status: {traj.status!r}")
    for name in ("t", "q", "v", "p", "kinetic_energy", "potential_energy"):
        check_numbers(name, getattr(traj, name), traj)
    for name in ("time", "q", "p_minus", "p_plus", "impulse", "gap"):
        if name in traj.events.arrays:
            check_numbers(f"events {name}", traj.events.array(name), traj)
    for name in ("t", "h", "position", "impulse"):
        if name in traj.contacts.arrays:
            check_numbers(f"contacts {name}", traj.contacts.array(name), traj)
    check_numbers("end of the run", np.array([traj.t[-1] - traj.status.time]), traj)


def check_numbers(name: str, values: Any, what: object = "") -> None:
    """Raise NotFiniteError unless all numbers are finite."""
    bad = np.flatnonzero(~np.isfinite(np.asarray(values, dtype=float)))
    if len(bad):
        raise NotFiniteError(f"{name}: {np.asarray(values, dtype=float).ravel()[bad[0]]} at {bad[0]} of {what!r}")
