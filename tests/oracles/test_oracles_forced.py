"""The oracle of constrained and forced motion against differences, energy balance and other derivations."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from oracles import forced
from oracles.constraints import (
    JointPolynomial,
    Motion,
    Point,
    Prescribed,
    Screw,
    Tape,
    Weld,
    constant,
    distance,
    ramp,
    sine,
)

EPS = np.finfo(float).eps
# central differences of sixth order: sum of w (f(k h) -+ f(-k h)) over h, or h^2
FIRST = ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
SECOND = ((0, -49 / 36), (1, 3 / 2), (2, -3 / 20), (3, 1 / 90))


def pose(rng):
    return pin.SE3(pin.exp3(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-1.0, 1.0, 3))


def forest():
    """Two trees with joints of every kind that the oracle knows."""
    model, rng = pin.Model(), np.random.default_rng(0)

    def add(parent, joint, name):
        joint = model.addJoint(parent, joint, pose(rng), name)
        inertia = pin.Inertia(rng.uniform(0.5, 2), rng.uniform(-0.3, 0.3, 3), np.diag(rng.uniform(0.4, 0.5, 3)))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        return joint

    a = add(0, pin.JointModelFreeFlyer(), "free")
    b = add(a, pin.JointModelRX(), "hinge")
    add(b, pin.JointModelPrismaticUnaligned(np.array([1.0, 2.0, 2.0]) / 3.0), "slide")
    d = add(0, pin.JointModelSpherical(), "ball")
    e = add(d, pin.JointModelRUBZ(), "turntable")
    f = add(e, pin.JointModelPlanar(), "planar")
    add(f, pin.JointModelHelicalUnaligned(np.array([2.0, 1.0, 2.0]) / 3.0, 0.3), "helix")
    return model


def state(model, seed=2, size=1.0):
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-size, size, model.nv))
    return q, rng.uniform(-size, size, model.nv)


def every_constraint():
    rng = np.random.default_rng(5)
    tape = [(1, (0, 0, 0.1)), (0, (1, 2, 0.3)), (6, (0.1, 0.2, 0.3)), (4, (0, 0.3, 0))]
    return {
        "point": Point((3, (0.1, 0.2, 0.3)), (7, (0.4, -0.2, 0.1))),
        "point on the world": Point((0, (0.1, 0.2, 0.3)), (7, (0.4, -0.2, 0.1))),
        "distance": distance((1, (0.1, 0.2, 0.3)), (5, (0.4, -0.2, 0.1)), sine(0.3, 2.0, 1.0)),
        "tape": Tape(tape, ramp(1.0, 0.5)),
        "weld": Weld(3, pose(rng), 7, pose(rng)),
        "screw": Screw(2, pose(rng), 5, pose(rng), 0.5),
        "polynomial": JointPolynomial(3, 2, [0.1, 0.2, 0.3, -0.4]),
        "prescribed": Prescribed(2, sine(0.2, 3.0)),
        "prescribed turntable": Prescribed(5, ramp(0.3, 3.0)),
    }


# --- constraints -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", every_constraint())
def test_derivatives_of_a_constraint_are_those_of_its_residual(name):
    model, constraint, t0 = forest(), every_constraint()[name], 0.37
    q, v = state(model)
    a = np.random.default_rng(3).uniform(-1.0, 1.0, model.nv)

    def f(s):
        return constraint.residual(model, pin.integrate(model, q, s * v + 0.5 * s * s * a), t0 + s)

    jet = constraint.jet(Motion(model, q, v), t0)
    rate = sum(w * (f(k * 5e-3) - f(-k * 5e-3)) for k, w in FIRST) / 5e-3
    second = sum(w * (f(k * 1e-2) + f(-k * 1e-2)) for k, w in SECOND) / 1e-4
    assert np.abs(rate - jet.rate).max() <= 1e-12  # rounding over 5e-3
    assert np.abs(second - jet.jac @ a - constraint.bias(model, q, v, t0)).max() <= 1e-9  # 1e-2^6 times 8 derivatives
    for i, e in enumerate(np.eye(model.nv)):

        def at(h, e=e):
            return constraint.residual(model, pin.integrate(model, q, h * e), t0)

        column = sum(w * (at(k * 5e-3) - at(-k * 5e-3)) for k, w in FIRST) / 5e-3
        assert np.abs(column - constraint.jacobian(model, q, t0)[:, i]).max() <= 1e-12


def test_rate_of_the_numbers_of_q_is_pinocchios_integrate():
    model = forest()
    q, v = state(model)
    ahead = [(w, pin.integrate(model, q, k * 5e-3 * v) - pin.integrate(model, q, -k * 5e-3 * v)) for k, w in FIRST]
    rate = sum(w * d for w, d in ahead) / 5e-3
    assert np.abs(rate - forced.configuration_rate(model, q, v)).max() <= 1e-12


def test_least_takes_the_smallest_multipliers_of_redundant_rows():
    rng = np.random.default_rng(1)
    half, jac = rng.uniform(-1.0, 1.0, (5, 5)), rng.uniform(-1.0, 1.0, (2, 5))
    mass, target = half @ half.T + np.eye(5), rng.uniform(-1.0, 1.0, 2)
    dv, lam = forced.least(mass, jac, target)
    twice_dv, twice = forced.least(mass, np.vstack([jac, jac]), np.concatenate([target, target]))
    exact = np.linalg.solve(jac @ np.linalg.solve(mass, jac.T), target)
    assert np.abs(lam - exact).max() <= 1e-12
    assert np.abs(twice_dv - dv).max() <= 1e-12
    assert np.abs(twice - 0.5 * np.concatenate([lam, lam])).max() <= 1e-12


# --- forces ------------------------------------------------------------------------------------------------------
PATH = ((1, (0, 0, 0.1)), (0, (1.0, 2.0, 0.3)), (6, (0.1, 0.2, 0.3)))


def every_force(model):
    wave = np.random.default_rng(8).uniform(-1.0, 1.0, (2, 3))
    ends = [(3, (0.1, 0.0, 0.2)), (7, (0.0, 0.3, 0.0))]
    return [
        forced.JointDamping(np.linspace(0.1, 0.5, model.nv)),
        forced.JointSpring(2, [3.0, 0.5, 2.0], 0.2),
        forced.JointSpring(3, [4.0]),
        *forced.spring_damper(ends, 5.0, 0.4, 0.7),
        *forced.spring_damper(PATH, 3.0, 2.0, 0.3),
        forced.PathSpring(PATH, 2.0, 1.5, slack=True),
        forced.PathPull(PATH, lambda t: 1.0 + math.sin(3.0 * t)),
        forced.Wrench((3, (0.1, 0.2, 0.0)), lambda t: wave[0] * math.cos(2.0 * t), lambda t: wave[1] * t),
        forced.Wrench((7, (0.0, 0.2, 0.1)), lambda t: wave[1] * math.sin(t), lambda t: wave[0], body_axes=True),
        forced.UserForce(lambda q, v, t: 0.3 * np.cos(t + np.arange(v.size))),
        forced.UserForce(lambda q, v, t: -0.1 * v * np.abs(v), "damping"),
    ]


def test_springs_pull_against_the_gradient_of_their_energy():
    model = forest()
    q, _ = state(model)
    for force in (f for f in every_force(model) if f.kind == "spring"):

        def energy(w, force=force):
            return force.energy(Motion(model, pin.integrate(model, q, w)))

        basis = np.eye(model.nv)
        slope = [sum(w * (energy(k * 5e-3 * e) - energy(-k * 5e-3 * e)) for k, w in FIRST) / 5e-3 for e in basis]
        assert np.abs(force.tau(Motion(model, q), 0.0) + slope).max() <= 1e-11  # 1e-15 J over 5e-3, sums of 10 J


def test_a_wrench_has_the_power_of_its_point_and_spin():
    model = forest()
    q, v = state(model)
    f, n, motion = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.2, -1.0]), Motion(model, q, v)
    spatial = pin.getVelocity(model, motion.data, 7, pin.LOCAL)
    at = np.array([0.4, -0.2, 0.1])
    body = f @ (spatial.linear + np.cross(spatial.angular, at)) + n @ spatial.angular
    power = forced.Wrench((7, at), lambda _t: f, lambda _t: n, body_axes=True).tau(motion, 0.0) @ v
    assert power == pytest.approx(body, rel=64 * EPS)
    turn = motion.data.oMi[7].rotation
    world = forced.Wrench((7, at), lambda _t: turn @ f, lambda _t: turn @ n).tau(motion, 0.0) @ v
    assert world == pytest.approx(body, rel=64 * EPS)


# --- motion ------------------------------------------------------------------------------------------------------
@pytest.mark.long
def test_energy_balance_and_constraints_with_everything_at_once():
    """Loops, prescribed motions, springs, dampers and inputs; a row given twice shares its multiplier."""
    model = forest()
    q, v = state(model, seed=4, size=0.5)
    motion = Motion(model, q)
    gap = motion.point((7, (0.1, 0.0, 0.0))).value
    rod = float(motion.length([(1, (0, 0, 0)), (4, (0, 0, 0.3))]).value[0])
    tape = float(motion.length(PATH).value[0])
    hinge = float(motion.joint(2).value[0])
    loop = distance((1, (0, 0, 0)), (4, (0, 0, 0.3)), sine(0.1, 4.0, rod))
    constraints = [
        Point((0, gap), (7, (0.1, 0.0, 0.0))),
        loop,
        loop,
        Tape(PATH, ramp(tape, -0.2)),
        Prescribed(2, sine(0.3, 5.0, hinge)),
    ]
    run = forced.solve(model, q, v, np.linspace(0.0, 0.5, 6), every_force(model), constraints)
    size = 1.0 + np.abs(run.kinetic).max()
    assert np.abs(run.imbalance()).max() <= 1e-9 * size
    assert min(np.ptp(run.work_input), np.ptp(run.dissipated), np.ptp(run.work_drive)) >= 0.1  # all three matter
    assert run.drift <= 1e-11
    assert run.misfit <= 1e-10
    for t, x, u in zip(run.t, run.q, run.v, strict=True):
        phi = forced.rows(Motion(model, x, u), t, constraints)
        assert np.abs(phi.value).max() <= 1e-12
        assert np.abs(phi.rate).max() <= 1e-12
    assert np.abs(run.multipliers[:, 3] - run.multipliers[:, 4]).max() <= 1e-8 * np.abs(run.multipliers).max()


def test_multipliers_are_newtons_law_of_the_whole():
    """Free bodies joined to each other and to the world: weight and the world's forces change the total momentum."""
    model = pin.Model()
    for name in "ab":
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.5, np.array([0.1, 0.2, 0.0]), np.eye(3)), pin.SE3.Identity())
    rng, (q, v) = np.random.default_rng(7), state(model)
    joined = Point((0, Motion(model, q).point((1, (0.3, 0.0, 0.0))).value), (1, (0.3, 0.0, 0.0)))
    x_1 = pose(rng)
    x_2 = pin.XYZQUATToSE3(q[7:]).actInv(pin.XYZQUATToSE3(q[:7]).act(x_1))
    q, v, _ = forced.project(model, q, v, 0.0, [joined, Weld(1, x_1, 2, x_2)])
    now = forced.acceleration(model, q, v, 0.0, [], [joined, Weld(1, x_1, 2, x_2)])
    data = model.createData()
    pin.computeCentroidalMomentumTimeVariation(model, data, q, v, now.a)
    weight = 3.0 * np.array([0.0, 0.0, -9.81])
    assert np.abs(data.dhg.linear - weight - now.multipliers[:3]).max() <= 1e-12
    centre = pin.centerOfMass(model, model.createData(), q)
    turn = np.cross(Motion(model, q).point((1, (0.3, 0.0, 0.0))).value - centre, now.multipliers[:3])
    assert np.abs(data.dhg.angular - turn).max() <= 1e-11


def test_welded_bodies_fly_as_one():
    model, one = pin.Model(), pin.Model()
    x = pin.SE3(pin.exp3(np.array([0.3, -0.8, 0.4])), np.array([0.5, 0.1, -0.2]))
    parts = [pin.Inertia(m, np.array([0.1, 0.0, 0.2]), np.diag([0.3, 0.4, 0.5])) for m in (1.0, 2.0)]
    for name, inertia in zip("ab", parts, strict=True):
        model.appendBodyToJoint(
            model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name), inertia, pin.SE3.Identity()
        )
    one.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "both")
    one.appendBodyToJoint(1, parts[0] + x.act(parts[1]), pin.SE3.Identity())
    twist = np.array([0.5, -0.2, 1.0, 2.0, -1.0, 1.5])
    second = x.actInv(pin.Motion(twist)).vector
    q = np.concatenate([pin.neutral(one), pin.SE3ToXYZQUAT(x)])
    times = np.linspace(0.0, 1.0, 5)
    weld = Weld(1, x, 2, pin.SE3.Identity())
    run = forced.solve(model, q, np.concatenate([twist, second]), times, (), [weld])
    single = forced.solve(one, pin.neutral(one), twist, times)
    assert np.abs(run.q[:, :7] - single.q).max() <= 1e-10
    assert np.abs(run.v[:, :6] - single.v).max() <= 1e-10
    assert run.drift <= 1e-11
    assert np.abs(run.imbalance()).max() <= 1e-10


def test_bead_on_a_polynomial_wire():
    """z = c2 x^2 + c3 x^3 with f(x) that height: (1 + f'^2) x'' + f' f'' x'^2 + g f' = 0."""
    model, wire = pin.Model(), np.polynomial.Polynomial([0.0, 0.0, 0.8, 0.3])
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(z, pin.Inertia(1.3, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())

    def rhs(_t, y):
        d1, d2 = wire.deriv(1)(y[0]), wire.deriv(2)(y[0])
        return [y[1], -(d1 * d2 * y[1] ** 2 + 9.81 * d1) / (1.0 + d1 * d1)]

    run = forced.solve(model, [0.5, wire(0.5)], [0.0, 0.0], [0.0, 1.0], (), [JointPolynomial(z, x, wire.coef)])
    exact = solve_ivp(rhs, (0.0, 1.0), [0.5, 0.0], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    assert abs(run.q[-1, 0] - exact[0]) <= 1e-10
    assert abs(run.v[-1, 0] - exact[1]) <= 1e-10


def test_a_contradiction_is_told():
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    both = [Prescribed(1, constant(0.0)), Prescribed(1, sine(1.0, 1.0))]
    assert forced.acceleration(model, np.zeros(1), np.ones(1), 0.5, (), both).misfit >= 0.1
    with pytest.raises(ArithmeticError, match="the constraints are left by"):
        forced.solve(model, np.zeros(1), np.zeros(1), [0.5, 1.0], (), both)
