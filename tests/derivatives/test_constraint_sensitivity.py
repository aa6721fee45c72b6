"""The derivatives of runs with loops, driven joints and other constraints against differences of the runs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH, compare_parameters, constrained_differences, transpose_error
from helpers import constrained_scenes as scenes
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm

BAR = 1e-7
KNOTS = np.linspace(0.0, 1.0, 11)

SMOOTH = {
    "a four-bar linkage": scenes.linkage,
    "a four-bar linkage, closed twice": lambda: scenes.linkage(redundant=True),
    "a four-bar linkage with joint friction": lambda: scenes.linkage(joint_friction=1.0),
    "a bar on three cranks": scenes.parallelogram,
    "a driven joint": scenes.driven_joint,
    "a driven joint with friction": lambda: scenes.driven_joint(joint_friction=0.5),
    "joints of several kinds": scenes.mixed_joints,
    "a joint that follows another": scenes.followers,
    "a box on a rod": lambda: scenes.box_on_rod(driven=False),
    "a box on a rod of driven length": lambda: scenes.box_on_rod(driven=True),
    "two bodies fixed to each other": lambda: scenes.pair_of_bodies(lambda s: s.add_weld("a", "b", scenes.TWISTED)),
    "a nut on a screw": lambda: scenes.pair_of_bodies(lambda s: s.add_screw("a", "b", 0.05, scenes.TWISTED)),
    "a hinge": lambda: scenes.pair_of_bodies(lambda s: s.add_screw("a", "b", 0.0, scenes.TWISTED)),
    "a chain of ball joints between two walls": scenes.chain_of_boxes,
    "a box on a body with a prescribed pose": scenes.moved_pendulum,
}
# name -> start, duration, what happens to the contacts, number of impacts
TOUCHING = {
    "a linkage bounces off a stop": (lambda: scenes.linkage_at_stop(1.0), 0.6, [], 1),
    "a linkage strikes a ball": (lambda: scenes.striker(1.0, 0.0), 0.5, [], 1),
    "a linkage strikes a ball, with friction": (lambda: scenes.striker(0.5, 0.3), 0.5, [], 1),
    "a driven arm bounces": (lambda: scenes.driven_arm_at_wall(0.5, 0.0), 0.28, [], 1),
    "a driven arm bounces, and sticks": (lambda: scenes.driven_arm_at_wall(0.5, 1.3), 0.28, [], 1),
    "a driven arm slides": (lambda: scenes.driven_arm_at_wall(0.0, 0.0), 0.6, ["begin"], 1),
    "a driven arm slips": (lambda: scenes.driven_arm_at_wall(0.0, 0.1), 0.6, ["begin"], 1),
    "a driven arm comes to rest": (lambda: scenes.driven_arm_at_wall(0.0, 1.5), 0.6, ["begin", "stick"], 1),
    "a ball with a pendulum slides": (lambda: scenes.ball_with_pendulum(0.0, 0.3), 0.3, ["begin"], 1),
    "a ball with a pendulum rolls": (lambda: scenes.ball_with_pendulum(0.9, 0.3), 0.3, ["begin"], 1),
    "a ball with a pendulum slips": (lambda: scenes.ball_with_pendulum(0.05, 1.0), 0.3, ["begin"], 1),
    "a ball with a pendulum slips and rolls": (lambda: scenes.ball_with_pendulum(0.2, 0.3), 0.3, ["begin", "stick"], 1),
    "a ball with a box slides off another": (lambda: scenes.pair_on_ball(0.05), 0.35, ["begin", "release"], 1),
    "a ball with a box rolls off another": (lambda: scenes.pair_on_ball(0.8), 0.35, ["begin", "slip", "release"], 1),
    "a towed ball leaves another": (lambda: scenes.towed_ball(scenes.winch), 0.35, ["begin", "release"], 1),
    "a ball towed along a spline": (
        lambda: scenes.towed_ball((KNOTS, [scenes.winch(t)[0] for t in KNOTS])),
        0.35,
        ["begin", "release"],
        1,
    ),
    "a ball bounces on a moved plate": (lambda: scenes.ball_on_moved_plate(0.9, 0.3), 0.06, [], 1),
    "a ball slides on a moved plate": (lambda: scenes.ball_on_moved_plate(0.0, 0.05), 0.2, ["begin"], 1),
    "a ball rolls on a moved plate": (lambda: scenes.ball_on_moved_plate(0.0, 0.8), 0.2, ["begin"], 1),
    "a ball leaves a moved plate": (
        lambda: scenes.ball_on_moved_plate(0.0, 0.1, 0.06),
        0.2,
        ["begin", "slip", "release"],
        1,
    ),
    "joined balls drop one after the other": (lambda: scenes.joined_balls(0.1), 0.3, ["begin", "begin"], 6),
}


def compare(traj: cvi.Trajectory, first: tuple, second: tuple) -> None:
    """Of an exact derivative with differences of two sizes, whose change is their own error."""
    S = traj.sensitivity(["q0", "v0"])
    size = np.abs(second[1]).max()
    own = np.abs(first[1] - second[1]).max() / size
    assert own <= BAR * 10
    assert np.abs(S.matrix[-1] @ second[0] - second[1]).max() <= max(BAR, own) * size
    assert all(0.0 < event.approach <= 1.0 + 1e-12 for event in S.report.events)
    if not len(traj.events):
        return
    # Those of impacts that close slowly are known to the time that these are located to.
    clear = np.flatnonzero([event.gamma_minus < -0.1 for event in traj.events])
    seconds, wide = second[2][clear], np.abs(first[2] - second[2])[clear]
    found = (S.event_times @ second[0])[clear]
    assert np.abs(found - seconds).max() <= max(BAR * np.abs(seconds).max(), wide.max())


def recorded(start: scenes.Start, duration: float, **options) -> tuple[cvi.Trajectory, np.ndarray, np.ndarray]:
    scene, q, v = start
    q, v = scenes.on_constraints(scene, q, v)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=duration, dt=0.01, **options)
    assert traj.status.ok
    return traj, q, v


def adjoint_error(traj: cvi.Trajectory, *names: str) -> float:
    last = str(traj.scene.model.names[traj.scene.model.njoints - 1])
    return transpose_error(traj, ["q0", "v0", "control", "gravity", f"mass:{last}", f"inertia:{last}", *names])


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_runs(name):
    traj, q, v = recorded(SMOOTH[name](), 0.2)
    options = {"duration": 0.2, "dt": 0.01}
    steps = [constrained_differences(traj.scene, q, v, step, **options) for step in (4e-4, 2e-4)]
    compare(traj, *steps)
    assert adjoint_error(traj) <= 2e-12


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", TOUCHING)
def test_runs_with_contacts(name):
    start, duration, changes, impacts = TOUCHING[name]
    traj, q, v = recorded(start(), duration)
    found = [c.change for c in traj.contact_changes]
    assert found[: len(changes)] == changes or set(found) == set(changes) | {"release"}
    assert len(traj.events) == impacts
    options = {"duration": duration, "dt": 0.01}
    steps = [constrained_differences(traj.scene, q, v, step, **options) for step in (1e-4, 5e-5)]
    compare(traj, *steps)
    assert adjoint_error(traj, "restitution") <= 2e-12


DTEC = {
    "a linkage bounces off a stop": (lambda: scenes.linkage_at_stop(0.7), 0.6, 1),
    "a linkage strikes a ball": (lambda: scenes.striker(0.8, 0.0), 0.5, 1),
    "a driven arm bounces": (lambda: scenes.driven_arm_at_wall(0.5, 0.0), 0.28, 1),
    "a ball bounces on a moved plate": (lambda: scenes.ball_on_moved_plate(0.9, 0.0), 0.06, 1),
    "a driven arm bounces again and again": (lambda: scenes.driven_arm_at_wall(0.8, 0.0), 0.6, 2),
}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", DTEC)
def test_runs_with_dtec(name):
    """Its equation over the rest of the step, with the work of what is driven."""
    start, duration, impacts = DTEC[name]
    traj, q, v = recorded(start(), duration, impact="dtec")
    assert len(traj.events) >= impacts
    assert not np.any(traj.events.array("fallback"))
    options = {"duration": duration, "dt": 0.01, "impact": "dtec"}
    steps = [constrained_differences(traj.scene, q, v, step, **options) for step in (1e-4, 5e-5)]
    compare(traj, *steps)
    assert transpose_error(traj, ["q0", "v0", "restitution"]) <= 2e-12


def test_inputs_of_a_linkage():
    """The columns of the control, which acts in all steps, and their single rows."""
    traj, q, v = recorded(scenes.linkage_at_stop(0.7), 0.6)
    exact = traj.sensitivity(["control"]).matrix[-1]

    def end(force: np.ndarray) -> np.ndarray:
        run = cvi.simulate(traj.scene, q, v, duration=0.6, dt=0.01, control=np.tile(force, (60, 1)))
        return np.concatenate([run.q[-1], run.v[-1]])

    step = 1e-3
    for k in range(3):
        numbers = sum(weight / step * end(count * step * np.eye(3)[k]) for count, weight in FOURTH)
        assert np.abs(exact[:, k] - numbers).max() <= BAR * np.abs(exact).max()


DROPS = [(0.6, 0.0, 0.25), (0.6, 0.3, 0.25), (0.0, 0.0, 0.3), (0.0, 0.3, 0.19)]  # e, mu, duration


@pytest.mark.parametrize(("e", "mu", "duration"), DROPS)
def test_parameters_of_the_scene(e, mu, duration):
    """A linked arm drops on the ground: impact and persistent contact depend on inertias through the constraint too."""
    scene_of = sprung_arm(restitution=e, friction=mu, linked=True)
    x = np.array(SPRUNG_ARM)
    scene = scene_of(x)
    q = scene.assemble(np.array([0.25, 0.4, 0.3]), fixed=["slide", "turn"])
    q, v = scenes.on_constraints(scene, q, np.array([-2.0, 0.5, 0.2]))
    options = {"duration": duration, "dt": 0.005, "target": [0.3]}
    traj = cvi.simulate(scene, q, v, record="gradient", **options)
    assert len(traj.events) >= 1
    compare_parameters(traj, lambda x: cvi.simulate(scene_of(x), q, v, **options), x, NAMES, COLUMNS)
    assert transpose_error(traj, [*NAMES, "q0", "v0"]) <= 2e-12


def test_columns_off_the_constraints_are_those_of_the_run():
    """A run accepts starts that are 1e-8 off, and its steps bring them back: along these, too, S is its derivative."""
    traj, q, v = recorded(scenes.linkage(), 0.1)
    S, nv, step = traj.sensitivity(["q0", "v0"]), traj.scene.nv, 2e-9
    for k in range(2 * nv):
        d = step * np.eye(2 * nv)[k]
        ends = []
        for sign in (1, -1):
            run = cvi.simulate(
                traj.scene, pin.integrate(traj.scene.model, q, sign * d[:nv]), v + sign * d[nv:], duration=0.1, dt=0.01
            )
            ends.append(np.concatenate([run.q[-1], run.v[-1]]))
        numbers = (ends[0] - ends[1]) / (2.0 * step)
        assert np.abs(S.matrix[-1][:, k] - numbers).max() <= 1e-5 * np.abs(S.matrix[-1]).max()


def test_the_end_of_a_run_stays_on_the_constraints_along_all_columns():
    traj, _, _ = recorded(scenes.driven_arm_at_wall(0.5, 0.3), 0.28)
    S, core, nv = traj.sensitivity(["q0", "v0", "control"]), traj.scene.core(), traj.scene.nv
    J = np.asarray(core.constraint_jacobian(traj.q[-1], float(traj.t[-1])))
    assert np.abs(J @ S.matrix[-1][:nv]).max() <= 1e-12 * np.abs(S.matrix[-1]).max()


def test_the_rest_of_a_step_may_be_very_short():
    """Below 1e-5 of a step constraints count by their rates, not by differences of residuals: to 1e-5 the same."""
    scene, q, v = scenes.driven_arm_at_wall(0.5, 0.3)
    q, v = scenes.on_constraints(scene, q, v)
    found = []
    for share in (2e-5, 9e-6):
        dt = 0.01
        for _ in range(5):  # the impact so much before the end of its step
            hit = cvi.simulate(scene, q, v, duration=28 * dt, dt=dt).events[0].time
            dt = hit / (round(hit / dt) - share)
        traj = cvi.simulate(scene, q, v, duration=28 * dt, dt=dt, record="gradient")
        assert (traj.events[0].time / dt) % 1.0 == pytest.approx(1.0 - share, rel=1e-6)
        found.append(traj.sensitivity(["q0", "v0"]).matrix[-1])
        assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12
    assert np.abs(found[1] - found[0]).max() <= 1e-6 * np.abs(found[0]).max()


def test_gradients_are_kept_in_files(tmp_path):
    traj, _, _ = recorded(scenes.striker(0.5, 0.3), 0.5)
    again = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    assert np.array_equal(again.sensitivity().matrix, traj.sensitivity().matrix)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["a linkage strikes a ball, with friction", "a driven arm comes to rest"])
def test_check_gradient_brings_starts_back(name):
    start, duration, _, _ = TOUCHING[name]
    scene, q, v = start()
    found = cvi.check_gradient(scene, *scenes.on_constraints(scene, q, v), duration, 0.01, columns=8)
    assert found.ok, [c for c in found.columns if c.believe == "neither"]
    assert sum(column.believe == "both" for column in found.columns) >= 4


# -- what has no derivative -------------------------------------------------------------------------------------------


def test_a_release_beside_a_motion_that_is_not_smooth_is_refused():
    """A spline has jumps in its third derivative at its knots, on which the time of the release depends."""
    times = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    release = 0.35
    for knot in (0.2, None, None, None):  # shortly before the release, which moves with it
        times[2:4] = knot or release - 0.0004, 0.33
        traj, _, _ = recorded(scenes.towed_ball((times, [scenes.winch(t)[0] for t in times])), 0.4)
        release = next(c.time for c in traj.contact_changes if c.change == "release")
    assert 0.0 < release - times[2] < 0.0008
    nv = traj.scene.nv
    for ask in (traj.sensitivity, lambda: cvi.gradient(traj, (np.ones(nv), np.ones(nv)))):
        with pytest.raises(cvi.NotDifferentiable, match="prescribed motion") as found:
            ask()
        assert found.value.reason == "release"


@pytest.mark.parametrize(("mu", "reason"), [(0.3, "friction"), (1.0, "redundant")])
def test_friction_that_the_constraints_make_indefinite_is_refused(mu, reason):
    """A linkage of one degree of freedom at a stop: how its impulse splits into pressure and friction is open, and the
    expansion depends on it."""
    scene, q, v = scenes.linkage_at_stop(0.5)
    scene.set_contact(restitution=0.5, friction=mu)
    traj, _, _ = recorded((scene, q, v), 0.6)
    with pytest.raises(cvi.NotDifferentiable) as found:
        traj.sensitivity()
    assert found.value.reason == reason


REFUSED = {  # options, what the derivative is with respect to, part of the message
    "mhc": ({"impact": "mhc"}, "v0", "MHC at order 2"),
    "inputs": ({"impact": "dtec"}, "control", "depends on inputs"),
    "gravity": ({"impact": "dtec"}, "gravity", "depends on inputs"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_implicit_maps_do_not_know_is_refused(name):
    options, wrt, words = REFUSED[name]
    traj, _, _ = recorded(scenes.linkage_at_stop(0.7), 0.6, **options)
    with pytest.raises(cvi.NotDifferentiable, match=words) as found:
        traj.sensitivity(wrt)
    assert found.value.reason == "map"


def test_joint_friction_beside_an_implicit_map_is_refused():
    scene, q, v = scenes.linkage_at_stop(0.7)
    scene.set_joint("hinge_coupler", friction=0.1)
    traj, _, _ = recorded((scene, q, v), 0.6, impact="dtec")
    with pytest.raises(cvi.NotDifferentiable, match="joint friction") as found:
        traj.sensitivity()
    assert found.value.reason == "map"
