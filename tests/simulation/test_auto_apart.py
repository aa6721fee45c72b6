"""dt = "auto" with islands: those that never meet are searched for by themselves, and those that meet together."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.simulation.auto_apart import Apart
from contactvi.simulation.auto_search import Search
from contactvi.states import States
from contactvi.trajectory.polynomials import SegmentsApart
from helpers.coupled_hands import hand, limited, scene_of

TOL = 1e-7


def ground() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.set_contact(restitution=0.6, friction=0.3)
    return scene


def balls(count: int, seed: int = 0, gap: float = 3.0) -> cvi.Scene:
    """Balls that bounce, apart from each other by `gap` [m]."""
    rng, scene, speeds = np.random.default_rng(seed), ground(), {}
    for k in range(count):
        ball = scene.add_sphere(f"ball {k}", 0.1, 1.0, placement=(gap * k, 0.0, rng.uniform(0.3, 1.5)))
        speeds[ball] = (*rng.uniform(-0.5, 0.5, 2), rng.uniform(-1.0, 1.0))
    scene.v0 = scene.velocity(speeds)
    return scene


def sliding() -> cvi.Scene:
    """A ball that bounces, and far from it a box that slides to rest."""
    scene = ground()
    ball = scene.add_sphere("ball", 0.1, 1.0, placement=(3.0, 0.0, 0.5))
    box = scene.add_box("box", (0.2, 0.2, 0.1), 2.0, placement=(0.0, 3.0, 0.05))
    scene.v0 = scene.velocity({ball: (1.0, 0.0, -0.3), box: (2.0, 0.5, 0.0)})
    return scene


def groups(traj: cvi.Trajectory) -> list[tuple[int, ...]]:
    """Return the static trees that were searched for together; none where all were."""
    return [trees for trees, _ in traj.segments.parts] if isinstance(traj.segments, SegmentsApart) else []


def together(monkeypatch: pytest.MonkeyPatch, scene: cvi.Scene, duration: float, **options: Any) -> cvi.Trajectory:
    with monkeypatch.context() as patch:
        patch.setattr(Apart, "search", lambda self: None)
        return cvi.simulate(scene, duration=duration, **options)


def distance(scene: cvi.Scene, one: Any, other: Any) -> float:
    return float(States(scene.model).distance(np.atleast_2d(one), np.atleast_2d(other)).max())


def test_bodies_that_do_not_meet_move_as_alone() -> None:
    scene = balls(5)
    traj = cvi.simulate(scene, duration=1.0, tol=TOL)
    assert groups(traj) == [(0,), (1,), (2,), (3,), (4,)]
    assert traj.error_estimate <= TOL
    times = np.linspace(0.0, 1.0, 37)
    states = traj.at(times)
    for k in range(5):
        alone = ground()
        alone.add_sphere("ball", 0.1, 1.0, placement=traj.q[0, 7 * k : 7 * k + 3])
        assert scene.v0 is not None
        alone.v0 = scene.v0[6 * k : 6 * k + 6]
        own = cvi.simulate(alone, duration=1.0, tol=TOL)
        own_states = own.at(times)
        assert distance(alone, states.q[:, 7 * k : 7 * k + 7], own_states.q) < 1e-11
        np.testing.assert_allclose(states.p[:, 6 * k : 6 * k + 6], own_states.p, atol=1e-10)
        hit = [event.time for event in traj.events if f"ball {k}" in event.pair]
        np.testing.assert_allclose(hit, own.events.array("time"), atol=1e-11)


def test_the_work_is_that_of_the_bodies_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is the sum over the bodies. Together each impact cuts the steps of all; an iteration is then one of all."""
    apart = cvi.simulate(balls(32), duration=1.0, tol=1e-6).stats
    cut = together(monkeypatch, balls(32), 1.0, tol=1e-6).stats
    assert cut.impacts == apart.impacts
    assert 32 * cut.stage_iterations > 10 * apart.stage_iterations


def test_bodies_that_meet_are_run_together(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = balls(6)
    a = scene.add_sphere("left", 0.1, 1.0, placement=(-1.0, 5.0, 0.1))
    b = scene.add_sphere("right", 0.2, 1.0, placement=(1.0, 5.05, 0.2))
    assert scene.v0 is not None
    scene.v0 = np.append(scene.v0, np.zeros(12)) + scene.velocity({a: (2.0, 0.0, 0.0), b: (-2.0, 0.0, 0.0)})
    traj = cvi.simulate(scene, duration=0.6, tol=TOL)
    assert groups(traj) == [(0,), (1,), (2,), (3,), (4,), (5,), (6, 7)]
    reference = together(monkeypatch, scene, 0.6, tol=TOL)
    assert any(set(event.pair) == {"left", "right"} for event in traj.events)
    assert len(traj.events) == len(reference.events)
    np.testing.assert_allclose(traj.events.array("time"), reference.events.array("time"), atol=1e-9)
    assert distance(scene, traj.events.array("q"), reference.events.array("q")) < 1e-8
    assert distance(scene, traj.q, reference.at(traj.t).q) < 2 * TOL


def test_paths_that_cross_at_other_times_do_not_meet() -> None:
    scene = ground()
    first = scene.add_sphere("first", 0.1, 1.0, placement=(-1.0, 0.0, 0.5))
    later = scene.add_sphere("later", 0.1, 1.0, placement=(0.0, -2.0, 0.5))
    scene.v0 = scene.velocity({first: (4.0, 0.0, 0.0), later: (0.0, 3.0, 0.0)})
    traj = cvi.simulate(scene, duration=0.9, tol=TOL)
    assert groups(traj) == [(0,), (1,)]
    gap = np.linalg.norm(np.diff(traj.at(np.linspace(0, 0.9, 500)).q.reshape(500, 2, 7)[:, :, :3], axis=1), axis=2)
    assert gap.min() > 0.2


@pytest.mark.parametrize("seed", range(12))
def test_no_meeting_is_missed(seed: int) -> None:
    """The certain answer against distances at many times, of balls, boxes and capsules that fly through each other."""
    rng = np.random.default_rng(seed)
    scene = cvi.Scene()
    scene.add_halfspace(offset=-50.0)
    speeds = {}
    for k in range(6):
        place = rng.uniform(-1.0, 1.0, 3)
        size = rng.uniform(0.05, 0.2, 3)
        body = (
            scene.add_sphere(f"b{k}", size[0], 1.0, placement=place) if k % 3 == 0
            else scene.add_box(f"b{k}", size, 1.0, placement=place) if k % 3 == 1
            else scene.add_capsule(f"b{k}", 0.5 * size[0], 2.0 * size[1], 1.0, placement=place)
        )  # fmt: skip
        speeds[body] = (rng.uniform(-2.0, 2.0, 3), rng.uniform(-6.0, 6.0, 3))
    scene.v0 = scene.velocity(speeds)
    core = scene.core()
    trees = _core.StaticTrees(core)
    assert trees.count == 6
    options = _core.SimulatorOptions()
    options.order, options.dense, options.dt = 8, True, 0.02
    parts = [trees.part([k]) for k in range(6)]
    runs, times = [], np.linspace(0.0, 0.5, 400)
    q0 = np.asarray(scene.built().start)
    everywhere = np.zeros((len(times), scene.nq))
    for part in parts:
        simulator = _core.Simulator(part.scene, options)
        assert simulator.reset(q0[part.q], scene.v0[part.v])["code"] == _core.StatusCode.SUCCESS
        run, error = simulator.run_auto(0.5, 1e-3)
        assert error is None
        runs.append(run)
    near = 1e-6
    found = {tuple(sorted(pair)) for pair in trees.meetings(parts, runs, near)}
    linked = {k: {k} for k in range(6)}
    for a, b in found:
        both = linked[a] | linked[b]
        for k in both:
            linked[k] = both
    for part, run in zip(parts, runs, strict=True):
        q, _ = _core.dense(part.scene, run.take_segments(), times, 8, 1e-10)
        everywhere[:, part.q] = q
    least = np.array([scene.gaps(q) for q in everywhere]).min(axis=0)
    for (one, other), gap in zip(scene.pair_names, least, strict=True):
        if not (one.startswith("b") and other.startswith("b")):
            continue
        a, b = int(one[1]), int(other[1])
        if gap <= 0.0:
            assert b in linked[a], (one, other, gap)
        if tuple(sorted((a, b))) in found:
            assert gap < 0.02, (one, other, gap)  # what moves between two of the times looked at


@pytest.mark.slow
def test_servos_and_coupled_joints_of_parts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Fingers of a hand with a fixed base: work and energies are those of one run with all."""
    scene = scene_of(limited(hand(), "f0j0", -0.3, 0.45), tmp_path)
    leaders = [f"f{k}j0" for k in range(5)]
    for k, name in enumerate(leaders):
        scene.set_servo(name, kp=0.05 * (k + 1), kd=0.002)
    goals = {name: (lambda t, k=k: 0.3 + 0.2 * np.sin((3.0 + k) * t)) for k, name in enumerate(leaders)}
    traj = cvi.simulate(scene, duration=0.5, tol=TOL, target=goals)
    assert len(groups(traj)) == 5
    reference = together(monkeypatch, scene, 0.5, tol=1e-9, target=goals)
    at = reference.at(traj.t)
    assert distance(scene, traj.q, at.q) < 2 * TOL
    np.testing.assert_allclose(traj.v[-1], reference.v[-1], atol=TOL)
    assert np.abs(traj.ledger.energy_balance).max() < 1e-3 * TOL
    assert np.ptp(traj.work.input) > 1e-3
    np.testing.assert_allclose(traj.work.input[-1], reference.work.input[-1], atol=TOL)
    np.testing.assert_allclose(traj.work.damping[-1], reference.work.damping[-1], atol=TOL)


def test_reactions_of_loops_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ground()
    speeds: dict[Any, Any] = {}
    for k, x in enumerate((0.0, 5.0)):
        one = scene.add_box(f"one {k}", (0.1, 0.1, 0.1), 1.0, placement=(x, 0.0, 2.0))
        other = scene.add_box(f"other {k}", (0.1, 0.1, 0.1), 1.0 + k, placement=(x + 0.5, 0.0, 2.0))
        scene.add_distance(one, other, name=f"rod {k}")
        speeds[one] = (0.0, 1.0, 1.0 + k)
    scene.v0 = scene.velocity(speeds)
    traj = cvi.simulate(scene, duration=0.4, tol=TOL)
    assert groups(traj) == [(0,), (1,)]
    reference = together(monkeypatch, scene, 0.4, tol=TOL)
    for name in ("rod 0", "rod 1"):
        impulse, expected = (np.diff(run.t) @ run.reactions(name)[1:] for run in (traj, reference))
        np.testing.assert_allclose(impulse, expected, rtol=1e-6)


def test_a_stored_run_has_the_same_states(tmp_path: Path) -> None:
    traj = cvi.simulate(sliding(), duration=1.0, tol=TOL)
    assert len(groups(traj)) == 2
    traj.save(tmp_path / "run.npz")
    again = cvi.Trajectory.load(tmp_path / "run.npz")
    assert groups(again) == groups(traj)
    times = np.linspace(0.0, 1.0, 23)
    for other in (again, pickle.loads(pickle.dumps(traj))):
        for name in ("q", "v", "p"):
            np.testing.assert_array_equal(getattr(other.at(times), name), getattr(traj.at(times), name))


def test_the_energy_balances_at_all_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The box slides while the ball bounces: its steps end at the nodes of the run, where its friction counts."""
    scene = sliding()
    traj = cvi.simulate(scene, duration=1.0, tol=TOL)
    assert len(groups(traj)) == 2
    assert np.abs(traj.ledger.energy_balance).max() < 1e-9
    reference = together(monkeypatch, scene, 1.0, tol=TOL)
    at = reference.at(traj.t)
    assert distance(scene, traj.q, at.q) < 2 * TOL
    samples = cvi.simulate(scene, duration=1.0, tol=TOL, sample_dt=0.125)
    assert distance(scene, samples.q, reference.at(samples.t).q) < 2 * TOL
    light = cvi.simulate(scene, duration=1.0, tol=TOL, dense=False)
    assert light.segments is None
    np.testing.assert_array_equal(light.q, traj.q)


def test_a_map_that_conserves_a_scalar_of_the_step_takes_all_bodies() -> None:
    scene = balls(2)
    scene.set_contact(restitution=1.0, friction=0.0)
    assert groups(cvi.simulate(scene, duration=0.5, tol=1e-5, impact="mhc")) == []


def test_ctrl_c_keeps_what_all_groups_have_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = cvi.simulate(balls(3), duration=1.0, tol=TOL)
    search, calls = Search.search, []

    def interrupted(self: Search, allowed: float | None = None) -> Any:
        calls.append(self)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return search(self, allowed)

    with monkeypatch.context() as patch:
        patch.setattr(Search, "search", interrupted)
        traj = cvi.simulate(balls(3), duration=1.0, tol=TOL, throw=False)
    assert traj.status.code == cvi.StatusCode.INTERRUPTED
    assert len(groups(traj)) == 3
    assert distance(traj.scene, traj.q[-1], whole.q[-1]) < 1e-4  # two groups have the long steps of a companion
    assert np.isnan(traj.error_estimate)


def test_ctrl_c_before_a_group_was_run_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    companion, calls = Search.companion, []

    def interrupted(self: Search) -> Any:
        calls.append(self)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return companion(self)

    monkeypatch.setattr(Search, "companion", interrupted)
    with pytest.raises(KeyboardInterrupt):
        cvi.simulate(balls(3), duration=1.0, tol=TOL)
