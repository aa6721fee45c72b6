"""Parameters of every run in copies of the engine's scene, against scenes that are built with them, to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.batch import scenes
from helpers.rollout_scenes import at_wall, servo_arm, thrown_box

RUNS = 4
SPREAD = 1.0 + 0.1 * np.arange(RUNS)[:, None]
BODY = np.array([1.5, 0.02, 0.01, 0.3, 0.5, 0.01, 0.02, 0.6, -0.01, 0.4])  # mass, first moment, inertia


def sprung_chain() -> cvi.Scene:
    """A circle, a turned slider with limits, and a spherical joint, with springs and damping; it hits a limit."""
    model, where = pin.Model(), 0
    kinds = {"circle": pin.JointModelRUBY(), "slider": pin.JointModelPrismaticUnaligned(0.6, 0.0, 0.8),
             "ball": pin.JointModelSpherical()}  # fmt: skip
    for name, kind in kinds.items():
        where = model.addJoint(
            where, kind, pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), np.array([0.0, 0.1, -0.4])), name
        )
        model.appendBodyToJoint(where, pin.Inertia(1.1, np.array([0.1, 0.02, -0.2]), np.diag([0.2, 0.3, 0.25])),
                                pin.SE3.Identity())  # fmt: skip
    slot = model.joints[2].idx_q
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    model.lowerPositionLimit[slot], model.upperPositionLimit[slot] = -0.1, 0.05
    scene = cvi.Scene.from_pinocchio(model, pin.GeometryModel())
    scene.set_joint("slider", stiffness=30.0, rest=0.01, spring=[0.0, 0.0, 40.0], restitution=0.5, limits=True)
    scene.set_joint("circle", stiffness=2.0, damping=0.1)
    scene.set_joint("ball", stiffness=3.0)
    return scene


CASES = [
    (at_wall, {"restitution": 0.6 * SPREAD}), (at_wall, {"mass:joint_2": SPREAD, "gravity": [0.0, 1.0, -9.0] * SPREAD}),
    (at_wall, {"inertia:joint_2": BODY * SPREAD}), (at_wall, {"stiffness:joint_1": SPREAD, "rest:joint_1": SPREAD}),
    (at_wall, {"damping:joint_2": SPREAD - 1.0, "armature:joint_1": SPREAD - 1.0}),
    (servo_arm, {"kp:joint_1": 20.0 * SPREAD, "kd:joint_1": SPREAD, "kd:joint_2": 2.0 * SPREAD}),
    (thrown_box, {"friction:box|ground": 0.2 * SPREAD, "inertia:box": BODY * SPREAD}),
    (thrown_box, {"friction": 0.2 * SPREAD, "restitution": 0.5 * SPREAD, "damping:box": SPREAD * np.full(6, 0.1)}),
    (sprung_chain, {"rest:circle": SPREAD, "rest:slider": 0.01 * SPREAD, "stiffness:ball": SPREAD}),
    (sprung_chain, {"restitution:slider": 0.6 * SPREAD, "inertia:slider": BODY * SPREAD, "mass:circle": SPREAD}),
]  # fmt: skip


def _built_in_vain(*_: Any) -> Any:
    raise AssertionError("a scene was built")


@pytest.mark.parametrize(("make", "values"), CASES)
def test_a_copy_is_a_scene_that_is_built(make, values, monkeypatch):
    found = make()
    scene, q, v = found if isinstance(found, tuple) else (found, found.neutral(), 0.5 * np.arange(1.0, found.nv + 1.0))
    settings: dict[str, Any] = {"dt": 0.005, "duration": 0.7}
    built = [scene.with_parameters({name: rows[k] for name, rows in values.items()}) for k in range(RUNS)]
    single = [cvi.simulate(own, q, v, **settings) for own in built]
    with monkeypatch.context() as patch:  # no scene is built for a run that is kept without its records
        patch.setattr(scenes.SceneCache, "of", _built_in_vain)
        result = cvi.simulate_batch(scene, q, v, parameters=values, keep="nodes", workers=2, **settings)
    assert result.ok.all()
    for k, run in enumerate(single):
        assert result.impacts[k] == len(run.events)
        for name in ("t", "q", "v"):
            assert getattr(result, name)[k].tobytes() == getattr(run, name).tobytes(), (k, name)
    assert len({rows.tobytes() for rows in result.q}) == RUNS  # the parameters matter


def test_values_that_a_copy_cannot_have():
    """A servo that is taken away is another scene; so is one without answer, and each run has the error of its own."""
    scene, q, v = servo_arm()
    values = {
        "kp:joint_1": np.array([20.0, 0.0, -1.0, np.nan])[:, None],
        "kd:joint_1": np.array([2.0, 0, 1, 1])[:, None],
    }
    result = cvi.simulate_batch(scene, q, v, parameters=values, dt=0.01, duration=0.3, keep="nodes")
    assert result.ok.tolist() == [True, True, False, False]
    for k in range(2):
        own = scene.with_parameters({name: rows[k] for name, rows in values.items()})
        assert result.q[k].tobytes() == cvi.simulate(own, q, v, dt=0.01, duration=0.3).q.tobytes()


def test_a_mass_matrix_that_is_singular():
    """The outer of two bodies on one axis moves with the inner one, which has no inertia of its own."""
    model = pin.Model()
    for name in ("inner", "outer"):
        where = model.addJoint(model.njoints - 1, pin.JointModelRZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(where, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model, pin.GeometryModel())
    numbers = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0]) * np.array([1.0, 1e-18])[:, None]
    settings: dict[str, Any] = {"dt": 0.01, "duration": 0.1}
    result = cvi.simulate_batch(scene, parameters={"inertia:inner": numbers}, **settings)
    assert result.ok.tolist() == [True, False]
    with pytest.raises(cvi.SceneError, match="singular") as single:
        cvi.simulate(scene.with_parameters({"inertia:inner": numbers[1]}), **settings)
    assert str(result.errors[1]) == str(single.value)


def test_dtec_that_loses_energy_in_some_runs():
    """Whether bouncing stalls is asked in every run where a restitution is given."""
    scene, q, v = at_wall()
    lossless = scene.with_parameters({"restitution": 1.0})
    values = {"restitution": np.array([1.0, 0.7])[:, None]}
    settings: dict[str, Any] = {"dt": 0.01, "duration": 0.9, "impact": "dtec"}
    result = cvi.simulate_batch(lossless, q, v, parameters=values, keep="nodes", **settings)
    for k in range(2):
        own = lossless.with_parameters({"restitution": values["restitution"][k]})
        assert result.q[k].tobytes() == cvi.simulate(own, q, v, **settings).q.tobytes()
