"""DTEC and MHC beside constraints and joint friction: what they conserve, and what they agree with.

The oracle is the slow one of oracles.constrained_maps. Beside it stand systems that have two descriptions, one of them
without constraints, and the symplectic form, which DTEC alone keeps over an impact.
"""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.constrained_scenes import Start, crank, driven_arm_at_wall, linkage_at_stop, on_constraints, striker
from helpers.loop_scenes import BAR, arm
from oracles.constrained_maps import ConstrainedSystem
from oracles.constraints import Point, Prescribed

MAPS = ("dtec", "mhc")


def with_tip(model: pin.Model, joint: str, **plane: object) -> cvi.Scene:
    """A scene of a model with a ball at the end of a rod, and a plane that it falls on."""
    geometry, end = pin.GeometryModel(), pin.SE3(np.eye(3), np.array([BAR, 0.0, 0.0]))
    geometry.addGeometryObject(pin.GeometryObject("tip", model.getJointId(joint), end, coal.Sphere(0.05)))
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    scene = cvi.Scene.from_pinocchio(model, geometry, name="arm")
    scene.add_halfspace(**plane, name="plane")
    return scene


def five_bar(restitution: float) -> Start:
    """Four rods between two pivots, with two degrees of freedom, whose second joint falls on a floor."""
    scene = with_tip(arm(4), "j2", normal=(0.0, 0.0, 1.0), offset=-0.45)
    scene.add_point("world", "j4", (0.6, 0.0, 0.0), (BAR, 0.0, 0.0))
    scene.set_contact(restitution=restitution, friction=0.0)
    q = scene.assemble(np.array([-0.8, 0.6, 1.0, 0.4]), fixed=["j1", "j2"])
    return scene, q, scene.consistent_velocity(q, np.array([1.0, 0.5, 0.0, 0.0]))


def moved_pendulum(restitution: float = 0.7) -> Start:
    """A box that is moved along and turned, with another one on a ball joint above a floor."""
    scene = cvi.Scene()
    scene.add_box("hand", (0.1, 0.1, 0.1))
    scene.add_box("bob", (0.05, 0.1, 0.2), mass=0.5)
    scene.add_point("hand", "bob", (0.2, 0.0, 0.0), (0.0, 0.0, 0.25))
    scene.add_halfspace(name="floor")
    scene.set_contact(restitution=restitution, friction=0.0)
    for pair in (("hand", "bob"), ("hand", "floor")):
        scene.disable_pair(*pair)
    scene.prescribe("hand", hand_motion, name="motion")
    q = scene.assemble()
    turned = pin.exp3(np.array([0.3, 1.2, 0.0]))
    end = pin.XYZQUATToSE3(q[:7]).act(np.array([0.2, 0.0, 0.0]))
    q[7:] = pin.SE3ToXYZQUAT(pin.SE3(turned, end - turned @ np.array([0.0, 0.0, 0.25])))
    v = np.zeros(12)
    v[10] = 1.0
    return scene, q, v


TURN = np.array([0.2, 0.5, 0.4])


def hand_motion(t: float) -> tuple[pin.SE3, tuple[np.ndarray, np.ndarray]]:
    """A pose and its velocity in world axes: it goes down, and turns about an axis."""
    place = pin.SE3(
        pin.exp3(TURN * np.sin(t)), np.array([0.3 * np.sin(2.0 * t), 0.1 * t, 0.45 - 0.1 * np.sin(3.0 * t)])
    )
    return place, (np.array([0.6 * np.cos(2.0 * t), 0.1, -0.3 * np.cos(3.0 * t)]), TURN * np.cos(t))


def run(start: Start, impact: str, duration: float, dt: float, **options: object) -> cvi.Trajectory:
    scene, q, v = start
    traj = cvi.simulate(scene, *on_constraints(scene, q, v), duration=duration, dt=dt, impact=impact, **options)
    assert traj.status.ok
    return traj


def gap_gradient(traj: cvi.Trajectory, event: cvi.Event) -> np.ndarray:
    """W (nv,) from Pinocchio's Jacobians of the bodies at the place of the impact."""
    model, found = traj.scene.model, np.zeros(traj.scene.nv)
    data, shapes = model.createData(), traj.scene.collision_model
    pin.computeJointJacobians(model, data, event.q)
    pin.updateGlobalPlacements(model, data)
    for name, sign in zip(event.pair, (-1.0, 1.0), strict=True):
        joint = shapes.geometryObjects[shapes.getGeometryId(name)].parentJoint
        J = pin.getJointJacobian(model, data, joint, pin.WORLD)
        found += sign * event.normal @ (J[:3] - pin.skew(event.point) @ J[3:]) if joint else 0.0
    return found


def loop(model: pin.Model, ground: float, joint: str, arm: tuple[float, float, float]) -> list:
    return [Point((0, (ground, 0.0, 0.0)), (model.getJointId(joint), arm))]


# name -> (start by restitution, its constraints, duration)
SYSTEMS: dict[str, tuple[Callable[[float], Start], Callable[[pin.Model], list], float]] = {
    "linkage": (linkage_at_stop, lambda m: loop(m, 1.0, "hinge_rocker", (0.7, 0.0, 0.0)), 0.6),
    "five bars": (five_bar, lambda m: loop(m, 0.6, "j4", (BAR, 0.0, 0.0)), 0.6),
    "driven arm": (
        lambda e: driven_arm_at_wall(e, 0.0),
        lambda m: [Prescribed(m.getJointId("j1"), lambda t: (0.1 + crank(t)[0], *crank(t)[1:]))],
        0.3,
    ),
}


@pytest.mark.parametrize("restitution", [1.0, 0.6])
@pytest.mark.parametrize("impact", MAPS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_first_impact_is_that_of_the_oracle(name, impact, restitution):
    start, constraints, duration = SYSTEMS[name]
    dt = 0.01
    traj = run(start(restitution), impact, duration, dt)
    event = traj.events[0]
    assert event.fallback is None
    system = ConstrainedSystem(traj.scene.model, constraints(traj.scene.model))
    node = int(traj.events.array("step")[0])
    q0, p0, t0 = traj.q[node], traj.p[node], float(traj.t[node])
    assert event.before == pytest.approx(event.time - t0, abs=1e-12)
    assert event.before + event.after == pytest.approx(dt, abs=1e-12)
    before = system.step(q0, p0, t0, event.before)
    assert before.q == pytest.approx(event.q, abs=1e-11)
    assert before.p == pytest.approx(event.p_minus, abs=1e-9)
    gradient = gap_gradient(traj, event)
    impulse, p_plus = system.impact(before, q0, p0, t0, gradient, restitution, event.after, impact)
    explicit = -(1.0 + restitution) * event.gamma_minus / event.G_c
    assert event.impulse == pytest.approx(impulse, rel=1e-9)
    assert event.p_plus == pytest.approx(p_plus, abs=1e-8)
    assert abs(event.impulse - explicit) > 1e-7 * explicit  # it is not CTEC's


@pytest.mark.parametrize("impact", ["ctec", *MAPS])
def test_two_bodies_welded_onto_each_other_are_one(impact):
    """Of two bodies at one place, the momenta add up to those of a body with both inertias, impact by impact."""

    def falling(masses: tuple[float, ...]) -> cvi.Trajectory:
        scene = cvi.Scene()
        scene.add_box("body", (0.2, 0.3, 0.4), mass=masses[0])
        if len(masses) > 1:
            scene.add_box("other", (0.2, 0.3, 0.4), mass=masses[1])
            scene.add_weld("body", "other")
            scene.disable_pair("body", "other")
        scene.add_halfspace(name="ground")
        for pair in ("other",) if len(masses) > 1 else ():
            scene.disable_pair(pair, "ground")
        scene.set_contact(restitution=0.8, friction=0.0)
        turned = pin.Quaternion(pin.exp3(np.array([0.4, 0.3, 0.2]))).coeffs()
        q = np.tile(np.concatenate([[0.0, 0.0, 0.5], turned]), len(masses))
        v = np.tile([0.3, 0.2, -1.0, 1.0, -2.0, 0.5], len(masses))
        return cvi.simulate(scene, q, v, duration=0.5, dt=0.01, order=2, impact=impact)

    one, two = falling((1.0,)), falling((0.7, 0.3))
    assert len(one.events) == len(two.events) > 2
    assert not np.any(two.events.array("fallback"))
    assert two.events.array("impulse") == pytest.approx(one.events.array("impulse"), rel=1e-8)
    assert two.q[-1, :7] == pytest.approx(one.q[-1], abs=1e-8)


@pytest.mark.parametrize("impact", MAPS)
def test_a_pendulum_of_free_bodies_comes_to_that_of_a_tree(impact):
    """Two rods that points hold, at a wall: their error is of second order, like that of the tree."""

    def swing(dt: float, tree: bool) -> np.ndarray:
        model = arm(2)
        if not tree:  # the chain again, cut at both joints and held there
            model = pin.Model()
            for k in range(2):
                slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), f"x{k + 1}")
                slide = model.addJoint(slide, pin.JointModelPZ(), pin.SE3.Identity(), f"z{k + 1}")
                joint = model.addJoint(slide, pin.JointModelRY(), pin.SE3.Identity(), f"j{k + 1}")
                rod = pin.Inertia(1.0, np.array([0.5 * BAR, 0.0, 0.0]), np.diag([1e-4, BAR**2 / 12, BAR**2 / 12]))
                model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
        scene = with_tip(model, "j2", normal=(1.0, 0.0, 0.0), offset=0.2)
        if not tree:
            scene.add_point("world", "j1", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            scene.add_point("j1", "j2", (BAR, 0.0, 0.0), (0.0, 0.0, 0.0))
        scene.set_contact(restitution=0.8, friction=0.0)
        angles, rates = np.array([0.6, 0.9]), np.array([0.5, -0.3])
        if tree:
            q, v = np.array([0.6, 0.3]), np.array([0.5, -0.8])
            picked = np.array([[1.0, 0.0], [1.0, 1.0]])
        else:
            place = BAR * np.array([np.cos(angles[0]), -np.sin(angles[0])])
            moves = BAR * rates[0] * np.array([-np.sin(angles[0]), -np.cos(angles[0])])
            q = np.array([0.0, 0.0, angles[0], *place, angles[1]])
            v = np.array([0.0, 0.0, rates[0], *moves, rates[1]])
            picked = np.eye(6)[[2, 5]]
        traj = cvi.simulate(scene, q, v, duration=0.6, dt=dt, order=2, impact=impact)
        assert len(traj.events) >= 1
        assert not np.any(traj.events.array("fallback"))
        return np.concatenate([picked @ traj.q[-1], picked @ traj.v[-1]])

    exact = swing(2e-4, tree=True)
    errors = [np.abs(swing(dt, tree=False) - exact).max() for dt in (8e-3, 4e-3, 2e-3)]
    assert errors[0] > 6.0 * errors[2]
    assert errors[2] < 2e-3


def tangents(scene: cvi.Scene, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A basis of the directions (dq, dv) that keep constraints and their rates, as columns."""
    core, n = scene.core(), scene.nv

    def left(x: np.ndarray) -> np.ndarray:
        moved = pin.integrate(scene.model, q, x[:n])
        J = np.asarray(core.constraint_jacobian(moved, 0.0))
        rate = J @ (v + x[n:]) + core.constraint_rate(moved, 0.0)
        return np.concatenate([core.constraint_residual(moved, 0.0), rate])

    J = np.column_stack([(left(1e-5 * unit) - left(-1e-5 * unit)) / 2e-5 for unit in np.eye(2 * n)])
    _, size, directions = np.linalg.svd(J)
    return directions[int(np.sum(size > 1e-6 * size[0])) :].T


def symplectic_form(scene: cvi.Scene, p: np.ndarray, dq: np.ndarray, dp: np.ndarray) -> np.ndarray:
    """dq ^ dp between all columns, momenta in the axes of bodies: free ones add p . [dq, dq]."""
    form = dq.T @ dp - dp.T @ dq
    for joint, at in zip(scene.model.joints, scene.model.idx_vs, strict=True):
        if joint.nv != 6:
            continue
        force, moves = pin.Force(p[at : at + 6]), [pin.Motion(column[at : at + 6]) for column in dq.T]
        form += np.array([[force.dot(one.cross(other)) for other in moves] for one in moves])
    return form


def symplectic_defect(start: Start, impact: str, duration: float, impacts: int) -> float:
    """How far the symplectic form changes over the run, on the directions that keep the constraints."""
    scene, q, v = start
    q, v = on_constraints(scene, q, v)
    n, step, columns = scene.nv, 2e-6, []
    middle = run((scene, q, v), impact, duration, 0.01)
    for direction in tangents(scene, q, v).T:
        ends = []
        for k in (2.0, 1.0, -1.0, -2.0):
            moved = pin.integrate(scene.model, q, k * step * direction[:n]), v + k * step * direction[n:]
            traj = run((scene, *moved), impact, duration, 0.01)
            assert len(traj.events) == impacts
            turns = [pin.difference(scene.model, middle.q[node], traj.q[node]) for node in (0, -1)]
            ends.append(np.concatenate([turns[0], traj.p[0], turns[1], traj.p[-1]]))
        columns.append((8.0 * (ends[1] - ends[2]) - (ends[0] - ends[3])) / (12.0 * step))
    dq0, dp0, dq1, dp1 = np.split(np.array(columns).T, 4)
    before, after = (
        symplectic_form(scene, p, dq, dp) for p, dq, dp in ((middle.p[0], dq0, dp0), (middle.p[-1], dq1, dp1))
    )
    return float(np.abs(after - before).max())


@pytest.mark.parametrize(
    ("start", "duration"),
    [(lambda: five_bar(1.0), 0.45), (lambda: driven_arm_at_wall(1.0, 0.0), 0.35), (lambda: moved_pendulum(1.0), 0.28)],
    ids=["five bars", "driven arm", "moved pendulum"],
)
def test_dtec_keeps_the_symplectic_form(start, duration):
    """Also where a joint is driven, whose work is in its equation; CTEC shows that an impact need not."""
    assert symplectic_defect(start(), "dtec", duration, 1) < 1e-8
    assert symplectic_defect(start(), "ctec", duration, 1) > 1e-5
    assert symplectic_defect(start(), "ctec", 0.1, 0) < 1e-8


def test_constraints_have_a_modified_hamiltonian():
    """It varies in the fourth order of the step, where H varies in the second."""
    spread = []
    for dt in (4e-3, 2e-3):
        traj = run(five_bar(1.0), "ctec", 0.16, dt)
        assert len(traj.events) == 0
        spread.append([np.ptp(traj.modified_energy), np.ptp(traj.energy)])
    assert np.log2(spread[0][0] / spread[1][0]) > 3.7
    assert np.log2(spread[0][1] / spread[1][1]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("order", [4, 8])
def test_above_order_2_it_is_the_energy(order):
    """But not in runs for derivatives with an implicit map, whose steps have order 2."""
    scene, q, v = five_bar(1.0)
    runs = {
        (record, impact): cvi.simulate(scene, q, v, duration=0.16, dt=2e-3, order=order, record=record, impact=impact)
        for record in ("states", "gradient")
        for impact in ("ctec", "mhc")
    }
    low = runs.pop(("gradient", "mhc"))
    assert np.ptp(low.modified_energy) < 0.1 * np.ptp(low.energy)
    for high in runs.values():
        np.testing.assert_array_equal(high.modified_energy, high.energy)
        assert np.ptp(high.energy) < 0.1 * np.ptp(low.energy)


@pytest.mark.parametrize("pose", [False, True])
def test_the_modified_hamiltonian_changes_by_the_work_of_what_is_driven(pose):
    """Of an arm on a driven joint, and of one on a body that is moved: to the fourth order of the step."""
    spread = []
    for dt in (8e-3, 4e-3):
        scene, q, v = moved_pendulum() if pose else driven_arm_at_wall(1.0, 0.0)
        traj = run((scene, q, v), "ctec", 0.12, dt)
        assert len(traj.events) == 0
        work = traj.work.prescribed
        spread.append([np.ptp(traj.modified_energy - work), np.ptp(traj.energy - work)])
    assert np.log2(spread[0][0] / spread[1][0]) > 3.6
    assert np.log2(spread[0][1] / spread[1][1]) == pytest.approx(2.0, abs=0.3)


def test_mhc_keeps_the_energy_of_a_long_run():
    """Elastic impacts for 40 s: the modified energy of a linkage stays where it is, and walks with the other maps."""
    spread = {}
    for impact in ("ctec", *MAPS):
        traj = run(linkage_at_stop(1.0), impact, 40.0, 5e-3)
        assert len(traj.events) > 50
        spread[impact] = np.ptp(traj.modified_energy[1:].reshape(8, -1).mean(axis=1))
    assert spread["mhc"] < spread["ctec"] / 3.0 < spread["dtec"] / 3.0


@pytest.mark.parametrize("restitution", [1.0, 0.8])
def test_a_reference_of_the_run_does_not_drift_from_impact_to_impact(restitution):
    """At the ends of the steps with impacts the energy of the start is back, less all losses: with it alone."""
    left = {}
    for reference in ("local", "global"):
        traj = run(linkage_at_stop(restitution), "mhc", 1.9, 5e-3, mhc_reference=reference)
        assert not np.any(traj.events.array("fallback"))
        steps = np.unique(traj.events.array("step"))
        left[reference] = np.abs((traj.modified_energy + traj.impact_loss)[steps + 1] - traj.modified_energy[0]).max()
    assert left["global"] < 1e-12
    assert left["local"] > 1e-9


def test_a_reference_of_the_run_is_refused_beside_joint_friction():
    scene, q, v = linkage_at_stop(1.0)
    scene.set_joint("hinge_coupler", friction=0.1)
    with pytest.raises(cvi.InputError, match="joint friction"):
        cvi.simulate(scene, q, v, duration=0.1, dt=0.01, impact="mhc", mhc_reference="global")


@pytest.mark.parametrize("impact", MAPS)
@pytest.mark.parametrize("start", [lambda: linkage_at_stop(0.7), lambda: striker(0.8, 0.3), moved_pendulum])
def test_own_scalar_is_kept_to_rounding(start, impact):
    traj = run(start(), impact, 0.7, 2e-3)
    own = traj.events.array("fallback") == 0
    assert np.any(own)
    assert np.abs(traj.ledger.own_jump[own]).max() <= 1e-13 * traj.ledger.kinetic_energy.max()


@pytest.mark.parametrize("impact", MAPS)
def test_joint_friction_acts_in_the_steps_and_not_in_the_impact(impact):
    """The maps leave its work to the steps: impulses come to those of CTEC, in the second order of the step."""

    def first(impact: str, dt: float) -> cvi.Event:
        scene, q, v = driven_arm_at_wall(0.8, 0.0)
        for joint in ("j2", "j3"):
            scene.set_joint(joint, friction=0.2)
        return run((scene, q, v), impact, 0.3, dt).events[0]

    apart = []
    for dt in (0.01, 0.0025):
        own, explicit = first(impact, dt), first("ctec", dt)
        assert own.fallback is None
        apart.append(abs(own.impulse / explicit.impulse - 1.0))
    assert apart[0] < 2e-2
    assert apart[1] < 0.2 * apart[0]


def test_joint_friction_alone_leaves_the_maps_an_equation():
    """Of an arm without constraints."""
    for impact in MAPS:
        scene = with_tip(arm(2, friction=0.1), "j2", normal=(0.0, 0.0, 1.0), offset=-0.5)
        scene.set_contact(restitution=0.8, friction=0.0)
        traj = cvi.simulate(scene, np.array([0.3, 0.2]), np.zeros(2), duration=0.6, dt=5e-3, impact=impact)
        assert traj.events[0].fallback is None
        assert abs(traj.ledger.own_jump[0]) <= 1e-13 * traj.ledger.kinetic_energy.max()


def test_persistent_contact_leaves_no_equation():
    """While something persists the impulse is CTEC's and the event says so."""
    scene = cvi.Scene()
    scene.add_box("box", (0.2, 0.2, 0.2))
    scene.add_sphere("ball", 0.05)
    scene.add_sphere("weight", 0.05)
    scene.add_distance("ball", "weight", length=0.2)
    scene.add_halfspace(name="ground")
    scene.disable_pair("ball", "weight")
    scene.set_contact(restitution=0.5, friction=0.0)
    scene.set_contact("box", "ground", restitution=0.0)
    q = pin.neutral(scene.model)
    q[2], q[9], q[16] = 0.1, 0.3, 0.5
    traj = cvi.simulate(scene, q, np.zeros(scene.nv), duration=0.25, dt=0.01, impact="mhc")
    assert traj.events[0].pair == ("box_0", "ball_0") or "ball" in "".join(traj.events[0].pair)
    assert traj.events[0].fallback.startswith("persistent")
