"""Every model of the battery at the orders 2 to 16: the oracle's step and the laws of a Galerkin-Gauss step.

Tolerances: the engine's stage iterations end when the error is below tol of the motion in the energy norm (here
1e-13), or at their rounding; differences are measured in that norm, because M of Talos has a condition of 1e6.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from batteries.models import CASES, FREE_FLOATING, SMALL, case
from helpers import laws
from helpers.engine import advance, core_scene, simulator, stepper
from helpers.gauss_laws import EPS, EVERY_ORDER, ORDERS, momentum_size, rotates, setup, velocity_size
from helpers.thinning import every
from oracles.del_step import System
from oracles.gauss_step import GaussStep
from oracles.momentum_maps import spatial_momentum
from oracles.smooth import flow

every_case = pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
small_case = pytest.mark.parametrize("case", SMALL, ids=lambda c: c.name)
free_floating = pytest.mark.parametrize("case", FREE_FLOATING, ids=lambda c: c.name)
every_order = pytest.mark.parametrize("order", ORDERS)
ERROR_FLOOR = 2e-11  # of a run: its own rounding and that of the reference
STEP = 1e-11  # agreement of one step, relative, in the energy norm: 100 times the tolerance asked for


def assert_oracles_step(system, scene, q, p, h, tau, order, stiff=0.0):
    """Stage velocities, end state, and the residual of the discrete Euler-Lagrange equations.

    stiff: h d/m + h^2 k/m, by which an error of the velocities enters the forces and with them p1.
    """
    gauss, split = GaussStep(system, order // 2), system.split
    q1, p1, v, iterations, _ = scene.step(q, p, h, tau, 1e-13, order)
    done = gauss.solve(q, p, h, tau)
    assert v.shape == (order // 2, system.nv)
    assert iterations >= 1
    start, end = split.tangent_map(q) @ p, split.tangent_map(q1) @ p1
    size = max(velocity_size(system, q, done.v), momentum_size(system, q, start), momentum_size(system, q, done.p1))
    assert velocity_size(system, q, v - done.v) <= STEP * size
    assert momentum_size(system, done.q1, end - done.p1) <= STEP * (1.0 + stiff) * size
    # positions add the rounding of their own size
    moved = velocity_size(system, q, split.difference(done.q1, q1))
    rounding = 8 * EPS * (1.0 + np.abs(q).max()) * velocity_size(system, q, np.ones(system.nv))
    assert moved <= STEP * h * size + rounding
    for momenta in gauss.residual(q, p, h, v, q1, p1, tau)[::2]:
        assert momentum_size(system, q, momenta) <= STEP * (1.0 + stiff) * size


# --- the step against the oracle ----------------------------------------------------------------------------------
@pytest.mark.thinned(3)
@pytest.mark.parametrize("case", every(2, CASES), ids=lambda c: c.name)
@pytest.mark.parametrize("kind", ["free", "damped springs"])
def test_step_is_the_oracles_step(case, kind):
    s = setup(case.name, kind != "free", kind != "free")
    # one order at each length of the step, all orders over the two kinds and both lengths
    lengths = (4 * case.h, 1e-4) if kind == "free" else (case.h, 4 * case.h)
    for seed, order in enumerate(EVERY_ORDER):
        q, p = s.state(seed)
        tau = None if seed % 2 else 0.1 * np.random.default_rng(seed).uniform(-1, 1, s.system.nv)
        assert_oracles_step(s.system, s.scene, q, p, lengths[seed // 2 % 2], tau, order)


@pytest.mark.long
@every_case
@pytest.mark.parametrize("order", EVERY_ORDER)
def test_many_steps_are_the_oracles_steps(case, order):
    s = setup(case.name, True, True)
    for seed in range(10, 16):
        q, p = s.state(seed)
        rng = np.random.default_rng(seed)
        h, tau = case.h * 10.0 ** rng.uniform(-3, 0.7), rng.uniform(-1, 1, s.system.nv)
        assert_oracles_step(s.system, s.scene, q, p, h, tau, order)


@pytest.mark.parametrize(("name", "h"), [("free_body", 0.05), ("joint_spherical", 0.02), ("pair", 0.02)])
@every_order
@pytest.mark.thinned(3)
def test_large_rotations_in_one_step(name, h, order):
    """0.4 to 1.7 rad per step: the exponential, its Jacobian and their derivatives far from the identity."""
    s = setup(name)
    for seed in range(3):
        q, v = s.case.state(s.model, seed)
        p = s.system.momentum(q, 20.0 / s.case.speed * v)
        assert_oracles_step(s.system, s.scene, q, p, h, None, order)


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("stiffness", "orders"), [(1e3, (2, 4, 8, 16)), (1e6, (2, 4))])
@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("name", ["arm_spherical", "joint_helical_x", "joint_planar", "joint_translation", "forest"])
def test_stiff_springs_and_dampers(name, damped, stiffness, orders):
    """h sqrt(k/m) up to 100 and h d/m up to 1e4: the stage iterations need the springs and dampers in their matrix."""
    c = case(name)
    model = c.model()
    k, d = np.zeros(model.njoints), np.zeros(model.nv)
    for i, joint in enumerate(list(model.joints)[1:], 1):
        free = joint.shortname().endswith(("FreeFlyer", "Planar"))
        k[i] = 0.0 if free else stiffness
        d[joint.idx_v : joint.idx_v + joint.nv] = 0.1 * (1.0 if free else stiffness) * damped
    q, v = c.state(model)
    extra = {"stiffness": k, "rest": q, "damping": d}
    system, scene = System(model, **extra), core_scene(model, **extra)
    forces = c.h * np.diag(d) + c.h**2 * system.spring_stiffness(q)
    stiff = np.abs(np.linalg.eigvals(np.linalg.solve(system.mass_matrix(q), forces))).max()
    for order in orders:
        assert_oracles_step(system, scene, q, system.momentum(q, v), c.h, None, order, stiff)


@pytest.mark.parametrize("order", EVERY_ORDER)
def test_oscillator_is_the_diagonal_pade_approximant(order):
    """On m x'' = -k x - d x' the step is N(hA) / N(-hA), N the numerator of the Pade approximant of exp."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(1, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    # h sqrt(k/m) = 0.6, 2 and, where one step converges, 141
    for h, k, d in ((0.1, 80.0, 0.0), (0.1, 800.0, 3.0), (0.1, 4e6, 500.0))[: 3 if order <= 4 else 2]:
        scene = core_scene(model, [0.0, k], np.zeros(1), np.array([d]))
        matrix, s = h * np.array([[0.0, 0.5], [-k, -0.5 * d]]), order // 2  # on (q, p)
        top, bottom, power, c = np.eye(2), np.eye(2), np.eye(2), 1.0
        for j in range(1, s + 1):
            c, power = c * (s - j + 1) / (j * (2 * s - j + 1)), power @ matrix
            top, bottom = top + c * power, bottom + (-1) ** j * c * power
        wanted = np.linalg.solve(bottom, top) @ [0.3, 0.7]
        q1, p1, *_ = scene.step(np.array([0.3]), np.array([0.7]), h, None, 1e-13, order)
        weight = np.array([np.sqrt(k), np.sqrt(0.5)])  # both parts of the energy
        error = weight * (np.array([q1[0], p1[0]]) - wanted)
        assert np.abs(error).max() <= 1e-10 * np.linalg.norm(weight * [0.3, 0.7])


# --- energies -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["double_pendulum", "arm_spherical", "forest", "allegro"])
def test_energies_of_higher_order(name):
    s = setup(name, springs=True)
    total = s.scene.energy(s.q[None], s.p[None]).sum()
    for order in EVERY_ORDER:
        h = 2 * s.case.h
        wanted = s.gauss(order).discrete_energy(s.q, s.p, h)
        found = s.scene.discrete_energy(s.q[None], s.p[None], np.array([h]), order)[0]
        assert found == pytest.approx(wanted, rel=1e-11)
        if order > 2:  # the conserved quantity is H itself to the order of the step
            assert s.scene.modified_energy(s.q[None], s.p[None], h, order)[0] == pytest.approx(total, rel=8 * EPS)


# --- laws of the step -----------------------------------------------------------------------------------------------
@every_case
@pytest.mark.thinned(3)
def test_step_is_symplectic(case):
    s = setup(case.name, springs=True)
    for order in ORDERS if case.name != "talos" else (4, 16):
        step = stepper(s.scene, 2 * case.h, order=order)
        assert laws.symplectic_defect(s.model, step, s.q, s.p) <= 1e-9, order


@every_case
def test_step_is_reversible(case):
    """To rounding where the joints commute; on SO(3) the chart sits at the start of a step, see test_gauss_oracle."""
    s = setup(case.name, springs=True)
    for order in ORDERS:
        # one step h and -h leaves a term of h^(order + 2) on rotations: seen at order 4 only
        tolerance = 1e-11 + (1e3 * case.h**6 if order == 4 and rotates(s.model) else 0.0)
        q1, p1 = laws.run(stepper(s.scene, case.h, order=order), s.q, s.p, 5)
        q2, p2 = laws.run(stepper(s.scene, -case.h, order=order), q1, p1, 5)
        assert laws.distance(s.model, (q2, p2), (s.q, s.p)) <= tolerance, order


def drift_of_momentum(name, h, order, steps):
    """Largest change of the spatial momentum, relative to its size: the largest moment of a part about the origin."""
    s = setup(name, gravity=False)
    start = spatial_momentum(s.model, s.q, s.p)
    _, qs, ps = advance(s.scene, s.model, s.q, s.v, h, steps, steps // 50, order=order)
    all_of_it = np.array([spatial_momentum(s.model, a, b) for a, b in zip(qs, ps, strict=True)])
    size = np.abs(qs).max() * np.abs(ps).max()
    return np.abs(all_of_it - start).max() / (1.0 + np.abs(start).max() + size)


@free_floating
@every_order
def test_momentum_maps_over_a_thousand_steps(case, order):
    assert drift_of_momentum(case.name, 2 * case.h, order, 1000) <= 1e-12


@pytest.mark.long
@free_floating
@every_order
@pytest.mark.parametrize("factor", [4, 1, 1e-3])
def test_momentum_maps_over_ten_thousand_steps(case, order, factor):
    assert drift_of_momentum(case.name, factor * case.h, order, 10_000) <= 1e-11


@pytest.mark.parametrize("name", ["double_pendulum", "free_body", "arm_spherical", "forest", "allegro"])
@every_order
def test_energy_stays_bounded(name, order):
    """The error of H comes in bursts where the motion is fast and goes back: its median does not grow."""
    s = setup(name, springs=True, gravity=name not in ("free_body", "forest"))  # nothing falls for ever
    _, qs, ps = advance(s.scene, s.model, s.q, s.v, 2 * s.case.h, 4000, 10, tol=1e-15, order=order)
    energy = s.scene.energy(qs, ps).sum(axis=1)
    error = np.abs(energy - energy[0])
    floor = 1e3 * EPS * np.abs(s.scene.energy(qs, ps)).max()  # 4000 steps of rounding, added up
    assert np.median(error[200:]) <= 5 * np.median(error[:200]) + floor
    assert error.max() <= 1e-3 * s.scene.energy(qs, ps)[:, 0].max()


# --- the order ------------------------------------------------------------------------------------------------------
def end_of(s, order, duration, steps):
    """(q, v) after `duration` [s], and how many steps were cut."""
    run = simulator(s.scene, duration / steps, tol=1e-15, order=order)
    assert run.reset(s.q, s.v, 0.0)["code"] == 0
    result = run.advance(steps, None, steps, None)
    assert result["code"] == 0, result["message"]
    q, p = result["q"][-1], result["p"][-1]
    return (q, s.system.velocity(q, p)), result["stats"]["halved"]


def errors_seen(s, order, duration, numbers):
    """(numbers of steps, errors) between rounding and 1e-3 of uncut runs, against order 16 with many steps."""
    reference, _ = end_of(s, 16, duration, 100)
    found = [end_of(s, order, duration, n) for n in numbers]
    errors = np.array([laws.distance(s.model, end, reference) for end, _ in found])
    seen = (errors > ERROR_FLOOR) & (errors < 1e-3) & np.array([halved == 0 for _, halved in found])
    return np.asarray(numbers)[seen], errors[seen]


@every_case
def test_order_sixteen_is_the_exact_motion(case):
    """It then serves as the reference of the other orders."""
    s = setup(case.name, True, True)
    exact = flow(s.system, s.q, s.v, 40 * case.h, rtol=1e-13)
    assert laws.distance(s.model, end_of(s, 16, 40 * case.h, 80)[0], exact) <= 1e-11


@every_case
def test_order_four(case):
    s = setup(case.name, True, True)
    _, errors = errors_seen(s, 4, 80 * case.h, (20, 40, 80, 160, 320))
    assert laws.orders(errors)[-1] == pytest.approx(4.0, abs=0.1), errors


@small_case
def test_order_six(case):
    """One halving above the rounding of a run remains where the error is nearly asymptotic."""
    s = setup(case.name, True, True)
    _, errors = errors_seen(s, 6, 80 * case.h, (10, 20, 40, 80))
    assert laws.orders(errors)[-1] == pytest.approx(6.0, abs=0.25), errors


@pytest.mark.parametrize(("order", "numbers"), [(8, range(6, 29, 2)), (12, range(4, 13)), (16, range(3, 9))])
def test_higher_orders_over_the_battery(order, numbers):
    """From 8 on the error is asymptotic only near rounding: the mean slope of many runs instead of the last one.

    What fixes the order itself is that the step is the oracle's and, on an oscillator, the Pade approximant.
    """
    slopes = []
    for c in SMALL:
        n, errors = errors_seen(setup(c.name, True, True), order, 80 * c.h, numbers)
        if len(n) >= 3:
            slopes.append(-np.polyfit(np.log(n), np.log(errors), 1)[0])
    # The higher the order, the fewer of the models' errors lie between rounding and the first useful step.
    models, missing = {8: (10, 0.5), 12: (10, 1.5), 16: (3, 4.0)}[order]
    assert len(slopes) >= models
    assert order - missing <= np.mean(slopes) <= order + 1.0, slopes


@small_case
def test_damping_takes_energy(case):
    s = setup(case.name, springs=True, damping=True)
    duration = 40 * case.h
    end = flow(s.system, s.q, s.v, duration, rtol=1e-12)
    exact = s.system.energy(end[0], s.system.split.tangent_map(end[0]) @ end[1]).sum()
    for order in ORDERS:
        _, qs, ps = advance(s.scene, s.model, s.q, s.v, case.h, 40, 4, order=order)
        energy = s.scene.energy(qs, ps).sum(axis=1)
        assert np.all(np.diff(energy) < 0.0)
        assert abs(energy[-1] - exact) <= (1e-4 if order == 4 else 1e-8) * (energy[0] - exact)


# --- through the event loop ---------------------------------------------------------------------------------------
@every_case
def test_the_event_loop_makes_the_same_steps(case):
    """There a step starts from the last one's polynomial; its solution stays the same."""
    s = setup(case.name, springs=True, damping=True)
    tau = 0.1 * np.random.default_rng(3).uniform(-1, 1, s.system.nv)
    for order in ORDERS:
        _, qs, ps = advance(s.scene, s.model, s.q, s.v, case.h, 8, tau=tau, order=order)
        for k in range(8):
            p1 = s.system.split.tangent_map(qs[k + 1]) @ ps[k + 1]
            q, p = stepper(s.scene, case.h, tau, order=order)(qs[k], ps[k])
            moved = velocity_size(s.system, q, s.system.split.difference(q, qs[k + 1]))
            size = momentum_size(s.system, q, p1)
            assert momentum_size(s.system, q, p1 - s.system.split.tangent_map(q) @ p) <= STEP * size, (order, k)
            assert moved <= STEP * case.h * size + 1e-14, (order, k)


@pytest.mark.parametrize("order", [2, 8, 16])
def test_steps_that_turn_too_far_are_cut(order):
    """Six radians per step are beyond the chart of SO(3): the run goes on in halves, and ends right."""
    c = case("free_body")
    model, ends = c.model(), []
    model.gravity.setZero()
    q, v = c.state(model)
    v *= 60.0 / np.abs(v[3:]).max()
    for parts in (1, 256):
        run = simulator(core_scene(model), 0.1 / parts, tol=1e-13, order=order)
        assert run.reset(q, v, 0.0)["code"] == 0
        result = run.advance(10 * parts, None, 10 * parts, None)
        assert (result["code"], result["stats"]["steps"]) == (0, 10 * parts)
        assert (result["stats"]["halved"] > 0) == (parts == 1)
        ends.append((result["q"][-1], result["p"][-1]))
    momenta = [spatial_momentum(model, *end) for end in ends]
    assert np.abs(momenta[0] - momenta[1]).max() <= 1e-10 * np.abs(momenta[1]).max()
    if order == 16:
        assert np.abs(ends[0][0] - ends[1][0]).max() <= 1e-3
