"""contactvi and its peers on S1 to S6 and two robots: wall time per simulated second against error, in one run.

    python benchmarks/peers/compare.py [--scenes S1,S4_e1] [--peers contactvi,mujoco] [-o DIR] [--passes 2]
                                       [--reuse OLD/peers.csv]
    python benchmarks/peers/compare.py --scenes hands -o DIR

`hands` are four hands with mimic joints, which take minutes of their own (mimic_hands.py).

Runs in an environment with contactvi. Each peer runs in its own interpreter, given by CONTACTVI_PEER_MUJOCO,
CONTACTVI_PEER_DRAKE, CONTACTVI_PEER_JIMINY, CONTACTVI_PEER_PYBULLET, or in this one where it is installed here; a peer
that is in neither is skipped, and the table reports it. Writes peers.csv, peers.md and peers.png into DIR and prints
the table. Error: largest |q - q_ref| over the samples every 0.1 s [rad, m]. Time: fastest run, measured inside the
process after a warm-up, without loading, with taking the state at each sample. One thread.

The column `dop853 estimate` is no program: it is the number of evaluations of scipy's DOP853 at its errors, times the
time of contactvi's own scalar evaluation (M^-1 p, dT/dq - g) in this run, its own algebra and event search free. It is
what a compiled DOP853 could at best do.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import peer_contactvi
import pinocchio as pin
import scenes
from report import markdown, picture
from settings import ESTIMATE, HANDS, PEERS, settings

import contactvi as cvi
from contactvi import _core

HERE = Path(__file__).resolve().parent
MODULES = {"mujoco": "mujoco", "drake": "pydrake", "jiminy": "jiminy_py", "pybullet": "pybullet"}
PACKAGES = ("pin", "scipy", "mujoco", "drake", "jiminy-py", "pybullet")
_VERSIONS = (
    "import importlib.metadata as m, json; have = {d.metadata['Name'].lower(): d.version for d in m.distributions()}; "
    "print(json.dumps({n: have[n] for n in %r if n in have}))"
)


def interpreter(peer: str) -> str | None:
    """The peer's Python; None where there is none."""
    given = os.environ.get(f"CONTACTVI_PEER_{peer.upper()}")
    if given:
        return given
    here = MODULES.get(peer) is None or importlib.util.find_spec(MODULES[peer]) is not None
    return sys.executable if here else None


def versions(peers: list[str]) -> dict[str, str]:
    """Versions of what is compared, as each interpreter has it."""
    found = {"contactvi": cvi.__version__}
    for peer in peers:
        python = interpreter(peer)
        if python:
            out = subprocess.run([python, "-c", _VERSIONS % (PACKAGES,)], capture_output=True, text=True, check=True)
            found = {**json.loads(out.stdout), **found}
    return found


def job_of(scene: scenes.Scene, folder: Path) -> dict[str, Any]:
    """The scene as plain data; its URDF is written into the folder."""
    model, urdf = scene.model, scenes.to_urdf(scene)
    file = folder / f"{scene.name}.urdf"
    file.write_text(urdf)
    balls = [{"joint": j, "centre": c.tolist(), "radius": r} for j, c, r in scene.balls]
    nq, nv = (7, 6) if scene.free else (0, 0)  # of a free base
    return {
        "name": scene.name, "urdf": urdf, "urdf_file": str(file), "joints": list(model.names)[2 if scene.free else 1 :],
        "base": scene.q0[:nq].tolist(), "base_v": scene.v0[:nv].tolist(),
        "q0": scene.q0[nq:].tolist(), "v0": scene.v0[nv:].tolist(), "duration": scene.duration, "sample": scenes.SAMPLE,
        "gravity": scenes.GRAVITY, "balls": balls, "wall": scene.wall, "floor": scene.floor,
        "neighbours": scene.neighbours, "restitution": scene.restitution, "followers": scene.followers,
    }  # fmt: skip


def call(peer: str, job: dict[str, Any], folder: Path, repeats: int, slow: float, timeout: float) -> list[dict]:
    """Run a peer's settings in its interpreter."""
    job_file, out_file = folder / "job.json", folder / "out.json"
    job_file.write_text(json.dumps(job))
    out_file.unlink(missing_ok=True)
    python = interpreter(peer)
    assert python is not None
    command = [python, str(HERE / f"peer_{peer.split()[0]}.py"), str(job_file), str(out_file), str(repeats), str(slow)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    if MODULES.get(peer):
        environment.pop("PYTHONPATH", None)  # a foreign interpreter has its own packages
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, env=environment)
    except subprocess.TimeoutExpired:
        return [{"setting": s, "times": [], "failed": f"longer than {timeout:g} s"} for s in job["settings"]]
    if not out_file.exists():
        why = done.stderr[-200:] or f"the process ended with {done.returncode}"
        return [{"setting": s, "times": [], "failed": why} for s in job["settings"]]
    return json.loads(out_file.read_text())


def energies(scene: scenes.Scene, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    model, data = scene.model, scene.model.createData()
    return np.array([
        pin.computeKineticEnergy(model, data, a, b) + pin.computePotentialEnergy(model, data, a)
        for a, b in zip(q, v, strict=True)
    ])  # fmt: skip


def judge(scene: scenes.Scene, result: dict[str, Any], q_ref: np.ndarray, peer: str) -> dict[str, Any]:
    """A row of the results."""
    row = {"scene": scene.name, "peer": peer, "setting": result["setting"], "failed": result.get("failed", "")}
    row.update(error=np.inf, energy_error=np.nan, ms_per_s=np.nan, runs=len(result["times"]))
    row["counts"] = result.get("counts", {})
    if row["failed"]:
        return row
    q, v = np.array(result["q"], dtype=float), np.array(result["v"], dtype=float)
    row["ms_per_s"] = 1e3 * min(result["times"]) / scene.duration
    if q.shape == q_ref.shape and np.isfinite(q).all():
        row["error"] = scene.distance(q, q_ref)
        if scene.restitution == 1.0 and not scene.free:  # all other scenes conserve energy
            start = energies(scene, scene.q0[None], scene.v0[None])[0]
            row["energy_error"] = float(abs(energies(scene, q, v)[-1] - start))
    return row


def scalar_seconds(job: dict[str, Any]) -> float:
    """Time of contactvi's own scalar evaluation (M^-1 p, dT/dq - g), on the fastest instruction set."""
    scene = peer_contactvi.build(job)
    q, v = peer_contactvi.start(scene, job)[:2]
    return min(_core.kernel_seconds(scene.core(), q, v, 1, name)["f"] for name in _core.instruction_sets())


def dop853(rows: list[dict[str, Any]], seconds: float, duration: float) -> list[dict[str, Any]]:
    """Rows of the estimate of a compiled DOP853, from scipy's."""
    mine = [r for r in rows if r["peer"] == "scipy" and r["setting"]["method"] == "DOP853" and not r["failed"]]
    return [{**r, "peer": ESTIMATE, "ms_per_s": 1e3 * seconds * r["counts"]["evaluations"] / duration} for r in mine]


def earlier(files: list[Path], measured: list[str]) -> list[dict[str, Any]]:
    """Rows of earlier runs, of the peers that are not measured now."""
    found = []
    for file in files:
        for row in csv.DictReader(file.open(newline="")):
            if row["peer"] in (*measured, ESTIMATE):
                continue
            row = {**row, "setting": json.loads(row["setting"]), "counts": json.loads(row.get("counts") or "{}")}
            found.append({**row, **{k: float(row[k]) for k in ("error", "energy_error", "ms_per_s")}})
            found[-1]["runs"] = int(row["runs"])
    return found


def merge(rows: dict[tuple[str, str, str], dict[str, Any]], more: list[dict[str, Any]]) -> None:
    """Add the rows of a pass: what was measured before keeps its error and takes the faster time."""
    for row in more:
        known = rows.setdefault((row["scene"], row["peer"], json.dumps(row["setting"])), row)
        if known is not row and not row["failed"]:
            known["ms_per_s"] = float(np.fmin(known["ms_per_s"], row["ms_per_s"]))
            known["runs"] += row["runs"]


def store(rows: list[dict[str, Any]], path: Path) -> None:
    names = ["scene", "peer", "setting", "error", "energy_error", "ms_per_s", "runs", "counts", "failed"]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        plain = dict.fromkeys(("setting", "counts"), json.dumps)
        writer.writerows({k: plain.get(k, lambda x: x)(value) for k, value in row.items()} for row in rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join(scenes.NAMES), help="or hands: those with mimic joints")
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--passes", type=int, default=1, help="through everything; the fastest time counts")
    parser.add_argument(
        "--slow", type=float, default=1.5, help="a setting whose first run takes longer is run once [s]"
    )
    parser.add_argument("--timeout", type=float, default=400.0, help="of one peer on one scene [s]")
    parser.add_argument("--reuse", type=Path, nargs="*", default=[], help="peers.csv of other peers' earlier runs")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/peers"))
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    wanted, names = args.peers.split(","), list(HANDS) if args.scenes == "hands" else args.scenes.split(",")
    peers = [peer for peer in wanted if interpreter(peer)]
    rows: dict[tuple[str, str, str], dict[str, Any]] = {}
    own: dict[str, float] = {}
    estimates: dict[str, list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scene_name in names * args.passes:
            scene = scenes.make(scene_name)
            q_ref, own[scene_name] = scenes.reference(scene)
            plain = job_of(scene, folder)
            for peer in peers:
                job = {**plain, "settings": settings(peer, scene_name)}
                if job["settings"]:
                    results = call(peer, job, folder, args.repeats, args.slow, args.timeout)
                    merge(rows, [judge(scene, result, q_ref, peer) for result in results])
                print(f"{scene_name} {peer}", file=sys.stderr, flush=True)
            seen = [row for row in rows.values() if row["scene"] == scene_name]
            estimates[scene_name] = dop853(seen, scalar_seconds(plain), scene.duration)
            store(list(rows.values()), args.output / "peers.csv")  # a run that is interrupted leaves its rows
    merge(rows, [row for row in earlier(args.reuse, peers) if row["scene"] in own])
    measured = list(rows.values()) + [row for group in estimates.values() for row in group]
    peers += [p for p in PEERS if p not in peers and any(row["peer"] == p for row in measured)]
    store(measured, args.output / "peers.csv")
    missing = [peer for peer in wanted if peer not in peers]
    text = markdown(measured, own, peers, missing, versions(peers))
    (args.output / "peers.md").write_text(text)
    picture(measured, own, args.output / "peers.png")
    print(text)


if __name__ == "__main__":
    main()
