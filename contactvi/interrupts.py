"""Ctrl-C that ends a run between two steps, so that nothing that was computed is lost.

Python raises KeyboardInterrupt between any two instructions of the main thread: also between the return of the engine
and the record of what it did. While Ctrl-C is held back it only sets a flag, which the run asks for.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class CtrlC:
    """Whether Ctrl-C was pressed while it was held back; pressed twice it is raised at once.

    Attributes:
        pressed: whether it was.
    """

    def __init__(self) -> None:
        self.pressed = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if Ctrl-C was pressed."""
        if self.pressed:
            raise KeyboardInterrupt

    def watch(self, progress: Callable[[float, int], object] | None) -> Callable[[float, int], None]:
        """Return a progress callback of a run that calls `progress` and ends the run after Ctrl-C."""

        def call(t: float, impacts: int) -> None:
            if progress is not None:
                progress(t, impacts)
            self.check()

        return call

    def _press(self, number: int, frame: FrameType | None) -> None:
        if self.pressed:
            signal.default_int_handler(number, frame)
        self.pressed = True


@contextmanager
def held_back() -> Iterator[CtrlC]:
    """Hold Ctrl-C back; whoever asks for it has to look at `pressed` in the end.

    Within another `held_back` it is that one's. Signal handlers that are not Python's own stay as they are, and
    threads other than the main one get no signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield CtrlC()
        return
    former = signal.getsignal(signal.SIGINT)
    outer = getattr(former, "__self__", None)
    if isinstance(outer, CtrlC):
        yield outer
    elif former is not signal.default_int_handler:
        yield CtrlC()
    else:
        ctrl_c = CtrlC()
        signal.signal(signal.SIGINT, ctrl_c._press)
        try:
            yield ctrl_c
        finally:
            signal.signal(signal.SIGINT, former)
