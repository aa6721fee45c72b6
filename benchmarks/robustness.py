"""What Ctrl-C, kill, full disks, other orders, threads, processes and processors do to runs and their files.

    python benchmarks/robustness.py [--only kill,disk,interrupt,determinism] [--count 45] [--seed 1] [-v]

Prints a table: what was tried, how often, what became of it, and what is wrong with it. The trials are those of
tests/robustness, so that it runs from the source tree; their laws stand in tests/helpers (killed_runs.py,
interrupted_runs.py, repeated_runs.py). The exit code is 1 where anything was found. Some ten minutes in all.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from contactvi import _core
from helpers import interrupted_runs, killed_runs, repeated_runs

Row = tuple[str, int, str, list[str]]  # what was tried, how often, outcomes, findings


def kill(count: int, seed: int) -> Iterator[Row]:
    """Killed writers; afterwards an undisturbed one, which removes what the killed ones have left."""
    with tempfile.TemporaryDirectory() as name:
        folder, began = Path(name), time.monotonic()
        killed_runs.run(folder, killed_runs.DURATIONS[0]).communicate()
        whole = time.monotonic() - began
        found = [text for k in range(count) for text in killed_runs.kill_command(folder, seed + k, whole)]
        left = len(killed_runs.parts(folder / "out"))
        killed_runs.run(folder, killed_runs.DURATIONS[1]).communicate()
        found += killed_runs.problems(folder / "out", killed_runs.DURATIONS[1:])
        found += [f"{part} stays" for part in killed_runs.parts(folder / "out")]
        yield "kill of `contactvi run`", count, f"{left} parts left, removed by the next run", found
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = [text for k in range(count) for text in killed_runs.kill_save(folder, seed + k)]
        left = len(killed_runs.parts(folder))
        killed_runs.save_one(folder)
        found += killed_runs.problems(folder, killed_runs.DURATIONS[:1])
        found += [f"{part} stays" for part in killed_runs.parts(folder)]
        yield "kill of `traj.save`", count, f"{left} parts left, removed by the next save", found


def disk(_: int, __: int) -> Iterator[Row]:
    """Files that may not grow; a disk that is full."""
    limits = (1, 4096, 20_000)
    found = []
    for limit in limits:
        with tempfile.TemporaryDirectory() as name:
            found += killed_runs.kept_after_full(Path(name), limit)
    yield "limit on the size of files", 3 * len(limits), "errors that name the file, old files kept", found
    with tempfile.TemporaryDirectory() as name, killed_runs.small_disk(Path(name)) as mounted:
        if mounted:
            found = killed_runs.kept_after_full(Path(name), 0)
            yield "full disk", 3, "errors that name the file, old files kept", found
        else:
            yield "full disk", 0, "mounting is not allowed here", []


def interrupt(count: int, seed: int) -> Iterator[Row]:
    """Ctrl-C."""
    for kind in (*interrupted_runs.RUNS, *interrupted_runs.LOOPS):
        yield _of_trials(f"Ctrl-C: {kind}", interrupted_runs.in_process(kind, count, seed))
    with tempfile.TemporaryDirectory() as name:
        for kind in interrupted_runs.COMMANDS:
            trials = interrupted_runs.of_commands(kind, count // 2, seed, Path(name))
            yield _of_trials(f"Ctrl-C: `{kind}`", trials)
        yield _of_trials("Ctrl-C: `import contactvi`", interrupted_runs.of_imports(count // 2, seed, Path(name)))


def _of_trials(what: str, trials: list[interrupted_runs.Trial]) -> Row:
    outcomes = Counter(trial.outcome for trial in trials)
    text = ", ".join(f"{number} {outcome}" for outcome, number in outcomes.most_common())
    return what, len(trials), text, [text for trial in trials for text in trial.findings]


def determinism(_: int, __: int) -> Iterator[Row]:
    """The same bits."""
    expected, number = repeated_runs.in_process(), len(repeated_runs.RUNS)
    for what, made in (
        ("again, in three orders", [repeated_runs.in_order(repeated_runs.shuffled(seed)) for seed in range(3)]),
        ("four threads at the same time", repeated_runs.in_threads(4)),
        ("PYTHONHASHSEED 0, 1, 4242, random",
         [repeated_runs.in_process(PYTHONHASHSEED=value) for value in ("0", "1", "4242", "random")]),
        (f"instruction sets {', '.join(_core.instruction_sets())}",
         [repeated_runs.in_process(CONTACTVI_INSTRUCTION_SET=name) for name in _core.instruction_sets()]),
    ):  # fmt: skip
        found = [text for digests in made for text in repeated_runs.differing(expected, digests)]
        yield f"same bits: {what}", number * len(made), f"{number * len(made) - len(found)} equal", found


PARTS: dict[str, Callable[[int, int], Iterator[Row]]] = {
    "kill": kill, "disk": disk, "interrupt": interrupt, "determinism": determinism,
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="parts, separated by commas; by default all")
    parser.add_argument("--count", type=int, default=45, help="trials of a kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-v", "--verbose", action="store_true", help="print every finding")
    args = parser.parse_args()
    wanted = args.only.split(",") if args.only else list(PARTS)
    if not set(wanted) <= set(PARTS):
        parser.error(f"--only takes a list of {', '.join(PARTS)}")
    print("| tried | times | became | findings |\n|---|---|---|---|")
    findings: list[str] = []
    for name in wanted:
        for what, times, became, found in PARTS[name](args.count, args.seed):
            print(f"| {what} | {times} | {became} | {len(found) or 'clean'} |", flush=True)
            findings += [f"{what}: {text}" for text in found]
    print(f"\n{len(findings)} findings." if findings else "\nAll clean.")
    for text in findings if args.verbose else findings[:20]:
        print(f"- {text}")
    return int(bool(findings))


if __name__ == "__main__":
    sys.exit(main())
