"""Problems through impacts, solved by scipy and IPOPT: they agree, and find what is known in closed form."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.control import Constraint, Problem, quadratic
from contactvi.control.casadi_functions import CasadiProblem
from contactvi.control.scipy_solvers import BACK_FROM_INFINITY, CONSTRAINED
from contactvi.errors import ContactviError, InputError, PenetrationError
from helpers.control_problems import GOAL, STEP, at_the_wall, ball_on_rails, first_guess, thrown_ball

OPTIMUM = 0.0204970  # of crocoddyl's FDDP for the pendulum at the wall, to the digits given
QUIET = {"ipopt_print_level": 0, "ipopt_sb": "yes", "print_time": False}
SOLVERS = {
    "L-BFGS-B": {"maxiter": 300, "ftol": 1e-12},
    "SLSQP": {"maxiter": 300, "ftol": 1e-12},
    "trust-constr": {"maxiter": 300},
}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("method", SOLVERS)
def test_scipy_through_the_wall(method):
    problem = at_the_wall()
    result = problem.minimize(first_guess(problem), method, **SOLVERS[method])
    assert result.success
    assert result.fun == pytest.approx(OPTIMUM, abs=1e-6)
    assert len(result.trajectory.events) == 1
    assert np.abs(problem.evaluate(result.x).gradient).max() < 1e-4
    assert len(result.history) == result.nit + 1 or method == "trust-constr"  # which counts what it refuses, too
    assert result.history[0] == pytest.approx(31.2, abs=0.1)
    assert result.evaluations < 200
    assert result.failures == []


def test_ipopt_through_the_wall():
    problem = at_the_wall()
    nlp = problem.nlp(first_guess(problem))
    result = nlp.solve(ipopt_tol=1e-6, **QUIET)
    assert result["stats"]["return_status"] == "Solve_Succeeded"
    assert result["f"] == pytest.approx(OPTIMUM, abs=1e-6)
    assert len(result["evaluation"].trajectory.events) == 1
    assert nlp.failures == []
    assert result["evaluations"] == len(nlp.costs)


def reached() -> Constraint:
    """The whole state at the end, (q, v)."""
    model = at_the_wall().scene.model
    upper = np.triu(pin.crba(model, model.createData(), GOAL[:2]))
    goal = np.concatenate([GOAL[:2], np.linalg.solve(upper + np.triu(upper, 1).T, GOAL[2:])])
    unit = np.eye(4)
    return Constraint(lambda t, q, v: (np.r_[q[-1], v[-1]], unit[:, :2], unit[:, 2:]), goal, goal, "goal")


@pytest.mark.thinned(3)
@pytest.mark.parametrize("method", [*CONSTRAINED, "ipopt"])
def test_the_goal_as_a_constraint(method):
    """The same state after the impact, demanded exactly, for the least torques: three solvers, one optimum."""
    problem = at_the_wall(cost=None, input_cost=quadratic(STEP), constraints=[reached()])
    z = first_guess(problem)
    if method == "ipopt":
        x = problem.nlp(z).solve(ipopt_tol=1e-8, **QUIET)["x"]
    else:
        x = problem.minimize(z, method, maxiter=500, **({"ftol": 1e-13} if method == "SLSQP" else {})).x
    at = problem.evaluate(x)
    assert np.abs(at.constraints - at.lower).max() < 1e-6
    assert len(at.trajectory.events) == 1
    assert at.cost == pytest.approx(20.5730371, rel=1e-7)  # all three
    multipliers = np.linalg.lstsq(at.jacobian.T, at.gradient, rcond=None)[0]
    assert np.abs(at.gradient - at.jacobian.T @ multipliers).max() < 1e-4 * np.abs(at.gradient).max()


def exact_throw(e: float, T: float, g: float = 9.81) -> np.ndarray:
    """The velocity, downward, with which the ball bounces once and is at (2, 0.5) at T: a scalar equation for v_z."""
    drop = 0.5 - 0.1

    def height(v: float) -> float:
        speed = np.sqrt(v**2 + 2.0 * g * drop)
        rest = T - (v + speed) / g
        return 0.1 + e * speed * rest - 0.5 * g * rest**2

    fast, slow = -4.0, -1.0  # what is thrown faster comes higher
    assert height(slow) < 0.5 < height(fast)
    for _ in range(100):
        middle = 0.5 * (fast + slow)
        fast, slow = (middle, slow) if height(middle) > 0.5 else (fast, middle)
    return np.array([2.0 / T, slow])


@pytest.mark.parametrize("method", [*CONSTRAINED, "ipopt"])
def test_thrown_ball_against_the_closed_form(method):
    problem, T = thrown_ball()
    z = np.array([1.0, -1.5])
    x = problem.nlp(z).solve(**QUIET)["x"] if method == "ipopt" else problem.minimize(z, method).x
    assert np.abs(x - exact_throw(0.9, T)).max() < 1e-6


def test_restitution_and_gravity_are_found_back():
    """The path of a ball that bounces, made with values that the search does not know."""
    scene = ball_on_rails(0.1)
    scene.set_contact(restitution=0.5)
    true = scene.with_parameters({"restitution:ball|ground": 0.73, "gravity": [0.2, 0.0, -9.5]})
    start = {"q0": [0.0, 0.5], "v0": [1.0, 0.0], "duration": 0.6, "dt": 1e-2}
    seen = cvi.simulate(true, **start).q

    def cost(t, q, v):
        off = q - seen
        return 0.5 * float(np.sum(off**2)), off, np.zeros_like(v)

    names = ["restitution:ball|ground", "gravity"]
    problem = Problem(scene, parameters=names, cost=cost, **start)
    result = problem.minimize(method="SLSQP", ftol=1e-20, maxiter=200)
    assert result.fun < 1e-12
    found = problem.unpack(result.x)
    assert found[names[0]] == pytest.approx([0.73], abs=1e-5)
    assert found["gravity"][[0, 2]] == pytest.approx([0.2, -9.5], abs=1e-4)


def test_a_design_within_its_range():
    """Restitution stays in [0, 1] without bounds of the user: higher than elastic it cannot bounce."""
    scene = ball_on_rails(0.1)

    def cost(t, q, v):
        return -float(q[-1, 1]), np.array([0.0, -1.0]), np.zeros(2)

    problem = Problem(
        scene, 0.5, 1e-2, q0=[0.0, 0.5], parameters=["restitution:ball|ground"], cost=cost, on_kink="taken"
    )
    assert problem.minimize().x == pytest.approx([1.0])


# --- points that fail -------------------------------------------------------------------------------------------------


def overshooting(constrained: bool, size: float) -> Problem:
    """A start that shall be near the ground, which the first steps of a search miss: there the ball overlaps it."""
    weights = np.array([1.0, 10.0])

    def cost(t, q, v):
        off = q[-1] - [0.1, 0.15]
        return (
            size * (0.5 * float(off**2 @ weights) + float(off @ off) ** 2),
            size * (weights * off + 4.0 * float(off @ off) * off), np.zeros(2),
        )  # fmt: skip

    def hessp(t, q, v, dq, dv):
        rows = np.zeros_like(dq)
        rows[-1] = 0.2 * size * weights * dq[-1]  # too little, for steps that are too long
        return rows, np.zeros_like(dv)

    at_x = Constraint(lambda t, q, v: (q[-1, 0], np.eye(2)[:1], np.zeros((1, 2))), 0.05, 0.05)
    return Problem(
        ball_on_rails(0.1, 0.0), 0.1, 0.05, q0=[0.0, 1.0], free_q0="*", cost=cost, hessp=hessp,
        constraints=[at_x] if constrained else [],
    )  # fmt: skip


RADIUS = {"trust-constr": {"initial_tr_radius": 3.0}, "trust-ncg": {"initial_trust_radius": 3.0}}
RADIUS["trust-krylov"] = RADIUS["trust-ncg"]
SIZES = {"BFGS": 1.0, "CG": 1.0}


@pytest.mark.parametrize("constrained", [False, True])
@pytest.mark.parametrize("method", BACK_FROM_INFINITY)
def test_failures_are_stepped_back_from(method, constrained):
    if constrained and method not in CONSTRAINED:
        return
    problem = overshooting(constrained, SIZES.get(method, 1e3))
    options = {"gtol": 1e-8} if method == "trust-constr" else {}
    result = problem.minimize(None, method, on_failure="infinite", maxiter=300, **RADIUS.get(method, {}), **options)
    assert result.x == pytest.approx([0.05 if constrained else 0.1, -0.85], abs=1e-3)
    assert len(result.failures) > 0
    assert all(isinstance(failure.error, PenetrationError) for failure in result.failures)
    assert result.failures[0].z[1] <= -0.9
    with pytest.raises(PenetrationError):
        problem.minimize(None, method, maxiter=300, **RADIUS.get(method, {}))


@pytest.mark.parametrize("method", ["L-BFGS-B", "TNC"])
def test_others_do_not_take_failures(method):
    with pytest.raises(InputError, match="step back"):
        overshooting(False, 1.0).minimize(None, method, on_failure="infinite")


def test_ipopt_steps_back():
    problem = overshooting(True, 1e3)
    nlp = problem.nlp()
    result = nlp.solve(show_eval_warnings=False, **QUIET)
    assert result["x"] == pytest.approx([0.05, -0.85], abs=1e-6)
    assert len(nlp.failures) > 0
    assert isinstance(nlp.failures[0].error, PenetrationError)


def test_second_derivatives_are_used():
    """Exact ones find the end in a few iterations, where products of the gradient alone are all there is."""
    problem = overshooting(False, 1.0)
    weights = np.array([1.0, 10.0])

    def hessp(t, q, v, dq, dv):
        off, rows = q[-1] - [0.1, 0.15], np.zeros_like(dq)
        rows[-1] = weights * dq[-1] + 4.0 * (off @ off) * dq[-1] + 8.0 * off * (off @ dq[-1])
        return rows, np.zeros_like(dv)

    problem.hessp = hessp
    result = problem.minimize([0.5, 0.3], "trust-ncg", gtol=1e-12)
    assert result.x == pytest.approx([0.1, -0.85], abs=1e-9)
    assert result.nit < 15


# --- Ctrl-C, and CasADi that is not there -----------------------------------------------------------------------------


def interrupted(problem: Problem, after: int) -> Problem:
    """The problem, whose cost sends the process a Ctrl-C at its n-th run."""
    cost = problem.terms.cost

    def stopping(t, q, v):
        if problem.runs == after:
            os.kill(os.getpid(), signal.SIGINT)
            threading.Event().wait(0.01)
        return cost(t, q, v)

    object.__setattr__(problem.terms, "cost", stopping)
    return problem


@pytest.fixture
def _heard():
    """Ctrl-C is heard, also where the tests run in the background of a shell, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_heard")
@pytest.mark.parametrize("solver", ["L-BFGS-B", "ipopt"])
def test_ctrl_c_comes_through(solver):
    problem = interrupted(at_the_wall(), 5)
    z = first_guess(problem)
    with pytest.raises(KeyboardInterrupt):
        problem.nlp(z).solve(**QUIET) if solver == "ipopt" else problem.minimize(z, solver)
    assert problem.runs == 5


def test_without_casadi(tmp_path):
    code = (
        "import sys; sys.modules['casadi'] = None\n"
        "import contactvi as cvi, contactvi.control as c\n"
        "s = cvi.Scene(); s.add_sphere('b', .1)\n"
        "p = c.Problem(s, .1, .1, free_v0='b')\n"
        "try: p.nlp()\n"
        "except cvi.ContactviError as e: print(e)\n"
    )
    found = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert 'pip install "contactvi[casadi]"' in found.stdout


def test_a_nlp_of_the_users_own():
    import casadi

    problem, T = thrown_ball()
    nlp = problem.nlp([1.0, -1.5])
    assert isinstance(nlp, CasadiProblem)
    solver = casadi.nlpsol("solver", "ipopt", nlp.nlp, {**nlp.options, "ipopt.print_level": 0, "print_time": False})
    assert np.abs(np.array(solver(**nlp.start)["x"]).ravel() - exact_throw(0.9, T)).max() < 1e-6
    assert issubclass(PenetrationError, ContactviError)


def test_options_of_the_method_by_keyword_or_as_scipy_takes_them():
    """Both say the same, and what the method does not have is refused."""
    problem = at_the_wall()
    z = first_guess(problem)
    plain = problem.minimize(z, "SLSQP", maxiter=2)
    nested = problem.minimize(z, "SLSQP", options={"maxiter": 2})
    assert plain.nit == nested.nit == 2
    np.testing.assert_array_equal(plain.x, nested.x)
    for options in ({"maxitre": 2}, {"options": {"maxitre": 2}}):
        with pytest.raises(InputError, match="SLSQP does not have these options: .*maxitre"):
            problem.minimize(z, "SLSQP", **options)
    with pytest.raises(InputError, match="options"):
        problem.minimize(z, "SLSQP", options=3)
