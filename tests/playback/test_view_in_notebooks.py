"""cvi.view in a notebook: it shows itself in the cell and opens no browser."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")

CELLS = (
    """
    import webbrowser
    import contactvi as cvi
    opened = []
    webbrowser.open = lambda url, new=0: opened.append(url)
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, placement=(0, 0, 0.5))
    traj = cvi.simulate(scene, duration=0.1, dt=1e-3)
    """,
    "shown = cvi.view(traj)\nimport threading\n"
    "print('served', any('contactvi' in thread.name for thread in threading.enumerate()))\nshown",
    "sim = cvi.Simulator(scene, dt=1e-3)\nsim.reset()\nlive = cvi.view(sim)\nlive",
    "print('opened', len(opened))\nwanted = cvi.view(traj, open_browser=True)\nprint('opened', opened == [wanted.url])",
    "shown.close(); live.close(); wanted.close()",
)


def test_it_shows_itself_and_opens_no_browser(monkeypatch, tmp_path):
    if not os.environ.get("CONTACTVI_TEST_INSTALLED"):
        import contactvi

        monkeypatch.setenv("PYTHONPATH", str(Path(contactvi.__file__).parents[1]))
    notebook = nbformat.v4.new_notebook()
    notebook.cells = [nbformat.v4.new_code_cell("\n".join(line.removeprefix("    ") for line in cell.splitlines()))
                      for cell in CELLS]  # fmt: skip
    # Away from the source, which would hide the package that is installed.
    away = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3", resources=away).execute()
    pages = [
        output["data"]["text/html"]
        for cell in notebook.cells for output in cell.outputs if "text/html" in output.get("data", {})
    ]  # fmt: skip
    assert pages[0].startswith("<iframe srcdoc=")
    assert pages[1].startswith('<iframe src="http://127.0.0.1:')
    told = str([output for output in notebook.cells[1].outputs if "text/html" not in output.get("data", {})])
    assert "served False" in told
    texts = [output.get("data", {}).get("text/plain", "") for output in notebook.cells[1].outputs]
    assert "<View>" in texts
    assert "http" not in told + "".join(texts)  # no address that is dead once the notebook is closed
    printed = "".join(output["text"] for output in notebook.cells[3].outputs if output.output_type == "stream")
    assert "opened 0\n" in printed
    assert "opened True\n" in printed
