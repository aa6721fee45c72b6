"""Ellipsoids that fall on other bodies, come to rest on them, roll and slide: gaps are those of all other shapes."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.derivative_cases import UP, Bodies, in_body, random_turn
from helpers.touching_pairs import hull, prism

BASES = {
    "box": (lambda: coal.Box(0.6, 0.6, 0.1), 0.05),
    "hull": (lambda: hull(prism(6, 0.3, 0.05)), 0.05),
    "ellipsoid": (lambda: coal.Ellipsoid(0.5, 0.6, 0.1), 0.1),
}
HALF = (0.05, 0.08, 0.06)
CLOSED = 1e-10  # [m] overlap of persistent contacts (docs/guide/contact.md)


def dropped(base: str, friction: float, seed: int) -> tuple[cvi.Scene, np.ndarray, np.ndarray]:
    """A turning ellipsoid over a body that lies on the ground."""
    make, height = BASES[base]
    rng = np.random.default_rng(seed)
    bodies, R = Bodies(rng), random_turn(rng)
    bodies.wall(UP, 0.0)
    bodies.add(make(), pin.Inertia.FromBox(50.0, 0.6, 0.6, 0.1), np.eye(3), height * UP)
    bodies.add(coal.Ellipsoid(*HALF), pin.Inertia.FromEllipsoid(1.0, *HALF), R, (2.0 * height + 0.1) * UP)
    scene, q = bodies.scene()
    scene.set_contact(restitution=0.3, friction=friction)
    return scene, q, np.r_[np.zeros(6), in_body(R, np.r_[0.05, 0.03, 0.0, rng.normal(size=3)])]


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("base", BASES)
def test_impacts_are_located_and_contacts_stay_closed(base, friction):
    scene, q, v = dropped(base, friction, 1)
    traj = cvi.simulate(scene, q, v, duration=0.6, dt=0.005, contact_mode="events")
    assert max(abs(event.gap) for event in traj.events if "wall0" not in event.pair) <= 1e-12
    core = scene.core()
    assert min(np.asarray(core.gaps(x)[0]).min() for x in traj.q) >= -CLOSED
    on_ground, on_base, _ = np.sort(np.abs(core.gaps(traj.q[-1])[0]))
    assert on_ground <= on_base <= 1e-12


def test_derivatives_of_a_run_with_persistent_contact():
    scene, q, v = dropped("ellipsoid", 0.4, 1)
    check = cvi.check_gradient(scene, q, v, duration=0.25, dt=0.005, wrt=("q0", "v0"), columns=6, tolerance=1e-7)
    compared = [column.state for column in check.columns if column.state is not None]
    assert len(compared) >= 3
    assert max(state.relative_difference for state in compared) <= 1e-8
    assert "neither" not in {column.believe for column in check.columns}
