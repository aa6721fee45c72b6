"""The oracles of the Gauss step and of its impacts against the midpoint oracle, differences and DOP853."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin
import pytest

from batteries.models import SMALL, case, double_pendulum, springs_of
from helpers import laws
from oracles import gauss_impacts, momentum_maps, problem_b, so3
from oracles.del_step import System
from oracles.gauss_step import GaussStep, gauss_table, right_jacobian_derivative
from oracles.smooth import flow

EPS = np.finfo(float).eps
LIE = ("joint_planar", "joint_free_flyer", "joint_spherical", "arm_spherical")


def by_name(*names):
    return pytest.mark.parametrize("case", [case(n) for n in names], ids=lambda c: c.name)


def system_of(model, conservative=False, seed=7):
    """System with random springs, and damping unless it has to be conservative."""
    extra = springs_of(model, np.random.default_rng(seed))
    if conservative:
        extra.pop("damping")
    return System(model, **extra)


# --- the table and the Jacobian's derivative ----------------------------------------------------------------------
@pytest.mark.parametrize("s", range(1, 9))
def test_table_is_collocation_at_gauss_points(s):
    c, b, a = gauss_table(s)
    for k in range(1, s + 1):  # C(s): int_0^c x^(k-1)
        assert np.abs(a @ c ** (k - 1) - c**k / k).max() <= 4 * EPS
    for k in range(1, 2 * s + 1):  # B(2s)
        assert abs(b @ c ** (k - 1) - 1 / k) <= 4 * EPS
    assert np.abs(b[:, None] * a + (b[:, None] * a).T - np.outer(b, b)).max() <= 2 * EPS  # symplectic


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-2, 0.7, 0.999, 1.001, 2.0, 4.0])
def test_derivative_of_the_right_jacobian(angle):
    phi, d, eps = angle * np.array([2.0, -1.0, 2.0]) / 3.0, np.array([1.0, 0.3, -2.0]), 1e-3
    by_differences = sum(w / eps * so3.right_jacobian(phi + k * eps * d) for k, w in laws._STENCIL)
    # rounding 4 eps over 1e-3
    assert np.abs(by_differences - right_jacobian_derivative(phi, d)).max() <= 1e-12


@pytest.mark.parametrize("angle", [0.1, 2.5])
def test_chart_force_is_the_one_with_ad_star(angle):
    """(d(J X')/dX)^T p = J'(X, X')^T p + J^T ad*_v p, v = J X': both ways to write the stage equations."""
    rng = np.random.default_rng(1)
    x, rate, p = (rng.normal(size=3) for _ in range(3))
    x *= angle / np.linalg.norm(x)
    j = so3.right_jacobian(x)
    one = np.array([right_jacobian_derivative(x, e) @ rate for e in np.eye(3)]) @ p
    other = right_jacobian_derivative(x, rate).T @ p + j.T @ np.cross(p, j @ rate)
    assert np.abs(one - other).max() <= 32 * EPS


# --- the step -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("case", SMALL, ids=lambda c: c.name)
def test_one_stage_is_the_midpoint_step(case):
    model = case.model()
    system, (q, v) = system_of(model), case.state(model)
    p, tau = system.momentum(q, v), np.random.default_rng(1).uniform(-1, 1, model.nv)
    for a, b in zip(system.step(q, p, case.h, tau), GaussStep(system, 1).step(q, p, case.h, tau), strict=True):
        assert np.abs(a - b).max() <= 1e-13 * (1 + np.abs(a).max())


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("name", "s"), [*((n, 3) for n in LIE), ("arm_spherical", 5), ("tree", 2)])
def test_step_is_the_discrete_legendre_transform(name, s):
    """p0 = -D1 L_d, p1 = D2 L_d, L_d stationary in its stages: differences of the discrete action alone."""
    model, h = case(name).model(), 0.1
    system = system_of(model, conservative=True)
    split, gauss = system.split, GaussStep(system, s)
    q0, v0 = case(name).state(model)
    p0 = split.tangent_map(q0) @ system.momentum(q0, v0)
    done = gauss.split_step(q0, p0, h)

    def action(a, b, rates):
        """h sum b_i L over the rates (s, nv), moved evenly so that the polynomial ends in b."""
        rates = rates + (split.difference(a, b) - h * gauss.b @ rates) / h
        total, eps = 0.0, 1e-3
        for weight, x, r in zip(gauss.b, h * gauss.a @ rates, rates, strict=True):
            q = split.integrate(a, x)
            # velocity by differences too: no Jacobian of exp
            v = sum(
                w / eps * split.difference(q, split.integrate(a, x + k * eps * r / (1 + np.abs(r).max())))
                for k, w in laws._STENCIL
            ) * (1 + np.abs(r).max())
            kinetic, potential = system.energy(q, v)
            total += h * weight * (kinetic - potential)
        return total

    def gradient(f, n, eps=1e-2):
        return np.array([sum(w / eps * f(k * eps * e) for k, w in laws._STENCIL) for e in np.eye(n)])

    minus = gradient(lambda w: action(split.integrate(q0, w), done.q1, done.rates), model.nv)
    plus = gradient(lambda w: action(q0, split.integrate(done.q1, w), done.rates), model.nv)
    inner = gradient(lambda w: action(q0, done.q1, done.rates + w.reshape(done.rates.shape)), done.rates.size)
    # 1e-2 rad in q1 is a velocity of 0.1; the velocities' own differences leave 1e-12: about 1e-9 is what can be seen
    assert np.abs(-minus - p0).max() <= 1e-8
    assert np.abs(plus - done.p1).max() <= 1e-8
    assert np.abs(inner).max() <= 1e-9


@by_name("joint_planar", "arm_spherical", "tree")
@pytest.mark.parametrize(("s", "numbers"), [(2, (20, 40)), (3, (10, 20)), (4, (6, 12)), (8, (2, 3))])
@pytest.mark.slow
def test_step_has_order_two_s_with_springs_damping_and_input(case, s, numbers):
    model, duration = case.model(), 0.4
    system, (q, v) = system_of(model), case.state(model)
    tau = np.random.default_rng(3).uniform(-1, 1, model.nv)
    reference = flow(system, q, v, duration, tau, rtol=1e-13)
    gauss, errors = GaussStep(system, s), []
    for n in numbers:
        a, b = laws.run(lambda x, y, n=n: gauss.step(x, y, duration / n, tau), q, system.momentum(q, v), n)
        errors.append(laws.distance(model, (a, system.velocity(a, b)), reference))
    if s == 8:  # two steps are enough for the rounding of the reference
        assert errors[0] <= 1e-9
        assert errors[1] <= 1e-11
    else:
        assert laws.orders(errors)[0] == pytest.approx(2 * s, abs=0.35), errors


@pytest.mark.parametrize(("name", "s"), [*((n, 2) for n in LIE), ("joint_planar", 8), ("joint_spherical", 6)])
@pytest.mark.slow
def test_step_is_symplectic(name, s):
    model = case(name).model()
    system, (q, v) = system_of(model, conservative=True), case(name).state(model)
    gauss = GaussStep(system, s)
    assert laws.symplectic_defect(model, lambda a, b: gauss.step(a, b, 0.05), q, system.momentum(q, v)) <= 1e-11


@by_name("free_body", "pair")
@pytest.mark.thinned(2)
@pytest.mark.parametrize("s", [2, 5])
def test_step_keeps_the_momentum_maps(case, s):
    model = case.model()
    model.gravity = pin.Motion.Zero()
    system, (q, v) = System(model), case.state(model)
    p, gauss = system.momentum(q, v), GaussStep(system, s)
    start = momentum_maps.spatial_momentum(model, q, p)
    for h in (0.1, 1e-4):
        q1, p1 = laws.run(lambda a, b, h=h: gauss.step(a, b, h), q, p, 10)
        assert np.abs(momentum_maps.spatial_momentum(model, q1, p1) - start).max() <= 1e-12


def test_reversible_where_the_chart_is_a_vector_space_and_nearly_on_rotations():
    """Polynomials of degree s >= 2 in the chart at q0 are none in the chart at q1, except on commuting joints."""
    for name, s, tolerance in (("joint_planar", 4, 1e-14), ("joint_helical_x", 2, 1e-14), ("free_body", 1, 1e-14)):
        assert back_and_forth(name, s, 0.05) <= tolerance
    defects = [back_and_forth("free_body", 2, h) for h in (0.08, 0.04, 0.02)]
    # of two steps h and -h of a method of order 2s only the even power h^(2s+2) remains
    assert np.abs(laws.orders(defects) - 6.0).max() <= 0.1
    assert back_and_forth("free_body", 4, 0.04) <= 1e-14


def back_and_forth(name, s, h):
    model = case(name).model()
    system, (q, v) = system_of(model, conservative=True), case(name).state(model)
    p, gauss = system.momentum(q, v), GaussStep(system, s)
    return laws.distance(model, gauss.step(*gauss.step(q, p, h), -h), (q, p))


@by_name("arm_spherical", "forest")
def test_energy_of_the_stages_is_of_order_two_s(case):
    """E_d = sum b_i E_i is the mean of H over the step: superconvergent, where single stages are of order s + 1."""
    model = case.model()
    system, (q, v) = system_of(model, conservative=True), case.state(model)
    p, gauss = system.momentum(q, v), GaussStep(system, 3)
    exact = system.energy(q, system.split.tangent_map(q) @ v).sum()
    errors = [abs(gauss.discrete_energy(q, p, h) - exact) for h in (0.04, 0.02)]
    assert laws.orders(errors)[0] == pytest.approx(6.0, abs=0.3)


def test_stiff_spring_and_damper_follow_the_gauss_approximant():
    """On x' = v, m v' = -k x - d v the step is R(h A), R the diagonal Pade approximant of exp."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(1, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    h, k, d = 0.1, 4e6, 500.0
    system = System(model, stiffness=[0, k], rest=[0.0], damping=[d])
    matrix = h * np.array([[0.0, 0.5], [-k, -0.5 * d]])  # on (q, p)
    coefficients = {2: (1, 1 / 2, 1 / 12), 3: (1, 1 / 2, 1 / 10, 1 / 120)}
    for s, terms in coefficients.items():
        top, bottom = (sum(c * np.linalg.matrix_power(z, i) for i, c in enumerate(terms)) for z in (matrix, -matrix))
        wanted = np.linalg.solve(bottom, top) @ [0.3, 0.7]
        q1, p1 = GaussStep(system, s).step(np.array([0.3]), np.array([0.7]), h)
        assert abs(q1[0] - wanted[0]) <= 1e-12
        assert p1[0] == pytest.approx(wanted[1], rel=1e-11)


@by_name("arm_spherical", "forest")
def test_residual_of_a_solved_step_is_rounding(case):
    model = case.model()
    system, (q, v) = system_of(model), case.state(model)
    p, gauss, tau = system.momentum(q, v), GaussStep(system, 4), np.random.default_rng(3).uniform(-1, 1, model.nv)
    done = gauss.solve(q, p, 0.05, tau)
    p1 = system.split.tangent_map(done.q1).T @ done.p1
    for part in gauss.residual(q, p, 0.05, done.v, done.q1, p1, tau):
        assert np.abs(part).max() <= 1e-13 * (1 + np.abs(p).max())
    worse = gauss.residual(q, p, 0.05, done.v + 1e-6, done.q1, p1, tau)
    assert max(np.abs(part).max() for part in worse) >= 1e-8  # it sees what is wrong


# --- impacts --------------------------------------------------------------------------------------------------------
ABSOLUTE = np.array([[1.0, 0.0], [1.0, 1.0]])  # absolute = ABSOLUTE @ relative angles


@functools.cache
def bounce(s, h, method, steps=None, e=1.0):
    """Problem B in relative angles."""
    gauss = GaussStep(System(double_pendulum()), s)
    return gauss_impacts.run(
        gauss,
        lambda q: problem_b.tip_gap(ABSOLUTE @ q),
        lambda q: problem_b.gap_gradient(ABSOLUTE @ q) @ ABSOLUTE,
        np.array([0.3, 0.2]),
        np.zeros(2),
        h,
        steps or round(3.0 / h),
        method,
        e,
    )


def test_problem_b_is_good_to_1e_13():
    """DOP853 with located events against Gragg's extrapolation in long double, whose own two steps agree to 1e-15."""
    (y, times), (finer, _) = gauss_impacts.precise_problem_b(), gauss_impacts.precise_problem_b(h=0.01)
    assert np.abs(y - finer).max() <= 1e-15
    run = problem_b.run(3.0)
    assert np.abs(np.concatenate([run.q, run.w]) - y).max() <= 5e-14
    assert np.abs(np.array([i[0] for i in run.impacts]) - times).max() <= 5e-15


@pytest.mark.thinned(3)
@pytest.mark.parametrize("method", gauss_impacts.METHODS)
def test_problem_b_with_one_stage_has_the_known_orders(method):
    """From h = 0.04 to 0.02 the orders are 1.96 for CTEC and MHC, 2.12 for DTEC."""
    exact = problem_b.run(3.0).q
    errors = [np.linalg.norm(ABSOLUTE @ bounce(1, h, method)[0][-1] - exact) for h in (0.04, 0.02)]
    assert laws.orders(errors)[0] == pytest.approx(2.12 if method == "dtec" else 1.96, abs=0.006)


@pytest.mark.parametrize("method", gauss_impacts.METHODS)
@pytest.mark.parametrize(("s", "steps"), [(6, (0.2, 0.075))])
@pytest.mark.slow
def test_problem_b_keeps_order_two_s_across_impacts(method, s, steps):
    exact, errors = problem_b.run(3.0).q, []
    for h in steps:
        qs, _, hits = bounce(s, h, method)
        assert len(hits) == 2
        errors.append(np.linalg.norm(ABSOLUTE @ qs[-1] - exact))
    # the place of the impact in its step changes the constant: about one order over a factor of three
    slope = np.log(errors[0] / errors[1]) / np.log(steps[0] / steps[1])
    assert slope == pytest.approx(2 * s, abs=1.0), errors


@pytest.mark.parametrize("e", [1.0, 0.6])
def test_each_map_keeps_its_scalar(e):
    """At h = 0.15 and s = 3 the three scalars differ by far more than rounding."""
    gauss = GaussStep(System(double_pendulum()), 3)
    h, energies, discrete = 0.15, {}, {}
    for method in gauss_impacts.METHODS:
        qs, ps, hits = bounce(3, h, method, 6, e)
        hit = hits[0]
        ends = [(qs[hit.step], ps[hit.step]), (qs[hit.step + 1], ps[hit.step + 1])]
        ends = [gauss_impacts.conserved(gauss, q, p, h) for q, p in ends]
        energies[method] = abs(ends[1] - ends[0] + hit.loss)
        before = gauss.discrete_energy(qs[hit.step], ps[hit.step], hit.before)
        discrete[method] = abs(gauss.discrete_energy(hit.q, hit.p_plus, hit.after) - before + hit.loss)
    assert energies["mhc"] <= 1e-13 < 1e-7 < min(energies["ctec"], energies["dtec"])
    assert discrete["dtec"] <= 1e-13 < 1e-7 < min(discrete["ctec"], discrete["mhc"])
