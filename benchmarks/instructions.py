"""Instructions of seven scenes, beside stored counts: a change that makes the engine slower shows without any clock.

    python benchmarks/instructions.py [--scenes chain heap] [--update] [--repeats 2] [--overheads]

Each scene runs in a process of its own under `valgrind --tool=callgrind`, which counts the instructions of
`Simulator.run` alone: importing, building and the first reset are not counted. Valgrind comes from the system's
packages together with its header callgrind.h, and a C compiler makes the call that starts and ends the counting.

The counts of one build are the same on every run to a part in 1e4 (`--repeats 2` shows it), so one that differs from
the stored one by more than 3 % is a change of the code. They depend on what compiled and what runs the engine: that is
stored with them, in instructions.json, and counts are compared only where all of it agrees. The kernel runs on AVX2,
the largest instruction set that valgrind knows.

Exit code 0: all counts are within 3 %, or nothing could be compared, which is printed. 1: a count is not. One that is
smaller by more than 3 % fails as well, since the next regression would hide behind it: store it with `--update`.

`--overheads` prints instead what two scenes pay beside what they need, in instructions per step: the hand with pairs
that are apart over the hand without pairs, and the hand without pairs over its stage iterations by the bare kernel.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import contactvi as cvi
from contactvi import _core
from contactvi.bench import heaps
from models import ROBOTS, chain, start

HERE = Path(__file__).resolve().parent
STORED = HERE / "instructions.json"
WITHIN = 0.03
DT, APART = 1e-3, 120  # of the hand: [s], steps
HAND = "allegro_hand_description/urdf/allegro_right_hand.urdf"
INSTRUCTION_SET = "avx2"
REQUIRES = HERE.parent / "pyproject.toml"  # where the exact versions stand of what the engine is made of
START, STOP = "START_INSTRUMENTATION", "STOP_INSTRUMENTATION"
Counts = dict[str, int]
Setting = dict[str, str]


# --- scenes: each returns a simulator at its start, and a number of steps ---------------------------------------------
def smooth_chain() -> tuple[cvi.Simulator, int]:
    """A chain of ten links without contact: the stage kernel and its iterations."""
    return started(cvi.Scene.from_pinocchio(chain(10)), 500, dt=1e-3)


def hand(pairs: bool, steps: int) -> tuple[cvi.Simulator, int]:
    """The Allegro hand from an almost straight pose; for APART steps no two links come nearer than 5 mm."""
    scene = cvi.Scene()
    part = scene.add_urdf(ROBOTS + HAND, base="fixed", mimic=False)
    scene.set_joint("joint_*", damping=0.0, limits=False)
    if not pairs:
        scene.disable_pair(part, part)
    return started(scene, steps, size=0.05, dt=DT)


def hand_falls() -> tuple[cvi.Simulator, int]:
    """The Allegro hand that falls, with its 185 own pairs: skipping pairs, and five impacts."""
    return hand(True, 300)


def hand_apart() -> tuple[cvi.Simulator, int]:
    """The part of that with all pairs apart."""
    return hand(True, APART)


def hand_alone() -> tuple[cvi.Simulator, int]:
    """The same motion without pairs: what a step pays beside the stage kernel."""
    return hand(False, APART)


def cradle() -> tuple[cvi.Simulator, int]:
    """Newton's cradle: flight, exact times of impacts, sequences of impacts at one instant."""
    scene = cvi.load_scene(HERE.parent / "models" / "newtons_cradle.toml")
    sim = cvi.Simulator(scene, dt=1e-2, record=False)
    sim.reset(scene.q0, scene.v0)
    return sim, 500


def grasp() -> tuple[cvi.Simulator, int]:
    """The ball that falls into the Allegro hand and rests there: impacts, persistent contacts, friction."""
    scene = cvi.load_scene(HERE.parent / "models" / "allegro_ball.toml")
    sim = cvi.Simulator(scene, dt=1e-3, record=False)
    sim.reset(scene.q0, scene.v0)
    return sim, 400


def heap() -> tuple[cvi.Simulator, int]:
    """Spheres that fall into a heap: the broad phase, the contact problem of many contacts."""
    scene, q0, v0 = heaps.to_scene(heaps.make("spheres", 0, count=12, restitution=0.0, friction=0.5))
    sim = cvi.Simulator(scene, dt=2e-3, record=False)
    sim.reset(q0, v0)
    return sim, 150


SCENES: dict[str, Callable[[], tuple[cvi.Simulator, int]]] = {
    "chain": smooth_chain, "hand": hand_falls, "apart": hand_apart, "alone": hand_alone, "cradle": cradle,
    "grasp": grasp, "heap": heap,
}  # fmt: skip
# Counted for the overheads alone: the stage iterations of "alone" by the bare kernel, and a call of its `run` without
# steps, whose price a call with any number of steps pays once.
KERNEL, CALL = "kernel", "call"
BARS = {"pairs": 0.10, "step": 0.05}  # of the overheads


def started(scene: cvi.Scene, steps: int, size: float = 0.3, **options: float) -> tuple[cvi.Simulator, int]:
    sim = cvi.Simulator(scene, record=False, **options)
    sim.reset(*start(scene.model, size=size))
    return sim, steps


# --- counting ---------------------------------------------------------------------------------------------------------
def compiled_switch(folder: Path) -> Path:
    """Compile the two functions that start and end the counting; return the library."""
    source = "#include <valgrind/callgrind.h>\n" + "".join(
        f"void {name.lower()}(void) {{ CALLGRIND_{name}; }}\n" for name in (START, STOP)
    )
    (folder / "switch.c").write_text(source)
    made = folder / "switch.so"
    compiler = os.environ.get("CC", "cc")
    command = [compiler, "-O1", "-shared", "-fPIC", "-o", str(made), str(folder / "switch.c")]
    if subprocess.run(command).returncode != 0:
        raise SystemExit(
            "expected valgrind's header valgrind/callgrind.h and a C compiler (CC); install valgrind-devel"
        )
    return made


def run_counted(name: str, switch: Path) -> None:
    """Run a scene in this process, which callgrind watches."""
    sim, steps = SCENES["alone" if name in (KERNEL, CALL) else name]()
    steps = 0 if name == CALL else steps
    library = ctypes.CDLL(str(switch))
    begin, end = library[START.lower()], library[STOP.lower()]
    if name == KERNEL:
        stats = cvi.simulate(sim.scene, sim.q, sim.v, APART * DT, DT).stats
        iterate = partial(_core.iterate_kernel, sim.scene.core(), sim.q, sim.v, sim.options.order // 2)
        begin()
        iterate(stats.stage_iterations, stats.factorizations)
        end()
        return
    begin()
    status = sim.run(steps)
    end()
    if not status.ok:
        raise SystemExit(f"{name}: the run ended early: {status}")


def count(name: str, folder: Path, switch: Path) -> int:
    """Return the instructions of a scene's run."""
    out = folder / f"{name}.out"
    command = ["valgrind", "--tool=callgrind", "--instr-atstart=no", f"--callgrind-out-file={out}", sys.executable]
    fixed = {"CONTACTVI_INSTRUCTION_SET": INSTRUCTION_SET, "PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1",
             "OPENBLAS_NUM_THREADS": "1", "PYTHONMALLOC": "malloc"}  # fmt: skip
    done = subprocess.run(
        [*command, __file__, "--run", name, "--switch", str(switch)],
        env={**os.environ, **fixed}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    total = re.search(r"Collected : (\d+)", done.stdout)
    if done.returncode != 0 or total is None or int(total[1]) == 0:
        raise SystemExit(f"{name}: counting failed, exit code {done.returncode}:\n{done.stdout[-3000:]}")
    return int(total[1])


def measure(names: list[str]) -> Counts:
    with tempfile.TemporaryDirectory() as made, ThreadPoolExecutor(os.cpu_count()) as pool:
        folder = Path(made)
        switch = compiled_switch(folder)
        return dict(zip(names, pool.map(lambda name: count(name, folder, switch), names), strict=True))


@dataclass(frozen=True)
class Overheads:
    """Instructions per step of the hand: with pairs apart, without pairs, and of its stage iterations alone."""

    apart: float
    alone: float
    kernel: float

    @property
    def pairs(self) -> float:
        """What pairs that are apart cost, over the hand without pairs."""
        return self.apart / self.alone - 1.0

    @property
    def step(self) -> float:
        """What a step without pairs costs beside the bare kernel, over the kernel."""
        return self.alone / self.kernel - 1.0


def overheads() -> Overheads:
    """Count the three."""
    counts = measure(["apart", "alone", KERNEL, CALL])
    apart, alone = (counts[name] - counts[CALL] for name in ("apart", "alone"))
    return Overheads(apart / APART, alone / APART, counts[KERNEL] / APART)


def print_overheads() -> None:
    found = overheads()
    print(
        f"hand with pairs apart {found.apart:.0f}, without pairs {found.alone:.0f}, kernel {found.kernel:.0f} per step"
    )
    for what, value, bar in (
        ("pairs apart over no pairs", found.pairs, BARS["pairs"]),
        ("no pairs over the bare kernel", found.step, BARS["step"]),
    ):
        print(f"{what:30} {100 * value:+.1f} % (bar {100 * bar:.0f} %)  {'met' if value <= bar else 'MISSED'}")


def libraries(project: str) -> str:
    """Return the libraries that the engine is built with, and their exact versions, from the text of pyproject.toml.

    The wheel's metadata have no requirements of the build, and the environment of a user does not hold all of them.
    """
    required = re.search(r"^requires = \[(.*?)^\]", project, re.MULTILINE | re.DOTALL)
    found = re.findall(r'"([\w-]+)(?:\[\w+\])?==([\w.]+)"', required[1] if required else "")
    return ", ".join(f"{name} {version}" for name, version in found)


def setting() -> Setting:
    """Return what counts depend on besides the code."""
    text = Path(_core.__file__).read_bytes()
    compilers = sorted({m.decode() for m in re.findall(rb"GCC: \([^)]*\) [0-9.]+|clang version [0-9.]+", text)})
    valgrind = subprocess.run(["valgrind", "--version"], stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    return {
        "compiler": ", ".join(compilers), "machine": platform.machine(), "libc": " ".join(platform.libc_ver()),
        "instruction set": INSTRUCTION_SET, "valgrind": valgrind,
        "libraries": libraries(REQUIRES.read_text()),
        "python": ".".join(platform.python_version_tuple()[:2]),
    }  # fmt: skip


def missing() -> str:
    """Return what is not there that counting needs, empty where all is."""
    if shutil.which("valgrind") is None:
        return "valgrind is not installed"
    if INSTRUCTION_SET not in _core.instruction_sets():
        return f"this processor has no {INSTRUCTION_SET}"
    if shutil.which(os.environ.get("CC", "cc")) is None:
        return "there is no C compiler"
    return ""


# --- comparing --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Verdict:
    """What a comparison says.

    Attributes:
        lines: of the printed table.
        compared: whether the counts may be compared at all.
        wrong: scenes whose count is not within WITHIN of the stored one, or has none.
    """

    lines: tuple[str, ...]
    compared: bool
    wrong: tuple[str, ...]


def verdict(stored: dict[str, dict], with_: Setting, counts: Counts) -> Verdict:
    """Compare counts with the stored ones, {"measured with": ..., "counts": ...}."""
    before: Setting = stored["measured with"]
    keys = [key for key in sorted({*before, *with_}) if before.get(key) != with_.get(key)]
    lines = [f"not compared, {key}: stored {before.get(key)!r}, here {with_.get(key)!r}" for key in keys]
    wrong = []
    for name, found in counts.items():
        known = stored["counts"].get(name)
        line = f"{name:8} {found / 1e6:10.2f} M instructions"
        if known is None:
            line, bad = line + ", none stored", True
        else:
            change = found / known - 1.0
            bad = abs(change) > WITHIN
            line += f", stored {known / 1e6:10.2f} M, {100 * change:+.2f} %"
        if bad and not keys:
            wrong.append(name)
            line += "  CHANGED" if known else "  NEW"
        lines.append(line)
    return Verdict(tuple(lines), not keys, tuple(wrong))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--update", action="store_true", help="store the counts")
    parser.add_argument(
        "--repeats", type=int, default=1, help="measure so many times and print by how much they differ"
    )
    parser.add_argument("--overheads", action="store_true", help="print what pairs and steps cost beside the kernel")
    parser.add_argument("--run", choices=[*SCENES, KERNEL, CALL], help=argparse.SUPPRESS)
    parser.add_argument("--switch", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        run_counted(given.run, given.switch)
        return 0
    if lacks := missing():
        print(f"instruction counts SKIPPED: {lacks}")
        return 0
    if given.overheads:
        print_overheads()
        return 0
    measured = [measure(given.scenes) for _ in range(given.repeats)]
    counts, with_ = measured[0], setting()
    for name in given.scenes if given.repeats > 1 else ():
        found = [one[name] for one in measured]
        print(f"{name:8} {given.repeats} runs differ by {100 * (max(found) / min(found) - 1):.4f} %")
    stored = json.loads(STORED.read_text()) if STORED.exists() else {"measured with": with_, "counts": {}}
    result = verdict(stored, with_, counts)
    print("\n".join(result.lines))
    if given.update:
        kept = stored["counts"] if result.compared else {}
        STORED.write_text(json.dumps({"measured with": with_, "counts": {**kept, **counts}}, indent=1) + "\n")
        print(f"stored in {STORED.name}")
        return 0
    if not result.compared:
        print("instruction counts NOT COMPARED: the stored ones were measured with something else, see above")
    if result.wrong:
        print(f"more than {100 * WITHIN:.0f} % from the stored count, or none stored: {', '.join(result.wrong)}")
    return int(bool(result.wrong))


if __name__ == "__main__":
    sys.exit(main())
