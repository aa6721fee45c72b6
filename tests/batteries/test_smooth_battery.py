"""Every model of the battery against every law of the smooth step, and against the oracles.

Tolerances: the engine's residual is at most tol * scale with tol = 1e-12 (1e-13 asked for here), so states agree to
that times the conditioning of M.
"""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin
import pytest

from batteries.models import CASES, FREE_FLOATING, case, springs_of
from helpers import laws
from helpers.engine import advance, core_scene, simulator, stepper
from oracles.del_step import System
from oracles.modified_energy import modified_energy
from oracles.momentum_maps import spatial_momentum
from oracles.smooth import flow

EPS = np.finfo(float).eps
every_case = pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
free_floating = pytest.mark.parametrize("case", FREE_FLOATING, ids=lambda c: c.name)


@functools.cache
def setup(name: str, springs: bool = False, damping: bool = False, gravity: bool = True):
    """(model, engine scene, oracle system, q, v, p) of a case; the start is the same for all variants."""
    c = case(name)
    model = c.model()
    if not gravity:
        model.gravity = pin.Motion.Zero()
    extra = springs_of(model, np.random.default_rng(7)) if springs or damping else {}
    if name in ("allegro", "talos"):  # springs and damping in proportion to the small links
        extra = {k: x if k == "rest" else 0.02 * x for k, x in extra.items()}
    if not damping:
        extra.pop("damping", None)
    if not springs:
        extra.pop("stiffness", None)
    system = System(model, **extra)
    q, v = c.state(model)
    return model, core_scene(model, **extra), system, q, v, system.momentum(q, v)


def close(a, b, tol: float) -> bool:
    """|a - b| <= tol * (1 + |b|), largest entry."""
    return bool(np.abs(np.asarray(a) - b).max(initial=0.0) <= tol * (1.0 + np.abs(b).max(initial=0.0)))


# --- coordinates and dynamics -------------------------------------------------------------------------------------
@every_case
def test_coordinates_and_dynamics(case):
    model, scene, system, q, v, p = setup(case.name)
    t = system.split.tangent_map(q)
    assert (scene.nq, scene.nv, scene.njoints, scene.npairs) == (model.nq, model.nv, model.njoints, 0)
    assert close(scene.to_engine(q, v), t @ v, 16 * EPS)
    assert close(scene.to_public(q, t @ v), v, 16 * EPS)
    assert close(scene.momentum_to_engine(q, p), t @ p, 16 * EPS)
    assert close(scene.momentum_to_public(q, t @ p), p, 16 * EPS)
    # sums of up to 50 products over a few levels of the tree
    assert close(scene.momentum(q[None], v[None])[0], laws.mass_matrix(model, q) @ v, 512 * EPS)
    # M^-1 loses the condition of M, up to 1e6 for Talos
    assert close(scene.velocity(q[None], p[None])[0], v, 1e-9)
    P, kinetic, potential = system.dynamics(q, t @ v)
    for engine, oracle in zip(scene.dynamics(q, t @ v), (P, kinetic - potential), strict=True):
        assert close(engine, oracle, 512 * EPS)


@every_case
def test_energies(case):
    model, scene, system, q, v, p = setup(case.name, springs=True)
    t = system.split.tangent_map(q)
    assert close(scene.energy(q[None], p[None])[0], system.energy(q, t @ v), 1e-12)
    for h in (case.h, 10 * case.h):
        difference = scene.modified_energy(q[None], p[None], h)[0] - scene.energy(q[None], p[None]).sum()
        wanted = modified_energy(system, q, p, h) - system.energy(q, t @ v).sum()
        # h^2 H2 against an energy of order E: its rounding is eps * E
        assert abs(difference - wanted) <= 1e-9 * abs(wanted) + 256 * EPS * np.abs(system.energy(q, t @ v)).max()


# --- the step -----------------------------------------------------------------------------------------------------
@every_case
@pytest.mark.thinned(3)
@pytest.mark.parametrize("kind", ["free", "springs", "damping"])
def test_step_is_the_oracles_step(case, kind):
    springs, damping = kind != "free", kind == "damping"
    model, scene, system, *_ = setup(case.name, springs, damping)
    for seed, h in ((0, case.h), (1, 1e-4), (2, 2 * case.h)):
        q, v = case.state(model, seed)
        p = system.momentum(q, v)
        tau = None if seed == 0 else 0.1 * np.random.default_rng(seed).uniform(-1, 1, model.nv)
        q1, p1, v_mid, iterations, residual = scene.step(q, p, h, tau, 1e-13)
        q_oracle, p_oracle = system.step(q, p, h, tau)
        assert np.abs(q1 - q_oracle).max() <= 1e-10
        assert np.abs(p1 - p_oracle).max() <= 1e-10
        assert close(v_mid[0], system.split.difference(q, q1) / h, 1e-10)
        assert iterations >= 1
        # own count of the residual, with v taken from q1: the rounding of q1 divided by h comes on top
        floor = 16 * EPS / h * np.abs(system.mass_matrix(q)).sum(axis=1).max()
        assert np.abs(system.residual(q, p, q1, p1, h, tau)).max() <= 1e-10 + floor


@pytest.mark.parametrize(
    ("name", "h"),
    [
        ("free_body", 0.05),
        ("joint_spherical", 0.02),
        ("joint_continuous_z", 0.02),
        ("joint_planar", 0.02),
        ("pair", 0.02),
    ],
)
def test_large_rotations_in_one_step(name, h):
    """0.4 to 1.7 rad per step: the exponential and its Jacobians far from the identity.

    From about 1 rad per step on, coupled bodies may have no solution near the start (the oracle's Newton fails too), so
    only the free body goes there.
    """
    c = case(name)
    model, scene, system, *_ = setup(name)
    for seed in range(5):
        q, v = c.state(model, seed)
        p = system.momentum(q, 20.0 / c.speed * v)
        q1, p1, *_ = scene.step(q, p, h, None, 1e-13)
        q_oracle, p_oracle = system.step(q, p, h)
        assert close(q1, q_oracle, 1e-10)
        assert close(p1, p_oracle, 1e-10)


@pytest.mark.long
@every_case
def test_many_steps_are_the_oracles_steps(case):
    model, scene, system, *_ = setup(case.name, True, True)
    for seed in range(10, 30):
        q, v = case.state(model, seed)
        h = case.h * 10.0 ** np.random.default_rng(seed).uniform(-3, 0.5)
        p, tau = system.momentum(q, v), np.random.default_rng(seed).uniform(-1, 1, model.nv)
        q1, p1, *_ = scene.step(q, p, h, tau, 1e-13)
        q_oracle, p_oracle = system.step(q, p, h, tau)
        assert np.abs(q1 - q_oracle).max() <= 1e-10
        assert close(p1, p_oracle, 1e-10)


@every_case
def test_step_is_symplectic(case):
    model, scene, _, q, _, p = setup(case.name, springs=True)
    assert laws.symplectic_defect(model, stepper(scene, case.h), q, p) <= 1e-9


@every_case
def test_step_is_reversible(case):
    model, scene, _, q, v, p = setup(case.name, springs=True)
    step = stepper(scene, case.h)
    q1, p1 = laws.run(step, q, p, 20)
    q2, p2 = laws.run(step, q1, -p1, 20)
    # 40 solves of tolerance 1e-13 (relative), conditioned by M
    assert laws.distance(model, (q2, scene.velocity(q2[None], -p2[None])[0]), (q, v)) <= 1e-9


@every_case
@pytest.mark.parametrize("damping", [False, True], ids=["conservative", "damped"])
def test_order_is_two(case, damping):
    model, scene, system, q, v, _ = setup(case.name, damping, damping)
    duration, n = 10 * case.h, 10
    reference = flow(system, q, v, duration, rtol=1e-13)
    errors = []
    for steps in (2 * n, 4 * n, 8 * n):
        _, qs, ps = advance(scene, model, q, v, duration / steps, steps, steps)
        errors.append(laws.distance(model, (qs[-1], scene.velocity(qs[-1:], ps[-1:])[0]), reference))
    assert np.abs(laws.orders(errors) - 2.0).max() <= 0.05, errors


# --- long laws ----------------------------------------------------------------------------------------------------
@free_floating
@pytest.mark.parametrize("h", [1e-3, 1e-5])
def test_momentum_maps_over_ten_thousand_steps(case, h):
    model, scene, _, q, v, p = setup(case.name, gravity=False)
    start = spatial_momentum(model, q, p)
    _, qs, ps = advance(scene, model, q, v, h, 10_000, 100)
    drift = max(np.abs(spatial_momentum(model, a, b) - start).max() for a, b in zip(qs, ps, strict=True))
    assert drift <= 1e-10


@every_case
def test_energy_varies_with_h_squared_and_the_modified_energy_with_its_fourth_power(case):
    model, scene, system, q, v, _ = setup(case.name, springs=True)
    steps, plain, modified = 40, [], []
    for k in (1, 2, 4):
        # the same times for every h, so that only the amplitude differs
        h = case.h / k
        _, qs, ps = advance(scene, model, q, v, h, steps * k, 4 * k)
        plain.append(np.ptp(scene.energy(qs, ps).sum(axis=1)))
        modified.append(np.ptp(scene.modified_energy(qs, ps, h)))
    assert np.abs(laws.orders(plain) - 2.0).max() <= 0.1, plain
    # the last variation may reach the rounding of the energy; drop what is below 1e3 eps of it
    floor = 1e3 * EPS * np.abs(scene.energy(q[None], system.momentum(q, v)[None])).max()
    seen = [m for m in modified if m > floor]
    assert len(seen) >= 2, modified
    assert np.abs(laws.orders(seen) - 4.0).max() <= 0.2, modified


@every_case
@pytest.mark.thinned(3)
def test_damping_takes_energy(case):
    model, scene, system, q, v, _ = setup(case.name, springs=True, damping=True)
    _, qs, ps = advance(scene, model, q, v, case.h / 4, 400, 40)
    energy = scene.energy(qs, ps).sum(axis=1)
    assert np.all(np.diff(energy) < 0.0)
    end = flow(system, q, v, 100 * case.h, rtol=1e-11)
    exact = system.energy(end[0], system.split.tangent_map(end[0]) @ end[1]).sum()
    # order 2 at a quarter of the sensible step: the error is small against what was lost
    assert abs(energy[-1] - exact) <= 1e-2 * (energy[0] - exact)


def test_steps_without_pairs_look_at_no_geometry():
    _, scene, _, q, v, _ = setup("double_pendulum")
    run = simulator(scene, 1e-2)
    run.reset(q, v, 0.0)
    stats = run.advance(100, None, 1, None)["stats"]
    assert (stats["guards_evaluated"], stats["guards_skipped"], stats["impacts"], stats["steps"]) == (0, 0, 0, 100)


@pytest.mark.parametrize("name", ["arm_spherical", "tree", "forest", "joint_planar", "joint_translation"])
def test_the_python_api_runs_the_same_system(name):
    """Springs, damping and control set through cvi.Scene and cvi.simulate: five oracle steps later the same state."""
    import contactvi as cvi

    c = case(name)
    model = c.model()
    extra = springs_of(model, np.random.default_rng(5))
    scene = cvi.Scene.from_pinocchio(model)
    for i in range(1, model.njoints):
        j = model.joints[i]
        settings = {"damping": extra["damping"][j.idx_v]}
        if extra["stiffness"][i]:
            rest = extra["rest"][j.idx_q : j.idx_q + j.nq]
            if (j.nq, j.nv) == (2, 1):
                rest = np.arctan2(rest[1:], rest[:1])
            settings |= {"stiffness": extra["stiffness"][i], "rest": rest if rest.size > 1 else float(rest[0])}
        scene.set_joint(model.names[i], **settings)
    system, (q, v) = System(model, **extra), c.state(model)
    tau = np.random.default_rng(6).uniform(-1, 1, (5, model.nv))
    traj = cvi.simulate(scene, q, v, 5 * c.h, c.h, control=tau)
    p = system.momentum(q, v)
    for k in range(5):
        q, p = system.step(q, p, c.h, tau[k])
        assert close(traj.q[k + 1], q, 1e-10)
        assert close(traj.p[k + 1], p, 1e-10)
        assert close(traj.v[k + 1], system.velocity(q, p), 1e-10)
        energy = system.energy(q, system.split.tangent_map(q) @ system.velocity(q, p)).sum()
        assert traj.energy[k + 1] == pytest.approx(energy, rel=1e-10, abs=1e-10)
        assert traj.modified_energy[k + 1] == pytest.approx(modified_energy(system, q, p, c.h), rel=1e-9, abs=1e-9)
