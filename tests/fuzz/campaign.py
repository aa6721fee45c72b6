"""Many cases of a family: workers are started, watched and started again, and what they find is counted."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fuzz.draws import Case

COLUMNS = ("ran", "accepted", "refused", "foreign", "warned", "not finite", "crash", "hang")
FINDINGS = COLUMNS[3:]
SECONDS = 20.0  # of processor time that a case may take
CHUNK = 500  # cases of one process
WALL = 180.0  # [s] without a new case, after which a process is taken to wait for something that never comes


@dataclass
class Finding:
    """A case that breaks the law. `where` is the same for findings of one kind, `times` how many there were."""

    family: str
    outcome: str
    where: str
    details: str
    case: Case
    times: int = 1

    def __str__(self) -> str:
        text = self.details.strip()
        return f"{self.family}: {self.outcome}, {self.times} times: {self.where}\n{text}\ncase: {json.dumps(self.case)}"


@dataclass
class Tally:
    """The outcomes of the cases of a family, and its findings by kind, each with its shortest case."""

    family: str
    counts: Counter[str] = field(default_factory=Counter)
    findings: dict[tuple[str, str], Finding] = field(default_factory=dict)

    def add(self, outcome: str, where: str, details: str = "", case: Case | None = None) -> None:
        """Count one case."""
        self.counts[outcome] += 1
        if case is None:
            return
        new = Finding(self.family, outcome, where, details, case)
        old = self.findings.setdefault((outcome, where), new)
        if old is not new:
            old.times += 1
            if len(json.dumps(case)) < len(json.dumps(old.case)):
                old.case, old.details = case, details

    def merge(self, other: Tally) -> None:
        """Add the counts and findings of another tally of the family."""
        self.counts += other.counts
        for key, finding in other.findings.items():
            old = self.findings.setdefault(key, finding)
            if old is not finding:
                old.times += finding.times

    @property
    def cases(self) -> int:
        return self.counts.total()

    @property
    def share_accepted(self) -> float:
        """Share of the cases that were accepted."""
        return (self.counts["ran"] + self.counts["accepted"]) / max(1, self.cases)

    def row(self) -> str:
        """Return the counts as a line of the table."""
        counts = "".join(f"{self.counts[name]:>11}" for name in COLUMNS)
        return f"{self.family:<12}{self.cases:>9}{counts}{self.share_accepted:>10.0%}"


def head() -> str:
    """Return the heading of the table."""
    return f"{'family':<12}{'cases':>9}" + "".join(f"{name:>11}" for name in COLUMNS) + f"{'accepted':>10}"


def many(family: str, cases: int, seed: int = 0, jobs: int = 1) -> Tally:
    """Make many cases, in `jobs` processes at a time; return what came of them."""
    tally = Tally(family)
    sizes = [min(CHUNK, cases - begin) for begin in range(0, cases, CHUNK)]
    with ThreadPoolExecutor(jobs) as pool:
        for part in pool.map(lambda k: chunk(family, 1_000_000 * seed + k, sizes[k]), range(len(sizes))):
            tally.merge(part)
    return tally


def chunk(family: str, seed: int, count: int, seconds: float = SECONDS) -> Tally:
    """Make `count` cases drawn from a seed, in one process and its successors; return what came of them.

    seconds: of processor time after which a case hangs.
    """
    tally = Tally(family)
    with tempfile.TemporaryDirectory(prefix="fuzz-", ignore_cleanup_errors=True) as place:
        folder, skip = Path(place), 0
        while True:
            code = _run(family, seed, count, skip, folder, seconds)
            left = folder / "case.json"
            for line in _lines(folder / "outcomes.jsonl"):
                tally.add(line["outcome"], line["where"], line.get("details", ""), line.get("case"))
            (folder / "outcomes.jsonl").unlink(missing_ok=True)
            if code == 0:
                return tally
            log = (folder / "log").read_text(errors="replace")[-20_000:]
            if not left.is_file():
                raise RuntimeError(
                    f"the process of {family}, seed {seed} ended with {code} before its first case:\n{log}"
                )
            last = json.loads(left.read_text())
            left.unlink()
            hung = code in (-signal.SIGPROF, None)
            where = "no end" if hung else f"ended with {code} {_crashed_at(log)}"
            tally.add("hang" if hung else "crash", where, log, last["case"])
            skip = last["number"]


def _run(family: str, seed: int, count: int, skip: int, folder: Path, seconds: float) -> int | None:
    """Run a worker; return its exit code, None where it had to be ended because it waited."""
    import contactvi

    package = str(Path(contactvi.__file__).parents[1])  # the one under test, wherever it is
    tests = str(Path(__file__).resolve().parents[1])
    paths = os.pathsep.join(filter(None, [package, tests, os.environ.get("PYTHONPATH")]))
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    numbers = map(str, (seed, count, skip, seconds))
    command = [sys.executable, "-m", "fuzz.worker", family, *numbers, str(folder)]
    environment = {**os.environ, **threads, "PYTHONPATH": paths, "MPLBACKEND": "agg", "TMPDIR": str(folder)}
    with open(folder / "log", "wb") as log:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=subprocess.STDOUT)
        try:
            while True:
                try:
                    return process.wait(timeout=5.0)
                except subprocess.TimeoutExpired:
                    if _age(folder) > WALL:
                        return None
        finally:
            process.kill()
            process.wait()


def _age(folder: Path) -> float:
    """Return the seconds since a worker has last begun or ended a case, or was started.

    After its last case there is no case.json, and its log may be as old as the process.
    """
    newest = 0.0
    for name in ("case.json", "outcomes.jsonl", "log"):
        with contextlib.suppress(FileNotFoundError):  # the worker removes the case while this is read
            newest = max(newest, (folder / name).stat().st_mtime)
    return time.time() - newest


def _crashed_at(log: str) -> str:
    """Return where in the package a process was when it crashed, by the list of calls in its log."""
    calls = [line.strip() for line in log.rpartition("(most recent call first)")[2].splitlines()]
    return next((call for call in calls if "/contactvi/" in call), "").rpartition("/contactvi/")[2]


def _lines(file: Path) -> list[dict[str, Any]]:
    """Return the whole lines of a file; the last one may have been cut off."""
    if not file.is_file():
        return []
    return [
        json.loads(line) for line in file.read_text(encoding="utf-8").splitlines(keepends=True) if line.endswith("\n")
    ]
