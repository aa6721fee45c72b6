"""The derivatives of runs with dense steps against fourth-order differences of the runs themselves.

Both are made with solver_tol=1e-15, with which the contact problems of the dense steps are solved to 1e-11 and gaps to
1e-14 m: with the usual 1e-8 and 1e-11 m differences are good to some five digits only.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH, transpose_error
from derivatives.test_persistent_sensitivity import MOVING, Start, arm, at_limit, ball_on_ball, body, trough
from helpers.grasp_scene import closed, grasp
from helpers.loop_scenes import arm_scene

DENSE = {"contact_mode": "steps", "solver_tol": 1e-15}
LANDS = "points whose shares of a load decide about the motion"


def placed(scene: cvi.Scene) -> np.ndarray:
    """The configuration in which the scene was built."""
    return np.array(cvi.simulate(scene, duration=1e-9, dt=1e-9, contact_mode="steps").q[0])


def bowl(mu: float, restitution: float = 0.0) -> Start:
    """Four balls that fall into a bowl of six planes, onto each other."""
    scene = cvi.Scene()
    for k in range(6):
        angle = np.pi * k / 3.0 + 0.1
        scene.add_halfspace([-np.cos(angle), -np.sin(angle), 1.2], -0.1, name=f"wall_{k}")
    for k in range(4):
        place = (0.04 * np.cos(2.0 * k), 0.04 * np.sin(2.0 * k), 0.1 + 0.11 * k)
        scene.add_sphere(f"ball_{k}", 0.05, mass=0.3, placement=place)
    scene.set_contact(restitution=restitution, friction=mu)
    return scene, placed(scene), 0.2 * np.random.default_rng(1).standard_normal(scene.nv)


def pile(mu: float) -> Start:
    """Three boxes that rest on each other, not straight."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(3):
        scene.add_box(f"box_{k}", [0.2, 0.2, 0.1], mass=1 + 0.3 * k, placement=(0.01 * k, -0.007 * k, 0.05 + 0.1 * k))
    scene.set_contact(restitution=0.0, friction=mu)
    return scene, placed(scene), np.zeros(scene.nv)


def dropped() -> Start:
    """Three boxes that fall flat on each other."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(3):
        scene.add_box(f"box_{k}", [0.2, 0.2, 0.1], mass=1 + 0.3 * k, placement=(0.02 * k, -0.013 * k, 0.06 + 0.13 * k))
    scene.set_contact(restitution=0.0, friction=0.3)
    return scene, placed(scene), 0.3 * np.random.default_rng(0).standard_normal(scene.nv)


def solo() -> Start:
    """A quadruped of meshes that falls on its feet and knees."""
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/solo_description/robots/solo12.urdf", base="free")
    scene.add_halfspace(offset=-0.4)
    scene.set_contact(friction=0.6, restitution=0.0)
    rng = np.random.default_rng(3)
    q = pin.integrate(scene.model, placed(scene), 0.1 * rng.standard_normal(scene.nv))
    return scene, q, 0.3 * rng.standard_normal(scene.nv)


def hand() -> Start:
    return grasp(0.0, 0.8)


# name -> start, duration, dt
RUNS = {
    "a ball slides": (lambda: body("ball", 0.105, MOVING, 0.0), 0.2, 0.01),
    "a ball slips, and turns": (lambda: body("ball", 0.105, MOVING, 0.1), 0.2, 0.01),
    "a ball rolls at once": (lambda: body("ball", 0.105, MOVING, 0.8), 0.2, 0.01),
    "a ball bounces": (lambda: body("ball", 0.105, MOVING, 0.1, e=0.5), 0.2, 0.01),
    "a ball slides down a plane": (lambda: body("ball", 0.12, MOVING, 0.0, tilt=0.3), 0.2, 0.01),
    "a corner slides": (lambda: body("box", 0.25, MOVING, 0.0), 0.15, 0.01),
    "a corner slips, and turns": (lambda: body("box", 0.25, MOVING, 0.1), 0.15, 0.01),
    "a corner sticks": (lambda: body("box", 0.25, MOVING, 0.8), 0.15, 0.01),
    "a box falls on a corner, an edge and its face": (lambda: body("box", 0.25, MOVING, 0.0), 0.4, 0.01),
    "a box slips on a corner and an edge": (lambda: body("box", 0.25, MOVING, 0.1), 0.22, 0.01),
    "a box tumbles": (lambda: body("box", 0.25, MOVING, 0.3, e=0.5), 0.4, 0.01),
    "a rim slides, and many of its points in one step": (lambda: body("cylinder", 0.25, MOVING, 0.0), 0.13, 0.01),
    "a ball slips in a trough against a wall": (lambda: trough(0.1, 0.0, -0.4), 0.3, 0.01),
    "a ball rolls, slips, leaves a ball": (lambda: ball_on_ball(1.0), 0.5, 0.01),
    "a joint stays at its limit": (at_limit, 0.7, 0.01),
    "an arm slides": (lambda: arm(0.0), 0.7, 0.01),
    "an arm slips": (lambda: arm(0.1), 0.7, 0.01),
    "an arm comes to rest, in halved steps": (lambda: arm(1.5), 0.5, 0.01),
    "balls fall into a bowl": (lambda: bowl(0.0), 0.2, 5e-3),
    "balls fall into a bowl and stick": (lambda: bowl(0.3), 0.2, 5e-3),
    "balls bounce in a bowl": (lambda: bowl(0.3, 0.4), 0.22, 5e-3),
    "a hand closes around a ball": (hand, 0.06, 1e-3),
    "a quadruped falls": (solo, 0.18, 2e-3),
}


def options_of(name: str, scene: cvi.Scene) -> dict:
    _, duration, dt = RUNS[name]
    target = {"target": closed(scene)} if "hand" in name else {}
    return {"duration": duration, "dt": dt, **DENSE, **target}


def differences(start: Start, directions: np.ndarray, step: float, options: dict) -> np.ndarray:
    """Differences of the end (q, v) along directions of the start, each (2 nv,)."""
    (scene, q, v), nv = start, start[0].nv
    base = cvi.simulate(scene, q, v, dense=True, **options)

    def end(change: np.ndarray) -> np.ndarray:
        run = cvi.simulate(scene, pin.integrate(scene.model, q, change[:nv]), v + change[nv:], dense=True, **options)
        return np.concatenate([pin.difference(scene.model, base.q[-1], run.q[-1]), run.v[-1]])

    columns = [sum(weight / step * end(count * step * d) for count, weight in FOURTH) for d in directions.T]
    return np.stack(columns, axis=1)


def compare(S: cvi.Sensitivity, start: Start, directions: np.ndarray, steps: tuple[float, float], options) -> None:
    """Compare with differences of two steps; the second tells how good they are."""
    coarse, fine = (differences(start, directions, step, options) for step in steps)
    scale, own = np.abs(fine).max(), np.abs(fine - coarse).max()
    assert own <= 1e-6 * scale
    assert np.abs(S.matrix[-1] @ directions - fine).max() <= 1e-7 * scale + own


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", RUNS)
def test_bodies_and_robots(name):
    """All columns of one body, random directions of many."""
    start = RUNS[name][0]()
    scene, q, v = start
    options = options_of(name, scene)
    traj = cvi.simulate(scene, q, v, record="gradient", **options)
    assert len(traj.dense_steps) > 0
    assert len(traj.contacts)
    S = traj.sensitivity()
    assert not any(step.reason for step in S.report.dense_steps if "rim" not in name)
    directions = np.eye(2 * scene.nv)
    if scene.nv > 12:
        directions = np.random.default_rng(0).standard_normal((2 * scene.nv, 3))
        directions /= np.linalg.norm(directions, axis=0)
    small = scene.nv > 12 or "box" in name or "trough" in name or "ball on" in name or "rim" in name or "halved" in name
    compare(S, start, directions, (1e-5, 5e-6) if small else (1e-4, 5e-5), options)


@pytest.mark.thinned(3)
@pytest.mark.filterwarnings("ignore::contactvi.ApproximateDerivativeWarning")
@pytest.mark.parametrize("name", RUNS)
def test_the_gradient_of_a_cost_is_the_transpose(name):
    scene, q, v = RUNS[name][0]()
    traj = cvi.simulate(scene, q, v, record="gradient", **options_of(name, scene))
    wrt = ["q0", "v0", "control", "gravity", f"inertia:{scene.model.names[-1]}", f"armature:{scene.model.names[-1]}"]
    wrt += ["friction"] if scene.pair_friction.max(initial=0.0) > 0.0 else []
    wrt += ["restitution"] if scene.pair_restitution.max(initial=0.0) > 0.0 else []
    assert transpose_error(traj, wrt) <= 2e-12


@pytest.mark.parametrize(("friction", "v"), [(20.0, [0.0, 1.0]), (6.0, [0.3, 1.0])], ids=["stays", "comes to rest"])
def test_a_joint_that_sticks_where_nothing_touches(friction, v):
    scene = arm_scene(2)
    scene.set_joint("j1", friction=friction)
    start, options = (scene, np.array([0.3, 0.4]), np.array(v)), {"duration": 0.05, "dt": 0.01, **DENSE}
    traj = cvi.simulate(*start, record="gradient", **options)
    assert traj.v[-1, 0] == pytest.approx(0.0, abs=1e-14)
    compare(traj.sensitivity(), start, np.eye(4), (1e-4, 5e-5), options)
    assert transpose_error(traj, ["q0", "v0", "control"]) <= 2e-12


@pytest.mark.parametrize(
    ("mu", "v"), [(0.0, [1, 0.3]), (0.2, [1, 0.3]), (0.5, [0.8, 0.3]), (0.5, [0, 0])],
    ids=["slides", "slips", "comes to rest", "rests"],
)  # fmt: skip
def test_a_face_that_lies_on_the_ground(mu, v):
    """Four points share the load. The start may move along the ground, and its speed too; it rests but for that."""
    start = body("box", 0.125, [*v, 0, 0, 0, 0], mu, turn=0.0)
    directions = np.eye(12)[:, [0, 1, 5, *([6, 7] if any(v) else [])]]
    options = {"duration": 0.25, "dt": 0.01, **DENSE}
    S = cvi.simulate(*start, record="gradient", **options).sensitivity()
    assert not S.report.approximate
    compare(S, start, directions, (2e-4, 1e-4), options)


def test_a_pile_of_boxes_at_rest():
    """Along all directions that keep the faces closed; over 0.05 s gaps of 1e-14 m are felt in the eighth digit."""
    start = pile(0.6)
    directions = np.eye(36)[:, [0, 1, 5, 6, 7, 11]]
    options = {"duration": 0.05, "dt": 5e-3, **DENSE}
    S = cvi.simulate(*start, record="gradient", **options).sensitivity()
    assert not S.report.approximate
    compare(S, start, directions, (2e-4, 1e-4), options)


@pytest.mark.parametrize("name", ["a ball slips, and turns", "an arm slips", "a ball bounces"])
def test_inputs_friction_and_restitution_are_parameters(name):
    make, duration, dt = RUNS[name]
    scene, q, v = make()
    nv, mu = scene.nv, 0.1  # that of all three
    e = float(scene.pair_restitution.max())
    steps = round(duration / dt)
    options = {"duration": duration, "dt": dt, **DENSE}
    # Without a force the gap of a ball that slips is just closed by what its friction asks for, which is a kink.
    traj = cvi.simulate(scene, q, v, record="gradient", control=np.full((steps, nv), 0.1), **options)
    S = traj.sensitivity(["control", "friction", "restitution"])
    assert not S.report.approximate

    def end(change: np.ndarray) -> np.ndarray:
        scene.set_contact(restitution=e + change[nv + 1], friction=mu + change[nv])
        run = cvi.simulate(scene, q, v, control=np.tile(0.1 + change[:nv], (steps, 1)), **options)
        return np.concatenate([pin.difference(scene.model, traj.q[-1], run.q[-1]), run.v[-1]])

    found = [np.zeros((2 * nv, nv + 2)) for _ in range(2)]
    for D, step in zip(found, (1e-4, 5e-5), strict=True):
        for k in range(nv + (2 if e > 0.0 else 1)):
            D[:, k] = sum(weight / step * end(count * step * np.eye(nv + 2)[k]) for count, weight in FOURTH)
    scale, own = np.abs(found[1]).max(), np.abs(found[1] - found[0]).max()
    assert own <= 1e-6 * scale
    assert np.abs(S.matrix[-1] - found[1]).max() <= 1e-7 * scale + own


@pytest.mark.slow
def test_from_dense_steps_to_located_events():
    """30 points with friction are not worth steps with persistent contacts; without three balls they are."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(30):
        scene.add_sphere(f"s{k}", 0.05, mass=0.3, placement=(0.2 * (k % 5), 0.2 * (k // 5), 0.05))
    scene.set_contact(restitution=0.0, friction=0.2)
    q, v = placed(scene), 0.3 * np.random.default_rng(1).standard_normal(scene.nv)
    v[2::6] = 0.0
    force = np.zeros((32, scene.nv))
    force[5:, [2, 8, 14]] = 6.0
    options = {"duration": 0.16, "dt": 5e-3, "solver_tol": 1e-15, "control": force}
    with pytest.warns(cvi.DenseStepWarning):
        traj = cvi.simulate(scene, q, v, record="gradient", **options)
    kinds = list(traj.phases["kind"])
    assert kinds[:2] == ["dense", "persistent"]
    direction = np.random.default_rng(0).standard_normal((2 * scene.nv, 1))
    direction[2 : scene.nv : 6] = 0.0  # the balls lie on the ground
    direction /= np.linalg.norm(direction)
    with pytest.warns(cvi.DenseStepWarning):
        compare(traj.sensitivity(), (scene, q, v), direction, (1e-5, 5e-6), options)


def test_a_file_keeps_what_the_derivatives_need(tmp_path):
    scene, q, v = bowl(0.3)
    traj = cvi.simulate(scene, q, v, duration=0.2, dt=5e-3, record="gradient", **DENSE)
    traj.save(tmp_path / "run.npz")
    again = cvi.Trajectory.load(tmp_path / "run.npz")
    assert np.array_equal(again.sensitivity().matrix, traj.sensitivity().matrix)


def test_what_is_kept_changes_no_number():
    scene, q, v = bowl(0.3, 0.4)
    runs = [
        cvi.simulate(scene, q, v, duration=0.3, dt=2e-3, contact_mode="steps", **more)
        for more in ({"dense": True}, {"record": "gradient"})
    ]
    assert np.array_equal(runs[0].q, runs[1].q)
    assert np.array_equal(runs[0].v, runs[1].v)


def test_a_load_that_is_shared_in_a_landing_is_told():
    """Boxes that fall flat on each other: what the points carry is not determined, and the motion depends on it."""
    scene, q, v = dropped()
    traj = cvi.simulate(scene, q, v, duration=0.1, dt=5e-3, record="gradient", **DENSE)
    for ask in (traj.sensitivity, lambda: cvi.gradient(traj, (np.ones(scene.nv), np.ones(scene.nv)), ["q0"])):
        with pytest.raises(cvi.NotDifferentiable) as found:
            ask()
        assert found.value.reason == "redundant"
    report = traj.sensitivity(on_kink="taken").report
    assert report.approximate
    assert LANDS in {step.reason for step in report.dense_steps}
    assert "approximate" in str(report)
    with pytest.warns(cvi.ApproximateDerivativeWarning):
        cvi.gradient(traj, (np.ones(scene.nv), np.ones(scene.nv)), ["q0"], on_kink="taken")


def test_a_gap_that_friction_holds_open_to_one_side_is_told():
    scene, q, v = RUNS["a ball slips, and turns"][0]()
    traj = cvi.simulate(scene, q, v, duration=0.2, dt=0.01, record="gradient", **DENSE)
    assert not traj.sensitivity(["q0", "v0"]).report.approximate
    report = traj.sensitivity(["control"]).report
    assert {step.reason for step in report.dense_steps if step.reason} == {
        "a sliding contact whose gap stays closed to one side and is held open to the other"
    }


def test_differences_agree_in_the_check():
    scene, q, v = RUNS["a corner slips, and turns"][0]()
    check = cvi.check_gradient(scene, q, v, duration=0.15, dt=0.01, contact_mode="steps", wrt=["q0", "v0"])
    assert {column.believe for column in check.columns} == {"both"}
