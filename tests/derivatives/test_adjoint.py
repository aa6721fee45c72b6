"""The transposed derivative of a step against the derivative's matrices, and its parameters against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from batteries import models
from contactvi import _core
from helpers.chains import JOINTS, chain, state_of, with_elements
from helpers.engine import core_scene

PARTS = ("q", "x", "tau", "h")
STATES = {"velocity": False, "momentum": True}


def motion(core: Any, q: np.ndarray, v: np.ndarray, momentum: bool) -> np.ndarray:
    return np.asarray(core.momentum(q[None], v[None]))[0] if momentum else v


def pulled(
    core: Any, x: tuple[np.ndarray, np.ndarray], momentum: bool, h: float, seed: int = 0, **inputs: Any
) -> tuple:
    """(gradients by the transpose, the same by the matrices, parameters) for a random gradient at the end."""
    n = core.nv
    at_end = np.random.default_rng(seed).uniform(-1, 1, 2 * n)
    _, _, A, B, by_h = _core.linear_step(core, *x, momentum, h, **inputs)
    lq, lx, ltau, lh, parameters = _core.adjoint_step(core, *x, momentum, h, at_end[:n], at_end[n:], **inputs)
    expected = at_end @ np.column_stack([A, B, by_h])
    return (
        dict(zip(PARTS, (lq, lx, ltau, np.array([lh])), strict=True)),
        np.split(expected, [n, 2 * n, 3 * n]),
        parameters,
    )


def assert_transposed(core, q, v, momentum, h, allowed=1e-11, **inputs) -> dict:
    found, expected, parameters = pulled(core, (q, motion(core, q, v, momentum)), momentum, h, **inputs)
    for (part, values), wanted in zip(found.items(), expected, strict=True):
        assert np.abs(values - wanted).max() <= allowed * np.abs(wanted).max(), part
    return parameters


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("joints", JOINTS)
def test_every_joint(joints, order, state):
    scene, rng = chain(JOINTS[joints])
    q, v, tau = state_of(scene, rng)
    assert_transposed(scene.core(), q, v, STATES[state], 0.05, tau=tau, order=order)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("name", ["tree", "forest", "pair", "arm_spherical", "free_body"])
def test_trees(name, order, state):
    case = models.case(name)
    model = case.model()
    tau = np.random.default_rng(1).uniform(-1, 1, model.nv)
    assert_transposed(core_scene(model), *case.state(model), STATES[state], 1e-2, tau=tau, order=order)


@pytest.mark.parametrize("order", [2, 16])
@pytest.mark.parametrize("name", ["allegro", "talos"])
def test_robots(name, order):
    case = models.case(name)
    model = case.model()
    assert_transposed(core_scene(model), *case.state(model), False, 1e-3, order=order)


def with_every_element(joints: str) -> tuple[cvi.Scene, np.random.Generator]:
    """With tapes, ropes, functions of the user with derivatives that are not symmetric, and a potential as well."""
    scene, rng = with_elements(joints)
    n, last = scene.nv, f"b{len(JOINTS[joints]) - 1}"
    points = [("world", (0.5, 0.5, 0.0)), ("b0", (0.1, 0.0, 0.0)), (last, (0.0, 0.1, 0.2))]
    scene.add_tape_spring(points, 30.0, rest_length=0.1, damping=0.8)
    scene.add_spring("b0", "world", 25.0, rest_length=0.05, tension_only=True, damping=0.5, point_b=(0.4, -0.9, 0.0))
    scene.add_wrench(last, force=lambda t: (np.sin(3 * t), 1.0, -0.5), torque=lambda t: (0.1, t, 0.2), axes="body")
    D = rng.uniform(-2, 2, (n, n))
    scene.add_force(lambda t, q, v: D @ np.sin(v), lambda t, q, v: (np.zeros((n, n)), D * np.cos(v)))
    if scene.model.nq == n:
        K = rng.uniform(-2, 2, (n, n))
        K = K @ K.T
        scene.add_potential(lambda q: 0.5 * q @ K @ q, lambda q: K @ q, lambda q: K)
    if scene.model.nqs[1] == 1:
        scene.set_joint("j0", spring=(2.0, 1.0, 0.5))
    return scene, rng


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("joints", JOINTS)
def test_every_force(joints, order, state):
    scene, rng = with_every_element(joints)
    q, v, tau = state_of(scene, rng)
    assert_transposed(scene.core(), q, v, STATES[state], 0.02, tau=tau, order=order, t=0.3)


@pytest.mark.parametrize("gains", [(400.0, 30.0), (1e5, 1e3)])
@pytest.mark.parametrize("order", [2, 4, 16])
def test_servos(order, gains):
    scene, rng = chain(JOINTS["revolute"], 2)
    scene.set_servo("*", kp=gains[0], kd=gains[1])
    scene.set_joint("j1", stiffness=5.0, damping=0.2)
    q, v, tau = state_of(scene, rng)
    target = np.array([0.3, -0.2, 0.4, 0.1, 0.0, -0.3])
    assert_transposed(scene.core(), q, v, False, 0.01, tau=tau, order=order, target=target)


@pytest.mark.parametrize("stiffness", [1e4, 1e5])
@pytest.mark.parametrize("order", [2, 4, 8])
@pytest.mark.parametrize("joints", ["revolute", "spherical", "free", "translation"])
def test_stiff(joints, order, stiffness):
    """Springs of joints and between bodies, dampers and functions of the user that the iterations alone cannot take:
    the transposed equations have the same condition."""
    scene, rng = chain(JOINTS[joints], 5)
    n = scene.nv
    for k, kind in enumerate(JOINTS[joints]):
        if kind.shortname() not in ("JointModelFreeFlyer", "JointModelPlanar"):
            scene.set_joint(f"j{k}", stiffness=stiffness, damping=1e-3 * stiffness)
    scene.add_spring("b1", "world", stiffness, point_a=(0.1, 0.2, 0.0), point_b=(1.0, 0.0, 0.5), damping=10.0)
    D = rng.uniform(-1, 1, (n, n))
    D = -1e-3 * stiffness * (D @ D.T) + 1e-4 * stiffness * (D - D.T)
    scene.add_force(lambda t, q, v: D @ v, lambda t, q, v: (np.zeros((n, n)), D))
    q, v, tau = state_of(scene, rng)
    assert_transposed(scene.core(), q, 0.01 * v, True, 2e-3, tau=tau, order=order)


def test_a_step_that_the_iterations_do_not_solve():
    """Where they do not contract the matrix is factored, for the transpose as for the tangent."""
    scene, rng = chain(JOINTS["spherical"])
    q, v, _ = state_of(scene, rng)
    found = None
    for h in np.arange(0.1, 1.0, 0.05):
        try:
            costs = _core.derivative_costs(scene.core(), q, v, h, order=2)
        except cvi.ContactviError:
            break
        if costs["adjoint_iterations"] == 0 and costs["tangent_iterations"] == 0:
            found = h
            break
    assert found is not None
    assert_transposed(scene.core(), q, v, False, found, order=2)


@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("name", ["tree", "forest", "arm_spherical", "double_pendulum", "allegro", "talos"])
def test_iterations_are_about_those_of_the_tangent(name, order):
    case = models.case(name)
    model = case.model()
    costs = _core.derivative_costs(core_scene(model), *case.state(model), 1e-3, order=order)
    assert costs["adjoint_iterations"] <= costs["tangent_iterations"] + 1


# -- parameters -------------------------------------------------------------------------------------------------------


MOST = 40  # of one kind's numbers, in the mean


class Parameters:
    """A tree with springs, dampers and servos as a function of numbers that are named as in `_core.adjoint_step`."""

    def __init__(self, name: str, order: int, momentum: bool):
        case = models.case(name)
        self.model, self.order, self.momentum, self.h = case.model(), order, momentum, 0.02
        rng, model = np.random.default_rng(3), self.model
        n, kinds = model.nv, [model.joints[k].shortname() for k in range(model.njoints)]
        whole = [k == 0 or "FreeFlyer" in kinds[k] or "Planar" in kinds[k] for k in range(model.njoints)]
        self.q, v = case.state(model)
        self.v, self.tau = 2.0 * v, rng.uniform(-1, 1, n)
        one_dof = np.concatenate([np.full(model.nvs[k], model.nvs[k] == 1) for k in range(1, model.njoints)])
        self.values = {
            "inertia": np.array([self.numbers(inertia) for inertia in model.inertias]),
            "stiffness": np.where(whole, 0.0, rng.uniform(2, 6, model.njoints)),
            "armature": np.where(one_dof, rng.uniform(0.05, 0.1, n), 0.0),
            "damping": rng.uniform(0.1, 0.4, n),
            "rest": np.zeros(n),  # displacement of the configuration self.rest
            "kp": one_dof * rng.uniform(5, 20, n), "kd": one_dof * rng.uniform(1, 2, n),
            "q_ref": rng.uniform(-0.3, 0.3, n), "v_ref": rng.uniform(-0.3, 0.3, n),
            "gravity": np.array([0.3, -0.2, -9.81]),
        }  # fmt: skip
        self.rest = pin.integrate(model, pin.neutral(model), rng.uniform(-0.3, 0.3, n))
        # Numbers that the tree does not have: masses without joint, springs of whole joints, servos of others.
        self.free = {name: np.ones(value.shape, bool) for name, value in self.values.items()}
        self.free["inertia"][0] = False
        self.free["stiffness"][whole] = False
        self.free["rest"][np.concatenate([np.full(model.nvs[k], whole[k]) for k in range(1, model.njoints)])] = False
        for name in ("kp", "kd", "q_ref", "v_ref", "armature"):
            self.free[name] &= one_dof.astype(bool)
        # Of many numbers some, for time.
        for free in self.free.values():
            free &= rng.uniform(size=free.shape) * free.sum() < MOST
        self.at_end = rng.uniform(-1, 1, 2 * n)
        self.x = motion(self.scene({}), self.q, self.v, momentum)
        self.end = self.step({})[0]

    @staticmethod
    def numbers(inertia: pin.Inertia) -> np.ndarray:
        moment = inertia.mass * inertia.lever
        about_origin = inertia.inertia - inertia.mass * pin.skew(inertia.lever) @ pin.skew(inertia.lever)
        return np.concatenate([[inertia.mass], moment, about_origin[np.triu_indices(3)]])

    @staticmethod
    def inertia(numbers: np.ndarray) -> pin.Inertia:
        about_origin = np.zeros((3, 3))
        about_origin[np.triu_indices(3)] = numbers[4:]
        about_origin += np.triu(about_origin, 1).T
        lever = numbers[1:4] / numbers[0]
        return pin.Inertia(numbers[0], lever, about_origin + numbers[0] * pin.skew(lever) @ pin.skew(lever))

    def scene(self, change: dict) -> Any:
        at = {**self.values, **change}
        model = pin.Model(self.model)
        for k in range(1, model.njoints):
            model.inertias[k] = self.inertia(at["inertia"][k])
        model.armature, model.gravity = at["armature"], pin.Motion(at["gravity"], np.zeros(3))
        rest = pin.integrate(model, self.rest, at["rest"])
        scene = core_scene(model, stiffness=at["stiffness"], rest=rest, damping=at["damping"])
        scene.set_servo(at["kp"], at["kd"], np.full(model.nv, np.inf))
        return scene

    def inputs(self, change: dict) -> dict:
        at = {**self.values, **change}
        return {"tau": self.tau, "target": np.concatenate([at["q_ref"], at["v_ref"]]), "order": self.order}

    def step(self, change: dict) -> tuple[np.ndarray, np.ndarray]:
        return _core.linear_step(self.scene(change), self.q, self.x, self.momentum, self.h, **self.inputs(change))[:2]

    def value(self, change: dict) -> float:
        q, x = self.step(change)
        return self.at_end @ np.concatenate([difference(self.model, self.end, q), x])

    def slope(self, name: str, index: tuple, size: float) -> float:
        def moved(by: float) -> float:
            value = self.values[name].copy()
            value[index] += by * size
            return self.value({name: value})

        return (8.0 * (moved(1.0) - moved(-1.0)) - (moved(2.0) - moved(-2.0))) / (12.0 * size)


def difference(model: pin.Model, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The tangent vector from a to b, which are close. Pinocchio's has 1e-8 of noise where q holds (cos, sin)."""
    found = pin.difference(model, a, b)
    for k in range(1, model.njoints):
        i, iv, kind = model.idx_qs[k], model.idx_vs[k], model.joints[k].shortname()
        if model.nqs[k] in (2, 4) and "Spherical" not in kind:
            c0, s0, c1, s1 = *a[i + model.nqs[k] - 2 : i + model.nqs[k]], *b[i + model.nqs[k] - 2 : i + model.nqs[k]]
            found[iv + model.nvs[k] - 1] = np.arctan2(c0 * s1 - s0 * c1, c0 * c1 + s0 * s1)
            if model.nvs[k] == 3:
                found[iv : iv + 2] = np.array([[c0, s0], [-s0, c0]]) @ (b[i : i + 2] - a[i : i + 2])
    return found


@pytest.mark.parametrize(
    ("name", "order", "state"),
    [
        pytest.param("tree", 2, "velocity", marks=pytest.mark.long),
        pytest.param("tree", 8, "momentum", marks=pytest.mark.long),
        pytest.param("forest", 4, "velocity", marks=pytest.mark.long),
        ("arm_spherical", 2, "momentum"),
        ("arm_spherical", 16, "velocity"),
    ],
)
def test_parameters(name, order, state):
    """Each parameter against fourth-order differences of the step of a scene made anew."""
    system = Parameters(name, order, STATES[state])
    n = system.model.nv
    *_, ltau, _, parameters = _core.adjoint_step(
        system.scene({}), system.q, system.x, system.momentum, system.h, system.at_end[:n], system.at_end[n:],
        **system.inputs({}),
    )  # fmt: skip
    for kind, value in system.values.items():
        found = np.asarray(parameters[kind])
        assert found.shape == value.shape
        size = {"gravity": 1e-1, "inertia": 2e-4, "armature": 5e-4}.get(kind, 1e-2)
        expected = np.zeros(value.shape)
        for index in zip(*np.nonzero(system.free[kind]), strict=True):
            expected[index] = system.slope(kind, index, size)
        scale = np.abs(expected).max()
        assert np.abs(found - expected)[system.free[kind]].max() <= 1e-7 * scale, kind
    served = system.free["kp"]
    assert np.asarray(parameters["feed"])[served] == pytest.approx(ltau[served], rel=1e-12)  # it acts as a force does
