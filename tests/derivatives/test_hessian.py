"""Second derivatives of runs along directions: against differences of gradients, closed forms and an oracle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from batteries import models
from contactvi import _core
from derivatives.second_differences import CurvedCost, Start, check_second, flat, start_of
from derivatives.test_sensitivity import at_wall
from helpers import derivative_cases
from helpers.chains import JOINTS, chain, state_of
from oracles import derivative_step, derivative_trep, precise

MODELS = Path(__file__).resolve().parents[2] / "models"
KNOWN = [name for name in derivative_cases.ELEMENTS if name not in ("user forces", "potentials")]


def cases(family: str, order: int) -> list[derivative_cases.Case]:
    every = [*derivative_cases.smooth(1), *derivative_cases.elements(1)]
    return [case for case in every if case.family == f"smooth: {family}" and case.options["order"] == order]


@pytest.mark.parametrize("order", [2, 4, 16])
@pytest.mark.parametrize("family", [*derivative_cases.FAMILIES, *KNOWN])
def test_smooth_runs_against_differences_of_gradients(family, order):
    """All joints and elements; configurations with turns in exponential coordinates, where H is symmetric."""
    for case in cases(family, order):
        check_second(start_of(case))


@pytest.mark.parametrize("order", [2, 16])
def test_the_hand(order):
    model = models.case("allegro").model()
    scene = cvi.Scene.from_pinocchio(model)
    q, v = state_of(scene, np.random.default_rng(3))[:2]
    rng, dt = np.random.default_rng(4), 0.002 if order == 2 else 0.01
    steps = 10
    start = Start(
        scene, q, 0.5 * v, 0.01 * rng.standard_normal((steps, scene.nv)),
        {"duration": steps * dt, "dt": dt, "order": order, "solver_tol": 1e-14, "contact_mode": "events"},
    )  # fmt: skip
    check_second(start, 1e-4)


def test_the_midpoint_step_of_a_pendulum_in_closed_form():
    """J (q1 - q0)/h = J v0 - (h/2) m g l sin((q0 + q1)/2), differentiated twice by hand."""
    mass, length, h, gravity = 1.3, 0.7, 0.1, 9.81
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(
        joint, pin.Inertia(mass, np.array([0.0, 0.0, -length]), 1e-3 * np.eye(3)), pin.SE3.Identity()
    )
    scene = cvi.Scene.from_pinocchio(model, name="pendulum")
    J, weight = mass * length**2 + 1e-3, mass * gravity * length
    q0, v0 = 0.4, 1.5
    traj = cvi.simulate(scene, [q0], [v0], record="gradient", duration=h, dt=h, order=2, solver_tol=1e-15)
    q1, k = float(traj.q[-1, 0]), 0.5 * h * h * weight / J
    middle = 0.5 * (q0 + q1)
    assert abs(q1 - q0 - h * v0 + k * np.sin(middle)) <= 1e-14
    slope, bend = 0.5 * k * np.cos(middle), -0.25 * k * np.sin(middle)
    dq = np.array([1.0 - slope, h]) / (1.0 + slope)  # by q0 and v0
    both = np.array([1.0, 0.0]) + dq
    second = -bend * np.outer(both, both) / (1.0 + slope)
    cost = (np.array([1.0]), np.array([0.0]))
    for column, w in enumerate(({"q0": [1.0]}, {"v0": [1.0]})):
        found = cvi.hessian_vector(traj, cost, w, ["q0", "v0"], hessp="linear")
        assert np.allclose([found.product["q0"][0], found.product["v0"][0]], second[column], rtol=1e-12)
        assert np.allclose([found.gradient["q0"][0], found.gradient["v0"][0]], dq, rtol=1e-13)


def pendulum(x: dict) -> cvi.Scene:
    scene = cvi.Scene.from_pinocchio(models.double_pendulum(), name="pendulum")
    for k in range(2):
        scene.set_joint(f"joint{k + 1}", damping=x["damping"][k], stiffness=x["stiffness"][k], rest=0.0)
    return scene


STEP = {
    "q0": [0.3, -0.42], "p0": [-1.7, -0.5], "tau": [0.3, -0.2], "h": 0.05, "masses": [1.0, 1.0],
    "lengths": [1.0, 1.0], "gravity": 9.81, "damping": [0.1, 0.3], "stiffness": [2.0, 1.0], "wall": -5.0, "e": 1.0,
}  # fmt: skip


@pytest.mark.parametrize("order", [2, 4, 8])
def test_a_damped_double_pendulum_in_sixty_digits(order):
    """Against differences in sixty digits of an integrator of its own."""
    scene = pendulum(STEP)
    q = np.array(STEP["q0"])
    v = np.asarray(scene.core().velocity(q[None], np.array(STEP["p0"])[None]))[0]
    run = derivative_step.outcome(derivative_step.PENDULUM, order // 2)
    x = {**{name: value for name, value in STEP.items() if name != "p0"}, "v0": v.tolist()}
    rng = np.random.default_rng(0)
    z = rng.standard_normal(4)
    one, two = ({name: rng.standard_normal(2).tolist() for name in ("q0", "v0", "tau")} for _ in range(2))
    expected = z @ precise.second_differences(run, x, one, two)
    options = {"duration": 0.05, "dt": 0.05, "order": order, "solver_tol": 1e-15}
    traj = cvi.simulate(scene, q, v, control=[STEP["tau"]], record="gradient", **options)
    w = {"q0": one["q0"], "v0": one["v0"], "control": [one["tau"]]}
    found = cvi.hessian_vector(traj, (z[:2], z[2:]), w, hessp="linear")
    names = {"q0": "q0", "v0": "v0", "control": "tau"}
    terms = [np.ravel(found.product[name]) * two[entry] for name, entry in names.items()]
    assert abs(np.sum(terms) - expected) <= 1e-12 * np.abs(terms).sum()


def test_treps_contracted_tensors():
    """The midpoint step's d2f/dx2 contracted with z, in momenta, is trep's."""
    scene = pendulum(STEP)
    q, p = np.array(STEP["q0"]), np.array(STEP["p0"])
    v = np.asarray(scene.core().velocity(q[None], p[None]))[0]
    z = np.array([1.0, -2.0, 0.0, 0.0])
    traj = cvi.simulate(
        scene, q, v, control=[STEP["tau"]], record="gradient", duration=0.05, dt=0.05, order=2, solver_tol=1e-15
    )
    tensors = derivative_trep.derivatives(derivative_step.PENDULUM, STEP)
    inputs = tensors.contracted(z)[2]
    for k in range(2):
        found = cvi.hessian_vector(traj, (z[:2], z[2:]), {"control": np.eye(2)[k : k + 1]}, hessp="linear")
        assert np.allclose(found.product["control"][0], inputs[k], rtol=1e-11, atol=1e-12 * np.abs(inputs).max())


def test_references_of_servos():
    """A reference acts as the torque kp times it."""
    scene, rng = chain(JOINTS["revolute"], 5)
    gains = rng.uniform(50, 200, scene.nv)
    for k in range(scene.nv):
        scene.set_servo(str(scene.model.names[k + 1]), kp=gains[k], kd=3.0)
    q, v = state_of(scene, rng)[:2]
    traj = cvi.simulate(scene, q, v, target=q + 0.1, record="gradient", duration=0.1, dt=0.02, order=4)
    cost = CurvedCost(traj, rng)
    du = rng.standard_normal((5, scene.nv))
    torque = cvi.hessian_vector(traj, cost, {"control": gains * du, "q0": np.ones(scene.nv)}, hessp=cost.hessp)
    names = ["control", "target", "target_velocity"]
    found = cvi.hessian_vector(traj, cost, {"target": du, "q0": np.ones(scene.nv)}, names, hessp=cost.hessp)
    assert np.array_equal(found.product["control"], torque.product["control"])
    assert np.array_equal(found.product["target"], gains * torque.product["control"])
    assert np.allclose(found.product["target_velocity"], 3.0 * torque.product["control"], rtol=1e-15)
    slope = cvi.gradient(traj, cost, names)[1]
    assert all(np.allclose(found.gradient[name], slope[name], rtol=1e-12, atol=1e-15) for name in names)


@pytest.mark.parametrize("order", [2, 4, 16])
def test_instruction_sets_give_equal_bits(order):
    names, before = _core.instruction_sets(), _core.instruction_set()
    if len(names) == 1:
        pytest.skip(f"this machine has {names} only")
    found = []
    try:
        for name in names:
            _core.instruction_set(name)
            start, rng = start_of(cases("mixed tree", order)[0]), np.random.default_rng(0)
            traj = start.run()
            cost = CurvedCost(traj, rng)
            product = cvi.hessian_vector(traj, cost, start.direction(rng), hessp=cost.hessp).product
            found.append(flat(product).tobytes())
    finally:
        _core.instruction_set(before)
    assert len(set(found)) == 1


def test_a_stored_run_has_the_same_bits(tmp_path):
    scene, q, v = at_wall(0.7)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.9, dt=0.01, order=4)
    cost, w = (np.ones(2), np.ones(2)), {"q0": np.ones(2), "control": np.ones((90, 2))}
    stored = cvi.Trajectory.load(traj.save(tmp_path / "run.npz"))
    one, two = (cvi.hessian_vector(run, cost, w, hessp="linear").product for run in (traj, stored))
    assert all(np.array_equal(one[name], two[name]) for name in w)


# -- impacts ----------------------------------------------------------------------------------------------------------


def hits(case: derivative_cases.Case) -> bool:
    """Whether a case has impacts without friction whose gaps have closed third derivatives."""
    parts = case.label.split()
    return case.options["impact"] == "ctec" and case.options["order"] in (2, 4) and (
        parts[0] in ("sphere", "box", "hull") and "e 0.7 mu 0.0" in case.label
    )  # fmt: skip


@pytest.mark.parametrize("case", [*filter(hits, derivative_cases.drops(1))], ids=lambda case: case.label)
def test_bodies_that_fall_on_the_ground(case):
    """Balls and corners on a plane, after a flight with turns."""
    start = start_of(case)
    assert len(start.run().events) > 0
    check_second(start, 2e-5)


BETWEEN = ("('sphere', 'sphere') ctec 0.7 0.0 0", "('sphere', 'box') ctec 0.7 0.0 0", "('box', 'hull') ctec 0.7 0.0 0")


@pytest.mark.parametrize("label", BETWEEN)
def test_two_bodies_that_meet(label):
    """A ball and a ball, a ball on a face and a corner on a face, which fly and turn."""
    start = start_of(next(case for case in derivative_cases.collisions(1) if case.label.startswith(label)))
    assert len(start.run().events) == 1
    check_second(start, 2e-5)


@pytest.mark.parametrize("order", [2, 4, 16])
def test_a_tip_that_hits_a_wall(order):
    scene, q, v = at_wall(0.7)
    options = {"duration": 0.9, "dt": 0.01, "order": order, "solver_tol": 1e-14}
    start = Start(scene, q, v, np.zeros((90, 2)), options)
    assert len(start.run().events) == 1
    check_second(start, 1e-4)


def test_joints_that_reach_their_limits():
    scene, rng = chain(JOINTS["revolute"], 3)
    q, v = state_of(scene, rng)[:2]
    for k in range(scene.nv):
        scene.set_joint(str(scene.model.names[k + 1]), limits=(q[k] - 0.3, q[k] + 0.3))
    start = Start(
        scene, q, 2.0 * v, np.zeros((40, scene.nv)), {"duration": 0.4, "dt": 0.01, "order": 4, "solver_tol": 1e-14}
    )
    assert len(start.run().events) == 2
    check_second(start, 1e-4)


def test_a_bounce_in_closed_form():
    """A ball that arrives at the speed s leaves at e s; both derivatives by the chain rule."""
    r, e, g, T, y0, v0 = 0.1, 0.7, 9.81, 0.5, 0.6, 0.4
    scene = cvi.Scene()
    scene.add_sphere("ball", r)
    scene.add_halfspace()
    scene.set_contact(restitution=e, friction=0.0)
    q, v = np.array([0.0, 0.0, y0, 0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, v0, 0.0, 0.0, 0.0])
    traj = cvi.simulate(scene, q, v, record="gradient", duration=T, dt=0.01, order=2, solver_tol=1e-15)
    assert len(traj.events) == 1
    # s and the rest of the time t = T - (v0 + s)/g, with their derivatives by y0 and v0; y = r + e s t - g t^2/2
    s = np.sqrt(v0**2 + 2.0 * g * (y0 - r))
    t, ds = T - (v0 + s) / g, np.array([g, v0]) / s
    dds = np.array([[0.0, 0.0], [0.0, 1.0]]) / s - np.outer([g, v0], [g, v0]) / s**3
    dt, ddt = -(np.array([0.0, 1.0]) + ds) / g, -dds / g
    assert abs(traj.q[-1, 2] - (r + e * s * t - 0.5 * g * t * t)) <= 1e-13
    place = e * (dds * t + np.outer(ds, dt) + np.outer(dt, ds) + s * ddt) - g * (np.outer(dt, dt) + t * ddt)
    up = np.eye(6)[2]
    for cost, expected in (((up, 0.0 * up), place), ((0.0 * up, up), e * dds - g * ddt)):
        for column, w in enumerate(({"q0": up}, {"v0": up})):
            found = cvi.hessian_vector(traj, cost, w, ["q0", "v0"], hessp="linear")
            got = [found.product["q0"][2], found.product["v0"][2]]
            assert np.abs(got - expected[column]).max() <= 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("order", [2, 4])
def test_an_impact_in_sixty_digits(order):
    """The double pendulum hits a wall inside of its only step; the oracle knows no gradient of it."""
    x = {name: value for name, value in STEP.items() if name != "p0"} | {
        "q0": [0.3, -0.42], "h": 0.1, "wall": 0.0, "e": 0.6, "damping": [0.0, 0.0], "stiffness": [0.0, 0.0]
    }  # fmt: skip
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    scene.set_contact(restitution=0.6)
    q, p = np.array(x["q0"]), np.array([-8.0, -3.0])
    v = np.asarray(scene.core().velocity(q[None], p[None]))[0]
    x["v0"] = v.tolist()
    run = derivative_step.outcome(derivative_step.PENDULUM, order // 2)
    rng = np.random.default_rng(0)
    z = rng.standard_normal(4)
    one, two = ({name: rng.standard_normal(2).tolist() for name in ("q0", "v0", "tau")} for _ in range(2))
    expected = z @ precise.second_differences(run, x, one, two)[:4]
    options = {"duration": 0.1, "dt": 0.1, "order": order, "solver_tol": 1e-15}
    traj = cvi.simulate(scene, q, v, control=[x["tau"]], record="gradient", **options)
    assert len(traj.events) == 1
    w = {"q0": one["q0"], "v0": one["v0"], "control": [one["tau"]]}
    found = cvi.hessian_vector(traj, (z[:2], z[2:]), w, hessp="linear")
    names = {"q0": "q0", "v0": "v0", "control": "tau"}
    terms = [np.ravel(found.product[name]) * two[entry] for name, entry in names.items()]
    assert abs(np.sum(terms) - expected) <= 1e-10 * np.abs(terms).sum()


REFUSED = {
    "friction": ({"friction": 0.3}, {}, "friction"), "map": ({}, {"impact": "mhc", "order": 4}, "Implicit"),
    "persistent": ({"restitution": 0.0}, {}, "Persistent|several points|end of a step"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_impacts_without_a_second_derivative_are_told(name):
    contact, options, word = REFUSED[name]
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    scene.add_halfspace()
    scene.set_contact(**{"restitution": 0.7, "friction": 0.0, **contact})
    q = np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0])
    v = np.array([0.3, 0.0, 0.4, 0.0, 0.0, 0.0])
    traj = cvi.simulate(scene, q, v, record="gradient", **{"duration": 0.5, "dt": 0.01, "order": 2, **options})
    cost, w = (np.ones(6), np.ones(6)), {"v0": np.ones(6)}
    with pytest.raises(cvi.NotDifferentiable, match=word) as told:
        cvi.hessian_vector(traj, cost, w, hessp="linear")
    assert told.value.reason == "second"
    found = cvi.hessian_vector(traj, cost, w, hessp="linear", method="auto")
    assert isinstance(found.approximate, cvi.NotDifferentiable)
    assert np.array_equal(found.gradient["v0"], cvi.gradient(traj, cost, "v0")[1]["v0"])


def test_gaps_without_a_third_derivative_are_told():
    case = next(case for case in derivative_cases.drops(1) if case.label.startswith("cylinder ctec e 0.7 mu 0.0"))
    traj = start_of(case).run()
    with pytest.raises(cvi.NotDifferentiable, match="rim") as told:
        cvi.hessian_vector(traj, (np.ones(6), np.ones(6)), {"v0": np.ones(6)}, hessp="linear")
    assert told.value.reason == "second"


# -- Gauss-Newton -----------------------------------------------------------------------------------------------------


def test_gauss_newton_is_the_sensitivity_on_both_sides():
    """Through impacts with all that has a gradient, inputs step by step included."""
    scene, q, v = at_wall(0.7)
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.9, dt=0.01, order=4)
    assert len(traj.events) > 0
    rng = np.random.default_rng(0)
    cost = CurvedCost(traj, rng)
    names = ["q0", "v0", "control", "restitution", "mass:joint_1", "gravity"]
    S = traj.sensitivity(names)
    value = {name: rng.standard_normal(S.of(name).shape[2]) for name in names}
    control = np.tile(value["control"], (len(traj.t) - 1, 1))
    moved = S.matrix @ np.concatenate([value[name] for name in names])
    hq, hv = cost.hessp(traj.t, traj.q, traj.v, moved[:, :2], moved[:, 2:])
    found = cvi.hessian_vector(
        traj, cost, {**value, "control": control}, hessp=cost.hessp, method="gauss-newton", on_kink="taken"
    )
    assert "gauss-newton" in str(found.approximate)
    for name in names:
        expected = np.einsum("ni,nik->k", np.hstack([hq, hv]), S.of(name))
        got = found.product[name].sum(axis=0) if name == "control" else found.product[name]
        assert np.allclose(got, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max()), name


def test_what_has_no_second_derivative_is_told():
    scene, q, v = at_wall(0.7)
    cost = (np.ones(2), np.ones(2))
    scene.add_force(lambda t, q, v: -0.1 * v**3, lambda t, q, v: (np.zeros((2, 2)), np.diag(-0.3 * v**2)), name="drag")
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.05, dt=0.01, order=4)
    with pytest.raises(cvi.DerivativeError, match="'drag'"):
        cvi.hessian_vector(traj, cost, {"q0": np.ones(2)}, hessp="linear")
    found = cvi.hessian_vector(traj, cost, {"q0": np.ones(2)}, hessp="linear", method="auto")
    assert isinstance(found.approximate, cvi.DerivativeError)
    assert not np.any(found.product["q0"])
    with pytest.raises(cvi.NotDifferentiable, match="mass:joint_1") as told:
        cvi.hessian_vector(traj, cost, {"mass:joint_1": [1.0]}, hessp="linear")
    assert told.value.reason == "second"


def test_arguments_that_do_not_fit_are_told():
    scene, rng = chain(JOINTS["revolute"], 5)
    q, v = state_of(scene, rng)[:2]
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.1, dt=0.02)
    nv = scene.nv
    cost, w = (np.ones(nv), np.ones(nv)), {"q0": np.ones(nv)}
    for bad in ({}, None, {"q": np.ones(nv)}, {"q0": np.ones(nv + 1)}, {"control": np.ones(nv)}):
        with pytest.raises(cvi.InputError):
            cvi.hessian_vector(traj, cost, bad, hessp="linear")
    for hessp in (None, "zero", lambda t, q, v: 0.0, lambda t, q, v, dq, dv: dq, lambda t, q, v, dq, dv: (dq, 0.0)):
        with pytest.raises(cvi.InputError):
            cvi.hessian_vector(traj, cost, w, hessp=hessp)
    with pytest.raises(cvi.InputError):
        cvi.hessian_vector(traj, cost, w, ["friktion"], hessp="linear")
    with pytest.raises(cvi.InputError):
        cvi.hessian_vector(traj, cost, w, hessp="linear", method="newton")
    with pytest.raises(cvi.InputError):
        cvi.hessian_vector(scene, cost, w, hessp="linear")


def test_an_error_in_the_cost_comes_through():
    scene, rng = chain(JOINTS["revolute"], 5)
    q, v = state_of(scene, rng)[:2]
    traj = cvi.simulate(scene, q, v, record="gradient", duration=0.1, dt=0.02)

    def hessp(t, q, v, dq, dv):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        cvi.hessian_vector(traj, (np.ones(scene.nv), np.ones(scene.nv)), {"q0": np.ones(scene.nv)}, hessp=hessp)
