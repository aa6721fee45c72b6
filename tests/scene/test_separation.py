"""Starts in penetration that are moved apart: by the least, within limits and on constraints, with a report."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import minimize

import contactvi as cvi
from contactvi.scene.separation import ACCEPTED

MODELS = Path(__file__).resolve().parents[2] / "models"
ROBOTS = "example-robot-data://robots/"
SUNK = 0.005  # [m]


def box_in_the_floor(depth: float = 0.002, tilt: float = 0.0) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), placement=((0, 0, 0.05 - depth), (tilt, 0.5 * tilt, 0)))
    return scene


def metric(scene: cvi.Scene, q0: np.ndarray, q: np.ndarray) -> float:
    """1/2 d^T M d."""
    d = pin.difference(scene.model, q0, q)
    return 0.5 * float(d @ scene.mass_matrix(q0) @ d)


def assert_starts(scene: cvi.Scene, found: cvi.Separation) -> None:
    assert scene.gaps(found.q).min() >= -ACCEPTED
    assert found.after <= ACCEPTED
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        assert cvi.simulate(scene, found.q, duration=2e-3, dt=1e-3, throw=False).status.ok


def test_a_box_moves_straight_up():
    scene = box_in_the_floor()
    found = scene.separate()
    np.testing.assert_allclose(found.q, [0, 0, 0.05, 0, 0, 0, 1], atol=1e-15)
    assert [move.body for move in found.moves] == ["box"]
    assert found.largest == pytest.approx(0.002, rel=1e-9)
    assert found.moves[0].angle < 1e-12
    assert found.overlaps == {("ground", "box"): pytest.approx(0.002)}
    assert found.before == pytest.approx(0.002)
    assert repr(found) == "<Separation: 'ground' and 'box' (0.002 deep); moved 'box' by 2 mm>"
    assert_starts(scene, found)
    np.testing.assert_array_equal(scene.neutral(), scene.configuration({}))  # the scene stays as it is


def test_what_has_no_overlaps_stays_to_the_bit():
    scene = box_in_the_floor(-0.01)
    found = scene.separate()
    np.testing.assert_array_equal(found.q, scene.neutral())
    assert found.moves == ()
    assert found.iterations == 0
    assert "nothing overlaps" in repr(found)


@pytest.mark.parametrize("tilt", [0.01, 0.03])
def test_a_tilted_box_moves_by_the_least(tilt):
    """Of height and angles, all four corners above the floor: against a general solver, from the exact corners."""
    scene = box_in_the_floor(0.001, tilt)
    q0, model = scene.neutral(), scene.model
    found = scene.separate()
    assert_starts(scene, found)
    corners = np.array([[x, y, -0.05] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])

    def heights(d):
        place = pin.XYZQUATToSE3(pin.integrate(model, q0, d))
        return corners @ place.rotation[2] + place.translation[2]

    M = scene.mass_matrix(q0)
    scale = 1e3  # of metres; the solver stops at absolute changes
    best = minimize(
        lambda x: 0.5 * x @ M @ x, np.zeros(6), jac=lambda x: M @ x,
        constraints={"type": "ineq", "fun": lambda x: scale * heights(x / scale)},
        method="SLSQP", options={"ftol": 1e-14, "maxiter": 500},
    )  # fmt: skip
    assert metric(scene, q0, found.q) == pytest.approx(best.fun / scale**2, rel=1e-3)


def test_two_balls_move_by_their_masses():
    """Along the line between them, each by the share of the other's mass."""
    scene = cvi.Scene(gravity=(0, 0, 0))
    scene.add_sphere("a", 0.1, 1.0)
    scene.add_sphere("b", 0.1, 3.0, placement=(0.12, 0.156, 0))
    gap = scene.gaps(scene.neutral())[0]
    found = scene.separate()
    line = np.array([0.12, 0.156, 0]) / np.hypot(0.12, 0.156)
    np.testing.assert_allclose(found.q[:3], 0.75 * gap * line, atol=1e-12)
    np.testing.assert_allclose(found.q[7:10], [0.12, 0.156, 0] - 0.25 * gap * line, atol=1e-12)
    assert scene.gaps(found.q)[0] == pytest.approx(0.0, abs=1e-12)


def test_a_pile_of_balls():
    scene, random = cvi.Scene(), np.random.default_rng(0)
    scene.add_halfspace()
    for k in range(20):
        place = 0.0975 * np.array([k % 3, k // 3 % 3, k // 9 + 0.5]) + 0.001 * random.standard_normal(3)
        scene.add_sphere(f"ball{k}", 0.05, placement=place)
    assert np.sum(scene.gaps(scene.neutral()) < 0.0) > 20
    found = scene.separate(limit=0.02)
    assert_starts(scene, found)
    assert found.largest < 0.02
    assert len(found.moves) > 10
    with pytest.raises(cvi.SeparationError, match=r"at most 0.001 m.* give limit="):
        scene.separate(limit=1e-3)


FEET = ("solo_description/robots/solo12", "go2_description/urdf/go2", "icub_description/robots/icub_reduced")


@pytest.mark.parametrize("robot", FEET)
def test_feet_in_the_floor(robot):
    """The base goes up, joints stay as they are to the bit."""
    scene = cvi.Scene()
    handle = scene.add_urdf(f"{ROBOTS}{robot}.urdf", base="free")
    scene.add_halfspace()
    q = scene.place_on_ground(handle)
    q[2] -= SUNK
    found = scene.separate(q)
    np.testing.assert_array_equal(found.q[7:], q[7:])
    assert SUNK <= found.largest < 1.2 * SUNK
    assert_starts(scene, found)


def test_fingers_that_overlap_turn_within_their_limits():
    scene = cvi.Scene()
    scene.add_urdf(ROBOTS + "allegro_hand_description/urdf/allegro_right_hand.urdf")
    model, random = scene.model, np.random.default_rng(1)
    low, high, tried = model.lowerPositionLimit, model.upperPositionLimit, 0
    while tried < 5:
        q = random.uniform(low, high)
        if not -0.003 < scene.gaps(q).min() < -1e-4:
            continue
        tried += 1
        found = scene.separate(q, limit=0.03)  # the tips move ten times as far as two links overlap at their edges
        assert np.all((found.q >= low) & (found.q <= high))
        assert_starts(scene, found)
    beyond = scene.neutral()
    beyond[0] = high[0] + 0.02
    found = scene.separate(beyond)
    assert found.q[0] == pytest.approx(high[0], abs=1e-12)
    np.testing.assert_array_equal(found.q[4:], beyond[4:])  # those of the other fingers
    assert list(found.overlaps) == [("joint_0.0", "upper limit")]


def loop() -> cvi.Scene:
    """A four-bar linkage beside a ball."""
    scene = cvi.load_scene(MODELS / "four_bar_striker.toml")
    scene.remove("motor")
    scene.remove("string")
    scene.v0 = None
    return scene


def test_a_linkage_stays_closed():
    scene = loop()
    q = scene.assemble(scene.q0)
    ball = scene.q_index("ball")
    center = q[ball][:3].copy()
    towards = scene.contact_jacobian(q, margin=1.0).contacts[0].normal  # from the coupler to the ball
    q[ball.start : ball.start + 3] = center - (scene.gaps(q)[0] + 0.003) * towards
    assert scene.gaps(q)[0] < -0.002
    for fixed in ((), "ball"):
        found = scene.separate(q, fixed=fixed)
        assert scene.gaps(found.q)[0] == pytest.approx(0.0, abs=ACCEPTED)
        np.testing.assert_allclose(scene.assemble(found.q), found.q, atol=1e-9)  # on the constraints already
        assert_starts(scene, found)
    np.testing.assert_array_equal(found.q[ball], q[ball])


def test_refusals_say_why_and_what_to_do():
    scene = box_in_the_floor(0.03)
    with pytest.raises(cvi.SeparationError, match="'box' would have to be moved by 0.03 m") as error:
        scene.separate()
    assert error.value.pair == ("ground", "box")
    assert error.value.depth == pytest.approx(0.03)
    assert error.value.moves[0].body == "box"
    assert "limit=0.04" in error.value.remedy or "limit=0.03" in error.value.remedy
    assert_starts(scene, scene.separate(limit=0.031))
    between = cvi.Scene()
    between.add_halfspace((0, 0, 1), 0.0, name="below")
    between.add_halfspace((0, 0, -1), -0.19, name="above")
    between.add_sphere("ball", 0.1, placement=(0, 0, 0.095))
    with pytest.raises(cvi.SeparationError, match="cannot be ended") as error:
        between.separate()
    assert "0.005 m or rad left" in error.value.got
    deep = cvi.Scene()
    deep.add_sphere("a", 0.1)
    deep.add_sphere("b", 0.01, placement=(0, 0, 0.1))
    with pytest.raises(cvi.SeparationError, match="way out is not known"):
        deep.separate()
    assert_starts(deep, deep.separate(limit=0.05))
    with pytest.raises(cvi.SeparationError):
        scene.separate(limit=0.05, fixed="box")
    for limit in (-1.0, np.nan, "far"):
        with pytest.raises(cvi.InputError):
            scene.separate(limit=limit)


@pytest.mark.parametrize("options", [{}, {"dt": 1e-3}])
def test_runs_take_it_as_their_start(options):
    scene = box_in_the_floor()
    with pytest.raises(cvi.PenetrationError, match="start='separate'"):
        cvi.simulate(scene, duration=0.01, **options)
    traj = cvi.simulate(scene, duration=0.01, start="separate", **options)
    np.testing.assert_array_equal(traj.q[0], scene.separate().q)
    assert traj.separation.largest == pytest.approx(0.002)
    assert traj.q[-1, 2] == pytest.approx(0.05, abs=1e-9)  # at rest
    assert cvi.simulate(scene, traj.q[0], duration=0.01, **options).separation is None
    with pytest.raises(cvi.InputError, match="'given' .* 'separate'"):
        cvi.simulate(scene, duration=0.01, start="apart")
    with pytest.raises(cvi.SeparationError):
        cvi.simulate(box_in_the_floor(0.03), duration=0.01, start="separate", **options)


def test_simulators_batches_and_scene_files_take_it(tmp_path):
    scene = box_in_the_floor()
    start = scene.separate().q
    sim = cvi.Simulator(scene, 1e-3, start="separate")
    sim.reset()
    np.testing.assert_array_equal(sim.q, start)
    sim.run(3)
    assert sim.trajectory().separation.before == pytest.approx(0.002)
    q0s = np.array([scene.neutral(), scene.configuration({"box": (0, 0, 0.02)}), start])
    found = cvi.simulate_batch(scene, q0s, duration=3e-3, dt=1e-3, start="separate")
    np.testing.assert_array_equal(found.q[0], sim.q if found.keep == "ends" else sim.trajectory().q)
    assert list(found.errors) == [1]
    assert isinstance(found.errors[1], cvi.SeparationError)
    file = tmp_path / "s.toml"
    file.write_text(
        '[[halfspace]]\n[[box]]\nname = "box"\nsize = [0.2, 0.2, 0.1]\nxyz = [0, 0, 0.048]\n'
        '[run]\ndt = 1e-3\nduration = 3e-3\nstart = "separate"\n'
    )
    np.testing.assert_array_equal(cvi.simulate(cvi.load_scene(file)).q[0], start)
