"""Calls of the public functions with arguments of wrong kinds and extreme numbers. A case is a small program."""

from __future__ import annotations

import contextlib
import copy
import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from fuzz import law
from fuzz.draws import EXTREME, Case, Draws
from fuzz.scene_file_cases import ARM, SRDF

# What stands for an argument and is mostly wrong, in Python.
WRONG = (
    *(
        "None",
        "True",
        "False",
        "nan",
        "inf",
        "-inf",
        "0",
        "-1",
        "1",
        "2",
        "10**400",
        "-10**400",
        "2**63",
        "2**31",
        "1e300",
    ),
    *(
        "''",
        "'a'",
        "'ball'",
        "'*'",
        "'world'",
        "'\\ud800'",
        "'a\\0b'",
        "b'ab'",
        "[]",
        "()",
        "{}",
        "set()",
        "[1]",
        "[1, 2]",
    ),
    *(
        "(0, 0, 1)",
        "[nan, 0, 0]",
        "[1, 'a', 2]",
        "[[1, 2], [3]]",
        "[None, None, None]",
        "np.zeros(3)",
        "np.zeros((2, 2))",
    ),
    *(
        "np.zeros(0)",
        "np.full(7, nan)",
        "np.eye(4)",
        "np.array('a')",
        "np.array(1.5)",
        "np.array([1, 2], dtype=object)",
    ),
    *(
        "np.float32(0.5)",
        "np.int64(3)",
        "np.bool_(True)",
        "np.ones(3, dtype=complex)",
        "Fraction(1, 3)",
        "1j",
        "object()",
    ),
    *("lambda *a: 0.0", "lambda *a: nan", "lambda *a: 'x'", "lambda *a: None", "lambda *a: np.zeros(99)", "lambda: 1"),
    *(
        "lambda *a: 1 / 0",
        "(i for i in range(3))",
        "range(3)",
        "{'a': 1}",
        "{'elbow': 0.1}",
        "{1: 2}",
        "{'elbow': nan}",
    ),
    *(
        "s",
        "ball",
        "arm",
        "pin.SE3.Identity()",
        "np.nan * np.eye(4)",
        "float",
        "Ellipsis",
        "'auto'",
        "np.ma.masked",
        "'x' * 99",
    ),
    *(
        "slice(1, 2)",
        "-0.0",
        "np.array([0, 0, 0, 0, 0, 0, 1.0])",
        "((0, 0, 1), (0, 0, 0))",
        "frozenset(['a'])",
        "Path('.')",
    ),
)
BODY = ("'ball'", "'upper'", "'lower'", "ball", "'world'")
JOINT = ("'elbow'", "'shoulder'", "'*'", "arm")
NAME = ("None", "'e1'", "'e2'")
POINT = ("(0, 0, 0.1)", "[0.1, 0, 0]", "np.zeros(3)")
MOTION = (
    "0.1",
    "([0, 1, 2], [0, 0.1, 0.3])",
    "lambda t: 0.1 * t",
    "lambda t: (0.1 * t, 0.1, 0.0)",
    "np.polynomial.Polynomial([0, 1])",
)
PLACE = ("None", "(4, 4, 1)", "((4, 4, 1), (0, 0, 1))", "pin.SE3.Identity()")
SHARE = ("0", "0.5", "1", "0.3")
FLAG = ("True", "False")
SOME = ("0.1", "1", "2.5")
LONG = ("0.01", "0.02")  # durations: others would ask for hours of work, and get them
# Values by the word that stands for them.
VALUES: dict[str, tuple[str, ...]] = {
    "BODY": BODY,
    "JOINT": JOINT,
    "NAME": NAME,
    "POINT": POINT,
    "MOTION": MOTION,
    "PLACE": PLACE,
    "SHARE": SHARE,
    "FLAG": FLAG,
    "SOME": SOME,
    "NEW": ("'n1'", "'n2'", "'n3'"),
    "COLOR": ("None", "(1, 0, 0, 1)"),
    "SIZE": ("(0.1, 0.2, 0.3)",),
    "STIFF": ("0", "10", "1e4"),
    "LIMITS": ("True", "False", "(-1, 1)", "None"),
    "KEYS": ("{'elbow': 0.2}", "{'ball': (0, 0, 1)}"),
    "SPEEDS": ("{'elbow': 0.2}", "{'ball': ((0, 0, 1), (0, 1, 0))}"),
    "CURVE": ("[1, 0, 2]", "(1,)"),
    "AXES": ("'world'", "'body'"),
    "VECTOR": ("(0, 0, 1)", "None", "lambda t: (0, 0, t)"),
    "Q": ("None", "s.neutral()"),
    "V": ("None", "np.zeros(s.nv)", "np.ones(s.nv)"),
    "TAU": ("None", "np.ones(s.nv)"),
    "DT": ("1e-3", "0.01", "'auto'"),
    "CDT": ("None", "1e-3", "1e-4"),  # steps in contact: 1e-8 would ask for a million of them in 0.01 s
    "LONG": LONG,
    "ORDER": ("None", "2", "4", "16"),
    "TOL": ("None", "1e-8"),
    "MAP": ("None", "'ctec'", "'mhc'", "'dtec'"),
    "MODE": ("None", "'auto'", "'events'", "'steps'"),
    "COUNT": ("None", "1", "4", "20"),
    "TIME": ("0.0", "0.005", "traj.t[-1]", "traj.t"),
    "CONTROL": ("None", "lambda t, q, v: np.zeros(len(v))"),
    "TARGET": ("None", "{'elbow': 0.1}"),
    "LEDGER": ("None", "{'own_jump': 1.0}", "{'energy': 1e9}"),
    "FILE": ("'out.x'",),
    "FPS": ("10.0", "30"),
    "SHAPE": ("'ball'", "'ground'", "'upper'"),
    "SAMPLE": ("None", "2e-3"),
    "STEPS": ("1", "3", "0"),
    "ARRAY": ("'t'", "'h'", "'index'"),
    "ENERGY": ("lambda q: float(q @ q)", "lambda q: 0.0"),
    "GRADIENT": ("None", "lambda q: np.zeros(s.nv)"),
    "FORCE": ("lambda t, q, v: -v", "lambda t, q, v: np.zeros(len(v))"),
    "NUMBERS": ("[0, 1]", "(0.1, 1, 2)"),
    "STATES": ("s.neutral()", "sim.q"),
    "ITEM": ("s", "0.1", "(lambda t: 0.1)"),
    "E": ("None", "0.5", "1"),
}
WORD = re.compile(r"\b[A-Z]{1,8}\b")

SCENE = (
    "cvi.Scene(POINT)",
    "s.add_sphere(NEW, SOME, SOME, FLAG, PLACE, COLOR)",
    "s.add_box(NEW, SIZE, SOME, FLAG, PLACE, COLOR)",
    "s.add_capsule(NEW, SOME, SOME, SOME, FLAG, PLACE)",
    "s.add_cylinder(NEW, SOME, SOME, SOME, FLAG, PLACE)",
    "s.add_halfspace(POINT, SHARE, NEW, COLOR)",
    "s.set_contact(BODY, BODY, restitution=SHARE, friction=SHARE)",
    "s.set_contact(restitution=SHARE, friction=SHARE)",
    "s.disable_pair(BODY, BODY)",
    "s.enable_pair(BODY, BODY)",
    "s.set_joint(JOINT, stiffness=STIFF, rest=SHARE, damping=STIFF)",
    "s.set_joint(JOINT, limits=LIMITS, restitution=SHARE)",
    "s.set_joint(JOINT, friction=FLAG, spring=CURVE)",
    "s.set_joint(JOINT, armature=SHARE, gear_ratio=SOME, rotor_inertia=SHARE)",
    "s.set_joint('ball', damping=STIFF)",
    "s.set_joint(JOINT, stiffness=STIFF)",
    "s.set_joint(JOINT, spring=CURVE)",
    "s.set_servo(JOINT, STIFF, STIFF, SOME, MOTION)",
    "s.set_actuator(JOINT, FLAG, SOME)",
    "s.set_actuator(JOINT, SOME, FLAG)",
    "s.add_point(BODY, BODY, POINT, POINT, NAME)",
    "s.add_distance(BODY, BODY, POINT, POINT, MOTION, NAME)",
    "s.add_weld(BODY, BODY, PLACE, NAME)",
    "s.add_screw(BODY, BODY, SHARE, PLACE, PLACE, NAME)",
    "s.add_joint_equality(JOINT, JOINT, NUMBERS, NAME)",
    "s.prescribe(JOINT, MOTION, NAME)",
    "s.prescribe('ball', PLACE, NAME)",
    "s.prescribe('ball', ([0.0, 1.0], [PLACE, PLACE]), NAME)",
    "s.prescribe('ball', lambda t: (PLACE, VECTOR), NAME)",
    "s.add_spring(BODY, BODY, STIFF, rest_length=SHARE, damping=STIFF, point_a=POINT, tension_only=FLAG, name=NAME)",
    "s.add_tape_spring([(BODY, POINT), (BODY, POINT), (BODY, POINT)], STIFF, damping=STIFF)",
    "s.add_tape_spring(NUMBERS, STIFF)",
    "s.add_wrench(BODY, VECTOR, VECTOR, POINT, AXES, NAME)",
    "s.add_potential(ENERGY, GRADIENT, check=FLAG, name=NAME)",
    "s.add_force(FORCE, check=FLAG, name=NAME)",
    "s.remove(NAME)",
    "s.q_index(JOINT)",
    "s.v_index(JOINT)",
    "s.configuration(KEYS, Q)",
    "s.velocity(SPEEDS, Q, V)",
    "s.assemble(Q, JOINT, SHARE)",
    "s.consistent_velocity(Q, V, SHARE)",
    "s.disable_overlapping(Q)",
    "s.add_mesh(NEW, [(0, 0, 0), (1, 0, 0), (0, 1, 0), POINT], SHARE, FLAG, PLACE, density=SHARE, scale=SHARE)",
    "s.add_mesh(NEW, FILE)",
    "s.place_on_ground(BODY, Q, ground=SHAPE)",
    "s.mass_matrix(Q)",
    "s.bias_forces(Q, V)",
    "s.passive_forces(Q, V, SHARE)",
    "s.gaps(Q)",
    "s.gap_gradients(Q)",
    "s.contact_jacobian(Q, SHARE).of(SHAPE, SHAPE)",
    "s.delassus(Q, SHARE)",
    "s.constraint_jacobian(Q, SHARE, NAME)",
    "s.add_urdf(FILE)",
    "s.add_urdf('arm.urdf', base='free', prefix=NEW, placement=PLACE, self_collision=FLAG)",
    "s.add_urdf('arm.urdf', prefix='b_', placement=(0, 9, 2), limits=FLAG, friction=FLAG, mimic=FLAG, armature=SHARE)",
    "s.add_urdf('arm.urdf', prefix='c_', placement=(9, 0, 2), srdf='arm.srdf', package_dirs=NUMBERS)",
    "cvi.Scene.from_mjcf(FILE)",
    "cvi.Scene.from_dict(s.to_dict())",
    "cvi.Scene.from_dict(KEYS)",
    "cvi.Scene.from_pinocchio(Q)",
    "cvi.load_scene(FILE)",
    "cvi.check_derivatives(ITEM, Q, V, SHARE, tolerance=SHARE)",
    "cvi.check_derivatives(ITEM, Q, V, scene=ITEM)",
    "cvi.simultaneous_outcomes(s, Q, V, e=E, tolerance=SHARE, max_states=COUNT)",
    "cvi.simultaneous_outcomes(s, Q, V, pairs=NUMBERS)",
    "setattr(s, 'q0', Q)",
    "setattr(s, 'v0', V)",
    "s.copy().add_sphere(NEW, SOME)",
    "s.add_ellipsoid(NEW, SIZE, SOME, FLAG, PLACE)",
)
RUN = (
    "traj = cvi.simulate(s, Q, V, LONG, DT, throw=False)",
    "traj = cvi.simulate(s, Q, V, LONG, 1e-3, order=ORDER, impact=MAP, throw=False)",
    "traj = cvi.simulate(s, v0=V, duration=LONG, dt=1e-3, contact_mode=MODE, contact_points=COUNT, throw=False)",
    "traj = cvi.simulate(s, duration=LONG, dt=DT, solver_tol=TOL, order=ORDER, throw=FLAG)",
    "traj = cvi.simulate(s, duration=LONG, dt=1e-3, control=CONTROL, target=TARGET, throw=False)",
    "traj = cvi.simulate(s, duration=LONG, dt=1e-3, sample_dt=SAMPLE, dense=FLAG, record_contacts=FLAG, throw=False)",
    "traj = cvi.simulate(s, duration=LONG, dt=1e-3, ledger=LEDGER, max_iterations=COUNT, throw=False)",
    "traj = cvi.simulate(s, duration=LONG, dt=1e-3, dt_contact=CDT, zeno=MAP, max_impacts_per_step=COUNT, throw=False)",
    "traj = cvi.simulate(ITEM, duration=0.01, dt=1e-3, throw=False)",
    "traj = cvi.simulate(s, duration=0.01, dt=1e-3, progress=CONTROL)",
    "cvi.Options(DT, LONG, MAP)",
    "cvi.Options(1e-3, 0.01, order=ORDER, solver_tol=TOL, contact_mode=MODE)",
    "cvi.Options.from_dict(LEDGER)",
)
STEPPED = (
    "sim = cvi.Simulator(s, 1e-3, order=ORDER, impact=MAP, contact_mode=MODE)",
    "sim = cvi.Simulator(s, DT)",
    "sim = cvi.Simulator(ITEM, 1e-3)",
    "sim.reset(Q, V, SHARE)",
    "sim.step(TAU, TARGET)",
    "sim.step(TAU)",
    "sim.run(STEPS, target=TARGET)",
    "sim.run(STEPS, TAU)",
    "sim.reaction(NAME)",
    "sim.load(ITEM)",
    "sim.load(sim.save())",
    "sim.last_step()",
    "sim.last_contacts()",
    "cvi.Imu(sim, BODY, PLACE).read()",
    "cvi.Imu(ITEM, BODY)",
    "cvi.JointEncoder(sim, JOINT).read()",
    "cvi.ContactSensor(sim, BODY).read()",
    "traj = sim.trajectory()",
    "sim.contacts",
    "sim.copy().step(TAU)",
)
OF_A_RUN = (
    "traj.at(TIME)",
    "traj.resample(TIME)",
    "traj.reactions(NAME)",
    "traj.save(FILE)",
    "traj.to_html(FILE, fps=FPS)",
    "traj.to_html(FILE, title=NEW)",
    "traj.contacts.at(TIME)",
    "traj.contacts.of(SHAPE, SHAPE)",
    "traj.contacts.force_of(SHAPE, SHAPE)",
    "traj.contacts.on(BODY)",
    "traj.contacts.impulse_on(BODY)",
    "traj.contacts.array(ARRAY)",
    "traj.contacts[STEPS]",
    "traj.events[STEPS]",
    "traj.events.array(ARRAY)",
    "cvi.plot(ITEM)",
    "cvi.plot_forces(ITEM)",
    "cvi.plot_reactions(traj, ITEM)",
    "cvi.plot_states(traj)",
    "traj.poses(BODY)",
    "traj.poses(BODY, TIME)",
    "traj.poses(ITEM)",
    "traj.table(NAME)",
    "traj.table('contacts').column('normal_force')",
    "traj.to_csv(FILE, ITEM)",
    "traj._repr_html_()",
    "s._repr_html_()",
    "copy.deepcopy(traj).energy",
    "traj.contact_changes.array(ARRAY)",
    "list(traj.contact_changes)",
    "cvi.Trajectory.load(FILE)",
    "traj.ledger.energy",
    "traj.gaps",
    "traj.frames",
    "traj.work",
    "traj.modified_energy",
    "traj.ledger.energy_balance",
    "cvi.view(ITEM, open_browser=False)",
    "cvi.plot(traj)",
)


def draw(d: Draws) -> Case:
    """Return a case: lines of Python."""
    wrong = d.pick((0, 0, 3, 8, 25))
    lines = [line(d, d.pick(SCENE), wrong) for _ in range(d.whole(0, 4))]
    if d.chance(60):
        lines.append(line(d, d.pick(RUN), wrong))
    if d.chance(35):
        lines += [
            line(d, d.pick(STEPPED[:3]), wrong),
            "sim.reset()" if d.chance(60) else line(d, "sim.reset(Q, V)", wrong),
        ]
        lines += [line(d, d.pick(STEPPED), wrong) for _ in range(d.whole(1, 3))]
    plots = d.chance(8)
    chosen = [call for call in OF_A_RUN if plots or not re.search("plot|html|view", call)]
    lines += [line(d, d.pick(chosen), wrong) for _ in range(d.whole(0, 3))]
    return {"lines": lines}


def line(d: Draws, template: str, wrong: int, values: Mapping[str, Sequence[str]] = VALUES) -> str:
    """Return a call with values for the words in it, some of them wrong."""

    def value(match: re.Match[str]) -> str:
        word = match.group()
        if word not in values:
            return word
        if not d.chance(wrong):
            return d.pick(values[word])
        if word == "FILE" and d.chance(70):
            return d.pick(
                ("'arm.urdf'", "'none.urdf'", "'.'", "'/dev/null'", "'a\\0'", "''", "None", "3", "'~'", "'x/y/z'")
            )
        if word == "LONG":
            return d.pick(
                ("0.0", "-1", "nan", "inf", "10**400", "'a'", "None", "[1]", "True", "1e-300", "0.0105", "'1'")
            )
        if word == "CDT":
            return d.pick(
                ("0.0", "-1", "nan", "inf", "1e-300", "1e-20", "10**400", "'a'", "[1]", "True", "'auto'", "1.0")
            )
        if word in ("DT", "SAMPLE"):
            return d.pick(
                ("0.0", "-1", "nan", "inf", "1e300", "10**400", "'a'", "None", "[1]", "True", "0.0031", "'Auto'", "1.0")
            )
        if word == "STEPS":
            return d.pick(("-1", "1.0", "None", "'a'", "True", "np.int64(2)", "10**30", "[1]", "nan", "-99", "99"))
        return repr(d.pick(EXTREME)) if d.chance(40) else d.pick(WRONG)

    return WORD.sub(value, template)


def prelude() -> dict[str, Any]:
    """Return the names that a program finds: a scene, its handles, a run and a simulator."""
    Path("arm.urdf").write_text(ARM)
    Path("arm.srdf").write_text(SRDF)
    s = cvi.Scene()
    s.add_halfspace()
    ball = s.add_sphere("ball", 0.1, placement=(3, 0, 0.1))
    arm = s.add_urdf("arm.urdf", placement=(0, 0, 2))
    traj = cvi.simulate(s, duration=0.01, dt=1e-3)
    sim = cvi.Simulator(s, 1e-3)
    sim.reset()
    names: dict[str, Any] = {
        "s": s,
        "ball": ball,
        "arm": arm,
        "traj": traj,
        "sim": sim,
        "cvi": cvi,
        "np": np,
        "pin": pin,
        "copy": copy,
    }
    return names | {"nan": float("nan"), "inf": float("inf"), "Fraction": Fraction, "Path": Path}


def attempt(case: Case) -> bool:
    """Run the program line by line; a line that is refused leaves what was there. At last the scene is run."""
    names = prelude()
    refused: cvi.ContactviError | None = None
    for line in case["lines"]:
        before = names.get("traj")
        try:
            exec(line, names)
        except cvi.ContactviError as error:
            refused = error
        except ZeroDivisionError:
            if "1 / 0" not in line:  # a function of the program may fail as it likes
                raise
        except (IndexError, TypeError):
            if not line.startswith(("traj.contacts[", "traj.events[")):  # these are sequences, with the errors of lists
                raise
        if names.get("traj") is not before:
            law.check_run(names["traj"])
    _check_scene(names["s"])
    sim = names["sim"]
    if sim.status is not None:
        law.check_numbers("state of the simulator", [sim.t, *sim.q, *sim.v, *sim.p])
    close = __import__("matplotlib.pyplot").pyplot.close
    close("all")
    if refused is not None:
        raise refused
    return True


def _check_scene(s: cvi.Scene) -> None:
    with contextlib.suppress(cvi.ContactviError, ZeroDivisionError):
        law.check_numbers("neutral", s.neutral())
        str(s.report)
        law.check_run(cvi.simulate(s, duration=3e-3, dt=1e-3, throw=False))
