"""A process that makes the cases of one family, so that a crash or a hang is a finding and not the end of the tests.

    python -m fuzz.worker FAMILY SEED COUNT SKIP SECONDS FOLDER

It draws COUNT cases from SEED and makes those after the first SKIP, each within SECONDS of processor time. Before each
it writes to FOLDER/case.json which one it is about to make; afterwards it adds a line to FOLDER/outcomes.jsonl.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import signal
import sys
import tempfile
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from fuzz import families, law
from fuzz.draws import Case, cases

MEMORY = 4 * 2**30  # [bytes] of addresses: more is a finding, and must not be felt by the machine
FILE_SIZE = 2**30  # [bytes]


def make(family: str, start: int, count: int, skip: int, seconds: float, folder: Path) -> None:
    """Draw the cases and make them."""
    module = families.load(family)
    done = 0
    with open(folder / "outcomes.jsonl", "a", encoding="utf-8") as outcomes:

        @seed(start)
        @settings(
            max_examples=count,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(cases(module.draw))
        def each(case: Case) -> None:
            nonlocal done
            done += 1
            if done <= skip:
                return
            text = json.dumps(case)
            (folder / "case.json").write_text(json.dumps({"family": family, "number": done, "case": case}))
            signal.setitimer(signal.ITIMER_PROF, seconds)  # what remains undone at its end is ended by the system
            outcome, where, details = in_empty_folder(module, json.loads(text))
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            found = outcome not in (law.ACCEPTED, law.RAN, law.REFUSED)
            line = {"outcome": outcome, "where": where}
            if found:
                line |= {"details": details[-4000:], "case": case}
            outcomes.write(json.dumps(line) + "\n")
            outcomes.flush()

        each()
    (folder / "case.json").unlink(missing_ok=True)


def in_empty_folder(module: families.Family, case: Case) -> tuple[str, str, str]:
    """Judge a case in a folder of its own that is gone afterwards."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory(prefix="case-", ignore_cleanup_errors=True) as place:
        os.chdir(place)
        try:
            return law.judge(module.attempt, case)
        finally:
            os.chdir(before)


def limit() -> None:
    """Set the limits of this process."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE_SIZE, FILE_SIZE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    faulthandler.enable()  # to the log, where in Python a process crashed
    limit()
    family, *numbers, seconds, folder = sys.argv[1:]
    make(family, *map(int, numbers), float(seconds), Path(folder).resolve())
