"""The derivatives of runs with persistent contacts against fourth-order differences of the runs themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from derivatives.differences import FOURTH, compare_parameters, transpose_error
from helpers.sprung_arm import COLUMNS, NAMES, SPRUNG_ARM, sprung_arm

MODELS = Path(__file__).resolve().parents[2] / "models"
LEFT = (-6.0, 0.0, -9.81)  # a wall on the left is a ground, too

Start = tuple[cvi.Scene, np.ndarray, np.ndarray]


def body(shape: str, height: float, v: list[float], mu: float, e: float = 0.0, turn: float = 1.0, tilt=0.0) -> Start:
    """A body over the ground, turned."""
    scene = cvi.Scene()
    if shape == "box":
        scene.add_box("body", [0.2, 0.3, 0.25])
    elif shape == "cylinder":
        scene.add_cylinder("body", 0.1, 0.3)
    else:
        scene.add_sphere("body", 0.1)
    scene.add_halfspace([np.sin(tilt), 0.0, np.cos(tilt)])
    scene.set_contact(restitution=e, friction=mu)
    rng = np.random.default_rng(5)
    q = pin.integrate(scene.model, pin.neutral(scene.model), np.r_[0, 0, 0, turn * rng.uniform(-1, 1, 3)])
    q[2] = height
    return scene, q, np.array(v, dtype=float)


def arm(mu: float, joint_friction: float = 0.0) -> Start:
    """A double pendulum whose tip drops on a wall and stays there."""
    scene = cvi.Scene(gravity=LEFT)
    scene.add_urdf(MODELS / "double_pendulum.urdf", limits=False)
    scene.add_halfspace([1.0, 0.0, 0.0], -0.03125, name="wall")
    scene.set_contact(restitution=0.0, friction=mu)
    if joint_friction:
        scene.set_joint("*", friction=joint_friction)
    return scene, np.array([0.3, 0.2]), np.array([0.1, -0.2])


def ball_on_ball(mu: float) -> Start:
    """A ball that drops on a fixed one, rolls or slides down and leaves it."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_sphere("big", 0.5, free=False)
    scene.set_contact(restitution=0.0, friction=mu)
    q = pin.neutral(scene.model)
    q[:3] = [0.3, 0.05, 0.615]
    return scene, q, np.array([0.3, 0.0, -0.3, 0.2, 0.1, 0.3])


def room(restitution: float, mu: float, tilt: float) -> Start:
    """A ball that drops on the ground, slides to a wall and bounces off."""
    scene = cvi.Scene()
    scene.add_sphere("body", 0.1)
    scene.add_halfspace(name="ground")
    scene.add_halfspace([-np.cos(tilt), 0.0, np.sin(tilt)], -1.0, name="wall")
    scene.set_contact(restitution=restitution, friction=mu)
    scene.set_contact("body", "wall", restitution=0.5, friction=mu)
    q = pin.neutral(scene.model)
    q[:3] = [0.7, 0.0, 0.102]
    return scene, q, np.array([1.0, 0.3, -0.1, 0.0, 0.0, 0.0])


def trough(mu: float, restitution: float, third: float) -> Start:
    """A ball in a trough of two planes, which it touches both, rolls along it against a wall."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_halfspace([0.0, 0.8, 0.6], name="left")
    scene.add_halfspace([0.0, -0.8, 0.7], name="right")
    scene.add_halfspace([-1.0, 0.1, third], -0.8, name="wall")
    scene.set_contact(restitution=0.0, friction=mu)
    scene.set_contact("ball", "wall", restitution=restitution, friction=mu)
    q = pin.neutral(scene.model)
    q[:3] = [0.5, 0.003, 0.17]
    return scene, q, np.array([1.0, 0.0, -0.1, 0.2, 0.1, 0.3])


def at_limit() -> Start:
    """A double pendulum whose first joint comes to a limit and stays there."""
    scene = cvi.Scene(gravity=LEFT)
    scene.add_urdf(MODELS / "double_pendulum.urdf", limits=False)
    scene.set_joint("joint_1", limits=(0.05, 3.0))
    scene.set_contact(restitution=0.0)
    return scene, np.array([0.3, 0.2]), np.array([0.1, -0.2])


MOVING, SLOW = [1.0, 0.3, -0.1, 0.5, 0.2, 0.3], [0.3, 0.1, -0.1, 0.0, 0.0, 0.0]
ORDER_2, ORDER_6 = {"dt": 0.01, "order": 2}, {"dt": 0.01, "order": 6}
# name -> start, duration, options, what happens to the contact
RUNS = {
    "a ball slides": (lambda: body("ball", 0.105, MOVING, 0.0), 0.2, ORDER_2, ["begin"]),
    "a ball slips, and turns": (lambda: body("ball", 0.105, MOVING, 0.1), 0.2, ORDER_2, ["begin"]),
    "a ball slips, steps of contact are shorter": (lambda: body("ball", 0.105, MOVING, 0.1), 0.2, ORDER_6, ["begin"]),
    "a ball rolls at once": (lambda: body("ball", 0.105, MOVING, 0.8), 0.2, ORDER_2, ["begin"]),
    "a ball slips and rolls": (lambda: body("ball", 0.105, SLOW, 0.1), 0.4, ORDER_2, ["begin", "stick"]),
    "a ball bounces to rest": (
        lambda: body("ball", 0.105, MOVING, 0.1, e=0.3), 0.3, ORDER_2, ["bouncing ended", "begin", "stick"]
    ),
    "a ball slides down a plane": (lambda: body("ball", 0.12, MOVING, 0.0, tilt=0.3), 0.2, ORDER_2, ["begin"]),
    "a corner slides": (lambda: body("box", 0.25, MOVING, 0.0), 0.15, ORDER_2, ["begin"]),
    "a corner slips, and turns": (lambda: body("box", 0.25, MOVING, 0.1), 0.15, ORDER_2, ["begin"]),
    "a corner sticks": (lambda: body("box", 0.25, MOVING, 0.8), 0.15, ORDER_2, ["begin"]),
    "a corner slips, and comes to rest": (
        lambda: body("box", 0.25, [1, 0.2, -0.1, 0.5, 0.2, 0.3], 0.3), 0.15, ORDER_2, ["begin", "slip", "stick"]
    ),
    "a rim rolls": (lambda: body("cylinder", 0.25, MOVING, 0.8), 0.2, ORDER_2, ["begin"]),
    "a rim slips": (lambda: body("cylinder", 0.25, MOVING, 0.1), 0.15, ORDER_2, ["begin"]),
    "a box falls on a corner, an edge and its face": (
        lambda: body("box", 0.25, MOVING, 0.0), 0.4, ORDER_2, ["begin", "begin", "begin", "begin"]
    ),
    "a box slips on a corner and an edge": (lambda: body("box", 0.25, MOVING, 0.1), 0.22, ORDER_2, ["begin", "begin"]),
    "a box sticks on a corner and an edge": (lambda: body("box", 0.25, MOVING, 0.5), 0.2, ORDER_2, ["begin", "slip"]),
    "a rim slips, and the other one is hit": (
        lambda: body("cylinder", 0.25, MOVING, 0.1), 0.2, ORDER_2, ["begin", "begin"]
    ),
    "a ball slides in a trough against a wall": (lambda: trough(0.0, 0.0, -0.4), 0.3, ORDER_2, ["begin"] * 2),
    "a ball slips in a trough against a wall, and stays": (
        lambda: trough(0.1, 0.0, -0.4), 0.3, ORDER_2, ["begin"] * 3
    ),
    "a ball slips in a trough, and leaves a wall": (
        lambda: trough(0.1, 0.5, 0.0), 0.3, ORDER_2, ["begin", "begin", "release", "release", "begin", "begin"]
    ),
    "a joint stays at its limit": (at_limit, 0.7, ORDER_2, ["begin"]),
    "a wall is hit": (lambda: room(0.0, 0.1, 0.0), 0.4, ORDER_2, ["begin", "release", "begin"]),
    "a wall is hit, and the ground by that": (
        lambda: room(0.3, 0.0, -0.2), 0.4, ORDER_2, ["bouncing ended", "begin", "release", "bouncing ended", "begin"]
    ),
    "an arm slides": (lambda: arm(0.0), 0.7, ORDER_2, ["begin"]),
    "an arm slips": (lambda: arm(0.1), 0.7, ORDER_6, ["begin"]),
    "an arm comes to rest": (lambda: arm(1.5), 0.7, ORDER_2, ["begin", "stick"]),
    "an arm with joint friction": (lambda: arm(0.2, 1.0), 0.7, ORDER_2, ["begin"]),
    "a ball leaves a ball": (lambda: ball_on_ball(0.0), 0.6, ORDER_2, ["begin", "release"]),
    "a ball slips, and leaves a ball": (lambda: ball_on_ball(0.1), 0.6, ORDER_6, ["begin", "release"]),
    "a ball rolls, slips, leaves a ball": (lambda: ball_on_ball(1.0), 0.6, ORDER_2, ["begin", "slip", "release"]),
}  # fmt: skip


def compare(S: cvi.Sensitivity, end, columns: list[int], steps: tuple[float, float]) -> None:
    """Compare columns with the differences of end(change) for two steps; the second tells how good they are."""
    numbers = np.zeros((2, S.matrix.shape[1], len(columns)))
    for size, total in zip(steps, numbers, strict=True):
        for j, k in enumerate(columns):
            for count, weight in FOURTH:
                total[:, j] += weight / size * end(count * size * np.eye(S.matrix.shape[2])[k])
    scale, own = np.abs(numbers[1]).max(), np.abs(numbers[1] - numbers[0]).max()
    assert own <= 1e-5 * scale
    assert np.abs(S.matrix[-1][:, columns] - numbers[1]).max() <= 1e-7 * scale + own


def check(start: Start, columns: list[int], steps: tuple[float, float], **options) -> cvi.Trajectory:
    """Compare the derivatives in (q0, v0)."""
    (scene, q, v), nv = start, start[0].nv
    traj = cvi.simulate(scene, q, v, record="gradient", **options)

    def end(change: np.ndarray) -> np.ndarray:
        start = pin.integrate(scene.model, q, change[:nv]), v + change[nv:]
        run = cvi.simulate(scene, *start, record="gradient", **options)
        assert [c.change for c in run.contact_changes] == [c.change for c in traj.contact_changes]
        return np.concatenate([pin.difference(scene.model, traj.q[-1], run.q[-1]), run.v[-1]])

    compare(traj.sensitivity(), end, columns, steps)
    return traj


@pytest.mark.parametrize("name", RUNS)
def test_bodies_that_drop_and_stay(name):
    make, duration, options, changes = RUNS[name]
    start = make()
    size = 1.0 if "trough" in name else 2.5 if "bounces" in name or "arm" in name else 5.0
    steps = (2e-5 * size, 1e-5 * size)
    traj = check(start, list(range(2 * start[0].nv)), steps, duration=duration, **options)
    assert [c.change for c in traj.contact_changes] == changes


@pytest.mark.parametrize("name", RUNS)
def test_the_gradient_of_a_cost_is_the_transpose(name):
    """Of all nodes, backward; with the places where contacts and joints stick, and the times at which contacts end."""
    make, duration, options, _ = RUNS[name]
    scene, q, v = make()
    traj = cvi.simulate(scene, q, v, record="gradient", duration=duration, **options)
    wrt = ["q0", "v0", "control"]
    wrt += ["friction"] if scene.pair_friction.max(initial=0.0) > 0.0 else []
    wrt += ["restitution"] if scene.pair_restitution.max(initial=0.0) > 0.0 else []
    assert transpose_error(traj, wrt) <= 2e-12


@pytest.mark.parametrize(
    ("mu", "v", "changes"),
    [(0.0, [1, 0.3], []), (0.2, [1, 0.3], []), (0.5, [0.8, 0.3], ["stick"]), (0.5, [0, 0], [])],
    ids=["slides", "slips", "comes to rest", "rests"],
)
def test_a_face_that_lies_on_the_ground(mu, v, changes):
    """Four points share the load. The start may move along the ground, and its speed too; it rests but for that."""
    start = body("box", 0.125, [*v, 0, 0, 0, 0], mu, turn=0.0)
    columns = [0, 1, 5, *([6, 7] if any(v) else [])]
    traj = check(start, columns, (2e-4, 1e-4), duration=0.25, dt=0.01)
    assert [c.change for c in traj.contact_changes] == ["begin"] * 4 + changes * 4


def test_a_gap_at_the_start_is_closed_within_a_step():
    """Along a direction that opens a contact at the start the step corrects its gap, as it corrects rounding."""
    scene, q, v = body("ball", 0.1, [1, 0.3, 0, 0, 0, 0], 0.0, turn=0.0)
    S = cvi.simulate(scene, q, v, record="gradient", duration=0.1, dt=0.01).sensitivity()
    up = S.of("q0")[:, 2, 2], S.of("v0")[:, 8, 2]
    assert up[0] == pytest.approx(np.r_[1.0, np.zeros(10)], abs=1e-13)
    assert up[1] == pytest.approx(np.r_[1.0, np.zeros(10)], abs=1e-13)


@pytest.mark.parametrize("name", ["a ball slips and rolls", "an arm slips", "a ball slips, and leaves a ball"])
def test_inputs_and_friction_are_parameters(name):
    make, duration, options, _ = RUNS[name]
    scene, q, v = make()
    nv, mu = scene.nv, 0.1  # that of all three
    options = options | {"duration": duration, "record": "gradient"}
    base = cvi.simulate(scene, q, v, **options)
    S = base.sensitivity(["control", "friction"])
    steps = round(duration / options["dt"])

    def end(change: np.ndarray) -> np.ndarray:
        scene.set_contact(restitution=0.0, friction=mu + change[nv])
        traj = cvi.simulate(scene, q, v, control=np.tile(change[:nv], (steps, 1)), **options)
        return np.concatenate([pin.difference(scene.model, base.q[-1], traj.q[-1]), traj.v[-1]])

    compare(S, end, list(range(nv + 1)), (1e-4, 5e-5))


@pytest.mark.parametrize("support", ["sequence", "stiff"])
def test_what_holds_a_ball_takes_part_in_its_impacts(support):
    """The planes of a trough act together with the wall that is hit: as rigid supports, or after it."""
    traj = check(trough(0.1, 0.5, -0.4), [0, 4, 6, 9], (2e-5, 1e-5), duration=0.3, dt=0.01, support=support)
    instant = [event.time for event in traj.events if "wall" in event.pair]
    assert len([event for event in traj.events if event.time == instant[0]]) > 1


@pytest.mark.parametrize(("mu", "duration"), [(0.0, 0.5), (0.3, 0.3)])
def test_parameters_of_the_scene(mu, duration):
    """An arm on a slide drops on the ground, where its tip stays."""
    scene_of = sprung_arm(restitution=0.0, friction=mu)
    x = np.array(SPRUNG_ARM)
    q, v = np.array([0.4, -0.2]), np.array([0.0, 1.0])
    options = {"duration": duration, "dt": 0.005, "order": 4, "target": [0.3], "record": "gradient"}
    traj = cvi.simulate(scene_of(x), q, v, **options)
    assert [c.change for c in traj.contact_changes] == ["begin"]
    compare_parameters(traj, lambda x: cvi.simulate(scene_of(x), q, v, **options), x, NAMES, COLUMNS)
    assert transpose_error(traj, [*NAMES, "friction"] if mu > 0.0 else list(NAMES)) <= 2e-12


def refused(start: Start, **options) -> cvi.NotDifferentiable:
    with pytest.raises(cvi.NotDifferentiable) as found:
        cvi.simulate(*start, record="gradient", **options).sensitivity()
    return found.value


def tray() -> cvi.Scene:
    """A ball lies beside the middle of a tray, which servos lift and tilt about an axis 0.1 m below it."""
    model, place = pin.Model(), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    lift = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    pitch = model.addJoint(lift, pin.JointModelRY(), pin.SE3.Identity(), "pitch")
    model.appendBodyToJoint(pitch, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.02), place)
    shapes = pin.GeometryModel()
    shapes.addGeometryObject(pin.GeometryObject("plate", pitch, place, pin.hppfcl.Box(0.2, 0.2, 0.02)))
    scene = cvi.Scene.from_pinocchio(model, shapes, name="tray")
    scene.set_joint("tray", limits=False)
    scene.set_servo("lift", 9e3, 130.0, effort=float("inf"))
    scene.set_servo("pitch", 30.0, 0.5, effort=float("inf"))
    scene.add_sphere("ball", 0.03, mass=0.1, placement=(0.05, 0.0, 0.14))
    scene.set_contact(restitution=0.0, friction=2.0)
    return scene


def test_what_sticks_up_to_its_release():
    """Friction that carries a load goes to zero with the normal force: the ball slips before the tray lets it go."""
    options = {"duration": 0.106, "dt": 1e-3, "order": 2, "contact_mode": "events"}
    wave = np.sin(4.0 * np.pi * (np.arange(106) + 0.5) * 1e-3) ** 3
    target = np.column_stack([0.05 * wave, -0.4 * wave])
    traj = cvi.simulate(tray(), record="gradient", target=target, **options)
    assert [c.change for c in traj.contact_changes] == ["begin", "release"]
    assert transpose_error(traj, ["control"]) <= 2e-12
    check = cvi.check_gradient(tray(), wrt="control", target=target, **options)
    assert check.ok
    # Beside the largest column of the block, what differences lose of the small ones may be all that they have.
    large = [column for column in check.columns if column.state.size >= 5e-3 * column.state.block]
    assert len(large) == 5
    assert {column.believe for column in large} == {"both"}


def test_what_has_no_derivative_says_why():
    turning = body("box", 0.125, [1, 0, 0, 0, 0, 1], 0.3, turn=0.0)
    assert refused(turning, duration=0.1, dt=0.01).reason == "redundant"
    dense = refused(turning, duration=0.1, dt=0.01, contact_mode="steps")
    assert dense.reason == "redundant"
    assert refused(body("box", 0.25, MOVING, 0.5), duration=0.4, dt=0.01).reason == "redundant"
    flat = body("box", 0.15, [0.3, 0, 0, 0, 0, 0], 0.0, turn=0.0)
    assert refused(flat, duration=0.2, dt=0.01).reason == "witness"
    mapped = refused(body("ball", 0.105, MOVING, 0.0), duration=0.1, dt=0.01, impact="mhc", order=4)
    assert mapped.reason == "map"
    S = cvi.simulate(*body("ball", 0.105, MOVING, 0.1), record="gradient", duration=0.2, dt=0.01).sensitivity()
    with pytest.raises(cvi.NotDifferentiable) as found:
        S.at(0.155)
    assert found.value.reason == "inside"


def test_a_run_in_parts_has_the_same_derivatives():
    scene, q, v = body("ball", 0.105, SLOW, 0.1)
    whole = cvi.simulate(scene, q, v, record="gradient", duration=0.2, dt=0.01)
    sim = cvi.Simulator(scene, dt=0.01, record="gradient")
    sim.reset(q, v)
    for _ in range(20):
        sim.step()
    assert np.array_equal(sim.trajectory().sensitivity().matrix, whole.sensitivity().matrix)


@pytest.mark.parametrize("order", [2, 4, 8])
def test_what_is_kept_changes_no_digit(order):
    scene, q, v = ball_on_ball(0.1)
    options = {"duration": 0.4, "dt": 0.01, "order": order}
    plain = cvi.simulate(scene, q, v, **options)
    assert [c.change for c in plain.contact_changes] == ["begin", "release"]
    for other in ({"dense": True}, {"dense": False}, {"record_contacts": False}, {"record": "gradient"}):
        kept = cvi.simulate(scene, q, v, **options, **other)
        assert np.array_equal(plain.q, kept.q)
        assert np.array_equal(plain.p, kept.p)
    for record in (False, 5):
        sim = cvi.Simulator(scene, dt=0.01, order=order, record=record)
        sim.reset(q, v)
        assert sim.run(40).ok
        assert np.array_equal(plain.q[-1], sim.q)
        assert np.array_equal(plain.p[-1], sim.p)
