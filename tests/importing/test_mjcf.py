"""MJCF files: what contactvi makes of them against MuJoCo's own numbers (helpers.mujoco_oracle) and runs."""

from __future__ import annotations

import sys
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.elements.constraints import Constraint
from contactvi.inputs import pose
from helpers import mujoco_oracle as oracle
from helpers.extras import mujoco_module

mujoco = mujoco_module()

WORLD = """
<body name="arm" pos=".1 .2 1" quat=".9 .1 .3 .2">
  <joint name="slide" type="slide" axis="1 2 3" pos=".1 .2 .3" ref=".2" springref=".1" stiffness="30" damping="1.5"/>
  <joint name="first" axis="1 0 1" pos=".1 -.2 .05" ref=".4" springref="-.3" stiffness="5" damping=".2" armature=".03"
         range="-2 2.5"/>
  <joint name="second" axis="0 1 0" pos="0 .1 .05" ref="-.7"/>
  <geom name="block" type="box" size=".1 .2 .3" pos=".1 0 .1" quat=".5 .1 .7 .2"/>
  <geom name="rod" type="capsule" fromto="0 0 0 .3 .1 .2" size=".05"/>
  <site name="here" pos=".1 .05 .2" quat=".3 .4 .5 .1"/>
  <body name="fixed" pos=".2 0 .1" euler=".1 .2 .3">
    <geom name="egg" type="ellipsoid" size=".05 .1 .07"/>
    <body name="hand" pos=".3 .1 -.2" axisangle="1 1 0 .5" gravcomp=".6">
      <joint name="third" axis="0 0 1" pos="-.1 0 .2" ref=".3"/>
      <joint name="ball" type="ball" pos=".05 .1 -.1" damping=".1" armature=".01" stiffness="2"/>
      <geom name="can" type="cylinder" size=".06 .2" pos="0 .1 0"/>
      <geom name="ghost" size=".1" contype="0" conaffinity="0"/>
      <site name="there" pos=".1 .05 .2" quat=".3 -.4 .5 .1"/>
    </body>
  </body>
</body>
<body name="drone" pos="0 1 2" quat=".3 .2 .1 .9">
  <freejoint name="free"/>
  <geom name="crate" type="box" size=".1 .2 .3" pos=".1 0 .1"/>
  <site name="hook" pos=".2 .1 0"/>
  <body name="flap" pos=".1 .2 .3"><joint name="hinge" axis="0 1 1"/><geom name="knob" size=".1" pos=".2 0 0"/></body>
</body>
<body name="marker" mocap="true" pos="3 3 3"><geom size=".1"/></body>
"""
FREE_OF_CONTACT = '<flag contact="disable" limit="disable"/>'


def text(world: str = WORLD, rest: str = "", option: str = "") -> str:
    return (
        '<mujoco model="m"><compiler angle="radian"/><option gravity=".3 -.2 -9.81">'
        f"{option}</option><worldbody>{world}</worldbody>{rest}</mujoco>"
    )


def both(folder: Path, xml: str, **options) -> tuple[cvi.Scene, mujoco.MjModel]:
    """The scene of an MJCF and MuJoCo's model of it."""
    file = folder / "m.xml"
    file.write_text(xml)
    return cvi.Scene.from_mjcf(file, **options), mujoco.MjModel.from_xml_path(str(file))


def names(scene: cvi.Scene, use: str, topic: str) -> dict[str, str]:
    return {note.name: note.text for note in scene.report.all_notes(use, topic)}


# --- what is in the model ---------------------------------------------------------------------------------------------


def test_masses_forces_and_places_are_those_of_mujoco(tmp_path: Path):
    scene, m = both(tmp_path, text())
    assert oracle.differences(scene, m, states=5).largest() < 1e-12
    assert scene.gravity == pytest.approx([0.3, -0.2, -9.81])
    assert [joint.type for joint in scene.report.parts[0].joints] == [
        "prismatic", "revolute", "revolute", "revolute", "spherical", "free", "revolute",
    ]  # fmt: skip
    assert names(scene, "changed", "body") == {"marker": "a mocap body, which stands still here"}
    assert "ghost" not in scene.names.geometries
    assert "marker" in scene.names.geometries  # a geom without a name has that of its body


@pytest.mark.parametrize(
    "rest",
    [
        "",
        '<tendon><spatial stiffness="20" damping=".3" springlength=".4">'
        '<site site="here"/><site site="there"/><site site="hook"/></spatial></tendon>',
        '<tendon><spatial stiffness="200" springlength="0 .4">'
        '<site site="here"/><site site="there"/></spatial></tendon>',
    ],
    ids=["springs and dampers", "tendon", "slack tendon"],
)
def test_a_motion_is_that_of_mujoco(tmp_path: Path, rest: str):
    """Order 4 with steps of 1 ms against MuJoCo's Runge-Kutta with 0.05 ms."""
    scene, m = both(tmp_path, text(rest=rest, option=FREE_OF_CONTACT))
    qpos, qvel = oracle.random_state(m, 1)
    start, speed = oracle.to_q(m, qpos), oracle.to_v(m, qpos)[0] @ qvel
    traj = cvi.simulate(scene, start, speed, 0.2, dt=1e-3, order=4)
    end = run(m, qpos, qvel, 0.2, 5e-5)
    slack = "0 .4" in rest  # the force has a kink where it begins
    assert off(m, end, traj.q[-1]) < (1e-6 if slack else 1e-9)
    assert off(m, end, start) > 0.1


def run(m: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, duration: float, dt: float, ctrl=()) -> np.ndarray:
    m.opt.timestep, m.opt.integrator = dt, mujoco.mjtIntegrator.mjINT_RK4
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:] = qpos, qvel
    if len(ctrl):
        d.ctrl[:] = ctrl
    for _ in range(round(duration / dt)):
        mujoco.mj_step(m, d)
    return np.array(d.qpos)


def off(m: mujoco.MjModel, qpos: np.ndarray, q: np.ndarray) -> float:
    """Largest difference [m, rad] of a qpos and a q."""
    other, apart = np.array(q), np.zeros(m.nv)
    for kind, first in zip(m.jnt_type, m.jnt_qposadr, strict=True):
        if kind in (oracle.FREE, oracle.BALL):
            first = first + (3 if kind == oracle.FREE else 0)
            other[first : first + 4] = np.roll(other[first : first + 4], 1)
    mujoco.mj_differentiatePos(m, apart, 1.0, qpos, other)
    return float(np.abs(apart).max())


def test_a_smooth_height_field(tmp_path: Path):
    """One surface through the file's samples, where MuJoCo has them; the report has the distance from its triangles."""
    asset = (
        '<asset><hfield name="hills" nrow="3" ncol="4" size="1 1 .5 .1" elevation="0 1 0 1 1 0 1 0 0 1 0 1"/></asset>'
    )
    world = '<geom name="hills" type="hfield" hfield="hills" pos=".1 .2 .3"/>'
    world += '<body pos=".2 .1 2"><freejoint/><geom name="b" size=".1"/></body>'
    (tmp_path / "m.xml").write_text(text(world, asset))
    scene = cvi.Scene.from_mjcf(tmp_path / "m.xml", hfield="smooth")
    assert scene.pair_names == [("hills", "b")]
    known = [note.text for note in scene.report.all_notes("changed", "geom")]
    assert len(known) == 1
    assert "height field taken smooth" in known[0]
    heights = 0.5 * np.array([[0, 1, 0, 1], [1, 0, 1, 0], [0, 1, 0, 1]], dtype=float)
    number = scene.collision_model.getGeometryId("hills")
    for i, y in enumerate(np.linspace(-1, 1, 3)):
        for j, x in enumerate(np.linspace(-1, 1, 4)):
            assert abs(scene.core().feet(number, np.array([x, y, heights[i, j]]), 0.0)[0, 0]) < 1e-12
    run = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert run.status.ok
    assert len(run.events) > 0
    with pytest.raises(cvi.InputError, match="height fields"):
        cvi.Scene.from_mjcf(tmp_path / "m.xml", hfield="rough")


def test_a_height_field_is_its_prisms(tmp_path: Path):
    asset = (
        '<asset><hfield name="hills" nrow="3" ncol="4" size="1 1 .5 .1" elevation="0 1 0 1 1 0 1 0 0 1 0 1"/></asset>'
    )
    world = '<geom name="hills" type="hfield" hfield="hills"/>'
    world += '<body pos=".2 .1 2"><freejoint/><geom name="b" size=".1"/></body>'
    scene, m = both(tmp_path, text(world, asset))
    assert len(scene.pair_names) == 12
    d, rng = mujoco.MjData(m), np.random.default_rng(0)
    hills = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_GEOM, "hills")
    ball = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_GEOM, "b")
    for _ in range(20):
        d.qpos[:3] = *rng.uniform(-0.7, 0.7, 2), 1.5
        mujoco.mj_forward(m, d)
        gap = scene.core().gaps(oracle.to_q(m, np.array(d.qpos)))[0].min()
        # A ray down from the ball meets the surface no nearer than the ball is.
        normal = np.zeros(3)
        ray = mujoco.mj_rayHfield(m, d, hills, d.geom_xpos[ball], np.array([0.0, 0.0, -1.0]), normal) - 0.1
        assert 0.3 * ray < gap <= ray + 1e-12
    big = asset.replace('nrow="3" ncol="4"', 'nrow="40" ncol="40"').replace("0 1 0 1 1 0 1 0 0 1 0 1", "0 " * 1600)
    scene, _ = both(tmp_path, text(world, big))
    assert not scene.pair_names
    assert "height field of more than 1000 cells" in names(scene, "ignored", "geom")["hills"]


# --- contacts ---------------------------------------------------------------------------------------------------------

RULES = """
<geom name="floor" type="plane" size="1 1 1"/>
<body name="a" pos="0 0 1"><freejoint/>
  <geom name="a1" size=".1" friction=".3"/><geom name="a2" size=".1" pos=".3 0 0" contype="2" conaffinity="0"/>
  <body name="b" pos="0 0 .5"><joint/><geom name="b1" size=".1" condim="1"/>
    <body name="c" pos="0 0 .5"><joint/><geom name="c1" size=".1" friction=".7 .01 0" priority="1"/>
      <body name="d" pos="0 0 .5"><geom name="d1" size=".1"/></body>
    </body>
  </body>
</body>
<body name="e" pos="1 0 1"><freejoint/>
  <geom name="e1" size=".1" conaffinity="2"/><geom name="e2" size=".1" pos=".5 0 0"/></body>
<body name="f" pos="2 0 1"><joint type="slide"/><geom name="f1" size=".1" solref=".02 .2"/></body>
<body name="g" pos="3 0 1"><geom name="g1" size=".1"/></body>
"""
PAIRS = """<contact><exclude body1="a" body2="e"/>
<pair geom1="a2" geom2="c1" friction=".2 .2 0 0 0" condim="3"/><pair geom1="e2" geom2="f1" condim="6"/></contact>"""


@pytest.mark.parametrize("flag", ["", '<flag filterparent="disable"/>', '<flag contact="disable"/>'])
def test_pairs_and_friction_are_those_of_mujoco(tmp_path: Path, flag: str):
    scene, m = both(tmp_path, text(RULES, PAIRS, flag))
    geom = {mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_GEOM, k): k for k in range(m.ngeom)}
    found = {
        tuple(sorted(geom[name] for name in pair)): mu
        for pair, mu in zip(scene.pair_names, scene.pair_friction, strict=True)
    }
    wanted = {pair: mu for pair, (mu, _) in oracle.tested_pairs(m).items()}
    assert found == pytest.approx(wanted)
    assert bool(found) == ("contact" not in flag)
    assert not scene.pair_restitution.any()
    if not flag:
        assert "torsional" in " ".join(names(scene, "ignored", "pair").values())


TURNING = """
<geom name="floor" type="plane" size="1 1 1" friction="{floor}" priority="{priority}"/>
<body name="a" pos="0 0 .09"><freejoint/><geom name="ball" size=".1" friction=".8 .02 .003" condim="{condim}"/></body>
"""


@pytest.mark.parametrize("condim", [3, 4, 6])
@pytest.mark.parametrize(("floor", "priority"), [("1 .005 .0001", 0), (".5 .03 .004", 0), (".5 .03 .004", 1)])
def test_torsional_and_rolling_friction_is_that_of_mujoco(tmp_path: Path, condim: int, floor: str, priority: int):
    """A contact that MuJoCo has mixed: its bounds on the two torques, over the normal force, are the same."""
    file = tmp_path / "turning.xml"
    file.write_text(text(TURNING.format(floor=floor, priority=priority, condim=condim)))
    m = mujoco.MjModel.from_xml_path(str(file))
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    contact = d.contact[0]
    scene = cvi.Scene()
    scene.add_mjcf(file, turning_friction=True)
    (mu,) = scene.pair_friction
    laws = scene.to_dict()["contact_laws"]
    law = laws[0] if laws else {}
    assert mu == pytest.approx(contact.friction[0])
    assert mu * law.get("spinning_radius", 0.0) == pytest.approx(contact.friction[2] if contact.dim >= 4 else 0.0)
    assert law.get("rolling_radius", 0.0) == pytest.approx(contact.friction[3] if contact.dim >= 6 else 0.0)
    assert not names(scene, "ignored", "pair")
    scene = cvi.Scene()
    scene.add_mjcf(file)
    assert ("torsional" in " ".join(names(scene, "ignored", "pair").values())) == (contact.dim >= 4)
    assert not scene.to_dict()["contact_laws"]


def test_what_may_touch_nothing_in_the_file_touches_what_is_not_in_it(tmp_path: Path):
    world = '<body pos="0 0 1"><freejoint/>'
    world += '<geom name="one" size=".1" friction=".4"/><geom name="two" size=".1" pos="1 0 0"/></body>'
    scene, _ = both(tmp_path, text(world))
    assert scene.pair_names == []
    scene.add_halfspace()
    assert sorted(map(sorted, scene.pair_names)) == [["ground", "one"], ["ground", "two"]]
    assert sorted(scene.pair_friction) == [0.4, 1.0]
    assert not scene.pair_restitution.any()
    again = cvi.Scene.from_dict(scene.to_dict())
    assert (again.pair_names, list(again.pair_friction)) == (scene.pair_names, list(scene.pair_friction))


def test_what_the_user_sets_counts_more_than_the_file(tmp_path: Path):
    scene, _ = both(tmp_path, text(RULES, PAIRS))
    at = [tuple(sorted(pair)) for pair in scene.pair_names].index(("a1", "floor"))
    assert (scene.pair_friction[at], scene.pair_restitution[at]) == (1.0, 0.0)
    scene.set_contact(friction=0.05, restitution=0.6)  # a default is for what says nothing
    assert (scene.pair_friction[at], scene.pair_restitution[at]) == (1.0, 0.0)
    scene.set_contact("floor", friction=0.2, restitution=0.3)
    assert (scene.pair_friction[at], scene.pair_restitution[at]) == (0.2, 0.3)
    scene.set_contact("a1", "floor", friction=0.4)
    assert (scene.pair_friction[at], scene.pair_restitution[at]) == (0.4, 0.3)


def test_several_joints_of_a_body_are_no_bodies_without_mass(tmp_path: Path):
    scene, _ = both(tmp_path, text())
    assert not list(scene.report.all_notes("suspicious", "body"))
    assert [body.name for body in scene.report.parts[0].bodies] == ["arm", "fixed", "hand", "drone", "flap", "marker"]


def test_parts_that_overlap_in_the_pose_of_the_file_do_not_touch(tmp_path: Path):
    world = RULES.replace('name="c1" size=".1"', 'name="c1" size="1.2"')
    scene, m = both(tmp_path, text(world, "<default><geom margin='0'/></default>"))
    removed = {tuple(sorted((pair.first, pair.second))) for pair in scene.report.removed}
    assert ("a1", "c1") in removed
    assert len(scene.pair_names) + len(removed & {tuple(sorted(p)) for p in pairs_by_name(m)}) == len(pairs_by_name(m))
    # What lies on the floor is placed by the start of a run: an overlap there is an error of the start.
    assert ("c1", "floor") in {tuple(sorted(pair)) for pair in scene.pair_names}


def pairs_by_name(m: mujoco.MjModel) -> list[tuple[str, ...]]:
    names = [mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_GEOM, k) for k in range(m.ngeom)]
    return [tuple(names[k] for k in pair) for pair in oracle.tested_pairs(m)]


@pytest.mark.parametrize(
    ("solref", "ratio"), [(".02 1", 0.1353), (".02 .2", 0.5725), (".02 2", 0.0476), ("-10000 -50", None)]
)
def test_restitution_from_solref(tmp_path: Path, solref: str, ratio: float | None):
    """The ratio of the speeds that MuJoCo itself has, with steps of 0.01 ms."""
    world = f'<geom type="plane" size="1 1 1" solref="{solref}"/>'
    world += f'<body pos="0 0 .1001"><freejoint/><geom size=".1" solref="{solref}"/></body>'
    xml = text(world, '<option gravity="0 0 0" timestep="1e-5"/>').replace('gravity=".3 -.2 -9.81"', "")
    scene, m = both(tmp_path, xml, restitution="solref")
    d = mujoco.MjData(m)
    d.qvel[2] = -1.0
    while d.qvel[2] < 0.0 or d.ncon:
        mujoco.mj_step(m, d)
    assert scene.pair_restitution[0] == pytest.approx(d.qvel[2], abs=0.004)
    if ratio is not None:
        assert scene.pair_restitution[0] == pytest.approx(ratio, abs=1e-3)
    assert both(tmp_path, xml, restitution=0.3)[0].pair_restitution[0] == 0.3
    loose = both(tmp_path, xml, restitution=None)[0]
    loose.set_contact(restitution=0.7)
    assert loose.pair_restitution[0] == 0.7
    with pytest.raises(cvi.InputError, match="restitution"):
        both(tmp_path, xml, restitution="bouncy")


# --- constraints and actuators ----------------------------------------------------------------------------------------

EQUALITIES = {
    "connect": '<connect name="e" body1="hand" body2="drone" anchor=".1 .2 .3"/>',
    "connect to the world": '<connect name="e" body1="hand" anchor=".1 .2 .3"/>',
    "sites": '<connect name="e" site1="here" site2="hook"/>',
    "weld": '<weld name="e" body1="drone" body2="hand" relpose=".1 .2 .3 .5 .1 .2 .3" anchor=".02 .03 .04"/>',
    "weld as it is": '<weld name="e" body1="flap" body2="fixed" anchor=".1 .2 .3"/>',
    "weld of sites": '<weld name="e" site1="there" site2="hook"/>',
    "joints": '<joint name="e" joint1="second" joint2="first" polycoef=".1 .5 .2 -.1 .05"/>',
    "joint": '<joint name="e" joint1="slide" polycoef=".05"/>',
    "tendon": '<tendon name="e" tendon1="sum" polycoef=".1"/>',
}
SUM = '<tendon><fixed name="sum"><joint joint="first" coef="2"/><joint joint="second" coef="-3"/></fixed></tendon>'


@pytest.mark.parametrize("case", EQUALITIES)
def test_equalities_are_those_of_mujoco(tmp_path: Path, case: str):
    """Where contactvi assembles the scene MuJoCo finds no violation, but it does at the start."""
    xml = text(rest=f"{SUM}<equality>{EQUALITIES[case]}</equality>", option=FREE_OF_CONTACT)
    scene, m = both(tmp_path, xml, prefix="p_")
    assert [element.name for element in scene.elements if isinstance(element, Constraint)] == ["p_e"]
    qpos, d = np.array(m.qpos0), mujoco.MjData(m)
    mujoco.mj_integratePos(m, qpos, np.random.default_rng(3).normal(size=m.nv), 0.3)
    assembled = scene.assemble(oracle.to_q(m, qpos))
    residuals = []
    for q in (oracle.to_q(m, qpos), assembled):
        d.qpos[:] = q
        for kind, first in zip(m.jnt_type, m.jnt_qposadr, strict=True):
            if kind in (oracle.FREE, oracle.BALL):
                first = first + (3 if kind == oracle.FREE else 0)
                d.qpos[first : first + 4] = np.roll(q[first : first + 4], 1)
        mujoco.mj_forward(m, d)
        residuals.append(float(np.abs(d.efc_pos[d.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)]).max()))
    assert residuals[1] < 1e-12
    assert residuals[0] > 1e-3
    assert not [e for e in both(tmp_path, xml, equality=False)[0].elements if isinstance(e, Constraint)]


ACTUATORS = """<actuator><position name="p" joint="first" kp="40" kv="2" gear="2.5" ctrlrange="-1 .3"/>
<velocity name="v" joint="second" kv="3" gear="-2"/>
<general name="g" joint="slide" gainprm="50" biastype="affine" biasprm="4 -50 -5" forcerange="-30 30"/>
<motor name="m" joint="third" gear="3" ctrlrange="-1 1" forcerange="-2 2"/>
<muscle name="lost" joint="hinge" lengthrange=".1 1"/><motor name="thrust" site="hook"/></actuator>"""


def test_actuators_are_servos(tmp_path: Path):
    """Order 2 with small steps against MuJoCo's Runge-Kutta, with control signals that are cut."""
    scene, m = both(tmp_path, text(rest=ACTUATORS, option=FREE_OF_CONTACT))
    found = {actuator.name: actuator for actuator in scene.parts[0].actuators}
    assert {name: actuator.kind for name, actuator in found.items()} == {
        "p": "position", "v": "velocity", "g": "position", "m": "motor",
    }  # fmt: skip
    assert found["m"].force(0.5) == 1.5
    assert found["m"].force(9.0) == 3.0  # ctrl is cut to 1
    assert names(scene, "ignored", "actuator") == {
        "lost": "has a state (muscle)", "thrust": "acts on a site, not on a joint or a body",
    }  # fmt: skip
    ctrl = {"p": 0.5, "v": 0.5, "g": 0.2, "m": 0.4}
    for name, actuator in found.items():
        if actuator.kind == "position":
            goal = actuator.target(ctrl[name])
            scene.set_servo(
                actuator.joint, actuator.kp, actuator.kd, actuator.effort, target=lambda t, x=goal: (x, 0.0)
            )
        elif actuator.kind == "velocity":
            rate = actuator.target(ctrl[name])
            scene.set_servo(actuator.joint, actuator.kp, actuator.kd, target=lambda t, x=rate: (x * t, x))
    qpos, qvel = oracle.random_state(m, 1)
    qvel *= 0.3
    torque = np.zeros(m.nv)
    torque[scene.v_index("third")] = found["m"].force(ctrl["m"])
    signals = [ctrl.get(mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_ACTUATOR, k), 0.0) for k in range(m.nactuator)]
    end = run(m, qpos, qvel, 0.2, 5e-5, signals)
    start, speed = oracle.to_q(m, qpos), oracle.to_v(m, qpos)[0] @ qvel
    errors = [
        off(m, end, cvi.simulate(scene, start, speed, 0.2, dt=dt, control=lambda t, q, v: torque).q[-1])
        for dt in (1e-3, 5e-4)
    ]
    assert errors[1] < 1e-5
    assert 3.0 < errors[0] / errors[1] < 5.0
    assert not both(tmp_path, text(rest=ACTUATORS), actuators=False)[0].servo_joints


# --- in a scene -------------------------------------------------------------------------------------------------------

HOME = '<keyframe><key name="home" qpos="{}" qvel="{}"/></keyframe>'


def test_actuators_by_name(tmp_path: Path):
    """Of a scene from a file, which gives no handle, and of copies with a prefix."""
    act = '<actuator><position name="up" joint="h" kp="60"/><motor name="push" joint="h" gear="2"/></actuator>'
    body = '<body name="b"><joint name="h" axis="0 1 0"/><geom size=".1"/></body>'
    (tmp_path / "a.xml").write_text(f"<mujoco><worldbody>{body}</worldbody>{act}</mujoco>")
    scene = cvi.Scene.from_mjcf(tmp_path / "a.xml")
    assert list(scene.actuators) == ["up", "push"]
    assert scene.actuators["push"].force(3.0) == 6.0
    assert scene.actuators["up"].target(0.2) == pytest.approx(0.2)
    scene.add_mjcf(tmp_path / "a.xml", prefix="two_", placement=(1, 0, 0))
    assert scene.actuators["two_push"].joint == "two_h"
    assert tuple(scene.actuators.values())[:2] == scene.parts[0].actuators


def test_two_copies_with_keyframes(tmp_path: Path):
    model = mujoco.MjModel.from_xml_string(text())
    qpos, qvel = oracle.random_state(model, 4)
    xml = text(rest=HOME.format(" ".join(map(repr, qpos.tolist())), " ".join(map(repr, qvel.tolist()))))
    (tmp_path / "m.xml").write_text(xml)
    scene = cvi.Scene()
    place = ((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    scene.add_mjcf(tmp_path / "m.xml", prefix="l_")
    scene.add_mjcf(tmp_path / "m.xml", prefix="r_", placement=place)
    assert "of the file: the scene has its own" in names(scene, "ignored", "option")["gravity"]
    poses = scene.named_configurations
    assert sorted(poses) == ["l_home", "r_home"]
    q, v = poses["r_home"]
    half, nv = model.nq, model.nv
    assert q[:half] == pytest.approx(scene.neutral()[:half])
    assert v[nv:] == pytest.approx(oracle.to_v(model, qpos)[0] @ qvel)
    # Everything of the second copy lies where the first one's would, moved.
    first, second = poses["l_home"][0], q
    data, moved = scene.model.createData(), pose("placement", place)
    places = []
    for state in (first, second):
        pin.framesForwardKinematics(scene.model, data, state)
        places.append([data.oMf[k].copy() for k in range(scene.model.nframes)])
    frames = [frame.name for frame in scene.model.frames]
    for k, name in enumerate(frames):
        if name.startswith("l_"):
            twin = frames.index("r_" + name[2:])
            assert (moved * places[0][k]).homogeneous == pytest.approx(places[1][twin].homogeneous, abs=1e-12)
    # The free joint's numbers are a pose in the world of the scene.
    own = scene.q_index("r_free")
    assert pin.XYZQUATToSE3(second[own]).homogeneous == pytest.approx(
        (moved * pin.XYZQUATToSE3(first[scene.q_index("l_free")])).homogeneous
    )
    with pytest.raises(cvi.InputError, match="Did you mean 'l_home'"):
        scene.configuration({}, "l_hom")


def test_a_scene_file_starts_from_a_keyframe(tmp_path: Path):
    world = '<body><joint name="j" axis="0 1 0"/><geom size=".1" pos="0 0 -1"/></body>'
    (tmp_path / "m.xml").write_text(text(world, HOME.format("0.5", "-2")))
    page = tmp_path / "s.toml"
    page.write_text('[[mjcf]]\npath = "m.xml"\nrestitution = "solref"\n[initial]\nconfiguration = "home"\n')
    scene = cvi.load_scene(page)
    assert (scene.q0, scene.v0) == (pytest.approx([0.5]), pytest.approx([-2.0]))
    page.write_text(page.read_text() + "springs_at_rest = true\n")
    with pytest.raises(cvi.InputError, match="configuration and springs_at_rest"):
        cvi.load_scene(page)


def test_the_start_is_moved_into_the_ranges(tmp_path: Path):
    world = '<body><joint name="j" axis="0 1 0" range=".2 1"/><geom size=".1" pos="0 0 -1"/></body>'
    scene, _ = both(tmp_path, text(world))
    assert scene.neutral() == pytest.approx([0.2])
    assert "outside of its range" in names(scene, "changed", "joint")["j"]


def test_what_is_lost_is_in_the_report_once_with_its_names(tmp_path: Path):
    world = "".join(
        f'<body pos="{k} 0 1"><joint name="b{k}" type="ball" range="0 1"/>'
        f'<geom name="g{k}" size=".1" margin=".01"/></body>'
        for k in range(3)
    )
    rest = '<sensor><jointpos joint="h"/></sensor><option density="1.2"/>'
    world += '<body pos="9 0 0"><joint name="h" frictionloss=".1"/><geom size=".1"/></body>'
    scene, _ = both(tmp_path, text(world, rest))
    page = str(scene.report)
    assert page.count("limit of a ball joint") == 1
    assert "joint b0, b1, b2" in page
    assert page.count("margin or gap") == 1
    assert "sensors: jointpos" in page
    assert names(scene, "ignored", "option")["density"] == "not simulated"
    assert scene.built().arrays.joint_friction.max() == 0.0
    assert both(tmp_path, text(world, rest), friction=True)[0].built().arrays.joint_friction.max() == pytest.approx(0.1)


def test_without_the_compiler_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    (tmp_path / "m.xml").write_text(text())
    with pytest.raises(cvi.SceneError, match=r"pip install 'contactvi\[mjcf\]'"):
        cvi.Scene().add_mjcf(tmp_path / "m.xml")


def test_warnings_of_the_compiler_are_in_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    """And neither printed nor written to a file in the working folder, as MuJoCo does."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.xml").write_text(text().replace('angle="radian"', 'angle="radian" settotalmass="5"'))
    scene = cvi.Scene.from_mjcf(tmp_path / "m.xml")
    assert [path.name for path in tmp_path.iterdir()] == ["m.xml"]
    assert capfd.readouterr() == ("", "")
    assert "settotalmass" in next(iter(scene.report.all_notes("suspicious", "file"))).text
    assert sum(body.mass for body in scene.report.parts[0].bodies) == pytest.approx(5.0)
    before = mujoco.get_mju_user_warning()
    assert before is None


def test_shapes_are_convex_and_planes_endless(tmp_path: Path):
    asset = '<asset><mesh name="t" vertex="0 0 0  1 0 0  0 1 0  0 0 1  .2 .2 .2"/></asset>'
    world = '<geom name="floor" type="plane" size="1 1 .1" pos="0 0 -5"/>'
    world += '<body><freejoint/><geom name="t" type="mesh" mesh="t"/></body>'
    scene, m = both(tmp_path, text(world, asset))
    shapes = {geometry.name: geometry.geometry for geometry in scene.collision_model.geometryObjects}
    assert isinstance(shapes["floor"], coal.Halfspace)
    assert isinstance(shapes["t"], coal.Convex)
    assert shapes["t"].num_points == 4
    assert shapes["t"].computeVolume() == pytest.approx(1 / 6, rel=1e-6)  # MuJoCo stores vertices in single precision
    assert oracle.differences(scene, m).largest() < 1e-6


ADHESION = """<mujoco model="pads"><worldbody><geom name="ceiling" type="box" size="1 1 .1" pos="0 0 1.1"/>
<body name="pad" pos="0 0 .9"><freejoint/><geom name="pad" type="box" size=".1 .1 .1" mass="2"/></body>
<body name="post" pos="3 0 0"><geom name="post" size=".1"/></body></worldbody>
<actuator><adhesion name="stick" body="pad" gain="50" ctrlrange="0 1"/>
<adhesion name="fixed" body="post" gain="50" ctrlrange="0 1"/></actuator></mujoco>"""


@pytest.mark.parametrize("mode", ["auto", "steps"])
def test_adhesion_actuators_hold_what_mujoco_holds(tmp_path: Path, mode: str):
    """A body hangs from its pad where the pull is more than its weight; MuJoCo's contacts begin with an overlap."""
    scene, m = both(tmp_path, ADHESION)
    (stick,) = scene.parts[0].actuators
    assert (stick.kind, stick.body, stick.joint) == ("adhesion", "pad", "")
    assert names(scene, "changed", "actuator") == {
        "stick": "pulls once scene.set_body_adhesion('pad', ...) gives its control; what lets go leaves its share"
    }
    assert "fixed" in names(scene, "ignored", "actuator")
    assert stick.force(0.5) == 25.0
    assert stick.force(7.0) == 50.0  # ctrl is cut to 1
    scene.set_contact(restitution=0.0)
    for ctrl, holds in ((0.38, False), (0.39, False), (0.4, True), (0.8, True)):
        d = mujoco.MjData(m)
        d.qpos[2], d.ctrl[0] = 0.9 + 1e-4, ctrl
        for _ in range(200):
            mujoco.mj_step(m, d)
        scene.set_body_adhesion(stick.body, lambda t, ctrl=ctrl: stick.force(ctrl))
        run_ = cvi.simulate(scene, [0, 0, 0.9, 0, 0, 0, 1], np.zeros(6), 0.4, dt=0.01, contact_mode=mode)
        assert (d.qpos[2] > 0.89) == (run_.q[-1][2] > 0.89) == holds


def test_the_control_of_adhesion_may_change_between_steps(tmp_path: Path):
    """The force that is needed to pull a body off is found by a program that turns the control down."""
    scene, _ = both(tmp_path, ADHESION)
    scene.set_contact(restitution=0.0)
    (stick,), ctrl = scene.parts[0].actuators, np.array([1.0])
    scene.set_body_adhesion(stick.body, lambda t: stick.force(float(ctrl[0])))
    simulator = cvi.Simulator(scene, dt=0.01)
    simulator.reset([0, 0, 0.9, 0, 0, 0, 1], np.zeros(6))
    while simulator.q[2] > 0.9 - 1e-8:
        ctrl[0] -= 0.01
        simulator.step()
    assert 50.0 * (ctrl[0] + 0.01) == pytest.approx(2.0 * 9.81, abs=0.51)
