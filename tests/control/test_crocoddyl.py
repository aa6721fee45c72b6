"""contactvi's steps as crocoddyl's actions: derivatives against differences, solvers through impacts, errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

import contactvi as cvi

crocoddyl = pytest.importorskip("crocoddyl")
import contactvi.crocoddyl as ours  # noqa: E402
from contactvi.control.drives import Drives  # noqa: E402
from contactvi.crocoddyl import ActionModel, merge_nodes_at_impacts, replay, solve, warm_start  # noqa: E402

MODELS = Path(__file__).resolve().parents[2] / "models"
FOURTH = ((-2, 1 / 12), (-1, -8 / 12), (1, 8 / 12), (2, -1 / 12))
X0 = np.array([0.35, 0.25, 0.0, 0.0])
GOAL = np.array([0.3, 0.1, 0.0, 0.0])


def wall(restitution=0.7):
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    scene.set_contact(restitution=restitution)
    return scene


def ball(height=0.3):
    """A ball over the ground, with friction: impacts turn it."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", radius=0.1, mass=0.7, placement=(0.0, 0.0, height))
    scene.set_contact(restitution=0.6, friction=0.4)
    return scene


def sum_of(state, nu, **residuals):
    costs = crocoddyl.CostModelSum(state, nu)
    for name, (weight, residual, *activation) in residuals.items():
        costs.addCost(name, crocoddyl.CostModelResidual(state, *activation, residual), weight)
    return costs


def pendulum_problem(span, nodes, goal=GOAL, effort=1e-3, solver_bounds=None):
    scene = wall()
    state = crocoddyl.StateMultibody(scene.model)
    running = sum_of(state, 2, u=(effort, crocoddyl.ResidualModelControl(state, 2)))
    weights = crocoddyl.ActivationModelWeightedQuad(np.array([50.0, 50.0, 5.0, 5.0]))
    terminal = sum_of(state, 2, goal=(1.0, crocoddyl.ResidualModelState(state, goal, 2), weights))
    action = ActionModel(scene, span / nodes, order=8, costs=running, bounds=solver_bounds)
    return crocoddyl.ShootingProblem(X0, [action] * nodes, ActionModel(scene, span / nodes, order=8, costs=terminal))


def slope_of(problem, us):
    """The gradient of the cost in all inputs, by the derivatives of the nodes."""
    xs = list(problem.rollout(list(us)))
    problem.calc(xs, list(us))
    problem.calcDiff(xs, list(us))
    slope, found = np.array(problem.terminalData.Lx), []
    for data in reversed(list(problem.runningDatas)):
        found.append(data.Lu + data.Fu.T @ slope)
        slope = data.Lx + data.Fx.T @ slope
    return np.array(found[::-1])


def check_derivatives(model, x, u, bound, step=1e-3):
    """Compare Fx, Fu, Lx and Lu of an action with fourth-order differences on the manifold."""
    data, state = model.createData(), model.state
    model.calc(data, x, u)
    model.calcDiff(data, x, u)
    assert not model.failures
    end, trial = np.array(data.xnext), model.createData()

    def column(dx, du):
        total, cost = np.zeros(state.ndx), 0.0
        for count, weight in FOURTH:
            model.calc(trial, state.integrate(x, count * step * dx), u + count * step * du)
            total += weight / step * state.diff(end, trial.xnext)
            cost += weight / step * trial.cost
        return total, cost

    n, nu = state.ndx, model.nu
    columns = [column(dx, np.zeros(nu)) for dx in np.eye(n)] + [column(np.zeros(n), du) for du in np.eye(nu)]
    expected = np.column_stack([c for c, _ in columns])
    assert np.abs(np.hstack([data.Fx, data.Fu]) - expected).max() <= bound * max(1.0, np.abs(expected).max())
    costs = np.array([c for _, c in columns])
    assert np.abs(np.concatenate([data.Lx, data.Lu]) - costs).max() <= bound * max(1.0, np.abs(costs).max())
    return data


def test_derivatives_through_an_impact():
    """Of four steps in one interval, with a wall in the second."""
    scene = wall()
    model = ActionModel(scene, 0.02, steps=4, order=4)
    found = check_derivatives(model, np.array([0.02, 0.05, -0.5, -1.0]), np.array([1.0, -0.5]), 1e-9, 1e-4)
    assert found.impacts == 1


def test_derivatives_of_a_free_body_with_friction():
    scene = ball()
    state = crocoddyl.StateMultibody(scene.model)
    model = ActionModel(scene, 0.03, steps=2, order=6)
    q = pin.integrate(scene.model, scene.neutral(), np.array([0.1, 0.2, -0.1, 0.3, -0.5, 0.2]))
    q[2] = 0.13
    found = check_derivatives(
        model, np.concatenate([q, [0.3, -0.2, -2.0, 0.5, 1.0, -0.4]]), 0.3 * np.ones(6), 1e-8, 1e-4
    )
    assert found.impacts == 1
    assert (state.nx, state.ndx, model.nu) == (13, 12, 6)


def test_residuals_of_crocoddyl():
    """Costs of state, control, frames, centre of mass and momentum on a hand, as running and as terminal costs."""
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/ur_description/urdf/ur5_robot.urdf")
    model = scene.model
    state = crocoddyl.StateMultibody(model)
    frame, place = model.getFrameId("tool0"), pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, -0.5), np.array([0.3, 0.2, 0.5]))
    residuals = {
        "x": crocoddyl.ResidualModelState(state, 0.1 * np.ones(12), 6),
        "u": crocoddyl.ResidualModelControl(state, np.ones(6)),
        "placement": ours.ResidualModelFramePlacement(state, frame, place, 6),
        "translation": ours.ResidualModelFrameTranslation(state, frame, place.translation, 6),
        "velocity": ours.ResidualModelFrameVelocity(
            state, frame, pin.Motion(np.arange(6.0)), pin.LOCAL_WORLD_ALIGNED, 6
        ),
        "twist in the world": ours.ResidualModelFrameVelocity(state, frame, pin.Motion(np.arange(6.0)), pin.WORLD, 6),
        "twist in the frame": ours.ResidualModelFrameVelocity(state, frame, pin.Motion(np.arange(6.0)), pin.LOCAL, 6),
        "com": ours.ResidualModelCoMPosition(state, np.array([0.1, 0.2, 0.3]), 6),
        "momentum": ours.ResidualModelCentroidalMomentum(state, np.arange(6.0), 6),
    }
    for name, residual in residuals.items():
        action = ActionModel(scene, 0.01, order=2, costs=sum_of(state, 6, **{name: (2.0, residual)}))
        x = np.concatenate([[0.3, -1.0, 1.2, -0.4, 0.7, 0.2], 0.5 * np.arange(6.0)])
        data = check_derivatives(action, x, np.arange(6.0), 1e-8)
        running, slope = data.cost, np.array(data.Lx)
        action.calc(data, x)
        action.calcDiff(data, x)
        if name != "u":
            assert data.cost * 0.01 == pytest.approx(running, rel=1e-12)
            assert np.allclose(data.Lx * 0.01, slope, rtol=1e-12)


def test_residuals_that_read_other_memory_are_refused():
    """Those of crocoddyl's wheels read the data of the Pinocchio that these were built with."""
    scene = wall()
    state = crocoddyl.StateMultibody(scene.model)
    costs = sum_of(state, 2, com=(1.0, crocoddyl.ResidualModelCoMPosition(state, np.zeros(3), 2)))
    model = ActionModel(scene, 0.02, costs=costs)
    if pin.__version__ == ours.residuals.BUILT_WITH.get(crocoddyl.__version__):
        pytest.skip("the installed crocoddyl and Pinocchio go together")
    with pytest.raises(cvi.InputError, match="contactvi.crocoddyl.ResidualModelCoMPosition"):
        model.createData()


def test_states_of_crocoddyl_are_those_of_pinocchio():
    """Of its wheels they read the model alone, which is the same."""
    model = pin.buildSampleModelHumanoid()
    state, rng = crocoddyl.StateMultibody(model), np.random.default_rng(0)
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    x, dx = np.concatenate([q, rng.standard_normal(model.nv)]), rng.standard_normal(2 * model.nv)
    end = state.integrate(x, dx)
    assert np.array_equal(end[: model.nq], pin.integrate(model, q, dx[: model.nv]))
    assert np.array_equal(state.diff(x, end)[: model.nv], pin.difference(model, q, end[: model.nq]))


def test_servo_targets_as_inputs():
    """u are references of one servo after a torque; the other servo holds where the scene starts."""
    scene = wall()
    scene.set_servo("joint_1", kp=40.0, kd=2.0)
    scene.set_servo("joint_2", kp=30.0, kd=1.0)
    model = ActionModel(scene, 0.02, steps=3, order=4, torques=["joint_2"], targets=["joint_1"])
    assert model.drives.names == ["joint_2", "joint_1"]
    x, u = np.array([0.3, 0.2, 0.0, 0.0]), np.array([0.7, 0.1])
    data = check_derivatives(model, x, u, 1e-9)
    start = scene.q0 if scene.q0 is not None else scene.neutral()
    run = cvi.simulate(
        scene, x[:2], x[2:], 0.06, 0.02, order=4, control=np.tile([0.0, 0.7], (3, 1)), target=[0.1, start[1]]
    )
    assert np.array_equal(data.xnext, np.concatenate([run.q[-1], run.v[-1]]))


def test_the_gradient_of_a_problem_is_that_of_its_run():
    problem = pendulum_problem(1.2, 12)
    us = [np.array([-2.0, 0.3 * k]) for k in range(12)]
    found = slope_of(problem, us)
    run = replay(problem, us)
    assert len(run.events) >= 1
    off = np.concatenate([run.q[-1], run.v[-1]]) - GOAL
    _, exact = cvi.gradient(run, (50.0 * off[:2], 5.0 * off[2:]), "control")
    expected = exact["control"] + 1e-3 * 0.1 * np.array(us)
    assert np.abs(found - expected).max() <= 1e-10 * np.abs(expected).max()


def test_fddp_finds_the_optimum_of_another_solver():
    """Through an impact whose time is free: at a gradient of 1e-6 scipy's L-BFGS-B goes no lower."""
    problem = pendulum_problem(1.2, 30)
    solver = crocoddyl.SolverFDDP(problem)
    solver.th_stop = 1e-13
    start = [np.zeros(2)] * 30
    before = problem.calc(list(problem.rollout(start)), start)
    log = crocoddyl.CallbackLogger()
    solver.setCallbacks([log])
    assert solve(solver, start)
    us = np.array(solver.us)
    assert np.abs(slope_of(problem, us)).max() <= 1e-6
    assert all(a >= b for a, b in zip([before, *log.costs], log.costs, strict=False))
    assert len(replay(problem, us).events) == 1

    def value(z):
        given = list(z.reshape(30, 2))
        return problem.calc(list(problem.rollout(given)), given), slope_of(problem, given).ravel()

    other = minimize(value, us.ravel() + 0.02, jac=True, method="L-BFGS-B", options={"maxiter": 300, "gtol": 1e-7})
    assert other.fun >= solver.cost * (1.0 - 1e-9)


@pytest.mark.slow
def test_box_fddp_keeps_its_bounds():
    problem = pendulum_problem(1.2, 30, goal=np.array([0.5, -0.3, 0.4, 0.2]), solver_bounds=(-1.5, [1.5, 1.0]))
    solver = crocoddyl.SolverBoxFDDP(problem)
    solve(solver, [np.zeros(2)] * 30)
    us = np.array(solver.us)
    assert np.all(us >= -1.5)
    assert np.all(us <= [1.5, 1.0])
    assert np.any(us == -1.5) or np.any(us == [1.5, 1.0])


@pytest.mark.slow
def test_nodes_at_impacts_are_merged():
    """FDDP stops where the impact is at a node; in the merged interval it converges, to a lower cost."""
    problem = pendulum_problem(0.8, 20, goal=np.array([0.5, -0.3, 0.4, 0.2]))
    us = [np.array([-2.0, 0.0]) if k < 8 else np.zeros(2) for k in range(20)]
    solver = crocoddyl.SolverFDDP(problem)
    solver.th_stop = 1e-13
    solve(solver, us)
    assert np.abs(slope_of(problem, solver.us)).max() > 1e-3
    (event,) = replay(problem, solver.us).events
    assert abs(event.time / 0.04 - 12.0) < 1e-3
    merged, us = merge_nodes_at_impacts(problem, solver.us)
    assert (problem.T, merged.T) == (20, 19)
    assert merged.runningModels[11].steps == 2
    again = crocoddyl.SolverFDDP(merged)
    again.th_stop = 1e-13
    solve(again, us)
    assert np.abs(slope_of(merged, again.us)).max() <= 1e-6
    assert again.cost < solver.cost


def test_a_run_is_a_start():
    scene = wall()
    model = ActionModel(scene, 0.02, steps=5, order=4)
    control = np.repeat(np.random.default_rng(1).standard_normal((6, 2)), 5, axis=0)
    run = cvi.simulate(scene, X0[:2], X0[2:], 0.6, 0.02, order=4, control=control, record="gradient")
    xs, us = warm_start(model, run)
    assert np.array_equal(us, control[::5])
    problem = crocoddyl.ShootingProblem(X0, [model] * 6, model)
    assert np.abs(np.array(problem.rollout(us)) - xs).max() <= 1e-11
    again = replay(problem, us)
    assert np.array_equal(again.q, run.q)
    with pytest.raises(cvi.InputError, match="change within an interval"):
        warm_start(model, cvi.simulate(scene, X0[:2], X0[2:], 0.1, 0.02, order=4, record="gradient",
                                       control=np.random.default_rng(1).standard_normal((5, 2))))  # fmt: skip
    with pytest.raises(cvi.InputError, match="not made of such intervals"):
        warm_start(
            model, cvi.simulate(scene, X0[:2], X0[2:], 0.08, 0.02, order=4, record="gradient", control=control[:4])
        )


def test_persistent_contact_goes_through_nodes():
    """A box that slides: the nodes' derivatives, chained, are those of differences of the whole."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", size=(0.2, 0.2, 0.1), mass=2.0, placement=(0.0, 0.0, 0.05))
    scene.set_contact(restitution=0.0, friction=0.3)
    state = crocoddyl.StateMultibody(scene.model)
    x0 = np.concatenate([scene.neutral(), np.zeros(6)])
    terminal = sum_of(state, 6, x=(1.0, crocoddyl.ResidualModelState(state, x0, 6)))
    action, end = ActionModel(scene, 5e-3, steps=4), ActionModel(scene, 5e-3, costs=terminal)
    problem = crocoddyl.ShootingProblem(x0, [action] * 5, end)
    us = np.tile([12.0, 0.0, 0.0, 0.0, 0.0, 0.0], (5, 1))
    found, d = slope_of(problem, us), np.random.default_rng(0).standard_normal((5, 6))

    def cost(us):
        return problem.calc(list(problem.rollout(list(us))), list(us))

    difference = sum(weight / 1e-3 * cost(us + count * 1e-3 * d) for count, weight in FOURTH)
    assert difference == pytest.approx(np.sum(found * d), rel=1e-8)


def test_what_fails_is_raised():
    """In a start, by `solve`; on trial in a line search the cost is NaN and the reason is kept."""
    scene = ball(0.3)
    model = ActionModel(scene, 0.05, order=2)
    inside = np.concatenate([scene.neutral(), np.zeros(6)])
    inside[2] = 0.05
    problem = crocoddyl.ShootingProblem(inside, [model] * 3, model)
    with pytest.raises(cvi.PenetrationError):
        solve(crocoddyl.SolverFDDP(problem), [np.zeros(6)] * 3)
    data = model.createData()
    model.failures.clear()
    model.calc(data, inside, np.zeros(6))
    assert np.isnan(data.cost)
    assert model.failures[0].where == "calc"
    flat = cvi.Scene()
    flat.add_halfspace()
    flat.add_box("box", size=(0.2, 0.2, 0.1), placement=(0.0, 0.0, 0.1))
    flat.set_contact(restitution=0.5, friction=0.3)
    falls = ActionModel(flat, 0.05, steps=4)
    start = np.concatenate([flat.neutral(), np.zeros(6)])
    with pytest.raises(cvi.NotDifferentiable):
        solve(crocoddyl.SolverFDDP(crocoddyl.ShootingProblem(start, [falls], falls)), [np.zeros(6)])


def test_ctrl_c_in_an_action_comes_through(monkeypatch):
    problem = pendulum_problem(0.4, 4)
    model = problem.runningModels[0]

    def pressed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(model.interval, "derivatives", pressed)
    with pytest.raises(KeyboardInterrupt):
        solve(crocoddyl.SolverFDDP(problem), [np.zeros(2)] * 4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"torques": ["nobody"]}, "nobody"),
        ({"torques": ["joint_1", "joint_1"]}, "named twice"),
        ({"targets": ["joint_1"]}, "has no servo"),
        ({"torques": []}, "There are no inputs"),
        ({"bounds": (1.0, -1.0)}, "out of order"),
        ({"bounds": "efforts"}, "Unknown bounds"),
        ({"bounds": 3.0}, "no bounds"),
        ({"costs": "effort"}, "no costs"),
        ({"steps": 0}, "steps"),
        ({"on_kink": "jump"}, "kink"),
    ],
)
def test_bad_arguments(settings, message):
    with pytest.raises(cvi.InputError, match=message):
        ActionModel(wall(), 0.02, **settings)


def test_costs_of_another_model():
    state = crocoddyl.StateMultibody(ball().model)
    with pytest.raises(cvi.InputError, match="those of another action"):
        ActionModel(wall(), 0.02, costs=crocoddyl.CostModelSum(state, 2))
    other = pendulum_problem(0.4, 4)
    alien = crocoddyl.ActionModelLQR(4, 2)
    with pytest.raises(cvi.InputError, match="not one run"):
        replay(crocoddyl.ShootingProblem(X0, [alien], other.terminalModel), [np.zeros(2)])
    with pytest.raises(cvi.InputError, match="one per node"):
        replay(other, [np.zeros(2)])


def test_drives_of_the_model():
    """Bounds are efforts and limits of the file; entries are named, those of several dofs with a number."""
    scene = cvi.Scene()
    scene.add_urdf("example-robot-data://robots/ur_description/urdf/ur5_robot.urdf")
    scene.set_servo("wrist_1_joint", kp=5.0, kd=0.1)
    drives = Drives(scene, torques=["elbow_joint", "shoulder_*"], targets=["wrist_1_joint"])
    assert drives.names == ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint"]
    assert np.array_equal(drives.upper[:3], [150.0, 150.0, 150.0])
    assert drives.forces[3, 3] == 5.0
    assert Drives(ball(), torques="ball").names[1] == "ball[1]"


def test_an_impact_in_the_last_instant_of_a_run():
    """What is left of the run after it has no length, and no inputs of its own."""
    scene = wall()
    (event,) = cvi.simulate(scene, X0[:2], X0[2:], 0.7, 0.05, order=8).events
    for shift in (-3e-16, 0.0, 1e-16, 3e-16, 1e-14):
        dt = event.time * (1.0 + shift) / 10
        run = cvi.simulate(scene, X0[:2], X0[2:], 10 * dt, dt, order=8, control=np.zeros((10, 2)), record="gradient")
        S = run.sensitivity(["q0", "control"]).matrix[-1]
        assert np.isfinite(S).all()
