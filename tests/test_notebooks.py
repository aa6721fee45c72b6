"""The notebooks of docs/notebooks: each runs from its first cell to its last, and is stored without outputs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
LONGEST = 60  # [s] of a whole notebook; they take about ten

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the tests were copied without the docs")


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 3


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_stored_without_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path, monkeypatch):
    """Its own assertions hold, it shows pictures and tables, and prints no warning."""
    if not os.environ.get("CONTACTVI_TEST_INSTALLED"):
        import contactvi

        # The kernel starts in the notebook's folder; it takes the package that this test has imported.
        monkeypatch.setenv("PYTHONPATH", str(Path(contactvi.__file__).parents[1]))
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(path.parent)}}
    nbclient.NotebookClient(notebook, timeout=LONGEST, kernel_name="python3", resources=place).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    kinds = {kind for output in outputs for kind in output.get("data", {})}
    assert {"image/png", "text/html"} <= kinds
    assert not [output.text for output in outputs if output.get("name") == "stderr"]
