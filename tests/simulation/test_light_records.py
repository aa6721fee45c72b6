"""Stepping: every kind of record has the same motion to the bit, a reset engine is a new one, light records small."""

from __future__ import annotations

import dataclasses
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi.errors import InputError, SimulationError

STEPS = 400


def bouncing() -> cvi.Scene:
    """A ball that bounces and comes to rest: impacts, a persistent contact, its end in no motion."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 0.2))
    scene.set_contact(restitution=0.5, friction=0.4)
    return scene


def heap() -> cvi.Scene:
    """Boxes that fall on each other: islands that meet, faces, dense steps or located events."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(3):
        scene.add_box(f"box_{k}", (0.2, 0.2, 0.1), placement=(0.03 * k, 0.01 * k, 0.06 + 0.13 * k))
    scene.set_contact(restitution=0.2, friction=0.5)
    return scene


def pendulum() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf("models/damped_pendulum.urdf", base="fixed")
    return scene


def fast_start(scene: cvi.Scene) -> tuple[np.ndarray, np.ndarray]:
    v = np.zeros(scene.model.nv)
    v[0] = 0.7
    return scene.neutral(), v


SCENES: dict[str, tuple[Callable[[], cvi.Scene], dict[str, Any]]] = {
    "bouncing": (bouncing, {}),
    "order 4": (bouncing, {"order": 4}),
    "mhc": (bouncing, {"impact": "mhc"}),
    "dense steps": (bouncing, {"contact_mode": "steps"}),
    "heap": (heap, {"dt": 2e-3}),
    "heap of dense steps": (heap, {"contact_mode": "steps", "dt": 2e-3}),
    "damped joint": (pendulum, {}),
}


def made(name: str, **options: Any) -> cvi.Simulator:
    make, chosen = SCENES[name]
    return cvi.Simulator(make(), **{"dt": 5e-3, **chosen, **options})


def push(k: int, nv: int) -> np.ndarray | None:
    """No input, then one, so that work begins to be counted within a record."""
    return None if k < 50 or k >= 120 else 0.05 * np.sin(0.1 * k + np.arange(nv))


def step_through(sim: cvi.Simulator, steps: int = STEPS) -> tuple[list[bytes], list[tuple[tuple[str, str], int]]]:
    """Return what can be seen of the present state after every 20th step, to the bit, and the points of contacts."""
    seen, points = [], []
    for k in range(steps):
        status = sim.step(push(k, len(sim.v)))
        assert status.ok
        assert status.time == sim.t
        if k % 20 == 19:
            t, q, v = sim.last_step()
            contacts = [(c.pair, c.t, tuple(c.position), tuple(c.force)) for c in sim.contacts]
            points += [(c.pair, c.point) for c in sim.contacts]
            seen.append(sim.q.tobytes() + sim.v.tobytes() + q.tobytes() + v.tobytes() + repr((t, contacts)).encode())
    return seen, points


def arrays(traj: cvi.Trajectory) -> dict[str, np.ndarray]:
    found = {"t": traj.t, "q": traj.q, "p": traj.p, "work": np.column_stack(traj.work)}
    found |= {f"event {name}": traj.events.array(name) for name in ("time", "impulse", "q", "p_plus")}
    found |= {"contact t": traj.contacts.t, "contact h": traj.contacts.h, "contact force": traj.contacts.force}
    found["dense"] = np.column_stack([traj.dense_steps["t"], traj.dense_steps["residual"]])
    return found


def assert_equal(one: cvi.Trajectory, other: cvi.Trajectory) -> None:
    a, b = arrays(one), arrays(other)
    for name, values in a.items():
        np.testing.assert_array_equal(values, b[name], err_msg=name)
    assert [(c.time, c.change, c.pair) for c in one.contact_changes] == [
        (c.time, c.change, c.pair) for c in other.contact_changes
    ]
    assert one.status == other.status
    phases = one.phases, other.phases
    assert (phases[0] is None) == (phases[1] is None)
    if phases[0] is None or phases[1] is None:
        return
    assert all(np.array_equal(phases[0][name], phases[1][name]) for name in ("t", "dt", "persistent"))


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", SCENES)
def test_the_motion_has_equal_bits_with_every_record(name):
    sims = [made(name, **record) for record in ({}, {"record": False}, {"record": 7}, {"record": 100_000})]
    for sim in sims:
        sim.reset(*fast_start(sim.scene))
    (full, points), *others = (step_through(sim) for sim in sims)
    for other, _ in others:
        assert other == full
    # Without a record points are numbered as they are seen: by other numbers perhaps, but each point by one.
    light, *recorded = (own for _, own in others)
    assert all(own == points for own in recorded)
    assert len(set(zip(points, light, strict=True))) == len(set(points)) == len(set(light))
    assert len({sim.impacts for sim in sims}) == 1
    assert_equal(sims[3].trajectory(), sims[0].trajectory())


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", SCENES)
def test_steps_that_are_read_later_are_those_that_are_read_at_once(name):
    """The engine keeps steps until they are asked for: how often that is changes nothing, nor does a call of `run`."""
    late, at_once = made(name), made(name)
    for sim in (late, at_once):
        sim.reset(*fast_start(sim.scene))
    for k in range(STEPS):
        tau = push(k, len(late.v))
        late.step(tau)
        at_once.step(tau)
        assert at_once.impacts == len(at_once.events)
    assert_equal(late.trajectory(), at_once.trajectory())
    assert late.trajectory().stats.stage_iterations == at_once.trajectory().stats.stage_iterations


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("record", [{}, {"record": False}])
def test_a_reset_engine_is_a_new_one(name, record):
    """Also in the middle of contacts, after inputs, and after a state was loaded."""
    used = made(name, **record)
    for steps in (3, 90, 230, STEPS):
        used.reset(*fast_start(used.scene))
        for k in range(steps):
            used.step(push(k, len(used.v)))
    used.load(used.save())
    new = made(name, **record)
    for start in ((used.scene.neutral(), None), fast_start(used.scene)):
        for sim in (used, new):
            sim.reset(*start, t=0.25)
        assert [used.step() for _ in range(30)] == [new.step() for _ in range(30)]
        assert step_through(used, 200) == step_through(new, 200)
        new = made(name, **record)
        for sim in (used, new):
            sim.reset(*start)
            sim.run(STEPS)
        if not record:
            assert_equal(used.trajectory(), new.trajectory())
            assert used.trajectory().stats.guards_evaluated == new.trajectory().stats.guards_evaluated
        new = made(name, **record)


def test_the_last_steps_are_those_of_the_whole_run():
    whole, last = made("bouncing"), made("bouncing", record=30)
    for sim in (whole, last):
        sim.reset(*fast_start(sim.scene))
        for k in range(STEPS):
            sim.step(push(k, 6))
    all_of_it, part = whole.trajectory(), last.trajectory()
    assert len(part.t) == 31
    for name in ("t", "q", "p"):
        np.testing.assert_array_equal(getattr(part, name), getattr(all_of_it, name)[-31:])
    begin = part.t[0]
    expected = [event.time for event in all_of_it.events if event.time > begin]
    assert [event.time for event in part.events] == expected
    middle = all_of_it.contacts.t + 0.5 * all_of_it.contacts.h
    np.testing.assert_array_equal(part.contacts.force, all_of_it.contacts.force[middle > begin])
    np.testing.assert_array_equal(np.column_stack(part.work), np.column_stack(all_of_it.work)[-31:])
    assert part.phases is not None
    assert part.phases["t"][0] >= begin


@pytest.mark.parametrize("record", [False, 50])
def test_a_light_record_does_not_grow(record):
    sim = made("bouncing", record=record)
    sim.reset(*fast_start(sim.scene))

    def used() -> int:
        for _ in range(5000):
            sim.step()
        if record:
            assert len(sim.trajectory().t) == record + 1  # which forgets what came before
        return tracemalloc.get_traced_memory()[0]

    used()
    tracemalloc.start()
    first = used()
    later = max(used() for _ in range(3))
    tracemalloc.stop()
    assert sum(map(len, sim._started().record.t)) <= record + 2
    assert later - first < 5000 * 8  # one number per step is more than that


def test_without_a_record_the_past_is_refused():
    sim, full = made("bouncing", record=False), made("bouncing")
    for each in (sim, full):
        each.reset(*fast_start(each.scene))
        for _ in range(STEPS):
            each.step()
    for ask in (sim.trajectory, lambda: sim.events):
        with pytest.raises(SimulationError, match="keeps none") as caught:
            ask()
        assert "record=1000" in caught.value.remedy
        assert caught.value.got == "record=False"
    kept, known = sim.last_contacts(), full.last_contacts()
    assert len(kept) == len(known) > 0
    assert np.array_equal(kept.force, known.force)
    assert sim.last_step()[0] == pytest.approx(sim.t - 5e-3)


@pytest.mark.parametrize("record", [0, -3, 2.5, "none", "states "])
def test_other_records_are_refused(record):
    with pytest.raises(InputError, match="record") as caught:
        cvi.Simulator(bouncing(), dt=1e-3, record=record)
    assert caught.value.remedy


def test_records_that_are_looked_through_are_not_light():
    with pytest.raises(InputError, match="as it grows"):
        cvi.Simulator(bouncing(), dt=1e-3, record=False, ledger={"energy": 1.0})
    with pytest.raises(InputError, match="returns its trajectory"):
        cvi.simulate(bouncing(), duration=0.1, dt=1e-3, record=False)


def test_a_bad_start_leaves_the_state_as_it_was():
    sim = made("bouncing")
    sim.reset()
    sim.step()
    with pytest.raises(InputError):
        sim.reset(np.zeros(3))
    assert sim.t == 5e-3
    assert sim.step().ok
    assert len(sim.trajectory().t) == 3


def test_bad_forces_are_refused_by_name():
    sim = made("bouncing", record=False)
    sim.reset()
    for tau in (np.full(6, np.nan), np.zeros(5), np.zeros((1, 5)), "x", np.full(6, 1e60)):
        with pytest.raises(InputError, match="tau"):
            sim.step(tau)
    assert sim.t == 0.0
    assert sim.step([0.0] * 6).ok
    assert sim.step(np.zeros(6, dtype=np.float32)).ok


@pytest.mark.parametrize("name", SCENES)
def test_runs_that_use_an_engine_again_have_the_bits_of_the_first(name):
    """`simulate` keeps its engine with the scene; inputs, contacts and other options before change nothing."""
    make, chosen = SCENES[name]
    options = {"dt": 5e-3, **chosen}
    scene, fresh = make(), make()
    q, v = fast_start(scene)
    tau = np.array([0.05 * np.sin(0.1 * k + np.arange(len(v))) for k in range(100)])
    cvi.simulate(scene, q, v, duration=100 * options["dt"], control=tau, **options)
    cvi.simulate(scene, q, -v, duration=50 * options["dt"], **{**options, "record_contacts": False})
    again = cvi.simulate(scene, q, v, duration=STEPS * options["dt"], **options)
    assert_equal(again, cvi.simulate(fresh, q, v, duration=STEPS * options["dt"], **options))
    assert_equal(again, cvi.simulate(scene, q, v, duration=STEPS * options["dt"], **options))


def test_runs_without_events_share_logs_that_stay_empty():
    """A short run, one with an impact and contacts, and a short one again: with the same scene, in this order."""
    scene = bouncing()
    short, long, again = (cvi.simulate(scene, duration=duration, dt=1e-3) for duration in (0.01, 1.0, 0.01))
    assert len(long.events) > 0 < len(long.contacts)
    for traj in (short, again):
        logs = traj.events, traj.contacts, traj.contact_changes, traj.dense_steps
        assert [len(log) for log in logs] == [0, 0, 0, 0]
        assert all(len(values) == 0 for log in logs for values in log.arrays.values())
        assert traj.contacts.force.shape == (0, 3)
    assert short.contacts.label(0, 0) == long.contacts.label(0, 0)
    mhc = cvi.simulate(scene, duration=0.01, dt=1e-3, impact="mhc")
    assert (short.events.method, mhc.events.method) == ("ctec", "mhc")


def test_counts_of_a_run_are_the_fields_of_its_stats():
    stats = cvi.simulate(pendulum(), duration=0.01, dt=1e-3).stats
    assert vars(stats).keys() == {field.name for field in dataclasses.fields(stats)}
    assert stats.steps == 10
    assert stats == cvi.Stats(**vars(stats))
