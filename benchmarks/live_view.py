"""What the live view costs a loop: `sync` of the Allegro hand with a ball, 1 ms steps, seen by one page.

python benchmarks/live_view.py [--frames 500]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import contactvi as cvi
from contactvi.playback.live import PERIOD

SCENE = Path(__file__).resolve().parents[1] / "models" / "allegro_ball.toml"


# A page in a process of its own, as a browser is: it takes frames until there are no more.
PAGE = """
import http.client, sys
connection = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1].rstrip("/").rsplit(":", 1)[1]))
connection.request("GET", "/frames")
for _ in connection.getresponse():
    pass
"""


def seconds_of(call: Callable[[], object]) -> float:
    """Return the wall time of a call [s]."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=500)
    frames = parser.parse_args().frames
    sim = cvi.Simulator(cvi.load_scene(SCENE), dt=1e-3)
    sim.reset()
    with cvi.view(sim, open_browser=False) as live:
        unseen = [seconds_of(live.sync) for _ in range(1000)]
        page = subprocess.Popen([sys.executable, "-c", PAGE, live.url])
        live.wait_for_page()
        due, idle, steps = [], [], []
        for _ in range(frames):
            last = time.perf_counter()
            steps += [seconds_of(sim.step) for _ in range(16)]
            time.sleep(max(0.0, PERIOD - (time.perf_counter() - last)))
            due.append(seconds_of(live.sync))
            idle.append(seconds_of(live.sync))
        impacts, contacts = sim.impacts, len(sim.contacts)
    page.wait()
    print(f"{frames} frames, {sim.t:.3g} s simulated, {impacts} impacts, {contacts} contact points at the end")
    for name, times in (("sync with a frame", due), ("sync without", idle), ("sync, no page", unseen), ("step", steps)):
        low, middle, high = 1e6 * np.quantile(times, (0.0, 0.5, 0.95))
        print(f"{name:<18} {low:8.1f} us least  {middle:8.1f} us median  {high:8.1f} us 95 %")


if __name__ == "__main__":
    main()
