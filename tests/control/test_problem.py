"""The values and derivatives of problems: gradient and Jacobian against differences of runs, the variables, errors."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.control import Constraint, Inputs, Problem, quadratic
from contactvi.errors import InputError, PenetrationError
from derivatives.differences import FOURTH
from helpers.control_problems import arm_problem, at_the_wall, ball_on_rails, box_problem, first_guess

CASES = {
    "arm": arm_problem,
    "arm, linear inputs": lambda: arm_problem("linear"),
    "box": box_problem,
    "wall": at_the_wall,
}


def generic_point(problem: Problem) -> np.ndarray:
    rng = np.random.default_rng(4)
    z = problem.z0 + 0.05 * rng.uniform(-1, 1, len(problem.z0))
    for name in problem.variables.parameters:
        z[problem.variables.blocks[name]] = problem.z0[problem.variables.blocks[name]]
    return first_guess(problem) if len(z) == 40 else z


@pytest.mark.parametrize("case", CASES)
def test_gradient_and_jacobian(case):
    """Fourth-order differences along each variable, of runs with an impact."""
    problem = CASES[case]()
    z = generic_point(problem)
    at = problem.evaluate(z)
    events = [event.pair for event in at.trajectory.events]
    assert events
    sizes = np.full(len(z), 2e-4)
    if "inertia:box" in problem.variables.blocks:
        sizes[problem.variables.blocks["inertia:box"]] = 1e-5  # of 1e-2 kg m^2
    scale = max(1.0, np.abs(at.gradient).max())
    for k, unit in enumerate(np.eye(len(z))):
        slope, rows, size = 0.0, np.zeros(len(at.constraints)), sizes[k]
        for number, weight in FOURTH:
            near = problem.evaluate(z + number * size * unit)
            assert [event.pair for event in near.trajectory.events] == events
            slope += weight / size * near.cost
            rows += weight / size * near.constraints
        assert abs(at.gradient[k] - slope) <= 1e-7 * scale, problem.variables.names[k]
        largest = np.maximum(1.0, np.abs(at.jacobian).max(axis=1, initial=0.0))
        assert np.all(np.abs(at.jacobian[:, k] - rows) <= 1e-7 * largest), problem.variables.names[k]


def test_one_run_for_all_of_a_point():
    problem = arm_problem()
    at = problem.evaluate(problem.z0)
    assert problem.runs == 1
    assert problem.evaluate(problem.z0.copy()) is at
    _ = at.gradient, at.jacobian
    assert problem.runs == 1
    problem.evaluate(problem.z0 + 0.01)
    assert problem.runs == 2


def test_variables_by_block():
    problem = arm_problem()
    variables = problem.variables
    assert list(variables.blocks) == [
        "inputs", "q0", "v0", "mass:turn", "restitution:tip|ground", "gravity", "kp:slide",
    ]  # fmt: skip
    assert len(variables.names) == len(problem.z0)
    assert variables.names[:2] == ["inputs[0] torque:turn", "inputs[0] target:slide"]
    values = problem.unpack(problem.z0)
    assert values["inputs"].shape == (7, 2)  # 45 steps, 7 an interval: the last one is shorter
    assert np.array_equal(values["inputs"], np.tile([0.0, 0.5], (7, 1)))  # the servo holds where it starts
    assert np.array_equal(values["v0"], [-1.0, 1.0])
    z = problem.pack({"mass:turn": 2.0, "inputs": [1.0, 0.4]})
    assert problem.unpack(z)["mass:turn"] == 2.0
    assert np.array_equal(problem.unpack(z)["inputs"], np.tile([1.0, 0.4], (7, 1)))
    lower, upper = problem.lower, problem.upper
    part = variables.blocks["restitution:tip|ground"]
    assert (lower[part], upper[part]) == (0.0, 1.0)
    assert lower[variables.blocks["kp:slide"]] == 0.0
    assert np.all(np.isinf(lower[variables.blocks["inputs"]]))


def test_inputs_act_as_those_of_simulate():
    """What a row of numbers means: constant over an interval, or linear between its ends, at the middle of a step."""
    scene = ball_on_rails(0.1, 0.0)
    scene.set_servo("z", kp=50.0, kd=3.0)
    for interpolation, rows in (("constant", 3), ("linear", 4)):
        inputs = Inputs(scene, "x", "z", hold=4, interpolation=interpolation)
        problem = Problem(scene, 1.0, 0.1, q0=[0.0, 1.0], inputs=inputs)
        u = np.random.default_rng(1).uniform(-1, 1, (rows, 2))
        middle = 0.1 * (np.arange(10) + 0.5)
        if interpolation == "constant":
            values, rates = u[np.arange(10) // 4], np.zeros(10)
        else:
            knots = 0.4 * np.arange(rows)
            values = np.array([np.interp(middle, knots, column) for column in u.T]).T
            rates = (np.diff(u[:, 1]) / 0.4)[np.arange(10) // 4]
        control = np.column_stack([values[:, 0], np.zeros(10)])
        target = np.column_stack([values[:, 1], rates])
        expected = cvi.simulate(scene, [0.0, 1.0], duration=1.0, dt=0.1, control=control, target=target)
        found = problem.simulate(problem.pack({"inputs": u}))
        assert np.abs(found.q - expected.q).max() <= 1e-13


def test_servos_that_are_not_chosen_keep_their_references():
    scene = ball_on_rails(0.1, 0.0)
    scene.set_servo("*", kp=50.0, kd=3.0)
    scene.set_servo("x", kp=50.0, kd=3.0, target=lambda t: np.sin(t))
    problem = Problem(scene, 0.5, 0.1, q0=[0.0, 1.0], inputs=Inputs(scene, targets="z", hold=5), free_q0="x")
    traj = problem.simulate(problem.pack({"inputs": 1.2, "q0": 0.1}))
    expected = cvi.simulate(scene, [0.1, 1.0], duration=0.5, dt=0.1, target={"z": 1.2})
    assert np.abs(traj.q - expected.q).max() <= 1e-13


def test_limits_of_the_model_bound_inputs():
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/panda_description/urdf/panda.urdf")
    scene.set_servo("panda_joint1", 100.0, 10.0)
    inputs = Inputs(scene, "panda_joint2", "panda_joint1", hold=5)
    problem = Problem(scene, 0.01, 1e-3, inputs=inputs, bounds={"inputs": "limits"})
    assert np.array_equal(problem.upper, np.tile([87.0, 2.8973], 2))
    assert np.array_equal(problem.lower, -problem.upper)


def test_second_derivatives():
    """The product of the Hessian against differences of the gradient, through an impact without friction."""
    scene = ball_on_rails(0.1)
    scene.set_contact(restitution=0.7)
    inputs = Inputs(scene, "*", hold=5)

    def cost(t, q, v):
        return 0.5 * float(q[-1] @ q[-1]), q[-1], np.zeros(2)

    def hessp(t, q, v, dq, dv):
        rows = np.zeros_like(dq)
        rows[-1] = dq[-1]
        return rows, np.zeros_like(dv)

    problem = Problem(
        scene, 0.5, 1e-2, q0=[0.0, 0.6], v0=[0.1, 0.2], inputs=inputs, free_q0="*", free_v0="*", cost=cost, hessp=hessp,
        input_cost=quadratic(0.1), solver_tol=1e-14,
    )  # fmt: skip
    z, w = problem.z0 + 0.01, np.random.default_rng(2).uniform(-1, 1, len(problem.z0))
    assert len(problem.evaluate(z).trajectory.events) == 1
    product = problem.hessian_product(z, w)
    size = 1e-3
    numbers = sum(weight / size * problem.evaluate(z + count * size * w).gradient for count, weight in FOURTH)
    assert np.abs(product - numbers).max() <= 1e-8 * np.abs(numbers).max()


def rails() -> cvi.Scene:
    return ball_on_rails(0.1)


def no_gradient(t, q, v):
    return 0.0


REFUSED = {
    "no variables": (lambda s: Problem(s, 0.1, 0.01), "no variables"),
    "no duration": (lambda s: Problem(s, free_v0="*", dt=0.01), "no duration"),
    "unknown joint": (lambda s: Problem(s, 0.1, 0.01, free_v0="zz"), "zz"),
    "unknown parameter": (lambda s: Problem(s, 0.1, 0.01, parameters=["mass:zz"]), "mass:zz"),
    "one parameter": (lambda s: Problem(s, 0.1, 0.01, parameters="mass:z"), "square brackets"),
    "parameter twice": (lambda s: Problem(s, 0.1, 0.01, parameters=["mass:z", "mass:z"]), "twice"),
    "joint twice": (lambda s: Problem(s, 0.1, 0.01, free_v0=["*", "z"]), "twice"),
    "bounds of nothing": (lambda s: Problem(s, 0.1, 0.01, free_v0="*", bounds={"q0": (0, 1)}), "no such variables"),
    "no pair": (lambda s: Problem(s, 0.1, 0.01, free_v0="*", bounds={"v0": 3}), "pair (lower, upper)"),
    "empty bounds": (lambda s: Problem(s, 0.1, 0.01, free_v0="*", bounds={"v0": (1, 0)}), "leave nothing"),
    "shape of bounds": (lambda s: Problem(s, 0.1, 0.01, free_v0="*", bounds={"v0": (0, [1, 2, 3])}), "shape (2,)"),
    "cost of no inputs": (lambda s: Problem(s, 0.1, 0.01, free_v0="*", input_cost=quadratic(1)), "no inputs"),
    "inputs": (lambda s: Problem(s, 0.1, 0.01, inputs="*"), "contactvi.control.Inputs"),
    "constraints": (lambda s: Problem(s, 0.1, 0.01, free_v0="*", constraints=no_gradient), "Constraint(function"),
    "no inputs": (lambda s: Inputs(s), "There are no inputs"),
    "no servo": (lambda s: Inputs(s, targets="z"), "set_servo"),
    "hold": (lambda s: Inputs(s, "*", hold=0), "hold"),
    "weights": (lambda s: quadratic(-1.0), "weights >= 0"),
    "constraint bounds": (lambda s: Constraint(no_gradient, 1.0, 0.0), "leave nothing"),
    "point": (lambda s: Problem(s, 0.1, 0.01, free_v0="*").evaluate([1.0]), "shape (2,)"),
    "no cost": (
        lambda s: Problem(s, 0.1, 0.01, q0=[0, 1], free_v0="*", cost=no_gradient).evaluate([0, 0]), "(J, dJ/dq, dJ/dv)",
    ),
    "no constraint": (
        lambda s: Problem(s, 0.1, 0.01, q0=[0, 1], free_v0="*", constraints=[Constraint(no_gradient)]).evaluate([0, 0]),
        "(c, dc/dq, dc/dv)",
    ),
    "second derivative": (
        lambda s: Problem(s, 0.1, 0.01, q0=[0, 1], free_v0="*", cost=lambda t, q, v: (0.0, v[-1], v[-1])).minimize(
            method="trust-ncg"
        ), "hessp",
    ),
    "method": (lambda s: Problem(s, 0.1, 0.01, q0=[0, 1], free_v0="*").minimize(method="COBYLA"), "not use gradients"),
    "bounded": (
        lambda s: Problem(s, 0.1, 0.01, q0=[0, 1], free_v0="*", bounds={"v0": (0, 1)}).minimize(method="BFGS"),
        "takes no bounds",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refused(case):
    make, text = REFUSED[case]
    with pytest.raises(InputError) as caught:
        make(rails())
    assert text in str(caught.value)


def test_a_run_that_fails_is_raised():
    problem = Problem(rails(), 0.1, 0.01, q0=[0.0, 0.5], free_q0="z")
    with pytest.raises(PenetrationError):
        problem.evaluate([-0.45])
    assert problem.evaluate([0.0]).trajectory.status.ok


def test_the_scene_is_taken_as_it_is():
    scene = rails()
    problem = Problem(scene, 0.1, 0.01, q0=[0.0, 0.5], parameters=["gravity"])
    scene.set_joint("z", stiffness=100.0)
    assert problem.scene.parameter("stiffness:z") == 0.0
    assert np.array_equal(problem.simulate([1.0, 0.0, 0.0]).scene.gravity, [1.0, 0.0, 0.0])
    assert np.array_equal(problem.scene.gravity, [0.0, 0.0, -9.81])
    assert isinstance(problem.scene.model, pin.Model)
