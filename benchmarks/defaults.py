"""What "fast by default" was to mean, in one table: the bar of each number, and what it is now.

    python benchmarks/defaults.py [--rows steps pairs building] [--repeats 5]

Each row comes from the function of the benchmark that prints it with its details; nothing is measured here. Times are
the least of the repeats and so can only be too long: on a machine that does other things look at ratios and at
instruction counts. All rows take some ten minutes; `--rows` chooses groups of them, in the order of the table.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "peers"))

import contactvi as cvi


@dataclass(frozen=True)
class Line:
    """A line of the table.

    Attributes:
        what: was measured.
        value: measured, in `unit`.
        bar: where it should be; None where none was set.
        least: whether the bar is the least that it should be, instead of the most.
    """

    what: str
    value: float
    unit: str = ""
    bar: float | None = None
    least: bool = False

    @property
    def verdict(self) -> str:
        """Either "met" or "MISSED"; nothing without a bar."""
        if self.bar is None:
            return ""
        return "met" if (self.value >= self.bar if self.least else self.value <= self.bar) else "MISSED"

    def __str__(self) -> str:
        bar = "-" if self.bar is None else f"{'>=' if self.least else '<='} {self.bar:g}"
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"| {self.what} | {bar}{unit if self.bar is not None else ''} | {self.value:.3g}{unit} | {self.verdict} |"
        )


def auto(repeats: int) -> Iterator[Line]:
    """Time of dt="auto" over that of the best fixed setting, tol 1e-6."""
    import auto as benchmark

    for row in benchmark.compare(benchmark.SCENES, [1e-6], repeats):
        yield Line(f"`auto` over the best fixed setting, tol 1e-6, {row.scene}", row.ratio, bar=benchmark.BAR)


def contact(repeats: int) -> Iterator[Line]:
    """Time of dt="auto" with persistent contact over that of dt=1e-3, tol 1e-6; both once, they take seconds."""
    import auto_contact

    for name, make in auto_contact.CASES.items():
        found = auto_contact.compare(make(), 1e-6)
        kept = "a warning" if found.warned else "tol met"
        yield Line(
            f"`auto` over dt=1e-3 with contact, {name}, {kept}", found.took / found.seconds, "", auto_contact.BAR
        )


def grasp(repeats: int) -> Iterator[Line]:
    """The hand that closes around a ball beside MuJoCo, at equal steps and for equal errors."""
    import hand_errors

    rows, _ = hand_errors.measure(passes=1, repeats=repeats, slow=1.0, timeout=300.0)

    def seconds(kind: str, dt: float) -> float:
        return next(r["seconds"] for r in rows if r["kind"] == kind and r["setting"]["dt"] == dt)

    for kind in hand_errors.KINDS:
        if kind != "contactvi":
            ratio = seconds("contactvi", 1e-3) / seconds(kind, 1e-3)
            yield Line(f"S7 over {kind}, both dt 1e-3", ratio, "", 1.0 if kind == "mujoco" else None)
    for name, measure, bar in hand_errors.BARS:
        ours = hand_errors.fastest([r for r in rows if r["kind"] == "contactvi"], measure, bar)
        for kind in hand_errors.KINDS:
            theirs = hand_errors.fastest([r for r in rows if r["kind"] == kind], measure, bar)
            if kind != "contactvi" and ours and theirs:
                yield Line(f"S7, time to {name} over {kind}", ours["seconds"] / theirs["seconds"], "", 1.0 / 12.0)


def steps(repeats: int) -> Iterator[Line]:
    """What Python costs around steps, resets and short runs, and a loop as of an environment."""
    import stepping

    for name, scene in stepping.scenes().items():
        yield Line(f"step from Python beside the engine, {name}", stepping.step_overhead(scene, repeats)[1], "us",
                   stepping.BARS["step"])  # fmt: skip
        yield Line(f"reset, {name}", stepping.reset_time(scene, repeats), "us", stepping.BARS["reset"])
        once = stepping.simulate_time(scene, repeats)
        yield Line(f"simulate of one step, {name}", once, "us", stepping.BARS["simulate"][name])
        ours, theirs = stepping.loop_times(name, scene, repeats)
        yield Line(f"loop: MuJoCo's time over ours, {name}", theirs / ours, "", stepping.BARS["share"], least=True)


def dynamics(repeats: int) -> Iterator[Line]:
    """Questions about the equations of motion, on chains."""
    import dynamics as benchmark

    for links in (6, 32):
        found = benchmark.measure(links, repeats)
        for name, bars in benchmark.BARS.items():
            if links in bars:
                yield Line(f"{name}, chain of {links} links", found[name], "us", bars[links])


def building(repeats: int) -> Iterator[Line]:
    """Import, robots, and a chain of 1000 links."""
    import building as benchmark

    for row in benchmark.ROWS:
        found = benchmark.least_of(row, repeats)
        if row.seconds < float("inf"):
            yield Line(row.title, found["seconds"], "s", row.seconds)
        if row.megabytes < float("inf"):
            yield Line(f"{row.title}, memory", found["megabytes"], "MB", row.megabytes)
    few, many = benchmark.iteration_times(repeats)
    title = f"per link and stage iteration, {benchmark.MANY} links over {benchmark.FEW}"
    yield Line(title, many / few, "", benchmark.RATIO)


def pairs(repeats: int) -> Iterator[Line]:
    """What pairs that are apart and a step cost, in instructions."""
    import instructions

    lacks = instructions.missing()
    if lacks:
        print(f"pairs SKIPPED: {lacks}", file=sys.stderr)
        return
    found = instructions.overheads()
    bars = instructions.BARS
    yield Line("hand with pairs apart over the hand without pairs", 100.0 * found.pairs, "%", 100.0 * bars["pairs"])
    yield Line("hand without pairs over the bare stage kernel", 100.0 * found.step, "%", 100.0 * bars["step"])


def batches(repeats: int) -> Iterator[Line]:
    """Two threads over one, and beside MuJoCo's rollout."""
    import batch

    warnings.simplefilter("ignore", cvi.DenseStepWarning)
    for name, durations in batch.CASES.items():
        for duration in durations:
            found = batch.ratios(batch.measure(name, duration, 100 * repeats, [1, 2]))
            yield Line(f"two threads over one, {name}, {duration:g} s", found.threads, "", 1.9, least=True)
            yield Line(f"one thread beside MuJoCo's rollout, time over its, {name}, {duration:g} s", found.peer)
    for name in batch.FLIGHTS:
        row = batch.measure_flight(name, 20 * repeats)
        best = max(float(str(row[own])) for own in ("avx2", "avx512") if own in row)
        yield Line(f"runs in lanes over runs alone, {name}", best / float(str(row["base"])), "", 3.0, least=True)


GROUPS: dict[str, Callable[[int], Iterator[Line]]] = {
    function.__name__: function for function in (auto, contact, grasp, steps, dynamics, building, pairs, batches)
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    print("| | bar | now | |\n|---|---|---|---|")
    for name in given.rows:
        for found in GROUPS[name](given.repeats):
            print(found, flush=True)


if __name__ == "__main__":
    main()
