"""The oracles against exact arithmetic, differences, closed forms and each other; the engine is not needed."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest

from batteries.models import CASES, SMALL, case, double_pendulum, springs_of
from helpers import laws
from oracles import blocks, closed_forms, ctec_oracle, momentum_maps, problem_b, so3
from oracles.del_step import System
from oracles.modified_energy import modified_energy
from oracles.smooth import flow
from oracles.split import SplitModel

EPS = np.finfo(float).eps
LIE = [case(n) for n in ("joint_planar", "joint_free_flyer", "joint_spherical", "arm_spherical")]


def by_name(cases):
    return pytest.mark.parametrize("case", cases, ids=lambda c: c.name)


def long(case):
    """A case that takes too long for every run; a smaller one stands beside it."""
    return pytest.param(case, marks=pytest.mark.long)


# --- SO(3) ---------------------------------------------------------------------------------------------------
def exact_right_jacobian(phi):
    """sum (-hat)^k / (k+1)! in rational numbers, terms below 1e-30 dropped."""
    x = [[Fraction(float(a)) for a in row] for row in so3.hat(phi)]
    term = [[Fraction(int(i == j)) for j in range(3)] for i in range(3)]
    total = [row[:] for row in term]
    for k in range(1, 60):
        term = [[-sum(term[i][m] * x[m][j] for m in range(3)) / (k + 1) for j in range(3)] for i in range(3)]
        # 200-bit rounding keeps the fractions short; far below double precision
        term = [[Fraction(round(a * 2**200), 2**200) for a in row] for row in term]
        total = [[total[i][j] + term[i][j] for j in range(3)] for i in range(3)]
    return total


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-5, 3e-4, 1e-2, 0.3, 0.499, 0.501, 1.0, 3.0])
def test_so3_jacobians_are_exact_to_rounding(angle):
    phi = angle * np.array([2.0, -1.0, 2.0]) / 3.0
    exact = exact_right_jacobian(phi)
    exact = np.array(exact, dtype=object)  # NumPy then computes in Fractions
    rational = np.vectorize(lambda a: Fraction(float(a)), otypes=[object])
    assert np.abs((exact - rational(so3.right_jacobian(phi))).astype(float)).max() <= 8 * EPS
    product = exact @ rational(so3.right_jacobian_inverse(phi))
    assert np.abs((product - np.eye(3, dtype=int)).astype(float)).max() <= 32 * EPS
    assert np.abs(so3.exp(phi) - pin.exp3(phi)).max() <= 8 * EPS
    assert np.abs(so3.quat_log(so3.quat_exp(phi)) - phi).max() <= 8 * EPS * max(angle, EPS)


# --- the split model and the Lagrangian ------------------------------------------------------------------------
@by_name(CASES)
def test_split_model_is_the_same_mechanism(case):
    model = case.model()
    split, (q, v) = SplitModel(model), case.state(model)
    d, s = model.createData(), split.data
    pin.forwardKinematics(model, d, q, v)
    pin.forwardKinematics(split.model, s, q, split.tangent_map(q) @ v)
    for i in range(1, model.njoints):
        a, b = split.last[i], i
        assert np.abs(s.oMi[a].homogeneous - d.oMi[b].homogeneous).max() <= 64 * EPS
        assert np.abs(s.v[a].vector - d.v[b].vector).max() <= 256 * EPS * (1 + np.abs(d.v[b].vector).max())
    t, system = split.tangent_map(q), System(model)
    m = laws.mass_matrix(model, q)
    assert np.abs(t.T @ system.mass_matrix(q) @ t - m).max() <= 256 * EPS * np.abs(m).max()
    w = 1e-3 * v
    assert np.abs(split.difference(q, split.integrate(q, w)) - w).max() <= 16 * EPS
    # to first order both retractions agree: second difference, so 1e-10 at 1e-5 rad
    near = pin.difference(model, q, split.integrate(q, 1e-5 * t @ v))
    assert np.abs(near - 1e-5 * v).max() <= 1e-9 * (1 + case.speed) ** 2


def difference(f, split, q, eps=1e-3):
    """Tangent gradient of a scalar f(q), sixth order."""
    out = np.zeros(split.nv)
    for i in range(split.nv):
        e = np.eye(split.nv)[i]
        out[i] = sum(w * f(split.integrate(q, s * eps * e)) for s, w in laws._STENCIL) / eps
    return out


@by_name(SMALL)
@pytest.mark.thinned(3)
def test_dynamics_are_the_gradient_of_the_lagrangian(case):
    model = case.model()
    system = System(model, **springs_of(model, np.random.default_rng(1)))
    q, v = case.state(model)
    _, dt_dq, g = system.dynamics(q, v)
    # rounding of an energy of order 10 over eps = 1e-3
    tol = 1e-10
    assert np.abs(dt_dq - difference(lambda x: system.energy(x, v)[0], system.split, q)).max() <= tol
    gradient = difference(lambda x: system.energy(x, v)[1], system.split, q)
    assert np.abs(g - system.spring_force(q) - gradient).max() <= tol
    rows = [difference(lambda x, i=i: -system.spring_force(x)[i], system.split, q) for i in range(model.nv)]
    assert np.abs(system.spring_stiffness(q) - rows).max() <= tol


# --- the step ----------------------------------------------------------------------------------------------------
@by_name(SMALL)
def test_step_is_the_discrete_legendre_transform(case):
    """p0 = -D1 L_d and p1 = D2 L_d by differences of L_d(q0, q1) itself: no Jacobian of exp, no Coriolis matrix."""
    model, h = case.model(), 0.02
    spring = springs_of(model, np.random.default_rng(2))
    system = System(model, stiffness=spring["stiffness"], rest=spring["rest"])
    split = system.split
    q0, v0 = case.state(model)
    p0 = system.momentum(q0, v0)
    q1, p1 = system.step(q0, p0, h)

    def discrete(a, b):
        v = split.difference(a, b) / h
        t, u = system.energy(split.integrate(a, 0.5 * h * v), v)
        return h * (t - u)

    minus = difference(lambda x: discrete(x, q1), split, q0)
    plus = difference(lambda x: discrete(q0, x), split, q1)
    # a step of 1e-3 in q1 is a velocity of 0.05: sixth-order differences leave about 1e-10
    assert np.abs(-minus - split.tangent_map(q0) @ p0).max() <= 1e-9
    assert np.abs(plus - split.tangent_map(q1) @ p1).max() <= 1e-9
    assert np.abs(system.residual(q0, p0, q1, p1, h)).max() <= 1e-11


@by_name(LIE)
def test_step_is_symplectic(case):
    model = case.model()
    system, (q, v) = System(model), case.state(model)
    defect = laws.symplectic_defect(model, lambda a, b: system.step(a, b, 0.02), q, system.momentum(q, v))
    assert defect <= 1e-10


@by_name([case("joint_planar"), case("arm_spherical"), long(case("tree"))])
def test_step_has_order_two_with_springs_damping_and_input(case):
    model, duration = case.model(), 0.2
    rng = np.random.default_rng(3)
    system, (q, v) = System(model, **springs_of(model, rng)), case.state(model)
    tau = rng.uniform(-1, 1, model.nv)
    reference = flow(system, q, v, duration, tau)
    errors = []
    for n in (20, 40, 80):
        a, b = laws.run(lambda x, y, n=n: system.step(x, y, duration / n, tau), q, system.momentum(q, v), n)
        errors.append(laws.distance(model, (a, system.velocity(a, b)), reference))
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.05


@by_name([case("free_body"), long(case("pair"))])
def test_step_keeps_the_momentum_maps(case):
    model = case.model()
    model.gravity = pin.Motion.Zero()
    system, (q, v) = System(model), case.state(model)
    p = system.momentum(q, v)
    start = momentum_maps.spatial_momentum(model, q, p)
    assert np.abs(start - momentum_maps.spatial_momentum_from_velocity(model, q, v)).max() <= 1e3 * EPS
    for h in (1e-2, 1e-5):
        q1, p1 = laws.run(lambda a, b, h=h: system.step(a, b, h), q, p, 50)
        assert np.abs(momentum_maps.spatial_momentum(model, q1, p1) - start).max() <= 1e-12


@by_name([case("joint_helical_unaligned"), case("free_body"), case("arm_spherical"), long(case("tree"))])
def test_modified_energy_varies_with_h_to_the_fourth(case):
    model = case.model()
    spring = springs_of(model, np.random.default_rng(4))
    system = System(model, stiffness=spring["stiffness"], rest=spring["rest"])
    q, v = case.state(model)
    variation = {}
    for n in (20, 40, 80):
        h, a, b = 0.4 / n, q, system.momentum(q, v)
        plain, modified = [], []
        for _ in range(10):  # the same times for every h, so that only the amplitude differs
            plain.append(system.energy(a, system.split.tangent_map(a) @ system.velocity(a, b)).sum())
            modified.append(modified_energy(system, a, b, h))
            a, b = laws.run(lambda x, y, h=h: system.step(x, y, h), a, b, n // 10)
        variation[n] = np.ptp(plain), np.ptp(modified)
    rates = laws.orders([variation[n] for n in (20, 40, 80)])
    assert np.abs(rates[:, 0] - 2).max() <= 0.1
    assert np.abs(rates[:, 1] - 4).max() <= 0.2


def test_modified_energy_of_the_harmonic_oscillator():
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(1, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    system, q, p, h = System(model, stiffness=[0, 8.0], rest=[0.0]), np.array([0.3]), np.array([0.7]), 0.1
    plain = 0.5 * p[0] ** 2 / 2 + 0.5 * 8 * q[0] ** 2
    assert modified_energy(system, q, p, h) == pytest.approx(plain * (1 - h * h * 4 / 12), rel=8 * EPS)


def test_smooth_flow_of_a_pendulum_has_the_elliptic_period():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(1, pin.Inertia(1.3, np.array([0.0, 0.0, -0.7]), np.zeros((3, 3))), pin.SE3.Identity())
    period = 2 * closed_forms.pendulum_wall_period(1.0, length=0.7)
    q, v = flow(System(model), np.array([1.0]), np.zeros(1), period, rtol=1e-13)
    assert abs(q[0] - 1.0) <= 1e-10
    assert abs(v[0]) <= 1e-10


# --- impacts and closed forms ------------------------------------------------------------------------------------
def test_problem_b_reproduces_the_known_numbers():
    run = problem_b.run(3.0)
    times, gammas, impulses = (np.array([i[k] for i in run.impacts]) for k in range(3))
    assert np.abs(times - [0.656671045, 2.017056240]).max() <= 1e-9  # the digits printed
    assert np.abs(gammas - [-1.844474252, -1.025804628]).max() <= 2e-9
    assert np.abs(impulses - [3.691654896, 2.131421633]).max() <= 2e-9
    assert np.abs(run.q - [0.3205793585, -0.2173609757]).max() <= 2e-10
    assert np.abs(run.w - [-1.1276643332, 1.2653022812]).max() <= 2e-10
    energies = [problem_b.energy(i[3], w) for i in run.impacts for w in (i[4], i[5])] + [problem_b.energy(run.q, run.w)]
    assert np.abs(np.array(energies) - problem_b.energy(np.array(problem_b.START), np.zeros(2))).max() <= 1e-11


def test_problem_b_in_absolute_angles_is_the_pin_double_pendulum():
    model, change = double_pendulum(), np.array([[1.0, 0.0], [-1.0, 1.0]])  # relative = change @ absolute
    q, w = np.array([0.3, 0.5]), np.array([1.0, -2.0])
    m = change.T @ laws.mass_matrix(model, change @ q) @ change
    assert np.abs(m - problem_b.mass_matrix(q)).max() <= 16 * EPS
    a = pin.aba(model, model.createData(), change @ q, change @ w, np.zeros(2))
    assert np.abs(a - change @ problem_b.acceleration(q, w)).max() <= 256 * EPS


def test_ctec_oracle_gives_problem_b_first_impulse():
    model, change = double_pendulum(), np.array([[1.0, 0.0], [-1.0, 1.0]])
    _, gamma, impulse, q, w, w_plus = problem_b.run(1.0).impacts[0]
    q_rel, p = change @ q, laws.mass_matrix(model, change @ q) @ change @ w
    tip = np.array([problem_b.tip_gap(q), 0.0, -np.cos(q).sum()])
    pairs = [
        ctec_oracle.gap_gradient(model, q_rel, lambda x: np.sin(x[0]) + np.sin(x[0] + x[1])),
        ctec_oracle.point_gradient(model, q_rel, 0, tip, 2, tip, np.array([1.0, 0.0, 0.0])),
    ]
    for gradient in pairs:
        hit = ctec_oracle.impact(model, q_rel, p, gradient, 1.0)
        assert abs(hit.gamma_minus - gamma) <= 1e-12
        assert abs(hit.impulse - impulse) <= 1e-12
        v_plus = np.linalg.solve(laws.mass_matrix(model, q_rel), hit.p_plus)
        assert np.abs(v_plus - change @ w_plus).max() <= 1e-11


def test_gap_gradient_by_coal_is_the_jacobian():
    import coal

    case_ = case("tree")
    model = case_.model()
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("ball", 5, pin.SE3.Identity(), coal.Sphere(0.1)))
    geometry.addGeometryObject(pin.GeometryObject("ground", 0, pin.SE3.Identity(), coal.Halfspace(0.0, 0.0, 1.0, -3.0)))
    geometry.addCollisionPair(pin.CollisionPair(1, 0))
    q, _ = case_.state(model)
    gap = ctec_oracle.geometry_gap(model, geometry, 0)
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    centre = data.oMi[5].translation
    assert abs(gap(q) - (centre[2] + 3.0 - 0.1)) <= 64 * EPS
    w = ctec_oracle.point_gradient(model, q, 0, centre, 5, centre, np.array([0.0, 0.0, 1.0]))
    # differences over 1e-3 rad of a gap of 3 m: rounding 1e-12
    assert np.abs(ctec_oracle.gap_gradient(model, q, gap) - w).max() <= 1e-11


def test_bouncing_ball_numbers():
    ball = closed_forms.BouncingBall(1.0, 0.9)
    assert ball.first == pytest.approx(0.4515236410, abs=5e-11)
    assert ball.zeno_time() == pytest.approx(8.5789491787, abs=5e-11)
    assert closed_forms.BouncingBall(1.0, 0.5).zeno_time() == pytest.approx(1.354571, abs=5e-7)
    t = ball.impact_times(6)
    assert max(abs(ball.height(x)) for x in t) <= 64 * EPS
    assert ball.height(0.5 * (t[1] + t[2])) == pytest.approx(ball.apex(2), rel=64 * EPS)
    assert ball.impact_times(400)[-1] == pytest.approx(ball.zeno_time(), rel=1e-15)


@pytest.mark.parametrize(("theta", "period"), [(0.5, 1.0189339576), (1.0, 1.0695688003), (1.5, 1.1654933911)])
def test_pendulum_wall_numbers(theta, period):
    assert closed_forms.pendulum_wall_period(theta) == pytest.approx(period, abs=5e-11)


@pytest.mark.parametrize(
    ("degrees", "v", "w"), [(0, -0.5, 3), (30, -0.384615, 3.197632), (45, -0.2, 3.394113), (60, 0.142857, 3.428571)]
)
def test_rod_numbers(degrees, v, w):
    theta = math.radians(degrees)
    impulse, v_com, omega = closed_forms.rod_impact(theta)
    assert impulse == pytest.approx(2 / (1 + 3 * math.cos(theta) ** 2), rel=8 * EPS)
    assert v_com == pytest.approx(v, abs=5e-7)
    assert omega == pytest.approx(w, abs=5e-7)
    assert 0.5 * v_com**2 + omega**2 / 24 == pytest.approx(0.5, rel=16 * EPS)


@pytest.mark.parametrize(("k", "count"), [(0, 3), (1, 31), (2, 314)])
def test_block_collisions_count_the_digits_of_pi(k, count):
    hits = blocks.collisions(k)
    assert len(hits) == count
    assert all(h.light**2 + 100**k * h.heavy**2 == 100**k for h in (hits[0], hits[count // 2], hits[-1]))
    assert [h.kind for h in hits[:3]] == ["blocks", "wall", "blocks"]
