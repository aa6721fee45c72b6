"""Cost and error of derivatives: of a step, and of whole runs through impacts.

    python benchmarks/derivatives.py [--repeats 7]

Times are CPU times, the least of several rounds; in every round each row of a table is measured once, so that ratios
hold on a busy machine, too. A *run* is `cvi.simulate` without a record, Python included; a *step* is one of the engine,
without Python, in a run of the same settings. Goals stand beside what was measured.

Errors are relative to the largest entry:

- exact: against an independent derivative of the same discrete run or step. The adjoint is compared with the tangent,
  the tangent with fourth-order central differences, which are good to the number in brackets themselves (what half
  their step changes). Central differences are compared with the tangent; the best of four steps counts.
  Events are located to gaps of 1e-12 m: after a slow approach that is seen in both. A second derivative times a vector
  is compared with fourth-order differences of gradients along it, in the same way.
- flow: against the derivative of the motion itself (order 16 with a quarter of its step), so that of the
  integrator counts; of a run: of q at its end.

Scenes:

- Allegro hand of example-robot-data, 16 joints without damping and limits, 1 s without contact, 32 columns (q0, v0).
- MuJoCo has the same hand, made from the scene (`contactvi/bench/mujoco_peer.py`): mjd_transitionFD, which gives the
  derivative of one of its steps by differences.
- The same hand closes around a ball (friction 0.8, e = 0, tests/helpers/grasp_scene.py): 30 impacts, and persistent
  contacts that begin, are released, stick and slip. Differences whose runs have other impacts are left out.
- Double pendulum at a wall (restitution 0.7), and a turning box that falls on the ground with friction and bounces.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
import contactvi as cvi
from contactvi import _core
from contactvi.bench.mujoco_peer import MujocoPeer
from helpers.grasp_scene import grasp
from models import all_models, start

MODELS = Path(__file__).resolve().parents[1] / "models"
HAND = ((16, 0.0125), (2, 1e-3))  # order, dt [s]
LINEAR_GOAL = {2: 3.0, 16: 30.0}  # steps
ADJOINT_GOAL = 4.0  # runs
HESSIAN_GOAL = 15.0  # runs; and 4 gradients
GRADIENT, HESSIAN = "gradient (q0, v0, control), terminal cost", "second derivative times vector"
FOURTH = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))
CENTRAL_STEPS = (1e-5, 1e-6, 1e-7, 1e-8)  # of central differences; which one is best depends on the growth
FOURTH_STEPS = (2e-4, 2e-5, 2e-6, 4e-7, 1e-7)
Array = np.ndarray
Row = dict[str, Any]


def least_seconds(functions: dict[str, Callable[[], object]], rounds: int, enough: float = 2e-3) -> dict[str, float]:
    """CPU time of a call of each function [s], the least of the rounds; short ones are called several times."""
    best, calls = dict.fromkeys(functions, np.inf), {}
    for name, function in functions.items():
        begin = time.process_time()
        function()
        calls[name] = max(1, int(enough / max(time.process_time() - begin, 1e-7)))
    for _ in range(rounds):
        for name, function in functions.items():
            begin = time.process_time()
            for _ in range(calls[name]):
                function()
            best[name] = min(best[name], (time.process_time() - begin) / calls[name])
    return best


def relative(found: Array, exact: Array) -> float:
    return float(np.abs(found - exact).max() / np.abs(exact).max())


def brief(x: float) -> str:
    return f"{x:.1e}"


def print_table(title: str, rows: list[Row]) -> None:
    heads = list(dict.fromkeys(key for row in rows for key in row))
    print(f"\n{title}\n\n| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in rows:
        print(
            "| " + " | ".join(f"{x:.3g}" if isinstance(x := row.get(h, ""), float) else str(x) for h in heads) + " |",
            flush=True,
        )


class Case:
    """A scene with a start and the settings of its run, and the derivatives of that run."""

    def __init__(self, name: str, scene: cvi.Scene, q: Array, v: Array, **options: Any) -> None:
        self.name, self.scene, self.q, self.v, self.options = name, scene, q, v, options
        self.traj = self.recorded()
        self.S = self.traj.sensitivity(["q0", "v0"])
        nodes, nv = len(self.traj.t), scene.nv
        rng = np.random.default_rng(0)
        self.terminal = tuple(rng.standard_normal((2, nv)))
        self.running = tuple(rng.standard_normal((2, nodes, nv)))
        self.w = {"q0": rng.standard_normal(nv), "v0": rng.standard_normal(nv)}

    def run(self, q: Array | None = None, v: Array | None = None, **more: Any) -> cvi.Trajectory:
        return cvi.simulate(
            self.scene, self.q if q is None else q, self.v if v is None else v, **{**self.options, **more}
        )

    def recorded(self) -> cvi.Trajectory:
        return self.run(record="gradient")

    def adjoint(self, cost: Any) -> dict[str, Array]:
        return cvi.gradient(self.traj, cost, ["q0", "v0", "control"])[1]

    def second(self) -> cvi.HessianVector:
        """Of the terminal cost, in all that the gradient is taken in; Gauss-Newton's where it is not known."""
        names = ["q0", "v0", "control"]
        return self.traj.hessian_vector(self.terminal, self.w, names, hessp="linear", method="auto")

    def second_error(self) -> str:
        """Of the rows of v0, which need no change of coordinates, against differences of gradients along w."""
        found = self.second()
        if found.approximate is not None:
            return "Gauss-Newton"

        def slope(s: float) -> Array:
            q = pin.integrate(self.scene.model, self.q, s * self.w["q0"])
            traj = self.run(q, self.v + s * self.w["v0"], record="gradient", solver_tol=1e-14)
            return cvi.gradient(traj, self.terminal, "v0")[1]["v0"]

        pairs = []
        for step in FOURTH_STEPS:
            coarse, fine = (sum(c / size * slope(k * size) for k, c in FOURTH) for size in (step, step / 2))
            pairs.append((relative(coarse, fine), fine))
        own, numbers = min(pairs, key=lambda pair: np.nan_to_num(pair[0], nan=np.inf))
        return f"{relative(found.product['v0'], numbers):.1e} ({own:.1e})"

    def adjoint_error(self, cost: tuple[Array, Array]) -> float:
        """Of the gradient in the start and in the sum of the inputs, against the tangent."""
        S = self.traj.sensitivity(["q0", "v0", "control"]).matrix
        exact = np.einsum("nik,ni->k", S, np.hstack(cost)) if cost[0].ndim == 2 else S[-1].T @ np.hstack(cost)
        found = self.adjoint(cost)
        nv, got = self.scene.nv, [found["q0"], found["v0"], found["control"].sum(axis=0)]
        return max(relative(part, exact[k * nv : (k + 1) * nv]) for k, part in enumerate(got))

    def moved(self, d: Array, **more: Any) -> Array:
        """The end of the run from a start that is moved by d, seen from the end of this run."""
        nv, model = self.scene.nv, self.scene.model
        # With polynomials all trees are advanced together, as in the run that is differentiated.
        traj = self.run(pin.integrate(model, self.q, d[:nv]), self.v + d[nv:], **{"record": "gradient", **more})
        if [event.pair for event in traj.events] != [event.pair for event in self.traj.events]:
            return np.full(2 * nv, np.nan)
        return np.concatenate([pin.difference(model, self.traj.q[-1], traj.q[-1]), traj.v[-1]])

    def central(self, step: float) -> Array:
        """Central differences of second order: two runs per column."""
        unit = step * np.eye(2 * self.scene.nv)
        return np.stack([(self.moved(d) - self.moved(-d)) / (2.0 * step) for d in unit], axis=1)

    def best_central(self) -> tuple[Array, float]:
        """Those with the step that is best, which one who has nothing else does not know; and this step."""
        end = self.S.matrix[-1]
        found = [(self.central(step), step) for step in CENTRAL_STEPS]
        return min(found, key=lambda pair: np.nan_to_num(relative(pair[0], end), nan=np.inf))

    def fourth(self, step: float) -> Array:
        unit = step * np.eye(2 * self.scene.nv)
        return np.stack([sum(w / step * self.moved(k * d, solver_tol=1e-14) for k, w in FOURTH) for d in unit], axis=1)

    def best_fourth(self) -> tuple[Array, float]:
        """Of the steps those whose halving changes least; and this change, relative."""
        found = []
        for step in FOURTH_STEPS:
            coarse, fine = self.fourth(step), self.fourth(step / 2)
            found.append((relative(coarse, fine), fine))
        own, numbers = min(found, key=lambda pair: np.nan_to_num(pair[0], nan=np.inf))
        return numbers, own

    def kept(self) -> tuple[int, int]:
        """Bytes that the run keeps for its derivatives, and the steps of the run."""
        inputs, segments = self.traj.inputs, self.traj.segments
        given = sum(part.nbytes for part in (inputs.control, inputs.target) if part is not None)
        count = round((self.traj.t[-1] - self.traj.t[0]) / self.options["dt"])
        return given + sum(part.nbytes for part in segments.arrays.values()), count


def run_rows(case: Case, rounds: int, flow: Case | None) -> list[Row]:
    """Runs and their derivatives, in runs."""
    functions: dict[str, Callable[[], object]] = {
        "run": case.run,
        "run, record='gradient'": case.recorded,
        GRADIENT: lambda: case.adjoint(case.terminal),
        "gradient (q0, v0, control), running cost": lambda: case.adjoint(case.running),
        HESSIAN: case.second,
        "sensitivity (q0, v0)": lambda: case.traj.sensitivity(["q0", "v0"]),
    }
    central, step = case.best_central()
    differences = f"central differences, step {step:g}"
    functions[differences] = lambda: case.central(step)
    seconds = least_seconds(functions, rounds)
    numbers, own = case.best_fourth()
    end = case.S.matrix[-1]
    exact = {
        GRADIENT: brief(case.adjoint_error(case.terminal)),
        "gradient (q0, v0, control), running cost": brief(case.adjoint_error(case.running)),
        HESSIAN: case.second_error(),
        "sensitivity (q0, v0)": f"{relative(end, numbers):.1e} ({own:.1e})",
        differences: brief(relative(central, end)),
    }
    drift = {} if flow is None else {
        "run": relative(case.traj.q[-1], flow.traj.q[-1]), "sensitivity (q0, v0)": relative(end, flow.S.matrix[-1]),
        differences: relative(central, flow.S.matrix[-1]),
    }  # fmt: skip
    goals = {name: ADJOINT_GOAL for name in seconds if name.startswith("gradient")} | {HESSIAN: HESSIAN_GOAL}
    rows: list[Row] = []
    for name, took in seconds.items():
        columns = f", {2 * case.scene.nv} columns" if name.startswith(("sens", "cent")) else ""
        row = {
            "settings": case.name, "what": name + columns, "ms": 1e3 * took, "runs": took / seconds["run"],
            "goal": f"<= {goals[name]:g}" if name in goals else "",
            "gradients": took / seconds[GRADIENT] if name in goals else "", "error, exact": exact.get(name, ""),
        }  # fmt: skip
        if flow is not None:
            row["error, flow"] = brief(drift[name]) if name in drift else ""
        rows.append(row)
    return rows


def steps_of(case: Case) -> tuple[Callable[[], object], int]:
    """A function that makes the engine's steps of a run, and how many these are."""
    options = _core.SimulatorOptions()
    options.dt, options.order, options.tol = case.options["dt"], case.options["order"], 1e-12
    simulator = _core.Simulator(case.scene.core(), options)
    count = round(case.options["duration"] / options.dt)

    def steps() -> None:
        simulator.reset(case.q, case.v)
        simulator.advance(count, record_every=count)

    return steps, count


def hand_scene() -> tuple[cvi.Scene, Array, Array]:
    model = all_models()["Allegro hand"]
    scene = cvi.Scene.from_pinocchio(model)
    for joint in model.names[1:]:
        scene.set_joint(joint, limits=False)
    return scene, *start(model)


def flow_of_step(scene: cvi.Scene, q: Array, v: Array, dt: float) -> Array:
    """The derivative of the motion over dt."""
    first = cvi.step_derivatives(scene, q, v, dt=dt / 2, order=16)
    return cvi.linearize(scene, first.q, first.x, dt=dt / 2, order=16)[0] @ first.A


def linear_rows(cases: list[Case], rounds: int) -> list[Row]:
    """Linear systems of one step, in steps."""
    rows: list[Row] = []
    for case in cases:
        scene, q, v, dt, order = case.scene, case.q, case.v, case.options["dt"], case.options["order"]
        core, none = scene.core(), np.zeros(scene.nv)
        linearizer = _core.Linearizer(core, order, 1e-12)
        functions: dict[str, Callable[[], object]] = {
            "cvi.linearize": lambda s=scene, q=q, v=v, dt=dt, o=order: cvi.linearize(s, q, v, dt=dt, order=o),
            "_core.Linearizer.step": lambda s=linearizer.step, q=q, v=v, dt=dt, n=none: s(
                q, v, False, dt, n, None, 0.0
            ),
            "one tangent equation per column": lambda c=core, q=q, v=v, dt=dt, o=order, n=none: _core.linear_step(
                c, q, v, False, dt, n, None, 0.0, o, 1e-12, by_columns=True
            ),
            "pin.computeABADerivatives": aba_derivatives(scene, q, v),
        }
        functions["engine's step"], count = steps_of(case)
        seconds = least_seconds(functions, rounds)
        step = seconds["engine's step"] = seconds["engine's step"] / count
        A, flow = cvi.linearize(scene, q, v, dt=dt, order=order)[0], flow_of_step(scene, q, v, dt)
        numbers = step_differences(scene, q, v, dt, order)
        for name, took in seconds.items():
            ours = name in ("cvi.linearize", "_core.Linearizer.step")
            rows.append({
                "settings": case.name, "what": name, "us": 1e6 * took, "steps": took / step,
                "goal": f"<= {LINEAR_GOAL[order]:g}" if ours else "",
                "error, exact": brief(relative(A, numbers)) if ours else "",
                "error, flow": brief(relative(A, flow)) if ours else "",
            })  # fmt: skip
    return rows


def aba_derivatives(scene: cvi.Scene, q: Array, v: Array) -> Callable[[], object]:
    model, none = scene.model, np.zeros(scene.nv)
    data = model.createData()
    return lambda: pin.computeABADerivatives(model, data, q, v, none)


def step_differences(scene: cvi.Scene, q: Array, v: Array, dt: float, order: int) -> Array:
    """Fourth-order differences of one step."""
    core, nv = scene.core(), scene.nv

    def end(d: Array) -> Array:
        q1, v1 = _core.linear_step(core, q + d[:nv], v + d[nv:], False, dt, None, None, 0.0, order, 1e-14)[:2]
        return np.concatenate([q1, v1])

    step = 1e-3
    return np.stack([sum(w / step * end(k * d) for k, w in FOURTH) for d in step * np.eye(2 * nv)], axis=1)


def mujoco_rows(scene: cvi.Scene, q: Array, v: Array, dt: float, rounds: int) -> list[Row]:
    """MuJoCo's derivative of one of its steps, by differences, in its own steps."""
    peer = MujocoPeer(scene, dt)
    mujoco, model, data = peer.mujoco, peer.model, peer.data(q, v)
    nv, flow = model.nv, flow_of_step(scene, q, v, dt)

    def transition(eps: float, centered: bool) -> Array:
        A = np.zeros((2 * nv, 2 * nv))
        mujoco.mjd_transitionFD(model, data, eps, centered, A, None, None, None)
        return A

    def end(d: Array) -> Array:
        data = peer.data(q + d[:nv], v + d[nv:])
        mujoco.mj_step(model, data)
        return np.concatenate([data.qpos, data.qvel])

    def steps() -> None:
        other = peer.data(q, v)
        for _ in range(100):
            mujoco.mj_step(model, other)

    step = 1e-3
    numbers = np.stack([sum(w / step * end(k * d) for k, w in FOURTH) for d in step * np.eye(2 * nv)], axis=1)
    settings = ((1e-6, False), (1e-6, True), (1e-4, True))
    seconds = least_seconds({"steps": steps, **{str(s): lambda s=s: transition(*s) for s in settings}}, rounds)
    unit = seconds["steps"] / 100
    rows: list[Row] = [{"what": "mj_step", "us": 1e6 * unit, "its steps": 1.0}]
    for s in settings:
        A = transition(*s)
        rows.append({
            "what": f"mjd_transitionFD, eps {s[0]:g}, {'centred' if s[1] else 'forward'}", "us": 1e6 * seconds[str(s)],
            "its steps": seconds[str(s)] / unit, "error, exact": brief(relative(A, numbers)),
            "error, flow": brief(relative(A, flow)),
        })  # fmt: skip
    return rows


def pendulum() -> Case:
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    scene.set_contact(restitution=0.7)
    start = np.array([0.3, 0.2]), np.array([0.1, -0.2])
    return Case("double pendulum at a wall, order 8", scene, *start, duration=3.0, dt=0.01, order=8)


def falling_box() -> Case:
    scene = cvi.Scene()
    scene.add_box("box", [0.2, 0.3, 0.25])
    scene.add_halfspace()
    scene.set_contact(restitution=0.7, friction=0.3)
    rng = np.random.default_rng(5)
    q = pin.integrate(scene.model, pin.neutral(scene.model), np.r_[0, 0, 0, rng.uniform(-1, 1, 3)])
    q[2] = 0.5
    return Case("falling box, order 4", scene, q, rng.uniform(-1, 1, 6), duration=0.8, dt=0.01, order=4)


def closing_hand() -> Case:
    scene, q, v = grasp(0.0, 0.8)
    return Case("hand around a ball", scene, q, v, duration=0.077, dt=1e-3, order=2, contact_mode="events")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7, help="rounds of which the least time counts")
    rounds = parser.parse_args().repeats
    scene, q, v = hand_scene()
    hands = [
        Case(f"order {order}, dt {dt:g}", scene, q, v, duration=1.0, dt=dt, order=order, ledger=None)
        for order, dt in HAND
    ]
    flow = Case("flow", scene, q, v, duration=1.0, dt=HAND[0][1] / 4, order=16, solver_tol=1e-15)
    print_table("Allegro hand, 1 s", [row for case in hands for row in run_rows(case, rounds, flow)])
    print_table("Allegro hand, one step", linear_rows(hands, rounds))
    print_table(f"Allegro hand in MuJoCo, one step of {HAND[1][1]:g} s", mujoco_rows(scene, q, v, HAND[1][1], rounds))
    impacts = [pendulum(), falling_box(), closing_hand()]
    print_table("Runs with impacts", [row for case in impacts for row in run_rows(case, rounds, None)])
    rows: list[Row] = []
    for case in [*hands, *impacts]:
        size, steps = case.kept()
        name = case.name if case in impacts else f"Allegro hand, {case.name}"
        report = case.S.report
        rows.append({
            "run": name, "impacts": len(report.events), "growth": brief(report.growth),
            "smallest approach": brief(min((e.approach for e in report.events), default=1.0)),
            "steps": steps, "bytes per step": size / steps,
        })  # fmt: skip
    print_table("What the runs keep, and how well they are conditioned", rows)


if __name__ == "__main__":
    main()
