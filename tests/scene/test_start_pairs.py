"""Pairs that overlap at the neutral pose: a run tests those that are apart in its start, and names the others."""

from __future__ import annotations

import copy
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi.control.drives import Drives
from contactvi.control.interval import Interval
from contactvi.control.rollouts import Rollouts
from contactvi.derivatives.perturbed_runs import PerturbedRuns
from contactvi.importing.report import ADJACENT, OVERLAP, SELF_COLLISION
from contactvi.trajectory.compiled import compile_scene
from helpers.run_scenes import ball_scene

PENDULUM = """<robot name="p"><link name="base"/><link name="rod">
<inertial><origin xyz="0 0 -1"/><mass value="1"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 -1"/><geometry><sphere radius=".05"/></geometry></collision></link>
<joint name="j" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 -1 0"/></joint></robot>"""
ROBOTS = "example-robot-data://robots/"
WALL = 0.2  # [m]; at the neutral pose the bob is behind it


def pendulum(folder: Path) -> cvi.Scene:
    """A pendulum in front of a wall; at rest it would hang in the wall."""
    path = folder / "p.urdf"
    path.write_text(PENDULUM)
    scene = cvi.Scene()
    scene.add_urdf(path)
    scene.add_halfspace((1, 0, 0), WALL, name="wall")
    scene.set_contact("wall", "p", restitution=0.5)
    return scene


@pytest.fixture
def scene(tmp_path: Path) -> cvi.Scene:
    return pendulum(tmp_path)


@pytest.fixture
def raised(scene: cvi.Scene) -> np.ndarray:
    return scene.configuration({"j": 1.0})


def test_a_wall_behind_the_neutral_pose_is_hit(scene, raised):
    """The first impact is where the bob is a radius away from the wall; each later one is slower by e."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(scene, raised, duration=2.0)
    assert len(traj.events) == 4
    first = traj.events[0]
    assert first.q[1] == pytest.approx(WALL + 0.05, abs=1e-9)  # sin of the angle
    assert traj.scene.pair_names == [("rod_0", "wall")]
    assert scene.pair_names == []
    assert "tested in runs that start where they are apart" in str(scene.report)


def test_what_a_run_leaves_out_is_named_once(scene):
    """It swings through the wall, and says so."""
    with pytest.warns(cvi.UntestedPairWarning, match="'rod_0' and 'wall'") as found:
        traj = cvi.simulate(scene, duration=0.1)
    assert [str(Path(record.filename)) for record in found] == [__file__]
    assert len(traj.events) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cvi.simulate(scene, duration=0.1)
    sim = cvi.Simulator(copy.copy(scene), 1e-3)
    with pytest.warns(cvi.UntestedPairWarning) as found:
        sim.reset()
    assert [str(Path(record.filename)) for record in found] == [__file__]
    scene.disable_pair("rod", "wall")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cvi.simulate(scene, duration=0.1)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_copies_and_stored_scenes_choose_as_the_scene_does(scene, raised, copied):
    traj = cvi.simulate(scene, raised, duration=1.0, dt=1e-3)
    again = cvi.simulate(copied(scene), raised, duration=1.0, dt=1e-3)
    np.testing.assert_array_equal(traj.q, again.q)
    for run in (traj, again):  # the scene of a run has its pairs, and a run of it from elsewhere has others
        twin = copied(run.scene)
        assert twin.pair_names == [("rod_0", "wall")]
        with pytest.warns(cvi.UntestedPairWarning):
            assert len(cvi.simulate(twin, twin.neutral(), duration=0.1).events) == 0
        np.testing.assert_array_equal(cvi.simulate(twin, raised, duration=1.0, dt=1e-3).q, traj.q)


def test_stored_runs_know_the_pairs(scene, raised, tmp_path):
    traj = cvi.simulate(scene, raised, duration=1.0, dt=1e-3)
    traj.save(tmp_path / "run.npz")
    again = cvi.Trajectory.load(tmp_path / "run.npz").scene
    assert again.pair_names == [("rod_0", "wall")]
    assert again.pair_restitution == pytest.approx([0.5])
    np.testing.assert_array_equal(cvi.simulate(again, raised, duration=1.0, dt=1e-3).q, traj.q)
    old = {key: value for key, value in scene.to_dict().items() if key != "neutral_overlaps"}
    assert len(cvi.simulate(cvi.Scene.from_dict(old), raised, duration=0.1).events) == 0  # its pairs are as they are


@pytest.mark.filterwarnings("ignore::contactvi.UntestedPairWarning")
def test_a_simulator_decides_at_each_reset(scene, raised):
    sim = cvi.Simulator(scene, 1e-3)
    traj = cvi.simulate(scene, raised, duration=1.0, dt=1e-3)
    for _ in range(2):
        sim.reset()
        assert sim.scene.pair_names == []
        assert sim.gaps().shape == (0,)
        sim.reset(raised)
        assert sim.scene.pair_names == [("rod_0", "wall")]
        saved = sim.save()
        sim.run(1000)
        np.testing.assert_array_equal(sim.trajectory().q, traj.q)
    sim.reset()
    sim.load(saved)
    sim.run(1000)
    np.testing.assert_array_equal(sim.q, traj.q[-1])
    other = cvi.Simulator(scene, 1e-3)
    other.load(saved)
    other.run(1000)
    np.testing.assert_array_equal(other.q, traj.q[-1])
    sim.load(saved)
    batch = cvi.simulate_batch(sim, control=np.zeros((2, 1000, 1)), duration=1.0)  # from the state of the simulator
    np.testing.assert_array_equal(batch.q[:, -1], [traj.q[-1], traj.q[-1]])
    with pytest.raises(cvi.InputError, match="Snapshot"):
        cvi.Simulator(ball_scene(), 1e-3).load(saved)


@pytest.mark.filterwarnings("ignore::contactvi.UntestedPairWarning")
@pytest.mark.parametrize("options", [{"dt": 1e-3}, {"dt": 1e-3, "sample_dt": 0.1}])
@pytest.mark.parametrize("parameters", [None, {"mass:j": [[1.0], [2.0], [1.0], [2.0]]}, {"restitution": 0.5}])
def test_each_run_of_a_batch_decides_for_itself(scene, options, parameters):
    """Run by run as alone, whoever makes the runs."""
    starts = np.array([scene.configuration({"j": angle}) for angle in (0.0, 1.0, 0.8, 0.1)])
    if parameters is not None and "restitution" in parameters:
        parameters = {"damping:j": [[0.0], [0.1], [0.2], [0.0]]}
    found = cvi.simulate_batch(scene, starts, parameters=parameters, duration=1.0, keep="runs", **options)
    for k, q0 in enumerate(starts):
        own = scene if parameters is None else scene.with_parameters({n: v[k] for n, v in parameters.items()})
        alone = cvi.simulate(own, q0, duration=1.0, **options)
        assert len(alone.scene.pair_names) == (k in (1, 2))
        traj = found.runs[k] if hasattr(found, "runs") else found[k]
        np.testing.assert_array_equal(traj.q, alone.q)
        assert len(traj.events) == len(alone.events)


def test_derivatives_are_those_of_the_run(scene, raised):
    """Through the impact with the wall: against differences of runs that test the same pairs."""
    traj = cvi.simulate(scene, raised, duration=0.7, dt=1e-3, order=4, record="gradient")
    assert len(traj.events) == 1
    assert cvi.check_gradient(scene, raised, duration=0.7, dt=1e-3, order=4).ok
    runs = PerturbedRuns(scene, traj, traj.sensitivity(("q0", "v0")))
    assert len(runs.middle.times) == 1
    assert cvi.linearize(scene, raised, dt=1e-3)[0].shape == (2, 2)
    outcome = cvi.simultaneous_outcomes(scene, traj.events[0].q, np.array([-1.0]), tolerance=1e-6).chosen
    assert outcome.v_plus == pytest.approx([0.5], abs=1e-12)


@pytest.mark.filterwarnings("ignore::contactvi.UntestedPairWarning")
def test_rollouts_and_intervals(scene, raised):
    """Rollouts decide run by run; an interval has the pairs of the scene's own start, whatever it is asked for."""
    starts = np.array([raised, scene.configuration({"j": 0.1})])
    runs = Rollouts(scene, starts, np.zeros((2, 1)), dt=1e-3, steps=700)
    assert [len(traj.events) for traj in runs.runs] == [1, 0]
    runs.gradients(np.ones(runs.q.shape), np.ones(runs.v.shape))
    for start, expected in ((None, 0), (raised, 1)):
        scene.q0 = start
        piece = Interval(scene, 1e-3, Drives(scene), steps=700)
        assert len(piece.run(raised, np.zeros(1), np.zeros(1)).events) == expected


@pytest.mark.filterwarnings("ignore::contactvi.UntestedPairWarning")
def test_a_scene_is_compiled_once_for_each_set_of_pairs(scene, raised):
    base = compile_scene(scene)
    other = base.at_start(raised)
    assert base.at_start(None) is base
    assert base.at_start(scene.configuration({"j": 0.8})) is other
    assert other.at_start(scene.neutral()) is base
    assert compile_scene(scene).at_start(raised) is other


def test_links_of_one_robot_are_tested_where_they_start_apart():
    """The palm and the thumb of a hand overlap at zero and not when the thumb is turned; nothing is warned of."""
    scene = cvi.Scene()
    scene.add_urdf(ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf")
    pair = ("palm_link_0", "link_13.0_0")
    assert pair not in scene.pair_names
    assert next(row for row in scene.report.removed if (row.first, row.second) == pair).reason == OVERLAP
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(scene, duration=0.01, dt=1e-3)
        assert pair not in traj.scene.pair_names
        turned = scene.configuration({"joint_12.0": 1.2, "joint_13.0": 0.3})
        traj = cvi.simulate(scene, turned, duration=0.01, dt=1e-3)
    tested = set(traj.scene.pair_names)
    gaps = dict(zip(traj.scene.gap_names, traj.scene.gaps(turned), strict=True))
    assert tested >= set(scene.pair_names)
    assert pair in tested
    assert min(gaps[name] for name in tested) >= 0.0


def test_what_is_set_for_a_pair_that_is_not_tested_is_warned_of(scene):
    """Of the pair that may be tested, from another start, nothing is said."""
    hand = cvi.Scene()
    hand.add_urdf(ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf", self_collision=False)
    hand.add_halfspace((0, 0, 1), -1.0)
    hand.add_halfspace((1, 0, 0), -1.0, name="wall")
    cases = [
        (hand, ("link_1.0", "link_5.0"), SELF_COLLISION),
        (hand, ("ground", "wall"), "two halfspaces"),
        (hand, ("ground", "palm_link"), "fixed to each other"),
    ]
    hand.disable_pair("link_1.0", "ground")
    cases.append((hand, ("link_1.0", "ground"), "disabled by disable_pair"))
    free = cvi.Scene()
    free.add_urdf(ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf")
    cases.append((free, ("link_1.0", "link_2.0"), ADJACENT))
    for one, pair, reason in cases:
        with pytest.warns(cvi.UnusedSettingWarning, match="has no effect") as found:
            one.set_contact(*pair, friction=0.5)
        assert reason in str(found[0].message)
        assert Path(found[0].filename) == Path(__file__)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.set_contact("wall", "rod", friction=0.5)
        free.enable_pair("link_1.0", "link_2.0")
        free.set_contact("link_1.0", "link_2.0", friction=0.5)
        hand.set_contact("link_*", "ground", friction=0.5)  # some of them are
