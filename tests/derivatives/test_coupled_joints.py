"""Derivatives of runs with coupled joints: against differences along the leaders; followers count for nothing."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from helpers.coupled_hands import finger, gripper, hand, limited, mimics, scene_of, start_of, with_ball
from oracles.coupled import Coupled

ROBOTS = {"finger": finger(3), "gripper": gripper(-0.05, 0.01), "arm": hand(2, mount="arm")}


def differences(run, x, size):
    """Return d run(x)/dx by central differences of fourth order."""
    columns = []
    for k in range(len(x)):
        total = 0.0
        for steps, weight in ((1, 2.0 / 3.0), (2, -1.0 / 12.0)):
            for side in (1.0, -1.0):
                moved = np.array(x, dtype=float)
                moved[k] += side * steps * size
                total = total + side * weight / size * run(moved)
        columns.append(total)
    return np.column_stack(columns)


class Robot:
    """A scene with its oracle, a start, and runs from other ones."""

    def __init__(self, text, folder, change=lambda scene: None, speed=3.0, base=None, **settings):
        self.scene = scene_of(text, folder)
        change(self.scene)
        self.oracle = oracle = Coupled(self.scene.model, mimics(text))
        self.settings = settings
        y, u, _, _ = start_of(oracle, speed)
        if base is not None:
            y, u = base
        self.x, self.n, self.nv = np.append(y, u), len(y), self.scene.model.nv
        self.S = np.zeros((2 * self.nv, 2 * self.n))
        self.S[: self.nv, : self.n] = self.S[self.nv :, self.n :] = oracle.S

    def traj(self, x=None, **more):
        x = self.x if x is None else x
        q, v = self.oracle.q(x[: self.n]), self.oracle.S @ x[self.n :]
        return cvi.simulate(self.scene, q, v, **{**self.settings, **more})

    def end(self, x, **more):
        traj = self.traj(x, **more)
        return np.append(traj.q[-1], traj.v[-1])

    def check(self, share, size=1e-4):
        """Hold the derivative by the start to differences, and the gradient to the derivative."""
        traj = self.traj(record="gradient")
        D = traj.sensitivity(["q0", "v0"]).matrix[-1]
        wanted = differences(self.end, self.x, size)
        assert np.abs(D @ self.S - wanted).max() < share * np.abs(wanted).max()
        nv, free = self.nv, self.oracle.free
        led = [i for i in range(nv) if i not in free]
        assert np.all(D[:, led + [nv + i for i in led]] == 0.0)
        for rows in (D[:nv], D[nv:]):
            np.testing.assert_allclose(rows, self.oracle.S @ rows[free], rtol=0, atol=1e-11 * np.abs(rows).max())
        z = np.sin(1.0 + np.arange(2 * nv))
        _, gradient = cvi.gradient(traj, (z[:nv], z[nv:]), ["q0", "v0"])
        found = np.append(gradient["q0"], gradient["v0"])
        np.testing.assert_allclose(found, z @ D, rtol=0, atol=1e-10 * np.abs(D).max())
        return traj


@pytest.mark.parametrize("order", [2, 4, 8])
@pytest.mark.parametrize("name", ROBOTS)
def test_smooth_runs(name, order, tmp_path):
    Robot(ROBOTS[name], tmp_path, duration=0.1, dt=0.01, order=order, solver_tol=1e-14).check(1e-8)


def test_long_steps(tmp_path):
    """Where the iterations of the derivative do not contract its matrix is factored."""
    Robot(ROBOTS["finger"], tmp_path, speed=12.0, duration=0.2, dt=0.1, order=8, solver_tol=1e-14).check(1e-6, 1e-5)


@pytest.mark.parametrize("impact", ["ctec", "dtec", "mhc"])
@pytest.mark.parametrize("joint", ["j0", "j2"])
def test_through_limits(joint, impact, tmp_path):
    text = limited(ROBOTS["finger"], joint, -2.0, 0.5 if joint == "j0" else 0.9)
    robot = Robot(
        text,
        tmp_path,
        base=(np.zeros(1), np.array([3.0])),
        duration=0.2,
        dt=0.01,
        order=4,
        solver_tol=1e-14,
        impact=impact,
    )
    assert len(robot.check(1e-6, 1e-5).events) == 1


@pytest.mark.parametrize("mode", ["events", "steps"])
@pytest.mark.parametrize("friction", [0.0, 0.1])
def test_a_tip_that_lands_and_slides(friction, mode, tmp_path):
    """Persistent contact after an impact, and dense steps."""

    def floor(scene):
        scene.add_halfspace(offset=-0.15)
        scene.set_contact(restitution=0.0, friction=friction)

    text = with_ball(hand(1, mount="arm"), "f0l2", 0.006, 0.028)
    base = np.array([0.1, 0.2, 0.3]), np.array([0.5, 1.5, 0.2])
    settings = {"duration": 0.15, "dt": 1e-3, "solver_tol": 1e-14, "contact_mode": mode}
    traj = Robot(text, tmp_path, floor, base=base, **settings).check(1e-5, 1e-6)
    assert len(traj.contacts) > 0


@pytest.mark.parametrize("name", ROBOTS)
def test_a_step_as_a_linear_system(name, tmp_path):
    robot = Robot(ROBOTS[name], tmp_path, duration=0.01, dt=0.01, order=4, solver_tol=1e-14)
    nv, n = robot.nv, robot.n
    q, v = robot.oracle.q(robot.x[:n]), robot.oracle.S @ robot.x[n:]
    A, B = cvi.linearize(robot.scene, q, v, dt=0.01, order=4)
    wanted = differences(robot.end, robot.x, 1e-4)
    assert np.abs(A @ robot.S - wanted).max() < 1e-9 * np.abs(wanted).max()
    by_force = differences(lambda tau: robot.end(robot.x, control=tau), np.zeros(nv), 1e-3)
    assert np.abs(B - by_force).max() < 1e-8 * np.abs(by_force).max()
    # In momenta the step of the leaders is symplectic: with p = M v of all joints, S^T p.
    step = cvi.step_derivatives(robot.scene, q, v, dt=0.01, order=4, state="momentum")
    free = robot.oracle.free
    T = np.zeros((2 * nv, 2 * n))
    T[:nv, :n] = robot.oracle.S
    T[nv:, n:][free] = np.eye(n)  # any momentum with this S^T p
    R = np.zeros((2 * n, 2 * nv))
    R[:n, :nv][:, free] = np.eye(n)
    R[n:, nv:] = robot.oracle.S.T
    reduced = R @ step.A @ T
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    assert np.abs(reduced.T @ J @ reduced - J).max() < 1e-11 * np.abs(reduced).max() ** 2


def test_parameters(tmp_path):
    names = ["gravity", "mass:j2", "inertia:j1", "armature:j2", "damping:j1", "stiffness:j2", "control"]

    def springs(scene):
        scene.set_joint("j1", damping=1e-3)
        scene.set_joint("j2", stiffness=0.3, armature=1e-6, rest=0.0)

    robot = Robot(finger(3), tmp_path, springs, duration=0.1, dt=0.01, order=4, solver_tol=1e-14)
    traj = robot.traj(record="gradient")
    found = traj.sensitivity(names)
    nv = robot.nv
    z = np.sin(1.0 + np.arange(2 * nv))
    _, gradient = cvi.gradient(traj, (z[:nv], z[nv:]), names)

    def changed(**settings):
        def change(scene):
            springs(scene)
            scene.set_joint(settings.pop("joint"), **settings)

        return Robot(finger(3), tmp_path, change, **robot.settings).end(robot.x)

    for name, joint, value in (("damping", "j1", 1e-3), ("stiffness", "j2", 0.3), ("armature", "j2", 1e-6)):
        step = 1e-3 * value
        ends = [changed(joint=joint, **{name: value + side * step}) for side in (1.0, -1.0)]
        wanted = (ends[0] - ends[1]) / (2.0 * step)
        D = found.of(f"{name}:{joint}")[-1][:, 0]
        assert np.abs(D - wanted).max() < 1e-6 * np.abs(wanted).max()  # the square of the step
    for name in names:
        D = found.of(name)[-1]
        np.testing.assert_allclose(
            np.sum(gradient[name], axis=0) if name == "control" else gradient[name],
            np.squeeze(z @ D), rtol=0, atol=1e-10 * np.abs(D).max(),
        )  # fmt: skip


@pytest.mark.parametrize("name", ["finger", "gripper"])
def test_second_derivatives(name, tmp_path):
    robot = Robot(ROBOTS[name], tmp_path, duration=0.1, dt=0.01, order=4, solver_tol=1e-14)
    nv, n = robot.nv, robot.n
    z = np.sin(1.0 + np.arange(2 * nv))
    cost = (z[:nv], z[nv:])
    direction = np.cos(np.arange(2 * n))

    def gradient(x):
        _, found = cvi.gradient(robot.traj(x, record="gradient"), cost, ["q0", "v0"])
        return np.append(found["q0"], found["v0"]) @ robot.S

    wanted = differences(lambda t: gradient(robot.x + t[0] * direction), np.zeros(1), 1e-4)[:, 0]
    w = robot.S @ direction
    found = cvi.hessian_vector(
        robot.traj(record="gradient"), cost, {"q0": w[:nv], "v0": w[nv:]}, ["q0", "v0"], hessp="linear"
    )
    product = np.append(found.product["q0"], found.product["v0"]) @ robot.S
    assert np.abs(product - wanted).max() < 1e-7 * np.abs(wanted).max()
