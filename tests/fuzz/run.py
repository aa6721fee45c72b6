"""Make many cases and print what came of them.

    python tests/fuzz/run.py --cases 100000 --jobs 2                # of all families
    python tests/fuzz/run.py urdf mesh --cases 2000 --seed 7 -o DIR # findings as files of their own
    python tests/fuzz/run.py --replay DIR/urdf-1.json               # one of them again, in this process

The exit code is 1 where a case broke the law (fuzz/law.py).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzz import campaign, families


def main() -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", metavar="FAMILY", help=f"of {', '.join(families.NAMES)}; default all")
    parser.add_argument("--cases", type=int, default=2000, help="of each family")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--seed", type=int, default=0, help="another one draws other cases")
    parser.add_argument("-o", "--output", type=Path, help="folder for the findings")
    parser.add_argument("--replay", type=Path, help="file of a finding, which is made again")
    chosen = parser.parse_args()
    if chosen.replay is not None:
        return replay(chosen.replay)
    unknown = set(chosen.families) - set(families.NAMES)
    if unknown:
        parser.error(f"unknown family {', '.join(sorted(unknown))}")
    broken = 0
    print(campaign.head(), flush=True)
    for family in chosen.families or families.NAMES:
        tally = campaign.many(family, chosen.cases, chosen.seed, chosen.jobs)
        print(tally.row(), flush=True)
        for number, finding in enumerate(tally.findings.values(), 1):
            broken += 1
            print(f"  {finding.outcome} x {finding.times}: {finding.where}", flush=True)
            if chosen.output is not None:
                chosen.output.mkdir(parents=True, exist_ok=True)
                entry = {"family": family, "case": finding.case, "details": finding.details}
                (chosen.output / f"{family}-{number}.json").write_text(json.dumps(entry, indent=1))
    return 1 if broken else 0


def replay(file: Path) -> int:
    """Make the case of a finding again in this process."""
    from fuzz import law, worker

    finding = json.loads(file.read_text())
    outcome, where, details = worker.in_empty_folder(families.load(finding["family"]), finding["case"])
    print(outcome, where, details, sep="\n")
    return 0 if outcome in (law.RAN, law.ACCEPTED, law.REFUSED) else 1


if __name__ == "__main__":
    sys.exit(main())
