"""What a release names: one version, authors, cases and figures that exist, and the script that makes its wheels."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from contactvi.verify.verify import CASES

ROOT = Path(__file__).resolve().parents[1]
PAPER = ROOT / "paper"
WHEELS = ROOT / ".ci" / "wheels"

pytestmark = pytest.mark.skipif(not PAPER.is_dir(), reason="the tests were copied without the paper")


def declared() -> str:
    found = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert found is not None
    return found[1]


def test_the_citation_is_of_this_version():
    text = (ROOT / "CITATION.cff").read_text()
    assert f"version: {declared()}\n" in text
    for key in ("cff-version: 1.2.0", "message:", "title:", "authors:", "date-released:", "license: BSD-3-Clause"):
        assert re.search(f"^{re.escape(key)}", text, re.MULTILINE), key


def test_the_paper_has_the_parts_that_its_journal_asks_for():
    text = (PAPER / "paper.md").read_text()
    head = text.split("---\n")[1]
    for key in ("title:", "tags:", "authors:", "affiliations:", "date:", "bibliography: paper.bib"):
        assert re.search(f"^{key}", head, re.MULTILINE), key
    for part in ("Summary", "Statement of need", "Acknowledgements", "References"):
        assert f"\n# {part}\n" in text
    assert 250 <= len(text.split("---\n", 2)[2].split()) <= 1000  # what the journal asks for


def test_what_the_paper_cites_and_shows_exists():
    text, bib = (PAPER / "paper.md").read_text(), (PAPER / "paper.bib").read_text()
    entries = set(re.findall(r"^@\w+\{(\w+),", bib, re.MULTILINE))
    body = text.split("---\n", 2)[2]
    cited = set(re.findall(r"@(\w+)", body))
    assert cited == entries
    figures = re.findall(r"!\[.*?\]\(([^)]+)\)", body, re.DOTALL)
    assert len(figures) >= 3
    for figure in figures:
        assert (PAPER / figure).is_file(), figure
    labels = set(re.findall(r"\\label\{([^}]+)\}", body))
    assert set(re.findall(r"\\autoref\{([^}]+)\}", body)) == labels


def test_commands_of_the_paper_exist():
    text = (PAPER / "paper.md").read_text()
    scripts = re.findall(r"`python (\S+\.py)", text)
    assert scripts
    for script in scripts:
        assert (ROOT / script).is_file(), script


@pytest.mark.skipif(not WHEELS.is_file(), reason="the tests were copied without .ci")
def test_the_script_of_the_wheels_names_cases_and_libraries_that_exist():
    text = WHEELS.read_text()
    named = re.search(r"^CASES=\((.*)\)$", text, re.MULTILINE)
    assert named is not None
    assert set(named[1].split()) <= {case.name for case in CASES}
    if shutil.which("bash") is None:
        pytest.skip("no bash")
    function = re.search(r"^excluded\(\).*$", text, re.MULTILINE)
    assert function is not None
    done = subprocess.run(
        ["bash", "-c", f'root="{ROOT}"\n{function[0]}\nexcluded'], capture_output=True, text=True, timeout=30
    )
    pyproject = (ROOT / "pyproject.toml").read_text()
    linux = pyproject[pyproject.index("[tool.cibuildwheel.linux]") : pyproject.index("[tool.cibuildwheel.macos]")]
    assert done.stdout.split() == re.findall(r"--exclude '([^']+)'", linux)
    assert "libcoal*" in done.stdout


@pytest.mark.skipif(not WHEELS.is_file(), reason="the tests were copied without .ci")
def test_the_script_of_the_wheels_asks_for_a_folder():
    done = subprocess.run(["bash", str(WHEELS)], capture_output=True, text=True, timeout=30)
    assert done.returncode == 2
    assert "Expected the folder" in done.stderr
