"""Batches of order 2, whose runs share the lanes of the kernel, against single runs to the bit."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from batch.test_simulate_batch import assert_same
from helpers.rollout_scenes import MODELS, at_wall, thrown_box
from helpers.run_scenes import HAND_URDF

RUNS = 9


@pytest.fixture(params=["base", "avx2", "avx512"], autouse=True)
def instruction_set(request):
    from contactvi import _core

    before = _core.instruction_set()
    if request.param not in _core.instruction_sets():
        pytest.skip(f"this machine has {_core.instruction_sets()} only")
    _core.instruction_set(request.param)
    yield
    _core.instruction_set(before)


def chain() -> cvi.Scene:
    model, parent = pin.Model(), 0
    for k in range(10):
        at = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1 if k else 0.0]))
        parent = model.addJoint(parent, pin.JointModelRY(), at, f"joint_{k}")
        inertia = pin.Inertia(0.1, np.array([0.0, 0.0, -0.05]), 1e-4 * np.eye(3))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return cvi.Scene.from_pinocchio(model)


def hand() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF, base="fixed", mimic=False)
    return scene


def hand_with_servos() -> cvi.Scene:
    """Some of them reach the limit of their effort."""
    scene = hand()
    scene.set_servo("joint_*", kp=2.0, kd=0.05, effort=0.1)
    return scene


def pendulum() -> cvi.Scene:
    return at_wall()[0]


def bodies() -> cvi.Scene:
    """Free bodies that may meet: islands, quaternions, a spring between two bodies."""
    scene = cvi.Scene()
    for k in range(3):
        scene.add_box(f"box_{k}", (0.1, 0.2, 0.15), mass=1.0 + k)
    scene.add_spring("box_0", "box_1", stiffness=30.0, damping=0.5, rest_length=0.5)
    scene.add_halfspace()
    return scene


def hand_and_ball() -> cvi.Scene:
    return cvi.load_scene(MODELS / "allegro_ball.toml")


CASES: list[tuple[Callable[[], cvi.Scene], float, float, float]] = [  # scene, duration [s], dt [s], size of velocities
    (chain, 0.3, 5e-3, 1.0),
    (hand, 0.15, 1e-3, 1.0),
    (hand_with_servos, 0.1, 1e-3, 0.5),
    (pendulum, 1.0, 5e-3, 1.5),
    (hand_and_ball, 0.25, 1e-3, 0.05),
]


def rows(scene: cvi.Scene, steps: int, servos: bool) -> dict[str, Any]:
    """Controls of every run, and targets where the scene has servos."""
    random = np.random.default_rng(1)
    found = {"control": 0.02 * random.standard_normal((RUNS, steps, scene.nv))}
    if servos:
        found["target"] = 0.3 * random.standard_normal((RUNS, steps, scene.nv))
    return found


@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize(("make", "duration", "dt", "size"), CASES, ids=lambda x: getattr(x, "__name__", ""))
def test_runs_have_the_bits_of_simulate(make, duration, dt, size, forced):
    scene = make()
    q = scene.neutral() if scene.q0 is None else scene.q0
    vs = size * np.random.default_rng(0).standard_normal((RUNS, scene.nv))
    inputs = rows(scene, round(duration / dt), make is hand_with_servos) if forced else {}
    settings = {"dt": dt, "duration": duration, "order": 2}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        result = cvi.simulate_batch(scene, q, vs, keep="runs", workers=1 + forced, **inputs, **settings)
        for k in range(RUNS):
            own = {name: values[k] for name, values in inputs.items()}
            assert_same(result[k], cvi.simulate(scene, q, vs[k], throw=False, **own, **settings))


SETTINGS = {
    "damping": {"damping": 0.02},
    "spring": {"stiffness": 3.0, "damping": 0.01},
    "nonlinear spring": {"spring": [1.0, 0.0, 0.5]},
    "friction": {"friction": 0.05},
    "limits": {"limits": (-0.6, 0.6), "restitution": 0.5},
    "limits and damping": {"limits": (-0.6, 0.6), "restitution": 0.0, "damping": 0.02},
}


@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("name", SETTINGS)
def test_what_acts_in_the_joints_of_a_short_tree(name, forced):
    """Of a double pendulum with a wall, whose flights are interrupted by impacts at other times in each run."""
    scene, q, v = at_wall()
    for joint in list(scene.model.names)[1:]:
        scene.set_joint(str(joint), **SETTINGS[name])
    vs = v + 1.5 * np.random.default_rng(0).standard_normal((RUNS, scene.nv))
    settings = {"dt": 2e-3, "duration": 0.5, "order": 2}
    inputs = rows(scene, 250, False) if forced else {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        result = cvi.simulate_batch(scene, q, vs, keep="runs", workers=1, **inputs, **settings)
        if "limits" in name:
            assert result.impacts.any()
        for k in range(RUNS):
            own = {key: values[k] for key, values in inputs.items()}
            assert_same(result[k], cvi.simulate(scene, q, vs[k], throw=False, **own, **settings))


def falling() -> cvi.Scene:
    """Islands that fly: bodies high above the ground, of which two meet, and a damped pendulum beside them."""
    model, geometry = pin.Model(), pin.GeometryModel()
    pivot, bob = (pin.SE3(np.eye(3), np.array(at)) for at in ([0.0, 2.0, 1.0], [0.0, 0.0, -0.2]))
    model.addJoint(0, pin.JointModelRY(), pivot, "swing")
    model.appendBodyToJoint(1, pin.Inertia(0.1, bob.translation, 1e-3 * np.eye(3)), pin.SE3.Identity())
    geometry.addGeometryObject(pin.GeometryObject("bob", 1, bob, coal.Sphere(0.05)))
    scene = cvi.Scene.from_pinocchio(model, geometry)
    for k in range(3):
        scene.add_box(f"box_{k}", (0.1, 0.2, 0.15), mass=1.0 + k, placement=(0.5 * k, 0.0, 1.0))
    scene.add_sphere("ball", 0.1, mass=1.0, placement=(1.5, 0.0, 0.5))
    scene.set_joint("swing", damping=0.05)
    scene.add_halfspace()
    return scene


@pytest.mark.parametrize("record_every", [1, 5])
def test_islands_that_fly(record_every):
    scene = falling()
    v = np.zeros(scene.nv)
    v[1:4], v[7:10] = (0.6, 0.0, 0.0), (-0.6, 0.0, 0.0)  # the first two boxes meet
    vs = v + 0.1 * np.random.default_rng(0).standard_normal((RUNS, scene.nv))
    settings = {"dt": 1e-3, "duration": 0.4, "order": 2, "record_every": record_every}
    result = cvi.simulate_batch(scene, v0s=vs, keep="runs", workers=1, **settings)
    assert result.impacts.any()
    for k in range(RUNS):
        single = cvi.simulate(scene, v0=vs[k], **settings)
        assert_same(result[k], single)
        for kind in ("input", "damping"):
            assert getattr(result[k].work, kind).tobytes() == getattr(single.work, kind).tobytes()
        assert single.work.damping[-1] > 0.0
    ends = cvi.simulate_batch(scene, v0s=vs, keep="ends", workers=1, **settings)
    assert ends.q.tobytes() == np.ascontiguousarray(result.q[:, -1:]).tobytes()


def test_free_bodies_with_a_spring():
    scene = bodies()
    turns = [pin.exp3_quat(np.array([0.3, -0.5 * k, 0.8])) for k in range(3)]
    q = np.concatenate([np.r_[0.4 * k, 0.0, 0.5, turn] for k, turn in enumerate(turns)])
    vs = np.random.default_rng(0).standard_normal((RUNS, scene.nv))
    settings = {"dt": 2e-3, "duration": 0.5, "order": 2}
    result = cvi.simulate_batch(scene, q, vs, keep="runs", **settings)
    assert result.impacts.any()
    for k in range(RUNS):
        assert_same(result[k], cvi.simulate(scene, q, vs[k], **settings))


def test_runs_with_parameters_of_their_own():
    """Other masses make other trees, other frictions do not."""
    scene, q, v = thrown_box()
    mass, friction = 1.0 + 0.1 * (np.arange(RUNS) % 3)[:, None], 0.1 + 0.02 * np.arange(RUNS)[:, None]
    settings = {"dt": 5e-3, "duration": 0.5, "order": 2}
    values = {"mass:box": mass, "friction": friction}
    result = cvi.simulate_batch(scene, q, v, parameters=values, keep="runs", **settings)
    for k in range(RUNS):
        own = scene.with_parameters({"mass:box": mass[k], "friction": friction[k]})
        assert_same(result[k], cvi.simulate(own, q, v, **settings))


def test_lanes_outlast_the_scenes_of_their_first_runs():
    """Each run has a scene of its own, which ends with it; those of one mass share lanes."""
    scene = cvi.Scene()
    scene.add_box("box", (0.1, 0.2, 0.3), mass=1.0)
    vs = np.random.default_rng(0).standard_normal((4 * RUNS, scene.nv))
    mass = 1.0 + 0.5 * (np.arange(4 * RUNS) % 2)[:, None]
    settings = {"dt": 2e-3, "duration": 0.3, "order": 2}
    result = cvi.simulate_batch(scene, None, vs, parameters={"mass:box": mass}, keep="runs", workers=1, **settings)
    for k in range(4 * RUNS):
        own = scene.with_parameters({"mass:box": mass[k]})
        assert_same(result[k], cvi.simulate(own, own.neutral(), vs[k], **settings))


@pytest.mark.parametrize("impact", ["dtec", "mhc"])
def test_implicit_impact_maps(impact):
    scene, q, v = at_wall()
    vs = v * (1.0 + 0.05 * np.arange(RUNS)[:, None])
    settings = {"dt": 0.01, "duration": 1.0, "order": 2, "impact": impact}
    result = cvi.simulate_batch(scene, q, vs, keep="runs", **settings)
    assert result.impacts.any()
    for k in range(RUNS):
        assert_same(result[k], cvi.simulate(scene, q, vs[k], throw=False, **settings))
