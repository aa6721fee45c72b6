"""Action models for crocoddyl: its solvers (FDDP, Box-FDDP, ...), costs and residuals over contactvi's steps.

`pip install "contactvi[crocoddyl]"`. A node's action is one or several event-driven steps, so that impacts are at no
given nodes and of no given number, and its derivatives are exact through them::

    state = crocoddyl.StateMultibody(scene.model)
    costs = crocoddyl.CostModelSum(state, scene.nv)
    ...
    running = ActionModel(scene, dt=0.02, order=4, costs=costs)
    problem = crocoddyl.ShootingProblem(x0, [running] * 50, ActionModel(scene, dt=0.02, order=4, costs=terminal))
    solver = crocoddyl.SolverFDDP(problem)
    solve(solver, [np.zeros(running.nu)] * 50)
    replay(problem, solver.us).to_html("run.html")
"""

from contactvi.errors import missing_package

try:
    import crocoddyl  # noqa: F401
except ImportError as error:
    raise missing_package("crocoddyl", "crocoddyl") from error

from contactvi.crocoddyl.action import ActionData, ActionModel, Failure
from contactvi.crocoddyl.problems import merge_nodes_at_impacts, replay, solve, warm_start
from contactvi.crocoddyl.residuals import (
    ResidualModelCentroidalMomentum,
    ResidualModelCoMPosition,
    ResidualModelFramePlacement,
    ResidualModelFrameTranslation,
    ResidualModelFrameVelocity,
)

__all__ = [
    "ActionData",
    "ActionModel",
    "Failure",
    "ResidualModelCentroidalMomentum",
    "ResidualModelCoMPosition",
    "ResidualModelFramePlacement",
    "ResidualModelFrameTranslation",
    "ResidualModelFrameVelocity",
    "merge_nodes_at_impacts",
    "replay",
    "solve",
    "warm_start",
]
