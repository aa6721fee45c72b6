"""Executors of other packages, whose workers are processes of their own.

What is sent to a worker is found there by its name. Therefore it is here and not in a module of tests: `helpers` is on
the path of every process that a test starts, and `tests` is not.
"""

from __future__ import annotations

import os
import time
from concurrent.futures import Executor, Future
from typing import Any


class RayExecutor(Executor):
    """As in docs/guide/batches.md."""

    def __init__(self, ray: Any) -> None:
        self._ray = ray

    def submit(self, call: Any, /, *args: Any, **named: Any) -> Future[Any]:
        return self._ray.remote(call).remote(*args, **named).future()


class Watched(Executor):
    """Notes which processes have made the calls."""

    def __init__(self, inner: Any) -> None:
        self.inner, self.processes = inner, set[int]()

    def submit(self, call: Any, /, *args: Any, **named: Any) -> Future[Any]:
        outer: Future[Any] = Future()

        def done(inner: Any) -> None:
            try:
                process, result = inner.result()
                self.processes.add(process)
                outer.set_result(result)
            except BaseException as error:  # of the transport
                outer.set_exception(error)

        self.inner.submit(with_process, call, *args, **named).add_done_callback(done)
        return outer


def with_process(call: Any, *args: Any, **named: Any) -> tuple[int, Any]:
    return os.getpid(), call(*args, **named)


def process_after(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def await_two_workers(executor: Any) -> None:
    """Returns when two processes answer side by side: an executor starts them when it likes."""
    for k in range(60):
        # Of other lengths each time, because Dask makes equal calls once.
        calls = [executor.submit(process_after, 0.5 + 1e-3 * i) for i in (2 * k, 2 * k + 1)]
        if len({call.result() for call in calls}) == 2:
            return
    raise AssertionError("one process made all calls for half a minute")
