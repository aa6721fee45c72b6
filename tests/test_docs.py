"""The pages name files and functions; these tests hold them to the tree.

A path in backticks exists. Identifiers that follow it in parentheses, `path` (`a`, `b`), occur in that file. Links of
the pages lead somewhere.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    sorted(ROOT.glob("*.md"))
    + sorted((ROOT / "docs").rglob("*.md"))
    + [ROOT / f"{f}/README.md" for f in ("models", "benchmarks")]
)
NAMED = re.compile(
    r"`((?:contactvi|core|tests|docs|examples|models|benchmarks|\.ci)/[^`\s]*)`(?: \((`[\w.:]+`(?:, `[\w.:]+`)*)\))?"
)
LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)(?:#[^)]*)?\)")

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the tests were copied without the docs")


def page_id(path: Path) -> str:
    return str(path.relative_to(ROOT))


def is_pattern(path: str) -> bool:
    return any(letter in path for letter in "*?<{[") or "NAME" in path


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_paths_and_names_exist(page):
    if page.name == "CHANGELOG.md":
        pytest.skip("a changelog names what was")
    missing = []
    for path, names in NAMED.findall(page.read_text()):
        if is_pattern(path):
            continue
        if re.search(r"-v\d+$", path):  # no path: an environment of Gymnasium
            known = (ROOT / "contactvi" / "gym" / "__init__.py").read_text()
            missing += [path] * (f'"{path.removeprefix("contactvi/")}"' not in known)
            continue
        file = ROOT / path
        if not file.exists():
            missing.append(path)
        elif names:
            words = set(re.findall(r"\w+", file.read_text()))
            missing += [f"{name} in {path}" for name in re.findall(r"`([\w.:]+)`", names) if name not in words]
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_links_lead_somewhere(page):
    targets = [page.parent / target for target in LINK.findall(page.read_text())]
    missing = [str(target) for target in targets if not target.exists()]
    assert not missing, "\n".join(missing)


def test_the_check_can_fail():
    ((path, names),) = NAMED.findall("| x | `core/run/simulator.cpp` (`interval`, `nowhere`) |")
    assert (path, names) == ("core/run/simulator.cpp", "`interval`, `nowhere`")
    assert LINK.findall("[a](docs/limits.md#steps) [b](https://x.org) [c](#here)") == ["docs/limits.md"]
