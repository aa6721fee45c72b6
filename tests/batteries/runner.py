"""Runs of the battery in a process of their own: a run that hangs or crashes is a finding, not the end of the tests.

As a program: reads one request a line (JSON: family, seed and settings of contact_scenes.draw), makes the run, checks
all laws, and writes one line of JSON.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

# Statuses that a run may end with, by impact map. DTEC has no persistent contact: its runs end with ZENO where impacts
# accumulate, or at the limit of impacts in a step.
ALLOWED_STATUSES = {"ctec": ("SUCCESS",), "mhc": ("SUCCESS",), "dtec": ("SUCCESS", "ZENO", "TOO_MANY_IMPACTS")}


@dataclass
class Report:
    """The result of one run: its label, status, time reached [s], the laws it violates, counts, wall time [s]."""

    label: str
    status: str
    found: list[str]
    time: float = 0.0
    impacts: int = 0
    contact_steps: int = 0
    seconds: float = 0.0

    def __str__(self) -> str:
        return f"{self.label}: {self.status} at {self.time:.9g} s; " + "; ".join(self.found)


def examine(family: str, seed: int, **chosen: Any) -> Report:
    """Run one drawn scene and check all laws."""
    import contactvi as cvi
    from batteries import contact_laws, contact_scenes, energy_laws

    drawn = contact_scenes.draw(family, seed, **chosen)
    start = time.perf_counter()
    traj = cvi.simulate(drawn.scene, drawn.q, drawn.v, throw=False, **drawn.options)
    status, options = traj.status, drawn.options
    found = [str(f) for f in contact_laws.broken(traj)]
    found += [str(f) for f in energy_laws.energy_laws(traj, options.get("dt_contact", options["dt"]))]
    if status.code.name not in ALLOWED_STATUSES[options["impact"]]:
        found.insert(0, str(status))
    seconds, contact_steps = time.perf_counter() - start, traj.stats.contact_steps
    return Report(str(drawn), status.code.name, found, status.time, len(traj.events), contact_steps, seconds)


class Runner:
    """A process that examines one scene after the other, and is started again after a run that hung or crashed.

    module: the module that it runs as a program, which calls `main` with its own `examine`.
    """

    def __init__(self, module: str = "batteries.runner") -> None:
        self._module = module
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def examine(self, family: str, seed: int, limit: float = 60.0, **chosen: Any) -> Report:
        """As `examine` above, within `limit` [s]; status HANG or CRASH where there is no answer."""
        process = self._process or self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps({"family": family, "seed": seed, **chosen}) + "\n")
        process.stdin.flush()
        answered, *_ = select.select([process.stdout], [], [], limit)
        line = process.stdout.readline() if answered else ""
        if line:
            return Report(**json.loads(line))
        self._stop()
        label = " ".join([family, str(seed), *(f"{name}={value}" for name, value in chosen.items())])
        if answered:
            return Report(label, "CRASH", [f"exit code {process.returncode}"])
        return Report(label, "HANG", [f"no answer within {limit:g} s"], seconds=limit)

    def _start(self) -> subprocess.Popen[str]:
        import contactvi

        package = str(Path(contactvi.__file__).parents[1])  # the one under test, wherever it is
        tests = str(Path(__file__).resolve().parents[1])
        paths = os.pathsep.join(filter(None, [package, tests, os.environ.get("PYTHONPATH")]))
        self._process = subprocess.Popen(
            [sys.executable, "-m", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": paths},
            cwd=tests,  # The module option puts this folder first; the source root would shadow an installed package.
        )
        return self._process

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def main(examine: Callable[..., Report] = examine) -> None:
    """Answer requests until there are no more."""
    for line in sys.stdin:
        request = json.loads(line)
        try:
            report = examine(**request)
        except Exception as error:  # of the Python API or of the laws themselves: a finding too
            report = Report(line.strip(), "ERROR", [f"{type(error).__name__}: {error}"])
        print(json.dumps(asdict(report)), flush=True)


if __name__ == "__main__":
    main()
