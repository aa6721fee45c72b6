"""Hard numbers for all three maps: small and large steps, mass ratios, many impacts, grazing, impacts at a step's end.

Every run keeps the laws to its end, or its Status gives the reason why it ended earlier: never NaN, never a crash.
"""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers import map_runs
from helpers.contact_models import GRAVITY, geometry, place, problem_b, room, room_start, slider_blocks
from helpers.contact_models import scene as public_scene
from oracles import momentum_maps

# SUCCESS, ZENO, NEWTON_FAILED, EVENT_UNRESOLVED: the last two where a step turns a body by more than its chart covers
SUCCESS, ZENO, NEWTON, EVENT = (
    cvi.StatusCode.SUCCESS,
    cvi.StatusCode.ZENO,
    cvi.StatusCode.NEWTON_FAILED,
    cvi.StatusCode.EVENT_UNRESOLVED,
)
VARIANTS = [("ctec", False), ("dtec", False), ("mhc", False), ("mhc", True)]
variants = pytest.mark.parametrize(("method", "mhc_global"), VARIANTS, ids=["ctec", "dtec", "mhc", "mhc_global"])


def lawful(scene, result, ends: tuple[int, ...] = (SUCCESS,), gap: float = 1e-12) -> None:
    """What holds for any run, however it ended, recorded at every node."""
    assert result.code in ends, (result.code, result.message)
    assert (result.code == SUCCESS) == (result.message == "")
    for values in (result.t, result.q, result.p, *(result.log[k] for k in ("time", "impulse", "q", "p_plus", "G_c"))):
        assert np.all(np.isfinite(values))
    core, log = scene.core(), result.log
    for q in result.q:
        assert np.min(core.gaps(q)[0], initial=1.0) >= -max(gap, 1e-10)
    if not result.events:
        return
    assert np.all(np.diff(log["time"]) >= 0.0)
    assert np.all(log["impulse"] >= 0.0)
    # plastic contacts of one instant are one problem: one of them may close only by what the others do
    assert np.all(np.where(log["restitution"] > 0.0, log["gamma_minus"] < 0.0, log["gamma_minus"] <= 0.0))
    # a point of a face that lay there without closing (the edge that a box tips about) stays so, to rounding, as does
    # what a plastic impact stops
    alone = (log["restitution"] > 0.0) & (log["points"] == 1)
    assert np.all(log["gamma_plus"][alone] >= 0.0), log["gamma_plus"][alone].min()
    assert np.all(log["gamma_plus"] >= -1e-14 * np.abs(log["p_plus"]).max()), log["gamma_plus"].min()
    assert np.abs(log["gap"]).max() <= gap
    ctec = -(1.0 + log["restitution"]) * log["gamma_minus"] / log["G_c"]
    # several plastic contacts of one instant, and the points of a face, are one problem
    explicit = ((log["fallback"] != 0) | (result.method == "ctec")) & (log["restitution"] > 0.0) & (log["points"] == 1)
    assert np.all(np.abs(log["impulse"] - ctec)[explicit] <= 1e-12 * ctec[explicit])
    # the scalar of each map, a sum of energies: the solver's 1e-12 of the largest of them and their rounding
    scale = 1.0 + np.abs(core.energy(result.q, result.p)).max()
    assert np.abs(own_jumps(scene, result)).max(initial=0.0) <= 1e-11 * scale
    loss = (1.0 - log["restitution"] ** 2) * log["gamma_minus"] ** 2 / (2.0 * log["G_c"])
    assert np.abs(log["loss"] - loss)[alone].max(initial=0.0) <= 1e-12 * scale
    _, instant = np.unique(
        log["time"], return_inverse=True
    )  # of one problem one contact may take what another one gives
    assert np.bincount(instant, log["loss"]).min() >= -1e-12 * scale


def own_jumps(scene, result) -> np.ndarray:
    """What each impact (MHC: each step with impacts) without fallback changes of its map's scalar beyond the loss.

    The scalars of DTEC and MHC belong to one length of the step: nothing of runs in which steps were cut. MHC's is not
    known where contacts persist in a part of the step.
    """
    core, log, found = scene.core(), result.log, []
    loss = log["loss"]
    if result.method != "ctec" and result.stats["halved"]:
        return np.zeros(0)
    if result.method == "mhc":
        persistent = set(result.contacts["step"][result.contacts["h"] > 0.0])
        whole = len(result.t) - (result.code != SUCCESS)  # the last node of a run that ended early lies within a step
        modified = core.modified_energy(result.q[:whole], result.p[:whole], result.h)
        for step in np.unique(log["step"]):
            here = log["step"] == step
            known = step + 1 < len(modified) and step not in persistent and not log["fallback"][here].any()
            if known and not result.mhc_global:
                found.append(modified[step + 1] - modified[step] + loss[here].sum())
        return np.array(found)
    sides = [(log["p_minus"], -log["before"]), (log["p_plus"], log["after"])]
    if result.method == "ctec":
        minus, plus = (core.energy(log["q"], p).sum(axis=1) for p, _ in sides)
    else:
        minus, plus = (core.discrete_energy(log["q"], p, part) for p, part in sides)
    alone = log["fallback"] == 0
    if result.method == "dtec":  # of impacts at one instant only the sequence conserves E_d
        alone &= (log["before"] > 0.0) & (log["after"] > 0.0)
    return (plus - minus + loss)[alone]


def run(scene, q, v, duration, h, method, mhc_global, **options):
    result = map_runs.run(scene, q, v, duration, h, method, mhc_global=mhc_global, **options)
    result.mhc_global = mhc_global
    return result


# --- steps from 1e-5 to 1e-1 ----------------------------------------------------------------------------------------
@variants
@pytest.mark.thinned(3)
@pytest.mark.parametrize("h", [1e-1, 3e-2, 1e-2, 1e-3, 1e-4, 1e-5])
def test_step_sizes(method, mhc_global, h):
    """Problem B up to its second impact: both found, no fallback, the scalar kept, at every step size."""
    scene = public_scene(*problem_b())
    result = run(scene, [0.3, 0.2], [0.0, 0.0], 2.2 if h >= 1e-4 else 0.7, h, method, mhc_global)
    lawful(scene, result)
    assert len(result.events) == (2 if h >= 1e-4 else 1)
    assert np.all(result.log["fallback"] == 0)
    assert abs(result.log["time"][0] - 0.656671045) <= max(1e-8, 0.5 * h * h)  # the exact time of impact; order 2


@variants
@pytest.mark.parametrize("h", [5e-2, 1e-3])
def test_step_sizes_on_bodies(method, mhc_global, h):
    model, shapes, q, v, duration, _ = map_runs.two_bodies(gravity=False)
    scene = public_scene(model, shapes)
    result = run(scene, q, v, duration, h, method, mhc_global)
    lawful(scene, result)
    assert len(result.events) == 1


# --- mass ratios ----------------------------------------------------------------------------------------------------
@variants
@pytest.mark.parametrize("ratio", [1e-6, 1e-3, 1e3, 1e6])
def test_mass_ratios_of_free_bodies(method, mhc_global, ratio):
    """Two free bodies, one up to a million times as heavy: total momentum kept, both scalars too."""
    model, shapes, q, v, duration, h = map_runs.two_bodies(ratio=ratio)
    scene = public_scene(model, shapes)
    result = run(scene, q, v, duration, h, method, mhc_global)
    lawful(scene, result)
    assert len(result.events) >= 1
    for e in result.events:
        before, after = (momentum_maps.spatial_momentum(model, e.q, p) for p in (e.p_minus, e.p_plus))
        assert np.abs(after - before).max() <= 1e-12 * np.abs(e.p_minus).max()


@variants
def test_mass_ratio_of_a_million_at_a_wall(method, mhc_global):
    """Two blocks and a wall, mass ratio 100^3: 3141 impacts, then both fly off; without forces all maps are equal."""
    scene = public_scene(*slider_blocks((1.0, 1e6), 0.1, "sphere"))
    result = run(scene, [1.1, 2.3], [0.0, -1.0], 4.0, 0.05, method, mhc_global)
    lawful(scene, result)
    assert len(result.events) == 3141
    kinetic = 0.5 * result.p**2 @ [1.0, 1e-6]
    assert np.abs(kinetic / kinetic[0] - 1.0).max() <= 1e-12
    assert 0.0 < result.p[-1, 0] <= result.p[-1, 1] / 1e6


@variants
@pytest.mark.parametrize("ratio", [1e-6, 1e6])
def test_mass_ratios_within_a_tree(method, mhc_global, ratio):
    """Problem B with the tip a million times lighter or heavier than the elbow.

    A heavy tip falls freely until the links are in line and then snaps the elbow over in some 1e-6 s: halved steps
    of the midpoint rule do not follow that, and the status reports it.
    """
    model, shapes = problem_b()
    model.inertias[2] = pin.Inertia(ratio, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3)))
    scene = public_scene(model, shapes)
    result = run(scene, [0.3, 0.2], [0.0, 0.0], 2.0, 0.005, method, mhc_global)
    lawful(scene, result, (SUCCESS,) if ratio < 1.0 else (SUCCESS, NEWTON))
    assert len(result.events) >= (1 if ratio < 1.0 else 0)


@variants
@pytest.mark.parametrize("order", [4, 8])
def test_halved_steps_get_over_a_snap(method, mhc_global, order):
    """The same heavy tip at high order: steps are halved until they are solved, and grow again; none is accurate."""
    model, shapes = problem_b()
    model.inertias[2] = pin.Inertia(1e6, np.array([0.0, 0.0, -1.0]), np.zeros((3, 3)))
    result = map_runs.run(
        public_scene(model, shapes), [0.3, 0.2], [0.0, 0.0], 1.0, 0.005, method, order=order, mhc_global=mhc_global
    )
    assert result.code == SUCCESS, result.message
    assert len(result.t) == 201
    assert result.stats["halved"] > 0
    assert np.all(np.isfinite(result.p))


# --- many impacts ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", map_runs.METHODS)
@pytest.mark.slow
def test_a_hundred_thousand_impacts_of_a_ball(method, record_property):
    import contactvi as cvi

    scene, height = cvi.Scene(gravity=(0.0, 0.0, -GRAVITY)), 0.01
    scene.add_sphere("ball", radius=0.1, mass=0.5)
    scene.add_halfspace()
    scene.set_contact(restitution=1.0)
    q = np.array([0.0, 0.0, 0.1 + height, 0.0, 0.0, 0.0, 1.0])
    result = map_runs.run(scene, q, np.zeros(6), 9040.0, 0.01, method, every=100)
    assert result.code == SUCCESS, result.message
    assert len(result.events) >= 100_000
    assert np.all(np.isfinite(result.p))
    assert np.all(result.log["fallback"] == 0)
    energy = scene.core().energy(result.q, result.p).sum(axis=1) - 0.5 * GRAVITY * 0.1
    error = float(np.abs(energy / energy[0] - 1.0).max())
    record_property("relative_energy_error", float(error))
    if method != "dtec":  # DTEC: 1.3e-2 already at 100 s
        assert error <= 1e-10  # 1e-11 per 1e3 impacts is the bar of a long run; errors of either sign add up slowly


@pytest.mark.long
@variants
def test_a_hundred_thousand_impacts_of_problem_b(method, mhc_global):
    """1.5e5 s: nothing ends the run, H stays bounded for the two maps that bound it."""
    scene = public_scene(*problem_b())
    result = map_runs.run(scene, [0.3, 0.2], [0.0, 0.0], 1.5e5, 0.02, method, every=50, mhc_global=mhc_global)
    assert result.code == SUCCESS, result.message
    assert len(result.events) >= 100_000
    assert np.all(np.isfinite(result.p))
    assert np.all(result.log["impulse"] > 0.0)
    energy = scene.core().energy(result.q, result.p).sum(axis=1)
    if method == "mhc":
        assert np.ptp(energy) <= 0.05  # H - H~ is h^2 times accelerations squared, some 1e-2 J here


# --- grazing --------------------------------------------------------------------------------------------------------
def tip(q) -> float:
    return math.sin(q[0]) + math.sin(q[0] + q[1])


def turning_point(h: float) -> float:
    """Least x of the tip of problem B without a wall, on the engine's partial steps about 1.34 s."""
    scene = public_scene(problem_b()[0], pin.GeometryModel())
    free, core = map_runs.run(scene, [0.3, 0.2], [0.0, 0.0], 2.0, h, "ctec"), scene.core()
    k = int(np.argmin([tip(q) for q in free.q]))
    found = []
    for j in (k - 1, k):
        low, high, ratio = 0.0, h, (math.sqrt(5.0) - 1.0) / 2.0
        for _ in range(60):  # golden section
            a, b = high - ratio * (high - low), low + ratio * (high - low)
            if tip(core.step(free.q[j], free.p[j], a)[0]) < tip(core.step(free.q[j], free.p[j], b)[0]):
                high = b
            else:
                low = a
        found.append(tip(core.step(free.q[j], free.p[j], low)[0]))
    return min(found)


def wall_at(x: float):
    """Problem B with its wall at x [m]."""
    model, shapes = problem_b()
    shapes.geometryObjects[1].placement = place(x)
    return public_scene(model, shapes)


@variants
@pytest.mark.thinned(2)
@pytest.mark.parametrize("h", [0.04, 0.01, 0.0025])
def test_grazing(method, mhc_global, h, record_property):
    """Grazing: one event where the tip would pass the wall by more than 1e-10 m, none where it would not."""
    turning, worst = turning_point(h), 0.0
    for depth in (1e-2, 1e-3, 1e-5, 1e-7, 1e-8, 1e-9, 1e-10, 0.0, -1e-11, -1e-9):
        scene = wall_at(turning + depth)
        result = run(scene, [0.3, 0.2], [0.0, 0.0], 2.0, h, method, mhc_global)
        lawful(scene, result)
        assert len(result.events) == (1 if depth > 0.0 else 0), depth
        assert len(result.t) == round(2.0 / h) + 1
        assert result.stats["stage_iterations"] <= 40 * round(2.0 / h)  # bounded work: some 5 per step and the location
        for e in result.events:
            h_minus, h_plus = (scene.core().energy(e.q[None], p[None]).sum() for p in (e.p_minus, e.p_plus))
            worst = max(worst, abs(h_plus - h_minus))
    record_property("largest_energy_jump", float(worst))
    if method == "ctec":  # the other two conserve their own scalar (`lawful`), and H to their order only
        assert worst <= 1e-8


@variants
def test_a_grazing_ball_pair(method, mhc_global):
    """Two spheres passing at a hair less than their contact distance: the same for a curved gap, no gravity."""
    for offset in (0.9, 0.999, 1 - 1e-6, 1 - 1e-9, 1 + 1e-9):
        model, shapes = pin.Model(), {}
        model.gravity = pin.Motion.Zero()
        for i in range(2):
            model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"body{i}")
            model.appendBodyToJoint(i + 1, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
            shapes[f"ball{i}"] = (i + 1, pin.SE3.Identity(), coal.Sphere(0.1))
        scene = public_scene(model, geometry(shapes, [("ball0", "ball1")]))
        q, v = pin.neutral(model), np.zeros(12)
        q[7:10], v[0], v[6] = (1.0, 0.2 * offset, 0.0), 1.0, -1.0
        result = run(scene, q, v, 1.0, 0.0371, method, mhc_global)
        lawful(scene, result)
        assert len(result.events) == (1 if offset < 1.0 else 0), offset


# --- impacts at the end of a step -----------------------------------------------------------------------------------
SHIFTS = (0.0, 1e-15, 1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-8)


@variants
@pytest.mark.thinned(2)
@pytest.mark.parametrize("h", [0.02, 0.001])
def test_impacts_next_to_a_step_end(method, mhc_global, h):
    """Problem B with the wall moved so that the tip reaches it within 1e-8 s of a node, on either side."""
    free = map_runs.run(public_scene(problem_b()[0], pin.GeometryModel()), [0.3, 0.2], [0.0, 0.0], 0.66, h, "ctec")
    k = round(0.64 / h)
    speed = (tip(free.q[k + 1]) - tip(free.q[k - 1])) / (2.0 * h)
    reference = []
    for shift in [s * sign for s in SHIFTS for sign in (1.0, -1.0)]:
        scene = wall_at(tip(free.q[k]) + speed * shift)
        result = run(scene, [0.3, 0.2], [0.0, 0.0], 0.8, h, method, mhc_global)
        lawful(scene, result)
        assert len(result.events) == 1, shift
        e = result.events[0]
        # the wall's place and the location are good to 1e-12 m, the speed along the step to h^2
        assert abs(e.time - (k * h + shift)) <= 4e-12 + 10.0 * h * abs(shift)
        assert e.fallback == 0
        reference.append([*result.q[-1], *result.p[-1]])
    # CTEC depends smoothly on the shift; for the others the parts of the step change places at the node, and with them
    # an energy of (g h)^2 / 4, so a speed of (g h)^2 / (4 gamma)
    spread = np.ptp(np.array(reference), axis=0).max()
    assert spread <= (1e-6 if method == "ctec" else (GRAVITY * h) ** 2 / 4.0)


# --- rooms ----------------------------------------------------------------------------------------------------------
# [m] Pairs that are this near when another one has its impact take part in it (Guards::kTouching).
TOUCHING = 1e-11


def rooms(method, mhc_global, h, restitution, seeds, ends) -> None:
    for seed in seeds:
        model, shapes = room(True)
        q, v = room_start(model, 3.0, seed)
        scene = public_scene(model, shapes, restitution)
        result = run(scene, q, v, 2.0, h, method, mhc_global)
        lawful(scene, result, ends, gap=TOUCHING)


@variants
@pytest.mark.thinned(3)
@pytest.mark.parametrize("restitution", [1.0, 0.7])
@pytest.mark.parametrize("h", [0.02, 0.005])
def test_rooms(method, mhc_global, restitution, h):
    """An arm and four free bodies between six walls: lawful to the end, or an accumulation of impacts."""
    rooms(method, mhc_global, h, restitution, range(100, 106), (SUCCESS,) if restitution == 1.0 else (SUCCESS, ZENO))


@pytest.mark.long
@variants
@pytest.mark.parametrize("restitution", [1.0, 0.9, 0.5])
@pytest.mark.parametrize("h", [0.05, 0.02, 0.002])
def test_many_rooms(method, mhc_global, restitution, h):
    """Steps of 0.05 s turn some bodies by more than pi: those runs end with a reason."""
    ends = (SUCCESS, ZENO, NEWTON, EVENT) if h > 0.02 else (SUCCESS, ZENO)
    rooms(method, mhc_global, h, restitution, range(200, 240), ends)
