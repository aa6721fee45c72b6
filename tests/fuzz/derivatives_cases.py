"""Derivatives of drawn scenes and runs, with arguments that are good or of wrong kinds. A case is a small program."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from fuzz import arguments_cases, law
from fuzz.draws import Case, Draws
from fuzz.scene_file_cases import ARM

WRT = (
    *("'q0'", "'v0'", "'control'", "('q0', 'v0')", "['q0', 'v0', 'control']", "'restitution'", "'friction'"),
    *("'gravity'", "'target'", "'target_velocity'", "'restitution:ball|ground'", "'friction:ball|ground'"),
    *("'mass:elbow'", "'inertia:shoulder'", "'armature:elbow'", "'stiffness:elbow'", "'damping:elbow'", "'rest:elbow'"),
    *("'kp:elbow'", "'kd:elbow'", "'mass:ball'", "('q0', 'friction', 'gravity')", "['restitution', 'v0']"),
)
COST = (
    "(np.zeros(s.nv), np.ones(s.nv))",
    "(np.ones((len(traj.t), s.nv)), np.ones((len(traj.t), s.nv)))",
    "(lambda t, q, v: (0.5 * float(np.sum(v * v)), np.zeros_like(v), v))",
    "(lambda t, q, v: (1, np.ones(v.shape[1]), np.zeros(v.shape[1])))",
)
# Costs of wrong kinds, besides what stands for any argument.
NO_COST = (
    *("(lambda t, q, v: None)", "(lambda t, q, v: (1, 2, 3))", "(lambda t, q, v: ('a', v, v))", "(lambda t: 0.0)"),
    *("(lambda t, q, v: (nan, v, v))", "(lambda t, q, v: (0.0, nan * v, v))", "(lambda t, q, v: ([1, 2], v, v))"),
    *("(lambda t, q, v: (1j, v, v))", "(lambda t, q, v: (0.0, v[:1], v))", "(np.zeros(s.nv), None)", "(1, 2)"),
    *("('a', 'b')", "(np.zeros((2, 2)), np.zeros(s.nv))", "(np.zeros((1, s.nv)), np.zeros(s.nv))", "np.zeros((2, 3))"),
    *("[np.zeros(s.nv), np.zeros(s.nv)]", "(lambda t, q, v: 1 / 0)", "(1e300 * np.ones(s.nv), np.ones(s.nv))"),
)
VALUES = arguments_cases.VALUES | {
    "WRT": WRT,
    "ONE": ("'q0'", "'v0'", "'control'", "'friction'"),
    "COST": COST,
    "KINK": ("'raise'", "'taken'"),
    "KIND": ("'velocity'", "'momentum'"),
    "STEP": ("1e-3", "0.01", "0.1"),
    "FEW": ("1", "2", "3"),
    "SEED": ("0", "7", "123456"),
    "ITEM": ("traj", "other", "s"),
    "SCN": ("s",),
    "TIME": ("0.0", "traj.t[-1]", "traj.t", "[0.001, 0.0]", "0.5 * traj.t[-1]"),
}
RUN = (
    "traj = cvi.simulate(s, Q, V, LONG, 1e-3, record='gradient', order=ORDER, impact=MAP, throw=False)",
    "traj = cvi.simulate(s, Q, V, LONG, 1e-3, record='gradient', contact_mode=MODE, throw=False)",
    "traj = cvi.simulate(s, duration=LONG, dt=1e-3, control=CONTROL, target=TARGET, record='gradient', throw=False)",
    "traj = cvi.simulate(s, duration=LONG, dt=1e-3, record='gradient', zeno=MAP, solver_tol=TOL, throw=False)",
    "traj = cvi.simulate(s, duration=LONG, dt=DT, record='gradient', sample_dt=SAMPLE, throw=False)",
)
CALLS = (
    "cvi.linearize(SCN, Q, V, TAU, STEP, order=ORDER, target=TARGET, t=SHARE, state=KIND)",
    "cvi.linearize(s, s.neutral(), V)",
    "cvi.step_derivatives(SCN, Q, V, TAU, STEP, order=ORDER, target=TARGET, t=SHARE, state=KIND)",
    "cvi.step_derivatives(s, s.neutral(), V, dt=STEP, order=ORDER)",
    "cvi.forward_dynamics_derivatives(SCN, Q, V, TAU, target=TARGET, t=SHARE)",
    "cvi.forward_dynamics_derivatives(s, s.neutral(), V, TAU)",
    "cvi.check_gradient(SCN, Q, V, LONG, 1e-3, wrt=ONE, columns=FEW, seed=SEED, tolerance=SHARE, on_kink=KINK)",
    "cvi.check_gradient(s, Q, V, 0.01, 5e-3, wrt=WRT, columns=FEW, order=ORDER, impact=MAP, control=CONTROL)",
    "traj.sensitivity(WRT, on_kink=KINK)",
    "traj.sensitivity(WRT)",
    "traj.sensitivity(ONE).at(TIME)",
    "traj.sensitivity(('q0', 'v0')).of(ONE)",
    "str(traj.sensitivity(ONE, on_kink='taken').report)",
    "traj.gradient(COST, WRT, on_kink=KINK)",
    "cvi.gradient(traj, COST, WRT, on_kink=KINK)",
    "cvi.gradient(traj, COST)",
    "cvi.gradient(traj, COST, WRT)",
    "cvi.gradient(ITEM, COST, WRT)",
)
BASES = ("arm", "ball", "both", "both", "box", "nothing")


def draw(d: Draws) -> Case:
    """Return a case: the scene to begin with, and lines of Python."""
    wrong = d.pick((0, 0, 0, 3, 10, 25))
    lines = [_line(d, d.pick(arguments_cases.SCENE), d.pick((0, wrong))) for _ in range(d.pick((0, 0, 1, 2, 4)))]
    if d.chance(80):
        lines.append(_line(d, d.pick(RUN), d.pick((0, 0, wrong))))
    lines += ["found = " + _line(d, d.pick(CALLS), wrong) for _ in range(d.whole(1, 3))]
    speed = [d.number(-2, 2) for _ in range(3)]
    return {"base": d.pick(BASES), "gap": d.pick((0.0, 1e-3, 0.01, 1.0)), "speed": speed, "lines": lines}


def _line(d: Draws, template: str, wrong: int) -> str:
    if "COST" in template and d.chance(wrong):
        template = template.replace("COST", d.pick(NO_COST))
    return arguments_cases.line(d, template, wrong, VALUES)


def prelude(case: Case) -> dict[str, Any]:
    """Return the names that a program finds: a scene, its handles, a run with derivatives and one without."""
    s = cvi.Scene()
    base, gap = case["base"], case["gap"]
    names: dict[str, Any] = {"ball": "ball", "arm": "elbow"}
    if base != "arm":
        s.add_halfspace(name="ground")
        s.set_contact(restitution=0.5, friction=0.3)
    if base in ("ball", "both"):
        names["ball"] = s.add_sphere("ball", 0.1, placement=(3, 0, 0.1 + gap))
    if base == "box":
        names["ball"] = s.add_box("ball", (0.2, 0.3, 0.1), placement=(3, 0, 0.05 + gap))
    if base in ("arm", "both"):
        Path("arm.urdf").write_text(ARM)
        names["arm"] = s.add_urdf("arm.urdf", placement=(0, 0, 2), friction=False)
    v0 = np.resize(np.array(case["speed"]), s.nv)
    names |= {"s": s, "cvi": cvi, "np": np, "pin": pin, "nan": float("nan"), "inf": float("inf"), "found": None}
    s.v0 = v0
    names["other"] = cvi.simulate(s, duration=5e-3, dt=1e-3, throw=False)
    names["traj"] = cvi.simulate(s, duration=0.01, dt=1e-3, record="gradient", throw=False) if s.nv else names["other"]
    names["sim"] = cvi.Simulator(s, 1e-3)
    return names | {"Fraction": Fraction, "Path": Path}


def attempt(case: Case) -> bool:
    """Run the program line by line; a line that is refused leaves what was there."""
    names = prelude(case)
    refused: cvi.ContactviError | None = None
    any_found = False
    for line in case["lines"]:
        names["found"] = None
        try:
            exec(line, names)
        except cvi.ContactviError as error:
            refused = error
        except ZeroDivisionError:
            if "1 / 0" not in line:  # a function of the program may fail as it likes
                raise
        check_values(line.partition("(")[0], names["found"])
        any_found |= names["found"] is not None
    if refused is not None and not any_found:
        raise refused
    return any_found


def check_values(name: str, found: Any) -> None:
    """Raise NotFiniteError where a result has NaN among its numbers."""
    if isinstance(found, (float, np.ndarray)):
        if np.any(np.isnan(np.asarray(found, dtype=float))):
            raise law.NotFiniteError(f"{name}: NaN in {found!r}")
    elif isinstance(found, Mapping):
        for key, value in found.items():
            check_values(f"{name} {key}", value)
    elif isinstance(found, (tuple, list)):
        for value in found:
            check_values(name, value)
    elif dataclasses.is_dataclass(found):
        for part in dataclasses.fields(found):
            check_values(f"{name} {part.name}", getattr(found, part.name))
    elif hasattr(found, "matrix"):
        check_values(f"{name} matrix", found.matrix)
        check_values(f"{name} event_times", found.event_times)
        check_values(f"{name} report", found.report)
