"""Battery of heaps: families of many contacts x restitution x friction x seeds, against the laws of heap_laws.

Whatever happens in a heap, the run goes to its end, nothing overlaps, impulses stay in their cones and the energy does
not rise. The runs are in a process of their own: one that hangs or crashes is a failure like any other.

Environment variables of the test of fresh seeds:

- CONTACTVI_HEAP_SEED: the number that the scenes are drawn from; by default the date, so that every day brings others.
- CONTACTVI_HEAP_SCENES: how many, by default 500.
"""

from __future__ import annotations

import datetime
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from batteries import heap_laws
from batteries.contact_laws import Finding
from batteries.reporting import Altered, altered_rows, table
from batteries.runner import Report, Runner
from contactvi.bench import heaps

RESTITUTIONS, FRICTIONS, SEEDS = (0.0, 0.3, 0.8), (0.0, 0.5, 0.8), range(10)
LIMIT, SHORT_LIMIT = 60.0, 10.0  # [s] of wall time of a run and its laws
LARGE_LIMIT = 300.0
LARGE = {"funnel": 50, "spheres": 200, "wall": 30, "bin": 20}
# family -> number of bodies, restitution, friction, for the runs of 0.3 s
SMALL = {
    "tower": (4, 0.0, 0.5), "mixed_tower": (3, 0.3, 0.8), "bin": (4, 0.3, 0.5), "spheres": (10, 0.8, 0.5),
    "funnel": (5, 0.3, 0.0), "wall": (5, 0.0, 0.5), "dominoes": (4, 0.0, 0.5), "incline": (3, 0.3, 0.0),
    "cards": (1, 0.0, 0.8),
}  # fmt: skip
PARTS = 20  # of the fresh scenes, so that processes can share them


@pytest.fixture(scope="module")
def runner() -> Iterator[Runner]:
    with Runner("batteries.heap_runner") as one:
        yield one


@pytest.mark.parametrize("family", SMALL)
def test_small_heaps(runner, family):
    count, restitution, friction = SMALL[family]
    chosen = {"restitution": restitution, "friction": friction, "count": count}
    report = runner.examine(family, 1, SHORT_LIMIT, duration=0.3, **chosen)
    assert not report.found, str(report)


TURNING = [(0.02, 0.005), (0.01, 0.0), (0.0, 0.01)]  # radii [m] of friction against spinning and rolling


@pytest.mark.parametrize("family", [family for family in SMALL if SMALL[family][2] > 0.0])
def test_small_heaps_with_turning_friction(runner, family):
    count, restitution, friction = SMALL[family]
    chosen = {"restitution": restitution, "friction": friction, "count": count}
    turning = TURNING[len(family) % len(TURNING)]
    report = runner.examine(family, 2, SHORT_LIMIT, duration=0.3, turning=turning, **chosen)
    assert not report.found, str(report)


@pytest.mark.long
@pytest.mark.parametrize("turning", TURNING)
@pytest.mark.parametrize("family", heaps.FAMILIES)
def test_every_family_with_turning_friction(runner, capsys, family, turning):
    chosen = {"restitution": 0.3, "friction": 0.5, "turning": turning}
    check(family, [runner.examine(family, seed, LIMIT, **chosen) for seed in range(3)], capsys)


def test_a_step_in_contact_that_gains_energy_is_taken_shorter(runner):
    """A body that turns by 10 degrees a step gains 0.14 J of 18 J in one of them where it touches another."""
    report = runner.examine("bin", 668353, SHORT_LIMIT, restitution=0.0, friction=0.8, duration=0.34)
    assert not report.found, str(report)


def test_a_contact_that_has_just_separated_may_close_within_the_step(runner):
    """It is left out of the search of that step: where another event cuts it, it is looked at."""
    report = runner.examine("funnel", 27270, SHORT_LIMIT, restitution=0.0, friction=0.8, duration=0.7)
    assert not report.found, str(report)


@pytest.mark.parametrize(
    ("seed", "restitution"), [(243696, 0.0), (307783, 0.3)], ids=["a contact left out", "a contact that touched"]
)
def test_a_change_that_cuts_a_step_looks_at_what_has_separated(runner, seed, restitution):
    """The whole step shows no event, but where a release cuts it another contact has closed."""
    chosen = {"restitution": restitution, "friction": 0.5, "duration": 0.33}
    report = runner.examine("dominoes", seed, SHORT_LIMIT, **chosen)
    assert not report.found, str(report)


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("seed", "restitution"), [(209777, 0.8), (674721, 0.3)])
def test_edges_that_become_parallel_in_a_dense_step(runner, seed, restitution):
    """Bricks whose edges cross at a small angle, which passes through zero: the crossing is somewhere else then."""
    report = runner.examine("wall", seed, SHORT_LIMIT, restitution=restitution, friction=0.0, duration=0.37)
    assert not report.found, str(report)


def test_an_overlap_of_rounding_that_a_dense_step_takes_back_is_no_gain(runner):
    """Three boxes lie on each other 5e-11 m deep: no step is halved for the 2e-9 J that lift them by that."""
    report = runner.examine("tower", 225039, SHORT_LIMIT, restitution=0.8, friction=0.0, duration=0.15)
    assert not report.found, str(report)


@pytest.mark.long
@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("restitution", RESTITUTIONS)
@pytest.mark.parametrize("family", heaps.FAMILIES)
def test_every_family_restitution_and_friction(runner, capsys, family, restitution, friction):
    chosen = {"restitution": restitution, "friction": friction}
    check(family, [runner.examine(family, seed, LIMIT, **chosen) for seed in SEEDS], capsys)


@pytest.mark.long
@pytest.mark.parametrize("restitution", RESTITUTIONS)
@pytest.mark.parametrize("family", LARGE)
def test_large_heaps(runner, capsys, family, restitution):
    chosen = {"restitution": restitution, "friction": 0.5, "count": LARGE[family]}
    check(family, [runner.examine(family, seed, LARGE_LIMIT, **chosen) for seed in range(2)], capsys)


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_no_failure_on_fresh_seeds(runner, capsys, part):
    start = int(os.environ.get("CONTACTVI_HEAP_SEED", datetime.date.today().toordinal()))
    count = int(os.environ.get("CONTACTVI_HEAP_SCENES", 500))
    reports = [runner.examine(limit=LIMIT, **draw(start, k)) for k in range(part, count, PARTS)]
    check("fresh", reports, capsys, f"CONTACTVI_HEAP_SEED={start}: ")


def draw(start: int, number: int) -> dict[str, Any]:
    """One of the fresh scenes: family, seed, restitution, friction, and of some with friction that against turning."""
    rng = np.random.default_rng([start, number])
    drawn: dict[str, Any] = {
        "family": str(rng.choice(list(heaps.FAMILIES))), "seed": int(rng.integers(10**6)),
        "restitution": float(rng.choice(RESTITUTIONS)), "friction": float(rng.choice(FRICTIONS)),
    }  # fmt: skip
    turning = TURNING[rng.integers(len(TURNING))]
    return {**drawn, "turning": turning} if drawn["friction"] > 0.0 and rng.uniform() < 0.25 else drawn


def check(title: str, reports: list[Report], capsys: pytest.CaptureFixture[str], about: str = "") -> None:
    """Print a table of the runs, and fail with all that break a law."""
    failed = [str(report) for report in reports if report.found]
    with capsys.disabled():
        print(f"\n{table({title: reports})}")
    assert not failed, f"{about}{len(failed)} of {len(reports)} runs:\n" + "\n".join(failed)


# --- the battery itself -----------------------------------------------------------------------------------------------
def lawful_run() -> tuple[heaps.Heap, cvi.Trajectory]:
    heap = heaps.make("incline", 2, restitution=0.3, friction=0.1, count=2)
    scene, q, v = heaps.to_scene(heap)
    return heap, cvi.simulate(scene, q, v, 0.2, dt=1e-3)


def test_the_laws_can_fail():
    heap, traj = lawful_run()
    assert (traj.contacts.h > 0.0).any()
    assert not heap_laws.broken(heap, traj, 1e-3)
    late = traj.t > 0.1
    lowered = traj.q - np.tile([0.0, 0.0, 2e-9, 0.0, 0.0, 0.0, 0.0], len(heap.bodies))
    wrong = {
        "finite nodes": Altered(traj, q=np.where(late[:, None], np.nan, traj.q)),
        "overlap": Altered(traj, q=lowered),
        "momentum": altered_rows(traj, "start", lambda x: 1.001 * x),
        "impulse pulls (end)": altered_rows(traj, "end", lambda x: -x),
        "cone (end)": altered_rows(traj, "end", lambda x: x + [2.0 * abs(x[2]), 0.0, 0.0]),
        "gap of a contact": altered_rows(traj, "gap", lambda x: x - 2e-9),
        # 5 % more speed from a node on: a tenth of T at once, more than what friction takes in that step.
        "energy rises in a step": Altered(traj, v=np.where(late[:, None], 1.05, 1.0) * traj.v),
        # The same little by little, each step within the error of a step.
        "energy rises": Altered(traj, q=traj.q + climb(heap, traj)),
    }
    for law, run in wrong.items():
        names = [found.law for found in heap_laws.broken(heap, run, 1e-3)]
        assert law in {name.partition(" (v index")[0] for name in names}, (law, names)


def climb(heap: heaps.Heap, traj: cvi.Trajectory) -> np.ndarray:
    """A way up of the first body by which half of what a step may gain is gained in each of them, and what friction
    takes besides; shape (N, nq)."""
    allowed, energy = heap_laws.allowed_rises(heap, traj, 1e-3), traj.energy
    height = np.concatenate([[0.0], np.cumsum(0.5 * allowed)]) - (energy - energy[0])
    assert heap.bodies[0].mass is not None
    up = np.zeros_like(traj.q)
    up[:, 2] = height / (heap_laws.GRAVITY * heap.bodies[0].mass)
    return up


def test_energies_and_moments_are_those_of_the_model():
    """The laws' own energies, by the formulas of solid bodies, against Pinocchio's inertias."""
    heap = heaps.make("bin", 3, count=20)
    model = heaps.to_scene(heap)[0].model
    kinds = {body.kind for body in heap.bodies}
    assert kinds == set(heaps.KINDS)
    for k in range(len(heap.bodies)):
        inertia = model.inertias[k + 1]
        np.testing.assert_allclose(np.diag(heap_laws.moments(heap, k)), inertia.inertia, rtol=1e-12, atol=1e-18)
        assert inertia.mass == pytest.approx(heap.bodies[k].mass, rel=1e-12)
    heap, traj = lawful_run()
    energy = sum(heap_laws.energies(heap, traj)).sum(axis=1)
    np.testing.assert_allclose(np.diff(energy), np.diff(traj.energy), atol=1e-12)


def test_a_run_that_ends_early_is_a_finding(runner):
    report = runner.examine("incline", 2, 1e-3, restitution=0.3, friction=0.1, count=2)
    assert report.status == "HANG"
    assert report.found


def test_fresh_scenes_are_those_of_their_number():
    assert draw(7, 3) == draw(7, 3)
    assert len({str(draw(7, k)) for k in range(50)} | {str(draw(8, k)) for k in range(50)}) == 100


def test_findings_say_where():
    heap, traj = lawful_run()
    lowered = traj.q - np.tile([0.0, 0.0, 1e-6, 0.0, 0.0, 0.0, 0.0], len(heap.bodies))
    (found,) = heap_laws.gap_laws(heap, Altered(traj, q=lowered))
    assert isinstance(found, Finding)
    assert found.value == pytest.approx(1e-6, rel=0.2)
    assert "plane0" in found.where
