"""add_ellipsoid: its inertia, errors, picture, and runs on the ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi


def on_the_ground(height: float, **contact: float) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_ellipsoid("egg", radii=(0.1, 0.1, 0.15), mass=2.0, placement=((0, 0, height), (np.pi / 2, 0, 0)))
    scene.set_contact(**contact)
    return scene


def test_its_inertia_is_that_of_the_points_inside():
    """By a sum over a grid of points, to its spacing."""
    scene = cvi.Scene()
    scene.add_ellipsoid("egg", (0.1, 0.2, 0.3), mass=5.0)
    axes = [np.linspace(-r, r, 81)[:-1] + r / 80 for r in (0.1, 0.2, 0.3)]
    x = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    x = x[np.sum((x / [0.1, 0.2, 0.3]) ** 2, axis=1) <= 1.0]
    wanted = 5.0 * np.mean(np.sum(x**2, axis=1)[:, None] - x**2, axis=0)
    np.testing.assert_allclose(np.diag(scene.model.inertias[1].inertia), wanted, rtol=2e-3)


def test_it_bounces_without_loss():
    scene = on_the_ground(0.3, restitution=1.0)
    traj = cvi.simulate(scene, duration=1.0, dt=1e-3)
    assert len(traj.events) >= 2
    first = traj.events[0]
    assert first.time == pytest.approx(np.sqrt(2.0 * 0.2 / 9.81), abs=1e-9)
    assert np.abs(traj.energy - traj.energy[0]).max() < 1e-9
    assert min(scene.gaps(q)[0] for q in traj.q) > -1e-9


def test_it_rolls_on_its_round_side():
    """A spheroid with its long axis level, across its way, rolls as a cylinder of its inertia does."""
    scene = on_the_ground(0.1, restitution=0.0, friction=0.8)
    speed, radius = 0.7, 0.1
    q0 = scene.neutral()
    turn = pin.Quaternion(q0[3:7]).matrix()  # of the body; its velocity is in its own axes
    v0 = np.concatenate([turn.T @ [speed, 0.0, 0.0], turn.T @ [0.0, speed / radius, 0.0]])
    traj = cvi.simulate(scene, q0, v0, duration=1.0, dt=1e-3)
    assert traj.q[-1, 0] == pytest.approx(speed * 1.0, abs=1e-6)
    assert np.abs(traj.energy - traj.energy[0]).max() < 1e-7
    assert max(abs(scene.gaps(q)[0]) for q in traj.q) < 1e-9


def test_its_picture_is_an_ellipsoid(tmp_path: Path):
    scene = on_the_ground(0.3)
    page = cvi.simulate(scene, duration=0.01, dt=1e-3).to_html(tmp_path / "run.html")
    assert '"ellipsoid"' in Path(page).read_text()
    (shape,) = [g.geometry for g in scene.collision_model.geometryObjects if g.name == "egg"]
    np.testing.assert_array_equal(shape.radii, [0.1, 0.1, 0.15])


@pytest.mark.parametrize("radii", [0.1, (0.1, 0.2), (0.1, 0.2, 0.0), (0.1, -0.2, 0.3), (0.1, np.nan, 0.3), "abc", None])
def test_wrong_radii_are_refused(radii):
    scene = cvi.Scene()
    with pytest.raises(cvi.InputError, match="radii of 'egg'"):
        scene.add_ellipsoid("egg", radii)
    assert len(scene.parts) == 0
