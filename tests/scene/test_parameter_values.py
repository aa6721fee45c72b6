"""Parameters of a scene by the names of derivatives: read, set, and with the derivatives that runs give for them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.errors import InputError
from derivatives.differences import FOURTH
from helpers.sprung_arm import SPRUNG_ARM, sprung_arm

RUN = {"duration": 0.5, "dt": 1e-2, "order": 4, "solver_tol": 1e-14}
ARM = [
    "gravity", "mass:turn", "mass:slide", "inertia:turn", "armature:turn", "stiffness:turn", "damping:turn",
    "rest:turn", "kp:slide", "kd:slide", "restitution", "friction", "restitution:tip|ground", "friction:ground | tip",
]  # fmt: skip


def arm() -> cvi.Scene:
    """An arm whose tip bounces off the ground and slips on it, with a rotor in a hinge."""
    scene = sprung_arm(0.6, 0.1)(np.array(SPRUNG_ARM))
    scene.set_joint("turn", rotor_inertia=1e-3, gear_ratio=2.0)
    scene.q0, scene.v0 = np.array([0.5, 0.5]), np.array([-1.0, 1.0])
    return scene


def between_limits() -> cvi.Scene:
    """A continuous joint with a spring that turns a plate, on a slider that is thrown against both of its limits."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    turn = model.addJoint(slide, pin.JointModelRUBZ(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(slide, pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    model.appendBodyToJoint(turn, pin.Inertia(0.5, np.array([0.2, 0.1, 0.0]), 0.02 * np.eye(3)), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("slide", limits=(-0.2, 0.2), restitution=0.7)
    scene.set_joint("turn", stiffness=2.0, rest=2.9)
    scene.q0, scene.v0 = scene.configuration({"turn": 2.0}), np.array([2.0, 0.3])
    return scene


def sprung_bodies() -> cvi.Scene:
    """A spherical joint with a spring and dampers on a translation joint."""
    model = pin.Model()
    move = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "move")
    turn = model.addJoint(move, pin.JointModelSpherical(), pin.SE3.Identity(), "turn")
    body = pin.Inertia(1.0, np.array([0.1, 0.0, 0.05]), np.diag([0.02, 0.03, 0.025]))
    model.appendBodyToJoint(turn, body, pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model)
    scene.set_joint("move", stiffness=30.0, rest=(0.1, 0.0, 0.2), damping=0.3, armature=0.1)
    scene.set_joint("turn", stiffness=2.0, damping=0.05, armature=0.01)
    scene.v0 = np.array([0.2, -0.1, 0.3, 0.5, 0.2, -0.4])
    return scene


SCENES = {"arm": arm, "limits": between_limits, "bodies": sprung_bodies}
OTHERS = {
    "limits": ["restitution:slide", "restitution", "rest:turn", "stiffness:turn", "mass:turn"],
    "bodies": [
        "rest:move", "damping:move", "damping:turn", "armature:move", "armature:turn", "inertia:turn", "stiffness:turn",
    ],
}  # fmt: skip
CASES = [("arm", name) for name in ARM] + [(scene, name) for scene, names in OTHERS.items() for name in names]


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_derivatives_are_those_of_the_value(kind, name):
    """Fourth-order differences of runs with the value set, against the sensitivity of its name."""
    scene = SCENES[kind]()
    exact = cvi.simulate(scene, record="gradient", **RUN).sensitivity(name).of(name)[-1]
    present = scene.parameter(name)
    assert exact.shape[1] == len(present)
    base = cvi.simulate(scene, **RUN)
    if kind != "bodies":
        assert len(base.events)
    step = 1e-3 * max(0.1, float(np.abs(present).min()))
    for k, unit in enumerate(np.eye(len(present))):
        numbers = np.zeros(2 * scene.nv)
        for count, weight in FOURTH:
            run = cvi.simulate(scene.with_parameters({name: present + count * step * unit}), **RUN)
            assert len(run.events) == len(base.events)
            end = np.concatenate([pin.difference(scene.model, base.q[-1], run.q[-1]), run.v[-1]])
            numbers += weight / step * end
        assert np.abs(exact[:, k] - numbers).max() <= 1e-7 * max(1.0, np.abs(numbers).max()), k


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_round_trip(kind, name):
    """What is set is read again, in a stored scene too, and what is read sets the same motion."""
    scene = SCENES[kind]()
    present = scene.parameter(name)
    value = present * 1.05 + (0.01 if name.startswith("rest:") else 0.0)
    changed = scene.with_parameters({name: value})
    assert changed.parameter(name) == pytest.approx(value, rel=1e-14, abs=1e-15)
    assert cvi.Scene.from_dict(changed.to_dict()).parameter(name) == pytest.approx(value, rel=1e-14, abs=1e-15)
    same = scene.with_parameters({name: present})
    one, two = cvi.simulate(scene, **RUN), cvi.simulate(same, **RUN)
    assert np.abs(one.q - two.q).max() <= 1e-12


@pytest.mark.parametrize(("kind", "name"), CASES)
def test_the_scene_stays_as_it_is(kind, name):
    """Bit for bit, and what is changed later in one of the two does not reach the other."""
    scene = SCENES[kind]()
    before, run = scene.to_dict(), cvi.simulate(scene, **RUN)
    changed = scene.with_parameters({name: scene.parameter(name) * 1.05 + 0.001})
    assert changed.to_dict() != before
    changed.set_joint("*", damping=3.0)
    assert scene.to_dict() == before
    assert np.array_equal(cvi.simulate(scene, **RUN).q, run.q)


def test_many_at_once():
    scene = arm()
    values = {"mass:turn": 1.5, "gravity": (0.0, 1.0, -3.0), "restitution:tip|ground": 0.2, "kp:slide": 7.0}
    values["kd:slide"] = 1
    changed = scene.with_parameters(values)
    for name, value in values.items():
        assert np.array_equal(changed.parameter(name), np.atleast_1d(value)), name
    assert np.array_equal(changed.gravity, [0.0, 1.0, -3.0])
    assert scene.with_parameters({}).to_dict() == scene.to_dict()


def test_a_mass_moves_nothing_else():
    """The centre of mass and the rotational inertia about it are those of before; later parts are added to it."""
    scene = arm()
    before = scene.model.inertias[2]
    changed = scene.with_parameters({"mass:turn": 2.0})
    changed.add_sphere("later", 0.1, placement=(5.0, 0.0, 1.0))
    after = changed.model.inertias[2]
    assert np.array_equal(after.lever, before.lever)
    assert np.array_equal(after.inertia, before.inertia)
    assert after.mass == 2.0
    assert sum(row.mass for part in changed.report.parts for row in part.bodies if row.joint == "turn") == 2.0


def test_restitution_of_all_counts_those_that_have_some():
    scene = arm()
    scene.add_sphere("ball", 0.1, placement=(3.0, 0.0, 1.0))
    scene.set_contact("ball", restitution=0.0)
    changed = scene.with_parameters({"restitution": 0.8})
    values = dict(zip(changed.pair_names, changed.pair_restitution, strict=True))
    assert sorted(values.values()) == [0.0, 0.0, 0.8]
    assert changed.parameter("restitution") == 0.8


@pytest.mark.parametrize("kind", ["restitution", "friction"])
@pytest.mark.parametrize("present", [0.0, 0.4])
def test_of_all_contacts_to_zero_and_from_it(kind, present):
    """In a single scene, and in runs of a batch, which have the bits of runs of single scenes."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 0.4))
    scene.add_halfspace((0.2, 0.0, 1.0))
    scene.set_contact(**{"restitution": 0.3, "friction": 0.2, kind: present})
    values, run = [0.0, 0.25, 0.5], {"dt": 1e-2, "duration": 0.5}
    assert scene.parameter(kind) == present
    batch = cvi.simulate_batch(scene, parameters={kind: np.array(values)[:, None]}, **run)
    for k, value in enumerate(values):
        changed = scene.with_parameters({kind: value})
        assert changed.parameter(kind) == value
        assert getattr(changed, f"pair_{kind}").tolist() == [value]
        np.testing.assert_array_equal(batch.q[k], cvi.simulate(changed, **run).q)
    assert not np.array_equal(batch.q[0], batch.q[2])


def two_values() -> cvi.Scene:
    scene = arm()
    scene.add_sphere("ball", 0.1, placement=(3.0, 0.0, 1.0))
    scene.set_contact("ball", restitution=0.9)
    return scene


REFUSED = {
    "unknown": (arm, {"weight:turn": 1.0}, "weight", "Nothing of the scene"),
    "unknown joint": (arm, {"mass:trun": 1.0}, "Did you mean 'turn'", "No joint"),
    "no text": (arm, {3: 1.0}, "mass:ball", "Nothing of the scene"),
    "no colon": (arm, {"mass": 1.0}, "mass:joint", "Nothing of the scene"),
    "unknown pair": (arm, {"friction:tip|grond": 1.0}, "tip|ground", "No contact of the scene"),
    "no contacts": (sprung_bodies, {"restitution": 0.5}, "Add what it may touch", "The scene has no contacts"),
    "two values": (two_values, {"restitution": 0.5}, "Name a pair", "no one value"),
    "one limit": (between_limits, {"restitution:slide|lower limit": 0.5}, "'restitution:slide'", "no restitution"),
    "massless": (arm, {"mass:turn": 0.0}, "above 0", "mass:turn"),
    "bouncing up": (arm, {"restitution:tip|ground": 1.2}, "[0, 1]", "restitution:tip|ground"),
    "less than none": (arm, {"friction": -0.1}, ">= 0", "friction"),
    "negative": (arm, {"damping:turn": -1.0}, ">= 0", "damping:turn"),
    "not definite": (arm, {"inertia:turn": [1, 0.5, 0, 0, 0.1, 0, 0, 0.1, 0, 0.1]}, "eigenvalue", "that of no body"),
    "shape": (arm, {"gravity": 9.81}, "(3,)", "gravity"),
    "nan": (arm, {"mass:turn": float("nan")}, "finite", "mass:turn"),
    "servo": (arm, {"kp:turn": 3.0}, "set_servo", "There is no kp"),
    "spherical rest": (sprung_bodies, {"rest:turn": [0, 0, 0]}, "set_joint", "There is no rest"),
    "free spring": (two_values, {"stiffness:ball": 3.0}, "Take this name out", "There is no stiffness"),
    "free armature": (two_values, {"armature:ball": np.ones(6)}, "Take this name out", "There is no armature"),
    "twice": (arm, {"mass:turn": 1.0, "inertia:turn": np.ones(10)}, "Leave one", "set one number"),
    "pair twice": (arm, {"restitution:tip|ground": 0.3, "restitution": 0.3}, "Leave one", "set one number"),
    "no mapping": (arm, ["mass:turn"], "Give a dict", "values"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    make, values, text, what = REFUSED[case]
    scene = make()
    before = scene.to_dict()
    with pytest.raises(InputError) as caught:
        scene.with_parameters(values)
    assert what in caught.value.what
    assert text in str(caught.value)
    assert scene.to_dict() == before
