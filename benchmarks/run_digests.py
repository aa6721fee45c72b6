"""Digests of what runs compute, so that two builds of the package can be compared bit by bit.

    python benchmarks/run_digests.py -o before.json          # with one build
    python benchmarks/run_digests.py -o after.json           # with the other
    python benchmarks/run_digests.py --compare before.json after.json

Runs every scene of `models/`, every script of `examples/`, all cases of `contactvi verify`, and random scenes of the
batteries in `tests/batteries`. Of each trajectory the SHA-256 of times, configurations, momenta, velocities, events,
contacts, changes of contacts, forces and reactions is kept, in the order in which the trajectories were made; of
stepping by hand that of the state after each step. A change that is meant to move code and no number leaves all of
them as they are.

Each group runs in a process of its own. A random scene that takes longer than LIMIT seconds is left out and reported.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from helpers.digests import digest, of_trajectory  # noqa: E402

LIMIT = 60  # [s] of one random scene
GROUPS = ("models", "examples", "verify", "battery", "forces")
CONTACT_SEEDS = range(9000, 9018)  # of each of the eight families of the contact battery: 144 scenes
FORCE_SEEDS = range(9000, 9010)  # of each family of the battery with forces


class TookTooLong(BaseException):
    """Raised by the alarm; no Exception, so that nothing on the way takes it for an error of its own."""


@contextlib.contextmanager
def watched() -> Iterator[list[Any]]:
    """Yield a list that takes up every trajectory that is made inside, and a running digest of every step by hand."""
    import contactvi as cvi

    made: list[Any] = []
    first_init, first_step = cvi.Trajectory.__init__, cvi.Simulator.step

    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        first_init(self, *args, **kwargs)
        made.append(self)

    def step(self: Any, *args: Any, **kwargs: Any) -> Any:
        status = first_step(self, *args, **kwargs)
        made.append(digest([self.q, self.v, [self.t]]))
        return status

    cvi.Trajectory.__init__, cvi.Simulator.step = init, step
    try:
        yield made
    finally:
        cvi.Trajectory.__init__, cvi.Simulator.step = first_init, first_step


def collected(made: list[Any]) -> list[Any]:
    """Return the digests of what `watched` took up; neighbouring digests of steps become one."""
    found: list[Any] = []
    steps: list[str] = []
    for item in [*made, None]:
        if isinstance(item, str):
            steps.append(item)
            continue
        if steps:
            found.append({"steps": len(steps), "states": hashlib.sha256("".join(steps).encode()).hexdigest()[:24]})
            steps = []
        if item is not None:
            found.append(of_trajectory(item))
    return found


def models() -> Iterator[tuple[str, Any]]:
    """Every scene of models/, as it stands."""
    import contactvi as cvi

    for path in sorted((ROOT / "models").glob("*.toml")):
        with watched() as made:
            cvi.simulate(cvi.load_scene(path), throw=False)
        yield path.stem, collected(made)


def examples() -> Iterator[tuple[str, Any]]:
    """Every script of examples/, in an empty folder."""
    os.environ["MPLBACKEND"] = "agg"
    for path in sorted((ROOT / "examples").glob("*.py")):
        with tempfile.TemporaryDirectory() as folder, watched() as made:
            before, arguments, sys.argv = Path.cwd(), sys.argv, [str(path)]
            os.chdir(folder)
            sys.path.insert(0, str(path.parent))  # as a script that is run has it
            with contextlib.redirect_stdout(io.StringIO()):
                runpy.run_path(str(path), run_name="__main__")
            sys.path.remove(str(path.parent))
            sys.argv = arguments
            os.chdir(before)
        yield path.stem, collected(made)


def verify() -> Iterator[tuple[str, Any]]:
    """Every case of `contactvi verify`: its trajectories and the numbers that it reports, by its former name."""
    from contactvi.verify.verify import CASES, measure

    for case in CASES:
        with watched() as made:
            result = measure(case)
        numbers = [[check.what, check.got, check.ok] for check in result.checks]
        yield case.former or case.name, {"numbers": numbers, "runs": collected(made)}


def battery() -> Iterator[tuple[str, Any]]:
    """Random scenes with contact."""
    import contactvi as cvi
    from batteries import contact_scenes

    for family in sorted(contact_scenes.FAMILIES):
        for seed in CONTACT_SEEDS:
            drawn = contact_scenes.draw(family, seed, 0.5)
            yield f"{family} {seed}", limited(cvi, drawn.scene, drawn)


def forces() -> Iterator[tuple[str, Any]]:
    """Random scenes with forces, loops and prescribed motion."""
    import contactvi as cvi
    from batteries import force_scenes

    for family in sorted(force_scenes.FAMILIES):
        for seed in FORCE_SEEDS:
            drawn = force_scenes.draw(family, seed)
            yield f"{family} {seed}", limited(cvi, drawn.built.scene, drawn)


def limited(cvi: Any, scene: Any, drawn: Any) -> Any:
    """Run a drawn scene; None where it takes too long."""

    def stop(*_: Any) -> None:
        raise TookTooLong

    signal.signal(signal.SIGALRM, stop)
    signal.alarm(LIMIT)
    try:
        return of_trajectory(cvi.simulate(scene, drawn.q, drawn.v, throw=False, **drawn.options))
    except TookTooLong:
        return None
    except cvi.ContactviError as error:
        return {"error": type(error).__name__}
    finally:
        signal.alarm(0)


def measure_group(group: str) -> None:
    """Print the digests of one group, a line of JSON each."""
    output = sys.stdout
    for name, found in globals()[group]():
        print(json.dumps([name, found]), file=output, flush=True)


def measure_all(groups: list[str], output: Path) -> int:
    """Run the groups, each in a process, and write their digests."""
    found: dict[str, Any] = {}
    failed = False
    for group in groups:
        done = subprocess.run([sys.executable, __file__, "--group", group], stdout=subprocess.PIPE, text=True)
        rows = dict(json.loads(line) for line in done.stdout.splitlines() if line.startswith("["))
        found[group], failed = rows, failed or done.returncode != 0
        slow = [name for name, row in rows.items() if row is None]
        print(f"{group}: {len(rows)} digests, exit code {done.returncode}" + (f", left out {slow}" if slow else ""))
        output.write_text(json.dumps(found, indent=1))
    return int(failed)


def without_words(digests: dict[str, Any]) -> dict[str, Any]:
    """Drop the names of the numbers that the cases of verify report: they are words and may change."""
    for row in digests.get("verify", {}).values():
        row["numbers"] = [values for _, *values in row["numbers"]]
    return digests


def compare(before: Path, after: Path) -> int:
    """Print what differs between two files of digests; return 1 where anything does."""
    one, two = (without_words(json.loads(path.read_text())) for path in (before, after))
    differ = 0
    for group in sorted({*one, *two}):
        left, right = one.get(group, {}), two.get(group, {})
        names = sorted({*left, *right})
        slow = [name for name in names if left.get(name) is None and right.get(name) is None]
        wrong = [name for name in names if name not in slow and left.get(name) != right.get(name)]
        differ += len(wrong)
        print(f"{group}: {len(names) - len(slow) - len(wrong)} of {len(names)} equal, {len(slow)} left out")
        for name in wrong:
            print(f"  differs: {name}")
    return int(differ > 0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("run_digests.json"))
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--group", choices=GROUPS, help=argparse.SUPPRESS)
    parser.add_argument("--compare", nargs=2, type=Path, metavar=("BEFORE", "AFTER"))
    arguments = parser.parse_args()
    if arguments.compare:
        return compare(*arguments.compare)
    if arguments.group:
        measure_group(arguments.group)
        return 0
    return measure_all(arguments.groups, arguments.output)


if __name__ == "__main__":
    sys.exit(main())
