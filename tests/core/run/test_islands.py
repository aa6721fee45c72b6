"""Islands: each as if it were alone, all together as the whole world advanced at once."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.bench import heaps
from helpers import engine
from helpers.engine import contacts_of, core_scene

Array = np.ndarray


def at(*position: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array(position))


def heap(scene: cvi.Scene, name: str, x: float, seed: int, count: int = 4) -> Array:
    """Adds boxes and spheres that fall on each other at x [m]; returns their velocities."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        place = at(x + 0.02 * rng.normal(), 0.02 * rng.normal(), 0.15 + 0.2 * i)
        if i % 2:
            scene.add_sphere(f"{name}{i}", 0.07, placement=place)
        else:
            scene.add_box(f"{name}{i}", (0.15, 0.12, 0.1), placement=place)
    return np.hstack([0.3 * rng.normal(size=(count, 3)), 2.0 * rng.normal(size=(count, 3))]).ravel()


def two_heaps(apart: float, seed: int) -> tuple[cvi.Scene, Array]:
    """On the ground, `apart` [m] along x; and their velocities."""
    scene = cvi.Scene()
    v = np.concatenate([heap(scene, "a", 0.0, seed), heap(scene, "b", apart, seed + 1)])
    scene.add_halfspace()
    scene.set_contact(restitution=0.3, friction=0.4)
    return scene, v


def gas(count: int, seed: int, density: float = 0.02, order: Array | None = None) -> tuple[cvi.Scene, Array, list[str]]:
    """Elastic spheres between six walls; order: in which they are added."""
    rng = np.random.default_rng(seed)
    radius, cells = 0.05, int(np.ceil(count ** (1 / 3)))
    side = (count * 4.0 / 3.0 * np.pi * radius**3 / density) ** (1 / 3)
    grid = (np.argwhere(np.ones((cells, cells, cells)))[:count] + 0.5) * side / cells
    v = np.hstack([rng.normal(size=(count, 3)), np.zeros((count, 3))])
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    order = np.arange(count) if order is None else order
    names = [f"s{i}" for i in order]
    for i in order:
        scene.add_sphere(f"s{i}", radius, placement=at(*grid[i]))
    for axis in np.eye(3):
        scene.add_halfspace(tuple(axis), 0.0, name=f"low{axis}")
        scene.add_halfspace(tuple(-axis), -side, name=f"high{axis}")
    scene.set_contact(restitution=1.0, friction=0.0)
    return scene, v[order].ravel(), names


def run(scene: cvi.Scene, v: Array, dt: float, steps: int, q: Array | None = None, **options):
    """The result of the engine's run from the neutral configuration, and its simulator."""
    simulator = engine.simulator(scene.core(), dt, **options)
    start = simulator.reset(scene.neutral() if q is None else q, v)
    assert start["code"] == 0, start["message"]
    result = simulator.advance(steps)
    assert result["code"] == 0, result["message"]
    return result, simulator


def columns(scene: cvi.Scene, names: list[str]) -> Array:
    return np.concatenate([np.r_[scene.q_index(name)] for name in names])


def same_bits(a: Array, b: Array) -> bool:
    return np.ascontiguousarray(a).tobytes() == np.ascontiguousarray(b).tobytes()


# --- an island alone and in a crowd -----------------------------------------------------------------------------------
@pytest.mark.parametrize("seed", range(5))
def test_an_island_alone_has_the_bits_of_one_in_a_crowd(seed):
    """Others before and after it in the numbering of bodies, with impacts and contacts of their own."""
    found = []
    for crowd in ("", "behind", "before and behind"):
        scene, v = cvi.Scene(), []
        if "before" in crowd:
            v.append(heap(scene, "c", 5.0, 900 + seed))
        v.append(heap(scene, "a", 0.0, seed))
        if "behind" in crowd:
            v.append(heap(scene, "b", 3.0, 100 + seed))
        scene.add_halfspace()
        scene.set_contact(restitution=0.3, friction=0.4)
        result, simulator = run(scene, np.concatenate(v), 1e-3, 300)
        mine = columns(scene, [f"a{i}" for i in range(4)])
        found.append(result["q"][:, mine])
        assert simulator.islands >= 1 + len(v) - 1
        assert result["stats"]["impacts"] > 0
    assert same_bits(found[0], found[1])
    assert same_bits(found[0], found[2])


def test_coupled_bodies_are_one_tree():
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    for i in range(4):
        scene.add_sphere(f"s{i}", 0.05, placement=at(float(i), 0.0, 0.0))
    free = engine.simulator(scene.core(), 1e-3)
    free.reset(scene.neutral(), np.zeros(scene.nv))
    free.advance(1)
    scene.add_spring("s0", "s1", stiffness=10.0, rest_length=1.0)
    coupled = engine.simulator(scene.core(), 1e-3)
    coupled.reset(scene.neutral(), np.zeros(scene.nv))
    coupled.advance(1)
    assert (free.islands, coupled.islands) == (4, 3)


# --- islands and the whole world at once ------------------------------------------------------------------------------
def test_events_are_those_of_the_whole_world():
    scene, v, _ = gas(12, 3)
    one, simulator = run(scene, v, 2e-3, 300)
    two, together = run(scene, v, 2e-3, 300, islands=False)
    assert simulator.islands > 6
    assert together.islands == 0
    assert len(one["events"]["time"]) == len(two["events"]["time"]) > 30
    assert np.array_equal(one["events"]["index"], two["events"]["index"])
    # the flow of a gas amplifies rounding: 4 to 6 free paths, each by ten at most
    assert np.abs(one["events"]["time"] - two["events"]["time"]).max() <= 1e-12
    assert np.abs(one["q"][-1] - two["q"][-1]).max() <= 1e-11
    assert np.abs(one["p"][-1] - two["p"][-1]).max() <= 1e-11


@pytest.mark.parametrize("restitution", [1.0, 0.6])
def test_a_blow_that_runs_through_bodies_at_rest(restitution):
    """Bodies at rest are islands alone; the blow makes them meet in the step of the first impact, which is redone."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    for i in range(6):
        scene.add_sphere(f"s{i}", 0.05, placement=at(0.1004 * i + (0.003 if i else 0.0), 0.0, 0.0))
    scene.set_contact(restitution=restitution, friction=0.0)
    v = np.zeros(scene.nv)
    v[0] = 20.0
    one, _ = run(scene, v, 1e-3, 5)
    two, _ = run(scene, v, 1e-3, 5, islands=False)
    assert len(one["events"]["time"]) == len(two["events"]["time"]) >= 5
    assert np.sum(one["events"]["time"] < 1e-3) >= 5
    assert np.abs(one["events"]["time"] - two["events"]["time"]).max() <= 1e-15
    assert np.abs(one["q"] - two["q"]).max() <= 1e-14
    assert np.abs(one["p"] - two["p"]).max() <= 1e-13


def test_a_kick_after_a_time_in_which_nothing_was_near():
    """As long as nothing is near nobody looks who may meet: a body that moves much further than before is noticed."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    for i in range(4):
        scene.add_box(f"b{i}", (0.1, 0.1, 0.1), mass=1.0, placement=at(0.4 * i, 0.0, 0.0))
    scene.set_contact(restitution=0.5, friction=0.0)
    v = 0.01 * np.random.default_rng(2).normal(size=scene.nv)
    kick = np.zeros((50, scene.nv))
    kick[40, scene.v_index("b0").start] = 8e5  # N: 0.4 m in the step
    results = []
    for islands in (True, False):
        simulator = engine.simulator(scene.core(), 1e-3, islands=islands)
        assert simulator.reset(scene.neutral(), v)["code"] == 0
        results.append(simulator.advance(50, kick))
        assert results[-1]["code"] == 0
    one, two = results
    assert one["events"]["time"].min() < 0.041
    assert len(one["events"]["time"]) == len(two["events"]["time"]) >= 2
    assert np.abs(one["events"]["time"] - two["events"]["time"]).max() <= 1e-13
    assert np.abs(one["q"][-1] - two["q"][-1]).max() <= 1e-10  # after blows at 400 m/s


def sliders(places: Array) -> tuple[pin.Model, pin.GeometryModel]:
    """Balls of 1 kg on a line, which may meet each other and a wall behind them."""
    import coal

    model, geometry = pin.Model(), pin.GeometryModel()
    model.gravity.linear = np.zeros(3)
    for k, place in enumerate(places):
        joint = model.addJoint(0, pin.JointModelPX(), at(place, 0.0, 0.0), f"slide{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, RADIUS), pin.SE3.Identity())
        geometry.addGeometryObject(pin.GeometryObject(f"ball{k}", joint, pin.SE3.Identity(), coal.Sphere(RADIUS)))
    wall = geometry.addGeometryObject(pin.GeometryObject("wall", 0, at(-5.0, 0.0, 0.0), coal.Box(0.1, 1.0, 1.0)))
    for a in range(len(places)):
        for b in (*range(a + 1, len(places)), wall):
            geometry.addCollisionPair(pin.CollisionPair(a, b))
    return model, geometry


RADIUS = 0.05


@pytest.mark.parametrize("seed", range(20))
def test_a_push_after_steps_that_nobody_looks_at(seed):
    """The impact is at the time that follows from the force, in the first step of it or after a hundred.

    Before it all are so slow that what is expected of them is exceeded by far: both where a step of an island is taken
    without a look at its guards, and where an interval is taken without a look at who may meet.
    """
    rng = np.random.default_rng(seed)
    h, gap, quiet = 1e-3, rng.uniform(0.05, 0.5), int(rng.integers(5, 200))
    scene = cvi.Scene.from_pinocchio(*sliders((gap + 2.0 * RADIUS) * np.arange(3)))
    v = np.append(rng.uniform(-1e-3, 1e-3, 2), 0.0)
    push = 2.0 * gap / h**2 * 10.0 ** rng.uniform(-4.0, 1.0)  # N: across the gap in so many steps
    # slow t + push (t - start)^2 / 2 = gap, relative to the ball in front
    start, slow = quiet * h, v[0] - v[1]
    taken = (np.sqrt(slow**2 + 2.0 * push * (gap - slow * start)) - slow) / push
    simulator = engine.simulator(scene.core(), h)
    assert simulator.reset(scene.neutral(), v)["code"] == 0
    assert simulator.advance(quiet, np.zeros((quiet, 3)))["code"] == 0
    assert simulator.islands == 3
    steps = int(np.ceil(taken / h))
    events = simulator.advance(steps, np.tile([push, 0.0, 0.0], (steps, 1)))["events"]
    assert abs(events["time"][0] - (start + taken)) <= 1e-12


def test_the_order_of_bodies_does_not_matter():
    count = 12
    permuted = np.random.default_rng(1).permutation(count)
    one = gas(count, 3)
    two = gas(count, 3, order=permuted)
    first, second = (run(scene, v, 2e-3, 300)[0] for scene, v, _ in (one, two))
    of = [columns(scene, [f"s{i}" for i in range(count)]) for scene, _, _ in (one, two)]
    assert len(first["events"]["time"]) > 30
    assert np.abs(first["events"]["time"] - second["events"]["time"]).max() <= 1e-12
    assert np.abs(first["q"][-1, of[0]] - second["q"][-1, of[1]]).max() <= 1e-11


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_what_falls_together_flies_apart(shape):
    """Bodies 5 mm from each other that fall by 10 cm a step are islands of their own, until two of them meet."""
    scene = cvi.Scene()
    scene.add_halfspace(offset=-100.0)
    for k in range(12):
        place = at(0.205 * (k % 4), 0.205 * (k // 4), 0.0)
        if shape == "sphere":
            scene.add_sphere(f"body{k}", 0.1, placement=place)
        else:
            scene.add_box(f"body{k}", (0.2, 0.2, 0.2), placement=place)
    scene.set_contact(restitution=1.0, friction=0.0)
    v = np.zeros((12, 6))
    v[:, 2] = -10.0
    v[5, 0] = 0.06  # meets its neighbour after 1 / 12 s
    ends, hits = [], []
    for islands in (True, False):
        simulator = engine.simulator(scene.core(), 0.01, islands=islands)
        simulator.reset(scene.neutral(), v.ravel())
        early = simulator.advance(3)
        assert simulator.islands in (12, 0)
        late = simulator.advance(13)
        hits.append(late["events"]["time"])
        assert early["events"] is None
        ends.append(late["q"][-1])
    assert np.abs(hits[0] - 1.0 / 12.0).max() <= 1e-12
    assert hits[0].shape == hits[1].shape
    assert np.abs(ends[0] - ends[1]).max() <= 1e-11


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_a_ball_that_comes_back_from_a_wall_meets_who_follows_it(shape):
    """Both impacts lie in one step: the path from the wall back is not the one that the step began with."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    add = (
        scene.add_sphere if shape == "sphere" else lambda name, r, **a: scene.add_box(name, (2 * r, 2 * r, 2 * r), **a)
    )
    add("first", 0.05, placement=at(0.25, 0.0, 0.0))
    add("second", 0.05, placement=at(0.75, 0.0, 0.0))
    scene.add_halfspace((1.0, 0.0, 0.0), 0.0, name="wall")
    scene.set_contact(restitution=1.0, friction=0.0)
    v = np.zeros(12)
    v[[0, 6]] = -4.0, -2.0
    # The first is at the wall after 0.05 s, at x = 0.05; they meet in the middle of the gap of 0.5 m that is left then,
    # where the second, at x = 0.65, closes with 6 m/s: 0.05 + 0.5 / 6 s.
    one, simulator = run(scene, v, 0.2, 1)
    np.testing.assert_allclose(one["events"]["time"], [0.05, 0.05 + 0.5 / 6.0], rtol=0, atol=1e-12)
    assert simulator.islands == 1
    two, _ = run(scene, v, 0.2, 1, islands=False)
    np.testing.assert_allclose(one["q"][-1], two["q"][-1], rtol=0, atol=1e-13)


def test_who_passes_another_one_by_stays_alone():
    """They move by more than their distance, and not towards each other."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_sphere("a", 0.05, placement=at(0.0, 0.0, 0.0))
    scene.add_sphere("b", 0.05, placement=at(0.0, 0.11, 0.0))
    scene.set_contact(restitution=1.0, friction=0.0)
    v = np.zeros(12)
    v[[0, 6]] = 1.0, -1.0
    _, simulator = run(scene, v, 0.05, 1)
    assert simulator.islands == 2


def test_who_rattles_meets_only_whom_it_reaches():
    """Twenty impacts between two walls in a step, over 20 mm in all: a ball 100 mm aside is not met."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_sphere("rattles", 0.05, placement=at(0.0505, 0.0, 0.0))
    scene.add_sphere("aside", 0.05, placement=at(0.0505, 0.2, 0.0))
    scene.add_halfspace((1.0, 0.0, 0.0), 0.0, name="low")
    scene.add_halfspace((-1.0, 0.0, 0.0), -0.101, name="high")
    scene.set_contact(restitution=0.999, friction=0.1)
    v = np.zeros(12)
    v[0] = 1.0
    result, simulator = run(scene, v, 0.02, 5)
    assert result["stats"]["impacts"] >= 90
    assert simulator.islands == 2


@pytest.mark.parametrize("seed", range(3))
def test_islands_of_a_gas_are_few_bodies_each(seed):
    """A tenth of the room is filled, and a step moves a body by a fifth of its radius: who meets nobody is alone.

    An impact joins two bodies; what it changes in their paths, foretold without it, may join each to one more.
    """
    scene, v, names = gas(300, seed, density=0.1)
    simulator = engine.simulator(scene.core(), 1e-2)
    assert simulator.reset(scene.neutral(), v)["code"] == 0
    for _ in range(30):
        events = simulator.advance(1)["events"]
        impacts = 0 if events is None else len(events["time"])
        assert simulator.islands >= len(names) - 3 * impacts


def test_a_snapshot_of_a_crowd_in_flight_goes_on_to_the_bit():
    """Boxes that tumble close to each other: which of them are joined depends on how they have turned before."""
    scene = cvi.Scene()
    for k in range(12):
        scene.add_box(f"body{k}", (0.1, 0.06, 0.04), placement=at(0.13 * (k % 4), 0.13 * (k // 4), 0.0))
    scene.set_contact(restitution=0.8, friction=0.0)
    v = np.random.default_rng(5).normal(size=(12, 6)) * [0.2, 0.2, 0.2, 3.0, 3.0, 3.0]
    simulator = engine.simulator(scene.core(), 2e-3)
    simulator.reset(scene.neutral(), v.ravel())
    simulator.advance(25)
    for _ in range(6):
        kept = simulator.save()
        first = simulator.advance(20)
        assert simulator.islands > 1
        other = engine.simulator(scene.core(), 2e-3)
        other.load(kept)
        again = other.advance(20)
        assert same_bits(first["q"], again["q"])
        assert same_bits(first["p"], again["p"])
    assert first["stats"]["impacts"] > 0


def test_an_impact_costs_its_bodies_only():
    """Stage iterations beyond one for each body and step, per impact: a few, where a step of all would be 120."""
    cost = {}
    for count, steps in ((10, 400), (120, 60)):
        scene, v, _ = gas(count, 5)
        result, _ = run(scene, v, 2e-3, steps)
        stats, energy = result["stats"], np.asarray(scene.core().energy(result["q"], result["p"])).sum(axis=1)
        assert stats["impacts"] >= 30
        assert np.abs(energy / energy[0] - 1.0).max() <= 1e-12
        cost[count] = (stats["stage_iterations"] - count * steps) / stats["impacts"]
    assert max(cost.values()) <= 4.0, cost


# --- the state is a value ---------------------------------------------------------------------------------------------
def test_a_snapshot_of_islands_goes_on_to_the_bit():
    scene, v = two_heaps(2.0, 4)
    _, simulator = run(scene, v, 1e-3, 120)
    kept = simulator.save()
    first = simulator.advance(80)
    simulator.advance(50)
    simulator.load(kept)
    again = simulator.advance(80)
    other = engine.simulator(scene.core(), 1e-3)
    other.load(kept)
    elsewhere = other.advance(80)
    for name in ("t", "q", "p"):
        assert same_bits(first[name], again[name]), name
        assert same_bits(first[name], elsewhere[name]), name


def test_a_reset_leaves_nothing_of_the_run_before():
    """Engines of islands are kept for later: what they have been through does not show."""
    scene, v = two_heaps(1.0, 8)
    first, simulator = run(scene, v, 1e-3, 200)
    simulator.reset(scene.neutral(), 0.5 * v)
    simulator.advance(150)
    simulator.reset(scene.neutral(), v)
    again = simulator.advance(200)
    assert again["stats"]["impacts"] == first["stats"]["impacts"]
    for name in ("q", "p"):
        assert same_bits(first[name], again[name])


def test_calls_of_one_step_and_of_many_are_the_same():
    scene = cvi.Scene()
    v = np.concatenate([heap(scene, "a", 0.0, 6), heap(scene, "b", 2.0, 7)])
    scene.add_halfspace()
    whole, _ = run(scene, v, 1e-3, 150)
    _, simulator = run(scene, v, 1e-3, 0)
    for k in range(150):
        step = simulator.advance(1)
        assert same_bits(step["q"][-1], whole["q"][k + 1])


def test_the_run_ends_at_one_time():
    """One body stops bouncing while another flies: where the run ends, both are where they are then."""
    scene = cvi.Scene()
    scene.add_sphere("bouncing", 0.1, placement=at(0.0, 0.0, 0.2))
    scene.add_sphere("flying", 0.1, placement=at(1.0, 0.0, 50.0))
    scene.add_halfspace()
    scene.set_contact(restitution=0.5, friction=0.0)
    simulator = engine.simulator(scene.core(), 0.01, end_at_zeno=True)
    v = np.zeros(scene.nv)
    v[8] = 3.0
    simulator.reset(scene.neutral(), v)
    result = simulator.advance(1000)
    assert result["code"] == 1
    t, height = result["time"], result["q"][-1, 9]
    assert result["t"][-1] == t
    assert height == pytest.approx(50.0 + 3.0 * t - 0.5 * 9.81 * t * t, rel=1e-12)


# --- islands at rest --------------------------------------------------------------------------------------------------
def resting_boxes(count: int = 4) -> cvi.Scene:
    scene = cvi.Scene()
    for i in range(count):
        scene.add_box(f"box{i}", (0.1, 0.12, 0.08), placement=at(0.3 * i, 0.0, 0.04))
    scene.add_halfspace()
    scene.set_contact(restitution=0.0, friction=0.5)
    return scene


def test_islands_at_rest_are_not_solved_and_keep_their_forces():
    scene = resting_boxes()
    early, simulator = run(scene, np.zeros(scene.nv), 1e-3, 50)
    late = simulator.advance(400)
    assert late["stats"]["contact_steps"] == early["stats"]["contact_steps"] < 4 * 50
    rows = contacts_of(late, scene)
    weights = np.bincount(rows["step"] - rows["step"].min(), weights=(rows["start"] + rows["end"])[:, 2] / rows["h"])
    masses = np.asarray([i.mass for i in scene.model.inertias[1:]]).sum()
    assert np.abs(np.abs(weights) / (masses * 9.81) - 1.0).max() <= 1e-9
    assert np.abs(rows["t"] - 1e-3 * rows["step"]).max() <= 1e-15
    assert same_bits(late["q"][0], late["q"][-1])


@pytest.mark.parametrize(("family", "seed"), [("cards", 1), ("mixed_tower", 2), ("dominoes", 2)])
def test_a_heap_in_dense_steps_comes_to_rest(family, seed):
    """What is at rest is solved to rounding, and then not solved at all; its forces carry it on."""
    made = heaps.make(family, seed, restitution=0.0, friction=0.8)
    scene, q, v = heaps.to_scene(made)
    simulator = cvi.Simulator(scene, 1e-3, contact_mode="steps")
    simulator.reset(q, v)
    simulator.run(1200)
    solved = simulator.trajectory().stats.dense_passes
    assert simulator.run(200).code == cvi.StatusCode.SUCCESS
    traj = simulator.trajectory()
    assert traj.stats.dense_passes == solved
    assert same_bits(traj.q[-1], traj.q[-200])
    _, force = traj.contacts.on("plane0")
    weight = 9.81 * sum(body.mass for body in made.bodies)
    # The law is solved to 1e-12 of g h, which the rows of a dozen bodies add up to less than a thousand times.
    np.testing.assert_allclose(np.abs(force[-100:, 2]), weight, rtol=1e-9)


def test_what_leaves_an_unstable_equilibrium_does_not_sleep():
    """Two slender rods: one hangs at rest, the other stands, off by 1e-13 rad, and falls within seconds."""
    model = pin.Model()
    for k, angle in enumerate((0.0, np.pi - 1e-13)):
        place = pin.SE3(pin.rpy.rpyToMatrix(angle, 0.0, 0.0), np.array([3.0 * k, 0.0, 0.0]))
        model.addJoint(0, pin.JointModelRX(), place, f"hinge{k}")
        rod = pin.Inertia(1.0, np.array([0.0, 0.0, -0.5]), np.eye(3) / 12.0)
        model.appendBodyToJoint(k + 1, rod, pin.SE3.Identity())
    scene = core_scene(model)
    ends = []
    for islands in (True, False):
        simulator = engine.simulator(scene, 1e-3, islands=islands)
        simulator.reset(np.zeros(2), np.zeros(2))
        ends.append(simulator.advance(8500, record_every=8500)["q"][-1])
    assert np.abs(ends[1]).max() > 1.0
    assert np.abs(ends[0] - ends[1]).max() <= 1e-9


def test_a_blow_a_force_and_a_load_wake_it():
    """Beside a run that solves every step: rest within 1e-15 m a step, then the same events."""
    scene = resting_boxes(3)
    scene.add_sphere("ball", 0.05, placement=at(0.02, 0.01, 0.35))
    scene.set_contact(restitution=0.0, friction=0.5)
    results = []
    for islands in (True, False):
        simulator = engine.simulator(scene.core(), 1e-3, islands=islands)
        simulator.reset(scene.neutral(), np.zeros(scene.nv))
        falls = simulator.advance(300)
        force = np.zeros((40, scene.nv))
        force[:, 6 * 2] = 1.2 * 0.5 * 9.81 * scene.model.inertias[3].mass  # pushes the third box
        pushed = simulator.advance(40, force)
        assert falls["code"] == pushed["code"] == 0
        results.append((falls, pushed))
    (falls, pushed), (falls_too, pushed_too) = results
    assert len(falls["events"]["time"]) > 0
    assert np.abs(falls["events"]["time"][0] - falls_too["events"]["time"][0]) <= 1e-12
    third = columns(scene, ["box2"])[:3]
    assert np.abs(pushed["q"][-1, third] - pushed_too["q"][-1, third]).max() <= 1e-11
    assert pushed["q"][-1, third[0]] - pushed["q"][0, third[0]] > 5e-4


def test_a_snapshot_of_islands_at_rest_goes_on_to_the_bit():
    scene = resting_boxes()
    _, simulator = run(scene, np.zeros(scene.nv), 1e-3, 50)
    kept = simulator.save()
    first = simulator.advance(10)
    other = engine.simulator(scene.core(), 1e-3)
    other.load(kept)
    again = other.advance(10)
    assert again["stats"]["contact_steps"] == first["stats"]["contact_steps"]
    for name in ("q", "p"):
        assert same_bits(first[name], again[name])
    for name in ("start", "end", "position"):
        assert same_bits(contacts_of(first, scene)[name], contacts_of(again, scene)[name])
