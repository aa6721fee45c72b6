"""A double pendulum reaches a state through one and through two impacts at a wall: crocoddyl's FDDP over exact steps.

The torques of 24 intervals are found twice, from two starts. How often the tip hits the wall, and when, is given
nowhere: it follows from the motion. Of the two local optima the one with two impacts is cheaper.

python examples/hit_through_wall.py [PICTURE.png]
"""

import sys
import time
from pathlib import Path

import crocoddyl
import numpy as np

import contactvi as cvi
from contactvi.crocoddyl import ActionModel, merge_nodes_at_impacts, replay, solve

SPAN, NODES = 1.6, 24  # [s]
START, GOAL = np.array([0.2, 0.1, -1.5, -1.0]), np.array([0.3, 0.1, 0.0, 0.0])  # q [rad], v [rad/s]
STARTS = {1: (-4.0, 6.0), 2: (0.0, 0.0)}  # impacts: torques of the shoulder at first, and from .5 to 1 s [N m]

scene = cvi.load_scene(Path(__file__).resolve().parents[1] / "models/double_pendulum_wall.toml")
scene.set_contact(restitution=0.9)
state = crocoddyl.StateMultibody(scene.model)
running, terminal = crocoddyl.CostModelSum(state, 2), crocoddyl.CostModelSum(state, 2)
running.addCost("torques", crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelControl(state, 2)), 1e-2)
weights = crocoddyl.ActivationModelWeightedQuad(np.array([50.0, 50.0, 5.0, 5.0]))
terminal.addCost("goal", crocoddyl.CostModelResidual(state, weights, crocoddyl.ResidualModelState(state, GOAL, 2)), 1.0)
action, end = (ActionModel(scene, SPAN / NODES, order=8, costs=costs) for costs in (running, terminal))


def cost(problem, us) -> float:
    return float(problem.calc(list(problem.rollout(list(us))), list(us)))


def gradient(problem, us) -> np.ndarray:
    """Return the derivative of the cost by all inputs, (nodes, 2), from the derivatives of the nodes."""
    cost(problem, us)
    problem.calcDiff(problem.rollout(list(us)), list(us))
    slope, found = np.array(problem.terminalData.Lx), []
    for data in reversed(list(problem.runningDatas)):
        found.append(data.Lu + data.Fu.T @ slope)
        slope = data.Lx + data.Fx.T @ slope
    return np.array(found[::-1])


def slope_error(problem, us, step=1e-4) -> float:
    """Return how far the gradient is from differences of the cost along a random direction, relative to |d|."""
    d = np.random.default_rng(0).standard_normal((len(us), 2))
    d /= np.linalg.norm(d)
    parts = [(-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12)]
    difference = sum(weight / step * cost(problem, us + count * step * d) for count, weight in parts)
    return abs(float(difference - np.sum(gradient(problem, us) * d)))


found = {}
for impacts, (first, second) in STARTS.items():
    problem = crocoddyl.ShootingProblem(START, [action] * NODES, end)
    us = [np.array([first if k < 7.2 else second if k < 14.4 else 0.0, 0.0]) for k in range(NODES)]
    at_start, history, evaluations, begin = cost(problem, us), [], 0, time.perf_counter()
    for _ in range(6):
        solver, log = crocoddyl.SolverFDDP(problem), crocoddyl.CallbackLogger()
        solver.th_stop = 1e-13
        solver.setCallbacks([log])
        solve(solver, us)
        costs = [float(c) for c in log.costs]
        assert all(b <= a * (1.0 + 1e-12) for a, b in zip(costs, costs[1:], strict=False))  # it never rises
        us, history = list(solver.us), history + costs
        evaluations += sum(1 - int(np.log2(step)) for step in log.steps if step > 0)  # crocoddyl halves its steps
        if np.abs(gradient(problem, us)).max() <= 1e-6:
            break
        problem, us = merge_nodes_at_impacts(problem, us)  # an impact at a node stops FDDP
    seconds, us = time.perf_counter() - begin, np.array(us)
    run, largest, error = replay(problem, us), np.abs(gradient(problem, us)).max(), slope_error(problem, us)
    found[impacts] = run, history[-1], np.abs(us).max()
    print(f"{len(run.events)} impacts: cost {at_start:.3f} -> {history[-1]:.6f}, {len(history)} iterations,", end=" ")
    print(f"{evaluations} rollouts, {seconds:.2f} s, gradient {largest:.1e}, off differences by {error:.1e};", end=" ")
    print("at", ", ".join(f"{event.time:.4f} s" for event in run.events), f"torques up to {np.abs(us).max():.2f} N m")
    assert len(run.events) == impacts
    assert largest <= 1e-6
    assert error <= 1e-7
assert found[2][1] < 0.3 * found[1][1]  # two impacts are cheaper

if len(sys.argv) > 1:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3), sharey=True, layout="constrained")
    for axis, (impacts, (run, least, _)) in zip(axes, found.items(), strict=True):
        t = np.linspace(0.0, SPAN, 400)
        axis.plot(t, run.at(t).q, label=["shoulder", "elbow"])
        for event in run.events:
            axis.axvline(event.time, color="gray", linestyle=":")
        axis.plot([SPAN, SPAN], GOAL[:2], "k.", label="goal")
        axis.set(title=f"{impacts} impact{'s'[: impacts - 1]}, cost {least:.3f}", xlabel="t [s]", ylabel="angle [rad]")
    axes[0].legend(loc="lower left")
    figure.savefig(sys.argv[1], dpi=120)
