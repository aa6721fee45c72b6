"""The oracle of persistent contact against closed forms and the continuous motion."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from batteries.models import double_pendulum
from helpers import laws
from helpers.bodies_on_planes import corners, free_body, on_slope, slope_frame
from oracles import persistent_scenes
from oracles.contact_modes import Law, cone_problem
from oracles.contact_points import Limit, Points, SphereSphere, VertexPlane
from oracles.del_step import System
from oracles.persistent_scenes import BALL, GRAVITY
from oracles.persistent_step import PersistentSystem
from oracles.split import SplitModel

EPS = np.finfo(float).eps


def steps(contact: PersistentSystem, q, p, h: float, n: int):
    """The last of n steps, with anchors and modes handed on."""
    anchors = modes = result = None
    for _ in range(n):
        result = contact.step(q, p, h, anchors, None, modes)
        q, p, anchors, modes = result.q, result.p, result.anchors, result.modes
    return result


# --- points -----------------------------------------------------------------------------------------------------------
def test_gradients_are_the_derivative_of_the_gap():
    """W_n against differences of the gap, on moving supports; W_t against the motion of the body's point."""
    model = pin.Model()
    for name in "ab":
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.3), pin.SE3.Identity())
    split, rng = SplitModel(model), np.random.default_rng(3)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, 12))
    n = np.array([0.6, 0.0, 0.8])
    listed = [
        VertexPlane(4, (0.1, 0.2, 0.3), support=2, normal=tuple(n), offset=0.1, radius=0.0),
        VertexPlane(4, (0.1, 0.2, 0.3), support=2, normal=tuple(n), offset=0.1, radius=0.2),
        SphereSphere(4, (0.1, 0.2, 0.3), 0.2, (0.3, -0.1, 0.0), 0.4, support=2),
        SphereSphere(4, (0.1, 0.2, 0.3), 0.2, (0.3, -0.1, 0.0), -2.0, support=2),
    ]
    points, v = Points(split, listed), rng.normal(size=12)
    bases, eps = points.bases(q), 1e-3
    found = points.gradients(q, bases) @ v
    rate = sum(w / eps * points.gaps(split.integrate(q, s * eps * v)) for s, w in laws._STENCIL)
    assert np.abs(found[:, 0] - rate).max() <= 1e-12  # rounding over eps
    place = sum(w / eps * points.places(split.integrate(q, s * eps * v))[0] for s, w in laws._STENCIL)
    # `places` speaks of the corner over a support that turns on; W's point of the support lies on its plane
    corner, turn = points.touches(q)[0], points.rotations(q)[0] @ v[3:6]
    along = points.rotations(q)[0] @ place + corner.gap * np.cross(turn, corner.normal)
    assert np.abs(bases[0][:, 1:].T @ along - found[0, 1:]).max() <= 1e-11


def test_bases_are_carried_as_rotations():
    model = free_body(pin.Inertia.FromSphere(1.0, 0.3))
    points = Points(SplitModel(model), [SphereSphere(2, (0.0, 0.0, 0.0), 0.3, (0.0, 0.0, -0.5), 0.2)])
    q, other = pin.neutral(model), pin.neutral(model)
    other[:3] = 0.3, -0.2, 0.1
    (basis,) = points.carried(points.bases(q), other)
    assert np.abs(basis.T @ basis - np.eye(3)).max() <= 4 * EPS
    assert np.abs(basis[:, 0] - points.touches(other)[0].normal).max() <= 4 * EPS


# --- the cone problem -------------------------------------------------------------------------------------------------
def test_modes_satisfy_the_laws():
    """Random problems of two contacts: what comes out obeys the laws as they are written."""
    rng, kinds = np.random.default_rng(5), set()
    for _ in range(60):
        a = rng.normal(size=(6, 8))
        g, b, mu = a @ a.T, rng.normal(size=6), rng.uniform(0.0, 1.0)
        found = cone_problem(g, b, [Law(mu), Law(0.5 * mu)])
        w = (b + g @ found.lam.reshape(-1)).reshape(2, 3)
        scale = np.abs(b).max()
        for lam, u, m in zip(found.lam, w, (mu, 0.5 * mu), strict=True):
            assert lam[0] >= -1e-12
            assert u[0] >= -1e-11
            assert abs(lam[0] * u[0]) <= 1e-11 * scale
            size = np.linalg.norm(u[1:])
            assert np.linalg.norm(lam[1:]) <= m * lam[0] * (1 + 1e-9) + 1e-12
            assert np.abs(size * lam[1:] + m * lam[0] * u[1:]).max() <= 1e-10 * scale
        kinds |= set(found.modes)
    assert kinds == {("closed", "stick"), ("closed", "slip"), ("open", "none")}


def test_forces_that_are_not_unique_are_the_smallest():
    g, b = np.zeros((6, 6)), np.array([-1.0, 0, 0, -1.0, 0, 0])
    g[np.ix_([0, 3], [0, 3])] = 1.0
    g[[1, 2, 4, 5], [1, 2, 4, 5]] = 1.0
    assert np.abs(cone_problem(g, b, [Law(), Law()], eps=1e-5).lam[:, 0] - 0.5).max() <= 1e-15


# --- steps of persistent contact: constant forces are stepped exactly -------------------------------------------------
@pytest.mark.parametrize("mu", [0.5, 0.05])
def test_ball_on_a_slope(mu):
    """Rolls or slides as in the closed form, exactly: the forces are constant."""
    slope, radius, h, n = 0.3, 0.1, 0.02, 10
    model = free_body(pin.Inertia.FromSphere(1.0, radius))
    down, normal = slope_frame(slope)
    contact = PersistentSystem(
        System(model), [VertexPlane(2, (0.0, 0.0, 0.0), mu, normal=tuple(normal), radius=radius)]
    )
    q0 = on_slope(model, slope, radius)
    result = steps(contact, q0, np.zeros(6), h, n)
    a, spin, rolls = persistent_scenes.round_body_on_slope(slope, mu, BALL)
    assert rolls == (mu == 0.5)
    t = n * h
    assert down @ (result.q - q0)[:3] == pytest.approx(0.5 * a * t * t, abs=1e-15)
    assert result.gap[0] == pytest.approx(0.0, abs=1e-16)
    assert result.p[4] == pytest.approx(BALL * radius * spin * t, abs=1e-15)
    force = (result.start + result.end)[0] / h
    assert force @ normal == pytest.approx(GRAVITY * math.cos(slope), rel=1e-12)
    assert force @ down == pytest.approx(a - GRAVITY * math.sin(slope), rel=1e-11)
    assert np.abs(result.start - result.end).max() <= 1e-13  # trapezoidal: equal impulses at both ends


@pytest.mark.parametrize("mu", [0.5, 0.1])
def test_box_on_a_slope(mu):
    slope, size, mass, h, n = 0.3, (0.2, 0.3, 0.1), 2.0, 0.02, 4
    model = free_body(pin.Inertia.FromBox(mass, *size))
    down, normal = slope_frame(slope)
    contact = PersistentSystem(System(model), corners(size, mu, {"normal": tuple(normal)}))
    q0 = on_slope(model, slope, 0.5 * size[2])
    result = steps(contact, q0, np.zeros(6), h, n)
    a, t = persistent_scenes.block_on_slope(slope, mu), n * h
    assert (a == 0.0) == (mu == 0.5)
    assert down @ (result.q - q0)[:3] == pytest.approx(0.5 * a * t * t, abs=1e-15)
    assert np.abs(result.q - q0 - np.append(0.5 * a * t * t * down, np.zeros(4))).max() <= 1e-15
    total = (result.start + result.end).sum(axis=0) / h
    assert total == pytest.approx(mass * (a * down + [0.0, 0.0, GRAVITY]), rel=1e-12)


def test_resting_box_stands_equally_on_its_corners():
    size, mass, h = (0.2, 0.3, 0.1), 2.0, 0.01
    model = free_body(pin.Inertia.FromBox(mass, *size))
    q = pin.neutral(model)
    q[2] = 0.05
    contact = PersistentSystem(System(model), corners(size, 0.6, {}))
    result = steps(contact, q, np.zeros(6), h, 3)
    each = 0.25 * persistent_scenes.stack_loads([mass])[0]
    assert np.abs((result.start + result.end)[:, 2] / h - each).max() <= 1e-10 * each
    assert np.abs(result.p).max() <= 1e-15


def test_ball_in_a_groove():
    slope, opening, radius, h, n = 0.2, 0.7, 0.1, 0.01, 5
    model = free_body(pin.Inertia.FromSphere(1.0, radius))
    turn = pin.exp3(np.array([0.0, slope, 0.0]))
    sides = [turn @ [0.0, s * math.sin(opening), math.cos(opening)] for s in (-1, 1)]
    contact = PersistentSystem(
        System(model), [VertexPlane(2, (0.0, 0.0, 0.0), 1.2, normal=tuple(x), radius=radius) for x in sides]
    )
    q0 = pin.neutral(model)
    q0[:3] = turn @ [0.0, 0.0, radius / math.cos(opening)]
    result = steps(contact, q0, np.zeros(6), h, n)
    a, spin, _ = persistent_scenes.ball_in_groove(slope, opening)
    down = turn @ [1.0, 0.0, 0.0]
    assert (result.q - q0)[:3] @ down == pytest.approx(0.5 * a * (n * h) ** 2, abs=1e-15)
    assert result.p[4] == pytest.approx(BALL * radius * spin * n * h, abs=1e-15)
    # with friction across the groove the two normal forces are not unique, their sum is
    forces = (result.start + result.end) / h
    assert forces.sum(axis=0) == pytest.approx(a * down + [0.0, 0.0, GRAVITY], rel=1e-11)
    assert np.abs(result.gap).max() <= 1e-16


def test_ball_lies_in_a_groove_without_friction():
    opening, radius = 0.7, 0.1
    model = free_body(pin.Inertia.FromSphere(1.0, radius))
    sides = [np.array([0.0, s * math.sin(opening), math.cos(opening)]) for s in (-1, 1)]
    contact = PersistentSystem(
        System(model), [VertexPlane(2, (0.0, 0.0, 0.0), normal=tuple(x), radius=radius) for x in sides]
    )
    q0 = pin.neutral(model)
    q0[2] = radius / math.cos(opening)
    result = steps(contact, q0, np.zeros(6), 0.01, 3)
    load = persistent_scenes.ball_in_groove(0.0, opening)[2] * GRAVITY
    assert np.einsum("ij,ij->i", (result.start + result.end) / 0.01, sides) == pytest.approx([load, load], rel=1e-12)


# --- steps of persistent contact: order 2 against the continuous motion -----------------------------------------------
def spring_arm() -> tuple[PersistentSystem, np.ndarray, np.ndarray]:
    """A double pendulum whose tip slides along a floor below it, hinged with springs: it swings for ever in contact."""
    model = double_pendulum()
    system = System(model, stiffness=[0.0, 4.0, 0.0])
    contact = PersistentSystem(
        system, [VertexPlane(2, (0.0, 0.0, -1.0), normal=(0.0, 0.0, 1.0), offset=-1.5, radius=0.05)]
    )
    split = system.split
    q, v = np.array([0.5, 0.0]), np.zeros(2)
    for _ in range(30):  # the second joint closes the gap
        gap = contact.points.gaps(q)[0]
        q[1] -= gap / contact.points.gradients(q, contact.points.bases(q))[0, 0, 1]
        if abs(gap) < 1e-16:
            break
    assert split.nv == 2
    return contact, q, v


def converge(contact, q0, v0, kinds, duration, counts):
    """Errors of (q, v) against the continuous motion with these modes, for these numbers of steps."""
    model = contact.split.original
    q, v, _ = contact.flow(q0, v0, duration, kinds)
    errors = []
    for n in counts:
        result = steps(contact, q0, contact.system.momentum(q0, v0), duration / n, n)
        errors.append(laws.distance(model, (result.q, contact.system.velocity(result.q, result.p)), (q, v)))
    return errors


def test_held_arm_is_of_order_two_and_reversible():
    contact, q0, v0 = spring_arm()
    errors = converge(contact, q0, v0, ["none"], 0.4, (10, 20, 40))
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.05, errors
    p0 = contact.system.momentum(q0, v0)
    there = steps(contact, q0, p0, 0.02, 20)
    back = steps(contact, there.q, -there.p, 0.02, 20)
    assert np.abs(back.q - q0).max() <= 1e-13
    assert np.abs(back.p + p0).max() <= 1e-12
    assert np.abs(there.gap).max() <= 1e-15


@pytest.mark.parametrize("mu", [0.0, 2.0])
def test_ball_on_a_ball_is_of_order_two(mu):
    radius, support = 0.1, 0.5
    model = free_body(pin.Inertia.FromSphere(1.0, radius))
    point = SphereSphere(2, (0.0, 0.0, 0.0), radius, (0.0, 0.0, 0.0), support, mu)
    contact = PersistentSystem(System(model), [point])
    q0 = pin.neutral(model)
    q0[:3] = 0.6 * np.array([math.sin(0.3), 0.0, math.cos(0.3)])
    errors = converge(contact, q0, np.zeros(6), ["none" if mu == 0.0 else "stick"], 0.2, (5, 10, 20))
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.1, errors


def test_turning_slip_is_of_order_two():
    """A ball crosses a slope: its slip turns; the continuous motion also agrees with its own two-dimensional form."""
    slope, mu, radius, duration = 0.5, 0.1, 0.1, 0.3
    model = free_body(pin.Inertia.FromSphere(1.0, radius))
    down, normal = slope_frame(slope)
    contact = PersistentSystem(
        System(model), [VertexPlane(2, (0.0, 0.0, 0.0), mu, normal=tuple(normal), radius=radius)]
    )
    q0, v0 = on_slope(model, slope, radius), np.array([0.1, 0.6, 0.0, 0.0, 0.0, 0.0])
    exact = persistent_scenes.ball_crossing_slope(slope, mu, (0.1, 0.6), duration)
    q, v, _ = contact.flow(q0, v0, duration, ["slip"])
    assert np.abs([down @ (q - q0)[:3] - exact[0], q[1] - exact[1]]).max() <= 1e-11
    errors = converge(contact, q0, v0, ["slip"], duration, (6, 12, 24))
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.1, errors


def test_sticking_corner_stays_where_it_is():
    """A box tips about one edge: the corners' slip is a displacement, so they do not creep."""
    width, height, h, n = 0.2, 0.4, 0.01, 20
    model = free_body(pin.Inertia.FromBox(1.0, width, 0.3, height))
    edge = [VertexPlane(2, (0.5 * width, y, -0.5 * height), 3.0) for y in (-0.15, 0.15)]
    contact, tilt = PersistentSystem(System(model), edge), 0.6
    q0 = pin.neutral(model)
    turn = pin.exp3(np.array([0.0, tilt, 0.0]))
    q0[:3], q0[3:7] = -turn @ [0.5 * width, 0.0, -0.5 * height], pin.Quaternion(turn).coeffs()
    errors = []
    for k in (1, 2):
        result = steps(contact, q0, np.zeros(6), h / k, n * k)
        exact, _, grip = persistent_scenes.tipping_box(width, height, tilt, 0.0, n * h)
        assert grip < 3.0
        errors.append(2.0 * math.atan2(result.q[4], result.q[6]) - exact)
        pivot = result.q[:3] + pin.Quaternion(result.q[3:7]).matrix() @ [0.5 * width, 0.0, -0.5 * height]
        assert np.abs(pivot).max() <= 1e-15
    assert laws.orders(np.abs(errors))[0] == pytest.approx(2.0, abs=0.05)


# --- continuous forces ------------------------------------------------------------------------------------------------
def ladder_model() -> tuple[pin.Model, list]:
    model = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1.0 / 12.0, 1.0 / 12.0])))
    floor = VertexPlane(2, (0.5, 0.0, 0.0), radius=0.01)
    wall = VertexPlane(2, (-0.5, 0.0, 0.0), normal=(1.0, 0.0, 0.0), radius=0.01)
    return model, [floor, wall]


def test_ladder_leaves_its_wall_at_two_thirds():
    theta0 = 1.2
    ladder, (model, listed) = persistent_scenes.Ladder(theta0), ladder_model()
    contact = PersistentSystem(System(model), listed)
    q0 = pin.neutral(model)
    turn = pin.exp3(np.array([0.0, theta0, 0.0]))  # body x points down to the floor
    q0[:3], q0[3:7] = [0.01 + 0.5 * math.cos(theta0), 0.0, 0.01 + 0.5 * math.sin(theta0)], pin.Quaternion(turn).coeffs()
    assert np.abs(contact.points.gaps(q0)).max() <= 1e-15
    q, v, t = contact.flow(
        q0, np.zeros(6), 2.0, ["none"] * 2, event=lambda x, u: contact.forces(x, u, ["none"] * 2)[0][1, 0]
    )
    released, rate = ladder.release
    assert t == pytest.approx(released, abs=1e-10)
    assert v[4] == pytest.approx(rate, abs=1e-9)
    assert (q[2] - 0.01) / (0.5 * math.sin(theta0)) == pytest.approx(2.0 / 3.0, abs=1e-10)
    q, _, _ = PersistentSystem(System(model), listed[:1]).flow(q, v, 0.2, ["none"])
    theta, _, x, _ = ladder.state(t + 0.2)
    assert q[0] - 0.01 == pytest.approx(x, abs=1e-9)
    assert q[2] - 0.01 == pytest.approx(0.5 * math.sin(theta), abs=1e-9)


@pytest.mark.parametrize("rolling", [False, True])
def test_ball_leaves_a_ball(rolling):
    radius, support, angle0 = 0.1, 0.5, 0.2
    model = free_body(pin.Inertia.FromSphere(1.0, radius))
    contact = PersistentSystem(System(model), [SphereSphere(2, (0.0, 0.0, 0.0), radius, (0.0, 0.0, 0.0), support, 1.0)])
    q0, kinds = pin.neutral(model), ["stick" if rolling else "none"]
    q0[:3] = 0.6 * np.array([math.sin(angle0), 0.0, math.cos(angle0)])
    q, _, t = contact.flow(q0, np.zeros(6), 5.0, kinds, event=lambda x, u: contact.forces(x, u, kinds)[0][0, 0])
    angle, time = persistent_scenes.ball_off_ball(radius + support, angle0, rolling)
    assert math.atan2(q[0], q[2]) == pytest.approx(angle, abs=1e-9)
    assert t == pytest.approx(time, abs=1e-9)


def test_limit_force_is_the_torque_of_gravity():
    model = pin.Model()
    model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.array([1.0, 0.0, 0.0]), np.zeros((3, 3))), pin.SE3.Identity())
    contact = PersistentSystem(System(model), [Limit(1, 0.4, -1.0)])
    result = steps(contact, np.array([0.4]), np.zeros(1), 0.01, 3)
    assert (result.start + result.end)[0, 0] / 0.01 == pytest.approx(GRAVITY * math.cos(0.4), rel=1e-12)
    assert abs(result.p[0]) <= 1e-16
