"""Surfaces that move along themselves and adhesion in MJCF files (MuJoCo 3.11 and later)."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from helpers.extras import needs_mujoco

BELT = """
<mujoco><worldbody>
  <geom name="belt" type="plane" size="5 5 1" euler="0 0 90" friction="0.5" surfacevel="1 0 0 0 0 0"/>
  <geom name="ceiling" type="box" size="1 1 .1" pos="5 0 1.1" friction="0.5" adhesion="30"/>
  <body name="box" pos="0 0 .05"><freejoint name="box"/>
    <geom name="box" type="box" size=".1 .1 .05" mass="2" friction="0.5"/></body>
  <body name="cup" pos="5 0 .95"><freejoint name="cup"/>
    <geom name="cup" type="box" size=".1 .1 .05" mass="2" friction="0.5"
    adhesion="5"/></body>
</worldbody></mujoco>
"""


@needs_mujoco
def test_surface_velocity_and_adhesion_are_read(tmp_path) -> None:
    """The box goes along with the belt, which is turned; the cup hangs by 35 N and not by 15 N."""
    mujoco = pytest.importorskip("mujoco")
    if not hasattr(mujoco.MjModel, "geom_surfacevel"):
        pytest.skip("this MuJoCo knows no surfacevel")
    for pull, hangs in (("30", True), ("10", False)):
        file = tmp_path / f"belt_{pull}.xml"
        file.write_text(BELT.replace('adhesion="30"', f'adhesion="{pull}"'))
        scene = cvi.Scene()
        scene.add_mjcf(file, restitution=0.0)
        run = cvi.simulate(scene, duration=1.0, dt=0.01, order=4, throw=False)
        assert run.status.ok
        box, cup = scene.q_index("box").start, scene.q_index("cup").start
        np.testing.assert_allclose(run.q[-1][box + 1], 1.0 - 0.5 / (0.5 * 9.81), atol=1e-9)
        assert abs(run.q[-1][box]) < 1e-9
        assert (abs(run.q[-1][cup + 2] - 0.95) < 1e-9) == hangs
    assert "adhesion 15 N" in str(scene.report)
