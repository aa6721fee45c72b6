"""How far an impact that is followed through its impulse is from the one in two phases, and what it takes.

    python benchmarks/impact_laws.py [--draws 60] [--seed 0]

Impacts: a corner of a turning box with friction (tests/helpers/corner.py). The difference is that of the impulses, of
the size of the one in two phases, both by Poisson's restitution. The time is that of one impact that is followed.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from contactvi import _core

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.corner import Corner

CALLS = 50  # of the engine, of which the time is the mean


def main() -> None:
    """Draw impacts and print their differences and times."""
    parser = argparse.ArgumentParser(description="Compare impacts in two phases with those followed through.")
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    rng = np.random.default_rng(chosen.seed)
    differences, times = [], []
    for k in range(chosen.draws):
        corner = Corner(1000 * chosen.seed + k, float(rng.uniform(0.05, 1.0)), float(rng.uniform(0.0, 1.0)))
        impulses = []
        for process in ("two-phase", "incremental"):
            corner.after(impact_process=process)
            impulses.append(corner.run.events[0].impulse_vector)
        differences.append(np.linalg.norm(impulses[1] - impulses[0]) / np.linalg.norm(impulses[0]))
        start = time.perf_counter()
        for _ in range(CALLS):
            _core.follow_impact(corner.G, corner.gamma, corner.mu, corner.e, 0)
        times.append((time.perf_counter() - start) / CALLS)
    size = 100.0 * np.array(differences)
    print(f"{chosen.draws} impulses differ by {np.median(size):.2g} % in the median, {size.max():.2g} % at most")
    print(f"followed in {1e6 * np.median(times):.3g} us in the median, {1e6 * max(times):.3g} us at most")


if __name__ == "__main__":
    main()
