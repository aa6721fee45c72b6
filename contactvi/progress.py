"""The progress bar of a run: simulated time, real-time factor, impacts, time left."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn


class RunProgress:
    """A progress callback for `simulate` that draws a bar on the terminal; a context manager.

    Parameters
    ----------
    duration : simulated time of the whole run [s].
    console : where to draw; the standard error stream when None. Nothing is drawn where that is no terminal.
    """

    def __init__(self, duration: float, console: Console | None = None) -> None:
        self._duration = duration
        self._bar = Progress(
            BarColumn(bar_width=20),
            TaskProgressColumn(),
            TextColumn("{task.fields[text]}"),
            TimeRemainingColumn(compact=True),
            console=console or Console(stderr=True),
            transient=True,
        )
        self._task = self._bar.add_task("run", total=duration, text="")
        self._start = time.perf_counter()

    def __enter__(self) -> RunProgress:
        self._start = time.perf_counter()
        if self._bar.console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def __call__(self, t: float, impacts: int) -> None:
        """Show that the run has reached time t [s] from its start, after so many impacts."""
        self._bar.update(self._task, completed=t, text=describe(t, self._duration, impacts, self.seconds))

    @property
    def seconds(self) -> float:
        """Wall time since the start [s]."""
        return time.perf_counter() - self._start


def describe(t: float, duration: float, impacts: int, seconds: float) -> str:
    """Return the text beside the bar."""
    factor = t / seconds if seconds > 0 else 0.0
    return f"{t:.4g}/{duration:.4g} s, {factor:.3g} x real time, {impacts} impacts, left"
