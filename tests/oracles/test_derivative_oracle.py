"""The oracles of derivatives against each other: closed forms, saltation, discrete differences, tensors, Pinocchio."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin
import pytest

from batteries.models import case, double_pendulum
from helpers import laws
from oracles import derivative_closed_forms as closed
from oracles import derivative_flow, derivative_trep, precise, problem_b
from oracles import derivative_step as discrete
from oracles.del_step import System
from oracles.derivative_saltation import ChainAtWall, Hybrid, sensitivity
from oracles.gauss_step import GaussStep
from oracles.smooth import flow

EPS = np.finfo(float).eps

# A double pendulum with everything, whose tip hits the wall after 0.0255 s.
FULL = {
    "masses": [1.3, 0.7],
    "lengths": [0.9, 1.1],
    "gravity": 9.81,
    "damping": [0.11, 0.23],
    "stiffness": [1.7, 0.6],
    "rest": [0.2, -0.1],
    "tau": [0.5, -0.4],
    "centres": [0.5, 0.6],
    "inertias": [0.08, 0.05],
    "wall": 0.1,
    "e": 0.6,
}
START = {"q0": [0.3, -0.42], "v0": [-1.1, 0.7]}
PARAMETERS = ("masses", "lengths", "gravity", "damping", "stiffness", "tau", "wall", "e")


def relative(a, b) -> float:
    """Largest difference over the largest number."""
    return float(np.abs(np.asarray(a) - b).max() / np.abs(b).max())


# --- closed forms -----------------------------------------------------------------------------------------------------
def ball_hybrid() -> Hybrid:
    """y = (z, v, e, g)."""
    return Hybrid(
        lambda y: np.array([y[1], -y[3], 0 * y[0], 0 * y[0]]),
        lambda y: y[0],
        lambda y: np.array([y[0], -y[2] * y[1], y[2], y[3]]),
    )


@pytest.mark.parametrize(("v0", "e"), [(0.0, 1.0), (0.4, 0.7), (-1.5, 0.5)])
def test_ball_by_saltation(v0, e):
    want = closed.bouncing_ball(1.0, v0, e, 9.81, 0.6)
    got = sensitivity(ball_hybrid(), [1.0, v0, e, 9.81], 0.6)
    assert relative([*got.y[:2], got.times[0]], want.values) <= 1e-13  # DOP853 is exact on a parabola but for rounding
    assert relative(np.vstack([got.dy_dy0[:2], got.dtimes_dy0]), want.derivative) <= 1e-13


@pytest.mark.parametrize("stages", [1, 3])
def test_ball_by_the_discrete_map(stages):
    """The Gauss steps of a parabola are exact: the discrete derivative is the continuous one, at every order."""
    x = {"q0": [1.0], "v0": [0.4], "mass": 2.0, "gravity": 9.81, "e": 0.7, "h": 0.15}
    want = closed.bouncing_ball(1.0, 0.4, 0.7, 9.81, 0.6)
    got = precise.differences(discrete.outcome(discrete.BALL, stages, 4), x, ["q0", "v0", "e", "gravity"])
    # four steps of .15 are .6 to rounding; the rest of the tolerance is the closed form's own rounding
    assert relative(got, want.derivative) <= 1e-14


def test_several_impacts_in_one_step():
    """Three bounces in a step of 1.2 s, with their times, against saltation: both are exact on parabolas."""
    x = {"q0": [1.0], "v0": [0.1], "mass": 2.0, "gravity": 9.81, "e": 0.5, "h": 1.2}
    got = precise.differences(discrete.outcome(discrete.BALL, 2), x, ["q0", "v0", "e", "gravity"])
    want = sensitivity(ball_hybrid(), [1.0, 0.1, 0.5, 9.81], 1.2)
    assert len(want.times) == 3
    assert relative(got, np.vstack([want.dy_dy0[:2], want.dtimes_dy0])) <= 1e-13


def test_two_equal_balls():
    """d x2 / d(x1, x2, v1, v2) = (1, 0, 1, 0) at t = 1, and t in general; x1 moves on as ball 2 would have."""
    known = closed.two_balls(0.0, 0.52, 1.0, 0.0, 0.2, 1.0)
    assert known.values[known.of.index("x2")] == pytest.approx(1.2, abs=4 * EPS)
    assert np.abs(known.derivative[1, :4] - [1, 0, 1, 0]).max() <= 4 * EPS
    assert np.abs(known.derivative[0, :4] - [0, 1, 0, 1]).max() <= 4 * EPS
    later = closed.two_balls(0.0, 0.52, 1.0, 0.0, 0.2, 1.7)
    assert np.abs(later.derivative[1, :4] - [1, 0, 1.7, 0]).max() <= 4 * EPS


def test_two_balls_of_any_masses_by_saltation():
    m1, m2, e = 1.3, 0.4, 0.6

    def reset(y):
        closing = (1 + y[4]) * (y[2] - y[3]) / (m1 + m2)
        return np.array([y[0], y[1], y[2] - m2 * closing, y[3] + m1 * closing, y[4]])

    balls = Hybrid(lambda y: np.array([y[2], y[3], 0 * y[0], 0 * y[0], 0 * y[0]]), lambda y: y[1] - y[0] - 0.2, reset)
    known = closed.two_balls(0.0, 0.52, 1.0, -0.3, 0.2, 1.0, e, m1, m2)
    got = sensitivity(balls, [0.0, 0.52, 1.0, -0.3, e], 1.0)
    assert relative(np.vstack([got.dy_dy0[:4], got.dtimes_dy0]), known.derivative) <= 1e-13  # straight lines: rounding


def test_oscillator_at_a_wall():
    x0, v0, omega, wall, e, t = 0.8, 0.3, 2.1, -0.35, 0.7, 1.6
    known = closed.oscillator_at_wall(x0, v0, omega, wall, e, t)
    hybrid = Hybrid(
        lambda y: np.array([y[1], -y[2] * y[2] * y[0], 0 * y[0], 0 * y[0], 0 * y[0]]),
        lambda y: y[0] - y[3],
        lambda y: np.array([y[0], -y[4] * y[1], y[2], y[3], y[4]]),
    )
    got = sensitivity(hybrid, [x0, v0, omega, wall, e], t)
    assert relative(np.vstack([got.dy_dy0[:2], got.dtimes_dy0]), known.derivative) <= 1e-11  # DOP853 at 1e-13
    x = {"q0": [x0], "v0": [v0], "omega": omega, "wall": wall, "e": e, "h": 0.2}
    names = ["q0", "v0", "omega", "wall", "e"]
    steps = precise.differences(discrete.outcome(discrete.OSCILLATOR, 6, 8), x, names)
    assert relative(steps, known.derivative) <= 1e-12  # order 12: (omega h)^12 = 3e-5 over 12! / .. is far below


@pytest.mark.thinned(2)
@pytest.mark.parametrize("theta0", [0.05, 1.0, 2.5])
def test_pendulum_at_a_stop(theta0):
    """Elliptic integrals against saltation of a chain of one link; small motion: t1 = pi/2 sqrt(l/g), no theta0."""
    length, g, e = 1.2, 9.81, 0.6
    known = closed.pendulum_at_stop(theta0, length, g, e)
    parameters = {"masses": [1.0], "lengths": [length], "gravity": g, "wall": 0.0, "e": e}
    pendulum = ChainAtWall(parameters, ["lengths", "gravity", "e"])
    got = pendulum.run([theta0], [0.0], 0.5 * (known.values[1] + known.values[0]) + 0.7 * np.diff(known.values[:2])[0])
    assert len(got.times) == 2
    columns = [0, 2, 3, 4]
    assert relative(got.dtimes_dy0[:, columns], known.derivative[:2]) <= 1e-11  # DOP853 at 1e-13
    if theta0 == 0.05:
        assert abs(known.at("t1", "theta0")) <= 0.2 * theta0 * known.values[0]  # t1 (1 + theta0^2/16)
        small = closed.oscillator_at_wall(theta0, 0.0, np.sqrt(g / length), 0.0, e, known.values[0] + 1e-3)
        assert abs(small.values[2] / known.values[0] - 1.0) <= theta0**2 / 15


@pytest.mark.parametrize("slope", [0.0, 0.3, -0.3])
def test_sliding_block_by_saltation(slope):
    """The stop is an event whose map changes the mode: y = (x, v, mu, g, slope, mode), mode 1 sliding, 0 at rest."""
    known = closed.sliding_block(1.7, 0.6, 9.81, slope)

    def rate(y):
        a = y[3] * (y[2] * np.cos(y[4]) + np.sin(y[4]))
        return y[5] * np.array([y[1], -a, 0, 0, 0, 0])

    block = Hybrid(rate, lambda y: y[1] + (1 - y[5]), lambda y: y * [1, 0, 1, 1, 1, 0])
    got = sensitivity(block, [0.0, 1.7, 0.6, 9.81, slope, 1.0], 2.0 * known.values[0])
    columns = slice(1, 5)
    assert relative(np.vstack([got.dtimes_dy0, got.dy_dy0[:1]])[:, columns], known.derivative) <= 1e-13  # a parabola
    assert np.abs(got.dy_dy0[1, columns]).max() <= 1e-13  # at rest whatever the start


def test_closed_forms_refuse_other_times():
    with pytest.raises(ValueError):
        closed.bouncing_ball(1.0, 0.0, 0.5, 9.81, 0.2)
    with pytest.raises(ValueError):
        closed.two_balls(0.0, 0.52, 1.0, 0.0, 0.2, 0.1)
    with pytest.raises(ValueError):
        closed.sliding_block(1.0, 0.1, 9.81, -0.5)


# --- saltation and the discrete map ---------------------------------------------------------------------------------
@pytest.mark.long
def test_saltation_of_problem_b():
    """State and times against oracles.problem_b; elastic, undamped: the derivative in (q, p) is symplectic."""
    parameters = {"masses": [1.0, 1.0], "lengths": [1.0, 1.0], "gravity": 9.81, "wall": 0.0, "e": 1.0}
    chain = ChainAtWall(parameters)
    got, want = chain.run([0.3, 0.2], [0.0, 0.0], 2.1), problem_b.run(2.1)
    assert np.abs(np.cumsum(got.y[:2]) - want.q).max() <= 1e-11  # both DOP853 at 1e-13
    assert len(got.times) == 2
    assert np.abs(got.times - [hit[0] for hit in want.impacts]).max() <= 1e-12
    # p = M(q) v: d(q, p) = [[1, 0], [d(M v)/dq, M]] d(q, v)
    ends = []
    for q, v in (([0.3, 0.2], [0.0, 0.0]), (got.y[:2], got.y[2:])):
        slope = precise.complex_jacobian(lambda q, v=v: chain.mass_matrix(q, chain.x) @ v, np.array(q))
        ends.append(np.block([[np.eye(2), np.zeros((2, 2))], [slope, chain.mass_matrix(np.array(q), chain.x)]]))
    a = ends[1] @ got.dy_dy0 @ np.linalg.inv(ends[0])
    omega = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    assert np.abs(a.T @ omega @ a - omega).max() <= 1e-11 * np.abs(a).max() ** 2


@functools.cache
def saltation_of_full(duration: float):
    """(state, derivative and event rows by (q0, v0, PARAMETERS)) in continuous time."""
    got = ChainAtWall(FULL, PARAMETERS).run(START["q0"], START["v0"], duration)
    assert len(got.times) == 1
    return np.vstack([got.dy_dy0[:4], got.dtimes_dy0])


def discrete_of_full(stages: int, steps: int, duration: float):
    x = {**FULL, **START, "h": duration / steps}
    run = discrete.outcome(discrete.PENDULUM, stages, steps)
    return precise.complex_differences(run, x, ["q0", "v0", *PARAMETERS])


@pytest.mark.long
def test_saltation_is_the_limit_at_high_order():
    """State, event time and all parameters at once: order 16 with steps of .075 s against DOP853 at 1e-13."""
    error = relative(discrete_of_full(8, 4, 0.3), saltation_of_full(0.3))
    assert error <= 2e-13  # measured 1e-14; with two steps 1e-10, the scheme's own error


@pytest.mark.long
@pytest.mark.parametrize(("stages", "steps"), [(1, 4), (2, 4), (3, 2)])
def test_the_discrete_derivative_has_the_order_of_the_scheme(stages, steps):
    """Through the impact, in every column: the discrete one differs from saltation by O(h^2s)."""
    errors = [relative(discrete_of_full(stages, n, 0.3), saltation_of_full(0.3)) for n in (steps, 4 * steps)]
    # n and 4 n, because the impact lies at the fractions .085 n of a step, .34 and .36; measured 1.9, 4.5, 7.9
    assert 0.5 * laws.orders(errors)[0] >= 2 * stages - 0.2, errors


def step_inputs(**more):
    return {**FULL, "q0": [0.3, -0.42], "p0": [-1.7, -0.5], "h": 0.1, **more}


@pytest.mark.parametrize("stages", [1, 2])
def test_complex_steps_and_differences_agree(stages):
    """Two ways to differentiate one run with an impact in its only step; the first is good to rounding."""
    run, x = discrete.outcome(discrete.PENDULUM, stages), step_inputs()
    names = ["q0", "p0", "h", *PARAMETERS]
    exact = precise.differences(run, x, names)
    assert exact.shape[0] == 5  # with the impact
    assert relative(precise.complex_differences(run, x, names), exact) <= 1e-12  # EPS times the condition of the event


@pytest.mark.parametrize("stages", [1, 2, 4])
def test_smooth_step_is_symplectic_in_sixty_digits(stages):
    """Without damping A^T J A = J, to the rounding of the floats that come out: a wrong a_ij or f breaks it."""
    x = step_inputs(damping=[0.0, 0.0], wall=-5.0)
    a = precise.differences(discrete.outcome(discrete.PENDULUM, stages), x, ["q0", "p0"])
    omega = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    assert np.abs(a.T @ omega @ a - omega).max() <= 16 * EPS * np.abs(a).max() ** 2


@pytest.mark.parametrize("stages", [1, 2])
def test_the_step_is_that_of_the_gauss_oracle(stages):
    """The same step by oracles.gauss_step on Pinocchio's model, with its damping and springs; and its derivative."""
    model, eps = double_pendulum(), 1e-3
    system = System(model, stiffness=[0.0, 2.0, 1.0], damping=[0.1, 0.3])
    x = {"q0": [0.3, 0.2], "p0": [-1.0, 0.4], "h": 0.05, "masses": [1.0, 1.0], "lengths": [1.0, 1.0], "gravity": 9.81}
    x |= {"damping": [0.1, 0.3], "stiffness": [2.0, 1.0], "tau": [0.3, -0.2], "wall": -5.0, "e": 1.0}
    run, other = discrete.outcome(discrete.PENDULUM, stages), GaussStep(system, stages)

    def step(q, p):
        return np.concatenate(other.step(q, p, 0.05, np.array([0.3, -0.2])))

    start = np.array([*x["q0"], *x["p0"]])
    assert np.abs(np.array(run(precise.as_floats(x)), dtype=float) - step(start[:2], start[2:])).max() <= 1e-13
    columns = []
    for e in np.eye(4):
        at = [(w / eps, start + k * eps * e) for k, w in laws._STENCIL]
        columns.append(sum(w * step(y[:2], y[2:]) for w, y in at))
    # sixth-order differences: EPS / eps, and eps^6
    assert np.abs(precise.differences(run, x, ["q0", "p0"]) - np.array(columns).T).max() <= 1e-11


# --- second derivatives -----------------------------------------------------------------------------------------------
def test_second_differences_are_symmetric_and_differences_of_the_first():
    """Through an impact: d2f(a, b) = d2f(b, a), and = d/ds of df(b) at x + s a, by differences."""
    run, x = discrete.outcome(discrete.PENDULUM, 2), step_inputs()
    one, two = {"q0": [0.3, -0.2], "tau": [1.0, 0.5]}, {"p0": [0.1, 0.4], "e": 0.3, "q0": [-0.2, 0.1]}
    second = precise.second_differences(run, x, one, two)
    assert relative(precise.second_differences(run, x, two, one), second) <= 4 * EPS
    eps, by_first = 1e-3, 0.0
    for k, w in laws._STENCIL:
        moved = {**x, **{n: (np.array(x[n]) + k * eps * np.array(d)).tolist() for n, d in one.items()}}
        first = precise.complex_differences(run, moved, list(two))
        by_first += w / eps * first @ np.concatenate([np.ravel(d) for d in two.values()])
    # complex steps good to 1e-13, over eps; sixth-order differences
    assert relative(by_first, second) <= 1e-9


@pytest.fixture(scope="module")
def tensors():
    x = step_inputs(wall=-5.0)
    return x, derivative_trep.derivatives(discrete.PENDULUM, x)


def test_tensors_against_differences(tensors):
    """The implicit function theorem on L_d against differences of the stage equations."""
    x, got = tensors
    run = discrete.outcome(discrete.PENDULUM, 1)
    assert relative(got.f, np.array(run(precise.as_floats(x)), dtype=float)) <= 8 * EPS
    assert relative(np.hstack([got.fdx, got.fdu]), precise.differences(run, x, ["q0", "p0", "tau"])) <= 4 * EPS
    rng = np.random.default_rng(2)
    for _ in range(3):
        a, b = ({n: rng.normal(size=2) for n in ("q0", "p0", "tau")} for _ in range(2))
        ax, bx = (np.concatenate([d["q0"], d["p0"]]) for d in (a, b))
        want = precise.second_differences(run, x, a, b)
        second = got.fdxdx @ bx @ ax + got.fdudu @ b["tau"] @ a["tau"]
        second += np.einsum("kab,a,b->k", got.fdxdu, ax, b["tau"]) + np.einsum("kab,a,b->k", got.fdxdu, bx, a["tau"])
        assert relative(second, want) <= 64 * EPS  # sums of some 30 products in floats


def test_tensors_are_symmetric_and_contract(tensors):
    _, got = tensors
    assert np.abs(got.fdxdx - got.fdxdx.transpose(0, 2, 1)).max() <= 4 * EPS * np.abs(got.fdxdx).max()
    z = np.array([1.0, -2.0, 0.5, 3.0])
    xx, xu, uu = got.contracted(z)
    assert [t.shape for t in (xx, xu, uu)] == [(4, 4), (4, 2), (2, 2)]
    assert relative(xu, np.einsum("k,kab->ab", z, got.fdxdu)) <= 8 * EPS
    assert all(np.abs(t).max() > 1e-6 for t in (xx, xu, uu))  # there is something to see


def test_where_trep_puts_the_force():
    """part = 0: from momenta lower by h F/2 trep's step ends at the same q1, again with p1 lower by that."""
    x = step_inputs(wall=-5.0, damping=[0.0, 0.0], stiffness=[0.0, 0.0])
    half = derivative_trep.derivatives(discrete.PENDULUM, x)
    kick = 0.5 * x["h"] * np.array(x["tau"])
    trep = derivative_trep.derivatives(discrete.PENDULUM, {**x, "p0": (np.array(x["p0"]) - kick).tolist()}, part=0.0)
    assert np.abs(trep.f - half.f + [0.0, 0.0, *kick]).max() <= 8 * EPS
    assert relative(trep.fdx, half.fdx) <= 32 * EPS  # the same step, only the momenta are shifted
    assert np.abs(trep.fdu - half.fdu).max() > 0.01


# --- Pinocchio's continuous derivatives -------------------------------------------------------------------------------
LIE = ("joint_free_flyer", "joint_spherical", "joint_planar", "joint_continuous_x", "arm_spherical", "joint_helical_x")


def state_of(model, seed=3, speed=1.0):
    """Random (q, v, tau)."""
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    return q, speed * rng.normal(size=model.nv), rng.normal(size=model.nv)


def test_flow_of_the_double_pendulum_is_that_of_saltation():
    """Pinocchio's ABA derivatives against the equations by hand, with damping and torques; no impact."""
    parameters = {"masses": [1.0, 1.0], "lengths": [1.0, 1.0], "gravity": 9.81, "wall": -5.0, "e": 1.0}
    tau, damping = np.array([0.5, -0.3]), np.array([0.2, 0.1])
    chain = ChainAtWall({**parameters, "tau": tau, "damping": damping}, ["tau"])
    got = derivative_flow.flow_linearisation(
        double_pendulum(), np.array([0.3, 0.2]), np.array([1.0, -2.0]), 1.0, tau, damping
    )
    want = chain.run([0.3, 0.2], [1.0, -2.0], 1.0)
    assert np.abs(np.concatenate([got.q, got.v]) - want.y[:4]).max() <= 1e-10
    assert relative(np.hstack([got.A, got.B]), want.dy_dy0[:4]) <= 1e-10  # DOP853 at 1e-12 over 1 s


@pytest.mark.parametrize("name", LIE)
def test_flow_linearisation_against_differences(name):
    """A and B in Pinocchio's tangent by sixth-order differences of oracles.smooth, retracted joint by joint."""
    model, eps, duration = case(name).model(), 1e-2, 0.2
    q, v, tau = state_of(model)
    got, system = derivative_flow.flow_linearisation(model, q, v, duration, tau), System(model)

    def end(w):
        a, b, c = np.split(w, 3)
        q1, v1 = flow(system, laws.retract(model, q, a), v + b, duration, tau + c, rtol=1e-13)
        return np.concatenate([laws.displacement(model, got.q, q1), v1 - got.v])

    rng = np.random.default_rng(4)
    for w in rng.normal(size=(2, 3 * model.nv)) / np.sqrt(model.nv):
        by_differences = sum(weight / eps * end(k * eps * w) for k, weight in laws._STENCIL)
        want = np.hstack([got.A, got.B]) @ w
        assert relative(by_differences, want) <= 1e-9  # DOP853 at 1e-12 over eps, eps^6 = 1e-12


@pytest.mark.parametrize("name", LIE)
def test_flow_linearisation_is_symplectic(name):
    """Without damping and torques, in (q, p): A keeps the canonical form of T*Q to the ODE's error."""
    model = case(name).model()
    q, v, *_ = state_of(model)
    got = derivative_flow.flow_linearisation(model, q, v, 0.3)
    start, last = (derivative_flow.to_momenta(model, *x) for x in ((q, v), (got.q, got.v)))
    a, n = last @ got.A @ np.linalg.inv(start), model.nv
    unit = np.eye(2 * n)
    before = laws.canonical_form(model, laws.mass_matrix(model, q) @ v, unit[:n], unit[n:])
    after = laws.canonical_form(model, laws.mass_matrix(model, got.q) @ got.v, a[:n], a[n:])
    assert np.abs(after - before).max() <= 1e-10 * np.abs(a).max() ** 2


def test_expm_at_an_equilibrium():
    """A hanging double pendulum with damping: the variational equations are linear with constant coefficients."""
    model, zero, damping = double_pendulum(), np.zeros(2), np.array([0.3, 0.1])
    got = derivative_flow.flow_linearisation(model, zero, zero, 0.7, None, damping)
    a, b = derivative_flow.discretised(model, zero, zero, 0.7, None, damping)
    assert relative(got.A, a) <= 1e-11
    assert relative(got.B, b) <= 1e-11


@pytest.mark.long
@pytest.mark.parametrize("stages", [1, 2])
@pytest.mark.parametrize("name", ["joint_free_flyer", "joint_spherical"])
def test_discrete_linearisation_tends_to_the_flow(name, stages):
    """A of the Gauss oracle's steps by differences, in (q, v), against the flow's: order 2s under halving of h."""
    model, eps, duration = case(name).model(), 1e-3, 0.1
    q, v, *_ = state_of(model)
    want = derivative_flow.flow_linearisation(model, q, v, duration).A
    gauss = GaussStep(System(model), stages)
    rng = np.random.default_rng(5)
    w, errors = rng.normal(size=2 * model.nv), []

    def end(q, v, steps):
        p = laws.mass_matrix(model, q) @ v
        q, p = laws.run(lambda q, p: gauss.step(q, p, duration / steps), q, p, steps)
        return q, np.linalg.solve(laws.mass_matrix(model, q), p)

    for steps in (1, 2, 4):
        centre, column = end(q, v, steps), 0.0
        for k, weight in laws._STENCIL:
            a, b = np.split(k * eps * w, 2)
            q1, v1 = end(laws.retract(model, q, a), v + b, steps)
            column += weight / eps * np.concatenate([laws.displacement(model, centre[0], q1), v1 - centre[1]])
        errors.append(relative(column, want @ w))
    assert (laws.orders(errors) >= 2 * stages - 0.3).all(), errors
