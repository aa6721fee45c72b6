"""CTEC, DTEC and MHC: each impact against the oracles, what each map conserves, its order, long runs, closed forms."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin
import pytest

from helpers import laws, map_runs
from helpers.contact_models import GRAVITY, problem_b
from helpers.contact_models import scene as public_scene
from helpers.map_runs import METHODS
from oracles import ctec_oracle, dtec_mhc, momentum_maps
from oracles import problem_b as reference_b
from oracles.del_step import System
from oracles.modified_energy import modified_energy

ABSOLUTE = np.array([[1.0, 0.0], [1.0, 1.0]])  # absolute = ABSOLUTE @ relative angles of problem B
START_B = (np.array([0.3, 0.2]), np.zeros(2))
IMPLICIT = ("dtec", "mhc")
maps = pytest.mark.parametrize("method", METHODS)
implicit = pytest.mark.parametrize("method", IMPLICIT)


@functools.cache
def run_b(method: str, h: float, duration: float = 3.0, restitution: float = 1.0, mhc_global: bool = False):
    scene = public_scene(*problem_b(), restitution)
    return map_runs.run(scene, *START_B, duration, h, method, mhc_global=mhc_global)


def gradient_b(event) -> np.ndarray:
    """W of problem B by hand, relative angles."""
    return reference_b.gap_gradient(ABSOLUTE @ event.q) @ ABSOLUTE


def ball_scene():
    """A centred ball of 0.5 kg over a floor, e = 1."""
    import contactvi as cvi

    scene = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY))
    scene.add_sphere("ball", radius=0.1, mass=0.5)
    scene.add_halfspace()
    scene.set_contact(restitution=1.0)
    return scene


def drop(method: str, height: float, duration: float, h: float = 0.01, spin: float = 0.0):
    """The ball released `height` [m] above the floor."""
    q, v = np.array([0.0, 0.0, 0.1 + height, 0.0, 0.0, 0.0, 1.0]), np.zeros(6)
    v[3:] = spin * np.array([1.0, -2.0, 0.5])
    return map_runs.run(ball_scene(), q, v, duration, h, method)


# --- the oracles against themselves ---------------------------------------------------------------------------------
def one_ball() -> System:
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(1, pin.Inertia.FromSphere(0.7, 0.1), pin.SE3.Identity())
    return System(model)


UP = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize(("before", "after"), [(0.003, 0.007), (0.01, 1e-6), (1e-7, 0.01), (0.005, 0.005)])
def test_oracle_on_a_ball_has_the_closed_forms(before, after):
    """Of a dropped ball: p+^2 = p-^2 + m^2 g^2 (r^2 - a^2)/4 for DTEC, and MHC = CTEC."""
    system, p = one_ball(), np.array([0.3, -0.2, -1.1, 0.02, 0.01, 0.0])
    q = pin.neutral(system.split.original)
    hit = dtec_mhc.dtec(system, q, p, UP, 1.0, before, after)
    exact = p[2] ** 2 + (0.7 * GRAVITY) ** 2 * (after**2 - before**2) / 4
    assert hit.p_plus[2] ** 2 == pytest.approx(exact, rel=1e-13)
    q0, p0 = system.step(q, p, -before)
    h = before + after
    hit = dtec_mhc.mhc(system, q, p, UP, 1.0, after, h, modified_energy(system, q0, p0, h))
    assert hit.impulse == pytest.approx(-2.0 * p[2], rel=1e-12)


@pytest.mark.parametrize("h", [0.04, 0.01])
def test_oracles_run_backwards(h):
    """From the end of an elastic impact step with the momentum reversed, the same impulse leads back to its start."""
    system, result = System(problem_b()[0]), run_b("ctec", h)
    e = result.events[0]
    before, after, w, k = float(e.before), float(e.after), gradient_b(e), int(e.step)
    there = dtec_mhc.dtec(system, e.q, e.p_minus, w, 1.0, before, after)
    back = dtec_mhc.dtec(system, e.q, -there.p_plus, w, 1.0, after, before)
    # two solves to the rounding of energies of some 30 J: 1e-14 / gamma_plus each
    assert back.impulse == pytest.approx(there.impulse, rel=1e-12)
    assert np.abs(back.p_plus + e.p_minus).max() <= 1e-11
    start = modified_energy(system, result.q[k], result.p[k], h)
    there = dtec_mhc.mhc(system, e.q, e.p_minus, w, 1.0, after, h, start)
    end = modified_energy(system, *system.step(e.q, there.p_plus, after), h)
    back = dtec_mhc.mhc(system, e.q, -there.p_plus, w, 1.0, before, h, end)
    assert back.impulse == pytest.approx(there.impulse, rel=1e-12)
    assert np.abs(back.p_plus + e.p_minus).max() <= 1e-11


def test_oracles_meet_ctec_as_the_step_shrinks():
    """lambda differs from CTEC's by O(h^2): both scalars are H up to there."""
    system, e = System(problem_b()[0]), run_b("ctec", 0.01).events[0]
    w, gaps = gradient_b(e), []
    exact = ctec_oracle.impact(system.split.original, e.q, e.p_minus, w, 0.6).impulse
    for h in (0.02, 0.01, 0.005):
        q0, p0 = system.step(e.q, e.p_minus, -0.3 * h)
        mhc = dtec_mhc.mhc(system, e.q, e.p_minus, w, 0.6, 0.7 * h, h, modified_energy(system, q0, p0, h))
        dtec = dtec_mhc.dtec(system, e.q, e.p_minus, w, 0.6, 0.3 * h, 0.7 * h)
        gaps.append([abs(mhc.impulse - exact), abs(dtec.impulse - exact)])
    assert np.abs(laws.orders(gaps) - 2.0).max() <= 0.1, gaps


# --- the engine against the oracles ---------------------------------------------------------------------------------
def check_against_oracle(system: System, result, gradient) -> int:
    """Impulse and p_plus of every event that did not fall back; the number of events checked."""
    checked = 0
    for e, hit in map_runs.oracle_impacts(system, result, gradient):
        assert e.fallback == 0, (e.time, e.fallback)
        assert METHODS[int(e.method)] == result.method
        # the scalar is good to some eps of the energies in it (below 100 J here), and its slope is gamma_plus
        tolerance = 1e-9 + 1e-13 / (e.impulse * e.gamma_plus)
        assert abs(e.impulse - hit.impulse) <= tolerance * e.impulse, (e.time, e.impulse, hit.impulse)
        assert np.abs(e.p_plus - hit.p_plus).max() <= tolerance * (np.abs(hit.p_plus).max() + e.impulse)
        assert e.gamma_minus == pytest.approx(hit.gamma_minus, rel=1e-9)
        assert e.impulse > 0.0
        assert e.iterations >= 1
        assert abs(e.jump) <= 1e-11 * (1.0 + abs(e.gamma_minus * e.impulse))
        checked += 1
    return checked


@implicit
@pytest.mark.parametrize("restitution", [1.0, 0.7])
@pytest.mark.parametrize("h", [0.04, 0.01])
def test_problem_b_is_the_oracles(method, restitution, h):
    result = run_b(method, h, 3.0 if restitution == 1.0 else 1.4, restitution)
    assert check_against_oracle(System(problem_b()[0]), result, gradient_b) >= (2 if restitution == 1.0 else 1)


@implicit
@pytest.mark.thinned(3)
@pytest.mark.parametrize("restitution", [1.0, 0.9])
@pytest.mark.parametrize("build", [map_runs.two_bodies, map_runs.body_at_wall, map_runs.arm_at_wall])
def test_bodies_and_an_arm_are_the_oracles(method, restitution, build):
    model, geometry, q, v, duration, h = build()
    scene = public_scene(model, geometry, restitution)
    result = map_runs.run(scene, q, v, duration, h, method)
    assert result.code == 0, result.message
    assert check_against_oracle(System(model), result, map_runs.gradient_of(scene)) >= 1
    for e in result.events:
        ctec = -(1.0 + restitution) * e.gamma_minus / e.G_c
        assert 1e-7 < abs(e.impulse / ctec - 1.0) < 0.2  # another map than CTEC, but not far from it


@implicit
@pytest.mark.thinned(2)
def test_several_impacts_in_one_step_are_the_oracles(method):
    """A body at 8 m/s with .3 m to move between the walls, h = .05: two impacts in some steps."""
    model, geometry, q, v, *_ = map_runs.body_at_wall(half=0.35)
    v[2] = -8.0
    scene = public_scene(model, geometry)
    result = map_runs.run(scene, q, v, 0.5, 0.05, method)
    assert result.code == 0, result.message
    assert max(len(group) for group in map_runs.by_step(result.events)) >= 2
    assert check_against_oracle(System(model), result, map_runs.gradient_of(scene)) >= 5


@implicit
@pytest.mark.thinned(2)
def test_a_hand_hit_by_a_ball_is_the_oracles(method):
    scene, system, q = map_runs.hand_and_ball()
    result = map_runs.run(scene, q, np.zeros(scene.nv), 0.22, 0.002, method)
    assert result.code == 0, result.message
    pairs = {frozenset(scene.pair_names[e.index]) for e in result.events}
    assert len(pairs) >= 3  # two fingers and the palm
    assert check_against_oracle(system, result, map_runs.gradient_of(scene)) >= 3


@maps
@pytest.mark.parametrize("ratio", [1.0, 1e3, 1e6])
def test_two_free_bodies_keep_their_total_momentum(method, ratio):
    model, geometry, q, v, duration, h = map_runs.two_bodies(ratio=ratio)
    result = map_runs.run(public_scene(model, geometry), q, v, duration, h, method)
    assert result.code == 0, result.message
    assert len(result.events) >= 1
    for e in result.events:
        jump = momentum_maps.spatial_momentum(model, e.q, e.p_plus) - momentum_maps.spatial_momentum(
            model, e.q, e.p_minus
        )
        size = np.abs(e.p_minus).max() + e.impulse
        assert np.abs(jump).max() <= 1e-12 * size, jump


@maps
def test_the_impulse_is_along_the_gradient(method):
    """At a wall the tangential part of the momentum is unchanged."""
    model, geometry, q, v, duration, h = map_runs.body_at_wall()
    scene = public_scene(model, geometry)
    gradient = map_runs.gradient_of(scene)
    for e in map_runs.run(scene, q, v, duration, h, method).events:
        assert np.abs(e.p_plus - e.p_minus - e.impulse * gradient(e)).max() <= 1e-12 * (1.0 + e.impulse)
        linear = momentum_maps.spatial_momentum(model, e.q, e.p_plus - e.p_minus)[:2]
        assert np.abs(linear).max() <= 1e-13 * (1.0 + e.impulse)


# --- what each map conserves ----------------------------------------------------------------------------------------
def jumps(system: System, result, e) -> np.ndarray:
    """Jumps [J] of H, E_d and H~ over an impact alone in its step."""
    k, h = int(e.step), result.h
    h_minus, h_plus = (dtec_mhc.energy(system, e.q, p) for p in (e.p_minus, e.p_plus))
    d_minus = dtec_mhc.discrete_energy(system, e.q, e.p_minus, -float(e.before))
    d_plus = dtec_mhc.discrete_energy(system, e.q, e.p_plus, float(e.after))
    m_minus, m_plus = (modified_energy(system, result.q[i], result.p[i], h) for i in (k, k + 1))
    return np.array([h_plus - h_minus, d_plus - d_minus, m_plus - m_minus])


@maps
def test_each_map_conserves_its_own_scalar_and_no_other(method):
    """The 3 x 3 table on problem B, h = .02: own jump at rounding, the other two at h^2."""
    system, result = System(problem_b()[0]), run_b(method, 0.02)
    for e in result.events:
        kinetic = 0.5 * e.p_minus @ np.linalg.solve(laws.mass_matrix(system.split.original, e.q), e.p_minus)
        relative = np.abs(jumps(system, result, e)) / kinetic
        own = METHODS.index(method)
        assert relative[own] <= 1e-11, relative
        assert np.delete(relative, own).min() >= 1e-5, relative


@maps
def test_orders_on_problem_b(method):
    """CTEC and MHC are of order 2 (1.96 1.99 2.00 2.00); DTEC's orders scatter about 2."""
    exact = reference_b.run(3.0)
    errors = [np.linalg.norm(ABSOLUTE @ run_b(method, h).q[-1] - exact.q) for h in (0.04, 0.02, 0.01, 0.005, 0.0025)]
    orders = laws.orders(errors)
    if method == "dtec":
        assert abs(orders.mean() - 2.0) <= 0.05, orders
        assert np.abs(orders - 2.0).max() <= 0.25, orders
    else:
        assert np.abs(orders - [1.96, 1.99, 2.00, 2.00]).max() <= 0.006, orders  # two decimals


@maps
@pytest.mark.parametrize("torque", [0.0, 2.0])
def test_orders_with_damping_and_a_torque(method, torque):
    """Neither scalar is constant then: a map that gave back what the forces took in its step would be of order 1."""
    import contactvi as cvi

    scene = cvi.Scene.from_pinocchio(*problem_b())
    scene.set_contact(restitution=1.0)
    for name in list(scene.model.names)[1:]:
        scene.set_joint(name, damping=0.5)

    def end(h: float, way: str) -> np.ndarray:
        steps = round(1.2 / h)
        simulator = map_runs.start(scene, *START_B, h, way)
        result = simulator.advance(steps, np.tile([torque, -torque], (steps, 1)), 1, None)
        assert result["code"] == 0, result["message"]
        assert len(result["events"]["time"]) == 1
        return np.concatenate([result["q"][-1], result["p"][-1]])

    exact = end(0.04 / 512, "ctec")  # its own error is 32^2 times smaller than the smallest here
    orders = laws.orders([np.linalg.norm(end(h, method) - exact) for h in (0.04, 0.02, 0.01, 0.005, 0.0025)])
    assert abs(orders.mean() - 2.0) <= 0.05, orders
    if method != "dtec":  # whose constant depends on where in its step an impact lies
        assert np.abs(orders - 2.0).max() <= 0.06, orders


def impact_step(method: str, h: float):
    """(step, q, p): one step of problem B with an impact at 0.45 of it."""
    scene, model = public_scene(*problem_b()), problem_b()[0]
    e = run_b("ctec", 0.005).events[0]
    q, p, *_ = scene.core().step(e.q, e.p_minus, -0.45 * h, None, 1e-14)

    def step(q0, p0):
        simulator = map_runs.start(scene, q0, np.linalg.solve(laws.mass_matrix(model, q0), p0), h, method, tol=1e-14)
        result = simulator.advance(1, None, 1, None)
        assert result["code"] == 0
        assert len(result["events"]["time"]) == 1
        return result["q"][-1], result["p"][-1]

    return step, q, p


@maps
def test_only_dtec_is_symplectic_over_an_impact_step(method):
    """max |J^T Om J - Om| by differences, h = .04 .02 .01: DTEC about 2e-10, the others 1e-4 to 1e-2."""
    model = problem_b()[0]
    # the impact must stay in the step when the state is varied: 1.8 m/s * .45 h is more than 3 eps |W|
    defects = [laws.symplectic_defect(model, *impact_step(method, h), eps=0.05 * h) for h in (0.04, 0.02, 0.01)]
    if method == "dtec":
        assert max(defects) <= 1e-9, defects  # the location's 1e-12 m and the solver's 1e-14, divided by eps
    else:
        assert min(defects) >= 1e-5, defects


# --- closed forms of the ball ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("height", [1.0, 0.1, 0.01])
def test_dtec_on_a_ball_is_its_closed_form(height):
    """DTEC on a dropped ball changes its energy: dH = m g^2 h (r - a) / 8."""
    m, h = 0.5, 0.01
    result = drop("dtec", height, 5.0, h)
    assert len(result.events) >= 5
    for e in result.events:
        assert e.fallback == 0
        a, r = float(e.before), float(e.after)
        exact = e.p_minus[2] ** 2 + (m * GRAVITY) ** 2 * (r * r - a * a) / 4
        assert e.p_plus[2] ** 2 == pytest.approx(exact, rel=1e-13)
        if abs(a + r - h) <= 1e-15:
            gain = (e.p_plus[2] ** 2 - e.p_minus[2] ** 2) / (2 * m)
            assert gain == pytest.approx(m * GRAVITY**2 * h * (r - a) / 8, abs=1e-13 * (1.0 + height))


@pytest.mark.parametrize("spin", [0.0, 3.0])
def test_mhc_on_a_ball_is_ctec(spin):
    """MHC on a dropped ball is CTEC, because H~ differs from H by a constant."""
    result = drop("mhc", 1.0, 5.0, spin=spin)
    assert len(result.events) >= 5
    for e in result.events:
        assert e.fallback == 0
        assert e.impulse == pytest.approx(-2.0 * e.gamma_minus / e.G_c, rel=1e-12)
    energy = ball_scene().core().energy(result.q, result.p).sum(axis=1)
    assert np.abs(energy / energy[0] - 1.0).max() <= 1e-12


@maps
@pytest.mark.parametrize("height", [1.0, 0.1, 0.01, 0.001])
def test_dense_impacts_of_a_ball(method, height, record_property):
    """100 s at h = .01: CTEC and MHC keep the energy at every drop height; DTEC's change is reported only."""
    result = drop(method, height, 100.0)
    assert result.code == 0, result.message
    t = np.sqrt(2.0 * height / GRAVITY)
    energy = ball_scene().core().energy(result.q, result.p).sum(axis=1) - 0.5 * GRAVITY * 0.1  # above rest
    error = float(np.abs(energy / energy[0] - 1.0).max())
    record_property("relative_energy_error", float(error))
    if method != "dtec":
        assert abs(len(result.events) - (100.0 / t + 1.0) / 2.0) <= 1.0
        assert error <= 1e-11


# --- a long run -----------------------------------------------------------------------------------------------------
def test_a_thousand_seconds_of_problem_b():
    """Decile means of H - H(0): MHC flat, the spread of either other at least three times as large."""
    core, spread = public_scene(*problem_b()).core(), {}
    for name, method, mhc_global in (("ctec", "ctec", False), ("dtec", "dtec", False), ("mhc", "mhc", False)) + (
        ("global", "mhc", True),
    ):
        result = run_b(method, 0.02, 1000.0, 1.0, mhc_global)
        assert result.code == 0, result.message
        assert 690 <= len(result.events) <= 725  # about 707
        energy = core.energy(result.q, result.p).sum(axis=1)
        means = [part.mean() for part in np.array_split(energy[1:] - energy[0], 10)]
        spread[name] = float(np.ptp(means))
        assert np.all(result.log["fallback"] == 0)
    for name in ("mhc", "global"):
        assert spread[name] <= min(spread["ctec"], spread["dtec"]) / 3.0, spread


def test_the_global_reference_does_not_drift():
    """H~ after every impact is that of the start to rounding, where the local one adds up what the steps leave."""
    core = public_scene(*problem_b()).core()
    result = run_b("mhc", 0.02, 1000.0, 1.0, True)
    modified = core.modified_energy(result.q, result.p, 0.02)
    after = modified[np.asarray(result.log["step"], int) + 1] - modified[0]
    # the sum of some energies of 30 J
    assert np.abs(after).max() <= 1e-12 * 30.0
