"""`contactvi reproduce`: the quick run end to end, and that its verdicts can also go the other way."""

from __future__ import annotations

import csv
import pathlib
import time

import numpy as np
import pytest
from typer.testing import CliRunner

import contactvi as cvi
from contactvi.commands import cli
from contactvi.reproduce import figures, laws, report, runs, systems
from contactvi.reproduce import reproduce as reproduction
from contactvi.reproduce.check import about, at_most, between, near, reported
from contactvi.reproduce.reference import energy, reference
from contactvi.reproduce.row import HOLDS, HOLDS_NOT, IN_PART, Row
from oracles import problem_b as oracle

PICTURES = ("fig1_energy", "convergence", "long_run_energy", "dense_impacts", "l2_errors")
FILE = pathlib.Path(__file__).resolve().parents[2] / "models" / "double_pendulum_wall.toml"
# The rows whose verdict does not depend on the machine or on the number of random starts.
ROBUST = {
    "own scalar": HOLDS,
    "momentum": HOLDS,
    "symplectic impact": HOLDS,
    "symplectic step": HOLDS,
    "order": IN_PART,  # DTEC scatters about 2
    "long-run energy": HOLDS,
    "dense impacts": HOLDS,
}


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """(result, folder, seconds, progress) of one quick run."""
    folder, told = tmp_path_factory.mktemp("reproduction"), []
    start = time.perf_counter()
    result = reproduction.reproduce(folder, quick=True, progress=lambda *now: told.append(now))
    return result, folder, time.perf_counter() - start, told


def read(path: pathlib.Path) -> tuple[list[str], np.ndarray]:
    header, *lines = list(csv.reader(path.open()))
    return header, np.array(lines, dtype=float)


@pytest.mark.slow
def test_a_quick_run_is_quick_and_complete(quick):
    result, folder, seconds, _ = quick
    assert seconds < 60.0
    names = {"report.md", "table.csv"} | {f"{name}.{ending}" for name in PICTURES for ending in ("png", "csv")}
    assert {path.name for path in folder.iterdir()} == names
    assert {path.name for path in result.files} == names
    for name in PICTURES:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        header, values = read(folder / f"{name}.csv")
        assert values.shape[0] > 5
        assert values.shape[1] == len(header)
        assert np.all(np.isfinite(values))
    assert [row.key for row in result.rows] == [*list(ROBUST)[:6], "cost", "dense impacts", "L2 error"]


def test_the_robust_rows_have_their_verdicts(quick):
    rows = {row.key: row for row in quick[0].rows}
    assert {key: rows[key].verdict for key in ROBUST} == ROBUST
    wrong = [n for key in ROBUST for n in rows[key].checks if n.ok is False]
    assert not wrong
    assert rows["L2 error"].as_expected is None  # reported, never asserted
    assert all(n.value > 0 for n in rows["cost"].checks)


def test_the_report_says_every_claim_and_shows_every_picture(quick):
    result, folder, _, _ = quick
    text = (folder / "report.md").read_text()
    assert len(text.splitlines()) < 100
    for row in result.rows:
        assert row.claim in text
        assert row.rule in text
        assert report.verdict(row).replace("; ", ";<br>") in text
    for name in PICTURES:
        assert f"]({name}.png)" in text
        assert f"`{name}.csv`" in text
    assert str(folder) not in text
    columns = {line.count(" | ") for line in text.splitlines() if line.startswith("| ")}
    assert columns <= {3, 4}, "a bar in a cell breaks the table"


def test_the_table_has_every_number(quick):
    result, folder, _, _ = quick
    header, *lines = list(csv.reader((folder / "table.csv").open()))
    assert tuple(header) == report.COLUMNS
    assert len(lines) == sum(len(row.checks) for row in result.rows)
    assert all(np.isfinite(float(line[header.index("value")])) for line in lines)


def test_progress_only_goes_forward(quick):
    fractions = [fraction for fraction, _ in quick[3]]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert 0.8 < fractions[-1] <= 1.0


def test_the_command_prints_the_verdicts(quick, monkeypatch, tmp_path):
    result, asked = quick[0], []

    def instead(folder, quick, progress):
        progress(0.5, "half")
        asked.append((folder, quick))
        return result

    monkeypatch.setattr(reproduction, "reproduce", instead)
    answer = CliRunner().invoke(cli.app, ["reproduce", "--quick", "-o", str(tmp_path / "a" / "b")])
    assert answer.exit_code == 0, answer.output
    assert asked == [(tmp_path / "a" / "b", True)]
    assert (tmp_path / "a" / "b").is_dir()
    assert all(row.key in answer.output and row.measured in answer.output for row in result.rows)


def test_the_reference_is_that_of_the_oracle_and_of_the_cases():
    """Two codes of one method at rtol 1e-13: they differ by what rounding grows to over 3 s."""
    exact, found = oracle.run(3.0), reference(systems.START, np.linspace(0.0, 3.0, 7))
    assert np.abs(found.q[-1] - exact.q).max() <= 1e-11
    assert np.abs(found.w[-1] - exact.w).max() <= 1e-11
    for impact, known in zip(found.impacts, exact.impacts, strict=True):
        assert np.abs(np.array([impact.time, impact.gamma_minus, impact.impulse]) - known[:3]).max() <= 1e-11
    assert np.abs(found.q[-1] - [0.3205793585, -0.2173609757]).max() <= 1e-10  # known to ten decimals
    change = [energy(q, w) - energy(found.q[0], found.w[0]) for q, w in zip(found.q, found.w, strict=True)]
    assert np.abs(change).max() <= 1e-11  # also at times inside, where the solver interpolates


def test_problem_b_is_the_scene_of_the_repository():
    built, loaded = systems.problem_b(), cvi.load_scene(FILE)
    assert np.allclose(np.linalg.solve(systems.ABSOLUTE, systems.START), loaded.q0, rtol=0, atol=1e-15)
    q, v = np.array([[0.4, -0.7]]), np.array([[0.3, 1.1]])
    for name in ("momentum", "energy"):
        values = [np.asarray(getattr(scene.core(), name)(q, v)) for scene in (built, loaded)]
        assert np.abs(values[0] - values[1]).max() <= 1e-12
    gaps = [float(scene.core().gaps(q[0])[0][0]) for scene in (built, loaded)]
    assert gaps[0] == pytest.approx(oracle.tip_gap(systems.ABSOLUTE @ q[0]), abs=1e-15)
    assert gaps[0] == pytest.approx(gaps[1], abs=1e-15)


def test_the_symplectic_defect_is_that_of_the_map(monkeypatch):
    """Half the difference step gives the same defect (noise 1e-10 of 1e-3): it belongs to the map, not the stencil."""
    found = laws.symplectic_defect("ctec", 0.02, impact=True)
    assert found > 1e5 * laws.symplectic_defect("dtec", 0.02, impact=True)
    monkeypatch.setattr(laws, "_DIFFERENCE", laws._DIFFERENCE / 2)
    assert found == pytest.approx(laws.symplectic_defect("ctec", 0.02, impact=True), rel=1e-6)


@pytest.mark.parametrize(
    ("check", "ok"),
    [
        (about("x", 2.0, 2.1, 2.0, "r"), True),
        (about("x", 2.0, 4.1, 2.0, "r"), False),
        (about("x", 2.0, 0.9, 2.0, "r"), False),
        (about("x", 2.0, float("nan"), 2.0, "r"), False),
        (between("x", 1.0, 2.0, 1.5, "r"), True),
        (between("x", 1.0, 2.0, 3.0, "r"), False),
        (between("x", 1.0, 2.0, float("nan"), "r"), False),
    ],
)
def test_checks_can_fail(check, ok):
    assert check.ok is ok
    assert check.expected


def test_expectations_read_as_one_phrase():
    assert near("x", 2.0, 2.1, 0.1001, "r").expectation == "2 +- 0.1"
    assert at_most("x", 1e-11, 2.0, "r").expectation == "<= 1e-11"
    assert about("x", 0.0004, 1.0, 2.0, "r").expectation == "0.0004 within a factor 2"
    assert between("x", -6e-5, 2e-4, 0.0, "r").expectation == "-6e-05 .. 0.0002"
    assert reported("x", 1.0).expectation == ""
    assert reported("x", 1.0).of("ctec", "h = 1 s", "J").map == "ctec"


def synthetic(order: dict[str, float]) -> runs.Convergence:
    h = np.array(systems.STEPS)
    return runs.Convergence(h, {name: h ** order[name] for name in systems.MAPS})


def test_orders_can_fail():
    two = dict.fromkeys(systems.MAPS, 2.0)
    assert runs.order_row(synthetic(two)).verdict == HOLDS
    row = runs.order_row(synthetic(two | {"mhc": 1.5}))
    assert row.verdict == HOLDS_NOT
    assert row.as_expected is False


def long_run(**drift: float) -> runs.LongRun:
    t = np.linspace(0.0, 1000.0, 1001)
    energy_of = {name: drift[name] * t / 1000.0 for name in systems.MAPS}
    return runs.LongRun(t, energy_of, dict.fromkeys(systems.MAPS, 707), dict.fromkeys(systems.MAPS, 0))


def test_long_run_energy_can_fail():
    assert runs.long_run_row(long_run(ctec=1e-4, dtec=1e-2, mhc=1e-5)).verdict == HOLDS
    assert runs.long_run_row(long_run(ctec=1e-4, dtec=1e-2, mhc=5e-5)).verdict == HOLDS_NOT


def dense(ctec: float, dtec: tuple[float, ...], fallbacks: int = 0) -> runs.Dense:
    errors = {name: [np.array([0.0, ctec])] * 4 for name in ("ctec", "mhc")}
    errors["dtec"] = [np.array([0.0, -x]) for x in dtec]
    counts = {name: [100] * 4 for name in systems.MAPS}
    return runs.Dense(np.array([0.0, 1.0]), errors, counts, {name: [fallbacks] * 4 for name in systems.MAPS})


def test_dense_impacts_can_fail():
    known = (4e-4, 1.2e-3, 1.3e-2, 0.21)
    assert (runs.dense_row(dense(1e-13, known)).verdict, runs.dense_row(dense(1e-13, known)).as_expected) == (
        HOLDS,
        True,
    )
    assert runs.dense_row(dense(1e-10, known)).verdict == HOLDS_NOT
    assert runs.dense_row(dense(1e-13, known[::-1])).verdict == HOLDS_NOT
    assert runs.dense_row(dense(1e-13, known, fallbacks=1)).as_expected is False


def test_an_l2_ranking_that_is_always_the_same_holds():
    noise = np.random.default_rng(4).uniform(0.9, 1.1, (50, 3))
    assert runs.l2_row(noise * [1.0, 3.0, 2.0]).verdict == HOLDS
    assert runs.l2_row(noise).verdict == HOLDS_NOT


def test_fine_steps_divide_the_duration():
    h = reproduction.fine_steps(40)
    assert np.all(np.diff(h) < 0)
    assert (h[0], h[-1]) == (0.04, 0.0025)
    assert np.abs(systems.DURATION / h - np.rint(systems.DURATION / h)).max() <= 1e-9


def test_bars_in_cells_do_not_break_a_table():
    row = Row("k", "a | b", "|x|", "", "r", HOLDS_NOT, [at_most("n", 1.0, 2.0, "r")])
    picture = figures.Picture("a.png", "a.csv", "caption")
    lines = report.report([row], [picture], 1.0, quick=True)
    assert any(line.startswith("| a \\| b | \\|x\\| |") for line in lines)
    assert report.summary([row]).startswith("**0 of 1 claims hold**")
    assert "Numbers differ" in report.summary([row])
