"""How good the error estimate of dt = "auto" is: the true error of random motions with contact beside it.

    python benchmarks/estimates.py [--seeds 0:10] [--families "box slides" "four-bar"] [--plot FILE.png] [-o FILE.json]

Motions: estimate_scenes.py, of each family one for each seed, with an accuracy from 1e-3 to 1e-8 that the seed draws,
too. The true error is what `traj.error_estimate` estimates: the largest distance of q over the nodes of the run from
the true motion. That is a run with a thousandth of tol. How far it is from the truth is known by a second one with
fixed steps of order 12, which knows nothing of how "auto" chooses its steps, and by the exact answer if there is one.
What counts:

- known: the two references agree to a tenth of the error, so that true / estimate is known to that.
- within: the references do not tell the error, but it is below the estimate even with their distance added to it.
- too small: the estimate is below a third of the true error; where the references agree to a half of it only, of what
  is left when their distance is taken off.
- open: none of these. The motion multiplies errors, or changes with the smallest of them: it tells nothing.

The histogram is of log10(true / estimate) of the known ones.
With such a run that does not warn the exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import estimate_scenes
import numpy as np
from estimate_scenes import Motion
from matplotlib.figure import Figure

import contactvi as cvi
from contactvi.states import States

FINER = 1e-3  # of the accuracy asked for: that of the reference,
LEAST = 1e-12  # but no more than rounding lets it reach
AGREED = 0.1  # of the error: as near the references are where the error is known
ROUGHLY = 0.5  # of the error: it is known to be as large as that
TOO_SMALL = 3.0  # times the estimate: an error above is a fault of the estimate
SHARE = 0.01  # of the known runs, in which the estimate may be too small
FIXED = 2e-3  # [s] step of the second reference, of which contact steps are a part
CONTACT_PART = 20
LOOKS = 500  # nodes of a run at which it is compared, at most
BINS = np.arange(-8.0, 2.1, 0.5)


class Row(NamedTuple):
    """What is known of one motion; numbers are NaN where a run ended early or took too long.

    Attributes:
        tol, estimate, error: asked for, estimated, true.
        gap: the distance of the two references, or of the first from the exact answer where that is larger.
        warned: what the run warned of its accuracy.
    """

    family: str
    seed: int
    tol: float
    estimate: float
    error: float
    gap: float
    seconds: float
    warned: str = ""
    ended: str = ""

    @property
    def known(self) -> bool:
        return self.gap <= AGREED * self.error

    @property
    def within(self) -> bool:
        return not self.known and self.error + self.gap <= self.estimate

    @property
    def ratio(self) -> float:
        """True error over the estimate."""
        return self.error / self.estimate

    @property
    def too_small(self) -> bool:
        sure = 0.0 if self.known else self.gap
        return self.gap <= ROUGHLY * self.error and self.error - sure > TOO_SMALL * self.estimate

    @property
    def told(self) -> bool:
        """Whether the motion says something about the estimate."""
        return self.known or self.within or self.too_small

    @property
    def fault(self) -> bool:
        return self.too_small and not self.warned


class TooLong(Exception):
    """A run has used up its time."""


def watch(limit: float) -> Callable[[float, int], None]:
    end = time.process_time() + limit

    def progress(t: float, impacts: int) -> None:
        if time.process_time() > end:
            raise TooLong

    return progress


def run(
    motion: Motion, limit: float, scene: cvi.Scene | None = None, **options: Any
) -> tuple[cvi.Trajectory, str]:  # fmt: skip
    """Return a run and what it warned of its accuracy; scene: another one than the motion's."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        traj = cvi.simulate(
            scene or motion.scene, motion.q, motion.v, motion.duration, throw=False, progress=watch(limit), **options
        )
    return traj, "; ".join(str(item.message) for item in caught if issubclass(item.category, cvi.AccuracyWarning))


def distance(motion: Motion, one: cvi.Trajectory, other: cvi.Trajectory, times: np.ndarray) -> float:
    return float(States(motion.scene.model).distance(one.at(times).q, other.at(times).q).max())


def off(known: estimate_scenes.Held, traj: cvi.Trajectory, times: np.ndarray) -> float:
    """Return how far a run is from its exact answer."""
    states = traj.at(times)
    rows = known.observe(np.asarray(states.q), np.asarray(states.v)) - known.exact(np.append(0.0, times))[1:]
    return float(np.linalg.norm(rows[:, known.places], axis=1).max())


def measure(family: str, seed: int, limit: float = 60.0) -> Row:
    """Return the row of a motion; limit: time of each of its runs [s]."""
    motion, tol = estimate_scenes.make(family, seed)
    began, nan = time.process_time(), float("nan")
    try:
        traj, warned = run(motion, limit, dt="auto", tol=tol)
    except TooLong:
        return Row(family, seed, tol, nan, nan, nan, time.process_time() - began, ended="too long")
    seconds = time.process_time() - began
    if not traj.status.ok:
        return Row(family, seed, tol, nan, nan, nan, seconds, warned, str(traj.status))
    estimate = traj.error_estimate
    times = traj.t[1:][np.unique(np.linspace(0, len(traj.t) - 2, LOOKS).astype(int))]
    try:
        fine = run(motion, limit, dt="auto", tol=max(FINER * tol, LEAST))[0]
        dt = motion.duration / np.ceil(motion.duration / FIXED)
        steps: dict[str, Any] = {"dt": dt, "order": 12, "solver_tol": 1e-13, "dense": True}
        steps["dt_contact"] = dt / CONTACT_PART
        fixed = run(motion, limit, motion.steady, **steps)[0]
        gap = distance(motion, fine, fixed, times) if fixed.status.ok else nan
        if motion.known is not None:
            gap = max(gap, off(motion.known, fine, times))
    except TooLong:
        return Row(family, seed, tol, estimate, nan, nan, seconds, warned, "reference too long")
    if not fine.status.ok:
        return Row(family, seed, tol, estimate, nan, nan, seconds, warned, f"reference: {fine.status}")
    return Row(family, seed, tol, estimate, distance(motion, fine, traj, times), gap, seconds, warned)


def counts(rows: Iterable[Row]) -> dict[str, int]:
    rows = list(rows)
    return {
        "motions": len(rows),
        "told": sum(row.told for row in rows),
        "known": sum(row.known for row in rows),
        "within": sum(row.within for row in rows),
        "too small": sum(row.too_small for row in rows),
        "met": sum(row.error <= row.tol for row in rows if row.told),
        "warned": sum(bool(row.warned) for row in rows),
    }


def table(rows: list[Row]) -> list[str]:
    lines = [
        "| family | motions | told | known | within | too small | tol met | warned | median true / estimate | largest |"
    ]
    lines.append("|---" * 10 + "|")
    names = list(dict.fromkeys(row.family for row in rows))
    for name in [*names, "all"]:
        group = [row for row in rows if name in (row.family, "all")]
        ratios = [row.ratio for row in group if row.known]
        numbers = [f"{np.median(ratios):.1g}", f"{max(ratios):.2g}"] if ratios else ["-", "-"]
        lines.append("| " + " | ".join([name, *map(str, counts(group).values()), *numbers]) + " |")
    return lines


def histogram(rows: list[Row]) -> list[str]:
    """Return the histogram of log10(true / estimate) of the known ones, in lines of text."""
    numbers = heights(rows)
    lines = []
    for low, number in zip(BINS, numbers, strict=False):
        lines.append(f"{low:5.1f} .. {low + 0.5:4.1f} {number:4d} " + "#" * int(number))
    return lines


def heights(rows: list[Row]) -> np.ndarray:
    logs = [np.log10(max(row.ratio, 1e-300)) for row in rows if row.known]
    return np.histogram(np.clip(logs, BINS[0], BINS[-1] - 1e-9), BINS)[0]


def picture(rows: list[Row], path: Path) -> None:
    figure = Figure(figsize=(6.0, 3.0), layout="constrained")
    panel = figure.subplots()
    panel.bar(BINS[:-1], heights(rows), width=0.45, align="edge", color="#4b2e83")
    panel.axvline(np.log10(TOO_SMALL), color="#c8371b", lw=1.0)
    panel.set_xlabel("log10(true error / estimate); too small to the right of the line")
    panel.set_ylabel("runs")
    figure.savefig(path, dpi=80)


def verdict(rows: list[Row]) -> list[str]:
    every = counts(rows)
    told = every["told"]
    lines = [
        f"{every['motions']} motions, {told} of which tell something about the estimate. It is too small in"
        f" {every['too small']} ({every['too small'] / max(told, 1):.1%}; the bar: {SHARE:.0%}), of these"
        f" {sum(row.fault for row in rows)} without a warning.",
        f"The tolerance was met in {every['met']} of {told}; {every['warned']} runs warned.",
    ]
    quiet = [row for row in rows if row.told and row.error > row.tol and not row.warned]
    lines.append(f"Not met and no warning: {len(quiet)}.")
    for row in rows:
        if row.too_small or row.ended or row in quiet:
            lines.append(
                f"- {row.family} {row.seed}: tol {row.tol:.1e}, estimate {row.estimate:.1e}, error {row.error:.1e},"
                f" references {row.gap:.1e} {row.ended} {row.warned[:100]}"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:10", help="first and last but one, A:B")
    names = list(estimate_scenes.FAMILIES)
    parser.add_argument("--families", nargs="+", default=names, choices=names)
    parser.add_argument("--limit", type=float, default=60.0, help="CPU time of one run [s]")
    parser.add_argument("--plot", type=Path, help="also draw the histogram into this file")
    parser.add_argument("-o", "--output", type=Path, help="also write what is known of every motion")
    given = parser.parse_args()
    first, last = map(int, given.seeds.split(":"))
    rows: list[Row] = []
    for family in given.families:
        for seed in range(first, last):
            row = measure(family, seed, given.limit)
            rows.append(row)
            kind = "known" if row.known else "within" if row.within else "open"
            print(f"{family} {seed}: {kind}, tol {row.tol:.1e}, estimate {row.estimate:.1e}, error {row.error:.1e},"
                  f" references {row.gap:.1e}, {row.seconds:.2f} s {row.ended} {row.warned[:60]}",
                  file=sys.stderr, flush=True)  # fmt: skip
            if given.output:
                given.output.write_text(json.dumps([r._asdict() for r in rows], indent=1))
    print("\n".join([*table(rows), "", *histogram(rows), "", *verdict(rows)]))
    if given.plot:
        picture(rows, given.plot)
    sys.exit(any(row.fault for row in rows))


if __name__ == "__main__":
    main()
