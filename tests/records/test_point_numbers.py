"""Contact points have short numbers, 0, 1, 2, ... within a pair, whatever the calls in which a run was made."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from contactvi.records.point_numbers import FEW, PointNumbers


def columns(rows: list[tuple[float, int, int, int]], time: str) -> dict[str, np.ndarray]:
    values = list(zip(*rows, strict=True)) if rows else [()] * 4
    return {name: np.array(column, dtype=float if name == time else np.int64)
            for name, column in zip((time, "kind", "index", "point"), values, strict=True)}  # fmt: skip


def by_hand(rows: list[tuple[float, int, int, int]]) -> list[int]:
    """The numbers of rows in the order of time, one after the other."""
    known: dict[tuple[int, int], list[int]] = {}
    numbers = []
    for _, kind, index, feature in rows:
        features = known.setdefault((kind, index), [])
        if feature not in features:
            features.append(feature)
        numbers.append(features.index(feature))
    return numbers


@pytest.mark.parametrize("count", [1, 30, 300])
def test_numbers_of_drawn_rows(count):
    """Two reports of drawn rows have the numbers of one pass over all rows in the order of time, changes first."""
    rng = np.random.default_rng(5)
    assert 30 <= FEW < 300  # few rows and many go different ways
    for _ in range(50):
        draw = [(float(t), int(rng.integers(2)), int(rng.integers(3)), int(rng.choice([0, 7, 2**41 + 1, 2**41 + 2])))
                for t in np.sort(rng.integers(0, 20, count))]  # fmt: skip
        is_change = rng.random(count) < 0.3
        ordered = sorted(range(count), key=lambda k: (draw[k][0], not is_change[k], k))
        expected = dict(zip(ordered, by_hand([draw[k] for k in ordered]), strict=True))
        cut = float(rng.integers(0, 20))
        numbers, got = PointNumbers(), {}
        for part in (lambda t: t < cut, lambda t: t >= cut):  # noqa: B023
            chosen = [[k for k in range(count) if is_change[k] == kind and part(draw[k][0])] for kind in (True, False)]
            changes, contacts = (columns([draw[k] for k in some], time)
                                 for some, time in zip(chosen, ("time", "t"), strict=True))  # fmt: skip
            contacts, changes = numbers.copy().number(contacts, changes), numbers.number(contacts, changes)
            assert np.array_equal(contacts[0]["point"], changes[0]["point"])  # a copy goes on in the same way
            got |= dict(zip(chosen[0], changes[1]["point"].tolist(), strict=True))
            got |= dict(zip(chosen[1], changes[0]["point"].tolist(), strict=True))
            assert changes[0]["feature"].tolist() == [draw[k][3] for k in chosen[1]]
        assert got == expected


def falling_boxes(count: int = 3) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(count):
        place = (0.03 * k, 0, 0.1 + 0.15 * k), (0.1, 0.2, 0)
        scene.add_box(f"box_{k}", size=(0.2, 0.2, 0.1), mass=1.0, placement=place)
    scene.set_contact(restitution=0.1, friction=0.5)
    return scene


@pytest.mark.parametrize(("mode", "count"), [("events", 1), ("auto", 3), ("steps", 3)])
def test_numbers_do_not_depend_on_the_calls(mode, count):
    """One call, one call per step, and a run that goes on from a snapshot have the same numbers, without a hole."""
    scene = falling_boxes(count)
    whole = cvi.simulate(scene, dt=2e-3, duration=0.6, contact_mode=mode)
    sim = cvi.Simulator(scene, dt=2e-3, contact_mode=mode)
    sim.reset()
    saved = None
    for k in range(300):
        if k == 150:
            saved = sim.save()
        assert sim.step().ok
    single = sim.trajectory()
    sim.load(saved)
    sim.run(150)
    assert len(whole.contacts) > 100
    for other in (single, sim.trajectory()):
        for log, same in ((whole.contacts, other.contacts), (whole.contact_changes, other.contact_changes)):
            assert np.array_equal(log.array("point"), same.array("point"))
    log = whole.contacts
    for pair in np.unique(log.array("index")):
        of_pair = log.array("index") == pair
        points = np.unique(log.array("point")[of_pair])
        in_changes = whole.contact_changes.array("point")[whole.contact_changes.array("index") == pair]
        assert set(points) | set(in_changes) == set(range(len(np.unique(log.array("feature")[of_pair]))))


def test_contacts_of_a_simulator_have_the_numbers_of_the_run():
    sim = cvi.Simulator(falling_boxes(), dt=2e-3)
    sim.reset()
    sim.run(250)
    now = sim.contacts
    assert now
    ends = [contact for contact in sim.trajectory().contacts[-200:] if contact.t == now[-1].t]
    assert {(c.pair, c.point, tuple(c.position)) for c in now} <= {(c.pair, c.point, tuple(c.position)) for c in ends}
