"""Bodies of closed meshes that are not convex: a cow at rest, a stool on its like, a mug that a hand lifts.

Nothing here is a closed form of the run: what is checked is what holds of every rest and of every lift, by the mesh's
own triangles, by statics and by the balance of momentum.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial import ConvexHull

import contactvi as cvi
from helpers import closed_meshes
from helpers.run_scenes import HAND_URDF

GRAVITY = 9.81


def turned(q: np.ndarray) -> np.ndarray:
    return pin.Quaternion(q[3:7]).toRotationMatrix()


def places(traj: cvi.Trajectory, name: str) -> np.ndarray:
    """Where a body is touched at the end of a run (n, 3)."""
    return np.array([contact.position for contact in traj.contacts.at(traj.t[-1]) if name in contact.pair])


def holds(corners: np.ndarray, place: np.ndarray) -> bool:
    """Whether a polygon (n, 2) has a place inside."""
    faces = ConvexHull(corners).equations
    return bool((faces[:, :2] @ place + faces[:, 2] < 0.0).all())


def distance_of_surface(scene: cvi.Scene) -> float:
    """That of the surfaces from their meshes at most, as the report says."""
    notes = [note.text for note in scene.report.all_notes("changed") if "from the mesh" in note.text]
    return max(float(text.split()[0]) for text in notes)


def test_a_cow_comes_to_rest_on_a_polygon_that_supports_it() -> None:
    """Its pose is one of least height over all directions nearby, by the vertices of its mesh."""
    vertices, faces = closed_meshes.cow()
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_mesh("cow", (vertices, faces), mass=1.0, spacing=0.004)
    scene.set_contact(restitution=0.0, friction=0.6)
    start = pin.Quaternion(pin.rpy.rpyToMatrix(0.5, 0.3, 0.2))
    run = cvi.simulate(scene, [0.01, 0.0, 0.13, *start.coeffs()], duration=3.0, dt=2e-3)
    assert run.status.ok
    assert np.abs(run.v[-1]).max() < 1e-8
    assert min(scene.gaps(q)[0] for q in run.q) > -1e-9
    off, lever = distance_of_surface(scene), scene.model.inertias[1].lever
    R, at = turned(run.q[-1]), run.q[-1, :3]
    # Its weight is above the polygon of its points, of which two alone would not hold it.
    corners = places(run, "cow")
    assert len(corners) >= 3
    assert holds(corners[:, :2], (R @ lever + at)[:2])
    assert np.linalg.norm(run.contacts.on("cow")[1][-1] - [0.0, 0.0, GRAVITY]) < 1e-9
    # The points are lowest ones of the mesh, to how far the surface is from it, and so is the whole: a hull's face.
    heights = vertices @ R.T[:, 2] + at[2]
    assert abs(heights.min()) < off
    for corner in corners:
        near = np.linalg.norm(vertices @ R.T + at - corner, axis=1) < 0.008
        assert heights[near].min() < 2.0 * off
    # Tilted in any direction by .1 rad, about where it then touches, its centre of mass is higher.
    high = float((R @ lever + at)[2])
    for angle in 2.0 * np.pi * np.arange(24) / 24:
        tilt = pin.exp3(0.1 * np.array([np.cos(angle), np.sin(angle), 0.0])) @ R
        assert float((tilt @ lever)[2] - (vertices @ tilt.T)[:, 2].min()) > high


@pytest.mark.slow
def test_a_stool_stands_on_its_like() -> None:
    """A stool with three legs is dropped on the seat of another one: the lever rule says what each leg carries."""
    mass = 2.0
    scene = cvi.Scene()
    scene.add_mesh("lower", closed_meshes.stool(), spacing=0.007, free=False)
    scene.add_mesh("upper", closed_meshes.stool(), mass=mass, spacing=0.007)
    scene.set_contact(restitution=0.0, friction=0.8)
    start = pin.Quaternion(pin.rpy.rpyToMatrix(0.02, -0.03, 0.5))
    run = cvi.simulate(scene, [0.005, -0.004, 0.165, *start.coeffs()], duration=0.3, dt=2e-3)
    assert run.status.ok
    assert np.abs(run.v[-1]).max() < 1e-8
    assert min(scene.gaps(q)[0] for q in run.q) > -1e-9
    corners, q = places(run, "upper"), run.q[-1]
    centre = turned(q) @ scene.model.inertias[1].lever + q[:3]
    assert len(corners) == 3
    assert holds(corners[:, :2], centre[:2])
    # Each leg stands by its own end: the ball about the middle of that, to how far the surface is from the mesh.
    ends = closed_meshes.stool_feet() @ turned(q).T + q[:3]
    away = np.linalg.norm(ends[:, None] - corners, axis=2)
    off = distance_of_surface(scene)
    assert sorted(away.argmin(axis=1)) == [0, 1, 2]
    assert np.abs(away.min(axis=1) - closed_meshes.STOOL_FOOT).max() < 2.0 * off
    # What they carry together: the weight, and no moment about the centre of mass.
    acting = run.contacts.at(run.t[-1])
    forces = np.array([(1.0 if contact.pair[1] == "upper" else -1.0) * np.array(contact.force) for contact in acting])
    np.testing.assert_allclose(forces.sum(axis=0), [0.0, 0.0, mass * GRAVITY], atol=1e-9)
    at = np.array([contact.position for contact in acting])
    np.testing.assert_allclose(np.cross(at - centre, forces).sum(axis=0), 0.0, atol=1e-9)


# --- a mug and a hand ------------------------------------------------------------------------------------------------

MASS, TIP, LIFT, UP = 0.15, 0.012, 0.06, 0.6  # [kg; m; m; s] the mug, the finger's tip, the way, its time
FLEXED = {"joint_0.0": 0.0, "joint_1.0": 0.1, "joint_2.0": 0.25, "joint_3.0": 0.35}  # the index finger, its tip up
# Inertias about the joints [kg m^2], as in models/allegro_ball.toml: springs of 20 Hz, half of critical damping.
INERTIAS = {
    "joint_[048].0": 3.6e-4, "joint_[159].0": 3.9e-4, "joint_[26].0": 9.9e-5, "joint_10.0": 9.9e-5,
    "joint_[37].0": 1.7e-5, "joint_11.0": 1.7e-5, "joint_12.0": 9.2e-4, "joint_13.0": 1.6e-4, "joint_14.0": 2.7e-4,
    "joint_15.0": 4.6e-5,
}  # fmt: skip


def hand_and_mug(options: dict[str, Any], mesh: closed_meshes.Mesh) -> tuple[cvi.Scene, np.ndarray]:
    """The Allegro hand, its index finger through the handle of a mug that stands on a table; and where both are."""
    scene = cvi.Scene()
    scene.add_urdf(HAND_URDF, base="free", self_collision=False)
    scene.add_halfspace(name="table")
    scene.add_mesh("mug", mesh, mass=MASS, **options)
    scene.set_contact(restitution=0.0, friction=0.8)
    rate = 2.0 * np.pi * 20.0
    for joint, inertia in INERTIAS.items():
        scene.set_joint(joint, stiffness=inertia * rate**2, damping=inertia * rate, rest=0.0)
    q = scene.neutral()
    for joint, angle in FLEXED.items():
        scene.set_joint(joint, rest=angle)
        q[scene.q_index(joint)] = angle
    palm_up = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, -0.5 * np.pi, np.pi)).coeffs()
    q[scene.q_index("root_joint")] = [0.0, 0.0, 0.0, *palm_up]
    geometry = scene.collision_model
    placed = geometry.createData()
    pin.updateGeometryPlacements(scene.model, scene.model.createData(), geometry, placed, q)
    tip = placed.oMg[geometry.getGeometryId("link_3.0_tip_0")].translation
    # The tip is 1 mm below the top of the hole in the handle.
    hole = closed_meshes.HANDLE_AT[2] + closed_meshes.HANDLE - closed_meshes.HANDLE_TUBE
    base = np.array([0.0, 0.0, hole - 1e-3 - TIP - tip[2]])
    q[scene.q_index("root_joint")] = [*base, *palm_up]
    q[scene.q_index("mug")] = [tip[0], tip[1] - closed_meshes.HANDLE_AT[1], 0.0, 0.0, 0.0, 0.0, 1.0]

    def way(t: float) -> Any:
        s = min(max(t / UP, 0.0), 1.0)
        return np.concatenate([base + [0.0, 0.0, LIFT * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)], palm_up])

    scene.prescribe("root_joint", way)
    return scene, q


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["pieces", "field"])
def test_a_hand_lifts_a_mug_by_its_handle(shape: str) -> None:
    """By pieces or by its field a mug hangs on the finger, clear of the table: its hull has no handle to grasp."""
    mesh = closed_meshes.mug(0.002 if shape == "field" else 0.003)
    scene, start = hand_and_mug({"spacing": 0.002} if shape == "field" else {"decompose": True}, mesh)
    run = cvi.simulate(scene, start, duration=1.0, dt=2e-3, start="separate")
    assert run.status.ok
    own, rates = scene.q_index("mug"), scene.v_index("mug")
    after = run.t > UP
    # Nothing but the finger touches it in the end, and no vertex of it is at the table.
    lowest = [(mesh[0] @ turned(q[own]).T)[:, 2].min() + q[own][2] for q in run.q[after]]
    assert min(lowest) > 0.005
    last = [contact for contact in run.contacts.at(run.t[-1]) if any(name.startswith("mug") for name in contact.pair)]
    assert len(last) > 0
    assert all(any(name.startswith("link_3.0") for name in contact.pair) for contact in last)
    assert min(scene.gaps(q).min() for q in run.q[1::10]) > -1e-9
    # What the table and the finger gave to it is what its momentum and its weight took.
    momenta = [turned(run.q[k, own]) @ run.p[k, rates][:3] for k in (0, -1)]
    change = momenta[1] - momenta[0] + [0.0, 0.0, MASS * GRAVITY * run.t[-1]]
    weight = MASS * GRAVITY * run.t[-1]
    assert np.abs(run.contacts.impulse_on("mug") - change).max() < 1e-12 * weight
