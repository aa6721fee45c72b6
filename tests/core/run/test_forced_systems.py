"""Forced and constrained systems against an oracle by index reduction: convergence, loops, prescribed motions."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from helpers.element_oracles import Translator
from helpers.forced_systems import (
    FOUR_BAR,
    MODELS,
    PUPPET,
    SYSTEMS,
    System,
    four_bar,
    hinged_four_bar,
    model,
    puppet,
    sine,
)
from oracles import forced, joint_friction, strings
from oracles.slider_clearance import SPEEDS, SliderClearance

PHI = 1e-10  # [m, rad] what every node has to satisfy
FLOOR = 1e-9  # errors below it, relative to the size of the quantity, are the oracle's and rounding
BY_NAME = {system.name: system for system in SYSTEMS}


def residuals(traj: cvi.Trajectory) -> float:
    core = traj.scene.core()
    return max(float(np.abs(core.constraint_residual(q, t)).max()) for t, q in zip(traj.t, traj.q, strict=True))


def reactions(traj: cvi.Trajectory, nodes: np.ndarray) -> np.ndarray:
    """Those of all constraints at nodes, (n, m): means over the two steps around each, within O(dt^2)."""
    columns = [traj.reactions(c.name) for c in traj.constraints]
    both = np.column_stack(columns) if columns else np.zeros((len(traj), 0))
    return 0.5 * (both[nodes] + both[nodes + 1])


# -- convergence ------------------------------------------------------------------------------------------------------


def quantities(traj: cvi.Trajectory, nodes: np.ndarray, run: forced.Run) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What is compared at the nodes: measured and exact; q by its tangent difference."""
    far = [pin.difference(traj.scene.model, a, b) for a, b in zip(run.q[1:], traj.q[nodes], strict=True)]
    return {
        "q": (np.array(far), np.zeros(1)),
        "v": (traj.v[nodes], run.v[1:]),
        "kinetic": (traj.kinetic_energy[nodes], run.kinetic[1:]),
        "potential": (traj.potential_energy[nodes], run.potential[1:]),
        "input": (traj.work.input[nodes], run.work_input[1:]),
        "damping": (traj.work.damping[nodes], run.dissipated[1:]),
        "drive": (traj.work.prescribed[nodes], run.work_drive[1:]),
        "reactions": (reactions(traj, nodes), run.multipliers[1:]),
        "balance": (traj.ledger.energy_balance[nodes], np.zeros(1)),
    }


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.name)
@pytest.mark.slow
def test_order_two_against_the_oracle(system: System):
    """Configuration, velocity, energies, works and reactions: errors fall by 4 per halving of the step."""
    scene, q0, v0 = system.start()
    exact = Translator(scene)
    times = np.linspace(0.0, system.duration, 5)
    run = forced.solve(
        exact.model, q0, v0, times, [*exact.forces, *system.forces], exact.constraints, rtol=1e-11, atol=1e-12
    )
    assert run.misfit < 1e-9
    errors: dict[str, list[float]] = {}
    for dt in (system.dt, system.dt / 2.0, system.dt / 4.0):
        traj = cvi.simulate(scene, q0, v0, duration=system.duration + dt, dt=dt)
        if exact.constraints:
            assert residuals(traj) <= PHI
        nodes = np.rint(times[1:] / dt).astype(int)
        for name, (measured, wanted) in quantities(traj, nodes, run).items():
            size = 1.0 + np.abs(wanted).max(initial=0.0)
            errors.setdefault(name, []).append(float(np.abs(measured - wanted).max(initial=0.0)) / size)
    for name, (_, middle, fine) in errors.items():
        if middle > FLOOR:
            assert 3.8 < middle / fine < 4.25, (name, errors[name])
    assert max(errors["q"]) < 0.05


# -- loops that stay closed -------------------------------------------------------------------------------------------


def driven_for_ever(name: str, steps: int) -> cvi.Trajectory:
    scene, q0, v0 = BY_NAME[name].start()
    return cvi.simulate(scene, q0, v0, duration=steps * 2e-3, dt=2e-3)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["four_bar", "driven_lift", "nut_on_a_bar", "puppet", "welded_carts"])
def test_loops_stay_closed(name):
    assert residuals(driven_for_ever(name, 5000)) <= PHI


@pytest.mark.long
def test_a_puppet_dances_on_for_a_hundred_thousand_steps():
    traj = driven_for_ever("puppet", 100_000)
    assert residuals(traj) <= PHI
    balance = np.abs(traj.ledger.energy_balance).max()
    assert balance < 1e-3 * max(traj.work.damping[-1], 1.0)


@pytest.mark.long
def test_a_linkage_swings_on_for_a_hundred_thousand_steps():
    traj = driven_for_ever("four_bar", 100_000)
    assert residuals(traj) <= PHI
    tenths = np.array([part.mean() for part in np.array_split(traj.energy, 10)])
    assert np.ptp(tenths) < 0.02 * np.ptp(traj.energy)  # no drift: means over parts of wiggles


def test_a_run_with_constraints_is_no_contact():
    """The report of a run on its steps: constraints do not count as persistent contacts."""
    scene, q0, v0 = BY_NAME["four_bar"].start()
    assert cvi.simulate(scene, q0, v0, duration=0.01, dt=1e-3).stepping == "order 2, dt = 0.001 s"
    high = cvi.simulate(scene, q0, v0, duration=0.01, dt=1e-3, order=4).stepping
    assert high == "order 4, dt = 0.001 s"
    for_derivatives = {"duration": 0.01, "dt": 1e-3, "order": 4, "record": "gradient"}
    assert cvi.simulate(scene, q0, v0, **for_derivatives).stepping == high
    kept = cvi.simulate(scene, q0, v0, impact="mhc", **for_derivatives).stepping
    assert kept == "order 4, dt = 0.001 s, constraints met with order 2, dt = 0.001 s"


# -- redundant rows ---------------------------------------------------------------------------------------------------


def linkage(scene: cvi.Scene) -> cvi.Trajectory:
    q = scene.assemble(scene.configuration(FOUR_BAR), fixed=["hinge_crank"])
    v = scene.consistent_velocity(q, scene.velocity({"hinge_crank": 3.0}))
    return cvi.simulate(scene, q, v, duration=0.5, dt=2e-3)


def test_a_hinge_closes_as_a_point_does():
    point, hinge = linkage(four_bar()), linkage(hinged_four_bar())
    assert hinge.q == pytest.approx(point.q, abs=1e-9)


def test_a_loop_closed_three_times():
    """Two more points on the same pin: the same motion, and the three share the force."""
    scene = four_bar()
    for name in ("second", "third"):
        scene.add_point("world", "rocker", (1, 0, 0), (0.7, 0, 0), name=name)
    point, many = linkage(four_bar()), linkage(scene)
    assert many.q == pytest.approx(point.q, abs=1e-9)
    for name in ("loop", "second", "third"):
        assert 3.0 * many.reactions(name)[1:] == pytest.approx(point.reactions("loop")[1:], abs=1e-6)


def test_a_weld_makes_a_frame():
    """Three hinged bars whose end is welded to the ground cannot move; the reaction of the weld is that of statics.

    Six rows for three degrees of freedom. The moments about the three hinges vanish, with the weld's force and torque
    and the weights of what hangs behind each.
    """
    scene = model("four_bar")
    q = scene.configuration({"hinge_crank": 1.0, "hinge_coupler": -0.7, "hinge_rocker": -0.8})
    data = scene.model.createData()
    pin.forwardKinematics(scene.model, data, q)
    frame = data.oMi[3].copy()
    scene.add_weld("world", "rocker", frame, name="weld")
    traj = cvi.simulate(scene, q, duration=0.2, dt=2e-3)
    assert residuals(traj) <= PHI
    assert traj.q == pytest.approx(np.tile(q, (len(traj), 1)), abs=1e-12)
    force = np.kron(np.eye(2), frame.rotation) @ traj.reactions("weld")[-1]  # given in the axes of the weld
    gravity = pin.computeGeneralizedGravity(scene.model, data, q)
    J = pin.computeFrameJacobian(scene.model, data, q, scene.model.getFrameId("rocker"), pin.LOCAL_WORLD_ALIGNED)
    assert J.T @ force == pytest.approx(gravity, abs=1e-8)
    assert force[[1, 3, 5]] == pytest.approx(np.zeros(3), abs=1e-9)


# -- prescribed motions ------------------------------------------------------------------------------------------------


def test_a_winch_and_its_closed_form():
    """A ball on a string that is pulled in: angle, tension and work with order 2."""
    length = sine(-0.3, 2.0, 1.0)
    scene = cvi.Scene((0, 0, 0))
    ball = scene.add_sphere("ball", 0.03, mass=0.5, placement=(1.0, 0, 0))
    scene.add_distance("world", "ball", length=length, name="string")
    v0 = scene.consistent_velocity(v=scene.velocity({ball: (0, 2.0, 0)}))
    exact, errors = strings.DrivenString(length, 2.0, 0.5), []
    for dt in (5e-3, 2.5e-3):
        traj = cvi.simulate(scene, v0=v0, duration=1.0 + dt, dt=dt)
        k = round(1.0 / dt)
        assert residuals(traj) <= PHI
        angle = math.atan2(traj.q[k, 1], traj.q[k, 0]) % (2.0 * math.pi)
        pull = -reactions(traj, np.array([k]))[0, 0]
        errors.append([angle - exact.angle(1.0), pull - exact.tension(1.0), traj.work.prescribed[k] - exact.work(1.0)])
    ratio = np.array(errors[0]) / errors[1]
    assert np.all((ratio > 3.8) & (ratio < 4.2)), errors


def test_a_puppet_saved_and_restored_goes_on_to_the_bit():
    scene, q0, v0 = BY_NAME["puppet"].start()
    sim = cvi.Simulator(scene, dt=2e-3)
    sim.reset(q0, v0)
    sim.run(50)
    kept = sim.save()
    sim.run(100)
    first = sim.q, sim.p, sim.reaction("back")
    sim.load(kept)
    sim.run(100)
    assert all(np.array_equal(a, b) for a, b in zip(first, (sim.q, sim.p, sim.reaction("back")), strict=True))


def test_strings_of_the_puppet_are_driven():
    """The work of the seven strings: the sum of tension times speed over the steps, to O(dt^2)."""
    scene = puppet()
    q0 = scene.assemble(scene.configuration(PUPPET))
    gaps = []
    for dt in (4e-3, 2e-3):
        traj = cvi.simulate(scene, q0, scene.consistent_velocity(q0), duration=0.8, dt=dt)
        middle, work = 0.5 * (traj.t[1:] + traj.t[:-1]), 0.0
        for element in scene.elements:
            rate = np.array([element.length(t)[1] for t in middle])
            work += dt * (traj.reactions(element.name)[1:, 0] @ rate)
        gaps.append(abs(work - traj.work.prescribed[-1]))
    assert gaps[1] < max(0.3 * gaps[0], 1e-12)


# -- joint friction -------------------------------------------------------------------------------------------


def sledge(stiffness: float, friction: float, push: float = 0.0) -> cvi.Scene:
    """A mass of 2 kg on a rail along x, with a spring to its start."""
    rail = pin.Model()
    rail.gravity.linear = np.array([0.5 * push, 0.0, 0.0])
    joint = rail.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    rail.appendBodyToJoint(joint, pin.Inertia(2.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    scene = cvi.Scene.from_pinocchio(rail, name="sledge")
    scene.set_joint("slide", stiffness=stiffness, friction=friction)
    return scene


def test_a_sledge_stops_with_order_two():
    exact, errors = joint_friction.Slide(2.0, 3.0, 1.0), []
    for dt in (0.01, 0.005):
        traj = cvi.simulate(sledge(0.0, 3.0), [0.0], [1.0], duration=1.0, dt=dt)
        errors.append(np.abs(traj.q[:, 0] - [exact.state(t)[0] for t in traj.t]).max())
        assert np.ptp(traj.q[-20:, 0]) == 0.0
    assert errors[1] < max(0.3 * errors[0], 1e-13)


def test_a_sledge_on_a_spring_comes_to_rest_where_it_should():
    """Four turns and a stick. A turn inside a step that is solved as one of rest is off by f dt / m at most."""
    exact = joint_friction.SpringMass(2.0, 50.0, 3.0, 0.5)
    turns = len(exact.turns()) - 1
    for dt in (0.01, 0.0025):
        traj = cvi.simulate(sledge(50.0, 3.0), [0.5], duration=4.0, dt=dt)
        off = np.abs(traj.v[:, 0] - [exact.state(t)[1] for t in traj.t]).max()
        assert off < turns * 3.0 * dt / 2.0
        assert traj.q[-1, 0] == pytest.approx(exact.stick()[1], abs=0.02 * dt)
        assert traj.work.joint_friction[-1] == pytest.approx(exact.dissipated(), abs=0.5 * dt)
        assert np.ptp(traj.q[traj.t > exact.stick()[0] + dt, 0]) == 0.0


# -- slider with clearance ---------------------------------------------------------------------------------------


def slider(mu: float) -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_urdf(MODELS / "slider_crank.urdf", limits=False)
    scene.add_halfspace((0, 0, -1), -0.026, "upper")
    scene.add_halfspace((0, 0, 1), -0.026, "lower")
    scene.set_contact(restitution=0.4, friction=mu)
    return scene


@pytest.mark.parametrize("mu", [0.0, 0.01])
@pytest.mark.parametrize("turned", [0.0, 0.005])
def test_first_impacts_of_the_slider(mu, turned):
    """Times and speeds with order 2, impulses by the oracle's law at the state that was reached."""
    exact = SliderClearance(mu=mu)
    hits = exact.run(0.2, (0.0, 0.0, turned), most=5).impacts
    turn = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]])  # absolute angles from relative ones
    back, errors = np.linalg.inv(turn), []
    for dt in (2e-5, 1e-5, 5e-6):
        scene = slider(mu)
        traj = cvi.simulate(scene, back @ [0.0, 0.0, turned], back @ SPEEDS, duration=0.01, dt=dt)
        core, events = scene.core(), list(traj.events)[:5]
        for event, hit in zip(events, hits, strict=True):
            q = turn @ event.q
            before, after = (turn @ core.velocity(event.q[None], p[None])[0] for p in (event.p_minus, event.p_plus))
            assert np.abs(exact.gaps(q)[hit.corners]).max() <= 1e-12
            assert after == pytest.approx(exact.impact(q, before, hit.corners)[0], rel=1e-8, abs=1e-6)
            assert event.energy_change < 0.0
        errors.append([abs(event.time - hit.time) for event, hit in zip(events, hits, strict=True)])
        assert abs(events[0].gamma_minus - hits[0].gamma_minus.min()) < 1e-4 * (dt / 2e-5) ** 2
    ratio = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratio > 3.6) & (ratio < 4.4)), errors


def test_energy_of_the_slider_is_accounted_for():
    """Impacts, touchdowns with friction, sliding: what is left of the balance falls by 16 for a quarter of the step."""
    back, left = np.array([[1.0, 0, 0], [-1.0, 1.0, 0], [0, -1.0, 1.0]]), []
    for dt in (2e-5, 5e-6):
        traj = cvi.simulate(slider(0.01), v0=back @ SPEEDS, duration=0.1, dt=dt)
        assert traj.friction_loss[-1] > 1e-3
        left.append(np.abs(traj.ledger.energy_balance).max())
    assert left[0] / left[1] == pytest.approx(16.0, rel=0.1)


def test_a_touchdown_with_friction_is_accounted_for():
    """A box that falls flat and slides: constant forces, which the midpoint rule has exactly."""
    scene = cvi.Scene()
    scene.add_halfspace()
    box = scene.add_box("box", (0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.1))
    scene.set_contact(restitution=0.0, friction=0.4)
    traj = cvi.simulate(scene, v0=scene.velocity({box: (2, 0, 0)}), duration=0.45, dt=2e-3)
    assert traj.friction_loss[-1] > 1.0
    assert np.abs(traj.ledger.energy_balance).max() < 1e-12
