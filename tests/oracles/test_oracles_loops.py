"""Known answers for linkages, pendulums, strings, springs and joint friction against the oracle of forced motion."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from oracles import closed_forms, forced, joint_friction, strings
from oracles.constraints import Motion, Point, Prescribed, Screw, Tape, constant, distance, ramp, sine
from oracles.loops import FourBar, MassesOfSliderCrank, ScrewNut, SliderCrank

MOTION = 1e-10  # DOP853 at rtol 1e-12 over about a second, and the problem's growth of errors


def body(model, parent, joint, at=(0.0, 0.0, 0.0), mass=1.0, centre=(0.0, 0.0, 0.0), inertia=0.0):
    joint = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array(at)), f"joint{model.njoints}")
    about = np.diag([inertia] * 3)
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.array(centre), about), pin.SE3.Identity())
    return joint


def planar(gravity=9.81):
    """Empty model with gravity along -y."""
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, -gravity, 0.0]), np.zeros(3))
    return model


# --- linkages ----------------------------------------------------------------------------------------------------
def four_bar_model(bar):
    """Crank and coupler in a row, the rocker alone: relative coordinates (crank, coupler - crank, rocker)."""
    model = planar()
    crank = body(model, 0, pin.JointModelRZ(), (0, 0, 0), 0.4, (0.5 * bar.crank, 0, 0), 0.01)
    coupler = body(model, crank, pin.JointModelRZ(), (bar.crank, 0, 0), 0.8, (0.4 * bar.coupler, 0.1, 0), 0.03)
    rocker = body(model, 0, pin.JointModelRZ(), (bar.ground, 0, 0), 0.6, (0.5 * bar.rocker, 0, 0), 0.02)
    return model, Point((coupler, (bar.coupler, 0, 0)), (rocker, (bar.rocker, 0, 0)))


@pytest.mark.parametrize("branch", [1, -1])
def test_crank_rocker_driven_through_a_turn(branch):
    bar = FourBar(1.0, 0.3, 0.9, 0.7, branch)
    assert bar.grashof() < 0.0
    model, pin_joint = four_bar_model(bar)
    speed, start = 7.0, 0.4
    c, r = bar.angles(start)
    wc, wr = bar.rates(start, speed)
    times = np.linspace(0.0, 2.0 * math.pi / speed, 9)
    crank = Prescribed(1, ramp(start, speed))
    run = forced.solve(model, [start, c - start, r], [speed, wc - speed, wr], times, (), [pin_joint, crank])
    for t, q, v, a in zip(times, run.q, run.v, run.a, strict=True):
        angles, rates = bar.angles(start + speed * t), bar.rates(start + speed * t, speed)
        change = np.array([q[0] + q[1], q[2]]) - angles
        assert np.abs(np.sin(0.5 * change)).max() <= 1e-11
        assert np.abs([v[0] + v[1] - rates[0], v[2] - rates[1]]).max() <= 1e-10
        second = bar.accelerations(start + speed * t, speed)
        assert np.abs([a[0] + a[1] - second[0], a[2] - second[1]]).max() <= 1e-9
    assert run.drift <= 1e-11
    assert np.abs(run.imbalance()).max() <= 1e-9
    assert np.abs(run.multipliers[:, 2]).max() == 0.0  # the redundant row across the plane


def test_parallelogram_swings_as_a_pendulum():
    """The coupler does not turn: one degree of freedom, I = sum of all inertia, by the scalar equation."""
    bar = FourBar(1.0, 0.4, 1.0, 0.4, -1)
    assert bar.grashof() == pytest.approx(0.0, abs=1e-15)
    q0 = -0.5 * math.pi + 0.9
    c, r = bar.angles(q0)
    assert abs(c) <= 1e-15
    assert abs(r - q0) <= 1e-15
    model, joint = four_bar_model(bar)
    times = np.linspace(0.0, 1.5, 7)
    run = forced.solve(model, [q0, -q0, q0], np.zeros(3), times, (), [joint])
    inertia = 0.01 + 0.02 + 0.4 * 0.2**2 + 0.6 * 0.2**2 + 0.8 * 0.4**2
    moment = 0.4 * 0.2 + 0.6 * 0.2 + 0.8 * 0.4
    exact = strings.Pendulum(0.9, length=inertia / moment)
    for t, q in zip(times, run.q, strict=True):
        assert abs(q[0] + 0.5 * math.pi - exact.angle(t)[0]) <= MOTION
        assert abs(q[0] + q[1]) <= MOTION
    assert np.abs(run.imbalance()).max() <= MOTION


def slider_crank_model(mechanism, masses):
    model = planar()
    arm = masses.crank_moment / 0.5
    own = masses.crank_inertia - 0.5 * arm**2
    crank = body(model, 0, pin.JointModelRZ(), (0, 0, 0), 0.5, (arm, 0, 0), own)
    along, centre = (mechanism.crank, 0, 0), (masses.rod_centre, 0, 0)
    rod = body(model, crank, pin.JointModelRZ(), along, masses.rod, centre, masses.rod_inertia)
    slider = body(model, 0, pin.JointModelPX(), (0, mechanism.offset, 0), masses.slider)
    return model, Point((rod, (mechanism.rod, 0, 0)), (slider, (0, 0, 0)))


def test_slider_crank_at_constant_speed():
    mechanism, speed = SliderCrank(0.153, 0.306, 0.02), 20.0
    masses = MassesOfSliderCrank(4e-3, 0.5 * 0.07, 0.038, 0.1, 5.9e-4, 0.076)
    model, joint = slider_crank_model(mechanism, masses)
    start = 0.3
    b, b1, _ = mechanism.rod_angle(start)
    x, x1, _ = mechanism.slider(start)
    times = np.linspace(0.0, 2.0 * math.pi / speed, 9)
    v0 = [speed, (b1 - 1.0) * speed, x1 * speed]
    run = forced.solve(model, [start, b - start, x], v0, times, (), [joint, Prescribed(1, ramp(start, speed))])
    for t, q, v, a, lam in zip(times, run.q, run.v, run.a, run.multipliers, strict=True):
        angle = start + speed * t
        x, x1, x2 = mechanism.slider(angle)
        assert abs(q[2] - x) <= 1e-12
        assert abs(v[2] - x1 * speed) <= 1e-11
        assert abs(a[2] - x2 * speed**2) <= 1e-9
        assert abs(lam[3] - mechanism.torque(angle, speed, masses, 9.81)) <= 1e-10
    assert abs(run.work_drive[-1]) <= 1e-10  # a full turn
    assert np.abs(run.imbalance()).max() <= 1e-10


def test_slider_crank_released():
    """The torque's closed form with acceleration: I a = -(I' w^2 / 2 + dV/dq)."""
    mechanism, masses = SliderCrank(0.153, 0.306), MassesOfSliderCrank(4e-3, 0.5 * 0.07, 0.038, 0.1, 5.9e-4, 0.076)
    model, joint = slider_crank_model(mechanism, masses)
    b, b1, _ = mechanism.rod_angle(0.3)
    x, x1, _ = mechanism.slider(0.3)

    def rhs(_t, y):
        return [y[1], -mechanism.torque(y[0], y[1], masses, 9.81) / mechanism.inertia(y[0], masses)[0]]

    run = forced.solve(model, [0.3, b - 0.3, x], [9.0, (b1 - 1.0) * 9.0, x1 * 9.0], [0.0, 0.5], (), [joint])
    exact = solve_ivp(rhs, (0.0, 0.5), [0.3, 9.0], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    assert np.abs([run.q[-1, 0] - exact[0], run.v[-1, 0] - exact[1]]).max() <= 1e-9


@pytest.mark.parametrize("pitch", [0.004, -0.05])
@pytest.mark.slow
def test_nut_on_a_screw(pitch):
    """Several turns of a free body on the thread, and Pinocchio's helical joint."""
    nut, turn = ScrewNut(0.7, 2e-4, pitch), np.array([0.0, 0.0, 2.0])
    model, helix = pin.Model(), pin.Model()
    body(model, 0, pin.JointModelFreeFlyer(), (0, 0, 0), 0.7, (0, 0, 0), 2e-4)
    body(helix, 0, pin.JointModelHZ(pitch), (0, 0, 0), 0.7, (0, 0, 0), 2e-4)
    thread = Screw(0, pin.SE3.Identity(), 1, pin.SE3.Identity(), pitch)
    v0 = np.array([0.0, 0.0, 2.0 * pitch, *turn])
    times = np.linspace(0.0, 1.0, 5)
    run = forced.solve(model, pin.neutral(model), v0, times, (), [thread])
    single = forced.solve(helix, np.zeros(1), turn[2:], times)
    for t, q, v, a, lam, h in zip(times, run.q, run.v, run.a, run.multipliers, single.q, strict=True):
        z, speed = nut.motion(t, 0.0, 2.0 * pitch)
        assert abs(q[2] - z) <= MOTION
        assert abs(h[0] * pitch - z) <= MOTION
        assert abs(v[2] - speed) <= MOTION
        assert np.abs(a[[2, 5]] - nut.acceleration()).max() <= 1e-9
        assert abs(lam[4] - nut.bearing()[0]) <= 1e-10
        assert nut.bearing()[1] == pytest.approx(-pitch * nut.bearing()[0], rel=1e-14)
        assert abs(nut.energy(z, speed) - nut.energy(0.0, 2.0 * pitch)) <= 1e-12
    assert run.drift <= 1e-11


# --- strings and pendulums ---------------------------------------------------------------------------------------
def free_point(mass=1.0, gravity=9.81):
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0.0, 0.0, -gravity]), np.zeros(3))
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "point")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    return model


@pytest.mark.parametrize("theta0", [0.3, 2.8])
def test_point_on_a_rod_is_the_elliptic_pendulum(theta0):
    exact, model = strings.Pendulum(theta0, 0.7, 1.3), free_point(1.3)
    assert exact.period() == pytest.approx(2.0 * closed_forms.pendulum_wall_period(theta0, 0.7), rel=1e-15)
    times = np.linspace(0.0, exact.period(), 5)
    q0 = 0.7 * np.array([math.sin(theta0), 0.0, -math.cos(theta0)])
    run = forced.solve(model, q0, np.zeros(3), times, (), [distance((0, (0, 0, 0)), (1, (0, 0, 0)), 0.7)])
    for t, q, v, lam in zip(times, run.q, run.v, run.multipliers, strict=True):
        theta, omega = exact.angle(t)
        assert abs(math.atan2(q[0], -q[2]) - theta) <= MOTION
        assert abs(v @ [math.cos(theta), 0.0, math.sin(theta)] - 0.7 * omega) <= 2 * MOTION
        assert abs(-lam[0] - exact.tension(t)) <= 1e-8
        assert 0.5 * 1.3 * (0.7 * omega) ** 2 - 1.3 * 9.81 * 0.7 * math.cos(theta) == pytest.approx(exact.energy())
    assert np.abs(run.imbalance()).max() <= MOTION


def test_damped_pendulum():
    exact = strings.DampedPendulum(1.3, 0.5, 0.4, 0.25)
    model = pin.Model()
    body(model, 0, pin.JointModelRY(), (0, 0, 0), 1.3, (0, 0, -0.5), 0.4 - 1.3 * 0.25)
    times = np.linspace(0.0, 2.0, 5)
    run = forced.solve(model, [2.5], [1.0], times, [forced.JointDamping([0.25])])
    known = exact.motion(times, 2.5, 1.0)
    assert np.abs(run.q[:, 0] - known[:, 0]).max() <= MOTION
    assert np.abs(run.dissipated - known[:, 2]).max() <= MOTION
    assert np.abs(run.imbalance()).max() <= MOTION
    energy = np.array([exact.energy(*y[:2]) for y in known])
    assert np.abs(energy + known[:, 2] - energy[0]).max() <= 1e-11
    small = exact.motion(times, 1e-5)
    assert np.abs(small[:, 0] - [exact.small(t, 1e-5) for t in times]).max() <= 1e-14  # theta^3


def test_pendulum_on_a_moved_cart():
    exact = strings.CartPendulum(sine(0.4, 5.0), 0.8, 0.6, 2.0)
    model = pin.Model()
    cart = body(model, 0, pin.JointModelPX(), (0, 0, 0), 2.0)
    body(model, cart, pin.JointModelRY(), (0, 0, 0), 0.6, (0, 0, -0.8))
    times = np.linspace(0.0, 2.0, 9)
    # turned about y by -theta, the rod points to (sin theta, -cos theta)
    run = forced.solve(model, [0.0, -0.5], [2.0, -0.3], times, (), [Prescribed(cart, exact.path)])
    known = exact.motion(times, 0.5, 0.3)
    assert np.abs(-run.q[:, 1] - known[:, 0]).max() <= MOTION
    assert np.abs(run.work_drive - known[:, 2]).max() <= 1e-9
    assert (
        np.abs(run.multipliers[:, 0] - [exact.force(t, *y[:2]) for t, y in zip(times, known, strict=True)]).max()
        <= 1e-8
    )
    balance = [exact.energy(t, *y[:2]) - y[2] for t, y in zip(times, known, strict=True)]
    assert np.ptp(balance) <= 1e-9
    assert np.abs(run.imbalance()).max() <= 1e-9


def test_lift_of_the_rail_is_the_multiplier_of_a_cart_held_at_its_height():
    exact = strings.CartPendulum(sine(0.4, 5.0), 0.8, 0.6, 2.0)
    model = pin.Model()
    along = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "along")
    cart = body(model, along, pin.JointModelPZ(), (0, 0, 0), 2.0)
    body(model, cart, pin.JointModelRY(), (0, 0, 0), 0.6, (0, 0, -0.8))
    prescribed = [Prescribed(along, exact.path), Prescribed(cart, constant(0.0))]
    x, speed, _ = exact.path(0.7)
    now = forced.acceleration(model, np.array([x, 0.0, -0.5]), np.array([speed, 0.0, -0.3]), 0.7, (), prescribed)
    assert now.multipliers == pytest.approx([exact.force(0.7, 0.5, 0.3), exact.lift(0.7, 0.5, 0.3)], rel=1e-13)


def test_atwood_machine_of_a_tape():
    model = pin.Model()
    for x, mass in ((-0.5, 3.0), (0.5, 1.0)):
        body(model, 0, pin.JointModelPZ(), (x, 0, 0), mass)
    tape = [(1, (0, 0, 0)), (0, (-0.5, 0, 2)), (0, (0.5, 0, 2)), (2, (0, 0, 0))]
    a, first, second = strings.atwood(3.0, 1.0)
    assert first == pytest.approx(second, rel=1e-15)
    run = forced.solve(model, np.zeros(2), np.zeros(2), [0.0, 0.5], (), [Tape(tape, constant(5.0))])
    assert run.q[-1] == pytest.approx([-0.125 * a, 0.125 * a], abs=1e-12)
    assert run.multipliers[:, 0] == pytest.approx(-first, abs=1e-11)
    for inertia in (0.0, 0.7):  # the pulley's energy too
        a, first, second = strings.atwood(3.0, 1.0, inertia, 0.2)
        assert (3.0 + 1.0 + inertia / 0.04) * a == pytest.approx(2.0 * 9.81, rel=1e-14)
        assert (first - second) * 0.2 == pytest.approx(inertia * a / 0.2, abs=1e-12)


@pytest.mark.parametrize("length", [ramp(1.0, -0.4), sine(0.3, 3.0, 1.0)])
def test_driven_string_keeps_l_squared_omega(length):
    exact, model = strings.DrivenString(length, 2.0, 1.3), free_point(1.3, 0.0)
    times = np.linspace(0.0, 1.2, 5)
    v0 = np.array([length(0.0)[1], 0.0, 2.0])
    run = forced.solve(model, [1.0, 0.0, 0.0], v0, times, (), [distance((0, (0, 0, 0)), (1, (0, 0, 0)), length)])
    for t, q, v, lam, work in zip(times, run.q, run.v, run.multipliers, run.work_drive, strict=True):
        assert abs(np.cross(q, v)[1] + 2.0) <= MOTION
        assert abs(math.remainder(math.atan2(q[2], q[0]) - exact.angle(t), 2.0 * math.pi)) <= MOTION
        assert abs(-lam[0] - exact.tension(t)) <= 1e-8
        assert abs(work - exact.work(t)) <= 1e-9
    if length(0.0)[2] == 0.0 and length(1.0)[2] == 0.0:
        assert exact.angle(1.2) == pytest.approx(2.0 * 1.2 / (1.0 - 0.4 * 1.2), rel=1e-12)


# --- springs -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("ends", ["fixed", "mixed", "free"])
@pytest.mark.slow
def test_chain_of_springs(ends):
    n, k, m = 5, 40.0, 0.7
    chain, model = strings.SpringChain(n, k, m, ends), planar(0.0)
    for i in range(n):
        body(model, 0, pin.JointModelPX(), (float(i + 1), 0, 0), m)
    walls = {"fixed": (0, n + 1), "mixed": (0, n), "free": (1, n)}[ends]
    places = [(i, (0.0, 0.0, 0.0)) if 1 <= i <= n else (0, (float(i), 0.0, 0.0)) for i in range(walls[0], walls[1] + 1)]
    rest = 0.9 if ends == "fixed" else 1.0
    springs = [forced.PathSpring(pair, k, rest) for pair in zip(places[:-1], places[1:], strict=True)]
    jac = [Motion(model, np.zeros(n)).length(s.places).jac[0] for s in springs]
    stiffness = k * sum(np.outer(j, j) for j in jac) / m
    modes = chain.modes()
    assert np.abs(modes.T @ modes - np.eye(n)).max() <= 1e-14
    assert np.abs(stiffness @ modes - modes * chain.frequencies() ** 2).max() <= 1e-12 * k / m
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-0.2, 0.2, (2, n))
    run = forced.solve(model, u, v, [0.0, 2.0], springs)
    known = chain.motion(2.0, u, v)
    assert np.abs(run.q[-1] - known[0]).max() <= MOTION
    assert np.abs(run.v[-1] - known[1]).max() <= 10 * MOTION


# --- joint friction ----------------------------------------------------------------------------------------------
def stopped(rhs, y, t):
    """(time, state) at the next rest, by DOP853 with an event."""

    def rest(s, x):
        return x[1] if s > t + 1e-9 else math.copysign(1.0, rhs(t, y)[1] if y[1] == 0.0 else y[1])

    rest.terminal = True
    run = solve_ivp(rhs, (t, t + 100.0), y, method="DOP853", rtol=1e-13, atol=1e-14, events=rest, max_step=0.05)
    return run.t_events[0][0], np.array([run.y_events[0][0][0], 0.0])


@pytest.mark.parametrize(("x0", "v0"), [(1.0, 0.0), (-0.83, 0.0), (0.2, -1.7), (0.0, 2.0), (0.05, 0.0), (0.15, 0.0)])
def test_spring_with_dry_friction(x0, v0):
    exact = joint_friction.SpringMass(1.4, 30.0, 3.0, x0, v0)
    turns, t, y = exact.turns(), 0.0, np.array([x0, v0])
    for time, place in turns[1:] if v0 == 0.0 else turns:
        s = math.copysign(1.0, y[1]) if y[1] != 0.0 else -math.copysign(1.0, y[0])

        def rhs(_t, z, s=s):
            return [z[1], (-30.0 * z[0] - 3.0 * s) / 1.4]

        middle = solve_ivp(rhs, (t, 0.5 * (t + time)), y, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
        assert np.abs(middle - exact.state(0.5 * (t + time))).max() <= 1e-11
        t, y = stopped(rhs, y, t)
        assert abs(t - time) <= 1e-10
        assert abs(y[0] - place) <= 1e-11
    assert 30.0 * abs(y[0]) <= 3.0  # it sticks here, and nowhere before
    assert all(30.0 * abs(x) > 3.0 for _, x in turns[:-1])
    assert exact.state(t + 1.0) == exact.stick()[1:] + (0.0,)
    assert exact.dissipated() == pytest.approx(exact.energy(x0, v0) - exact.energy(y[0], 0.0), rel=1e-13, abs=1e-15)
    full = [abs(x) for _, x in turns[:-1:2]]
    assert np.abs(np.diff(full) + 4.0 * 3.0 / 30.0).max(initial=0.0) <= 1e-14


def test_sliding_block():
    level = joint_friction.block_on_slope(3.0, 0.3)
    assert level.stop() == pytest.approx((3.0 / (0.3 * 9.81), 9.0 / (2.0 * 0.3 * 9.81)), rel=1e-15)
    assert level.sticks()
    for mu, slope, v0 in ((0.3, 0.2, 3.0), (0.3, 0.6, 3.0), (0.3, 0.2, -3.0), (0.3, 0.6, -3.0)):
        block = joint_friction.block_on_slope(v0, mu, slope, 2.0)
        assert block.sticks() == (mu >= math.tan(slope))
        assert (block.stop() is None) == (v0 < 0.0 and mu < math.tan(slope))
        x, v = block.state(1.7)
        way = abs(x) if block.stop() is None else abs(block.stop()[1]) + abs(x - block.stop()[1])
        if block.stop() is None or block.stop()[0] < 1.7:
            loss = 0.5 * 2.0 * (v0**2 - v**2) - 2.0 * 9.81 * math.sin(slope) * x
            assert loss == pytest.approx(block.friction * way, rel=1e-13)


def test_pendulum_with_dry_friction():
    turns = joint_friction.pendulum_turns(2.0, 5.0, 0.8)
    t, y, s = 0.0, np.array([2.0, 0.0]), -1.0
    for place in turns[1:]:
        t, y = stopped(lambda _t, z, s=s: [z[1], -5.0 * math.sin(z[0]) - 0.8 * s], y, t)
        assert abs(y[0] - place) <= 1e-11
        s = -s
    assert 5.0 * abs(math.sin(turns[-1])) <= 0.8 < 5.0 * abs(math.sin(turns[-2]))
