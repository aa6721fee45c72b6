"""The derivatives of a step against differences of the step, closed forms, and Pinocchio's derivatives as dt -> 0."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from batteries import models
from helpers.chains import JOINTS, chain, form, state_of, with_elements
from oracles import derivative_flow, derivative_step, precise

H = 0.05  # [s]


def tangent(model: pin.Model, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The tangent vector from a to b, which are close. Pinocchio's has 1e-8 of noise where q holds (cos, sin)."""
    found = pin.difference(model, a, b)
    for k in range(1, model.njoints):
        i, iv, kind = model.idx_qs[k], model.idx_vs[k], model.joints[k].shortname()
        if kind.startswith("JointModelRUB") or "Planar" in kind:
            c0, s0, c1, s1 = *a[i + model.nqs[k] - 2 : i + model.nqs[k]], *b[i + model.nqs[k] - 2 : i + model.nqs[k]]
            found[iv + model.nvs[k] - 1] = np.arctan2(c0 * s1 - s0 * c1, c0 * c1 + s0 * s1)
            if "Planar" in kind:
                found[iv : iv + 2] = np.array([[c0, s0], [-s0, c0]]) @ (b[i : i + 2] - a[i : i + 2])
    return found


def differences(scene, q, v, tau, dt, order, state, **inputs) -> tuple[np.ndarray, np.ndarray]:
    """Fourth-order central differences of the step in (q, x, tau, dt), and their own error: two step sizes compared."""
    model, core, nv = scene.model, scene.core(), scene.nv
    sim = cvi.Simulator(scene, dt=dt, order=order, solver_tol=1e-15, contact_mode="events")
    x = np.asarray(core.momentum(q[None], v[None]))[0] if state == "momentum" else v
    middle = cvi.step_derivatives(scene, q, v, tau, dt, order=order, state=state, **inputs)

    def end(change: np.ndarray) -> np.ndarray:
        dq, dx, force, longer = np.split(change, [nv, 2 * nv, 3 * nv])
        at, beside = pin.integrate(model, q, dq), x + dx
        speed = np.asarray(core.velocity(at[None], beside[None]))[0] if state == "momentum" else beside
        own = sim if longer[0] == 0.0 else cvi.Simulator(scene, dt=dt + longer[0], order=order, solver_tol=1e-15)
        own.reset(at, speed)
        own.step(tau + force, **inputs)
        return np.concatenate([tangent(model, middle.q, own.q), own.p if state == "momentum" else own.v])

    def column(k: int, size: float) -> np.ndarray:
        unit = np.zeros(3 * nv + 1)
        unit[k] = size
        return (8.0 * (end(unit) - end(-unit)) - (end(2.0 * unit) - end(-2.0 * unit))) / (12.0 * size)

    sizes = [(4e-3, 2e-3) if k < 3 * nv else (4e-3 * dt, 2e-3 * dt) for k in range(3 * nv + 1)]
    wide, near = (np.array([column(k, size[j]) for k, size in enumerate(sizes)]).T for j in (0, 1))
    return near, np.abs(near - wide)


def assert_derivative(scene, q, v, tau, order, state="velocity", dt=H, **inputs) -> None:
    step = cvi.step_derivatives(scene, q, v, tau, dt, order=order, state=state, **inputs)
    found = np.column_stack([step.A, step.B, step.dt])
    expected, own_error = differences(scene, q, v, tau, dt, order, state, **inputs)
    scale = np.maximum(np.abs(found).max(axis=0), 1e-3)
    allowed = np.maximum(1e-9 * scale, own_error.max(axis=0))
    assert np.all(np.abs(found - expected).max(axis=0) <= allowed)
    assert np.median(own_error.max(axis=0) / scale) < 1e-7  # the differences are worth something


@pytest.mark.parametrize("state", ["velocity", "momentum"])
@pytest.mark.parametrize("order", [2, 4, 16])
@pytest.mark.parametrize("joints", JOINTS)
def test_every_joint(joints, order, state):
    scene, rng = chain(JOINTS[joints])
    assert_derivative(scene, *state_of(scene, rng), order, state)


@pytest.mark.parametrize("order", [2, 8])
@pytest.mark.parametrize("joints", ["revolute", "continuous", "helical", "spherical", "free", "planar"])
def test_every_force(joints, order):
    scene, rng = with_elements(joints)
    q, v, tau = state_of(scene, rng)
    assert_derivative(scene, q, v, tau, order, dt=0.02)


@pytest.mark.parametrize("order", [2, 4])
def test_servos(order):
    scene, rng = chain(JOINTS["revolute"], 2)
    scene.set_servo("*", kp=400.0, kd=30.0)
    q, v, tau = state_of(scene, rng)
    assert_derivative(scene, q, v, tau, order, dt=0.01, target=np.array([0.3, -0.2, 0.4]))


@pytest.mark.parametrize("joints", JOINTS)
@pytest.mark.parametrize("order", [2, 8])
def test_without_damping_the_map_of_momenta_is_symplectic(joints, order):
    """A^T J A = J in canonical coordinates; with joints that turn, in the left-trivialised form of the bracket."""
    scene, rng = chain(JOINTS[joints], 3)
    q, v, _ = state_of(scene, rng)
    step = cvi.step_derivatives(scene, q, v, None, H, order=order, state="momentum")
    p = np.asarray(scene.core().momentum(q[None], v[None]))[0]
    before, after = form(scene, p), form(scene, step.x)
    assert np.abs(step.A.T @ after @ step.A - before).max() < 1e-11 * np.abs(before).max() * np.abs(step.A).max() ** 2


@pytest.mark.parametrize("joints", ["revolute", "spherical", "free"])
def test_forward_dynamics(joints):
    """The acceleration is that of a run's first instants; its derivatives are those of its differences."""
    scene, rng = with_elements(joints)
    q, v, tau = state_of(scene, rng)
    found = cvi.forward_dynamics_derivatives(scene, q, v, tau)

    def acceleration(at, speed, force):
        return cvi.forward_dynamics_derivatives(scene, at, speed, force).a

    # v(h) - v(0) over h at h, h/2, h/4, extrapolated to h = 0: O(h^3) and the rounding of v over h are left.
    h = 1e-3
    rates = [(cvi.step_derivatives(scene, q, v, tau, s, order=16).x - v) / s for s in (h, h / 2.0, h / 4.0)]
    first, second = 2.0 * rates[1] - rates[0], 2.0 * rates[2] - rates[1]
    assert found.a == pytest.approx((4.0 * second - first) / 3.0, abs=1e-5 * max(1.0, np.abs(found.a).max()))
    for columns, moved in (
        (found.a_q, lambda d: acceleration(pin.integrate(scene.model, q, d), v, tau)),
        (found.a_v, lambda d: acceleration(q, v + d, tau)),
        (found.a_tau, lambda d: acceleration(q, v, tau + d)),
    ):
        for k in range(scene.nv):
            d = 1e-3 * np.eye(scene.nv)[k]
            slope = (8.0 * (moved(d) - moved(-d)) - (moved(2.0 * d) - moved(-2.0 * d))) / 12e-3
            assert columns[:, k] == pytest.approx(slope, abs=1e-8 * max(1.0, np.abs(columns).max()))


@pytest.mark.parametrize(("order", "sizes"), [(2, (0.02, 0.005)), (4, (0.08, 0.02)), (8, (0.1, 0.05))])
def test_many_steps_converge_to_the_flow_with_the_order(order, sizes):
    """A and B of a run of steps against the variational equations of the flow with Pinocchio's derivatives."""
    scene, rng = chain(JOINTS["free"], 4)
    q0, v0, tau = state_of(scene, rng)
    tau, duration = 0.3 * tau, 0.4
    flow = derivative_flow.flow_linearisation(scene.model, q0, v0, duration, tau)
    errors = []
    for dt in sizes:
        q, v, A, B = q0, v0, np.eye(2 * scene.nv), np.zeros((2 * scene.nv, scene.nv))
        for _ in range(round(duration / dt)):
            step = cvi.step_derivatives(scene, q, v, tau, dt, order=order)
            A, B = step.A @ A, step.A @ B + step.B
            q, v = step.q, step.x
        errors.append(max(np.abs(A - flow.A).max(), np.abs(B - flow.B).max()))
    measured = np.log(errors[0] / errors[1]) / np.log(sizes[0] / sizes[1])
    assert measured == pytest.approx(order, abs=0.35), errors


# -- what is refused --------------------------------------------------------------------------------------------------


def ball(height: float) -> tuple[cvi.Scene, np.ndarray]:
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1, placement=(0.0, 0.0, 0.1 + height))
    scene.add_halfspace()
    return scene, scene.neutral()


def test_contact_is_refused():
    scene, q = ball(1e-4)
    with pytest.raises(cvi.NotDifferentiable, match="impact in the step") as caught:
        cvi.linearize(scene, q, [0, 0, -1.0, 0, 0, 0], dt=1e-3)
    assert caught.value.reason == "impact"
    assert set(caught.value.pair) == {"ball", "ground"}
    assert caught.value.time == pytest.approx(1e-4, rel=1e-2)
    scene, q = ball(0.0)
    with pytest.raises(cvi.NotDifferentiable, match="persistent contact in the step"):
        cvi.linearize(scene, q)
    with pytest.raises(cvi.NotDifferentiable, match="Something touches"):
        cvi.forward_dynamics_derivatives(scene, q)


def test_a_limit_that_touches_is_refused():
    model = pin.Model()
    joint = model.addJoint(
        0, pin.JointModelRX(), pin.SE3.Identity(), "hinge", np.ones(1), np.ones(1), np.zeros(1), np.ones(1)
    )
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model, name="hinge")
    assert cvi.forward_dynamics_derivatives(scene, [0.5]).a_q.shape == (1, 1)
    with pytest.raises(cvi.NotDifferentiable, match="Something touches") as caught:
        cvi.forward_dynamics_derivatives(scene, [0.0])
    assert caught.value.pair == ("hinge", "lower limit")


def test_constraints_saturation_and_missing_derivatives_are_refused():
    scene, rng = chain(JOINTS["revolute"], 2)
    q, v, _ = state_of(scene, rng)
    scene.set_servo("*", kp=400.0, kd=30.0, effort=0.1)
    with pytest.raises(cvi.NotDifferentiable, match="actuator is at its limit"):
        cvi.linearize(scene, q, v, dt=1e-2, target=np.zeros(3))
    scene, _ = chain(JOINTS["revolute"], 2)
    scene.set_joint("j0", friction=1.0)
    with pytest.raises(cvi.NotDifferentiable, match="joint friction"):
        cvi.forward_dynamics_derivatives(scene, q, v)
    scene, _ = chain(JOINTS["revolute"], 2)
    name = scene.add_force(lambda t, q, v: -v)
    with pytest.raises(cvi.DerivativeError, match=f"'{name}' has no derivatives"):
        cvi.forward_dynamics_derivatives(scene, q, v)


# -- an oracle that shares nothing with the engine --------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4, 16])
def test_a_damped_double_pendulum_in_sixty_digits(order):
    """Against differences in sixty digits of an integrator of its own, written from the equations alone."""
    x = {
        "q0": [0.3, -0.42], "p0": [-1.7, -0.5], "tau": [0.3, -0.2], "h": 0.05, "masses": [1.0, 1.0],
        "lengths": [1.0, 1.0], "gravity": 9.81, "damping": [0.1, 0.3], "stiffness": [2.0, 1.0], "wall": -5.0, "e": 1.0,
    }  # fmt: skip
    run = derivative_step.outcome(derivative_step.PENDULUM, order // 2)
    expected = precise.complex_differences(run, x, ["q0", "p0", "tau", "h"])
    scene = cvi.Scene.from_pinocchio(models.double_pendulum(), name="pendulum")
    for k in range(2):
        scene.set_joint(f"joint{k + 1}", damping=x["damping"][k], stiffness=x["stiffness"][k], rest=0.0)
    q, p = np.array(x["q0"]), np.array(x["p0"])
    v = np.asarray(scene.core().velocity(q[None], p[None]))[0]
    step = cvi.step_derivatives(scene, q, v, x["tau"], x["h"], order=order, state="momentum")
    found = np.column_stack([step.A, step.B, step.dt])
    assert np.abs(found - expected).max() <= 1e-13 * np.abs(expected).max()


def test_the_oscillator_in_closed_form():
    """A mass on a spring: order 2 is the Cayley map of the linear system, (1 - h K/2)^-1 (1 + h K/2)."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(model, name="oscillator")
    scene.set_joint("slide", stiffness=18.0, damping=0.6)
    K = np.array([[0.0, 1.0], [-9.0, -0.3]])
    half = 0.5 * 0.1 * K
    A, B = cvi.linearize(scene, [0.4], [-1.0], [0.7], 0.1)
    inverse = np.linalg.inv(np.eye(2) - half)
    assert pytest.approx(inverse @ (np.eye(2) + half), abs=1e-14) == A
    assert pytest.approx(inverse @ np.array([[0.0], [0.05]]), abs=1e-14) == B


# -- steps that need no run -------------------------------------------------------------------------------------------


def no_run(*_args, **_options):
    raise RuntimeError("a run was made")


def test_a_step_that_is_far_from_all_contact_makes_no_run(monkeypatch):
    scene, q = ball(0.5)
    v, tau = np.array([0.3, 0.0, -1.0, 0.1, 0.2, 0.0]), np.array([0.0, 0.1, 0.2, 0.0, 0.0, 0.3])
    compare_with_a_run(scene, q, v, tau, monkeypatch)


def test_a_step_within_the_limits_of_actuators_makes_no_run(monkeypatch):
    scene, rng = chain(JOINTS["revolute"], 2)
    scene.set_actuator("*", effort=100.0, velocity=10.0)
    scene.set_servo("*", kp=40.0, kd=3.0)
    compare_with_a_run(scene, *state_of(scene, rng), monkeypatch, target=np.array([0.3, -0.2, 0.4]))


def compare_with_a_run(scene, q, v, tau, monkeypatch, **inputs) -> None:
    cvi.linearize(scene, q, v, tau, **inputs)
    monkeypatch.setattr("contactvi.derivatives.linear.Run", no_run)
    found = cvi.step_derivatives(scene, q, v, tau, **inputs)
    monkeypatch.undo()
    monkeypatch.setattr("contactvi.derivatives.linear._clear_step", lambda *_: None)
    checked = cvi.step_derivatives(scene, q, v, tau, **inputs)
    for name in ("q", "x", "A", "B", "dt"):
        assert getattr(found, name) == pytest.approx(getattr(checked, name), rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("order", [2, 8])
def test_what_may_touch_is_left_to_a_run(order, monkeypatch):
    """A ball that comes nearer to the ground than it moves in the step, without touching it."""
    scene, q = ball(1.5e-3)
    v = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    near = cvi.step_derivatives(scene, q, v, order=order)
    far = cvi.step_derivatives(*ball(1.0), v, order=order)
    assert pytest.approx(far.A, abs=1e-14) == near.A
    monkeypatch.setattr("contactvi.derivatives.linear.Run", no_run)
    with pytest.raises(RuntimeError, match="a run was made"):
        cvi.linearize(scene, q, v, order=order)


def test_steps_of_other_lengths_orders_and_states_do_not_mix():
    """What is kept from one step to the next changes no digit."""
    scene, rng = chain(JOINTS["free"], 5)
    q, v, tau = state_of(scene, rng)
    asked = [
        {"dt": dt, "order": order, "state": state}
        for dt in (1e-3, 2e-2)
        for order in (2, 8)
        for state in ("velocity", "momentum")
    ]
    fresh = [cvi.step_derivatives(chain(JOINTS["free"], 5)[0], q, v, tau, **each) for each in asked]
    for _ in range(2):
        for each, expected in zip(asked, fresh, strict=True):
            found = cvi.step_derivatives(scene, q, v, tau, **each)
            assert found.A.tobytes() == expected.A.tobytes()
            assert found.dt.tobytes() == expected.dt.tobytes()
    with pytest.raises(cvi.InputError, match="dt"):
        cvi.linearize(scene, q, v, dt=-1.0)


def test_a_scene_that_its_own_functions_hold_is_collected():
    """The engine that linearises is kept with the scene, which the functions of the user may hold in turn."""

    def make() -> weakref.ref:
        scene, rng = chain(JOINTS["revolute"], 2)
        damping = -0.1 * np.eye(scene.nv)

        def force(t, q, v, scene=scene):
            return damping @ v

        scene.add_force(force, lambda t, q, v: (0.0 * damping, damping))
        q, v, tau = state_of(scene, rng)
        for _ in range(2):
            cvi.linearize(scene, q, v, tau)
        return weakref.ref(force)

    force = make()
    gc.collect()
    assert force() is None


def test_functions_of_the_user_are_asked_once_for_all_directions():
    asked = []

    def derivatives(t, q, v):
        asked.append(t)
        return np.zeros((7, 7)), -np.eye(7)

    scene, _ = chain([pin.JointModelRZ()] * 7)
    scene.add_force(lambda t, q, v: -v, derivatives)
    q, v = scene.neutral(), np.ones(7)
    cvi.simulate(scene, q, v, duration=1e-3, dt=1e-3)  # checks them against differences
    asked.clear()
    cvi.forward_dynamics_derivatives(scene, q, v)
    assert len(asked) == 1
