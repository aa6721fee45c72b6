"""Runs per second of contactvi.simulate_batch, beside MuJoCo's rollout on the same model, with one and two threads.

    python benchmarks/batch.py [--runs 400] [--threads 1 2] [--only contact flight] [-o FILE.json]

Both start from the same states, make steps of 1 ms, and keep the states at all of them. The model of MuJoCo is made
from the scene (contactvi/bench/mujoco_peer.py): contacts there are springs and dampers as stiff as they may be, and
impacts have no times. So the two do not solve one problem, and their error is told beside their speed: the median
over some runs of the distance of q at the end [m, rad] from contactvi with steps of 1/16 ms. Times are the fastest of
three.

"flight" compares runs without contact, of order 2 with one thread and the states at the ends kept, with those that the
instruction set "base" makes: there each run is made alone, while on the other sets several share the lanes of the
kernel. Both stand in one process, one after the other in each of several rounds, and have the same bits, which is
checked. Seconds are those of the processor, so that others who use the machine count less.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mujoco import rollout

import contactvi as cvi
from contactvi import _core
from contactvi.bench.mujoco_peer import MujocoPeer
from contactvi.states import States
from models import ROBOTS, chain

MODELS = Path(__file__).resolve().parents[1] / "models"
DT, COMPARED = 1e-3, 16  # [s], runs whose error is measured
CASES = {  # scene: durations [s]
    "allegro_ball.toml": (0.1, 0.3, 0.4, 0.6),
    "double_pendulum_wall.toml": (1.0, 5.0),
}


HAND = "allegro_hand_description/urdf/allegro_right_hand.urdf"
FLIGHT = 0.3  # [s]
ROUNDS = 5


def hand() -> cvi.Scene:
    """The Allegro hand with its 185 own pairs."""
    scene = cvi.Scene()
    scene.add_urdf(ROBOTS + HAND, base="fixed", mimic=False)
    scene.set_joint("joint_*", damping=0.0, limits=False)
    return scene


def driven_hand() -> cvi.Scene:
    scene = hand()
    scene.set_servo("joint_*", kp=1.0, kd=0.05)
    return scene


def free_body() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_box("box", (0.1, 0.2, 0.3), mass=1.0)
    return scene


FLIGHTS: dict[str, tuple[Callable[[], cvi.Scene], float]] = {  # scene, size of the velocities at the start
    "double pendulum": (lambda: cvi.Scene.from_pinocchio(chain(2)), 1.0),
    "chain of 10": (lambda: cvi.Scene.from_pinocchio(chain(10)), 1.0),
    "chain of 40": (lambda: cvi.Scene.from_pinocchio(chain(40)), 0.1),
    "free body": (free_body, 1.0),
    "Allegro hand": (hand, 0.05),
    "Allegro hand with servos": (driven_hand, 0.05),
}


def starts(scene: cvi.Scene, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """The start of the scene with other velocities, (runs, nq), (runs, nv)."""
    q = scene.neutral() if scene.q0 is None else scene.q0
    return np.tile(q, (runs, 1)), 0.05 * np.random.default_rng(0).standard_normal((runs, scene.nv))


def fastest(call: Callable[[], object], clock: Callable[[], float] = time.perf_counter, rounds: int = 3) -> float:
    seconds = []
    for _ in range(rounds):
        begin = clock()
        call()
        seconds.append(clock() - begin)
    return min(seconds)


def error(scene: cvi.Scene, found: np.ndarray, true: np.ndarray) -> float:
    return float(np.median(States(scene.model).distance(found, true)))


def mujoco_states(peer: MujocoPeer, qs: np.ndarray, vs: np.ndarray) -> np.ndarray:
    """The starts as MuJoCo's full states, (runs, size)."""
    mujoco, full = peer.mujoco, peer.mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = np.zeros((len(qs), mujoco.mj_stateSize(peer.model, full)))
    for state, q, v in zip(states, qs, vs, strict=True):
        mujoco.mj_getState(peer.model, peer.data(q, v), state, full)
    return states


def measure(name: str, duration: float, runs: int, threads: list[int]) -> list[dict[str, object]]:
    scene = cvi.load_scene(MODELS / name)
    qs, vs = starts(scene, runs)
    steps = round(duration / DT)
    fine = cvi.simulate_batch(
        scene, qs[:COMPARED], vs[:COMPARED], dt=DT / 16.0, duration=duration, keep="ends", max_iterations=100
    ).q
    rows: list[dict[str, object]] = []
    own = {}
    for count in threads:

        def batch(workers: int = count) -> None:
            own["result"] = cvi.simulate_batch(scene, qs, vs, dt=DT, duration=duration, keep="nodes", workers=workers)

        seconds = fastest(batch)
        off = error(scene, own["result"].q[:COMPARED, -1], fine)
        rows.append({"scene": name, "duration": duration, "tool": "contactvi", "threads": count,
                     "seconds": seconds, "runs": runs, "error": off})  # fmt: skip
    peer = MujocoPeer(scene, DT)
    states = mujoco_states(peer, qs, vs)
    for count in threads:
        datas = [peer.mujoco.MjData(peer.model) for _ in range(count)]
        with rollout.Rollout(nthread=0 if count == 1 else count) as pool:
            found = {}

            def roll(pool: rollout.Rollout = pool, datas: list = datas, found: dict = found) -> None:
                found["states"], _ = pool.rollout(peer.model, datas, states, nstep=steps)

            seconds = fastest(roll)
            ends = found["states"][:COMPARED, -1, 1 : 1 + peer.model.nq]  # time stands first
            off = error(scene, np.array([peer.configuration(qpos) for qpos in ends]), fine)
        rows.append({"scene": name, "duration": duration, "tool": "mujoco.rollout", "threads": count,
                     "seconds": seconds, "runs": runs, "error": off})  # fmt: skip
    return rows


def measure_flight(name: str, runs: int) -> dict[str, object]:
    """Runs per second of each instruction set, and of MuJoCo's rollout where it knows all of the scene."""
    make, size = FLIGHTS[name]
    scene = make()
    qs, vs = starts(scene, runs)
    vs *= size / 0.05
    sets = _core.instruction_sets()
    seconds = dict.fromkeys(sets, np.inf)
    ends: dict[str, bytes] = {}

    def batch() -> None:
        ends[_core.instruction_set()] = cvi.simulate_batch(
            scene, qs, vs, dt=DT, duration=FLIGHT, order=2, keep="ends", workers=1
        ).q.tobytes()

    for _ in range(ROUNDS):
        for own in sets:
            _core.instruction_set(own)
            seconds[own] = min(seconds[own], fastest(batch, time.process_time, 1))
    assert len(set(ends.values())) == 1, "instruction sets differ"
    row: dict[str, object] = {"scene": name, "runs": runs} | {own: runs / taken for own, taken in seconds.items()}
    if "servos" not in name:
        peer = MujocoPeer(scene, DT)
        states, steps = mujoco_states(peer, qs, vs), round(FLIGHT / DT)
        data = [peer.mujoco.MjData(peer.model)]
        with rollout.Rollout(nthread=0) as pool:
            row["mujoco.rollout"] = runs / fastest(
                lambda: pool.rollout(peer.model, data, states, nstep=steps), time.process_time, ROUNDS
            )
    return row


def print_flights(rows: list[dict[str, object]]) -> None:
    """In parentheses: times base."""
    tools = [name for name in rows[0] if name not in ("scene", "runs")]
    for row in rows:
        rates = [f"{tool} {row[tool]:.0f} runs/s ({row[tool] / row['base']:.2f})" for tool in tools if tool in row]
        print(f"{row['scene']}, {FLIGHT:g} s: {', '.join(rates)}", flush=True)


class Ratios(NamedTuple):
    """Of the rows of `measure`: runs per second of two threads over one; time of one thread over MuJoCo's rollout's."""

    threads: float
    peer: float


def ratios(rows: list[dict[str, object]]) -> Ratios:
    """Compare the rows of one scene and duration, measured with one and two threads."""
    seconds = {(row["tool"], row["threads"]): float(row["seconds"]) for row in rows}
    own = seconds["contactvi", 1]
    return Ratios(own / seconds["contactvi", 2], own / seconds["mujoco.rollout", 1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--only", nargs="+", choices=["contact", "flight"], default=["contact", "flight"])
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", cvi.DenseStepWarning)
    everything = [measure_flight(name, arguments.runs) for name in FLIGHTS] if "flight" in arguments.only else []
    if everything:
        print_flights(everything)
    for name, durations in CASES.items() if "contact" in arguments.only else ():
        for duration in durations:
            rows = measure(name, duration, arguments.runs, arguments.threads)
            everything += rows
            for row in rows:
                rate = row["runs"] / row["seconds"]
                first = next(other for other in rows if other["tool"] == row["tool"])
                print(
                    f"{name} {duration:g} s, {row['tool']}, {row['threads']} threads: {rate:.0f} runs/s "
                    f"({1e3 / rate:.3g} ms a run), {first['seconds'] / row['seconds']:.2f} times the first, "
                    f"error {row['error']:.2g}",
                    flush=True,
                )
    if arguments.output:
        arguments.output.write_text(json.dumps(everything, indent=1))


if __name__ == "__main__":
    main()
