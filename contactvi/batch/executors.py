"""Batches by an executor: chunks of runs in other processes or on other machines, with equal bits.

What all runs have in common, the scene above all, is pickled once; a worker that has seen it keeps it, found by its
hash. Chunks are as long as about a second of work, measured on those before. They are handed on in the order of the
runs, so that a file can be written while others are under way.
"""

from __future__ import annotations

import hashlib
import pickle
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.batch.blocks import Block, joined
from contactvi.batch.plan import Plan, Report
from contactvi.batch.runs import BLOCK_BYTES, blocks_of
from contactvi.batch.scenes import SceneCache
from contactvi.errors import ContactviError, InputError

_SECONDS = 1.0  # of work in a chunk: long beside what sending it costs, short beside losing it
_FIRST = 4  # runs of the chunks before anything was measured
_MOST = 4096  # runs of a chunk
_ATTEMPTS = 4  # to make a chunk
_KEPT = 4  # batches whose scenes a worker keeps

Rows = Mapping[str, NDArray[np.float64]]


class _Chunk:
    """Some runs, and the call that makes them."""

    def __init__(self, first: int, last: int) -> None:
        self.first, self.last, self.attempts = first, last, 0
        self.future: Future[tuple[Block, float]] | None = None
        self.error: BaseException | None = None


def blocks_by(executor: Executor, plan: Plan, ahead: int, report: Report | None = None) -> Iterator[Block]:
    """Yield the results of the runs of a plan in their order, made by an executor.

    Args:
        ahead: chunks that are under way at once.

    Raises:
        InputError: no executor; something that cannot be pickled. ContactviError: a chunk was lost again and again.
    """
    if not callable(getattr(executor, "submit", None)):
        raise InputError(
            "The executor cannot make calls", name="executor", expected="a concurrent.futures.Executor",
            got=type(executor).__name__, remedy="Give concurrent.futures.ProcessPoolExecutor(), for example",
        )  # fmt: skip
    common = _pickled(plan)
    key = hashlib.sha256(common).hexdigest()
    longest = max(1, min(_MOST, int(BLOCK_BYTES / plan.bytes_of_a_run)))
    under_way: deque[_Chunk] = deque()
    runs, next_run = _FIRST, 0
    try:
        while under_way or next_run < plan.runs:
            while next_run < plan.runs and len(under_way) < ahead:
                chunk = _Chunk(next_run, min(next_run + min(runs, longest), plan.runs))
                _submit(executor, plan, key, common, chunk)
                under_way.append(chunk)
                next_run = chunk.last
            chunk = under_way[0]
            block, seconds = _result(executor, plan, key, common, chunk)
            under_way.popleft()
            runs = max(1, int(_SECONDS * len(block) / max(seconds, 1e-6)))
            if report is not None:
                report(chunk.last)
            yield block
    finally:
        for chunk in under_way:
            if chunk.future is not None:
                chunk.future.cancel()


def _submit(executor: Executor, plan: Plan, key: str, common: bytes, chunk: _Chunk) -> None:
    """Send a chunk; what the executor says against it counts as a loss."""
    part = plan.part(chunk.first, chunk.last)
    chunk.attempts += 1
    try:
        chunk.future = executor.submit(run_chunk, key, common, part.runs, dict(part.rows), dict(part.parameters))
    except Exception as error:  # a broken pool, a closed client: whatever the transport raises
        chunk.future, chunk.error = None, error


def _result(executor: Executor, plan: Plan, key: str, common: bytes, chunk: _Chunk) -> tuple[Block, float]:
    """Return the results of a chunk, which is sent again where it was lost."""
    while True:
        if chunk.future is not None:
            try:
                return chunk.future.result()
            except (Exception, CancelledError) as error:  # of the transport: those of runs are in the results
                chunk.error = error
        if chunk.attempts >= _ATTEMPTS:
            raise ContactviError(
                f"The executor has lost the runs {chunk.first} to {chunk.last - 1} {chunk.attempts} times",
                expected="the results of these runs", got=f"{type(chunk.error).__name__}: {chunk.error}",
                remedy="Look at the logs of its workers; a pool that is broken has to be made again",
            ) from chunk.error  # fmt: skip
        _submit(executor, plan, key, common, chunk)


def _pickled(plan: Plan) -> bytes:
    try:
        return pickle.dumps((plan.scene, plan.options, plan.keep, dict(plan.shared), dict(plan.common)))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InputError(
            "The runs cannot be sent to an executor", name="executor",
            expected="functions of the scene and inputs that pickle can store, such as those of a module",
            got=str(error), remedy="Define the functions in a module, or use workers=... instead",
        ) from error  # fmt: skip


_known: OrderedDict[str, tuple[Any, SceneCache]] = OrderedDict()
_lock = threading.Lock()


def run_chunk(key: str, common: bytes, runs: int, rows: Rows, parameters: Rows) -> tuple[Block, float]:
    """Make some runs, in a worker; return their results and the time that they took [s]."""
    start = time.perf_counter()
    with _lock:
        if key not in _known:
            stored = pickle.loads(common)
            _known[key] = stored, SceneCache(stored[1])
            if len(_known) > _KEPT:
                _known.popitem(last=False)
        (scene, options, keep, shared, same), scenes = _known[key]
    plan = Plan(scene, options, keep, runs, rows, shared, parameters, same)
    block = joined(list(blocks_of(plan, 1, None, scenes)))
    return block, time.perf_counter() - start
