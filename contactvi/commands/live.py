"""`contactvi run --live`: the run of a scene, stepped in real time and shown in the browser meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from contactvi.commands.console import err

if TYPE_CHECKING:
    from contactvi.interrupts import CtrlC
    from contactvi.playback.live import LiveView
    from contactvi.scene.scene import Scene
    from contactvi.trajectory.trajectory import Trajectory

_PROGRESS_PERIOD = 0.1  # [s] of wall time
_PATIENCE = 10.0  # [s] for the browser to open the page


def live_options(scene: Scene, chosen: dict[str, Any]) -> dict[str, Any]:
    """Return the options of a live run: those chosen, with steps of one length."""
    from contactvi.options import DEFAULT_DT
    from contactvi.simulation.settings import settings_of

    if not settings_of(scene, chosen).auto:
        return chosen
    err.print(f'The live view takes steps of one length: dt = {DEFAULT_DT:g} s in place of "auto", which chooses them.')
    return {**chosen, "dt": DEFAULT_DT, "tol": None}  # the accuracy of runs that choose their steps


def run_live(
    scene: Scene,
    chosen: dict[str, Any],
    steps: int,
    title: str,
    browser: bool,
    progress: Callable[[float, int], object],
    ctrl_c: CtrlC,
) -> Trajectory:
    """Step a scene in real time while its page shows it; return what was simulated.

    It ends after `steps` steps, with the status of a step that fails, with Ctrl-C, or when the page is closed.
    """
    from contactvi.playback.viewer import view
    from contactvi.simulation.simulator import Simulator

    sim = Simulator(scene, **chosen)
    sim.reset()
    with view(sim, open_browser=browser, realtime=True, title=title) as live:
        try:
            if browser:
                _wait_for_page(live, ctrl_c)
            told = time.perf_counter()
            for _ in range(steps):
                if not live.is_open or not sim.step().ok:
                    break
                live.sync()
                ctrl_c.check()
                if time.perf_counter() - told > _PROGRESS_PERIOD:
                    told = time.perf_counter()
                    progress(sim.t, sim.impacts)
        except KeyboardInterrupt:
            sim.interrupt()
        if not live.is_open:
            err.print(f"The page was closed at t = {sim.t:.4g} s: the run ends there.")
    return sim.trajectory()


def _wait_for_page(live: LiveView, ctrl_c: CtrlC) -> None:
    """Wait for the browser, so that the page sees the start; raise KeyboardInterrupt after Ctrl-C."""
    start = time.perf_counter()
    while not live.wait_for_page(0.1):
        ctrl_c.check()
        if time.perf_counter() - start > _PATIENCE:
            err.print("No browser has opened the page; the run goes on.")
            return
