"""The derivatives of runs with moving surfaces, laws of friction and adhesion, against differences of the runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from contactvi.verify import systems
from derivatives.differences import transpose_error
from derivatives.test_persistent_sensitivity import Start, check

SLOW = [pytest.mark.slow]
ORDERS = [{"dt": 0.01, "order": 2}, {"dt": 0.01, "order": 4}, {"dt": 0.02, "order": 8}]


def rubber(slip, normal, t):
    """Less friction under more load and by and by; an impact has an infinite one."""
    loaded = np.minimum(normal, 100.0)
    return 0.3 * (loaded / 5.0) ** (-1.0 / 3.0) * (1.0 + 0.5 * np.exp(-2.0 * slip)) * (1.0 - 0.3 * np.sin(2.0 * t))


RUBBER = {"friction_of_state": rubber}
STRIBECK = {"friction": lambda v: 0.2 + 0.2 * math.exp(-2.0 * v), "static_friction": 0.5}


def scene_of(shape: str, e: float, contact: dict[str, Any], **surface: Any) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    if shape == "box":
        scene.add_box("body", [0.2, 0.3, 0.1], mass=1.3)
    else:
        scene.add_sphere("body", 0.1, mass=0.7)
    axis = contact.pop("friction_axis", None)
    scene.set_contact("ground", "body", restitution=e)
    if axis is None:
        scene.set_contact("ground", "body", **contact)
    else:
        scene.set_contact("ground", friction_axis=axis, **contact)
    if surface:
        scene.set_surface_velocity("ground", **surface)
    return scene


def ball(contact: dict[str, Any], e: float = 0.0, height: float = 0.11, **surface: Any) -> Start:
    v = np.array([1.0, 0.4, 0.0, 0.5, -2.0, 3.0])
    return scene_of("ball", e, dict(contact), **surface), np.array([0.1, 0.2, height, 0.0, 0.0, 0.0, 1.0]), v


def box(contact: dict[str, Any], v: tuple[float, ...] = (0.6, 0.5, 0.0), **surface: Any) -> Start:
    """Return a box that lies flat, and so may be moved in the plane alone."""
    start = np.array([0.1, 0.2, 0.05, 0.0, 0.0, 0.0, 1.0])
    return scene_of("box", 0.0, dict(contact), **surface), start, np.array([*v, 0.0, 0.0, 0.0])


BELT = {"linear": (0.5, -0.3, 0.0)}
SWINGING = {"linear": (0.5, -0.3, 0.0), "profile": lambda t: 1.0 + math.sin(3.0 * t)}
TABLE = {"linear": (0.1, 0.0, 0.0), "angular": (0.0, 0.0, 2.0), "profile": lambda t: 1.0 + t}
PLAIN = {"friction": 0.3}
GRIPS = {"friction": 1.5}
ALONG = {"friction": (0.1, 0.3), "friction_axis": (1.0, 0.5, 0.0)}
PULLED = {"friction": 0.3, "adhesion": lambda t: 3.0 + math.sin(5.0 * t)}

FASTER = {"linear": (1.0, -0.5, 0.0), "profile": lambda t: 4.0 * t * t}
STATIC = {"friction": 0.3, "static_friction": 0.5}


def held_up() -> Start:
    """Return a ball that weighs upwards and rolls under a plane that lets it go."""
    scene = cvi.Scene(gravity=(0.6, 0.2, 9.81))
    scene.add_halfspace(name="ground")
    scene.add_sphere("body", 0.1, mass=0.7)
    scene.set_contact("ground", "body", restitution=0.0, friction=1.0, adhesion=lambda t: 9.0 - 10.0 * t * t)
    return scene, np.array([0.1, 0.2, 0.1, 0.0, 0.0, 0.0, 1.0]), np.array([1.0, 0.5, 0.0, -2.0, 3.0, 0.5])


def tumbling() -> Start:
    """Return a rod that falls on its tip, which slides then: the load depends on the friction."""
    scene, q = systems.rod_on_ground(1.0, 0.02, 0.0, 0.3, 9.81)
    scene.set_contact(friction_of_state=rubber)
    q[1] += 0.005
    return scene, q, np.array([1.5, 0.0, 0.0])


# A ball that falls may be moved anywhere, a box that lies flat in its plane.
ALL = list(range(12))
FLAT = [0, 1, 6, 7]

# name -> start, directions of (q0, v0), duration
RUNS: dict[str, tuple[Callable[[], Start], list[int], float]] = {
    "a ball bounces on a belt": (lambda: ball(PLAIN, 0.7, 0.3, **SWINGING), ALL, 0.4),
    "a ball bounces on a turntable": (lambda: ball(GRIPS, 0.7, 0.3, **TABLE), ALL, 0.4),
    "a ball bounces, friction by speed": (lambda: ball(STRIBECK, 0.7, 0.3), ALL, 0.4),
    "a ball bounces, friction along an axis": (lambda: ball(ALONG, 0.7, 0.3), ALL, 0.4),
    "a ball slips on a belt": (lambda: ball(PLAIN, **SWINGING), ALL, 0.16),
    "a ball slips on a turntable": (lambda: ball(PLAIN, **TABLE), ALL, 0.16),
    "a ball slips, friction by speed": (lambda: ball(STRIBECK), ALL, 0.16),
    "a ball slips, friction along an axis": (lambda: ball(ALONG), ALL, 0.16),
    "a ball slips under adhesion": (lambda: ball(PULLED), ALL, 0.16),
    "a ball comes to roll on a turntable": (lambda: ball(PLAIN, **TABLE), ALL, 0.4),
    "a ball comes to roll, friction by speed": (lambda: ball(STRIBECK), ALL, 0.4),
    "a ball comes to roll, friction along an axis": (lambda: ball(ALONG), ALL, 0.6),
    "a ball comes to roll under adhesion": (lambda: ball(PULLED), ALL, 0.4),
    "a box comes to rest on a belt": (lambda: box(PLAIN, **BELT), FLAT, 0.5),
    "a box on a belt that swings": (lambda: box(PLAIN, (1.0, -0.6, 0.0), **SWINGING), FLAT, 0.6),
    "a box comes to rest, friction by speed": (lambda: box(STRIBECK, (0.6, 0.52, 0.0)), FLAT, 0.4),
    "a box slides, friction along an axis": (lambda: box(ALONG), FLAT, 0.2),
    "a box sticks to a belt and slips again": (lambda: box(STATIC, (0.3, -0.15, 0.0), **FASTER), FLAT, 0.8),
    "a ball bounces, friction of the state": (lambda: ball(RUBBER, 0.7, 0.3), ALL, 0.4),
    "a ball slips, friction of the state": (lambda: ball(RUBBER), ALL, 0.12),
    "a ball slips on a belt, friction of the state": (lambda: ball(RUBBER, **SWINGING), ALL, 0.12),
    "a ball comes to roll, friction of the state": (lambda: ball(RUBBER), ALL, 0.4),
    "a rod that falls, friction of the state": (tumbling, [0, 1, 2, 3, 4, 5], 0.3),
    "a ball is let go": (held_up, [*FLAT, 9, 10, 11], 0.6),
    "a box comes to rest under adhesion": (lambda: box(PULLED), FLAT, 0.4),
}


# In contact steps of order 2 corners that share a load come to the limits of their friction one by one: a kink.
AGAIN = "a box sticks to a belt and slips again"
CASES = [
    pytest.param(name, options, id=f"{name}, order {options['order']}", marks=[] if options["order"] == 4 else SLOW)
    for name in RUNS
    for options in ORDERS
    if name != AGAIN or options["order"] > 2
]


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("name", "options"), CASES)
def test_runs_with_laws_of_friction(name: str, options: dict[str, Any]) -> None:
    """Tangent against differences, and the adjoint against the tangent."""
    make, directions, duration = RUNS[name]
    # The time at which a slip begins is that at which a force is at its limit, which is located less closely.
    size = 10.0 if name == AGAIN else 1.0
    traj = check(make(), directions, (1e-4 * size, 5e-5 * size), duration=duration, **options)
    assert traj.status.ok
    assert transpose_error(traj, ["q0", "v0"]) <= 1e-11


def test_dense_steps_have_no_derivative_of_the_state() -> None:
    """They say so."""
    scene, q, v = ball(RUBBER)
    run = cvi.simulate(scene, q, v, duration=0.12, dt=0.01, record="gradient", contact_mode="steps")
    with pytest.raises(cvi.NotDifferentiable, match="normal force"):
        run.sensitivity()


def test_points_of_a_face_have_no_derivative_of_the_state() -> None:
    """How they share their load, which the laws of rigid bodies leave open, decides about their friction."""
    scene, q, v = box(RUBBER)
    run = cvi.simulate(scene, q, v, duration=0.2, dt=0.01, order=4, record="gradient")
    with pytest.raises(cvi.NotDifferentiable, match="share their load"):
        run.sensitivity()


def test_coefficients_that_are_no_numbers() -> None:
    """The number of a pair has a derivative where it is the friction, and none where a law takes its place."""
    for contact, expected in ((STATIC, True), (STRIBECK, False)):
        scene, q, v = box(contact)
        run = cvi.simulate(scene, q, v, duration=0.1, dt=0.01, order=4, record="gradient")
        by_friction = run.sensitivity("friction").matrix[-1]
        assert bool(np.abs(by_friction).max() > 1e-3) == expected


TABLE_OF_SPEED = {"friction": [(0.0, 0.5), (0.4, 0.3), (2.0, 0.2)], "static_friction": 0.6}
# name -> start, duration; what a file can hold
STORED: dict[str, tuple[Callable[[], Start], float]] = {
    "a ball bounces on a belt": (lambda: ball(PLAIN, 0.7, 0.3, **BELT), 0.4),
    "a ball comes to roll on a turntable": (lambda: ball(PLAIN, linear=(0.1, 0.0, 0.0), angular=(0.0, 0.0, 2.0)), 0.4),
    "a box comes to rest on a belt": (lambda: box(PLAIN, **BELT), 0.5),
    "a box comes to rest, friction by speed": (lambda: box(TABLE_OF_SPEED, (0.6, 0.52, 0.0)), 0.4),
    "a ball comes to roll, friction along an axis": (lambda: ball(ALONG), 0.6),
    "a box comes to rest, static friction": (lambda: box(STATIC), 0.4),
    "a box comes to rest under adhesion": (lambda: box({"friction": 0.3, "adhesion": 4.0}), 0.4),
    "a ball spins and rolls to rest": (lambda: ball(TURNING | {"friction": 0.4}), 0.5),
}
TURNING = {"spinning_radius": 0.01, "rolling_radius": 0.005}


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("name", STORED)
def test_runs_from_files(name: str, order: int, tmp_path: Path) -> None:
    """A file keeps all that these laws need: the derivatives of a run that was loaded have the same bits."""
    make, duration = STORED[name]
    scene, q, v = make()
    run = cvi.simulate(scene, q, v, duration=duration, dt=0.01, order=order, record="gradient")
    again = cvi.Trajectory.load(run.save(tmp_path / "run.npz"))
    twice = cvi.Trajectory.load(again.save(tmp_path / "again.npz"))
    wrt = ["q0", "v0", "friction"]
    expected = run.sensitivity(wrt, on_kink="taken").matrix
    for stored in (again, twice):
        np.testing.assert_array_equal(stored.sensitivity(wrt, on_kink="taken").matrix, expected)
        for cost in ("q0", "friction"):
            ones = np.ones((2, len(run.t), scene.nv))
            mine, other = (cvi.gradient(r, tuple(ones), [cost], on_kink="taken")[1] for r in (run, stored))
            np.testing.assert_array_equal(mine[cost], other[cost])


@pytest.mark.parametrize("order", [2, 4])
def test_files_of_older_versions(order: int, tmp_path: Path) -> None:
    """They lack what laws need: such runs have no derivatives, those with Coulomb's law have them as before."""
    for contact, surface, has_law in ((PLAIN, BELT, True), (PLAIN, {}, False)):
        scene, q, v = box(contact, **surface)
        run = cvi.simulate(scene, q, v, duration=0.1, dt=0.01, order=order, record="gradient")
        path = run.save(tmp_path / "run.npz", overwrite=True)
        with np.load(path) as file:
            entries = {name: file[name] for name in file.files if name not in ("input/contact_laws", "input/held_laws")}
        np.savez(path, **entries)
        again = cvi.Trajectory.load(path)
        if not has_law:
            np.testing.assert_array_equal(again.sensitivity("v0").matrix, run.sensitivity("v0").matrix)
            continue
        with pytest.raises(cvi.NotDifferentiable, match="older versions") as refused:
            again.sensitivity("v0")
        assert refused.value.reason == "law"
        saved_again = cvi.Trajectory.load(again.save(tmp_path / "again.npz"))
        with pytest.raises(cvi.NotDifferentiable, match="older versions"):
            saved_again.sensitivity("v0")


def test_numbers_of_laws_that_do_not_belong_to_the_scene(tmp_path: Path) -> None:
    scene, q, v = ball(TURNING | {"friction": 0.4})
    run = cvi.simulate(scene, q, v, duration=0.3, dt=0.01, record="gradient")
    path = run.save(tmp_path / "run.npz")
    with np.load(path) as file:
        entries = {name: file[name] for name in file.files}
    laws = entries["input/contact_laws"]
    assert len(laws)
    for wrong in (laws[:-1], np.append(laws, 0.0), -laws, np.zeros_like(laws)):
        np.savez(path, **(entries | {"input/contact_laws": wrong}))
        with pytest.raises(cvi.ContactviError, match="do not belong to its scene"):
            cvi.Trajectory.load(path).sensitivity("v0")
