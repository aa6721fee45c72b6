"""`contactvi verify`: the cases with known answers, measured here, with a verdict on every number."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.table import Table

from contactvi.errors import InputError, did_you_mean
from contactvi.reproduce.check import Check
from contactvi.tables import name_table
from contactvi.verify import (
    cases_contact,
    cases_fields,
    cases_forced,
    cases_friction,
    cases_impact,
    cases_laws,
    cases_loops,
    cases_several,
    cases_shapes,
)
from contactvi.verify.case import LIMIT, Case, Runs

PASSED, FAILED, NOT_APPLICABLE = "ok", "FAILED", "not applicable"
CASES: tuple[Case, ...] = (
    *cases_impact.CASES,
    *cases_several.CASES,
    *cases_laws.CASES,
    *cases_fields.CASES,
    *cases_shapes.CASES,
    *cases_friction.CASES,
    *cases_contact.CASES,
    *cases_forced.CASES,
    *cases_loops.CASES,
)
Progress = Callable[[float, str], object]  # called with the fraction that is done and the name of the present case


@dataclass(frozen=True)
class Result:
    """The result of one case: its checks, wall time [s], and its verdict."""

    case: Case
    checks: tuple[Check, ...]
    seconds: float

    @property
    def verdict(self) -> str:
        """PASSED only where there are checks and all of them hold."""
        if self.case.run is None:
            return NOT_APPLICABLE
        return PASSED if self.checks and all(check.ok for check in self.checks) else FAILED


def chosen(names: Sequence[str], cases: Sequence[Case] | None = None) -> list[Case]:
    """Return the cases of these names (or former names), in the order of the list; all where no name is given.

    Raises:
        InputError: for a name that no case has.
    """
    wanted = list(CASES if cases is None else cases)
    former = {case.former: case.name for case in wanted if case.former}
    known = {case.name: case for case in wanted}
    names = [former.get(name, name) for name in names]
    for name in names:
        if name not in known:
            raise InputError(
                f"There is no case {name!r}",
                name="case",
                expected="a name from contactvi verify --list",
                got=repr(name),
                remedy=did_you_mean(name, known),
            )
    return [case for case in known.values() if not names or case.name in names]


def verify(cases: Sequence[Case] | None = None, progress: Progress | None = None) -> list[Result]:
    """Measure cases, by default all; a case that raises has failed."""
    wanted = list(CASES if cases is None else cases)
    results = []
    for k, case in enumerate(wanted):
        if progress is not None:
            progress(k / len(wanted), case.name)
        results.append(measure(case))
    return results


def measure(case: Case, limit: float = LIMIT) -> Result:
    """Measure one case; it fails where its runs take longer than `limit` [s] of a processor."""
    if case.run is None:
        return Result(case, (), 0.0)
    started, runs = time.perf_counter(), Runs(limit)
    try:
        checks = [*case.run(runs), *runs.laws()]
    except Exception as error:  # one case that raises must not hide the results of the others
        text = f"{type(error).__name__}: {error}".strip()
        checks = [*runs.laws(), Check("the case itself", "no error", text, "exact", "it has to run", False)]
    return Result(case, tuple(checks), time.perf_counter() - started)


def passed(results: Sequence[Result]) -> bool:
    """Return whether nothing failed, and something was measured."""
    verdicts = [result.verdict for result in results]
    return FAILED not in verdicts and PASSED in verdicts


def listing(cases: Sequence[Case] | None = None) -> Table:
    """Return a table with a row per case: its name and what it is."""
    wanted = CASES if cases is None else cases
    return name_table((case.name, case.title + (" (not applicable)" if case.excuse else "")) for case in wanted)
