"""`simulate_batch`: many runs of one scene."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from contactvi.batch.blocks import Block, joined
from contactvi.batch.plan import Plan, Report, plan_of
from contactvi.batch.results import BatchResult
from contactvi.batch.runs import blocks_of
from contactvi.errors import DenseStepWarning
from contactvi.inputs import callback, check_choice
from contactvi.options import Dt, FurtherOptions, ImpactMap, Options
from contactvi.simulation.simulator import settings_of
from contactvi.threads import Workers

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.scene import Scene

Keep = Literal["ends", "nodes", "runs"]
KEEPS = ("ends", "nodes", "runs")
MOST_BYTES = 2**28  # of the states at all nodes: above, only the ends are kept unless more is asked for


class BatchOptions(FurtherOptions, total=False):
    """The options of the runs of a batch; `Options` describes them."""

    duration: float | None
    dt: Dt | None
    impact: ImpactMap | None
    order: int | None
    tol: float | None
    sample_dt: float | None
    ledger: Mapping[str, float] | None


def simulate_batch(
    scene: Scene,
    q0s: ArrayLike | None = None,
    v0s: ArrayLike | None = None,
    *,
    parameters: Mapping[str, ArrayLike] | None = None,
    control: Any = None,
    target: Any = None,
    keep: Keep | None = None,
    workers: int | None = None,
    progress: bool | Callable[[int, int], object] = False,
    **options: Unpack[BatchOptions],
) -> BatchResult:
    """Run a scene from many starts, with many parameters or inputs, in several threads.

    Every run has the bits that `simulate` gives it alone, whatever the number of threads. A run that fails does not end
    the others: `result.status` and `result.errors` tell how each ended.

    Args:
        scene: the scene of all runs.
        q0s: starts, Pinocchio's numbers, (runs, nq), or (nq,) for all; None: as in `simulate`.
        v0s: their velocities, (runs, nv) or (nv,); None: as in `simulate`.
        parameters: values by the names of `Scene.parameter`, with a leading dimension (runs, ...), or one for all: such
            as {"friction": (runs, 1), "mass:ball": (runs, 1)}.
        control: as in `simulate` for all runs, or (runs, steps, nv). A function is called by all threads.
        target: as in `simulate` for all runs, or (runs, steps, n).
        keep: "ends": the last states; "nodes": those at all nodes; "runs": all of the runs, as `Trajectory`. None:
            "nodes" where the steps have one length and these states take at most 256 MB, else "ends".
        workers: number of threads; None: one for each core that the process may use.
        progress: True shows a progress bar; or a function called as progress(runs made, runs) now and then.
        **options: duration, dt, order, ...: as in `simulate`.

    Raises:
        InputError: for arguments whose shapes do not fit, and for bad options. Errors of single runs are in the result.
        KeyboardInterrupt: on Ctrl-C, which ends the runs under way within a tenth of a second.

    Warns:
        DenseStepWarning: once, where runs with contact_mode="auto" took dense steps.
    """
    settings = settings_of(scene, dict(options), forced=control is not None or target is not None)
    _ = settings.span
    inputs = {"q0": q0s, "v0": v0s, "control": control, "target": target}
    plan = plan_of(scene, settings, "ends" if keep is None else _checked(keep), inputs, parameters)
    if keep is None and _few_nodes(plan):
        plan = plan_of(scene, settings, "nodes", inputs, parameters)
    number = Workers(workers).number
    with ExitStack() as stack:
        report = _report(plan.runs, progress, stack)
        blocks = list(blocks_of(plan, number, report))
        if report is not None:
            report(plan.runs)
    whole = joined(blocks)
    _warn_of_dense_steps(settings, whole)
    return BatchResult(plan.keep, whole)


def _checked(keep: Any) -> str:
    check_choice("keep", keep, KEEPS, "Unknown part of the runs to keep")
    return str(keep)


def _few_nodes(plan: Plan) -> bool:
    options, model = plan.options, plan.scene.model
    if options.sample_dt is not None:
        nodes = options.span / options.sample_dt
    elif options.auto:
        return False
    else:
        nodes = options.steps / options.record_every
    return bool(plan.runs * (nodes + 2.0) * (model.nq + model.nv + 1) * 8.0 <= MOST_BYTES)


def _report(runs: int, progress: Any, stack: ExitStack) -> Report | None:
    """Return the function that is told how many runs were made."""
    if progress is True:
        from contactvi.progress import JobProgress

        bar = stack.enter_context(JobProgress(total=runs))
        return lambda made: bar(made, f"{made}/{runs} runs")
    called = None if isinstance(progress, bool) else callback("progress", progress)
    return None if called is None else lambda made: called(made, runs)


def _warn_of_dense_steps(options: Options, block: Block) -> None:
    some = int(np.count_nonzero(block.columns["dense_steps"]))
    if some and options.contact_mode == "auto":
        warnings.warn(
            f"Dense contact: {some} of {len(block)} runs took dense steps, in which impacts have no times; see"
            " result.dense_steps. contact_mode='events' refuses such steps, 'steps' asks for them",
            DenseStepWarning,
            stacklevel=3,
        )
