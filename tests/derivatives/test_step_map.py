"""The derivative of a step by one factored matrix against that by one tangent equation per column."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core
from helpers.chains import JOINTS, chain, state_of, with_elements

H = 0.02  # [s]


def branched(base, seed: int = 3) -> tuple[cvi.Scene, np.random.Generator]:
    """Return a tree with three branches on a base, one of which branches again, and a second tree beside it."""
    rng, model = np.random.default_rng(seed), pin.Model()

    def add(parent: int, joint) -> int:
        placement = pin.SE3(pin.exp3(rng.uniform(-1, 1, 3)), rng.uniform(-0.4, 0.4, 3))
        index = model.addJoint(parent, joint, placement, f"j{model.njoints}")
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.2, 0.2, 3), np.diag(rng.uniform(0.05, 0.1, 3)))
        model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"b{index}", index, 0, pin.SE3.Identity(), pin.FrameType.BODY))
        return index

    root = add(0, base)
    add(add(root, pin.JointModelRX()), pin.JointModelSpherical())
    fork = add(root, pin.JointModelPY())
    for end in (pin.JointModelRZ(), pin.JointModelHX(0.1)):
        add(add(fork, end), pin.JointModelRUBY())
    add(root, pin.JointModelTranslation())
    add(add(0, pin.JointModelRY()), pin.JointModelSpherical())
    return cvi.Scene.from_pinocchio(model, name="branched"), rng


def both_ways(scene, q, x, tau, order, momentum=False, target=None, h=H) -> tuple[np.ndarray, np.ndarray]:
    found = []
    for by_columns in (False, True):
        step = _core.linear_step(scene.core(), q, x, momentum, h, tau, target, 0.0, order, 1e-12, by_columns)
        found.append(np.column_stack([step[2], step[3], step[4]]))
    return found[0], found[1]


def assert_equal(found: np.ndarray, expected: np.ndarray, scene: cvi.Scene) -> None:
    """To 1e-12 of the largest number in each block of columns and rows."""
    nv = scene.nv
    for columns in (slice(0, nv), slice(nv, 2 * nv), slice(2 * nv, 3 * nv), slice(3 * nv, None)):
        for rows in (slice(0, nv), slice(nv, None)):
            scale = np.abs(expected[rows, columns]).max()
            assert np.abs(found[rows, columns] - expected[rows, columns]).max() <= 1e-12 * scale


@pytest.mark.parametrize("momentum", [False, True], ids=["velocity", "momentum"])
@pytest.mark.parametrize("order", [2, 4, 6, 8, 16])
@pytest.mark.parametrize("joints", JOINTS)
def test_every_joint(joints, order, momentum):
    scene, rng = chain(JOINTS[joints])
    q, v, tau = state_of(scene, rng)
    assert_equal(*both_ways(scene, q, v, tau, order, momentum), scene)


@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("joints", ["revolute", "continuous", "helical", "spherical", "free", "planar"])
def test_every_force(joints, order):
    scene, rng = with_elements(joints)
    q, v, tau = state_of(scene, rng)
    assert_equal(*both_ways(scene, q, v, tau, order), scene)


@pytest.mark.parametrize("order", [2, 4, 8, 16])
@pytest.mark.parametrize("base", [pin.JointModelRX(), pin.JointModelFreeFlyer(), pin.JointModelPlanar()], ids=str)
def test_branches(base, order):
    """With joint springs and damping, and with a spring between two branches, which couples them."""
    scene, rng = branched(base)
    q, v, tau = state_of(scene, rng)
    assert_equal(*both_ways(scene, q, v, tau, order), scene)
    for name in scene.model.names[1:]:
        whole = scene.model.joints[scene.model.getJointId(name)].shortname()
        given = {} if whole in ("JointModelFreeFlyer", "JointModelPlanar") else {"stiffness": 3.0}
        scene.set_joint(name, damping=0.3, **given)
    assert_equal(*both_ways(scene, q, v, tau, order), scene)
    scene.add_spring("b3", "b6", 40.0, point_a=(0.1, 0.2, 0.0), point_b=(1.0, 0.0, 0.5), damping=1.5)
    assert_equal(*both_ways(scene, q, v, tau, order), scene)


@pytest.mark.parametrize("order", [2, 8])
def test_stiff_servos(order):
    scene, rng = chain(JOINTS["revolute"], 2)
    scene.set_servo("*", kp=4e4, kd=300.0)
    q, v, tau = state_of(scene, rng)
    target = np.concatenate([[0.3, -0.2, 0.4], np.zeros(3)])
    assert_equal(*both_ways(scene, q, v, tau, order, target=target), scene)


@pytest.mark.parametrize("order", [2, 16])
@pytest.mark.parametrize("links", [3, 6, 10, 20])
def test_long_chains(links, order):
    """Elimination loses digits along a chain, and is left to the columns in time."""
    model, parent = pin.Model(), 0
    length, rod = 1.0 / links, np.array([0.0, 0.0, -1.0 / links])
    for k in range(links):
        parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), rod if k else 0.0 * rod), f"j{k}")
        inertia = pin.Inertia(1.0 / links, 0.5 * rod, length**2 / (12 * links) * np.eye(3))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    scene, rng = cvi.Scene.from_pinocchio(model, name="rods"), np.random.default_rng(5)
    q, v = 0.3 * rng.normal(size=links), 0.3 * rng.normal(size=links)
    assert_equal(*both_ways(scene, q, v, np.zeros(links), order, h=1e-3), scene)


@pytest.mark.parametrize("order", [2, 4, 16])
def test_instruction_sets_give_equal_bits(order):
    scene, rng = branched(pin.JointModelFreeFlyer())
    q, v, tau = state_of(scene, rng)
    names, before = _core.instruction_sets(), _core.instruction_set()
    if len(names) == 1:
        pytest.skip(f"this machine has {names} only")
    try:
        found = []
        for name in names:
            _core.instruction_set(name)
            found.append(both_ways(scene, q, v, tau, order)[0].tobytes())
    finally:
        _core.instruction_set(before)
    assert len(set(found)) == 1
