"""Dense steps with constraints and prescribed motions, against laws of mechanics and against located events."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import constrained_scenes

G = 9.81
pytestmark = pytest.mark.filterwarnings("ignore::contactvi.DenseStepWarning")


def tray(lift, side, friction: float, boxes: int = 3) -> cvi.Scene:
    """Boxes on a tray that goes along (side(t), 0, lift(t)); both return a place and a speed."""
    scene = cvi.Scene()
    body = scene.add_box("tray", size=(2.0, 0.5, 0.02), mass=1.0)

    def pose(t: float):
        (z, w), (x, u) = lift(t), side(t)
        return pin.SE3(np.eye(3), np.array([x, 0.0, z])), (np.array([u, 0.0, w]), np.zeros(3))

    scene.prescribe(body, pose, name="motion")
    for k in range(boxes):
        scene.add_box(f"box{k}", size=(0.06, 0.05, 0.04), mass=0.2, placement=(0.0, 0.0, 0.03 + 0.04 * k))
    scene.set_contact(restitution=0.0, friction=friction)
    return scene


def still(t: float) -> tuple[float, float]:
    return 0.0, 0.0


def test_a_lifted_pile_weighs_what_newton_says():
    """The wrench of the motion is (M + m)(g + a), over each step the mean of it."""
    a = 1.5
    scene = tray(lambda t: (0.5 * a * t * t, a * t), still, friction=0.5)
    traj = cvi.simulate(scene, scene.assemble(), duration=0.3, dt=1e-3, contact_mode="steps")
    assert len(traj.dense_steps) >= 300
    assert len(traj.events) == 0
    np.testing.assert_allclose(traj.reactions("motion")[2:, 2], 1.6 * (G + a), rtol=1e-6)  # gaps are solved to 1e-11 m
    for k in range(3):
        at = traj.q[:, scene.q_index(f"box{k}")]
        np.testing.assert_allclose(at[:, 2] - 0.03 - 0.04 * k, 0.5 * a * traj.t**2, atol=1e-10)
    assert abs(traj.energy[-1] - traj.energy[0] - traj.work.prescribed[-1]) < 1e-10


def test_a_belt_takes_a_box_along_until_it_sticks():
    """The box slides for t = u/(mu g), over u t/2, and then goes with the belt: friction of a motion that is given."""
    u, mu = 0.4, 0.3
    scene = tray(still, lambda t: (u * t, u), friction=mu, boxes=1)
    traj = cvi.simulate(scene, scene.assemble(), duration=0.3, dt=1e-3, contact_mode="steps")
    x = traj.q[:, scene.q_index("box0")][:, 0]
    end = u / (mu * G)
    expected = np.where(traj.t < end, 0.5 * mu * G * traj.t**2, u * traj.t - 0.5 * u * end)
    np.testing.assert_allclose(x, expected, atol=2e-4)  # the slip ends inside of a step
    sliding = traj.t < end - 2e-3
    np.testing.assert_allclose(x[sliding], expected[sliding], atol=1e-9)


TWO = """<robot name="two"><link name="a">{a}</link><link name="b">{b}</link>
<joint name="ab" type="fixed"><parent link="a"/><child link="b"/><origin xyz="0.15 0 0.02"/></joint></robot>"""


def shape(mass: float, size: tuple[float, float, float]) -> str:
    """The inertia and shape of a box in a URDF."""
    x, y, z = (mass / 12.0 * (sum(s * s for s in size) - own * own) for own in size)
    return (
        f'<inertial><mass value="{mass}"/><inertia ixx="{x}" iyy="{y}" izz="{z}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<collision><geometry><box size="{size[0]} {size[1]} {size[2]}"/></geometry></collision>'
    )


def welded(weld: bool, path: Path | None = None) -> tuple[cvi.Scene, np.ndarray]:
    """A dumbbell of two boxes that falls on its edge: of two bodies with a weld, or of one."""
    scene = cvi.Scene()
    scene.add_halfspace((0, 0, 1), 0.0, name="ground")
    rotation = pin.exp3(np.array([0.2, 0.5, 0.1]))
    base = pin.SE3(rotation, np.array([0.0, 0.0, 0.3]))
    arm = pin.SE3(np.eye(3), np.array([0.15, 0.0, 0.02]))
    if weld:
        scene.add_box("a", size=(0.1, 0.1, 0.1), mass=1.0, placement=base)
        scene.add_box("b", size=(0.1, 0.08, 0.06), mass=0.5, placement=base * arm)
        scene.disable_pair("a", "b")
        scene.add_weld("a", "b", name="weld")
    else:
        path.write_text(TWO.format(a=shape(1.0, (0.1, 0.1, 0.1)), b=shape(0.5, (0.1, 0.08, 0.06))))
        scene.add_urdf(path, base="free", placement=base)
    scene.set_contact(restitution=0.0, friction=0.6)
    return scene, scene.assemble()


def test_welded_bodies_fall_as_they_do_with_located_events():
    """The dumbbell comes to rest near the same place, and the weld holds at every node."""
    scene, q0 = welded(True)
    dense = cvi.simulate(scene, q0, duration=0.6, dt=5e-4, contact_mode="steps")
    located = cvi.simulate(scene, q0, duration=0.6, dt=5e-4, contact_mode="events")
    assert len(dense.events) == 0
    assert len(located.events) > 0
    assert np.abs(dense.q[-1] - located.q[-1]).max() < 1e-2  # impacts at one instant share otherwise in a dense step
    assert max(np.abs(scene.core().constraint_residual(q, 0.0)).max() for q in dense.q) < 1e-12
    assert min(scene.gaps(q).min() for q in dense.q) > -1e-9
    assert np.diff(dense.energy).max() < 1e-7 * dense.energy[0]


def test_a_weld_makes_one_body_of_two(tmp_path):
    """Two boxes with a weld, and one body of both shapes, fall in the same way, to the order of the steps."""
    errors = []
    for dt in (1e-3, 2.5e-4):
        ends = []
        for weld in (True, False):
            scene, q0 = welded(weld, tmp_path / "two.urdf")
            traj = cvi.simulate(scene, q0, duration=0.25, dt=dt, contact_mode="steps")
            ends.append(traj.q[-1, scene.q_index("a" if weld else "root_joint")])
        errors.append(np.abs(ends[1] - ends[0]).max())
    assert errors[0] < 5e-5
    assert errors[1] < errors[0] / 4


def test_the_order_with_a_loop():
    """A four-bar without contacts is the same midpoint rule in dense steps and in those with constraints alone."""
    scene = cvi.load_scene("models/four_bar_striker.toml")
    runs = [
        cvi.simulate(scene, scene.q0, scene.v0, duration=0.1, dt=1e-3, contact_mode=mode)
        for mode in ("events", "steps")
    ]
    np.testing.assert_allclose(runs[1].q, runs[0].q, atol=1e-10)
    np.testing.assert_allclose(runs[1].v, runs[0].v, atol=1e-9)


@pytest.mark.parametrize("dt", [1e-2, 1e-3, 1e-4])
def test_a_plane_loop_on_a_body_that_hardly_tilts(dt):
    """A row of its constraint, across its plane, is zero or nearly so, and depends on the other two."""
    scene, q0, _ = constrained_scenes.five_bar_leg(0.0, 0.5)
    v0 = np.zeros(scene.nv)
    v0[3] = 1e-6
    runs = [cvi.simulate(scene, q0, v0, duration=0.03, dt=dt, contact_mode=mode) for mode in ("events", "steps")]
    assert runs[1].stats.halved == 0
    assert 1e-9 < np.abs(runs[1].q[-1, 3]) < 1e-7
    np.testing.assert_allclose(runs[1].q[-1], runs[0].q[-1], atol=2e-7)


def test_what_cannot_give_way_is_named():
    """A box between a table and a plate that comes down on it."""
    scene = cvi.Scene()
    scene.add_box("table", size=(0.4, 0.4, 0.02), free=False, placement=(0.0, 0.0, -0.01))
    scene.add_box("box", size=(0.1, 0.1, 0.1), mass=1.0, placement=(0.0, 0.0, 0.05))
    plate = scene.add_box("plate", size=(0.3, 0.3, 0.02), mass=1.0, placement=(0.0, 0.0, 0.12))
    down = np.array([0.0, 0.0, -0.1])
    scene.prescribe(
        plate, lambda t: (pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.12]) + t * down), (down, np.zeros(3))), name="press"
    )
    with pytest.raises(cvi.SimulationError, match="'box'|'plate'") as ended:
        cvi.simulate(scene, scene.assemble(), duration=0.3, dt=1e-3, contact_mode="steps")
    assert ended.value.status.code is cvi.StatusCode.CONSTRAINT
    assert ended.value.trajectory.t[-1] == pytest.approx(0.1, abs=2e-3)


LIFT = """<robot name="lift"><link name="base"/>
<link name="plate"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><box size="0.3 0.3 0.02"/></geometry></collision></link>
<joint name="lift" type="prismatic"><parent link="base"/><child link="plate"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="100" velocity="10"/></joint></robot>"""


@pytest.mark.parametrize("mode", ["events", "steps"])
def test_a_motion_bears_the_friction_of_its_joint(mode, tmp_path):
    """A prescribed lift with joint friction and a box on it: its force is weight and friction, which acts in full."""
    (tmp_path / "lift.urdf").write_text(LIFT)
    scene = cvi.Scene()
    scene.add_urdf(tmp_path / "lift.urdf")
    scene.set_joint("lift", friction=3.0)
    speed = 0.1
    scene.prescribe("lift", lambda t: (speed * t, speed, 0.0), name="motion")
    scene.add_box("box", size=(0.1, 0.1, 0.1), mass=2.0, placement=(0.0, 0.0, 0.06))
    scene.set_contact(restitution=0.0, friction=0.5)
    v0 = np.zeros(scene.nv)
    v0[0] = v0[3] = speed
    traj = cvi.simulate(scene, scene.assemble(), v0, duration=0.1, dt=1e-3, contact_mode=mode)
    assert (len(traj.dense_steps) > 0) == (mode == "steps")
    np.testing.assert_allclose(traj.q[:, scene.q_index("box")][:, 2], 0.06 + speed * traj.t, atol=1e-10)
    np.testing.assert_allclose(traj.reactions("motion")[2:], 3.0 * G + 3.0, rtol=1e-6)
    assert traj.work.joint_friction[-1] == pytest.approx(3.0 * speed * 0.1, rel=1e-9)


def jumps(t: float) -> float:
    return 0.0 if t < 0.0503 else 0.01


def fails(t: float) -> float:
    if t > 0.05:
        raise ValueError("no more")
    return 0.0


@pytest.mark.parametrize(("motion", "error"), [(jumps, cvi.SimulationError), (fails, cvi.UserFunctionError)])
def test_a_motion_that_jumps_or_fails_ends_the_run(motion, error):
    """At the instant at which it does, under its name."""
    scene = cvi.Scene()
    lift = scene.add_box("lift", size=(0.3, 0.3, 0.02), mass=1.0)
    still_there = (np.zeros(3), np.zeros(3))
    scene.prescribe(lift, lambda t: (pin.SE3(np.eye(3), np.array([0.0, 0.0, motion(t)])), still_there), name="motion")
    scene.add_box("box", size=(0.1, 0.1, 0.1), mass=1.0, placement=(0.0, 0.0, 0.06))
    with pytest.raises(error, match="motion") as ended:
        cvi.simulate(scene, scene.assemble(), duration=0.2, dt=1e-3, contact_mode="steps")
    if error is cvi.SimulationError:
        assert ended.value.status.code is cvi.StatusCode.CONSTRAINT
        assert ended.value.trajectory.t[-1] == pytest.approx(0.0503, abs=2e-5)


def test_joint_friction_takes_its_torque_times_the_angle_in_whole_steps():
    """A pendulum falls against friction: steps that counted too much of it as lost were halved to the shortest."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    rod = pin.Inertia(0.3, np.array([0.15, 0.0, 0.0]), np.diag([1e-4, 0.3 * 0.3**2 / 12, 0.3 * 0.3**2 / 12]))
    model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -G])
    scene = cvi.Scene.from_pinocchio(model, name="pendulum")
    scene.add_sphere("ball", 0.1, placement=(0.0, 3.0, 0.0))  # what can touch makes dense steps
    scene.add_halfspace(offset=-50.0)
    scene.set_joint("hinge", friction=0.05)
    traj = cvi.simulate(scene, duration=0.2, dt=1e-3, contact_mode="steps")
    assert traj.stats.halved == 0
    assert (traj.dense_steps.array("energy_rise") == 0.0).all()
    lost = 0.05 * traj.q[-1, scene.q_index("hinge")].item()
    assert traj.work.joint_friction[-1] == pytest.approx(lost, rel=1e-9)
    assert traj.energy[0] - traj.energy[-1] == pytest.approx(lost, rel=1e-4)  # H itself is of second order
