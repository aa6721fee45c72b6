"""Capsules and cylinders that lie on each other rest, roll and rock without overlaps and without gaining energy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import contactvi as cvi
from contactvi.records.codes import Change
from contactvi.records.contacts import ChangeLog
from contactvi.simulation.simulation import broken_promises

R, LENGTH, GAP = 0.05, 0.4, 1e-4
LIE = (np.pi / 2, 0.0, 0.0)


def check(scene: cvi.Scene, duration: float, *start, dt: float = 1e-3) -> cvi.Trajectory:
    """A run whose gaps and energy are those of rigid bodies: 1e-9 m, and the h^2 terms of the midpoint rule."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", cvi.AccuracyWarning)
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        traj = cvi.simulate(scene, *start, duration=duration, dt=dt)
    assert min(scene.gaps(q).min() for q in traj.q) >= -1e-9
    # In one step the energy may swing by what the rule conserves besides it: (a h)^2 m / 12 and (w h)^2 T / 12, with
    # accelerations of some 4 g where a point runs along a line; over the run it falls.
    rise = traj.energy - np.minimum.accumulate(traj.energy)
    assert rise.max() <= (4 * 9.81 * dt) ** 2 * 1.0 / 12 + 1e-4 * traj.kinetic_energy.max()
    return traj


def add(scene: cvi.Scene, kind: str, name: str, place, turn=LIE, mass: float | None = 1.0) -> None:
    make = scene.add_capsule if kind == "capsule" else scene.add_cylinder
    fixed = {"free": False} if mass is None else {"mass": mass}
    make(name, radius=R, length=LENGTH, placement=(place, turn), **fixed)


def lying(yaw: float = 0.0, tilt: float = 0.0) -> tuple[float, float, float]:
    """Rotation vector of an axis along -y, turned about z by yaw and tipped."""
    import pinocchio as pin

    R_z, R_x = (pin.AngleAxis(a, np.eye(3)[i]).toRotationMatrix() for a, i in ((yaw, 2), (np.pi / 2 + tilt, 0)))
    return tuple(pin.log3(R_z @ R_x))


@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
@pytest.mark.parametrize("on", ["capsule", "cylinder"])
def test_a_roller_comes_to_rest_in_a_vee(kind, on):
    scene = cvi.Scene()
    for k, x in enumerate((-0.06, 0.06)):
        add(scene, on, f"f{k}", (x, 0, R), mass=None)
    z = R + np.sqrt(4 * R * R - 0.06**2)
    add(scene, kind, "a", (0, 0, z + GAP))
    scene.set_contact(restitution=0.0, friction=0.5)
    traj = check(scene, 0.5)
    assert traj.stats.dense_steps == 0
    assert len(traj.events) <= 6
    np.testing.assert_allclose(traj.q[-1, :3], [0, 0, z], atol=1e-9)
    assert abs(traj.v[-1]).max() < 1e-9
    # What a side carries as normal force and as friction is not unique; together they carry the weight.
    last = traj.contacts.t > 0.49
    steps = len(set(traj.contacts.t[last]))
    assert np.count_nonzero(last) == 4 * steps
    assert traj.contacts.force[last, 2].sum() == pytest.approx(9.81 * steps, rel=1e-9)


@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
def test_a_roller_rolls_on_a_parallel_one_as_on_a_circle(kind):
    """Without friction a body slides off a fixed roller at cos = 2/3 of the height, and its axis stays parallel."""
    scene = cvi.Scene()
    add(scene, "cylinder", "below", (0, 0, 0), mass=None)
    angle = 0.1
    add(scene, kind, "a", (2 * R * np.sin(angle), 0.05, 2 * R * np.cos(angle)))
    scene.set_contact(restitution=0.0, friction=0.0)
    traj = check(scene, 0.3)
    leaves = next(c for c in traj.contact_changes if c.change == "release").time
    k = int(leaves / 1e-3)
    cosine = traj.q[k, 2] / np.hypot(traj.q[k, 0], traj.q[k, 2])
    assert cosine == pytest.approx(2 / 3 * np.cos(angle), abs=1e-2)  # a step before it leaves
    assert abs(traj.q[:k, 1] - 0.05).max() < 1e-9


@pytest.mark.thinned(3)
@pytest.mark.parametrize("restitution", [0.0, 0.4, 0.8])
@pytest.mark.parametrize("yaw", [0.0, 1e-6, 1e-4, 1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
def test_rollers_that_are_dropped_on_each_other(kind, yaw, restitution):
    scene = cvi.Scene()
    add(scene, "cylinder", "below", (0, 0, R), mass=None)
    add(scene, kind, "a", (0.003, 0.01, 3 * R + 5e-3), lying(yaw, 0.01))
    scene.set_contact(restitution=restitution, friction=0.3)
    check(scene, 0.2)


@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
def test_a_roller_on_the_end_of_a_standing_cylinder(kind):
    """It lies along a chord, tips over an end of it when pushed down there, and falls back."""
    scene = cvi.Scene()
    scene.add_cylinder("below", 0.08, 0.1, free=False, placement=(0, 0, 0.05))
    add(scene, kind, "a", (0.03, 0.0, 0.1 + R + 2e-3), lying(0.3, 0.02))
    scene.set_contact(restitution=0.2, friction=0.4)
    traj = check(scene, 0.3)
    assert traj.q[-1, 2] == pytest.approx(0.1 + R, abs=1e-6)


def test_an_overlap_beyond_what_is_promised_is_told():
    """Where no step keeps the gaps the pair, the depth and the time are in the changes of contact, and a warning."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, 1.0, placement=(0, 0, 0.1))
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3)
    log = {"time": 0.005, "kind": 0, "index": 0, "point": 0, "change": Change.OVERLAP, "value": -2e-8}
    arrays = {name: np.array([value]) for name, value in log.items()}
    traj.contact_changes = ChangeLog(arrays, scene.pair_names, list(scene.model.names))
    (told,) = broken_promises(traj)
    assert "'ground' and 'ball' by 2e-08 m at t = 0.005 s" in told


def test_dense_steps_that_miss_the_law_are_told():
    """Where the residual of Coulomb's law is above a half, a run says so in every contact mode."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, 1.0, placement=(0, 0, 0.1))
    traj = cvi.simulate(scene, duration=0.01, dt=1e-3, contact_mode="steps")
    assert broken_promises(traj) == []
    traj.dense_steps["residual"][3:5] = 0.2, 0.7
    (told,) = broken_promises(traj)
    assert "not met in 1 of 10 dense steps: by up to 0.7 of the largest free speed, at t = 0.004 s" in told


def two_falling(seed: int, first: str) -> tuple[cvi.Scene, np.ndarray]:
    """A box or a cylinder, and a cylinder, which fall on the ground and on each other."""
    rng, scene = np.random.default_rng(seed), cvi.Scene()
    scene.add_halfspace()
    turn = tuple(rng.uniform(-3, 3, 3))
    if first == "box":
        a = scene.add_box("one", (0.2, 0.15, 0.1), 0.7, placement=((0, 0, 0.4), turn))
    else:
        a = scene.add_cylinder("one", 0.08, 0.15, 0.8, placement=((0, 0, 0.4), turn))
    b = scene.add_cylinder("two", 0.08, 0.15, 0.8, placement=((0.02, 0.01, 0.9), tuple(rng.uniform(-3, 3, 3))))
    scene.set_contact(restitution=0.5, friction=0.3)
    turning = {a: (rng.normal(size=3) * 0.2, rng.normal(size=3) * 3),
               b: (rng.normal(size=3) * 0.2 + [0, 0, -1.5], rng.normal(size=3) * 3)}  # fmt: skip
    return scene, scene.velocity(turning)


@pytest.mark.parametrize(("seed", "first"), [(21, "cylinder"), (74, "box"), (3, "cylinder"), (5, "box")])
def test_energy_and_losses_of_falling_cylinders(seed, first):
    """The energy never rises, and friction takes no more than the energy falls by."""
    scene, v0 = two_falling(seed, first)
    with warnings.catch_warnings():
        warnings.simplefilter("error", cvi.AccuracyWarning)
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        traj = cvi.simulate(scene, None, v0, 1.0, dt=1e-3)
    size = float(traj.kinetic_energy.max())
    assert np.diff(traj.energy).max() <= 1e-5 * size
    assert np.diff(traj.friction_loss).min() >= -1e-5 * size
    lost = traj.energy[0] - traj.energy
    assert abs(lost - traj.friction_loss - traj.impact_loss).max() <= 2e-3 * size
    assert min(scene.gaps(q).min() for q in traj.q) >= -1e-9


def test_a_step_in_contact_that_loses_energy_is_taken_shorter():
    """Light rollers that cross at a small angle: steps of 40 us lost 0.14 J of 12 J besides friction and impacts."""
    scene = cvi.Scene()
    for k, (x, y) in enumerate(
        [
            (-0.03353671296287785, -0.22125911549944335),
            (0.20838437132283205, 0.08158591236444261),
            (-0.17484765835995417, 0.13967320313500087),
        ]
    ):
        scene.add_halfspace((x, y, 0.9746382368304917), -0.05, name=f"slope{k}")
    capsule, cylinder = scene.add_capsule, scene.add_cylinder
    for k, (add, radius, mass, place, yaw) in enumerate(
        [
            (capsule, 0.04, 0.7295388307141953, (0.031159128754502288, -0.02976747852986711, 0.1), 0.001),
            (
                cylinder, 0.04, 8.77881516914708,
                (-0.018806986598658093, -0.034486326293466374, 0.16257260318568584), 0.001,
            ),
            (
                capsule, 0.04, 0.750498015469337,
                (0.007703709359352884, -0.00019151168909679883, 0.24267260231624688), 2.094373349665074,
            ),
            (
                cylinder, 0.04, 0.18529341240979635,
                (0.015496735405861495, 0.039782250678028874, 0.3227722206033965), np.pi / 2,
            ),
            (
                capsule, 0.03, 5.323460203859223,
                (-0.013393277361190739, 0.04106179250695394, 0.39279090766085145), np.pi / 2,
            ),
        ]
    ):  # fmt: skip
        add(f"roller{k}", radius, 0.3, mass=mass, placement=(place, (np.pi / 2, 0.0, yaw)))
    scene.set_contact(restitution=0.5, friction=0.8)
    traj = cvi.simulate(scene, scene.configuration({}), scene.velocity({}), 0.28, dt=1e-3)
    assert np.abs(np.diff(traj.ledger.energy_balance)).max() <= 1e-3 * np.ptp(traj.energy)
