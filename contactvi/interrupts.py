"""Ctrl-C that ends a run between two steps, so that nothing that was computed is lost.

Python raises KeyboardInterrupt between any two instructions of the main thread: also between the return of the engine
and the record of what it did. While Ctrl-C is held back it is kept, and handled where the run can end.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from signal import getsignal
    from signal import signal as set_signal
else:
    # Those of the module signal look for an enumeration's member in every handler, which takes longer than a step.
    from _signal import getsignal
    from _signal import signal as set_signal


class CtrlC:
    """Ctrl-C while it is held back: the signal handler is called where the run can end, by `check`.

    Attributes:
        pressed: whether the handler has raised KeyboardInterrupt.
    """

    def __init__(self, handler: Callable[[int, FrameType | None], Any] | None = None) -> None:
        self.pressed = False
        self._handler = handler
        self._waiting: tuple[int, FrameType | None] | None = None

    def check(self) -> None:
        """Call the signal handler if Ctrl-C was pressed; raise KeyboardInterrupt if it does so, now or before."""
        waiting, self._waiting = self._waiting, None
        if self._handler is not None and waiting is not None:
            try:
                self._handler(*waiting)
            except KeyboardInterrupt:
                self.pressed = True
                raise
        if self.pressed:
            raise KeyboardInterrupt

    def pressed_alone(self) -> bool:
        """Return whether it has ended and a signal waits for `check`; within another `held_back` that one checks."""
        return self._waiting is not None and getsignal(signal.SIGINT) is self._handler

    def settle(self) -> bool:
        """Return whether Ctrl-C was pressed, after a last check."""
        try:
            self.check()
        except KeyboardInterrupt:
            return True
        return False

    def watch(self, progress: Callable[[float, int], object] | None) -> Callable[[float, int], None]:
        """Return a progress callback of a run that calls `progress` and ends the run after Ctrl-C."""

        def call(t: float, impacts: int) -> None:
            if progress is not None:
                progress(t, impacts)
            self.check()

        return call

    def receive(self, number: int, frame: FrameType | None) -> None:
        """Keep a signal until the next check; a second one is handled at once."""
        if self._waiting is not None and self._handler is not None:
            self._handler(number, frame)
        self._waiting = (number, frame)


class held_back:
    """Hold Ctrl-C back in a `with` block; whoever asks for it has to `settle` in the end.

    Within another `held_back` it is that one's. Threads other than the main one get no signals, and a process that
    ignores them, or dies of them, goes on to do so.
    """

    _former: Any = None  # the handler to be put back

    def __enter__(self) -> CtrlC:
        if threading.current_thread() is not threading.main_thread():
            return CtrlC()
        former = getsignal(signal.SIGINT)
        outer = getattr(former, "__self__", None)
        if isinstance(outer, CtrlC):
            return outer
        if former is None or isinstance(former, int):
            return CtrlC()
        ctrl_c = CtrlC(former)
        self._former = former
        set_signal(signal.SIGINT, ctrl_c.receive)
        return ctrl_c

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._former is not None:
            set_signal(signal.SIGINT, self._former)
