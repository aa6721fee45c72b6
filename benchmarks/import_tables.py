"""What the import makes of the model files of other packages, beside MuJoCo's and Pinocchio's own numbers.

    python benchmarks/import_tables.py [--only mjcf|urdf] [--match TEXT] [--limit 200] [--full] [--json]

Needs mujoco, gymnasium and dm_control (`pip install "contactvi[test]"`), and runs from the source tree: the comparisons
are those of the tests. Times are those of the engine.

- mjcf: every XML of gymnasium and dm_control. Of those that load the largest differences to MuJoCo's model at random
  states: of the mass, the mass matrix, bias forces with gravity, places of geoms, ranges of joints (all relative, or in
  m and rad), and of how many pairs of geoms that MuJoCo tests; a run of 1 s at dt = 1e-3 s from the file's start, free
  bodies raised where they overlap with something.
- urdf: every URDF of example-robot-data, with the SRDF of its package. Of those that load the largest differences to
  Pinocchio's model: of the mass, the engine's mass matrix, bias forces with gravity, the engine's gravity, limits of
  joints; how many pairs of links overlap in the first pose of the SRDF (scene.disable_overlapping takes them out), and
  how many joints are beyond their limits there (which are switched off); a run of 0.2 s at dt = 1e-3 s from this pose
  without motors, robots with a free base dropped from 5 cm above a floor.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import signal
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import contactvi as cvi

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers import mjcf_files, mujoco_oracle, robot_files

Row = dict[str, Any]
MJCF_SPAN, URDF_SPAN, STEP = 1.0, 0.2, 1e-3  # [s]
DROP = 0.05  # [m] height above the floor from which a free robot falls
FLOOR = "floor_below"


class TookTooLong(BaseException):
    """Raised by the alarm; no Exception, so that nothing on the way takes it for an error of its own."""


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise TookTooLong in the block after so many seconds of wall time."""

    def stop(*_: Any) -> None:
        raise TookTooLong

    handler = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, handler)


# --- one file ---------------------------------------------------------------------------------------------------------
def mjcf_row(path: Path, limit: float) -> Row:
    """What the import makes of one MJCF."""
    import mujoco

    package = next(parent for parent in path.parents if parent.name in mjcf_files.PACKAGES)
    row: Row = {"file": str(path.relative_to(package.parent))}
    try:
        scene = cvi.Scene.from_mjcf(path)
    except cvi.ContactviError as error:
        return row | {"refused": refusal(error)}
    m = mujoco.MjModel.from_xml_path(str(path))
    row |= {"dofs": scene.nv, "lost": lost(scene), "counts": counts(scene)}
    if m.nbody > 1:
        row |= with_largest(vars(mujoco_oracle.differences(scene, m)))
    row["pairs"], row["other_pairs"] = mjcf_files.pairs(scene, m)
    return row | run(scene, mjcf_files.lifted(scene), MJCF_SPAN, limit)


def urdf_row(path: Path, limit: float) -> Row:
    """What the import makes of one URDF."""
    options, scene = robot_files.options_of(path), cvi.Scene()
    given = {name: value for name, value in options.items() if name not in ("base", "srdf")}
    row: Row = {"file": robot_files.label(path), "base": options["base"], "given": given}
    try:
        scene.add_urdf(path, **options)
    except cvi.ContactviError as error:
        return row | {"refused": refusal(error)}
    row |= {"dofs": scene.nv, "lost": lost(scene), "counts": counts(scene), "pairs": len(scene.pair_names)}
    row |= with_largest(vars(robot_files.differences(scene, path, options)))
    poses = scene.named_configurations
    row["poses"] = list(poses)
    q = next(iter(poses.values()))[0] if poses else scene.neutral()
    row["overlaps"] = len(scene.disable_overlapping(q))
    row["beyond"] = robot_files.beyond_limits(scene, q)
    for joint in row["beyond"]:
        scene.set_joint(joint, limits=False)
    if options["base"] == "free":
        q = above_a_floor(scene, q)
    try:
        q = scene.assemble(q)
    except cvi.ContactviError as error:
        return row | {"status": refusal(error)}
    return row | run(scene, q, URDF_SPAN, limit)


def with_largest(differences: dict[str, float]) -> Row:
    return {**differences, "largest": max(differences.values())}


def above_a_floor(scene: cvi.Scene, q: np.ndarray) -> np.ndarray:
    """Add a floor, and return q with the free base so high that the lowest shape is DROP above it."""
    scene.add_halfspace(name=FLOOR)
    pairs = [FLOOR in pair for pair in scene.pair_names]
    if any(pairs):
        q = q.copy()
        q[scene.q_index("root_joint").start + 2] += DROP - float(np.asarray(scene.core().gaps(q)[0])[pairs].min())
    return q


def run(scene: cvi.Scene, q: np.ndarray, span: float, limit: float) -> Row:
    """How a run from q at rest ends, and the engine's time for it."""
    if scene.nv == 0:
        return {"status": "nothing moves"}
    try:
        with limited(limit), warnings.catch_warnings():
            warnings.simplefilter("ignore", cvi.DenseStepWarning)
            traj = cvi.simulate(scene, q, duration=span, dt=STEP, throw=False)
    except TookTooLong:
        return {"status": f"more than {limit:g} s"}
    except cvi.ContactviError as error:
        return {"status": refusal(error)}
    name = traj.status.code.name if np.isfinite(traj.q).all() else "numbers that are not finite"
    found: Row = {"status": name, "seconds": traj.stats.seconds, "reached": traj.status.time}
    return found if traj.status.ok else found | {"message": traj.status.message}


def refusal(error: cvi.ContactviError) -> str:
    """What happened and what was found instead, without the folders of this machine."""
    text = error.what if error.got is None else f"{error.what}: {error.got}"
    return re.sub(r"(/[\w.+-]+)+/", "", " ".join(text.split()))


# --- what is not represented ------------------------------------------------------------------------------------------
def lost(scene: cvi.Scene) -> list[str]:
    """What of a file has no place in the engine: counts, topics and reasons from the import report."""
    found: Counter[str] = Counter()
    for note in scene.report.all_notes("ignored"):
        reason = re.split(r"[:(]", note.text)[0].strip()
        if note.topic in ("option", "element"):
            found[note.name] += 1
        elif note.topic == "sensor":
            found["sensors"] += int(note.name)
        else:
            found[f"{note.topic}: {reason}"] += 1
    return [f"{name} ({count})" if count > 1 else name for name, count in found.items()]


def counts(scene: cvi.Scene) -> dict[str, int]:
    """How many findings of the report changed something or look wrong."""
    return {use: sum(1 for _ in scene.report.all_notes(use)) for use in ("changed", "suspicious")}


# --- the tables -------------------------------------------------------------------------------------------------------
MJCF_KEYS = {"mass": "mass", "matrix": "M(q)", "bias": "bias", "places": "places", "ranges": "ranges"}
URDF_KEYS = {"mass": "mass", "matrix": "M(q)", "bias": "bias", "gravity": "gravity", "limits": "limits"}


def mjcf_table(rows: list[Row], full: bool) -> list[str]:
    keys = MJCF_KEYS if full else {"largest": "difference"}
    head = ("file", "dofs", *keys.values(), "pairs", "1 s", "not represented")
    cells = []
    for row in rows:
        if "refused" not in row:
            other = f" ({row['other_pairs']} differ)" if row["other_pairs"] else ""
            cells.append([
                f"`{row['file']}`", str(row["dofs"]), *(number(row.get(key)) for key in keys), f"{row['pairs']}{other}",
                ending(row), missing(row),
            ])  # fmt: skip
    return [*markdown(head, cells), *refused(rows), "", summary(rows, list(MJCF_KEYS))]


def urdf_table(rows: list[Row], full: bool) -> list[str]:
    keys = URDF_KEYS if full else {"largest": "difference"}
    head = ("file", "base", "dofs", "poses", "overlaps, beyond", *keys.values(), "pairs", "0.2 s", "not represented")
    cells = []
    for row in rows:
        if "refused" not in row:
            given = "".join(f", {name}={value}" for name, value in row["given"].items())
            cells.append([
                f"`{row['file']}`{given}", row["base"], str(row["dofs"]), ", ".join(row["poses"]) or "-",
                f"{row['overlaps']}, {len(row['beyond'])}", *(number(row.get(key)) for key in keys), str(row["pairs"]),
                ending(row), missing(row),
            ])  # fmt: skip
    return [*markdown(head, cells), *refused(rows), "", summary(rows, list(URDF_KEYS))]


def ending(row: Row) -> str:
    """The engine's time of a run that came to its end, else how it ended."""
    return f"{row['seconds']:.2g} s" if row["status"] == "SUCCESS" else row["status"]


def markdown(head: tuple[str, ...], rows: list[list[str]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return lines + ["| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows]


def refused(rows: list[Row]) -> list[str]:
    cells = [[f"`{row['file']}`", row["refused"]] for row in rows if "refused" in row]
    return ["", *markdown(("refused", "reason"), cells)] if cells else []


def missing(row: Row) -> str:
    parts = [*row["lost"], *(f"{count} {use}" for use, count in row["counts"].items() if count)]
    return "; ".join(parts) or "-"


def number(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.1e}" if value else "0"


def summary(rows: list[Row], keys: list[str]) -> str:
    """One line: how many load, run, and the largest differences."""
    loaded = [row for row in rows if "refused" not in row]
    moving = [row for row in loaded if row["dofs"]]
    worst = ", ".join(f"{key} {number(max((row.get(key, 0.0) for row in loaded), default=0.0))}" for key in keys)
    other = [row["other_pairs"] for row in loaded if "other_pairs" in row]
    pairs = f", {sum(other)} pairs that differ" if other else ""
    ended = sum(row["status"] == "SUCCESS" for row in moving)
    return (
        f"{len(loaded)} of {len(rows)} files load, {ended} of the {len(moving)} with something that moves run to the "
        f"end; largest differences: {worst}{pairs}."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("mjcf", "urdf"), help="one of the two tables; by default both")
    parser.add_argument("--match", default="", help="files whose path holds this text")
    parser.add_argument("--limit", type=float, default=200.0, help="wall time of one run [s]")
    parser.add_argument("--full", action="store_true", help="every difference instead of the largest one")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    args = parser.parse_args()
    kinds = {"mjcf": (mjcf_files.files, mjcf_row, mjcf_table), "urdf": (robot_files.files, urdf_row, urdf_table)}
    found: dict[str, list[Row]] = {kind: [] for kind in kinds if args.only in (None, kind)}
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # MuJoCo writes its warnings to a file in the working folder
        for kind, rows in found.items():
            files, measure, _ = kinds[kind]
            for path in [path for path in files() if args.match in str(path)]:
                rows.append(measure(path, args.limit))
                print(path.name, rows[-1].get("refused", rows[-1].get("status")), file=sys.stderr, flush=True)
        os.chdir(before)
    if args.json:
        print(json.dumps(found, indent=1))
        return
    for kind, rows in ((kind, rows) for kind, rows in found.items() if rows):
        print("\n".join([*kinds[kind][2](rows, args.full), ""]))


if __name__ == "__main__":
    main()
