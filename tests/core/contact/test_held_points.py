"""Points of a contact that constraints hold: no impulse changes their speed, so they take none."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi

CORNER = np.array([0.1, 0.15, -0.05])


def pinned_box(restitution: float, friction: float) -> cvi.Scene:
    """A box of which one lower corner is pinned to the ground."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", 2.0 * np.abs(CORNER), mass=2.0)
    scene.set_contact(restitution=restitution, friction=friction)
    scene.add_point("world", "box", (CORNER[0], CORNER[1], 0.0), CORNER)
    return scene


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("turn", [(0.5, -0.5, 0.3), (-0.5, 0.0, 0.1), (0.0, 0.3, 0.0)])
def test_a_box_that_lies_with_a_pinned_corner(restitution, friction, turn):
    """It tips about the corner or is thrown back: impulses are those of its weight and speed, the energy falls."""
    q = np.r_[0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0]
    v = np.r_[np.cross(turn, -CORNER), turn]
    traj = cvi.simulate(pinned_box(restitution, friction), q, v, duration=0.3, dt=1e-3, throw=False)
    assert len(traj.events) > 0 or friction > 0.0
    # The gap of the pair is that of the corner, zero to rounding, which may end the run.
    assert traj.status.code in (cvi.StatusCode.SUCCESS, cvi.StatusCode.CONSTRAINT, cvi.StatusCode.TOO_MANY_IMPACTS)
    if len(traj.events):
        closing = np.abs(traj.events.array("gamma_minus")).max()
        assert traj.events.array("impulse").max() <= 2.0 * (1.0 + restitution) * closing
    assert np.ptp(traj.energy.clip(min=traj.energy[0])) <= 1e-6


def test_a_box_that_falls_beside_its_pinned_corner_says_what_to_do():
    """The gap of the pair stays that of the corner: the others come down unseen, and the run ends there."""
    R = pin.exp3(np.array([-0.2, 0.1, 0.2]))
    q = np.r_[np.array([CORNER[0], CORNER[1], 0.0]) - R @ CORNER, pin.Quaternion(R).coeffs()]
    traj = cvi.simulate(pinned_box(0.5, 0.0), q, duration=0.3, dt=1e-3, throw=False)
    assert traj.status.code == cvi.StatusCode.CONSTRAINT
    assert "disable" in traj.status.message
    assert traj.t[-1] == pytest.approx(0.0862, abs=2e-4)
