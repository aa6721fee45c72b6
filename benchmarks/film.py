"""What a film costs: a GIF of the Allegro hand with a ball, wall time and the times of the processors of all processes.

python benchmarks/film.py [--frames 100] [--duration 5] [--size 640x480]

The times of the browser's processes are those of /proc at the end of the film: they are printed on Linux alone.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import contactvi as cvi
from contactvi.playback.browser import measured

SCENE = Path(__file__).resolve().parents[1] / "models" / "allegro_ball.toml"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--duration", type=float, default=5.0)
    parser.add_argument("--size", default="640x480")
    chosen = parser.parse_args()
    traj = cvi.simulate(cvi.load_scene(SCENE), duration=chosen.duration)
    with tempfile.TemporaryDirectory() as folder:
        speed = 25.0 * chosen.duration / (chosen.frames - 1)
        own, start = time.process_time(), time.perf_counter()
        with measured() as cost:
            file = traj.render(Path(folder) / "film.gif", size=chosen.size, fps=25.0, speed=speed)
        wall, own = time.perf_counter() - start, time.process_time() - own
        size = file.stat().st_size
    print(f"{cost.asked} frames, {cost.drawn} drawn, {size / 1e6:.2g} MB, {chosen.duration:g} s of a run")
    print(f"wall time {wall:.3g} s; processors: Python {own:.3g} s, browser {cost.seconds:.3g} s")


if __name__ == "__main__":
    main()
