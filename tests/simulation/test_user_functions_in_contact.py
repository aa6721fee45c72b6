"""Functions of the user in runs with contacts, joint friction and constraints: what they are called with, and where."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

Build = tuple[cvi.Scene, np.ndarray, np.ndarray]


def lying_ball() -> Build:
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 0.11))
    scene.set_contact(restitution=0.0, friction=0.3)
    return scene, scene.neutral(), np.array([0.5, 0.0, 0.0, 0.0, 0.0, 2.0])


def tied_ball() -> Build:
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1, placement=(0.3, 0.0, 0.4))
    scene.add_distance("world", "ball")
    return scene, scene.neutral(), np.zeros(scene.nv)


BUILDS = {"contact": lying_ball, "constraint": tied_ball}


@pytest.mark.parametrize(("dt", "order"), [(5e-3, 2), (5e-3, 4), (1e-2, 8), ("auto", 16)])
@pytest.mark.parametrize("kind", BUILDS)
def test_forces_without_derivatives_act_as_with_them(kind, dt, order):
    ends = []
    for given in (False, True):
        scene, q, v = BUILDS[kind]()
        drag = -0.05 * np.eye(scene.nv)
        known = (lambda t, q, v, D=drag: (np.zeros_like(D), D)) if given else None
        scene.add_force(lambda t, q, v, D=drag: D @ v, derivatives=known)
        run = cvi.simulate(scene, q, v, duration=0.3, dt=dt, order=order)
        ends.append(np.concatenate([pin.difference(scene.model, q, run.q[-1]), run.v[-1]]))
    assert np.abs(ends[1]).max() > 0.01
    assert np.allclose(*ends, rtol=0.0, atol=1e-9 if dt != "auto" else 1e-6)


@pytest.mark.parametrize(("dt", "order"), [(5e-3, 4), ("auto", 16)])
def test_potentials_without_a_hessian_act_as_with_one(dt, order):
    ends = []
    for given in (False, True):
        scene, q, v = lying_ball()
        weight = 2.0

        def gradient(q: np.ndarray, weight: float = weight) -> np.ndarray:
            return np.concatenate([weight * pin.XYZQUATToSE3(q).rotation.T @ [1.0, 0.0, 0.0], np.zeros(3)])

        def hessian(q: np.ndarray, weight: float = weight) -> np.ndarray:
            force = weight * pin.XYZQUATToSE3(q).rotation.T @ [1.0, 0.0, 0.0]
            H = np.zeros((6, 6))
            H[:3, 3:] = pin.skew(force)
            return H

        scene.add_potential(
            lambda q, weight=weight: weight * q[0], gradient, hessian=hessian if given else None, check=False
        )
        run = cvi.simulate(scene, q, v, duration=0.3, dt=dt, order=order)
        ends.append(np.concatenate([pin.difference(scene.model, q, run.q[-1]), run.v[-1]]))
    assert np.allclose(*ends, rtol=0.0, atol=1e-9 if dt != "auto" else 1e-6)


def test_a_law_of_friction_is_asked_for_finite_speeds_alone():
    asked = []

    def friction(speed: float) -> float:
        asked.append(speed)
        return 0.25 + 0.25 * math.exp(-abs(speed) / 0.15)

    scene = cvi.Scene()
    scene.add_halfspace(name="belt")
    scene.add_box("block", (0.2, 0.2, 0.1), mass=1.0, placement=(0, 0, 0.05))
    scene.set_contact("belt", "block", friction=friction, static_friction=0.5, restitution=0.0)
    scene.set_surface_velocity("belt", (0.1, 0, 0))
    scene.add_spring("world", "block", 50.0, rest_length=1.0, point_a=(-1, 0, 0.05))
    run = cvi.simulate(scene, duration=3.0)
    assert run.status.ok
    assert len(asked) > 100
    assert np.isfinite(asked).all()
