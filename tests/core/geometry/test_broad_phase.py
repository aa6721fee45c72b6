"""The broad phase against brute force: no pair that is left out may touch, and a start looks at few pairs exactly."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import _core

FEW_PAIRS = 64  # core/geometry/broad_phase.cpp
LOOKS = np.linspace(0.0, 1.0, 7)  # fractions of a step at which all gaps are evaluated


def arm(links: int) -> pin.Model:
    """A chain of long thin links that turn about different axes, with a capsule along each."""
    model = pin.Model()
    parent, place = 0, pin.SE3.Identity()
    for k in range(links):
        kind = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())[k % 3]
        parent = model.addJoint(parent, kind, place, f"turn{k}")
        inertia = pin.Inertia.FromCylinder(1.0, 0.03, 0.8)
        model.appendBodyToJoint(parent, inertia, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4])))
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.8]))
    return model


def arm_geometry(model: pin.Model) -> pin.GeometryModel:
    import coal

    geometry = pin.GeometryModel()
    for k in range(1, model.njoints):
        middle = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.4]))
        geometry.addGeometryObject(pin.GeometryObject(f"link{k}", k, middle, coal.Capsule(0.03, 0.6)))
    for i in range(model.njoints - 1):
        for j in range(i + 2, model.njoints - 1):
            geometry.addCollisionPair(pin.CollisionPair(i, j))
    return geometry


def drawn_scene(rng: np.random.Generator, bodies: int, links: int = 0) -> cvi.Scene:
    """Free bodies of all kinds on a ground, with fixed ones among them and perhaps a long arm."""
    model = arm(links)
    scene = cvi.Scene.from_pinocchio(model, arm_geometry(model)) if links else cvi.Scene()
    scene.add_halfspace()
    for k in range(bodies):
        size = rng.uniform(0.05, 0.3, 3)
        free = bool(rng.random() < 0.85)
        match k % 4:
            case 0:
                scene.add_box(f"body{k}", size, free=free)
            case 1:
                scene.add_sphere(f"body{k}", size[0], free=free)
            case 2:
                scene.add_capsule(f"body{k}", size[0], size[1], free=free)
            case _:
                scene.add_cylinder(f"body{k}", size[0], size[1], free=free)
    return scene


def velocities(scene: cvi.Scene, rng: np.random.Generator, speed: float, spin: float) -> np.ndarray:
    """Of the engine: world axes for the linear part of a free body."""
    v = np.zeros(scene.nv)
    for joint in scene.model.joints:
        if joint.nv == 6:
            v[joint.idx_v : joint.idx_v + 6] = [*rng.normal(0.0, speed, 3), *rng.normal(0.0, spin, 3)]
        else:
            v[joint.idx_v : joint.idx_v + joint.nv] = rng.normal(0.0, spin, joint.nv)
    return v


def moved(scene: cvi.Scene, q: np.ndarray, v: np.ndarray, time: float) -> np.ndarray:
    """Translations at constant velocity along the world's axes, turns at constant velocity about the body's axes."""
    result = pin.integrate(scene.model, q, time * v)
    for joint in scene.model.joints:
        if joint.nv == 6:
            result[joint.idx_q : joint.idx_q + 3] = (
                q[joint.idx_q : joint.idx_q + 3] + time * v[joint.idx_v : joint.idx_v + 3]
            )
    return result


def bound_of(scene: cvi.Scene, v: np.ndarray) -> np.ndarray:
    """Per dof its speed, and for turns in space the speed of the whole vector."""
    bound = np.abs(v)
    for joint in scene.model.joints:
        if joint.nv == 6:
            bound[joint.idx_v + 3 : joint.idx_v + 6] = np.linalg.norm(v[joint.idx_v + 3 : joint.idx_v + 6])
    return bound


def placed(scene: cvi.Scene, rng: np.random.Generator, room: float) -> np.ndarray:
    q = pin.randomConfiguration(scene.model, -np.ones(scene.nq), np.ones(scene.nq))
    for joint in scene.model.joints:
        if joint.nv == 6:
            turn = rng.normal(size=4)
            q[joint.idx_q : joint.idx_q + 3] = rng.uniform(-room, room, 3) + [0.0, 0.0, room]
            q[joint.idx_q + 3 : joint.idx_q + 7] = turn / np.linalg.norm(turn)
    return q


@pytest.mark.thinned(4)
@pytest.mark.parametrize("bodies", [7, 12])  # few pairs, which are looked at one by one, and many
@pytest.mark.parametrize("spans", [False, True])
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("h", "speed", "spin"), [(1e-3, 2.0, 5.0), (1e-3, 30.0, 100.0), (0.05, 5.0, 20.0)])
def test_pairs_left_out_do_not_touch(seed: int, h: float, speed: float, spin: float, spans: bool, bodies: int):
    """All gaps at many places of many steps, some of which are cut: those of pairs left out stay open, and are larger
    at the end of the step than the motion of the two bodies in it."""
    rng = np.random.default_rng([seed, int(1e4 * h), int(speed)])
    pin.seed(seed)
    scene = drawn_scene(rng, bodies, links=6 if seed % 2 and bodies > 7 else 0)
    core = scene.core()
    assert (core.npairs <= FEW_PAIRS) == (bodies == 7)
    q, v = placed(scene, rng, 2.0 if bodies > 7 else 1.5), velocities(scene, rng, speed, spin)
    start, end, bound, looks = [], [], [], []
    for _ in range(60):
        if rng.random() < 0.1:
            v = velocities(scene, rng, speed * rng.random(), spin * rng.random())
        slower = rng.uniform(0.5, 1.0)  # than the bound
        start.append(q)
        end.append(moved(scene, q, slower * v, h))
        bound.append(bound_of(scene, v))
        looks.append([core.gaps(moved(scene, q, slower * v, x * h))[0] for x in LOOKS])
        q = end[-1] if rng.random() < 0.8 else moved(scene, q, slower * v, rng.random() * h)
    steps = _core.near_pairs(core, np.array(start), np.array(end), np.array(bound), h, spans)
    left_out = 0
    for (near, motion, _), gaps in zip(steps, np.array(looks), strict=True):
        assert all(a < b for a, b in pairwise(near))
        far = np.setdiff1d(np.arange(core.npairs), near)
        left_out += len(far)
        assert np.all(gaps[:, far] > 0.0)
        assert np.all(gaps[-1, far] > motion[far])
    assert left_out > 0.2 * len(steps) * core.npairs or h > 0.01


def slides(links: int = 3) -> tuple[pin.Model, pin.GeometryModel]:
    """An arm on a turntable whose links slide out of each other, and a ball in the world: motion lengthens arms."""
    import coal

    model, geometry = pin.Model(), pin.GeometryModel()
    parent = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    for k in range(links):
        parent = model.addJoint(parent, pin.JointModelPX(), pin.SE3.Identity(), f"slide{k}")
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        geometry.addGeometryObject(pin.GeometryObject(f"tip{k}", parent, pin.SE3.Identity(), coal.Sphere(0.05)))
    place = pin.SE3(np.eye(3), np.array([0.0, 1.5, 0.0]))
    ball = geometry.addGeometryObject(pin.GeometryObject("ball", 0, place, coal.Sphere(0.2)))
    for k in range(links):
        geometry.addCollisionPair(pin.CollisionPair(k, ball))
    return model, geometry


@pytest.mark.parametrize("seed", range(40))
def test_clear_spans_end_before_a_pair_comes_near(seed: int):
    """Speeds that change all the time, from rest too, of sliding and turning joints: passed steps are clear for sure.

    Many steps have to be passed, or there would be nothing to see.
    """
    rng = np.random.default_rng(seed)
    scene = cvi.Scene.from_pinocchio(*slides())
    core, h = scene.core(), 1e-2
    q, v = np.array([rng.uniform(-3.0, 0.5), *rng.uniform(0.1, 0.3, 3)]), np.zeros(4)
    start, end, bound = [], [], []
    for _ in range(150):
        new = 0.9 * v + rng.normal(size=4) * [0.3, 0.1, 0.1, 0.1]
        start.append(q)
        bound.append(np.maximum(np.abs(v), np.abs(new)))
        q, v = q + 0.5 * h * (v + new), new
        end.append(q)
    arguments = core, np.array(start), np.array(end), np.array(bound), h
    steps, one_by_one = _core.near_pairs(*arguments, True), _core.near_pairs(*arguments, False)
    for k, (near, motion, _) in enumerate(steps):
        far = np.setdiff1d(np.arange(core.npairs), near)
        gaps = np.array([core.gaps(start[k] + x * (end[k] - start[k]))[0] for x in LOOKS])
        assert np.all(gaps[:, far] > 0.0)
        assert np.all(gaps[-1, far] > motion[far])
    assert sum(len(near) for near, *_ in steps) <= sum(len(near) for near, *_ in one_by_one)
    assert sum(not looks for *_, looks in steps) > 50


# How many steps of equal motion lie between two looks at least, where no pair is near: after a look every box has half
# of its room left, that of 32 such steps, of which two are kept, and a step of the span counts as 1/1.25 or less.
BETWEEN_LOOKS = int((0.5 * 32 - 2) / 1.25)


def steps_with_a_look(scene: cvi.Scene, v: np.ndarray, h: float, count: int) -> np.ndarray:
    """Numbers of the steps that look at guards, of a motion with constant velocity v (nv,) from the neutral place."""
    places = [moved(scene, np.asarray(scene.neutral()), v, k * h) for k in range(count + 1)]
    bounds = np.tile(bound_of(scene, v), (count, 1))
    steps = _core.near_pairs(scene.core(), np.array(places[:-1]), np.array(places[1:]), bounds, h, True)
    return np.flatnonzero([looks for *_, looks in steps])


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("bodies", [8, 16])
def test_bodies_of_all_speeds_are_looked_at_together(seed: int, bodies: int):
    """Boxes in a row, far apart, whose boxes are used up at different times: none ends a span soon after another."""
    rng = np.random.default_rng(seed)
    scene, v = cvi.Scene(gravity=(0.0, 0.0, 0.0)), []
    for k in range(bodies):
        size = rng.uniform(0.05, 0.2, 3)
        scene.add_box(f"box{k}", size, placement=(100.0 * k, 0.0, 0.0))
        v += [0.0, rng.uniform(0.05, 3.0) * np.linalg.norm(size), 0.0, 0.0, 0.0, 0.0]
    looks = steps_with_a_look(scene, np.array(v), 1e-2, 400)
    assert 2 < len(looks) < 400 / BETWEEN_LOOKS
    assert np.diff(looks).min() >= BETWEEN_LOOKS


def test_a_short_bound_on_a_distance_gives_way_to_the_distance():
    """Thin rods side by side, near enough for their fat boxes to meet: their balls are 6 cm apart, which would allow a
    step or two of 3.4 cm, they themselves 1 m."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    for k in range(2):
        scene.add_box(f"rod{k}", (0.02, 0.02, 1.0), placement=(1.06 * k, 0.0, 0.0))
    v = np.zeros(scene.nv)
    v[[1, 7]] = 1.7  # m/s along y, both; the bounds know no directions
    looks = steps_with_a_look(scene, v, 1e-2, 60)
    assert np.diff(looks).min() >= BETWEEN_LOOKS


def chain_of(model: pin.Model, joint: int) -> list[int]:
    return [joint, *chain_of(model, model.parents[joint])] if joint > 0 else []


def branched_arm(rng: np.random.Generator, links: int) -> pin.Model:
    """Links that hang on earlier ones, by joints that turn or slide."""
    model = pin.Model()
    for k in range(links):
        parent = int(rng.choice([0, *chain_of(model, k)]))  # depth first
        kinds = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ(), pin.JointModelPX(), pin.JointModelPZ())
        place = pin.SE3(pin.exp3(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.5, 0.5, 3))
        joint = model.addJoint(parent, kinds[rng.integers(len(kinds))], place, f"joint{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    return model


@pytest.mark.parametrize("seed", range(12))
def test_what_moves_both_links_of_a_pair_does_not_count(seed: int):
    """No gap changes by more than the bound on the motion of its pair, and the joints that carry both links of a pair
    alone give a bound of zero."""
    rng = np.random.default_rng(seed)
    links, h = 9, 0.05
    model = branched_arm(rng, links)
    scene = cvi.Scene.from_pinocchio(model, arm_geometry(model))
    q0, v = rng.uniform(-1.0, 1.0, links), rng.uniform(-2.0, 2.0, links) * (rng.random(links) < 0.7)
    core = scene.core()

    def motion(bound: np.ndarray) -> np.ndarray:
        return np.asarray(_core.near_pairs(core, q0[None], (q0 + h * v)[None], bound[None], h)[0][1])

    change = np.abs(np.asarray(core.gaps(q0 + h * v)[0]) - np.asarray(core.gaps(q0)[0]))
    assert (change[: len(scene.pair_names)] <= motion(np.abs(v)) + 1e-12).all()
    for k, pair in enumerate(scene.collision_model.collisionPairs):
        i, j = pair.first, pair.second
        both = set(chain_of(model, i + 1)) & set(chain_of(model, j + 1))
        one = set(chain_of(model, i + 1)) ^ set(chain_of(model, j + 1))
        carries = np.zeros(links)
        carries[[joint - 1 for joint in both]] = 1.0
        assert motion(carries)[k] <= 1e-12
        moves = np.zeros(links)
        moves[[joint - 1 for joint in one]] = 1.0
        assert motion(moves)[k] > 0.0


def cloud(n: int, distance: float = 0.25) -> tuple[cvi.Scene, np.ndarray]:
    """n spheres of radius 0.1 m on a grid above the ground."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_halfspace()
    side = int(np.ceil(n ** (1.0 / 3.0)))
    for k in range(n):
        where = distance * np.array([k % side, k // side % side, k // side**2]) + [0.0, 0.0, 0.2]
        scene.add_sphere(f"ball{k}", 0.1, placement=where)
    return scene, np.asarray(scene.neutral())


def engine(scene: cvi.Scene) -> _core.Simulator:
    options = _core.SimulatorOptions()
    options.dt, options.tol = 1e-3, 1e-12
    return _core.Simulator(scene.core(), options)


def evaluated(simulator: _core.Simulator) -> int:
    return int(simulator.advance(0)["stats"]["guards_evaluated"])


def test_a_start_evaluates_only_what_meets():
    """64 spheres apart from each other: none of the 2080 pairs is evaluated; two that touch: theirs."""
    scene, q = cloud(64)
    simulator = engine(scene)
    assert simulator.reset(q, np.zeros(scene.nv), 0.0)["code"] == _core.StatusCode.SUCCESS
    assert evaluated(simulator) == 0
    q[0] += 0.05  # 0.2 m from the next: they touch
    assert simulator.reset(q, np.zeros(scene.nv), 0.0)["code"] == _core.StatusCode.SUCCESS
    assert 1 <= evaluated(simulator) <= 8  # the one pair, a few times


def test_a_robot_of_meshes_starts_without_their_distances():
    """Of solo12, 2 m above the ground: its 24 joint limits, and none of its 129 pairs of hulls and with the ground."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_urdf("example-robot-data://robots/solo_description/robots/solo12.urdf", base="free", placement=(0, 0, 2))
    simulator = engine(scene)
    status = simulator.reset(np.asarray(scene.neutral()), np.zeros(scene.nv), 0.0)
    assert status["code"] == _core.StatusCode.SUCCESS
    assert evaluated(simulator) == 24


@pytest.mark.parametrize("seed", range(12))
def test_a_start_in_penetration_is_found_as_by_brute_force(seed: int):
    """The first pair in penetration, with its depth, or none."""
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    scene = drawn_scene(rng, bodies=10)
    core = scene.core()
    q = placed(scene, rng, rng.uniform(0.3, 3.0))
    gap = core.gaps(q)[0]
    deep = np.flatnonzero(gap < -1e-8)
    status = engine(scene).reset(q, np.zeros(scene.nv), 0.0)
    assert (status["code"] == _core.StatusCode.PENETRATION) == (len(deep) > 0)
    if len(deep):
        assert status["guard_index"] == deep[0]
        assert status["depth"] == -gap[deep[0]]


@pytest.mark.parametrize("dt", [1e-3, 0.05])
def test_fast_elastic_balls_meet_when_they_should(dt: float):
    """27 balls at 10 m/s between six walls, with steps in which a ball flies through half of the box: no two overlap at
    any node, and what an impact must keep is kept. A missed impact would show as an overlap or an open end."""
    rng = np.random.default_rng(3)
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    half = 0.6
    for axis in range(3):
        for sign in (1.0, -1.0):
            scene.add_halfspace(sign * np.eye(3)[axis], -half, name=f"wall{axis}{sign}")
    for k in range(27):
        where = 0.35 * (np.array([k % 3, k // 3 % 3, k // 9]) - 1.0) + rng.uniform(-0.02, 0.02, 3)
        scene.add_sphere(f"ball{k}", 0.05, placement=where)
    scene.set_contact(restitution=1.0, friction=0.0)
    v0 = np.zeros(scene.nv)
    v0.reshape(27, 6)[:, :3] = rng.normal(0.0, 6.0, (27, 3))
    traj = cvi.simulate(scene, None, v0, 0.2, dt)
    assert traj.status.ok
    assert len(traj.events) > 30
    core = scene.core()
    assert min(core.gaps(q)[0].min() for q in traj.q) > -1e-9
    assert np.ptp(traj.energy) < 1e-11 * traj.energy[0]


@pytest.mark.long
def test_a_thousand_spheres_take_little_memory():
    """505 500 pairs: a simulator and its first step take less than 60 MB on top of the scene."""
    program = """
        import sys
        from pathlib import Path
        sys.path[:0] = [{tests!r}, {root!r}]
        import numpy as np
        from core.geometry.test_broad_phase import cloud, engine

        def resident():
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            return 4096 * pages / 1e6

        scene, q = cloud(1000)
        core = scene.core()
        before = resident()
        simulator = engine(scene)
        simulator.reset(q, np.zeros(scene.nv), 0.0)
        simulator.advance(3)
        print(core.npairs, resident() - before)
    """
    tests = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", ".."))
    code = textwrap.dedent(program).format(tests=tests, root=os.path.dirname(tests))
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=True)
    pairs, taken = done.stdout.split()
    assert int(pairs) == 500500
    assert float(taken) < 60.0
