"""What a film costs: a GIF of the Allegro hand with a ball, wall time and the times of the processors of all processes.

python benchmarks/film.py [--frames 100] [--duration 5] [--size 640x480]

The times of the browser's processes are those of /proc at the end of the film: they are printed on Linux alone.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import contactvi as cvi
from contactvi.playback import browser

SCENE = Path(__file__).resolve().parents[1] / "models" / "allegro_ball.toml"


def session_seconds(session: int) -> float:
    """Return what the processes of a session have used [s], those among them that have ended too."""
    ticks = 0
    for process in Path("/proc").glob("[0-9]*/stat"):
        try:
            numbers = process.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended
        if int(numbers[3]) == session:
            ticks += sum(int(number) for number in numbers[11:15])
    return ticks / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--duration", type=float, default=5.0)
    parser.add_argument("--size", default="640x480")
    chosen = parser.parse_args()
    traj = cvi.simulate(cvi.load_scene(SCENE), duration=chosen.duration)
    drawn, used = [], [0.0]
    stop = browser._stop

    def stopped(process: Any) -> None:
        used[0] = session_seconds(process.pid)
        stop(process)

    def counted(page: str, count: int) -> Iterator[bytes]:
        for data in pictures(page, count):
            drawn.append(bool(data))
            yield data

    from contactvi.playback import render

    pictures, render.pictures, browser._stop = render.pictures, counted, stopped
    with tempfile.TemporaryDirectory() as folder:
        own, start = time.process_time(), time.perf_counter()
        speed = 25.0 * chosen.duration / (chosen.frames - 1)
        file = traj.render(Path(folder) / "film.gif", size=chosen.size, fps=25.0, speed=speed)
        wall, own = time.perf_counter() - start, time.process_time() - own
        size = file.stat().st_size
    print(f"{len(drawn)} frames, {sum(drawn)} drawn, {size / 1e6:.2g} MB, {chosen.duration:g} s of a run")
    print(f"wall time {wall:.3g} s; processors: Python {own:.3g} s, browser {used[0]:.3g} s")


if __name__ == "__main__":
    main()
