"""Surfaces given by functions: against halfspaces, balls and meshes, and against DOP853 on the offset surface."""

from __future__ import annotations

import ctypes
import pickle
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi import UserFunctionError
from contactvi.errors import InputError, SceneError
from helpers.wavy_ground import HIGH, WAVE, bend, slope, waves
from oracles.surface_ball import GRAVITY, BallOnSurface

RADIUS = 0.1

WAVES: dict[str, Any] = {"height": waves, "gradient": slope, "hessian": bend}
ORACLE = BallOnSurface(
    lambda u: float(waves(u[None])[0]),
    lambda u: slope(u[None])[0],
    lambda u: bend(u[None])[0],
    RADIUS,
)


def with_ball(friction: float = 0.0, restitution: float = 0.5, **surface: Any) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_surface("ground", **surface)
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=restitution, friction=friction)
    return scene


def at(center: Any) -> np.ndarray:
    return np.array([*center, 0.0, 0.0, 0.0, 1.0])


# --- against what is known otherwise ---------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("kind", ["height", "distance"])
def test_an_inclined_plane_is_the_halfspace(kind: str, order: int) -> None:
    """Bounces, slides and rests as on the halfspace: events to 1e-11 s, states to 1e-9."""
    slope = np.array([0.3, -0.2])
    normal = np.array([*-slope, 1.0]) / np.sqrt(1.0 + slope @ slope)
    given: dict[str, Any] = (
        {"height": lambda p: p @ slope, "gradient": lambda p: np.tile(slope, (len(p), 1))}
        if kind == "height"
        else {"distance": lambda p: p @ normal, "gradient": lambda p: np.tile(normal, (len(p), 1))}
    )
    runs = []
    for by_function in (True, False):
        scene = cvi.Scene()
        if by_function:
            scene.add_surface("ground", **given)
        else:
            scene.add_halfspace(normal)
        scene.add_sphere("ball", RADIUS)
        scene.set_contact(restitution=0.6, friction=0.2)
        v = np.array([0.3, 0.1, 0.0, 1.0, 0.0, 2.0])
        runs.append(cvi.simulate(scene, at([0.0, 0.0, 0.6]), v, duration=2.0, dt=0.01, order=order))
    found, known = runs
    assert found.status.ok
    assert known.status.ok
    assert len(found.events) == len(known.events) > 5
    # The impacts accumulate: the last ones inherit all errors of the ones before.
    np.testing.assert_allclose([e.time for e in found.events][:8], [e.time for e in known.events][:8], atol=1e-11)
    np.testing.assert_allclose(found.q, known.q, atol=1e-9)
    np.testing.assert_allclose(found.v, known.v, atol=1e-8)
    assert [c.change for c in found.contact_changes] == [c.change for c in known.contact_changes]


def test_a_box_lands_on_a_slope() -> None:
    """By its corners, slides, tips onto its face and comes to rest, as on the halfspace."""
    slope = 0.3
    normal = np.array([-slope, 0.0, 1.0]) / np.sqrt(1.0 + slope**2)
    turned = pin.Quaternion(pin.utils.rotate("x", 0.2) @ pin.utils.rotate("y", -0.5)).coeffs()
    runs = []
    for by_function in (True, False):
        scene = cvi.Scene()
        if by_function:
            scene.add_surface("ground", height=lambda p: slope * p[:, 0])
        else:
            scene.add_halfspace(normal)
        scene.add_box("box", (0.2, 0.3, 0.1))
        scene.set_contact(restitution=0.0, friction=0.6)
        runs.append(cvi.simulate(scene, [0.0, 0.0, 0.4, *turned], duration=1.5, dt=0.005))
    found, known = runs
    assert found.status.ok
    assert known.status.ok
    np.testing.assert_allclose(found.events[0].time, known.events[0].time, atol=1e-11)
    np.testing.assert_allclose(found.q[-1], known.q[-1], atol=1e-5)  # sticking by rates here, by places there
    assert np.abs(found.v[-1]).max() < 1e-9
    lowest = min(gap for gap in found.scene.core().gaps(found.q[-1])[0])
    assert abs(lowest) < 1e-9


def test_a_distance_of_a_ball_is_the_ball() -> None:
    """A ball that bounces off a ball given by its distance, and off the built-in one."""
    runs = []
    for by_function in (True, False):
        scene = cvi.Scene()
        if by_function:
            scene.add_surface(
                "dome", distance=lambda p: np.linalg.norm(p, axis=1) - 0.5, placement=(0.1, 0.0, 0.0),
                gradient=lambda p: p / np.linalg.norm(p, axis=1, keepdims=True),
            )  # fmt: skip
        else:
            scene.add_sphere("dome", 0.5, free=False, placement=(0.1, 0.0, 0.0))
        scene.add_sphere("ball", RADIUS)
        scene.set_contact(restitution=0.7, friction=0.3)
        runs.append(cvi.simulate(scene, at([0.15, 0.02, 0.9]), duration=0.8, dt=0.01, order=4))
    found, known = runs
    assert found.status.ok
    assert len(found.events) == len(known.events) > 0
    np.testing.assert_allclose([e.time for e in found.events], [e.time for e in known.events], atol=1e-11)
    np.testing.assert_allclose(found.q, known.q, atol=1e-9)


def test_a_torus_holds_a_ball() -> None:
    """In the ring of a torus a ball comes to rest at the bottom, which touches all around: at the one point it has."""

    def torus(p: np.ndarray) -> np.ndarray:
        return np.hypot(np.hypot(p[:, 0], p[:, 1]) - 0.5, p[:, 2]) - 0.2

    scene = cvi.Scene()
    scene.add_surface("ring", distance=torus, extent=[(-0.8, 0.8), (-0.8, 0.8), (-0.3, 0.3)])
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=0.0)
    run = cvi.simulate(
        scene, at([0.5, 0.0, 0.3 + 1e-3]), [0.0, 0.2, 0.0, 0.0, 0.0, 0.0], duration=0.5, dt=0.005, order=4
    )
    assert run.status.ok
    centers = run.q[run.t > 0.1, :3]
    away = np.hypot(np.hypot(centers[:, 0], centers[:, 1]) - 0.5, centers[:, 2]) - 0.2
    np.testing.assert_allclose(away, RADIUS, atol=1e-9)


# --- against DOP853 --------------------------------------------------------------------------------------------------


def _on_waves(u: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A centre over u, and a velocity of it in the tangent plane."""
    return ORACLE.center(u), ORACLE.center_change(u) @ along


def _slid(order: int, dt: Any, duration: float = 1.0) -> Any:
    u, along = np.array([0.2, 0.1]), np.array([0.5, 0.3])
    q, v = _on_waves(u, along)
    return cvi.simulate(with_ball(**WAVES), at(q), [*v, 0.0, 0.0, 0.0], duration=duration, dt=dt, order=order), u, v


def test_a_ball_that_slides_converges_with_the_order() -> None:
    """Frictionless: places against the oracle, and the energy; orders 2, 4, 8."""
    for order, steps, ratio in ((2, (0.01, 0.005), 3.4), (4, (0.04, 0.02), 12.0), (8, (0.1, 0.05), 100.0)):
        errors, losses = [], []
        for dt in steps:
            run, u, v = _slid(order, dt)
            assert run.status.ok
            known, _ = ORACLE.slide(u, v, np.array([0.0, run.t[-1]]))
            errors.append(float(np.abs(run.q[-1, :3] - known[-1]).max()))
            energy = 0.5 * (run.v[:, :3] ** 2).sum(axis=1) + GRAVITY * run.q[:, 2]
            losses.append(float(np.abs(energy - energy[0]).max()))
        assert errors[0] / errors[1] > ratio, (order, errors)
        assert errors[1] < {2: 1e-4, 4: 1e-5, 8: 1e-8}[order], (order, errors)
        assert losses[1] < {2: 1e-3, 4: 1e-5, 8: 1e-8}[order], (order, losses)


@pytest.mark.parametrize(("order", "dt", "bound"), [(4, 0.01, 1e-5), (8, 0.02, 1e-8)])
def test_a_ball_that_rolls(order: int, dt: float, bound: float) -> None:
    """Nonholonomic: against the equations of rolling on the offset surface."""
    u = np.array([0.2, 0.1])
    omega = np.array([-2.0, 4.0, 1.0])
    v = RADIUS * np.cross(omega, ORACLE.normal(u))
    run = cvi.simulate(
        with_ball(friction=2.0, **WAVES), at(ORACLE.center(u)), [*v, *omega], duration=1.0, dt=dt, order=order
    )
    assert run.status.ok
    assert {change.change for change in run.contact_changes} <= {"begin", "stick"}
    known, speeds, _ = ORACLE.roll(u, omega, np.array([0.0, 1.0]))
    np.testing.assert_allclose(run.q[-1, :3], known[-1], atol=bound)
    turn = pin.Quaternion(run.q[-1, 3:]).toRotationMatrix()
    np.testing.assert_allclose(turn @ run.v[-1, :3], speeds[-1], atol=20 * bound)


@pytest.mark.slow
def test_a_ball_that_bounces_on_waves() -> None:
    """Instants of impacts are those of the parabola that meets the offset surface."""
    c, v = np.array([0.3, 0.2, 0.5]), np.array([0.4, -0.2, 0.0])
    run = cvi.simulate(with_ball(restitution=0.9, **WAVES), at(c), [*v, 0.0, 0.0, 0.0], duration=1.6, dt=0.02)
    times, places, _ = ORACLE.bounce(c, v, 0.9, 3)
    assert run.status.ok
    # Each impact multiplies the rounding of the one before by about the flight over the radius of curvature.
    np.testing.assert_allclose([e.time for e in run.events][:3], times, atol=1e-11)
    np.testing.assert_allclose([e.q[:3] for e in run.events][:3], places, atol=1e-10)


def test_a_crest_within_a_step_is_met() -> None:
    """A ball passes half a metre in a step, over a crest that stands between both ends."""
    scene = with_ball(height=lambda p: 0.3 * np.exp(-((p[:, 0] / 0.15) ** 2)), restitution=1.0)
    run = cvi.simulate(scene, at([-0.24, 0.0, 0.3]), [10.0, 0.0, 0.0, 0.0, 0.0, 0.0], duration=0.05, dt=0.05)
    (event,) = run.events
    assert 0.0 < event.time < 0.03
    assert abs(scene.core().gaps(event.q)[0][0]) < 1e-11


@pytest.mark.slow
def test_automatic_steps() -> None:
    """dt="auto" on waves: bounces, then rolls and rests in a hollow."""
    run = cvi.simulate(with_ball(friction=0.5, **WAVES), at([0.3, 0.1, 0.4]), duration=1.0, dt="auto", tol=1e-6)
    close = cvi.simulate(with_ball(friction=0.5, **WAVES), at([0.3, 0.1, 0.4]), duration=1.0, dt=1e-3, order=8)
    assert run.status.ok
    assert close.status.ok
    np.testing.assert_allclose(run.q[-1, :3], close.q[-1, :3], atol=1e-4)


def test_a_ball_comes_to_rest_in_a_bowl() -> None:
    """Rolling in a paraboloid with slip at first; the gap stays closed."""
    bowl: dict[str, Any] = {
        "height": lambda p: 0.5 * (p**2).sum(axis=1), "gradient": lambda p: p,
        "hessian": lambda p: np.tile(np.eye(2), (len(p), 1, 1)),
    }  # fmt: skip
    scene = with_ball(friction=0.4, restitution=0.3, **bowl)
    run = cvi.simulate(scene, at([0.3, 0.0, 0.4]), duration=2.0, dt=0.005, order=4)
    assert run.status.ok
    assert run.contact_changes[-1].change == "begin"
    gaps = [abs(scene.core().gaps(q)[0][0]) for q in run.q[run.t > 1.5]]
    assert max(gaps) < 1e-9


def test_a_fine_mesh_is_near() -> None:
    """The first impact with a mesh of prisms under the same waves, to the error of its cells."""
    n = 24
    x = np.linspace(-0.3, 0.3, n + 1)
    scene = cvi.Scene()
    for i in range(n // 2 - 4, n // 2 + 4):
        for j in range(n // 2 - 4, n // 2 + 4):
            for corners in (((i, j), (i + 1, j), (i + 1, j + 1)), ((i, j), (i + 1, j + 1), (i, j + 1))):
                top = np.array([(x[a], x[b]) for a, b in corners])
                points = np.vstack([np.column_stack([top, waves(top)]), np.column_stack([top, np.full(3, -0.2)])])
                scene.add_mesh(f"cell_{i}_{j}_{len(corners[1]) * corners[1][1] + corners[2][0]}", points, free=False)
    scene.add_sphere("ball", RADIUS)
    scene.set_contact(restitution=0.9)
    c = np.array([0.01, 0.02, 0.4])
    mesh = cvi.simulate(scene, at(c), duration=0.4, dt=0.01)
    run = cvi.simulate(with_ball(restitution=0.9, **WAVES), at(c), duration=0.4, dt=0.01)
    cell = 0.6 / n
    sag = HIGH * WAVE**2 * cell**2 / 4.0  # of a triangle under the surface, both directions
    speed = abs(run.events[0].v_minus[2]) if hasattr(run.events[0], "v_minus") else 2.0
    assert abs(run.events[0].time - mesh.events[0].time) < 2.0 * sag / speed


# --- derivatives that are not given ----------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [("height",), ("height", "gradient")])
def test_differences_stand_for_derivatives(given: tuple[str, ...]) -> None:
    """Events are the same to 1e-11 s: the gap has the error of the nearest point in second order."""
    c, v = [0.3, 0.2, 0.5], [0.4, -0.2, 0.0, 0.0, 0.0, 0.0]
    runs = [
        cvi.simulate(with_ball(restitution=0.9, **{k: WAVES[k] for k in keys}), at(c), v, duration=1.0, dt=0.02)
        for keys in (given, tuple(WAVES))
    ]
    times = [[e.time for e in run.events] for run in runs]
    assert len(times[0]) == len(times[1]) > 1
    np.testing.assert_allclose(*times, atol=1e-10)


_Compiled = ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_double, ctypes.POINTER(ctypes.c_double))


def _compiled_bowl(x: float, y: float, values: Any) -> None:
    values[0], values[1], values[2] = 0.5 * (x * x + y * y), x, y
    values[3], values[4], values[5] = 1.0, 0.0, 1.0


class Compiled:
    """An object with the address of a C function, as numba.cfunc makes them."""

    def __init__(self, function: Any = _compiled_bowl) -> None:
        self._kept = _Compiled(function)
        self.address = ctypes.cast(self._kept, ctypes.c_void_p).value


def test_a_compiled_function_gives_the_same_run() -> None:
    bowl: dict[str, Any] = {
        "height": lambda p: 0.5 * (p[:, 0] * p[:, 0] + p[:, 1] * p[:, 1]), "gradient": lambda p: p,
        "hessian": lambda p: np.tile(np.eye(2), (len(p), 1, 1)),
    }  # fmt: skip
    runs = [
        cvi.simulate(with_ball(friction=0.3, **given), at([0.2, 0.1, 0.5]), duration=0.6, dt=0.01)
        for given in (bowl, {"height": Compiled()})
    ]
    assert runs[0].status.ok
    np.testing.assert_array_equal(runs[0].q, runs[1].q)


def test_threads_of_a_batch_call_it() -> None:
    """Runs of a batch in two threads are those alone."""
    scene = with_ball(restitution=0.8, **WAVES)
    starts = np.array([at([0.1 * k, 0.0, 0.4]) for k in range(6)])
    batch = cvi.simulate_batch(scene, starts, duration=0.6, dt=0.01, workers=2)
    for q0, run in zip(starts, batch.q, strict=True):
        alone = cvi.simulate(scene, q0, duration=0.6, dt=0.01)
        np.testing.assert_array_equal(np.asarray(run)[-1], alone.q[-1])


# --- shapes ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_capsules_touch_by_both_ends_and_hulls_by_vertices() -> None:
    scene = cvi.Scene()
    scene.add_surface("ground", **WAVES)
    scene.add_capsule("capsule", 0.05, 0.3, placement=((0.0, 0.0, 0.3), (0.0, np.pi / 2, 0.0)))
    rng = np.random.default_rng(4)
    points = rng.normal(size=(30, 3))
    scene.add_mesh("stone", 0.1 * points / np.linalg.norm(points, axis=1, keepdims=True), placement=(0.6, 0.0, 0.3))
    scene.set_contact(restitution=0.2, friction=0.7)
    run = cvi.simulate(scene, duration=1.5, dt=0.005)
    assert run.status.ok
    gaps = dict(zip(scene.pair_names, scene.core().gaps(run.q[-1])[0], strict=True))
    assert abs(gaps["ground", "capsule"]) < 1e-8
    assert abs(gaps["ground", "stone"]) < 1e-8


def test_a_free_body_given_by_a_distance_falls_on_balls() -> None:
    """A solid whose distance a function gives, on three fixed balls, comes to rest on them."""
    scene = cvi.Scene()
    for k in range(3):
        angle = 2.0 * np.pi * k / 3.0
        scene.add_sphere(f"foot_{k}", 0.1, free=False, placement=(0.2 * np.cos(angle), 0.2 * np.sin(angle), 0.0))
    scene.add_surface(
        "stone", distance=lambda p: np.linalg.norm(p, axis=1) - 0.3, inertia=pin.Inertia.FromSphere(2.0, 0.3),
        extent=[(-0.3, 0.3)] * 3, placement=(0.0, 0.0, 0.6),
    )  # fmt: skip
    scene.set_contact(restitution=0.0, friction=0.5)
    run = cvi.simulate(scene, duration=1.0, dt=0.005)
    assert run.status.ok
    rest = np.sqrt(0.4**2 - 0.2**2)
    np.testing.assert_allclose(run.q[-1, :3], [0.0, 0.0, rest], atol=1e-6)


@pytest.mark.parametrize("other", ["cylinder", "ellipsoid", "compliant", "moving halfspace"])
def test_other_combinations_are_refused(other: str) -> None:
    scene = cvi.Scene()
    scene.add_surface("ground", **WAVES)
    if other == "cylinder":
        scene.add_cylinder("body", 0.1, 0.2)
    elif other == "ellipsoid":
        scene.add_ellipsoid("body", (0.1, 0.2, 0.3))
    elif other == "compliant":
        scene.add_sphere("body", 0.1)
        scene.set_compliance("body", "ground", stiffness=1e4)
    else:
        scene.add_halfspace(name="floor")
        scene.add_surface("body", distance=lambda p: np.linalg.norm(p, axis=1) - 0.3, inertia=pin.Inertia.Random())
    with pytest.raises(SceneError, match="ground|body"):
        scene.built()


# --- what goes wrong -------------------------------------------------------------------------------------------------


def test_functions_that_fail_end_the_run() -> None:
    """Raising, a wrong shape and nan, in the middle of a run: an error that names the surface."""

    class Fails:
        def __init__(self, result: Any) -> None:
            self.result, self.armed = result, False

        def __call__(self, p: np.ndarray) -> Any:
            if not self.armed:
                return np.zeros(len(p))
            if isinstance(self.result, Exception):
                raise self.result
            return self.result(p)

    for result in (
        ValueError("lost"),
        lambda p: np.zeros(len(p) + 1),
        lambda p: np.full(len(p), np.nan),
        lambda p: "x",
    ):
        function = Fails(result)
        scene = with_ball(height=function)
        scene.core()
        function.armed = True
        with pytest.raises(UserFunctionError, match="ground"):
            cvi.simulate(scene, at([0.0, 0.0, 0.2]), duration=1.0, dt=0.01)


def test_a_compiled_function_that_is_not_finite_ends_the_run() -> None:
    def fails(x: float, y: float, values: Any) -> None:
        _compiled_bowl(x, y, values)
        if x > 0.35:
            values[0] = float("nan")

    scene = with_ball(height=Compiled(fails), extent=[(-0.2, 0.2)] * 2)
    with pytest.raises(UserFunctionError, match="ground.*gives no gap"):
        cvi.simulate(scene, at([0.0, 0.0, 0.15]), [2.0, 0.0, 0.0, 0.0, 0.0, 0.0], duration=1.0, dt=0.01)


def test_a_distance_that_is_none_away_from_the_samples_ends_the_run() -> None:
    """A true distance near the origin, twice it far from there."""

    def distance(p: np.ndarray) -> np.ndarray:
        return p[:, 2] * np.where(p[:, 0] < 1.0, 1.0, 2.0)

    scene = with_ball(distance=distance, restitution=0.0)
    with pytest.raises(UserFunctionError, match="ground.*gives no gap.*length"):
        cvi.simulate(scene, at([0.0, 0.0, 0.12]), [2.0, 0.0, 0.0, 0.0, 0.0, 0.0], duration=1.0, dt=0.01)


def test_a_hollow_that_is_narrower_than_the_ball_is_refused() -> None:
    scene = with_ball(height=lambda p: 20.0 * p[:, 0] ** 2, restitution=0.0)
    with pytest.raises(UserFunctionError, match="hollows that are wider"):
        cvi.simulate(scene, at([0.02, 0.0, 0.6]), duration=1.0, dt=0.01)


def test_a_sharp_crest_has_no_foot() -> None:
    """Over the edge of two planes the search for the nearest point comes to no end, and says so."""
    scene = with_ball(
        height=lambda p: -0.5 * np.abs(p[:, 0] - 0.013), restitution=0.0,
        gradient=lambda p: np.stack([-0.5 * np.sign(p[:, 0] - 0.013), np.zeros(len(p))], axis=1),
    )  # fmt: skip
    with pytest.raises(UserFunctionError, match="ground.*gives no gap"):
        cvi.simulate(scene, at([0.023, 0.0, 0.2]), duration=1.0, dt=0.01)


def test_arguments_are_checked() -> None:
    scene = cvi.Scene()
    for wrong in (
        {}, {"height": waves, "distance": waves}, {"height": 3.0}, {"height": waves, "hessian": bend},
        {"height": waves, "extent": [(1, -1), (0, 1)]},
        {"height": waves, "gradient": lambda p: 2.0 * slope(p)},
        {"distance": lambda p: 2.0 * (np.linalg.norm(p, axis=1) - 0.5)}, {"height": Compiled(), "gradient": waves},
    ):  # fmt: skip
        with pytest.raises(InputError):
            scene.add_surface("ground", **wrong)
    with pytest.raises(UserFunctionError, match="ground"):
        scene.add_surface("ground", height=lambda p: p)
    assert not scene.parts


# --- kept, drawn, copied ---------------------------------------------------------------------------------------------


def test_stored_runs_are_played_and_ask_for_the_function_again(tmp_path: Any) -> None:
    scene = with_ball(**WAVES)
    run = cvi.simulate(scene, at([0.3, 0.2, 0.3]), duration=0.3, dt=0.01)
    run.save(tmp_path / "run.npz")
    loaded = cvi.Trajectory.load(tmp_path / "run.npz")
    assert loaded.scene.missing == ["surface of ground"]
    loaded.to_html(tmp_path / "run.html")
    with pytest.raises(SceneError, match="surface of ground"):
        cvi.simulate(loaded.scene, at([0.3, 0.2, 0.3]), duration=0.3, dt=0.01)
    loaded.scene.set_surface("ground", **WAVES)
    again = cvi.simulate(loaded.scene, at([0.3, 0.2, 0.3]), duration=0.3, dt=0.01)
    np.testing.assert_array_equal(again.q, run.q)


def test_pickled_scenes_keep_it() -> None:
    twin = pickle.loads(pickle.dumps(with_ball(**WAVES)))
    assert not twin.missing
    q = at([0.3, 0.2, 0.3])
    np.testing.assert_array_equal(twin.core().gaps(q)[0], with_ball(**WAVES).core().gaps(q)[0])


def test_the_grid_is_drawn() -> None:
    """Vertices of the drawn mesh lie on the surface; that of a distance is closed and turned outward."""
    from contactvi.playback.scene_visuals import from_scene

    scene = with_ball(**WAVES)
    scene.add_surface("dome", distance=lambda p: np.linalg.norm(p, axis=1) - 0.5)
    by_name = {visual.name: visual for visual in from_scene(scene)}
    sheet, dome = by_name["ground"], by_name["dome"]
    assert sheet.shape == dome.shape == "mesh"
    np.testing.assert_allclose(sheet.vertices[:, 2], waves(sheet.vertices[:, :2].astype(float)), atol=1e-6)
    points, corners = dome.vertices.astype(float), dome.faces.astype(int)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.5, atol=2e-3)
    a, b, c = (points[corners[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
    assert 0.98 < volume / (4.0 / 3.0 * np.pi * 0.125) < 1.0  # chords of cells of 5 cm
