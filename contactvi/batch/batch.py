"""`simulate_batch`: many runs of one scene."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from contactvi.batch.blocks import Block, joined
from contactvi.batch.executors import blocks_by
from contactvi.batch.plan import Plan, Report, plan_from, plan_of
from contactvi.batch.results import BatchResult
from contactvi.batch.resume import Made, Resumed
from contactvi.batch.runs import blocks_of
from contactvi.batch.storage import StoredBatch, save_batch
from contactvi.errors import DenseStepWarning, InputError
from contactvi.files import check_free, checked_path
from contactvi.inputs import callback, check_choice, flag
from contactvi.keywords import check_keywords, with_keywords
from contactvi.options import Dt, FurtherOptions, ImpactMap, Options
from contactvi.simulation.settings import settings_of
from contactvi.simulation.simulation import check_no_steps
from contactvi.simulation.simulator import Simulator
from contactvi.simulation.targets import by_steps
from contactvi.threads import Workers, cores
from contactvi.trajectory.compiled import filled_scene

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from contactvi.scene.scene import Scene

Keep = Literal["ends", "nodes", "runs"]
KEEPS = ("ends", "nodes", "runs")
KEPT_SECONDS = 2.0  # [s] of work of all threads that an interruption loses at most, long beside writing a file
MOST_BYTES = 2**28  # of the states at all nodes: above, only the ends are kept unless more is asked for


class BatchOptions(FurtherOptions, total=False):
    """The options of the runs of a batch; `Options` describes them."""

    duration: float | None
    dt: Dt | None
    impact: ImpactMap | None
    order: int | None
    tol: float | None
    solver_tol: float | None
    sample_dt: float | None
    ledger: Mapping[str, float] | None


BatchOptions.described = Options  # type: ignore[attr-defined]


@overload
def simulate_batch(
    scene: Scene | Simulator,
    q0s: ArrayLike | None = ...,
    v0s: ArrayLike | None = ...,
    *,
    parameters: Mapping[str, ArrayLike] | None = ...,
    control: Any = ...,
    target: Any = ...,
    keep: Keep | None = ...,
    workers: int | None = ...,
    executor: Executor | None = ...,
    progress: bool | Callable[[int, int], object] = ...,
    path: None = ...,
    overwrite: bool = ...,
    resume: bool = ...,
    **options: Unpack[BatchOptions],
) -> BatchResult: ...


@overload
def simulate_batch(
    scene: Scene | Simulator,
    q0s: ArrayLike | None = ...,
    v0s: ArrayLike | None = ...,
    *,
    parameters: Mapping[str, ArrayLike] | None = ...,
    control: Any = ...,
    target: Any = ...,
    keep: Keep | None = ...,
    workers: int | None = ...,
    executor: Executor | None = ...,
    progress: bool | Callable[[int, int], object] = ...,
    path: str | os.PathLike[str],
    overwrite: bool = ...,
    resume: bool = ...,
    **options: Unpack[BatchOptions],
) -> StoredBatch: ...


@with_keywords(BatchOptions)
def simulate_batch(
    scene: Scene | Simulator,
    q0s: ArrayLike | None = None,
    v0s: ArrayLike | None = None,
    *,
    parameters: Mapping[str, ArrayLike] | None = None,
    control: Any = None,
    target: Any = None,
    keep: Keep | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool | Callable[[int, int], object] = False,
    path: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    resume: bool = False,
    **options: Unpack[BatchOptions],
) -> BatchResult | StoredBatch:
    """Run a scene from many starts, with many parameters or inputs, in several threads.

    Every run has the bits that `simulate` gives it alone, whatever the number of threads. A run that fails does not end
    the others: `result.status` and `result.errors` tell how each ended.

    Args:
        scene: the scene of all runs; or a `Simulator`, from whose present state all runs go on, with its contacts,
            options and what its servos follow, while it stays as it is: for sampling-based control, with the control or
            target of every run and a duration. Runs have the bits of those that a copy of it makes (sim.copy().run).
        q0s: starts, Pinocchio's numbers, (runs, nq), or (nq,) for all; None: as in `simulate`.
        v0s: their velocities, (runs, nv) or (nv,); None: as in `simulate`.
        parameters: values by the names of `Scene.parameter`, with a leading dimension (runs, ...), or one for all: such
            as {"friction": (runs, 1), "mass:ball": (runs, 1)}.
        control: as in `simulate` for all runs, or (runs, steps, nv). A function is called by all threads.
        target: as in `simulate` for all runs, or (runs, steps, n).
        keep: "ends": the last states; "nodes": those at all nodes; "runs": all of the runs, as `Trajectory`. None:
            "nodes" where their number is known before the runs and these states take at most 256 MB, or go to a file;
            else "ends".
        workers: number of threads; None: one for each core that the process may use. With an executor, how many chunks
            of runs are under way at once; None: four for each core.
        executor: a concurrent.futures.Executor that makes the runs in chunks of about a second, such as a
            ProcessPoolExecutor or dask's `Client.get_executor()`; what is sent there has to be picklable. A chunk that
            is lost with its worker is sent again, three times at most.
        path: write the results to this file while runs end, and return a `StoredBatch`, which reads what is asked for.
            The file is there when all runs have ended.
        overwrite: whether a file at `path` is replaced; else it is refused before the first run.
        resume: keep the runs that are made in the folder PATH.parts until all are, so that the same call goes on after
            an interruption; where the file is complete it is returned. What the runs depend on is compared: scene,
            options, starts, parameters and inputs, which have to be arrays.
        progress: True shows a progress bar; or a function called as progress(runs made, runs) now and then.
        **options: as of `Options`.

    Raises:
        InputError: for arguments whose shapes do not fit, and for bad options. Errors of single runs are in the result.
        OverwriteError: there is a file at `path`, without `overwrite`.
        ContactviError: the executor lost a chunk of runs again and again.
        KeyboardInterrupt: on Ctrl-C, which ends the runs under way within a tenth of a second.

    Warns:
        DenseStepWarning: once, where runs with contact_mode="auto" took dense steps.
    """
    check_keywords(simulate_batch, options, "simulate_batch")
    if flag("resume", resume) and path is None:
        raise InputError(
            "Runs are kept in files to be resumed", name="resume", expected="a path with resume=True", got="none",
            remedy="Give path=..., the file of the batch",
        )  # fmt: skip
    if path is not None and not resume:
        check_free(path, overwrite)
    inputs = {"q0": q0s, "v0": v0s, "control": control, "target": target}
    kept = "ends" if keep is None else _checked(keep)
    if isinstance(scene, Simulator):
        starts = {"q0s": q0s, "v0s": v0s, "parameters": parameters, "executor": executor}
        plan = plan_from(scene, dict(options), kept, inputs, starts)
        settings = plan.options
    else:
        settings = settings_of(filled_scene(scene), dict(options), forced=control is not None or by_steps(target))
        _ = settings.span
        if settings.auto:
            check_no_steps(control, target)
        plan = plan_of(scene, settings, kept, inputs, parameters)
    if keep is None and plan.nodes is not None:
        full = replace(plan, keep="nodes")
        plan = full if path is not None or full.runs * full.bytes_of_a_run <= MOST_BYTES else plan
    if plan.keep == "runs" and (path is not None or executor is not None):
        raise InputError(
            "Whole runs are kept in this process only", name="keep", expected="'ends' or 'nodes' with path or executor",
            got="'runs'", remedy="Use keep='nodes', and make the few runs that are looked at again with simulate",
        )  # fmt: skip
    number = Workers(workers).number if executor is None or workers is not None else 4 * cores()
    with ExitStack() as stack:
        report = _report(plan.runs, progress, stack)
        dense: list[int] = []
        made = _maker(executor, number, report, dense, KEPT_SECONDS if resume else None)
        result: BatchResult | StoredBatch
        if path is None:
            result = BatchResult(plan.keep, joined(list(made(plan, 0))))
        elif resume:
            resumed = Resumed(checked_path(path), plan, overwrite)
            result = resumed.finished or resumed.run(made)
        else:
            result = save_batch(path, plan, made(plan, 0), overwrite)
        if report is not None:
            report(plan.runs)
    if sum(dense) and settings.contact_mode == "auto":
        warnings.warn(
            f"Dense contact: {sum(dense)} of {plan.runs} runs took dense steps, in which impacts have no times; see"
            " result.dense_steps. contact_mode='events' refuses such steps, 'steps' asks for them",
            DenseStepWarning,
            stacklevel=2,
        )
    return result


def _maker(
    executor: Executor | None, number: int, report: Report | None, dense: list[int], seconds: float | None
) -> Made:
    """Return what makes the runs of a plan, or of a part of it from a given run on; seconds as of `blocks_of`."""

    def made(part: Plan, first: int) -> Iterator[Block]:
        told = report if report is None or not first else lambda count: report(first + count)
        if executor is None:
            blocks = blocks_of(part, number, told, seconds=seconds)
        else:
            blocks = blocks_by(executor, part, number, told)
        return _watched(blocks, part, dense)

    return made


def _watched(blocks: Iterator[Block], plan: Plan, dense: list[int]) -> Iterator[Block]:
    """Yield blocks with what was given for their runs, and note how many runs of each took dense steps."""
    first = 0
    for block in blocks:
        block.given = plan.part(first, first + len(block)).given
        first += len(block)
        dense.append(int(np.count_nonzero(block.columns["dense_steps"])))
        yield block


def _checked(keep: Any) -> str:
    check_choice("keep", keep, KEEPS, "Unknown part of the runs to keep")
    return str(keep)


def _report(runs: int, progress: Any, stack: ExitStack) -> Report | None:
    """Return the function that is told how many runs were made."""
    if progress is True:
        from contactvi.progress import JobProgress

        bar = stack.enter_context(JobProgress(total=runs))
        return lambda made: bar(made, f"{made}/{runs} runs")
    called = None if isinstance(progress, bool) else callback("progress", progress)
    return None if called is None else lambda made: called(made, runs)
