"""dt = "auto" beside the best fixed setting, which a newcomer does not know: scenes of peers/compare.py and four arms.

    python benchmarks/auto.py [--tols 1e-3 1e-6 1e-8] [--scenes S1 talos] [--repeats 5]

For each scene and tol: the fastest of a grid of fixed settings (orders 8 and 16, dt, tolerance of the stage equations)
whose error is at most tol; the time of dt="auto" over that, and what that would be if it were one call with two runs as
long as the fixed one (floor); the time in the engine, of all runs, over that of the fixed one; the sweeps (evaluations
of all stages) of its last run over those of the fixed one; its error over tol, and its estimate of the error over the
error. Errors are the largest over the samples of tenths of a second, against the references of
benchmarks/peers/scenes.py. Times are CPU times of this process, the least of the repeats; those in the engine are wall
times, which are too long where the machine does other things. At the end: median and largest ratio of each tol.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent / "peers"))

import peer_contactvi
import scenes
from compare import job_of

import contactvi as cvi

PARTS = {
    8: (1, 2, 3, 5, 8, 12, 20, 40, 60),
    16: (0.5, 1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24, 40),
}  # steps per tenth of a second
SCENES = (*(name for name in scenes.NAMES if name != "S2_n100"), *scenes.ARMS)
BAR = 2.0  # of the time of "auto" over that of the best fixed setting
STAGE_TOLS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


class Seconds(NamedTuple):
    """Of a call [s]: all of it, and in the engine."""

    whole: float
    engine: float


class Case:
    """A scene as a user runs it, and its reference."""

    def __init__(self, name: str, folder: Path) -> None:
        self.model = scenes.make(name)
        self.job = job_of(self.model, folder)
        self.scene = peer_contactvi.build(self.job)
        self.start = peer_contactvi.start(self.scene, self.job)
        self.reference = scenes.reference(self.model)[0]

    def run(self, setting: dict[str, Any]) -> tuple[cvi.Trajectory, float]:
        """Return the run and its error; infinite where it ended early."""
        q0, v0, at_q, _ = self.start
        options = peer_contactvi.options(self.job, setting)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            traj = cvi.simulate(self.scene, q0, v0, self.job["duration"], **options)
        q = traj.q[1:, at_q]
        return traj, self.model.distance(q, self.reference) if q.shape == self.reference.shape else np.inf

    def seconds(self, setting: dict[str, Any], repeats: int) -> Seconds:
        """Return the times of a call of simulate, the least of the repeats."""
        whole = engine = np.inf
        for _ in range(repeats):
            begin = time.process_time()
            traj, _ = self.run(setting)
            whole, engine = min(whole, time.process_time() - begin), min(engine, traj.stats.seconds)
        return Seconds(whole, engine)


def fixed(case: Case, tols: list[float], repeats: int) -> dict[float, tuple[Seconds, int, dict[str, Any]]]:
    """Return for each tol the times, the sweeps and the setting of the fastest fixed one that meets it."""
    found = []
    for order, parts in PARTS.items():
        for part in parts:
            for tol in STAGE_TOLS:
                setting = {"order": order, "dt": 0.1 / part, "solver_tol": tol, "impact": "ctec"}
                try:
                    traj, error = case.run(setting)
                except cvi.ContactviError:
                    continue
                found.append((traj.stats.sweeps * (1 + order / 8), error, traj.stats.sweeps, setting))
    best = {}
    for tol in tols:
        good = sorted((row for row in found if row[1] <= tol), key=lambda row: row[0])[:4]
        if good:
            best[tol] = min(
                ((case.seconds(row[3], repeats), row[2], row[3]) for row in good), key=lambda row: row[0].whole
            )
    return best


@dataclass(frozen=True)
class Compared:
    """`dt="auto"` beside the best fixed setting of a scene for a tol: times, sweeps, error [m, rad]."""

    scene: str
    tol: float
    fixed: Seconds
    auto: Seconds
    sweeps: float  # over those of the fixed setting
    error: float
    estimate: float
    setting: dict[str, Any]

    @property
    def ratio(self) -> float:
        """Time over that of the fixed setting."""
        return self.auto.whole / self.fixed.whole

    @property
    def floor(self) -> float:
        """What it would be with two runs as long as the fixed one, and nothing else more."""
        return 1.0 + self.fixed.engine / self.fixed.whole


def compare(names: Sequence[str], tols: list[float], repeats: int) -> Iterator[Compared]:
    """Measure scene by scene and tol by tol."""
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            case = Case(name, Path(folder))
            for tol, (seconds, sweeps, setting) in fixed(case, tols, repeats).items():
                auto = {"dt": "auto", "tol": tol, "impact": "ctec"}
                traj, error = case.run(auto)
                took = case.seconds(auto, repeats)
                share = traj.stats.sweeps / sweeps
                yield Compared(name, tol, seconds, took, share, error, traj.error_estimate, setting)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tols", type=float, nargs="+", default=[1e-3, 1e-6, 1e-8])
    parser.add_argument("--scenes", nargs="+", default=list(SCENES))
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    print(f"{'scene':8} {'tol':>7} {'fixed ms':>9} {'auto ms':>9} {'ratio':>6} {'floor':>6} {'engine':>7}"
          f" {'sweeps':>7} {'error/tol':>10} {'estimate/error':>15}  best fixed setting")  # fmt: skip
    ratios: dict[float, dict[str, float]] = {tol: {} for tol in given.tols}
    for row in compare(given.scenes, given.tols, given.repeats):
        ratios[row.tol][row.scene] = row.ratio
        setting = row.setting
        shown = f"order {setting['order']}, dt {setting['dt']:.4g}, tol {setting['tol']:.0e}"
        print(f"{row.scene:8} {row.tol:7.0e} {1e3 * row.fixed.whole:9.3f} {1e3 * row.auto.whole:9.3f}"
              f" {row.ratio:6.2f} {row.floor:6.2f} {row.auto.engine / row.fixed.engine:7.2f} {row.sweeps:7.2f}"
              f" {row.error / row.tol:10.3f} {row.estimate / row.error:15.2f}  {shown}", flush=True)  # fmt: skip
    for tol, found in ratios.items():
        if not found:
            continue
        over = [name for name, ratio in found.items() if ratio > BAR]
        print(f"tol {tol:.0e}: median {np.median(list(found.values())):.2f}, largest {max(found.values()):.2f}"
              f" ({max(found, key=lambda name: found[name])}), over {BAR:g}: {', '.join(over) or 'none'}")  # fmt: skip


if __name__ == "__main__":
    main()
