"""Cases of forces and prescribed motion: damping, joint friction, a screw, a string, a cart that is moved."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ellipk

from contactvi.reproduce.check import Check, at_most, near
from contactvi.trajectory.trajectory import Trajectory
from contactvi.verify import systems
from contactvi.verify.case import Case, Runs, largest
from contactvi.verify.systems import GRAVITY as _G

_SOLVED = "steps are solved to 1e-12; rounding over the run"
_CONSTANT = "constant acceleration is exact in the midpoint rule; " + _SOLVED
_ORDER = "second order; terms of higher order"


def damped_pendulum(runs: Runs) -> list[Check]:
    """Closed form of a small swing: exp(-r t) (cos w t + r/w sin w t), r = c / 2, w^2 = g - r^2; m = l = 1."""
    c, small = 0.4, 1e-6
    scene = systems.damped_pendulum(c)
    traj = runs.simulate(scene, [small], [0.0], 5.0, 0.05, order=8)
    rate = 0.5 * c
    w = math.sqrt(_G - rate * rate)
    exact = np.exp(-rate * traj.t) * (np.cos(w * traj.t) + rate / w * np.sin(w * traj.t))
    balance, lost = [], []
    for h in (0.01, 0.005):
        swing = runs.simulate(scene, [2.5], [0.0], 5.0, h)
        balance.append(float(np.abs(swing.ledger.energy_balance).max()))
        lost.append(float(swing.energy[0] - swing.energy[-1] - swing.work.damping[-1]))
    return [
        at_most("small swing over its start, largest error", 1e-10, largest(traj.q[:, 0] / small - exact),
                "order 8 at w h = .16; sin x is x to 1e-13"),
        near("energy lost less the damper's work, from 2.5 rad, h = .005 [J]", 0.0, lost[1], 2.0 * _G * _G * 0.005**2,
             "second order: (w h)^2 of the energy swung, 2 m G l"),
        near("order of the energy balance", 2.0, math.log2(balance[0] / balance[1]), 0.05, _ORDER),
    ]  # fmt: skip


def friction_stop(runs: Runs) -> list[Check]:
    """Closed form: stops after m v / f s and m v^2 / (2 f) m, and stays; the friction takes m v^2 / 2."""
    m, f, v = 2.0, 2.9, 1.5
    checks = []
    for h in (0.1, 0.01):
        traj = runs.simulate(systems.slider_with_friction(m, f), [0.0], [v], 2.0, h)
        x, speed = traj.q[:, 0], traj.v[:, 0]
        last = int(np.flatnonzero(speed > 0.0)[-1])  # node before the stop; from there x = v t / 2 to the end
        after, of = traj.t > m * v / f, f", h = {h:g}"
        checks += [
            near(f"place [m]{of}", 0.5 * m * v * v / f, x[-1], 1e-12, "the stop is located in its step; " + _CONSTANT),
            near(f"time [s], by the place{of}", m * v / f, traj.t[last] + 2.0 * (x[-1] - x[last]) / speed[last], 1e-10,
                 "the error of the place over the speed"),
            near(f"work of the friction [J]{of}", 0.5 * m * v * v, traj.work.joint_friction[-1], 1e-11, _SOLVED),
            at_most(f"moved after it [m]{of}", 0.0, largest(x[after] - x[-1]), "a sticking joint is at rest exactly"),
        ]  # fmt: skip
    return checks


def friction_spring(runs: Runs) -> list[Check]:
    """Closed form: every half period pi sqrt(m/k) the swing is 2 f/k smaller; it sticks where k |x| <= f.

    The midpoint rule keeps quadratic energies and the friction's work is exact, so the turns are, at any step.
    """
    m, k, f, start = 2.0, 200.0, 3.0, 0.1
    turns = [start]
    while k * abs(turns[-1]) > f:
        turns.append(math.copysign(2.0 * f / k, turns[-1]) - turns[-1])  # .1, -.07, .04, -.01
    stop = (len(turns) - 1) * math.pi * math.sqrt(m / k)
    work = 0.5 * k * (start**2 - turns[-1] ** 2)
    checks = []
    for h in (0.01, 0.005):
        traj = runs.simulate(systems.slider_with_friction(m, f, k), [start], [0.0], 2.0, h)
        x, of = traj.q[:, 0], f", h = {h:g}"
        rest = traj.t[np.flatnonzero(np.diff(x) != 0.0)[-1] + 1]
        checks += [
            near(f"sticks at [m]{of}", turns[-1], x[-1], 1e-12, "energy is exact, turns are located; " + _SOLVED),
            near(f"first node at rest [s]{of}", stop + 0.5 * h, rest, 0.5 * h + 0.1 * h,
                 "the node after the stop; time to (w h)^2 / 12"),
            near(f"work of the friction [J]{of}", work, traj.work.joint_friction[-1], 1e-11, _SOLVED),
        ]  # fmt: skip
    return checks


def nut(runs: Runs) -> list[Check]:
    """Closed form: (m p^2 + I) phi'' = -m g p, z = p phi; the thread carries m (g + z'')."""
    m, r, p = 2.0, 0.05, 0.02
    inertia = 0.5 * m * r * r
    a = -_G * m * p * p / (m * p * p + inertia)
    scene = systems.nut_on_screw(m, r, p)
    traj = runs.simulate(scene, scene.neutral(), np.zeros(6), 2.0, 0.01)
    force = traj.reactions("thread")[1:]
    acceleration = np.diff(traj.v[:, 2]) / 0.01
    return [
        near("acceleration [m/s^2]", np.full(len(acceleration), a), acceleration, 1e-9, _CONSTANT + ", over h"),
        at_most("place, largest error [m]", 1e-10, largest(traj.q[:, 2] - 0.5 * a * traj.t**2), _CONSTANT),
        at_most("spin, largest error [rad/s]", 1e-9, largest(traj.v[:, 5] - a / p * traj.t), _CONSTANT),
        near("force of the thread [N]", np.full(len(force), m * (_G + a)), force[:, 4], 1e-7, _SOLVED + ", over h"),
        at_most("across it [N, N m]", 1e-7, largest(force[:, :4]), "it falls straight"),
        at_most("off the screw [m, rad]", 1e-10, residual(traj), "phi of constraints"),
    ]


def string_pendulum(runs: Runs) -> list[Check]:
    """Closed form: period 4 sqrt(l/g) K(sin(a/2)); at the bottom the string pulls with m g (3 - 2 cos a)."""
    angle = 1.0
    period = 4.0 / math.sqrt(_G) * float(ellipk(math.sin(0.5 * angle) ** 2))
    speed = math.sqrt(2.0 * _G * (1.0 - math.cos(angle)))
    checks, errors = [], []
    for steps in (250, 500, 1000):
        h = 1.25 * period / steps
        scene, q = systems.ball_on_string(angle)
        traj = runs.simulate(scene, q, np.zeros(6), steps * h, h)
        late = abs(traj.q[-1, 0]) / speed  # it should pass the bottom: the time that the place is off
        stretch = largest(np.linalg.norm(traj.q[:, :3], axis=1) - 1.0)
        errors.append(late)
        of = f", h = {h:.2g}"
        checks += [
            near(f"time of 1 1/4 periods [s]{of}", steps * h, steps * h + late, steps * h * _G * h * h / 6.0,
                 "second order: twice the (w h)^2 / 12 of the linear pendulum"),
            near(f"pull at the bottom [N]{of}", _G * (3.0 - 2.0 * math.cos(angle)), -traj.reactions("string")[-1, 0],
                 3.0 * _G * (speed * h) ** 2, "mean over a step that turns by v h: 3 m g times its square bounds it"),
            at_most(f"length of the string off by [m]{of}", 1e-10, stretch, "phi of constraints"),
        ]  # fmt: skip
    return [*checks, near("order of the time", [2.0, 2.0], np.log2(np.divide(errors[:-1], errors[1:])), 0.05, _ORDER)]


def moved_cart(runs: Runs) -> list[Check]:
    """Closed form: F = (M + m) x'' + m l (a'' cos a - a'^2 sin a), l a'' = -(g sin a + x'' cos a); M = m = l = 1.

    x = A sin w t. Angle and rate are the run's; the force is the mean over a step, compared at its middle.
    """
    A, w = 0.2, 5.0
    scene = systems.pendulum_on_cart(
        lambda t: (A * math.sin(w * t), A * w * math.cos(w * t), -A * w * w * math.sin(w * t))
    )
    q = [0.0, 0.5]
    checks, errors, works = [], [], []
    for h in (0.02, 0.01, 0.005):
        traj = runs.simulate(scene, q, scene.consistent_velocity(q), 5.0, h)
        x2 = -A * w * w * np.sin(w * 0.5 * (traj.t[1:] + traj.t[:-1]))
        a, rate = (0.5 * (values[1:, 1] + values[:-1, 1]) for values in (traj.q, traj.v))
        turn = -(_G * np.sin(a) + x2 * np.cos(a))
        force = 2.0 * x2 + turn * np.cos(a) - rate**2 * np.sin(a)
        errors.append(largest(traj.reactions("motion")[1:, 0] - force))
        works.append(largest(traj.energy - traj.energy[0] - traj.work.prescribed))
        of = f", h = {h:g}"
        checks += [
            at_most(f"cart off its motion [m]{of}", 1e-12, largest(traj.q[:, 0] - A * np.sin(w * traj.t)), _SOLVED),
            at_most(f"force, largest error [N]{of}", (w * h) ** 2 / 6.0 * largest(force), errors[-1],
                    "second order: (w h)^2 / 6 of the largest force"),
        ]  # fmt: skip
    return [
        *checks,
        near("order of the force", [2.0, 2.0], np.log2(np.divide(errors[:-1], errors[1:])), 0.05, _ORDER),
        near("order of energy less work", [2.0, 2.0], np.log2(np.divide(works[:-1], works[1:])), 0.05, _ORDER),
    ]


def residual(traj: Trajectory) -> float:
    """Return the largest |phi| of the constraints over the nodes [m, rad]."""
    core = traj.scene.core()
    return max(float(np.abs(core.constraint_residual(q, t)).max()) for t, q in zip(traj.t, traj.q, strict=True))


CASES = (
    Case("damped", "a damped pendulum", damped_pendulum),
    Case("joint-friction-stop", "joint friction stops a slider", friction_stop, former="dry-stop"),
    Case(
        "joint-friction-spring", "a mass on a spring with joint friction sticks", friction_spring, former="dry-spring"
    ),
    Case("screw", "a nut runs down a screw", nut),
    Case("string", "a pendulum on a string", string_pendulum),
    Case("cart", "a pendulum on a cart that is moved", moved_cart),
)
