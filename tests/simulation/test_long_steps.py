"""Steps that are so long that what solves their equations is not the motion: they are halved, by their energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

LENGTH = 1.0  # [m] of the links of `chain`


def chain(folder: Path, masses: list[float], axes: list[str]) -> cvi.Scene:
    """Links with their masses at their ends, one below the other."""
    text = '<robot name="c"><link name="l0"/>'
    for k, (mass, axis) in enumerate(zip(masses, axes, strict=True), 1):
        i = 0.001 * mass
        text += (
            f'<link name="l{k}"><inertial><origin xyz="0 0 -{LENGTH}"/><mass value="{mass}"/><inertia ixx="{i}"'
            f' iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{k}" type="continuous"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 {-LENGTH if k > 1 else 0}"/><axis xyz="{axis}"/></joint>'
        )
    path = folder / "chain.urdf"
    path.write_text(text + "</robot>")
    scene = cvi.Scene()
    scene.add_urdf(path, limits=False, self_collision=False)
    return scene


def scale(traj: cvi.Trajectory) -> float:
    """Of the energy of a motion: its largest kinetic energy, or how far its potential energy moves."""
    return max(float(traj.kinetic_energy.max()), float(np.ptp(traj.potential_energy)))


def test_a_double_pendulum_of_the_field(tmp_path):
    """With steps of .25 s its energy left all bounds, without a status."""
    scene = chain(tmp_path, [1.0, 1.0], ["0 1 0", "0 1 0"])
    traj = cvi.simulate(scene, scene.configuration({"j1": 1.5, "j2": 1.0}), duration=20.0, dt=0.25)
    assert traj.stats.halved > 0
    assert np.ptp(traj.energy) <= 0.1 * 4 * 9.81 * LENGTH


@pytest.mark.parametrize("order", [2, 4, 8])
def test_drawn_chains_keep_their_energy_however_long_the_steps_are(order, tmp_path):
    """Without a look at the energy a sixth of such runs end with SUCCESS and an energy off by a tenth and more."""
    rng, rises = np.random.default_rng(5), []
    for _ in range(12):
        links = int(rng.integers(1, 4))
        scene = chain(
            tmp_path, list(rng.uniform(0.3, 2.0, links)), list(rng.choice(["1 0 0", "0 1 0", "0 0 1"], links))
        )
        q = pin.integrate(scene.model, pin.neutral(scene.model), rng.uniform(-2, 2, links))
        v = rng.normal(size=links) * 3.0
        fine = cvi.simulate(scene, q, v, 2.0, dt=1e-3, order=8)
        for dt in (0.05, 0.15, 0.4):
            traj = cvi.simulate(scene, q, v, 40 * dt, dt=dt, order=order)
            rises.append(np.abs(traj.energy - traj.energy[0]).max() / scale(fine))
    # Steps in which nothing turns far are not looked at, and add what their order leaves.
    assert max(rises) <= 0.15


@pytest.mark.parametrize(("order", "dt"), [(2, 0.01), (4, 0.05), (8, 0.1)])
def test_steps_that_resolve_the_motion_are_left_alone(order, dt, tmp_path):
    scene = chain(tmp_path, [1.0, 0.5], ["0 1 0", "0 1 0"])
    traj = cvi.simulate(scene, scene.configuration({"j1": 1.5, "j2": 1.0}), [3.0, -2.0], 10.0, dt=dt, order=order)
    assert traj.stats.halved == 0
