"""Progress bars on the terminal: of a run (simulated time, real-time factor, impacts, time left), and of other jobs."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn


class JobProgress:
    """A progress callback, called with (fraction, text), that draws a bar on the terminal; a context manager.

    Args:
        console: where to draw; the standard error stream when None. Nothing is drawn where that is no terminal.
        total: what counts as all of the job, in the unit of the callback's first argument.
        time_left: show an estimate of the time left.
    """

    def __init__(self, console: Console | None = None, total: float = 1.0, time_left: bool = True) -> None:
        self._bar = Progress(
            BarColumn(bar_width=20),
            TaskProgressColumn(),
            TextColumn("{task.fields[text]}"),
            *([TimeRemainingColumn(compact=True)] if time_left else []),
            console=console or Console(stderr=True),
            transient=True,
        )
        self._task = self._bar.add_task("", total=total, text="")
        self._start = time.perf_counter()

    def __enter__(self) -> JobProgress:
        self._start = time.perf_counter()
        if self._bar.console.is_terminal:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def show(self, done: float, text: str) -> None:
        """Show how much is done and what is being done."""
        self._bar.update(self._task, completed=done, text=text)

    @property
    def seconds(self) -> float:
        """Wall time since the start [s]."""
        return time.perf_counter() - self._start

    def __call__(self, done: float, text: str) -> None:
        self.show(done, text)


class RunProgress:
    """The bar of a run: a progress callback for `simulate`, called with (time, impacts); a context manager.

    Attributes:
        duration: simulated time of the whole run [s]. console as in JobProgress.
    """

    def __init__(self, duration: float, console: Console | None = None) -> None:
        self._duration = duration
        self._job = JobProgress(console, total=duration)

    def __enter__(self) -> RunProgress:
        self._job.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._job.__exit__(kind, error, trace)

    def __call__(self, t: float, impacts: int) -> None:
        """Show that the run has reached time t [s] from its start, after so many impacts."""
        self._job.show(t, describe(t, self._duration, impacts, self.seconds))

    @property
    def seconds(self) -> float:
        """Wall time since the start [s]."""
        return self._job.seconds


def describe(t: float, duration: float, impacts: int, seconds: float) -> str:
    """Return the text beside the bar."""
    factor = t / seconds if seconds > 0 else 0.0
    return f"{t:.4g}/{duration:.4g} s, {factor:.3g} x real time, {impacts} impacts, left"
