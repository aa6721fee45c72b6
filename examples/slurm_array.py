"""A sweep as a job array: each task makes its share of the runs, and the shares are joined.

    sbatch --array=0-15 --time=1:00:00 --requeue --wrap "python slurm_array.py"
    python slurm_array.py --join                    # when all tasks have ended

Slurm tells each task its number and how many there are (SLURM_ARRAY_TASK_ID, SLURM_ARRAY_TASK_COUNT); without it one
task makes all runs. A task that is stopped and started again (`--requeue`) goes on with the runs that it lacks, and
one that is done ends at once. The joined file has the bits of one call with all runs.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

import contactvi as cvi


def ball() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", radius=0.1, mass=1.0, placement=(0, 0, 1))
    scene.set_contact(restitution=0.8, friction=0.3)
    return scene


def starts(scene: cvi.Scene, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts of all runs, the same in every task: q (runs, nq) and v (runs, nv), thrown at random."""
    rng = np.random.default_rng(0)
    v = np.zeros((runs, scene.nv))
    v[:, :3] = rng.normal(0.0, 1.0, (runs, 3))
    v[:, 3:] = rng.normal(0.0, 10.0, (runs, 3))
    return np.tile(scene.neutral(), (runs, 1)), v


def make_share(folder: Path, runs: int) -> cvi.StoredBatch:
    task = int(os.environ.get("SLURM_ARRAY_TASK_ID", "0"))
    tasks = int(os.environ.get("SLURM_ARRAY_TASK_COUNT", "1"))
    scene = ball()
    q, v = starts(scene, runs)
    mine = np.array_split(np.arange(runs), tasks)[task]
    folder.mkdir(parents=True, exist_ok=True)
    return cvi.simulate_batch(
        scene, q[mine], v[mine], dt=1e-2, duration=2.0, keep="ends",
        workers=int(os.environ.get("SLURM_CPUS_PER_TASK", "1")),
        path=folder / f"shard-{task:04}.npz", resume=True,
    )  # fmt: skip


def join_shares(folder: Path) -> cvi.StoredBatch:
    return cvi.join_batches(sorted(folder.glob("shard-*.npz")), folder / "runs.npz")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2_000)
    parser.add_argument("--folder", type=Path, default=Path())
    parser.add_argument("--join", action="store_true", help="join the shares instead of making one")
    given = parser.parse_args()
    batch = join_shares(given.folder) if given.join else make_share(given.folder, given.runs)
    print(f"{len(batch)} runs, {int(batch.ok.sum())} reached their end, {int(batch.impacts.sum())} impacts")
