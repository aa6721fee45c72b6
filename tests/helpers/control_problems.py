"""Problems of optimal control that are small enough to be known: their scenes, costs and constraints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.control import Constraint, Inputs, Problem, quadratic
from derivatives.differences import FOURTH
from helpers.sprung_arm import SPRUNG_ARM, sprung_arm

MODELS = Path(__file__).resolve().parents[2] / "models"
STEP, INTERVALS = 0.04, 20
GOAL = np.array([0.5, -0.3, 1.0, 0.2])  # (q, p)
WEIGHTS = 50.0 * np.array([1.0, 1.0, 0.1, 0.1])


def generic(target: np.ndarray, model: pin.Model) -> Any:
    """A cost of the distance of the last configuration from a target and of all velocities."""

    def cost(t, q, v):
        off = pin.difference(model, target, q[-1])
        lq = np.zeros((len(t), model.nv))
        lq[-1] = pin.dDifference(model, target, q[-1], pin.ArgumentPosition.ARG1).T @ off
        return 0.5 * float(off @ off) + 0.05 * float(np.sum(v**2)), lq, 0.1 * v

    return cost


def at_middle(nv: int) -> Constraint:
    """Two numbers of the path: a velocity at one node, and the sum of the squares of those at another one."""

    def function(t, q, v):
        c = np.array([v[3, 0], np.sum(v[-4] ** 2)])
        by_v = np.zeros((2, len(t), nv))
        by_v[0, 3, 0], by_v[1, -4] = 1.0, 2.0 * v[-4]
        return c, np.zeros((2, len(t), nv)), by_v

    return Constraint(function, [-5.0, 0.0], [5.0, np.inf], "middle")


def arm_problem(interpolation: str = "constant", **options: Any) -> Problem:
    """An arm whose tip bounces, with a servo in the slide: all kinds of variables at once."""
    scene = sprung_arm(0.6, 0.1)(np.array(SPRUNG_ARM))
    inputs = Inputs(scene, torques="turn", targets="slide", hold=7, interpolation=interpolation)
    return Problem(
        scene, 0.45, 1e-2, order=4, solver_tol=1e-14, q0=[0.5, 0.5], v0=[-1.0, 1.0], inputs=inputs, free_q0="turn",
        free_v0="*", parameters=["mass:turn", "restitution:tip|ground", "gravity", "kp:slide"],
        cost=generic(np.array([0.4, 0.3]), scene.model), input_cost=quadratic([1e-2, 1e-1], [0.0, 0.4]),
        parameter_cost=lambda p: (float(p["mass:turn"][0] ** 2), {"mass:turn": 2.0 * p["mass:turn"]}),
        constraints=[at_middle(2)], **options,
    )  # fmt: skip


def box_problem() -> Problem:
    """A box thrown with spin that falls on a corner: its pose in space is free."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.3, 0.25), mass=0.8)
    scene.set_contact(restitution=0.6)
    q = pin.integrate(scene.model, scene.neutral(), np.array([0, 0, 0.3, 0.3, 0.5, 0.2]))
    target = pin.integrate(scene.model, q, np.array([0.1, 0.0, 0.0, 0.1, 0.0, 0.1]))
    return Problem(
        scene, 0.3, 1e-2, order=4, solver_tol=1e-14, q0=q, v0=[0.3, 0.1, -0.5, 0.5, 1.0, -0.5], free_q0="box",
        free_v0="box",
        parameters=["inertia:box"], cost=generic(target, scene.model), constraints=[at_middle(6)],
    )  # fmt: skip


def at_the_wall(**options: Any) -> Problem:
    """A double pendulum that comes to a state (q, p) after an impact on the wall; the optimum's cost is 0.0205."""
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    scene.set_contact(restitution=0.7)
    model = scene.model

    def momentum(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        upper = np.triu(pin.crba(model, model.createData(), q))
        return (upper + np.triu(upper, 1).T) @ v

    def cost(t, q, v):
        off = WEIGHTS * (np.concatenate([q[-1], momentum(q[-1], v[-1])]) - GOAL)
        J = 0.5 * float(off**2 @ (1.0 / WEIGHTS))
        size = 1e-3
        by_q = sum(
            weight / size * np.array([momentum(q[-1] + count * size * unit, v[-1]) for unit in np.eye(2)]).T
            for count, weight in FOURTH
        )
        by_v = np.array([momentum(q[-1], unit) for unit in np.eye(2)]).T
        return J, off[:2] + by_q.T @ off[2:], by_v.T @ off[2:]

    chosen = {"cost": cost, "input_cost": quadratic(1e-3 * STEP), "bounds": {"inputs": (-15.0, 15.0)}} | options
    return Problem(
        scene, INTERVALS * STEP, STEP, order=4, solver_tol=1e-14, q0=[0.35, 0.25], v0=[0.0, 0.0],
        inputs=Inputs(scene, torques="*"), **chosen,
    )  # fmt: skip


def first_guess(problem: Problem) -> np.ndarray:
    """Torques that throw the pendulum against the wall."""
    u = np.zeros((INTERVALS, 2))
    u[:8, 0] = -2.0
    return problem.pack({"inputs": u})


def thrown_ball(e: float = 0.9, **options: Any) -> tuple[Problem, float]:
    """A ball that is thrown from the ground's height with a free velocity, bounces once, and has to be at x = 2 m at
    the height from which it came; the least v^2 is asked. Returns the time of the run, too.
    """
    scene = ball_on_rails(0.1)
    scene.set_contact(restitution=e)
    T = 0.6

    def cost(t, q, v):
        return 0.5 * float(v[0] @ v[0]), np.zeros((len(t), 2)), np.vstack([v[:1], np.zeros((len(t) - 1, 2))])

    target = Constraint(lambda t, q, v: (q[-1], np.eye(2), np.zeros((2, 2))), [2.0, 0.5], [2.0, 0.5], "target")
    return Problem(scene, T, 1e-2, q0=[0.0, 0.5], free_v0="*", cost=cost, constraints=[target], **options), T


def ball_on_rails(radius: float, gravity: float = -9.81) -> cvi.Scene:
    """A ball that moves along x and z, above the ground."""
    model = pin.Model()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(z, pin.Inertia.FromSphere(1.0, radius), pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, gravity])
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("ball", z, pin.SE3.Identity(), coal.Sphere(radius)))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="rails")
    scene.add_halfspace()
    return scene
