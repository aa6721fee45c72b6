"""Calls in several threads, whose results do not depend on how many there are."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from contactvi.errors import ContactviError
from contactvi.inputs import count

T = TypeVar("T")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Workers:
    """Makes calls in threads; the engine computes without the interpreter lock, so that several cores are used.

    Args:
        number: of threads; None for one per core.
    """

    def __init__(self, number: int | None = None) -> None:
        self.number = cores() if number is None else count("workers", number)

    def each(self, calls: int, call: Callable[[int, Callable[[], None]], T]) -> list[T]:
        """Return call(k, check) for k < calls, in this order.

        Of several calls that fail the error is that of the first one, with its index in front. Calls that take long
        have to call `check` now and then: it raises KeyboardInterrupt after another call has failed, and after Ctrl-C.
        """
        stop = threading.Event()

        def check() -> None:
            if stop.is_set():
                raise KeyboardInterrupt

        def one(k: int) -> T:
            with _placed(k, calls):
                return call(k, check)

        if min(self.number, calls) <= 1:
            return [one(k) for k in range(calls)]
        with ThreadPoolExecutor(min(self.number, calls)) as pool:
            try:
                return list(pool.map(one, range(calls)))
            except BaseException:
                stop.set()
                raise


@contextmanager
def _placed(k: int, calls: int) -> Iterator[None]:
    try:
        yield
    except ContactviError as error:
        if calls > 1:
            error.put_in(f"Run {k} of the batch")
        raise
