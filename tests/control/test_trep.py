"""contactvi.trep: steps as a discrete system with trep's names, its derivatives, and feedback along trajectories."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

import contactvi as cvi
from batteries import models
from contactvi.derivatives.inertia import MassDerivatives
from contactvi.trep import DiscreteSystem, solve_tv_lqr
from helpers.chains import chain, state_of
from helpers.derivative_cases import FAMILIES, tree
from helpers.thinning import every
from oracles import derivative_step, derivative_trep

MODELS = Path(__file__).resolve().parents[2] / "models"
STEP = {
    "q0": [0.3, -0.42], "p0": [-1.7, -0.5], "tau": [0.3, -0.2], "h": 0.05, "masses": [1.0, 1.0],
    "lengths": [1.0, 1.0], "gravity": 9.81, "damping": [0.1, 0.3], "stiffness": [2.0, 1.0],
}  # fmt: skip
CHECKS = ("fdx", "fdu", "fdxdx", "fdxdu", "fdudu")


def pendulum() -> cvi.Scene:
    scene = cvi.Scene.from_pinocchio(models.double_pendulum(), name="pendulum")
    for k in range(2):
        scene.set_joint(f"joint{k + 1}", damping=STEP["damping"][k], stiffness=STEP["stiffness"][k], rest=0.0)
    return scene


def cart() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(MODELS / "cart_pendulum.urdf", limits=False)
    return scene


def elastic_arm(seed: int = 5) -> tuple[cvi.Scene, np.random.Generator]:
    """Five turning joints with springs, dampers, armature and a spring between two points."""
    scene, rng = chain(FAMILIES["revolute"] + FAMILIES["prismatic"][:2], seed)
    scene.set_joint("*", damping=0.3, stiffness=5.0, armature=0.1)
    scene.add_spring("b0", "world", 40.0, damping=1.5, rest_length=0.2, point_a=(0.3, 0.1, 0.2), point_b=(0.5, 1, 1))
    return scene, rng


def largest(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


# --- one step -------------------------------------------------------------------------------------------------------
def test_names_and_shapes():
    system = DiscreteSystem(cart(), np.arange(11) * 0.02, inputs=["slide"])
    assert (system.nX, system.ndX, system.nU, system.kf(), system.input_names) == (4, 4, 1, 10, ["slide"])
    x, u = system.build_state([0.1, 0.5], v=[1.0, -2.0]), system.build_input([3.0])
    system.set(x, u, 2)
    assert system.k == 2
    assert np.array_equal(system.xk, x)
    assert np.array_equal(system.uk, u)
    z = np.ones(4)
    shapes = [part.shape for part in (system.f(), system.fdx(), system.fdu(), system.fdxdx(z), system.fdxdu(z))]
    assert shapes == [(4,), (4, 4), (4, 1), (4, 4), (4, 1)]
    assert system.fdudu(z).shape == (1, 1)
    parts = system.split_state(x)
    assert np.allclose(parts.v, [1.0, -2.0], rtol=1e-14)
    assert np.allclose(parts.p, system.scene.core().momentum(parts.Q[None], parts.v[None])[0], rtol=1e-14)
    next_one = system.f()
    system.step([1.0])
    assert system.k == 3
    assert np.array_equal(system.xk, next_one)
    X, U = system.build_trajectory(Q=np.tile([0.1, 0.5], (11, 1)), u=np.ones((10, 1)))
    assert np.array_equal(system.split_trajectory(X, U).Q, X[:, :2])
    assert np.array_equal(system.split_trajectory(X, U).u, U)
    assert system.build_trajectory().X.shape == (11, 4)


@pytest.mark.parametrize("order", [2, 6])
def test_steps_are_those_of_the_simulator_to_the_bit(order):
    """From velocities; from momenta, whose change to velocities is rounded, the first step is."""
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    scene.set_joint("*", damping=0.1)
    system = DiscreteSystem(scene, dt=0.01, steps=100, order=order, state="velocity")
    U = np.random.default_rng(0).standard_normal((100, 2))
    X = system.simulate(system.build_state(scene.q0), U).X
    sim = cvi.Simulator(scene, dt=0.01, order=order)
    sim.reset()
    for k in range(100):
        assert np.array_equal(X[k], np.concatenate([sim.q, sim.v])), k
        q, v = sim.q, sim.v
        sim.reset(q, v, system.time[k])  # a step from a state, without what a run remembers
        sim.step(U[k])
    momenta = DiscreteSystem(scene, dt=0.01, steps=1, order=order)
    momenta.set(momenta.build_state(scene.q0), U[0], 0)
    assert np.array_equal(momenta.f()[:2], X[1, :2])


@pytest.mark.thinned(2)
@pytest.mark.parametrize("state", ["velocity", "momentum"])
@pytest.mark.parametrize("family", every(2, [*FAMILIES, "arm"]))
def test_derivatives_against_differences(family, state):
    """All joints, those with turns in the coordinates of changes; differences of 1e-5 of numbers near 1 keep 1e-8."""
    if family == "arm":
        scene, rng = elastic_arm()
    else:
        scene, rng = tree(3) if family == "mixed tree" else chain(FAMILIES[family], 5)
    q, v = state_of(scene, rng)[:2]
    system = DiscreteSystem(scene, dt=0.02, steps=1, state=state, order=4, solver_tol=1e-14)
    x, u = system.build_state(q, v=v), rng.standard_normal(system.nU)
    for name in CHECKS:
        found = getattr(system, f"check_{name}")(x, u, 0)
        assert found.error <= 1e-7 * (found.exact_norm + 0.1), name


def test_derivatives_of_mass_against_differences(monkeypatch: pytest.MonkeyPatch):
    """Without a pin.Data of the model, whose tensors have the size nv^3."""
    scene, rng = tree(7)
    for name in ("j1", "j2", "j3"):
        scene.set_joint(name, armature=0.2)
    model, core = scene.model, scene.core()
    for place, name in ((pin.Model, "createData"), (pin, "Data")):
        monkeypatch.setattr(place, name, None)
    mass = MassDerivatives(model)
    q, y, w, d = state_of(scene, rng)[0], *rng.standard_normal((3, scene.nv))

    def value(step: float) -> float:
        moved = np.asarray(pin.integrate(model, q, step * d))
        return float(y @ np.asarray(core.momentum(moved[None], w[None]))[0])

    h = 1e-3  # sixth-order differences: 1e-13 / h^2 of rounding
    weights = {0: -49 / 18, 1: 3 / 2, 2: -3 / 20, 3: 1 / 90}
    second = sum(c * (value(k * h) + (value(-k * h) if k else 0.0)) for k, c in weights.items()) / h**2
    first = sum(c * (value(k * h) - value(-k * h)) for k, c in {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}.items()) / h
    assert abs(d @ mass.second(q, y, w) @ d - second) <= 1e-6 * abs(second)
    assert abs(y @ mass.first(q, w) @ d - first) <= 1e-10 * abs(first)
    assert np.allclose(mass.mass(q) @ w, np.asarray(core.momentum(q[None], w[None]))[0], rtol=1e-12)


def test_treps_tensors():
    """All of trep's first and second derivatives of the damped double pendulum, from an oracle in Decimal."""
    system = DiscreteSystem(pendulum(), dt=STEP["h"], steps=1, solver_tol=1e-15)
    x, u = np.array(STEP["q0"] + STEP["p0"]), np.array(STEP["tau"])
    system.set(x, u, 0)
    tensors = derivative_trep.derivatives(derivative_step.PENDULUM, STEP)
    assert largest(system.f(), tensors.f) <= 1e-14
    assert largest(system.fdx(), tensors.fdx) <= 1e-12
    assert largest(system.fdu(), tensors.fdu) <= 1e-12
    for z in [*np.eye(4), np.array([1.0, -2.0, 0.5, 0.3])]:
        expected = tensors.contracted(z)
        found = system.fdxdx(z), system.fdxdu(z), system.fdudu(z)
        assert all(largest(a, b) <= 1e-11 for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("order", [2, 8])
def test_fdx_is_symplectic_in_momenta(order):
    scene, rng = chain(FAMILIES["revolute"] + FAMILIES["prismatic"][:2], 5)
    scene.set_joint("*", stiffness=5.0)
    q, v = state_of(scene, rng)[:2]
    system = DiscreteSystem(scene, dt=0.05, steps=1, order=order)
    system.set(system.build_state(q, v=v), np.zeros(system.nU), 0)
    n, A = scene.nv, system.fdx()
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    assert np.abs(A.T @ J @ A - J).max() <= 1e-12 * np.abs(A).max() ** 2


def near_impact(state: str, order: int = 2) -> tuple[DiscreteSystem, np.ndarray, np.ndarray, int]:
    """A step of the double pendulum in which its tip hits the wall."""
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    traj = cvi.simulate(scene, duration=1.0, dt=0.01, order=order, solver_tol=1e-14)
    k = int((traj.events[0].time - 0.0) / 0.01)
    system = DiscreteSystem(scene, dt=0.01, steps=100, order=order, state=state, solver_tol=1e-14)
    return system, system.build_state(traj.q[k], v=traj.v[k]), np.array([0.2, -0.1]), k


@pytest.mark.parametrize("state", ["velocity", "momentum"])
@pytest.mark.parametrize("order", [2, 4])
def test_derivatives_through_an_impact(state, order):
    system, x, u, k = near_impact(state, order)
    system.set(x, u, k)
    smooth = DiscreteSystem(cvi.Scene.from_pinocchio(system.scene.model), dt=0.01, steps=100, order=order, state=state)
    smooth.set(x, u, k)
    assert np.abs(system.f() - smooth.f()).max() > 0.1  # there is an impact in it
    for name in CHECKS:
        found = getattr(system, f"check_{name}")(x, u, k, delta=1e-6)
        assert found.error <= 1e-6 * (found.exact_norm + 0.1), name


def test_targets_of_servos_are_inputs():
    scene = cart()
    scene.set_servo("slide", kp=200.0, kd=10.0)
    system = DiscreteSystem(scene, dt=0.01, steps=5, inputs=["hinge"], targets=["slide"])
    assert system.input_names == ["hinge", "slide target"]
    x, u = system.build_state([0.1, 0.4], v=[0.3, 0.2]), system.build_input(u=[0.5], rho=[0.2])
    assert system.split_input(u) == ([0.5], [0.2])
    for name in CHECKS:
        found = getattr(system, f"check_{name}")(x, u, 0)
        assert found.error <= 1e-7 * (found.exact_norm + 0.1), name
    sim = cvi.Simulator(scene, dt=0.01)
    system.set(x, u, 0)
    sim.reset([0.1, 0.4], system.split_state(x).v)
    sim.step([0.0, 0.5], target=[0.2])
    assert np.array_equal(system.f(), np.concatenate([sim.q, sim.p]))


def test_a_prescribed_joint_moves_with_time():
    scene = cart()
    scene.prescribe("slide", lambda t: (0.1 * t * t, 0.2 * t, 0.2))
    system = DiscreteSystem(scene, dt=0.01, steps=10, t0=0.5, state="velocity", inputs=["hinge"])
    X = system.simulate(system.build_state([0.025, 0.3], v=[0.1, 0.0]), np.zeros((10, 1))).X
    assert np.allclose(X[:, 0], 0.1 * system.time**2, atol=1e-12)
    with pytest.raises(cvi.NotDifferentiable):
        system.fdxdx(np.ones(4))


# --- trajectories ---------------------------------------------------------------------------------------------------
def test_the_projection_of_a_motion_is_itself():
    system = DiscreteSystem(cart(), dt=0.02, steps=30, inputs=["slide"])
    U = np.sin(np.arange(30))[:, None]
    X = system.simulate(system.build_state([0.0, 0.3]), U).X
    found = system.project(X, U)
    assert np.allclose(found.X, X, atol=1e-12)
    assert np.allclose(found.U, U, atol=1e-12)
    K, A, B = system.calc_feedback_controller(X, U)
    dX, dU = (1e-6 * np.random.default_rng(k).standard_normal(part.shape) for k, part in enumerate((X, U)))
    plus, minus = (system.project(X + s * dX, U + s * dU, K) for s in (1, -1))
    change = system.dproject(A, B, dX, dU, K)
    assert np.allclose((plus.X - minus.X) / 2, change.dX, atol=1e-5 * np.abs(change.dX).max())
    assert np.allclose((plus.U - minus.U) / 2, change.dU, atol=1e-5 * np.abs(change.dU).max())


def test_feedback_holds_a_pendulum_upright():
    """Without feedback it falls. The gains of an end that goes on for ever are all the same."""
    system = DiscreteSystem(cart(), dt=0.02, steps=600, inputs=["slide"])
    X, U = system.build_trajectory(Q=np.tile([0.0, np.pi], (601, 1)))
    K = system.calc_feedback_controller(X, U, end="stationary").Kproj
    assert np.allclose(K, K[0], rtol=1e-6)
    fallen, held = ([system.integrate(X[0], np.array([0.0, 0.1, 0.0, 0.0]))] for _ in range(2))
    for k in range(600):
        for gain, states in ((0.0 * K[k], fallen), (K[k], held)):
            system.set(states[-1], U[k] - gain @ system.difference(X[k], states[-1]), k)
            states.append(system.f())
    assert np.abs(system.difference(X[-1], held[-1])).max() < 1e-2
    assert np.abs([system.difference(X[0], x)[1] for x in fallen]).max() > 1.0


def test_lqr_against_a_dense_minimum():
    """The gain at k = 0 and the cost-to-go of random systems, from the minimum over all inputs at once."""
    rng = np.random.default_rng(1)
    N, n, m = 6, 3, 2
    A, B = rng.standard_normal((N, n, n)), rng.standard_normal((N, n, m))
    Qs = [np.eye(n) * (k + 1) for k in range(N + 1)]
    K, P = solve_tv_lqr(A, B, lambda k: Qs[k], np.diag([0.5, 2.0]))

    def cost(u: np.ndarray, x: np.ndarray) -> float:
        total = 0.0
        for k, uk in enumerate(u.reshape(N, m)):
            total += x @ Qs[k] @ x + uk @ np.diag([0.5, 2.0]) @ uk
            x = A[k] @ x + B[k] @ uk
        return total + x @ Qs[N] @ x

    # The cost is quadratic: its Hessian and gradient by exact second differences.
    unit = np.eye(N * m)
    x0 = rng.standard_normal(n)
    zero = cost(0 * unit[0], x0)
    gradient = np.array([(cost(e, x0) - cost(-e, x0)) / 2 for e in unit])
    H = np.array([[cost(a + b, x0) - cost(a, x0) - cost(b, x0) + zero for b in unit] for a in unit])
    best = np.linalg.solve(H, -gradient)
    assert np.allclose(best[:m], -K[0] @ x0, rtol=1e-7)
    assert np.isclose(cost(best, x0), x0 @ P @ x0, rtol=1e-7)


def test_a_cost_of_a_motion_has_the_gradient_that_the_steps_give():
    """An adjoint recursion over fdx and fdu, against the gradient of the whole run."""
    scene = cart()
    system = DiscreteSystem(scene, dt=0.02, steps=40, state="velocity")
    U = np.random.default_rng(3).standard_normal((40, 2))
    x0 = system.build_state([0.0, 0.3])
    X = system.simulate(x0, U).X
    A, B = system.linearize_trajectory(X, U)
    z, slope = X[-1].copy(), np.zeros_like(U)
    for k in reversed(range(40)):
        slope[k], z = B[k].T @ z, A[k].T @ z
    traj = cvi.simulate(scene, x0[:2], x0[2:], duration=0.8, dt=0.02, control=U, record="gradient")
    exact = cvi.gradient(traj, (X[-1, :2], X[-1, 2:]), ["control"])[1]["control"]
    assert np.allclose(slope, exact, rtol=1e-9, atol=1e-12)


def test_newton_with_the_steps_derivatives_finds_a_swing():
    """scipy's Newton method with the Hessian that fdxdx, fdxdu, fdudu give, on two steps: the cost has a minimum."""
    system = DiscreteSystem(cart(), dt=0.1, steps=2, inputs=["slide"])
    x0, goal = system.build_state([0.0, 0.3]), np.array([0.05, 0.25, 0.0, 0.0])

    def roll(u):
        X = system.simulate(x0, u[:, None]).X
        return X, 0.5 * np.sum((X[-1] - goal) ** 2) + 1e-3 * u @ u

    def slope_and_hessian(u):
        X = roll(u)[0]
        A, B = system.linearize_trajectory(X, u[:, None])
        z = X[-1] - goal
        S = np.hstack([A[1] @ B[0], B[1]])  # of the last state by both inputs
        H = S.T @ S + 2e-3 * np.eye(2)
        system.set(X[1], u[1:], 1)
        T = np.hstack([B[0], np.zeros((4, 1))])
        E = np.array([[0.0, 1.0]])
        mixed = T.T @ system.fdxdu(z) @ E
        H += T.T @ system.fdxdx(z) @ T + mixed + mixed.T + E.T @ system.fdudu(z) @ E
        system.set(X[0], u[:1], 0)
        H[0, 0] += system.fdudu(A[1].T @ z)[0, 0]
        return S.T @ z + 2e-3 * u, H

    found = minimize(
        lambda u: roll(u)[1], np.zeros(2), jac=lambda u: slope_and_hessian(u)[0],
        hess=lambda u: slope_and_hessian(u)[1], method="trust-exact", options={"gtol": 1e-10},
    )  # fmt: skip
    assert found.success
    assert found.nit <= 15
    u = found.x
    exact = slope_and_hessian(u)[1]
    h = 1e-4
    near = [(slope_and_hessian(u + h * e)[0] - slope_and_hessian(u - h * e)[0]) / (2 * h) for e in np.eye(2)]
    assert np.allclose(near, exact, rtol=1e-6)


def test_trajectories_go_from_one_system_to_another_by_name():
    whole = DiscreteSystem(cart(), dt=0.02, steps=5)
    forced = DiscreteSystem(cart(), dt=0.02, steps=5, inputs=["slide"], state="velocity")
    U = np.arange(10.0).reshape(5, 2)
    X = whole.simulate(whole.build_state([0.1, 0.2]), U).X
    found = forced.convert_trajectory(whole, X, U)
    assert np.allclose(forced.split_trajectory(*found).p, X[:, 2:], rtol=1e-13)
    assert np.array_equal(found.U, U[:, :1])


# --- errors ---------------------------------------------------------------------------------------------------------
def test_errors():
    scene = cart()
    with pytest.raises(cvi.InputError, match="not equal"):
        DiscreteSystem(scene, [0.0, 0.1, 0.3])
    with pytest.raises(cvi.InputError, match="t, or dt with steps"):
        DiscreteSystem(scene)
    with pytest.raises(cvi.InputError, match="kind of state"):
        DiscreteSystem(scene, dt=0.1, steps=1, state="speed")
    with pytest.raises(cvi.InputError, match="no servo"):
        DiscreteSystem(scene, dt=0.1, steps=1, targets=["slide"])
    with pytest.raises(cvi.InputError):
        DiscreteSystem(scene, dt=0.1, steps=1, inputs=["wheel"])
    system = DiscreteSystem(scene, dt=0.1, steps=2)
    with pytest.raises(cvi.SimulationError, match="set"):
        system.f()
    with pytest.raises(cvi.InputError, match="No step begins"):
        system.set(np.zeros(4), np.zeros(2), 2)
    with pytest.raises(cvi.InputError, match="xk"):
        system.set(np.zeros(5), np.zeros(2), 0)
    with pytest.raises(cvi.InputError, match="twice"):
        system.build_state(p=[0.0, 0.0], v=[0.0, 0.0])
    with pytest.raises(cvi.InputError, match="one state more"):
        system.linearize_trajectory(np.zeros((2, 4)), np.zeros((2, 2)))
    with pytest.raises(cvi.InputError, match="linear system"):
        solve_tv_lqr(np.eye(2), np.eye(2), np.eye(2), np.eye(2))
    scene.set_servo("slide", kp=1.0, kd=0.0)
    with pytest.raises(cvi.InputError, match="has no target"):
        DiscreteSystem(scene, dt=0.1, steps=1)
