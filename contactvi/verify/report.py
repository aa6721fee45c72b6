"""The results of `contactvi verify` as text, at most WIDTH columns wide, and as JSON."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator, Sequence

from contactvi.reproduce.check import Check
from contactvi.verify.verify import FAILED, NOT_APPLICABLE, PASSED, Result

WIDTH = 100
JSON_KEYS = ("what", "expected", "got", "tolerance", "reason", "ok")
_NAMES = 24  # columns of the names of cases
_VERDICTS = len(NOT_APPLICABLE) + 2


def lines(results: Sequence[Result], details: bool) -> Iterator[str]:
    """Yield a line for each case; below it its checks, all of them or only those that failed."""
    for k, result in enumerate(results):
        if details and k:
            yield ""
        case = result.case
        took = "" if case.run is None else f"{result.seconds:.2f} s"
        title = case.title + (f": {case.excuse}" if case.run is None else "")
        yield from _folded(f"{result.verdict:<{_VERDICTS}}{case.name:<{_NAMES}}{took:>7}  ", title)
        for check in result.checks:
            if details or not check.ok:
                yield from _check_lines(check)


def _check_lines(check: Check) -> Iterator[str]:
    yield from _folded(f"  {PASSED if check.ok else FAILED:<8}", check.what)
    yield from _folded("          expected   ", check.expected)
    yield from _folded("          got        ", check.got)
    yield from _folded("          tolerance  ", f"{check.tolerance}: {check.reason}")


def _folded(begin: str, text: str) -> list[str]:
    """Return a text behind its beginning, broken into lines that go on below it."""
    return textwrap.wrap(
        " ".join(text.split()), WIDTH, initial_indent=begin, subsequent_indent=" " * len(begin), break_on_hyphens=False
    ) or [begin.rstrip()]


def summary(results: Sequence[Result]) -> list[str]:
    """Return the last lines: how many cases passed, which failed, which do not apply."""
    names = {verdict: [r.case.name for r in results if r.verdict == verdict] for verdict in (FAILED, NOT_APPLICABLE)}
    measured = len(results) - len(names[NOT_APPLICABLE])
    checks = [check.ok is True for result in results for check in result.checks]
    text = f"{measured - len(names[FAILED])} of {measured} cases passed, {sum(checks)} of {len(checks)} numbers"
    text += f", in {sum(result.seconds for result in results):.1f} s"
    for verdict, listed in names.items():
        text += f"; {verdict}: {', '.join(listed)}" if listed else ""
    return _folded("", text)


def as_json(results: Sequence[Result]) -> str:
    """Return everything as JSON: a list of cases with their checks."""
    data = [
        {
            "case": result.case.name,
            "title": result.case.title,
            "verdict": result.verdict,
            "reason": result.case.excuse,
            "seconds": result.seconds,
            "checks": [{name: getattr(check, name) for name in JSON_KEYS} for check in result.checks],
        }
        for result in results
    ]
    return json.dumps(data, indent=2)
