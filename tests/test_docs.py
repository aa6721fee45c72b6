"""The pages name files and functions; these tests hold them to the tree.

A path in backticks exists. Identifiers that follow it in parentheses, `path` (`a`, `b`), occur in that file. Links of
the pages, and of what is included in them, lead to files and headings that exist. The pages of the guide are short.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = (
    sorted(ROOT.glob("*.md"))
    + sorted((ROOT / "docs").rglob("*.md"))
    + [ROOT / f"{f}/README.md" for f in ("models", "benchmarks")]
)
GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
NAMED = re.compile(
    r"`((?:contactvi|core|tests|docs|examples|models|benchmarks|\.ci)/[^`\s]*)`(?: \((`[\w.:]+`(?:, `[\w.:]+`)*)\))?"
)
LINK = re.compile(r"\]\((?!https?:)([^)\s#]*)(?:#([^)\s]*))?\)")
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)

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


def anchors(page: Path) -> set[str]:
    """Those of the headings down to the third level, as GitHub and MyST make them, also of pages that it includes."""
    text, found = page.read_text(), set[str]()
    for included in re.findall(r"^```{include} (\S+)", text, re.MULTILINE):
        found |= anchors(page.parent / included)
    for heading in re.findall(r"^#{1,3} (.*)", FENCED.sub("", text), re.MULTILINE):
        anchor = re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")
        found.add(anchor if anchor not in found else f"{anchor}-1")
    return found


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_links_lead_somewhere(page):
    missing = []
    for target, anchor in LINK.findall(FENCED.sub("", page.read_text())):
        file = page.parent / target if target else page
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
            missing.append(f"{target}#{anchor}")
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize("page", GUIDE, ids=page_id)
def test_a_page_of_the_guide_is_read_in_ten_minutes(page):
    """180 words a minute, code and tables included."""
    assert len(page.read_text().split()) <= 1800


def test_the_index_of_examples_names_every_file():
    """With the first sentence of each, as the file has it."""
    page = (ROOT / "docs" / "examples.md").read_text()
    for file in (ROOT / "examples").rglob("*.py"):
        says = (ast.get_docstring(ast.parse(file.read_text())) or "").split("\n\n")[0].replace("\n", " ")
        assert f"| `{file.relative_to(ROOT)}` | {says}" in page


def test_the_reference_names_each_object_and_each_page_once():
    folder = ROOT / "docs" / "api"
    named = []
    for page in folder.glob("*.md"):
        module = ""
        for directive, name in re.findall(r"^\.\. (currentmodule|auto\w+):: (\S+)", page.read_text(), re.MULTILINE):
            if directive == "currentmodule":
                module = name
            else:
                named.append(name if name.startswith("contactvi.") else f"{module}.{name}")
    assert len(named) == len(set(named))
    listed = re.findall(r"^\| \[[^\]]*\]\((\w+\.md)\)", (folder / "index.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(page.name for page in folder.glob("*.md") if page.name != "index.md")


def test_contributing_is_two_pages():
    assert len((ROOT / "CONTRIBUTING.md").read_text().split()) <= 900


def test_the_check_can_fail():
    ((path, names),) = NAMED.findall("| x | `core/run/simulator.cpp` (`interval`, `nowhere`) |")
    assert (path, names) == ("core/run/simulator.cpp", "`interval`, `nowhere`")
    assert LINK.findall("[a](docs/limits.md#steps) [b](https://x.org) [c](#here)") == [
        ("docs/limits.md", "steps"),
        ("", "here"),
    ]
    assert anchors(ROOT / "docs" / "limits.md") >= {"limits", "steps-that-are-too-long"}
