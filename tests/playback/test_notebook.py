"""Views in the cells of a notebook: the player comes along once, and all views are shown."""

from __future__ import annotations

import html
import os
import re
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

import contactvi as cvi
from contactvi.playback.notebook import Carriers, Execution, execution
from contactvi.playback.page import carrying_page, page_data, taking_page
from helpers.run_scenes import ball_scene

SHOW = 'cvi.view(traj, open_browser=False, play=False, title="view {}")'
MAKE = """
import contactvi as cvi
scene = cvi.Scene()
scene.add_halfspace()
scene.add_sphere("ball", radius=0.1, placement=(0, 0, 0.5))
traj = cvi.simulate(scene, duration=0.5, dt=1e-2)
"""


@pytest.fixture(scope="module")
def data() -> dict:
    return page_data(cvi.simulate(ball_scene(), duration=0.5, dt=1e-2), play=False)


def frame(page: str) -> str:
    return f'<iframe srcdoc="{html.escape(page, quote=True)}" style="width: 100%; height: 300px"></iframe>'


# -- which cell brings the player ------------------------------------------------------------------------------------


def test_the_first_cell_carries_and_others_do_not():
    session = Carriers()
    assert [session.carries(Execution(cell, cell)) for cell in "abc"] == [True, False, False]


def test_all_views_of_a_cell_that_carries_do():
    """A cell may clear the output of its first view."""
    session = Carriers()
    assert [session.carries(Execution("a", "1")) for _ in range(3)] == [True] * 3
    assert [session.carries(Execution("b", "2")) for _ in range(3)] == [False] * 3


@pytest.mark.parametrize("cell", ["a", "b"])
def test_a_cell_that_is_run_again_carries(cell):
    session = Carriers()
    for k, name in enumerate("ab"):
        session.carries(Execution(name, str(k)))
    assert session.carries(Execution(cell, "2"))
    assert session.carries(Execution(cell, "3"))
    assert not session.carries(Execution("c", "4"))


def test_where_cells_are_not_known_every_view_carries():
    session = Carriers()
    assert [session.carries(None) for _ in range(3)] == [True] * 3


@pytest.mark.parametrize(
    ("metadata", "content", "expected"),
    [
        ({"cellId": "c7"}, {"allow_stdin": True}, Execution("c7", "m1")),  # JupyterLab
        ({}, {"allow_stdin": False}, Execution("m1", "m1")),  # nbclient
        ({}, {"allow_stdin": True}, None),  # a program that does not name cells
        ({}, {}, None),
        (None, None, None),
    ],
)
def test_the_cell_that_runs(monkeypatch, metadata, content, expected):
    request = {"header": {"msg_id": "m1"}, "metadata": metadata, "content": content}
    shell = SimpleNamespace(get_parent=lambda: request)
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert execution() == expected


@pytest.mark.parametrize("shell", [None, SimpleNamespace(), SimpleNamespace(get_parent=dict)])
def test_no_cell_runs(monkeypatch, shell):
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert execution() is None


def test_without_a_notebook_there_is_no_cell(monkeypatch):
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    assert execution() is None


# -- pages ------------------------------------------------------------------------------------------------------------


def test_pages_that_take_the_player_are_small(data):
    """Beside their data they hold the form of the page; a run of half a second has 31 frames."""
    carrying, taking = carrying_page(data), taking_page(data)
    assert len(carrying) > 900_000
    assert len(taking) < 30_000
    keys = {re.search(r'window\.parent\["(\w+)"\]', page)[1] for page in (carrying, taking)}
    assert len(keys) == 1
    assert "@" not in keys.pop()


def run_notebook(cells: list[str], folder: Path) -> list[str]:
    """The HTML outputs of the cells, run by nbclient in a kernel of their own."""
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    nbclient.NotebookClient(book, timeout=120, resources={"metadata": {"path": str(folder)}}).execute()
    return [
        output["data"]["text/html"]
        for cell in book["cells"]
        for output in cell["outputs"]
        if "text/html" in output.get("data", {})
    ]


def test_a_notebook_holds_the_player_once(tmp_path, monkeypatch):
    if not os.environ.get("CONTACTVI_TEST_INSTALLED"):
        monkeypatch.setenv("PYTHONPATH", str(Path(cvi.__file__).parents[1]))  # the kernel takes this package
    outputs = run_notebook([MAKE + SHOW.format(1), SHOW.format(2), SHOW.format(3)], tmp_path)
    assert [len(output) > 900_000 for output in outputs] == [True, False, False]
    assert max(map(len, outputs[1:])) < 60_000


# -- in a browser -----------------------------------------------------------------------------------------------------


def titles(browser, wanted: int) -> list[str]:
    """The headings of the views once so many of them play, at the latest after 20 s."""
    until = time.monotonic() + 20.0
    while True:
        found, ready = [], 0
        for view in browser.find_elements("css selector", "iframe"):
            browser.switch_to.frame(view)
            found.append(browser.execute_script("return document.querySelector('#head h1').textContent"))
            ready += browser.execute_script("return typeof panels !== 'undefined'")
            browser.switch_to.default_content()
        if ready >= wanted or time.monotonic() > until:
            return found if ready == wanted else [*found, f"{ready} play"]
        time.sleep(0.1)


@pytest.mark.browser
@pytest.mark.parametrize("order", ["carrier first", "carrier last"])
def test_a_static_notebook_shows_all_views(browser, data, tmp_path, order):
    """As nbconvert writes it: the outputs one below the other in one file, whichever is loaded first."""
    pages = [carrying_page(data | {"title": "view 0"})]
    pages += [taking_page(data | {"title": f"view {k}"}) for k in (1, 2)]
    pages = pages if order == "carrier first" else pages[::-1]
    text = "<!DOCTYPE html><meta charset=utf-8><body>" + "<p>text</p>".join(map(frame, pages))
    (tmp_path / "notebook.html").write_text(text, encoding="utf-8")
    browser.get((tmp_path / "notebook.html").as_uri())
    assert sorted(titles(browser, 3)) == ["view 0", "view 1", "view 2"]


@pytest.mark.browser
@pytest.mark.parametrize("apart", [False, True], ids=["without the carrier", "outputs kept apart"])
def test_a_view_whose_player_is_gone_says_what_to_do(browser, data, tmp_path, apart):
    """Also where an output is not allowed to look at the page of the notebook: the carrier itself plays there."""
    sandbox = ' sandbox="allow-scripts"' if apart else ""
    frames = [frame(page) for page in ([carrying_page(data), taking_page(data)] if apart else [taking_page(data)])]
    text = "<!DOCTYPE html><meta charset=utf-8><body>" + "".join(
        f.replace("<iframe", "<iframe" + sandbox) for f in frames
    )
    (tmp_path / "notebook.html").write_text(text, encoding="utf-8")
    browser.get((tmp_path / "notebook.html").as_uri())
    browser.switch_to.frame(browser.find_elements("css selector", "iframe")[-1])
    until = time.monotonic() + 20.0
    said = ""
    while "Run this cell again" not in said and time.monotonic() < until:
        said = browser.execute_script("return document.querySelector('#head h1').textContent")
        time.sleep(0.1)
    browser.switch_to.default_content()
    assert "Run this cell again" in said
    assert ("keeps the outputs of cells apart" in said) == apart
    assert len(titles(browser, int(apart))) == 1 + apart
