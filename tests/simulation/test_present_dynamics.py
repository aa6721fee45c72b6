"""The equations of motion at the present state of a simulator, with the forces of its contacts and constraints."""

from __future__ import annotations

import numpy as np
import pytest

import contactvi as cvi
from helpers.laws import mass_matrix


def resting_boxes() -> cvi.Simulator:
    scene = cvi.Scene()
    scene.add_halfspace((0.1, 0.05, 1.0))
    scene.add_box("low", size=(0.3, 0.3, 0.1), mass=2.0, placement=(0, 0, 0.08))
    scene.add_box("high", size=(0.1, 0.1, 0.1), mass=1.0, placement=(0.02, 0.01, 0.2))
    scene.set_contact(restitution=0.0, friction=0.8)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    assert sim.run(1500).ok
    return sim


def forces_in_frames(sim: cvi.Simulator) -> np.ndarray:
    J = sim.contact_jacobian()
    contacts = [c for c in sim.contacts if c.kind == "contact"]
    assert [(c.pair, c.point) for c in J.contacts] == [(c.pair, c.point) for c in contacts]
    return np.concatenate([j.rotation.T @ c.force for j, c in zip(J.contacts, contacts, strict=True)])


def test_at_rest_contact_forces_balance_the_bias_forces():
    sim = resting_boxes()
    assert len(sim.contact_jacobian().contacts) >= 6
    np.testing.assert_allclose(sim.v, 0.0, atol=1e-9)
    held = sim.contact_jacobian().matrix.T @ forces_in_frames(sim)
    np.testing.assert_allclose(held, sim.bias_forces(), atol=1e-7)  # of 30 N
    assert np.all(forces_in_frames(sim)[2::3] >= 0.0)


def test_quantities_are_those_of_the_scene_at_the_present_state():
    sim = resting_boxes()
    scene = sim.scene
    pairs = [
        (sim.mass_matrix(), scene.mass_matrix(sim.q)),
        (sim.bias_forces(), scene.bias_forces(sim.q, sim.v)),
        (sim.passive_forces(), scene.passive_forces(sim.q, sim.v, sim.t)),
        (sim.gaps(), scene.gaps(sim.q)),
    ]
    for now, there in pairs:  # quaternions of a simulator have norm one to rounding, those given are normalised
        np.testing.assert_allclose(now, there, atol=1e-14 * max(1.0, np.abs(there).max()))
    here, there = scene.contact_jacobian(sim.q).contacts, scene.contact_jacobian(sim.q).matrix
    J = sim.contact_jacobian()
    for k, contact in enumerate(J.contacts):  # the numbers of points are those of the run, and of the state
        off = [np.linalg.norm(c.position - contact.position) if c.pair == contact.pair else np.inf for c in here]
        j = int(np.argmin(off))
        assert off[j] < 1e-9
        np.testing.assert_allclose(J.matrix[3 * k : 3 * k + 3], there[3 * j : 3 * j + 3], atol=1e-9)
    expected = J.matrix @ np.linalg.solve(mass_matrix(scene.model, sim.q), J.matrix.T)
    np.testing.assert_allclose(sim.delassus(), expected, atol=1e-12 * np.abs(expected).max())


def test_before_the_first_step_the_contacts_are_what_touches():
    sim = resting_boxes()
    scene, q = sim.scene, sim.q
    for _ in range(2):  # again after a reset
        sim.reset(q, t=1.0)
        J, there = sim.contact_jacobian(), scene.contact_jacobian(q)
        assert len(J.contacts) >= 6
        np.testing.assert_array_equal(J.matrix, there.matrix)
        assert sim.delassus().shape == (len(J.matrix), len(J.matrix))
        sim.step()
        after = sim.contact_jacobian()
        assert {c.pair for c in after.contacts} == {c.pair for c in J.contacts}
    high = scene.configuration({"high": (0.0, 0.0, 1.0)})
    sim.reset(high)
    lifted = sim.contact_jacobian()
    assert "high" not in {name for c in lifted.contacts for name in c.pair}


def test_slip_is_the_tangential_part_of_the_contact_velocity():
    scene = cvi.Scene()
    scene.add_halfspace()
    box = scene.add_box("box", size=(0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.05))
    scene.set_contact(restitution=0.0, friction=0.3)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset(v0=scene.velocity({box: ((2.0, 1.0, 0.0), (0.0, 0.0, 3.0))}))
    sim.run(20)
    J = sim.contact_jacobian()
    assert len(J.contacts) == 4
    for k, contact in enumerate(sim.contacts):
        velocity = J.contacts[k].rotation @ (J.matrix[3 * k : 3 * k + 3] @ sim.v)
        np.testing.assert_allclose(velocity[:2], contact.slip[:2], atol=1e-9)
        assert abs(velocity[2]) < 1e-9


def test_reactions_act_along_the_constraint_jacobian():
    """A pendulum whose hinge is driven: M a + b = f + J^T lambda, with a from the motion and lambda the reaction."""
    scene = cvi.Scene()
    scene.add_urdf("models/double_pendulum.urdf")
    scene.set_joint("*", damping=0.1, stiffness=0.5)
    scene.prescribe("joint_1", lambda t: (np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)), name="motor")
    dt = 1e-4
    sim = cvi.Simulator(scene, dt=dt)
    sim.reset(scene.assemble())
    sim.run(3000)
    middle = sim.copy()  # at the middle of the two steps that are looked at
    before = sim.v.copy()
    sim.step()
    middle = sim.copy()
    first = sim.reaction("motor").copy()
    sim.step()
    a = (sim.v - before) / (2.0 * dt)
    force = 0.5 * (first + sim.reaction("motor"))
    left = middle.mass_matrix() @ a + middle.bias_forces()
    right = middle.passive_forces() + middle.constraint_jacobian("motor").T @ force
    np.testing.assert_allclose(left, right, atol=1e3 * dt**2 * np.abs(left).max())


def test_limits_have_no_rows_and_unrecorded_contacts_are_refused():
    scene = cvi.Scene()
    scene.add_urdf("models/double_pendulum.urdf")
    scene.set_joint("joint_1", limits=(-0.1, 0.2), restitution=0.0)
    sim = cvi.Simulator(scene, dt=1e-3)
    sim.reset()
    sim.run(400, np.tile([200.0, 0.0], (400, 1)))
    assert [c.kind for c in sim.contacts] == ["limit"]
    assert sim.contact_jacobian().matrix.shape == (0, 2)
    np.testing.assert_array_equal(sim.gap_gradients(), sim.scene.gap_gradients(sim.q))
    rows = dict(zip(sim.scene.gap_names, sim.gap_gradients(), strict=True))
    np.testing.assert_array_equal(rows["joint_1", "lower limit"], [1.0, 0.0])
    np.testing.assert_array_equal(rows["joint_1", "upper limit"], [-1.0, 0.0])
    silent = cvi.Simulator(scene, dt=1e-3, record_contacts=False)
    silent.reset()
    with pytest.raises(cvi.InputError, match="not recorded"):
        silent.contact_jacobian()
