"""The exact derivatives of runs beside fourth-order differences of the engine itself, family by family.

    python benchmarks/derivative_battery.py [--quick] [--seeds 1] [--only TEXT]

Prints a table: cases, those refused, impacts on the way, columns that were compared and those that differences cannot
decide, the largest disagreement of the state at the end and of the times of the impacts (relative to the largest entry
of a column) with the own error of the differences there; then what was refused and why, and how far one step of momenta
is from symplectic. The cases are those of tests/helpers/derivative_cases.py, so that it runs from the source tree. The
exit code is 1 where a derivative and its differences disagree by more than both the bar and the differences' own error.
Some seven minutes on one core; --quick takes one.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from rich.console import Console

from contactvi.derivatives.gradient_check import Comparison
from contactvi.progress import JobProgress
from contactvi.tables import print_table, text_table
from helpers.derivative_battery import BAR, SYMPLECTIC, Row, measure, sample, symplectic_errors
from helpers.derivative_cases import all_cases

COLUMNS = (
    "family", "cases", "refused", "impacts", "columns", "undecided", "state", "own error", "times", "own error ",
)  # fmt: skip
QUICK = 2  # cases of a family


def pair(part: Comparison | None) -> list[str]:
    return ["", ""] if part is None else [f"{part.relative_difference:.1e}", f"{part.relative_own:.1e}"]


def cells(row: Row) -> list[str]:
    compared, undecided = sum(row.columns.values()), row.columns["exact"]
    numbers = [row.cases, sum(row.refused.values()), row.impacts, compared, undecided]
    return [row.family, *(str(number) if number else "" for number in numbers), *pair(row.state), *pair(row.times)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two cases of each family")
    parser.add_argument("--seeds", type=int, default=1, help="of every case")
    parser.add_argument("--only", default="", help="families whose name has this text")
    args = parser.parse_args()
    cases = [case for case in all_cases(args.seeds) if args.only in case.family]
    cases = sample(cases, QUICK) if args.quick else cases
    out, began = Console(highlight=False, soft_wrap=True), time.monotonic()
    with JobProgress(total=float(len(cases))) as bar:
        rows = measure(cases, bar)
    print_table(out, text_table(COLUMNS, map(cells, rows), right=COLUMNS[1:]))
    for row in rows:
        for reason, count in row.refused.items():
            print(f"refused {count} x {row.family}: {reason}")
    faults = [text for row in rows for text in row.faults]
    print(f"\n{len(cases)} cases in {time.monotonic() - began:.0f} s, bar {BAR:g}; {len(faults)} disagreements")
    for fault in faults:
        print(f"  {fault}")
    errors = symplectic_errors(1 if args.quick else 5)
    worst = max(errors, key=lambda joints: errors[joints])
    print(f"A^T J A - J: at most {errors[worst]:.1e} ({worst}), bar {SYMPLECTIC:g}")
    return int(bool(faults) or errors[worst] > SYMPLECTIC)


if __name__ == "__main__":
    sys.exit(main())
