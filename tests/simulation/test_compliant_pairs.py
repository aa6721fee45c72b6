"""Compliant pairs: forces by the depth of an overlap, beside rigid contact, against closed forms and DOP853."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.special import beta

import contactvi as cvi
from contactvi.scene.engine import static_trees
from helpers.compliant_scenes import MASS, RADIUS, ball, table
from oracles import compliant_contact

# Steps of 0.9 s for each order, in which the ball touches twice.
STEPS = {2: (2000, 4000, 8000), 4: (1000, 2000, 4000), 8: (200, 400, 800)}
LAWS = {
    "linear": {"stiffness": 1000.0},
    "hertz": {"stiffness": 1e5, "exponent": 1.5},
    "quadratic": {"stiffness": 1e5, "exponent": 2.0},
    "damped": {"stiffness": 1000.0, "damping": 0.3},
    "damped hertz": {"stiffness": 1e5, "exponent": 1.5, "damping": 0.3},
}
DURATION, HEIGHT = 0.9, 0.1
ORACLE = 1e-11
TOLD = {2: 2e-4, 4: 1e-6, 8: 1e-9}


def dropped(law: dict[str, float]) -> tuple[float, float, int]:
    """Return height and speed of the ball after DURATION by the oracle, and how often it has touched and left."""
    numbers = (MASS, law["stiffness"], law.get("exponent", 1.0), law.get("damping", 0.0))
    z, v = compliant_contact.position(DURATION, HEIGHT, *numbers)
    times = [t for touch, release, _, _ in compliant_contact.drops(HEIGHT, *numbers) for t in (touch, release)]
    assert times[-1] > DURATION
    return z, v, sum(t < DURATION for t in times)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("order", STEPS)
def test_a_ball_that_drops_keeps_the_order(name, order):
    """Some bounces: the height of the ball after them, its speed, and how often it touches and leaves.

    Where in their steps the openings lie changes with the number of steps: that may take .7 of the order.
    """
    law = LAWS[name]
    z, v, changes = dropped(law)
    scene = ball(HEIGHT, **law)
    errors = []
    for steps in STEPS[order]:
        traj = cvi.simulate(scene, None, None, DURATION, dt=DURATION / steps, order=order)
        assert traj.stats.switches == changes >= 4
        assert len(traj.events) == 0
        errors.append(max(abs(traj.q[-1, 2] - RADIUS - z), abs(traj.v[-1, 2] - v)))
    assert errors[-1] <= TOLD[order]
    for n, error in zip(STEPS[order][1:], errors[1:], strict=True):
        assert error <= max(ORACLE, errors[0] * (STEPS[order][0] / n) ** (order - 0.7))


@pytest.mark.parametrize("order", [2, 4, 8, 16])
def test_the_deepest_overlap_and_the_time_of_a_linear_contact(order):
    """Without gravity: half a period of the spring, v / omega deep."""
    k, v = 1000.0, 0.7
    omega = np.sqrt(k / MASS)
    scene = ball(0.07, gravity=0.0, stiffness=k)
    traj = cvi.simulate(scene, None, scene.velocity({"ball": (0.0, 0.0, -v)}), 0.25, dt=1e-4, order=order)
    found = traj.compliant_contacts()
    assert found.depth.max() == pytest.approx(v / omega, rel=1e-5)  # nodes are at most half a step from it
    exact = (0.25 - 0.1 - np.pi / omega) * v  # after the contact it flies at its speed
    assert traj.q[-1, 2] - RADIUS == pytest.approx(exact, rel={2: 2e-4, 4: 1e-7}.get(order, 1e-10))
    assert traj.v[-1, 2] == pytest.approx(v, rel=1e-11)
    assert np.all(found.normal_force > 0.0)
    assert found.normal_force == pytest.approx(k * found.depth, rel=1e-12)
    assert found.pairs == (("ball", "ground"),) or found.pairs == (("ground", "ball"),)


def test_hertz_contact_of_two_balls_has_its_time_and_its_depth():
    """One of two free balls at rest, reduced mass m: D = (5 m v^2 / (4 k))^(2/5) and T = .8 B(2/5, 1/2) D / v."""
    k, v, m = 1e6, 0.4, MASS * 0.3 / (MASS + 0.3)
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_sphere("one", 0.05, MASS, placement=(-0.06, 0.0, 0.0))
    scene.add_sphere("two", 0.03, 0.3, placement=(0.03, 0.0, 0.0))
    scene.set_compliance("one", "two", stiffness=k, exponent=1.5)
    deepest = (5.0 * m * v**2 / (4.0 * k)) ** 0.4
    time = 0.8 * beta(0.4, 0.5) * deepest / v
    speed = scene.velocity({"one": (v, 0.0, 0.0)})
    traj = cvi.simulate(scene, None, speed, 0.05, dt=2e-4, order=8)
    found = traj.compliant_contacts()
    assert found.depth.max() == pytest.approx(deepest, rel=5e-3)
    one, two = v * (MASS - 0.3) / (MASS + 0.3), 2.0 * MASS / (MASS + 0.3) * v
    assert traj.v[-1, [0, 6]] == pytest.approx([one, two], rel=1e-9)
    # The gap was 0.01 m: together they have moved by its closing, the contact and the flights after it.
    after = 0.05 - 0.01 / v - time
    assert traj.q[-1, 7] - traj.q[-1, 0] - 0.08 == pytest.approx((two - one) * after, abs=1e-9)
    momentum = MASS * traj.v[:, 0] + 0.3 * traj.v[:, 6]
    assert np.ptp(momentum) <= 1e-12


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize(("c", "v"), [(0.2, 0.5), (1.0, 1.0)])
def test_the_restitution_of_hunt_and_crossley(exponent, c, v):
    scene = ball(0.0103, gravity=0.0, stiffness=2000.0, exponent=exponent, damping=c)
    traj = cvi.simulate(scene, None, scene.velocity({"ball": (0.0, 0.0, -v)}), 1.0, dt=1e-3, order=8)
    assert traj.stats.switches == 2
    assert traj.v[-1, 2] == pytest.approx(compliant_contact.restitution(v, c) * v, rel=1e-8)
    assert np.abs(traj.ledger.energy_balance).max() <= 1e-8


def test_a_table_rests_on_four_feet():
    """Its weight is the sum of the forces of the feet, each of which is m g / (4 k) deep."""
    mass, k = 2.0, 5e4
    scene = table(mass, stiffness=k, damping=20.0)
    traj = cvi.simulate(scene, None, None, 3.0, dt=1e-3, order=4)
    found = traj.compliant_contacts()
    last = found.node == found.node.max()
    assert last.sum() == 4
    assert found.normal_force[last].sum() == pytest.approx(mass * 9.81, rel=1e-6)
    start = table(mass, stiffness=k)
    q = start.q0.copy()
    q[2] -= mass * 9.81 / (4.0 * k)
    still = cvi.simulate(start, q, None, 1.0, dt=1e-3, order=4)
    assert np.abs(still.q - q).max() <= 1e-12


def test_a_table_slides_and_stops():
    """With speeds far above the slip speed it is braked by mu g, but for the sway of the feet."""
    mass, k, mu, v = 2.0, 1e6, 0.4, 1.0
    scene = table(mass, stiffness=k, damping=5.0, friction=mu, slip_speed=1e-4)
    q = scene.q0.copy()
    q[2] -= mass * 9.81 / (4.0 * k)
    traj = cvi.simulate(scene, q, scene.velocity({"table": (v, 0.0, 0.0)}), 0.6, dt=5e-4, order=4)
    distance = v**2 / (2.0 * mu * 9.81)
    assert traj.q[-1, 0] == pytest.approx(distance, rel=2e-3)
    assert abs(traj.v[-1, 0]) <= 1e-6
    assert np.abs(traj.ledger.energy_balance).max() <= 1e-4 * 0.5 * mass * v**2
    assert traj.work.damping[-1] == pytest.approx(0.5 * mass * v**2, rel=1e-3)
    found = traj.compliant_contacts()
    tangential = np.linalg.norm(found.force[:, :2], axis=1)
    assert np.all(tangential <= mu * found.normal_force * (1.0 + 1e-12))


def test_a_hundred_bounces_keep_the_energy_to_rounding():
    scene = ball(0.05, stiffness=2000.0)
    traj = cvi.simulate(scene, None, None, 32.0, dt=2e-3, order=8, solver_tol=1e-14)
    assert traj.stats.switches >= 200
    assert np.ptp(traj.energy) <= 1e-11 * traj.energy[0]  # some 1e-13 for each bounce, where it is located


@pytest.mark.parametrize("order", [2, 4, 8])
def test_a_very_stiff_pair_bounces_as_a_rigid_one(order):
    """1e8 N/m at a step of 1 ms, which is three times the duration of the contact: no step is halved for that."""
    scene = ball(0.1, stiffness=1e8)
    traj = cvi.simulate(scene, None, None, 1.0, dt=1e-3, order=order)
    assert traj.stats.stage_iterations <= 2 * 1000
    assert traj.energy == pytest.approx(traj.energy[0], rel=1e-9)
    rigid = cvi.Scene()
    rigid.add_halfspace()
    rigid.add_sphere("ball", RADIUS, MASS, placement=(0.0, 0.0, RADIUS + 0.1))
    rigid.set_contact(restitution=1.0)
    other = cvi.simulate(rigid, None, None, 1.0, dt=1e-3, order=order)
    assert np.abs(traj.q[:, 2] - other.q[:, 2]).max() <= 2e-2


def test_it_converges_to_the_rigid_bounce():
    """The delay of each bounce is the duration of the contact, pi sqrt(m / k)."""
    rigid = cvi.Scene()
    rigid.add_halfspace()
    rigid.add_sphere("ball", RADIUS, MASS, placement=(0.0, 0.0, RADIUS + 0.1))
    rigid.set_contact(restitution=1.0)
    end = cvi.simulate(rigid, None, None, 0.4, dt=1e-3, order=8).q[-1, 2]
    errors = []
    for k in (1e4, 1e6, 1e8):
        errors.append(abs(cvi.simulate(ball(0.1, stiffness=k), None, None, 0.4, dt=1e-3, order=16).q[-1, 2] - end))
    assert errors[1] <= 0.15 * errors[0]
    assert errors[2] <= 0.15 * errors[1]
    assert errors[2] <= 1e-3


def test_beside_rigid_contact():
    """Of two balls on one ground the soft one bounces by its law and the rigid one by its restitution."""
    scene = ball(0.1, stiffness=1000.0)
    scene.add_sphere("other", RADIUS, MASS, placement=(1.0, 0.0, RADIUS + 0.1))
    scene.set_contact(restitution=0.5)
    traj = cvi.simulate(scene, None, None, DURATION, dt=1e-3, order=8)
    z, _, _ = dropped({"stiffness": 1000.0})
    assert traj.q[-1, 2] - RADIUS == pytest.approx(z, abs=1e-8)
    assert len(traj.events) > 0
    assert {tuple(sorted(pair)) for pair in scene.pair_names} == {("ball", "other"), ("ground", "other")}
    assert [tuple(sorted(pair)) for pair in scene.compliant_pairs] == [("ball", "ground")]


@pytest.mark.parametrize("law", [LAWS["linear"], LAWS["damped hertz"] | {"friction": 0.3}])
def test_a_stored_scene_has_the_same_bits(tmp_path, law):
    scene = ball(0.1, **law)
    v = scene.velocity({"ball": ((0.3, 0.0, 0.0), (0.0, 2.0, 0.0))})
    traj = cvi.simulate(scene, None, v, 0.4, dt=1e-3, order=4)
    again = cvi.simulate(cvi.Scene.from_dict(scene.to_dict()), None, v, 0.4, dt=1e-3, order=4)
    assert np.array_equal(traj.q, again.q)
    assert np.array_equal(traj.p, again.p)
    traj.save(tmp_path / "run.npz")
    loaded = cvi.Trajectory.load(tmp_path / "run.npz")
    assert loaded.scene.compliant_pairs == scene.compliant_pairs
    assert np.array_equal(loaded.compliant_contacts().force, traj.compliant_contacts().force)
    assert any(note.topic == "compliance" for note in scene.report.notes)


def test_auto_steps():
    law = LAWS["hertz"]
    z, _, _ = dropped(law)
    traj = cvi.simulate(ball(HEIGHT, **law), None, None, DURATION, dt="auto", tol=1e-8)
    assert traj.q[-1, 2] - RADIUS == pytest.approx(z, abs=1e-8)


def derivative_cases() -> dict[str, tuple[cvi.Scene, dict[str, tuple]]]:
    """Balls, feet and a capsule that bounce, slide and roll, on a plane, on a box and on each other."""
    rolling = {"stiffness": 5e3, "exponent": 1.5, "damping": 0.3, "friction": 0.4, "slip_speed": 0.05}
    law = {"stiffness": 2e4, "damping": 0.5, "friction": 0.3, "slip_speed": 0.05}
    two = cvi.Scene()
    two.add_box("floor", (1.0, 1.0, 0.1), free=False, placement=(0.0, 0.0, -0.05))
    two.add_capsule("rod", 0.03, 0.2, 0.5, placement=((0.0, 0.0, 0.2), (0.0, 1.4, 0.0)))
    two.add_sphere("ball", 0.04, 0.3, placement=(0.02, 0.01, 0.045))
    two.disable_pair("floor", "rod")
    two.set_compliance("ball", stiffness=4e3, damping=0.2, friction=0.3, slip_speed=0.05)
    return {
        "ball": (ball(0.02, **rolling), {"ball": ((0.3, 0.1, -0.2), (0.5, 2.0, -1.0))}),
        "table": (table(**law), {"table": ((0.2, 0.1, -0.3), (0.6, -0.4, 0.5))}),
        "rod": (two, {"ball": ((0.1, 0.0, -0.5), (0.0, 1.0, 0.0)), "rod": ((0.0, 0.0, -1.0), (0.1, 0.3, 0.2))}),
    }


CASES = derivative_cases()


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", [2, 4, 8])
@pytest.mark.parametrize("name", CASES)
def test_derivatives_are_those_of_differences(name, order):
    """The gradient of a sum of the last velocities, and the same by the tangent."""
    scene, speeds = CASES[name]
    q = (scene.neutral() if scene.q0 is None else scene.q0).copy()
    q[2] += 0.01 * (name == "table")
    v = scene.velocity(speeds, q)
    weights = np.linspace(0.5, 1.5, scene.nv)

    def run(dq: np.ndarray, dv: np.ndarray, **options) -> cvi.Trajectory:
        start = pin.integrate(scene.model, q, dq)
        return cvi.simulate(scene, start, v + dv, 0.12, dt=5e-4, order=order, solver_tol=1e-14, **options)

    none = np.zeros(scene.nv)
    traj = run(none, none, record="gradient")
    assert traj.stats.switches >= 1
    _, found = cvi.gradient(traj, (none, weights))
    # The lengths of the parts of steps that an opening cuts count as given, which is true to the order.
    close = {2: 5e-3, 4: 2e-4}.get(order, 1e-5) * float(max(np.abs(found["q0"]).max(), 1.0))
    step = 1e-5
    for key, place in (("q0", 0), ("v0", 1)):
        for k in range(scene.nv):
            direction = step * np.eye(scene.nv)[k]
            ends = [run(*((none,) * place), s * direction, *((none,) * (1 - place))).v[-1] for s in (1, -1, 2, -2)]
            change = 8.0 * (ends[0] - ends[1]) - (ends[2] - ends[3])
            assert found[key][k] == pytest.approx(weights @ change / (12.0 * step), abs=close)


def test_derivatives_through_many_switches_are_not_refused_and_second_ones_are():
    scene, speeds = CASES["ball"]
    traj = cvi.simulate(scene, None, scene.velocity(speeds), 0.3, dt=1e-3, order=4, record="gradient")
    _, found = cvi.gradient(traj, (np.zeros(6), np.ones(6)), ("q0", "v0", "mass:ball", "gravity"))
    assert all(np.isfinite(values).all() for values in found.values())
    arguments = traj, lambda t, q, v: (0.0, np.zeros(6), np.ones(6)), {"v0": np.ones(6)}
    options = {"hessp": lambda *_: (np.zeros((301, 6)),) * 2}
    with pytest.raises(cvi.NotDifferentiable, match="compliant pair"):
        cvi.hessian_vector(*arguments, method="exact", **options)
    assert cvi.hessian_vector(*arguments, method="gauss-newton", **options).approximate is not None


def test_islands_have_the_bits_of_what_they_are_alone():
    def balls(places: list[float]) -> cvi.Scene:
        scene = cvi.Scene()
        scene.add_halfspace()
        for x in places:
            scene.add_sphere(f"at{x:g}", 0.05, 0.5, placement=(x, 0.0, 0.06 + 0.03 * x))
        scene.set_compliance("ground", stiffness=2e4, damping=0.2, friction=0.3)
        return scene

    def run(places: list[float]) -> cvi.Trajectory:
        return cvi.simulate(balls(places), None, None, 0.5, dt=1e-3, order=4, dense=False)

    both, alone = run([0.0, 1.0]), run([1.0])
    assert np.array_equal(both.q[:, 7:], alone.q)
    assert both.work.damping[-1] > alone.work.damping[-1] > 0.0
    # With a compliant pair between them they are one.
    coupled = balls([0.0, 1.0])
    coupled.set_compliance("at0", "at1", stiffness=1e4)
    assert static_trees(coupled.core()).count == 1
    assert static_trees(balls([0.0, 1.0]).core()).count == 2


def test_a_batch_has_the_bits_of_single_runs():
    scene = ball(0.05, **LAWS["damped hertz"])
    v = np.array([scene.velocity({"ball": (0.0, 0.0, -s)}) for s in (0.1, 0.4, 0.7)])
    batch = cvi.simulate_batch(scene, [scene.neutral()] * 3, v, duration=0.3, dt=1e-3, order=2)
    for k in range(3):
        single = cvi.simulate(scene, None, v[k], 0.3, dt=1e-3, order=2)
        assert np.array_equal(batch.q[k], single.q)


def test_it_may_overlap_at_the_start_and_is_placed_on_the_ground():
    scene = ball(0.1, stiffness=1000.0)
    q = scene.place_on_ground("ball")
    assert q[2] == pytest.approx(RADIUS, abs=1e-12)
    q[2] -= 0.02
    traj = cvi.simulate(scene, q, None, 0.3, dt=1e-4, order=4)
    assert traj.potential_energy[0] == pytest.approx(MASS * 9.81 * (RADIUS - 0.02) + 500.0 * 0.02**2, rel=1e-12)
    scene.set_compliance("ball", "ground", stiffness=None)
    with pytest.raises(cvi.PenetrationError):
        cvi.simulate(scene, q, None, 0.3, dt=1e-4, order=4)


@pytest.mark.parametrize("shape", ["box", "capsule", "ellipsoid", "mesh"])
def test_shapes_fall_on_the_ground_and_come_to_rest(shape):
    """The energy balance closes, and in the end the forces carry the weight."""
    scene = cvi.Scene()
    scene.add_halfspace()
    place = ((0.0, 0.0, 0.2), (0.3, 0.2, 0.0))
    corners = np.array([[0.1, 0.0, -0.05], [-0.1, 0.1, -0.05], [-0.1, -0.1, -0.05], [0.0, 0.0, 0.1]])
    given = {"box": ((0.2, 0.1, 0.1),), "capsule": (0.05, 0.2), "ellipsoid": ((0.1, 0.06, 0.04),), "mesh": (corners,)}
    getattr(scene, f"add_{shape}")("body", *given[shape], 1.0, placement=place)
    scene.set_compliance("body", stiffness=1e4, damping=2.0, friction=0.5)
    scene.set_joint("body", damping=0.05)
    traj = cvi.simulate(scene, None, None, 4.0, dt=1e-3, order=4)
    assert np.abs(traj.ledger.energy_balance).max() <= 1e-5
    found = traj.compliant_contacts()
    last = found.node == found.node.max()
    assert found.force[last].sum(axis=0) * (1 if scene.compliant_pairs[0][0] == "ground" else -1) == pytest.approx(
        [0.0, 0.0, 9.81], abs=0.05
    )


TARGETS = {
    "box": lambda scene: scene.add_box("target", (0.2, 0.2, 0.2), free=False),
    "cylinder": lambda scene: scene.add_cylinder("target", 0.1, 0.2, free=False),
    "capsule": lambda scene: scene.add_capsule("target", 0.05, 0.2, free=False),
    "sphere": lambda scene: scene.add_sphere("target", 0.1, free=False),
    "mesh": lambda scene: scene.add_mesh(
        "target", np.array([[0.1, 0, 0], [-0.1, 0.1, 0], [-0.1, -0.1, 0], [0, 0, 0.2]]), free=False
    ),
}


@pytest.mark.parametrize("name", TARGETS)
def test_gaps_of_a_ball_are_those_of_the_rigid_pair(name):
    """At drawn places around each shape, over all of its features, to the noise of coal's distances."""
    rigid = cvi.Scene()
    TARGETS[name](rigid)
    rigid.add_sphere("ball", 0.03, placement=(1.0, 0.0, 0.0))
    soft = rigid.copy()
    soft.set_compliance("ball", "target", stiffness=1.0)
    draw = np.random.default_rng(3)
    for _ in range(300):
        q = rigid.configuration({"ball": tuple(draw.uniform(-0.25, 0.25, 3))})
        gap = float(np.asarray(rigid.core().gaps(q)[0])[0])
        if gap > -0.025:  # deeper the centre lies inside, where the way out is that through the nearest face
            assert soft.core().compliant_gaps(q)[0][1] == pytest.approx(gap, abs=1e-7)


def test_a_scene_file(tmp_path):
    file = tmp_path / "drop.toml"
    file.write_text(
        "[[halfspace]]\n[[sphere]]\nname = 'ball'\nradius = 0.05\nmass = 0.8\nxyz = [0, 0, 0.15]\n"
        "[[compliance]]\na = 'ball'\nb = 'ground'\nstiffness = 1000.0\ndamping = 0.3\n[run]\ndt = 1e-3\n"
    )
    scene = cvi.load_scene(file)
    other = ball(0.1, stiffness=1000.0, damping=0.3)
    ends = [cvi.simulate(x, None, None, 0.3, dt=1e-3).q[-1] for x in (scene, other)]
    assert np.array_equal(*ends)


@pytest.mark.parametrize(
    ("law", "name"),
    [
        ({"stiffness": 0.0}, "stiffness"),
        ({"stiffness": 1.0, "exponent": 0.5}, "exponent"),
        ({"stiffness": 1.0, "damping": -1.0}, "damping"),
        ({"stiffness": 1.0, "friction": -1.0}, "friction"),
        ({"stiffness": 1.0, "slip_speed": 0.0}, "slip_speed"),
    ],
)
def test_bad_numbers_are_refused(law, name):
    with pytest.raises(cvi.InputError, match=name):
        ball(0.1, **law)


def test_shapes_whose_nearest_points_jump_are_refused():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("one", (1.0, 1.0, 1.0), placement=(0.0, 0.0, 2.0))
    scene.add_box("two", (1.0, 1.0, 1.0), placement=(0.0, 0.0, 4.0))
    scene.set_compliance("one", "two", stiffness=1e5)
    with pytest.raises(cvi.EngineError, match="nearest may jump"):
        scene.core()
