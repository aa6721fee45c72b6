"""One problem of optimal control through contact, with exact derivatives and with differences of hard and soft contact.

A double pendulum reaches a state after it has hit a wall (examples/hit_through_wall.py), by crocoddyl's FDDP from equal
starts. What differs is the step and its derivatives:

- exact: contactvi's event-driven intervals, their own derivatives;
- differences: the same intervals, crocoddyl's ActionModelNumDiff;
- penalty: crocoddyl's Euler steps of a soft wall, DifferentialActionModelNumDiff;
- MuJoCo: its soft contact, mjd_transitionFD.

Reported are iterations, seconds, the cost that the solver believes in, and the true one: that of its inputs in an
accurate run of the hard contact. Needs crocoddyl and mujoco.

python benchmarks/optimal_control.py [-o FILE.json]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import crocoddyl
import mujoco
import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.crocoddyl import ActionModel, merge_nodes_at_impacts, replay

SPAN, NODES, PARTS = 1.6, 24, 64  # [s]; intervals of equal inputs; steps of soft contact in each
START, GOAL = np.array([0.2, 0.1, -1.5, -1.0]), np.array([0.3, 0.1, 0.0, 0.0])
WEIGHTS, EFFORT = np.array([50.0, 50.0, 5.0, 5.0]), 1e-2
RESTITUTION = 0.9
FREQUENCY = 200.0  # of the soft contact [rad/s]: it lasts pi / 200 s, 15 steps
RATIO = -np.log(RESTITUTION) / np.hypot(np.pi, np.log(RESTITUTION))  # of damping, that rebounds with the restitution
GUESSES = {"one": (-4.0, 6.0), "two": (0.0, 0.0)}  # impacts that the exact solver comes to: torques of the shoulder
ITERATIONS = 100

scene = cvi.load_scene(Path(__file__).resolve().parents[1] / "models/double_pendulum_wall.toml")
scene.set_contact(restitution=RESTITUTION)
state = crocoddyl.StateMultibody(scene.model)

MJCF = f"""
<mujoco>
  <option timestep="{SPAN / NODES / PARTS}" integrator="implicitfast"><flag eulerdamp="disable"/></option>
  <default><geom solref="{-(FREQUENCY**2)} {-2 * RATIO * FREQUENCY}" solimp="0.99 0.99 0.001" condim="1"/></default>
  <worldbody>
    <geom name="wall" type="plane" size="5 5 1" pos="-0.03125 0 0" zaxis="1 0 0"/>
    <body><joint name="joint_1" axis="0 -1 0"/>
      <inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/>
      <body pos="0 0 -1"><joint name="joint_2" axis="0 -1 0"/>
        <inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/>
        <geom type="sphere" size="0.03125" pos="0 0 -1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="joint_1"/><motor joint="joint_2"/></actuator>
</mujoco>"""


def costs_of(**residuals: Any) -> Any:
    costs = crocoddyl.CostModelSum(state, 2)
    for name, (weight, residual, *activation) in residuals.items():
        costs.addCost(name, crocoddyl.CostModelResidual(state, *activation, residual), weight)
    return costs


RUNNING = costs_of(torques=(EFFORT, crocoddyl.ResidualModelControl(state, 2)))
TERMINAL = costs_of(
    goal=(1.0, crocoddyl.ResidualModelState(state, GOAL, 2), crocoddyl.ActivationModelWeightedQuad(WEIGHTS))
)
END = ActionModel(scene, SPAN / NODES, order=8, costs=TERMINAL)


class SoftWall(crocoddyl.DifferentialActionModelAbstract):
    """Accelerations with a spring and a damper in the wall."""

    def __init__(self) -> None:
        crocoddyl.DifferentialActionModelAbstract.__init__(self, state, 2, 1)
        self.model, self.own = scene.model, scene.model.createData()

    def calc(self, data: Any, x: np.ndarray, u: np.ndarray | None = None) -> None:
        q, v = np.array(x[:2]), np.array(x[2:])
        tau = np.zeros(2) if u is None else np.array(u)
        data.cost = 0.5 * EFFORT * float(tau @ tau)
        reach = np.array([np.cos(q[0]) + np.cos(q[0] + q[1]), np.cos(q[0] + q[1])])  # d x_tip / d q
        gap = np.sin(q[0]) + np.sin(q[0] + q[1])
        if gap < 0.0:
            inverse = np.linalg.inv(pin.crba(self.model, self.own, q))
            mass = 1.0 / (reach @ inverse @ reach)
            tau = tau + reach * mass * (-(FREQUENCY**2) * gap - 2.0 * RATIO * FREQUENCY * (reach @ v))
        data.xout = pin.aba(self.model, self.own, q, v, tau)


class MujocoInterval(crocoddyl.ActionModelAbstract):
    """An interval of MuJoCo's steps, its derivatives by mjd_transitionFD."""

    def __init__(self, centred: bool = True) -> None:
        crocoddyl.ActionModelAbstract.__init__(self, state, 2, 2)
        self.model = mujoco.MjModel.from_xml_string(MJCF)
        self.own, self.centred = mujoco.MjData(self.model), centred

    def calc(self, data: Any, x: np.ndarray, u: np.ndarray | None = None) -> None:
        data.cost = 0.0 if u is None else SPAN / NODES * 0.5 * EFFORT * float(u @ u)
        data.xnext = x if u is None else self._steps(x, u)[0]

    def calcDiff(self, data: Any, x: np.ndarray, u: np.ndarray | None = None) -> None:
        if u is not None:
            _, data.Fx, data.Fu = self._steps(x, u, True)
            data.Lu, data.Luu = SPAN / NODES * EFFORT * u, SPAN / NODES * EFFORT * np.eye(2)

    def _steps(self, x: np.ndarray, u: np.ndarray, slopes: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        mujoco.mj_resetData(self.model, self.own)
        self.own.qpos[:], self.own.qvel[:], self.own.ctrl[:] = x[:2], x[2:], u
        A, B = np.eye(4), np.zeros((4, 2))
        own_A, own_B = np.zeros((4, 4)), np.zeros((4, 2))
        for _ in range(PARTS):
            if slopes:
                mujoco.mjd_transitionFD(self.model, self.own, 1e-6, self.centred, own_A, own_B, None, None)
                A, B = own_A @ A, own_A @ B + own_B
            mujoco.mj_step(self.model, self.own)
        return np.concatenate([self.own.qpos, self.own.qvel]), A, B


def problems() -> dict[str, Any]:
    """Return the same problem for each kind of step, as (problem, inputs per node of the guess)."""
    exact = ActionModel(scene, SPAN / NODES, order=8, costs=RUNNING)
    differences = crocoddyl.ActionModelNumDiff(exact, False)
    small = SPAN / NODES / PARTS
    penalty = crocoddyl.IntegratedActionModelEuler(crocoddyl.DifferentialActionModelNumDiff(SoftWall(), False), small)
    actions = {"exact": [exact] * NODES, "differences": [differences] * NODES,
               "penalty": [penalty] * (NODES * PARTS), "MuJoCo": [MujocoInterval()] * NODES}  # fmt: skip
    return {name: crocoddyl.ShootingProblem(START, models, END) for name, models in actions.items()}


def truth(us: np.ndarray) -> tuple[float, int]:
    """Return the cost of inputs (n, 2), each held for 1.6 s / n, in an accurate run, and its number of impacts."""
    rows = np.repeat(us, max(1, 480 // len(us)), axis=0)
    run = cvi.simulate(scene, START[:2], START[2:], SPAN, SPAN / len(rows), order=8, control=rows)
    off = np.concatenate([run.q[-1], run.v[-1]]) - GOAL
    return float(0.5 * off @ (WEIGHTS * off) + 0.5 * EFFORT * SPAN * np.mean(np.sum(us**2, axis=1))), len(run.events)


def solve(name: str, problem: Any, first: float, second: float) -> dict[str, Any]:
    nodes = problem.T
    us = [np.array([first if k < 0.3 * nodes else second if k < 0.6 * nodes else 0.0, 0.0]) for k in range(nodes)]
    begin, iterations = time.perf_counter(), 0
    for _ in range(4):
        solver = crocoddyl.SolverFDDP(problem)
        solver.th_stop = 1e-12
        solved = solver.solve(list(problem.rollout(us)), us, ITERATIONS, True)
        us, iterations = list(solver.us), iterations + solver.iter + 1
        if name != "exact":
            break
        merged, us = merge_nodes_at_impacts(problem, us)
        if merged.T == problem.T:
            break
        problem = merged
    seconds = time.perf_counter() - begin
    kept = replay(problem, us).inputs if name == "exact" else None  # merged intervals have several steps
    true, impacts = truth(np.array(us) if kept is None else np.asarray(kept.control))
    return {"solved": bool(solved), "iterations": iterations, "seconds": seconds, "cost": float(solver.cost),
            "true cost": true, "impacts": impacts}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", dest="file", type=Path, help="where the numbers go, as JSON")
    file = parser.parse_args().file
    found = {}
    print("guess step         solved  iterations  seconds       cost  true cost  impacts")
    for guess, torques in GUESSES.items():
        for name, problem in problems().items():
            row = found[f"{guess} {name}"] = solve(name, problem, *torques)
            print(f"{guess:6}{name:13}{row['solved']!s:>7}{row['iterations']:12d}{row['seconds']:9.2f}", end="")
            print(f"{row['cost']:11.5f}{row['true cost']:11.5f}{row['impacts']:9d}", flush=True)
    if file is not None:
        file.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
