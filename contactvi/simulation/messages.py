"""Messages about how a run ended: the engine's status with names instead of numbers, and what to do about it."""

from __future__ import annotations

from contactvi.records.codes import GuardKind
from contactvi.simulation.compatibility import NO_ANSWER_DTEC
from contactvi.simulation.results import EngineStatus
from contactvi.status import StatusCode

REACHED = "the run reached its end"
REMEDY = {
    StatusCode.NEWTON_FAILED: "Use a smaller dt",
    StatusCode.NOT_FINITE: "Use a smaller dt, and look for huge forces or tiny masses",
    StatusCode.IMPACT_UNSOLVED: "Use a smaller dt, or another impact map",
    StatusCode.EVENT_UNRESOLVED: "Use a smaller dt",
    StatusCode.TOO_MANY_IMPACTS: "Use a smaller dt, or raise max_impacts_per_step",
    StatusCode.PENETRATION: "start='separate' moves it apart by the least, scene.separate(q0) tells what that moves; "
    "scene.disable_overlapping(q0) takes out the pairs within one model that overlap there, scene.disable_pair(a, b) "
    "any pair",
    StatusCode.CONSTRAINT: "Mend the prescribed motions and lengths, or use a smaller dt",
    StatusCode.TOO_MANY_STEPS: "Look for huge forces, stiff springs and tiny masses; use a larger tol, or a shorter "
    "duration",
    StatusCode.INTERRUPTED: "Run it again; error.trajectory holds what was computed until then",
    StatusCode.LEDGER: "Look at error.trajectory.ledger there; use a smaller dt, or another tolerance",
}


def remedy(code: StatusCode, contact_mode: str, zeno: str = "end", impact: str = "dtec") -> str:
    """Return what to do about a run with these options that ended so."""
    if code == StatusCode.ZENO:
        needed = ["zeno='hold'"] * (zeno == "end") + ["impact='ctec' or 'mhc'"] * (impact == "dtec")
        return f"Use {' and '.join(needed)}: the run then goes on with a persistent contact"
    text = REMEDY.get(code, "This is a bug: please report it with the scene")
    left_to_dense = (StatusCode.EVENT_UNRESOLVED, StatusCode.TOO_MANY_IMPACTS, StatusCode.IMPACT_UNSOLVED)
    if contact_mode == "events" and code in left_to_dense:
        return f"{text}. Where events accumulate contact_mode='auto' goes on with dense steps"
    return text


def describe(code: StatusCode, result: EngineStatus, names: tuple[str, str] | None, impact: str) -> str:
    """Return the engine's message with the names of its pair or limit; `impact` is the map of the run."""
    if code == StatusCode.SUCCESS:
        return REACHED
    pair = "" if names is None else f"{names[0]!r} and {names[1]!r}"
    limit = GuardKind(result["guard_kind"].value) == GuardKind.LIMIT
    if code == StatusCode.INTERRUPTED:
        return "stopped by the user"
    if code == StatusCode.ZENO and names is not None:
        what = f"the impacts of joint {names[0]!r} at its {names[1]}" if limit else f"the impacts of {pair}"
        text = f"{what} accumulate at t = {result['accumulation_time']:.12g} s"
        return f"{text}; {NO_ANSWER_DTEC}" if impact == "dtec" else text
    if code == StatusCode.PENETRATION and names is not None:
        depth = f"{result['depth']:.6g}"
        if limit:
            return f"joint {names[0]!r} is {depth} (rad or m) beyond its {names[1]}"
        return f"{pair} overlap by {depth} m"
    return f"{result['message']} ({pair})" if pair else result["message"]
