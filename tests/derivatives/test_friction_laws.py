"""The derivatives of runs with moving surfaces, laws of friction and adhesion, against differences of the runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import contactvi as cvi
from derivatives.differences import transpose_error
from derivatives.test_persistent_sensitivity import Start, check

SLOW = [pytest.mark.slow]
ORDERS = [{"dt": 0.01, "order": 2}, {"dt": 0.01, "order": 4}, {"dt": 0.02, "order": 8}]
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


@pytest.mark.parametrize(("name", "options"), CASES)
def test_runs_with_laws_of_friction(name: str, options: dict[str, Any]) -> None:
    """Tangent against differences, and the adjoint against the tangent."""
    make, directions, duration = RUNS[name]
    # The time at which a slip begins is that at which a force is at its limit, which is located less closely.
    size = 10.0 if name == AGAIN else 1.0
    traj = check(make(), directions, (1e-4 * size, 5e-5 * size), duration=duration, **options)
    assert traj.status.ok
    assert transpose_error(traj, ["q0", "v0"]) <= 1e-11


def test_coefficients_that_are_no_numbers() -> None:
    """The number of a pair has a derivative where it is the friction, and none where a law takes its place."""
    for contact, expected in ((STATIC, True), (STRIBECK, False)):
        scene, q, v = box(contact)
        run = cvi.simulate(scene, q, v, duration=0.1, dt=0.01, order=4, record="gradient")
        by_friction = run.sensitivity("friction").matrix[-1]
        assert bool(np.abs(by_friction).max() > 1e-3) == expected


def test_dense_steps_refuse() -> None:
    scene, q, v = box(STATIC)
    run = cvi.simulate(scene, q, v, duration=0.1, dt=0.01, contact_mode="steps", record="gradient")
    with pytest.raises(cvi.NotDifferentiable, match="law") as refused:
        run.sensitivity("v0")
    assert refused.value.reason == "law"


@pytest.mark.parametrize("order", [2, 4])
def test_runs_from_files_refuse(order: int, tmp_path: Path) -> None:
    """A file does not keep what these laws need."""
    scene, q, v = box(PLAIN, **BELT)
    run = cvi.simulate(scene, q, v, duration=0.1, dt=0.01, order=order, record="gradient")
    again = cvi.Trajectory.load(run.save(tmp_path / "run.npz"))
    with pytest.raises(cvi.NotDifferentiable, match="files") as refused:
        again.sensitivity("v0")
    assert refused.value.reason == "law"
