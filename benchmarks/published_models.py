"""Robot models that others publish, as they come: contactvi beside MuJoCo, same step, one process per file.

    python benchmarks/published_models.py [--only mjcf|urdf] [--match TEXT] [--held] [--limit 60] [-o FILE.json]

Needs mujoco, gymnasium, dm_control and example-robot-data (`pip install "contactvi[test]"`), and runs from the source
tree: the lists of files, and what each needs to load, are those of the tests.

- mjcf: every XML of gymnasium and dm_control that loads and moves, from the file's start, free bodies raised where they
  overlap with something. MuJoCo runs the same file with the file's own options but for the step.
- urdf: every URDF of example-robot-data that loads, in the first pose of its SRDF, robots with a free base dropped from
  5 cm above a floor. MuJoCo's model is made of the scene (contactvi.bench.mujoco_peer), with the stiffest contacts that
  it allows.
- Limp: no actuator acts. `--held`: servos hold the joints at the start; those of an MJCF are its position actuators, a
  URDF is given some that are as stiff as hold it.
- Time: CPU time of 0.5 s in steps of 2 ms, of one thread, the least of several runs; the ratio is over MuJoCo's.
  Columns besides: general distances (GJK) per step, impacts, steps that were halved, dense steps, the least gap at the
  end [m].
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import contactvi as cvi

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from import_tables import above_a_floor, markdown

from helpers import mjcf_files, robot_files

SPAN, STEP = 0.5, 2e-3  # [s]
SHORT, ENOUGH = 1.0, 0.3  # [s]: runs that are made again until they have taken so long together, shorter ones longer
STIFF = 100.0  # [1/s] frequency of the servos that a URDF is given, about the inertia of their joints at the start
Row = dict[str, Any]


def best_of(run: Callable[[], float]) -> float:
    times = [run()]
    while sum(times) < (SHORT if len(times) < 3 else ENOUGH):
        times.append(run())
    return min(times)


def timed(function: Callable[[], Any]) -> float:
    began = time.process_time()
    function()
    return time.process_time() - began


# --- one file, in a process of its own --------------------------------------------------------------------------------
def mjcf_case(path: Path, held: bool) -> tuple[cvi.Scene, np.ndarray, Any, Any]:
    """Return the scene, its start, and MuJoCo's model and data."""
    import mujoco

    scene = cvi.Scene.from_mjcf(path, actuators=held)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = STEP
    if not held:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data, q = mujoco.MjData(model), mjcf_files.lifted(scene)
    raised = q - scene.neutral()
    for k in range(1, scene.model.njoints):
        if scene.model.nqs[k] == 7:
            joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, scene.model.names[k])
            if joint >= 0:
                data.qpos[model.jnt_qposadr[joint] + 2] += raised[scene.model.idx_qs[k] + 2]
    if held:
        for k in range(model.nu):
            if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_biastype[k] != 0:
                data.ctrl[k] = data.qpos[model.jnt_qposadr[model.actuator_trnid[k, 0]]]
    return scene, q, model, data


def urdf_case(path: Path, held: bool) -> tuple[cvi.Scene, np.ndarray, Any, Any]:
    from contactvi.bench.mujoco_peer import MujocoPeer

    options, scene = robot_files.options_of(path), cvi.Scene()
    scene.add_urdf(path, **options)
    poses = scene.named_configurations
    q = next(iter(poses.values()))[0] if poses else scene.neutral()
    scene.disable_overlapping(q)
    for joint in robot_files.beyond_limits(scene, q):
        scene.set_joint(joint, limits=False)
    if options["base"] == "free":
        q = above_a_floor(scene, q)
    scene.set_contact(restitution=0.0, friction=0.6)
    q = scene.assemble(q)
    if held:
        inertia = np.diag(scene.mass_matrix(q))
        for name in list(scene.model.names)[1:]:
            at = scene.v_index(name)
            if at.stop - at.start == 1:
                scene.set_servo(name, kp=STIFF**2 * inertia[at.start], kd=2.0 * STIFF * inertia[at.start])
    peer = MujocoPeer(scene, STEP)
    return scene, q, peer.model, peer.data(q, np.zeros(scene.nv))


def measure(kind: str, path: Path, held: bool) -> Row:
    import mujoco

    case = mjcf_case if kind == "mjcf" else urdf_case
    try:
        scene, q, model, data = case(path, held)
    except (cvi.ContactviError, ValueError) as error:
        return {"refused": str(error)[:200]}
    if scene.nv == 0:
        return {"refused": "nothing moves"}
    steps = round(SPAN / STEP)

    def peer() -> None:
        fresh = mujoco.MjData(model)
        fresh.qpos[:], fresh.qvel[:], fresh.ctrl[:] = data.qpos, data.qvel, data.ctrl
        mujoco.mj_step(model, fresh, steps)

    row: Row = {"dofs": scene.nv, "pairs": len(scene.pair_names), "mujoco": best_of(lambda: timed(peer))}
    print(json.dumps(row), flush=True)
    try:
        simulator = cvi.Simulator(scene, dt=STEP)
        simulator.reset(q)
    except cvi.ContactviError as error:
        return row | {"refused": str(error)[:200]}

    def own() -> float:
        simulator.reset(q)
        return timed(lambda: simulator.run(steps))

    row["seconds"] = best_of(own)
    status = simulator.status
    assert status is not None
    row |= {"status": status.code.name, "reached": status.time, "message": status.message[:120]}
    stats = simulator.trajectory().stats
    row["counts"] = stats.to_dict()
    if scene.pair_names:
        row["gap"] = float(np.asarray(scene.core().gaps(simulator.q)[0]).min())
    return row


# --- all of them ------------------------------------------------------------------------------------------------------
def in_a_process(kind: str, path: Path, held: bool, limit: float) -> Row:
    arguments = [sys.executable, __file__, "--one", kind, str(path), *(["--held"] if held else [])]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=limit, env=environment, check=False)
        lines, status = done.stdout.splitlines(), f"CRASH: {(done.stderr.splitlines() or ['no reason'])[-1][:80]}"
    except subprocess.TimeoutExpired as late:
        lines, status = (late.stdout or b"").decode().splitlines(), "TIMEOUT"
    row: Row = {}
    for line in lines:
        if line.startswith("{"):
            row.update(json.loads(line))
    return row if "status" in row or "refused" in row else row | {"status": status, "seconds": limit, "reached": 0.0}


def ratio(row: Row) -> float:
    """Time over MuJoCo's; of a run that has ended early, of the time that it has reached; else not finite."""
    reached = row.get("reached", 0.0) / SPAN
    return row["seconds"] / reached / row["mujoco"] if reached > 0.0 and "mujoco" in row else float("inf")


def table(rows: list[Row]) -> list[str]:
    head = ("file", "dofs", "pairs", "ms/s", "over MuJoCo", "distances", "impacts", "halved", "dense", "gap", "status")
    cells = []
    for row in sorted(rows, key=ratio, reverse=True):
        counts = row.get("counts", {})
        cells.append([
            f"`{row['file']}`", row.get("dofs", "-"), row.get("pairs", "-"), f"{1e3 * row['seconds'] / SPAN:.3g}",
            f"{ratio(row):.3g}", f"{counts.get('distances', 0) / max(counts.get('steps', 0), 1):.3g}",
            counts.get("impacts", "-"), counts.get("halved", "-"), counts.get("dense_steps", "-"),
            f"{row.get('gap', float('nan')):.0e}", row["status"],
        ])  # fmt: skip
    return markdown(head, [list(map(str, row)) for row in cells])


def summary(rows: list[Row]) -> str:
    ratios = sorted(map(ratio, rows))
    ended = sum(row["status"] == "SUCCESS" for row in rows)
    at = int(0.9 * (len(ratios) - 1))
    return (
        f"{len(rows)} files, {ended} to the end; time over MuJoCo's: median {statistics.median(ratios):.2g}, "
        f"90 % {ratios[at]:.2g}, worst {ratios[-1]:.3g}."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("mjcf", "urdf"), help="one of the two; by default both")
    parser.add_argument("--match", default="", help="files whose path holds this text")
    parser.add_argument("--held", action="store_true", help="servos hold the joints")
    parser.add_argument("--limit", type=float, default=60.0, help="wall time of one file [s]")
    parser.add_argument("-o", "--output", type=Path, help="write the rows as JSON")
    parser.add_argument("--one", nargs=2, metavar=("KIND", "FILE"), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.one:
        warnings.simplefilter("ignore")
        print(json.dumps(measure(args.one[0], Path(args.one[1]), args.held)), flush=True)
        return
    kinds = {"mjcf": mjcf_files.files, "urdf": robot_files.files}
    everything: dict[str, list[Row]] = {}
    for kind in [kind for kind in kinds if args.only in (None, kind)]:
        rows: list[Row] = []
        for path in [path for path in kinds[kind]() if args.match in str(path)]:
            if mjcf_files.reason(path) is not None or path.name in robot_files.REFUSED:
                continue
            row = in_a_process(kind, path, args.held, args.limit)
            row["file"] = robot_files.label(path) if kind == "urdf" else "/".join(path.parts[-3:])
            rows.append(row)
            print(row["file"], row.get("refused", row.get("status")), file=sys.stderr, flush=True)
            if args.output:
                args.output.write_text(json.dumps({**everything, kind: rows}, indent=1))
        everything[kind] = rows
        measured = [row for row in rows if "refused" not in row]
        print("\n".join([*table(measured), "", summary(measured), ""]))
        for row in rows:
            if "refused" in row and row["refused"] != "nothing moves":
                print(f"- `{row['file']}` is left out: {row['refused']}")


if __name__ == "__main__":
    main()
