"""Problems of crocoddyl over intervals of a scene: solving, starting from a run, and playing back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import crocoddyl
import numpy as np
from numpy.typing import NDArray

from contactvi.control.interval import Interval
from contactvi.crocoddyl.action import ActionModel
from contactvi.errors import ContactviError, InputError
from contactvi.trajectory.trajectory import Trajectory

Array = NDArray[np.float64]


def solve(
    solver: Any, us: Sequence[Array] | Array, xs: Sequence[Array] | None = None, iterations: int = 100, *,
    regularization: float | None = None,
) -> bool:  # fmt: skip
    """Let a solver solve its problem from inputs us, and raise the errors that it cannot pass on; return its answer.

    Args:
        solver: of crocoddyl, with its problem. us: start, one array (nu,) per node.
        xs: states at all nodes and at the end; None: those that us lead to, from which all steps stay real motions.
        iterations: at most. regularization: of the first iteration, by default the solver's.

    Raises:
        SimulationError, PenetrationError, NotDifferentiable: where the start has no run or no derivative, and where a
            point that the solver had accepted has none.
        KeyboardInterrupt: after a Ctrl-C in an action.
    """
    models = _actions(solver.problem)
    for model in models:
        model.failures.clear()
    feasible = xs is None
    start = list(solver.problem.rollout(list(us))) if xs is None else list(xs)
    _raise_failures(models, ("calc", "calcDiff"))
    first = () if regularization is None else (regularization,)
    solved = bool(solver.solve(start, list(us), iterations, feasible, *first))
    _raise_failures(models, ("calcDiff",))
    return solved


def merge_nodes_at_impacts(problem: Any, us: Sequence[Array] | Array, within: float = 1e-3) -> tuple[Any, list[Array]]:
    """Return a problem in which no impact of the run with us is at a node, and its inputs.

    Where an impact passes a node, the derivative of the motion jumps if the input does, and the feedback of DDP's
    rollouts answers a state that jumps from before the impact to after it; solvers stop at such nodes
    (docs/optimal_control.md). The two intervals that meet there become one, in which the impact may move; its input is
    their mean.

    Args:
        problem: crocoddyl.ShootingProblem with actions of this module as running models. us: inputs, one per node.
        within: distance of an impact from a node, relative to the shorter interval beside it.

    Raises:
        InputError: for actions of other kinds. SimulationError, PenetrationError: where the run has no end.
    """
    run = replay(problem, us)
    impacts = np.array([event.time for event in run.events]) - float(run.t[0])
    joined: list[tuple[ActionModel, Array]] = []
    t, before = 0.0, np.inf
    for model, u in zip(problem.runningModels, us, strict=True):
        span = model.interval.span
        if joined and np.any(np.abs(impacts - t) <= within * min(before, span)):
            first, given = joined[-1]
            longer = first.longer(first.steps + model.steps)
            joined[-1] = longer, (first.steps * given + model.steps * np.asarray(u)) / longer.steps
        else:
            joined.append((model, np.array(u)))
        t, before = t + span, span
    problem = crocoddyl.ShootingProblem(problem.x0, [model for model, _ in joined], problem.terminalModel)
    return problem, [u for _, u in joined]


def warm_start(model: ActionModel, traj: Trajectory) -> tuple[list[Array], list[Array]]:
    """Return xs and us of a run whose inputs are constant over the intervals of a model, as a solver's start.

    Args:
        model: the action of all nodes. traj: a run with its inputs (record="gradient") and steps of the model's dt.

    Raises:
        InputError: for a run of other steps, or without inputs.
    """
    xs, us = model.interval.nodes(traj)
    return list(xs), list(us)


def replay(problem: Any, us: Sequence[Array] | Array) -> Trajectory:
    """Return the run that a problem of one scene makes with us, as one trajectory, for playback and measurements.

    The problem's states are those of the run where its intervals join. A run that goes on through a node knows more
    there than (q, v): impacts that accumulate, and the point where a contact sticks.
    """
    models = list(problem.runningModels)
    if len(us) != len(models):
        raise InputError(
            "Inputs of a problem", name="us", expected=f"{len(models)}, one per node", got=str(len(us)),
            remedy="Give those of the solver: solver.us",
        )  # fmt: skip
    ours = all(isinstance(model, ActionModel) for model in models)
    if not (ours and all(models[0].interval.continues(model.interval) for model in models)):
        raise InputError(
            "The problem is not one run", name="problem",
            expected="actions of this module, of one scene and equal options", got="others",
            remedy="Replay its parts: model.interval.run(q, v, u)",
        )  # fmt: skip
    first: Interval = models[0].interval
    x0 = np.array(problem.x0)
    run = first.start(x0[: first.nq], x0[first.nq :])
    for model, u in zip(models, us, strict=True):
        model.interval.advance(run, np.asarray(u))
    return run.trajectory()


def _actions(problem: Any) -> list[ActionModel]:
    """Return the actions of a problem that are of this module."""
    models = [*problem.runningModels, problem.terminalModel]
    return [model for model in models if isinstance(model, ActionModel)]


def _raise_failures(models: Sequence[ActionModel], where: tuple[str, ...]) -> None:
    for model in models:
        for failure in model.failures:
            if failure.where in where or not isinstance(failure.error, ContactviError):
                raise failure.error
