"""The ledger of a run against oracles, and the tolerances that make a run fail loudly."""

from __future__ import annotations

import itertools
import pathlib

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.records.codes import METHODS
from contactvi.run_settings import LEDGER_TOLERANCES
from helpers import laws
from helpers.run_scenes import slider_scene
from oracles import dtec_mhc
from oracles.del_step import System
from oracles.modified_energy import modified_energy

FILE = pathlib.Path(__file__).resolve().parents[2] / "models" / "double_pendulum_wall.toml"
EPS = float(np.finfo(float).eps)
maps = pytest.mark.parametrize("impact", METHODS)
OWN = {"ctec": "energy_jump", "dtec": "discrete_energy_jump", "mhc": "modified_energy_jump"}


def pendulum(impact: str, e: float = 0.7, **options) -> cvi.Trajectory:
    """Three seconds of problem B."""
    scene = cvi.load_scene(FILE)
    scene.set_contact(restitution=e)
    return cvi.simulate(scene, **{"duration": 3.0, "dt": 0.02, "impact": impact, **options})


def free_bodies() -> cvi.Scene:
    """Two spinning bodies that collide, without gravity."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_box("box", size=(0.4, 0.3, 0.2), mass=2.0)
    scene.add_sphere("ball", radius=0.1, mass=0.7, placement=(1.0, 0.08, 0.03))
    scene.v0 = scene.velocity({"box": ((1.0, 0.0, 0.0), (0.3, 0.5, -0.2)), "ball": (-1.5, 0.0, 0.0)})
    scene.set_contact(restitution=0.8)
    return scene


def spatial_momentum(model: pin.Model, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(linear, angular) of all bodies about the world's origin, shape (6,), from Pinocchio's centroidal momentum."""
    data = model.createData()
    centroidal = pin.computeCentroidalMomentum(model, data, q, np.linalg.solve(laws.mass_matrix(model, q), p))
    return np.concatenate([centroidal.linear, centroidal.angular + np.cross(data.com[0], centroidal.linear)])


# -- its quantities ---------------------------------------------------------------------------------------------------


@maps
def test_nodes_against_the_oracles(impact):
    traj = pendulum(impact)
    ledger, model = traj.ledger, traj.scene.model
    system = System(model)
    cut = set(traj.events.array("step"))
    assert ledger.energy.shape == ledger.modified_energy.shape == ledger.discrete_energy.shape == traj.t.shape
    # of energies of some 30 J, sums of a few terms; the discrete one behind a step solved to 1e-12
    for node in (0, 10, 40, 77, 149):
        q, p = traj.q[node], traj.p[node]
        assert ledger.energy[node] == pytest.approx(dtec_mhc.energy(system, q, p), abs=64 * EPS * 30)
        assert ledger.modified_energy[node] == pytest.approx(modified_energy(system, q, p, 0.02), abs=1e-11)
        if node not in cut:
            assert ledger.discrete_energy[node] == pytest.approx(
                dtec_mhc.discrete_energy(system, q, p, 0.02), abs=1e-11
            )
        momentum = np.concatenate([ledger.linear_momentum[node], ledger.angular_momentum[node]])
        assert momentum == pytest.approx(spatial_momentum(model, q, p), abs=1e-12)
    missing = np.flatnonzero(np.isnan(ledger.discrete_energy))
    assert set(missing) == cut | {len(traj) - 1}  # steps cut by an impact, and there is none after the last node
    np.testing.assert_array_equal(traj.discrete_energy, ledger.discrete_energy)


@maps
def test_jumps_against_the_oracles(impact):
    traj = pendulum(impact)
    ledger, model = traj.ledger, traj.scene.model
    system = System(model)
    assert len(traj.events) >= 2
    for i, event in enumerate(traj.events):
        kept = 1.0 - event.restitution**2
        loss = 0.5 * kept * event.gamma_minus**2 / event.G_c
        inverse = np.linalg.inv(laws.mass_matrix(model, event.q))
        kinetic = [0.5 * p @ inverse @ p for p in (event.p_minus, event.p_plus)]
        assert ledger.event_loss[i] == pytest.approx(loss, rel=1e-14)
        assert ledger.energy_jump[i] == pytest.approx(kinetic[1] - kinetic[0] + loss, abs=1e-13)
        before = dtec_mhc.discrete_energy(system, event.q, event.p_minus, -event.before)
        after = dtec_mhc.discrete_energy(system, event.q, event.p_plus, event.after)
        assert ledger.discrete_energy_jump[i] == pytest.approx(after - before + loss, abs=1e-11)
        # one impact per step here: the modified Hamiltonian jumps from node to node
        start, end = (modified_energy(system, traj.q[k], traj.p[k], 0.02) for k in (event.step, event.step + 1))
        assert ledger.modified_energy_jump[i] == pytest.approx(end - start + loss, abs=1e-11)
        assert ledger.complementarity[i] == event.gap * event.impulse
        assert ledger.impulse[i] == event.impulse
        jump = spatial_momentum(model, event.q, event.p_plus - event.p_minus)
        both = np.concatenate([ledger.linear_momentum_jump[i], ledger.angular_momentum_jump[i]])
        assert both == pytest.approx(jump, abs=1e-12)


@pytest.mark.parametrize("damping", [0.0, 0.2])
@pytest.mark.parametrize("order", [4, 8, 16])
@maps
def test_every_order_keeps_what_the_map_keeps(impact, order, damping):
    """Made again from the impacts, with the work of damping by the Gauss weights of the stages taken off."""
    scene = cvi.load_scene(FILE)
    scene.set_contact(restitution=0.7)
    scene.set_joint("joint_*", damping=damping)
    traj = cvi.simulate(scene, duration=3.0, dt=0.05, impact=impact, order=order)
    ledger = traj.ledger
    assert len(traj.events) >= 2
    assert not np.any(traj.events.array("fallback"))
    own = getattr(ledger, OWN[impact])
    # 1e-12: tolerance of a step, of some 30 J
    assert np.abs(own).max() <= 1e-12 * 30
    assert np.abs(ledger.own_jump).max() <= 1e-12 * 30
    np.testing.assert_array_equal(ledger.modified_energy, ledger.energy)
    others = [np.abs(getattr(ledger, name)).max() for name in OWN.values()]
    assert max(others) <= 10.0 * 0.05**order * 30 + 1e-12 * 30  # the scalars differ by the error of the step
    cut = set(traj.events.array("step"))
    assert set(np.flatnonzero(np.isnan(ledger.discrete_energy))) == cut | {len(traj) - 1}


@maps
def test_several_impacts_in_one_step_add_up(impact):
    """The jumps of the modified Hamiltonian of one step add up to that from its first node to its last."""
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.1, mass=0.5, placement=(0.0, 0.0, 0.25))
    scene.add_halfspace(name="floor")
    scene.add_halfspace(normal=(0.0, 0.0, -1.0), offset=-0.5, name="ceiling")
    scene.set_contact(restitution=0.9)
    scene.v0 = scene.velocity({"ball": (0.0, 0.0, -10.0)})
    traj = cvi.simulate(scene, duration=0.4, dt=0.05, impact=impact)
    most = 0
    for step, group in itertools.groupby(range(len(traj.events)), key=lambda i: traj.events[i].step):
        of_step = list(group)
        most = max(most, len(of_step))
        total = traj.ledger.modified_energy_jump[of_step].sum() - traj.events.loss[of_step].sum()
        expected = traj.modified_energy[step + 1] - traj.modified_energy[step]
        assert total == pytest.approx(expected, abs=1e-12 * traj.energy[0])
    assert most >= 2


def test_momenta_of_free_bodies():
    traj = cvi.simulate(free_bodies(), duration=1.0, dt=0.01)
    ledger = traj.ledger
    assert len(traj.events) >= 1
    # 1e-12: tolerance of a step and of an impact, of momenta of about 1
    assert np.abs(ledger.linear_momentum - ledger.linear_momentum[0]).max() <= 1e-11
    assert np.abs(ledger.angular_momentum - ledger.angular_momentum[0]).max() <= 1e-11
    assert np.abs(ledger.linear_momentum_jump).max() <= 1e-12
    assert np.abs(ledger.angular_momentum_jump).max() <= 1e-12


def test_a_run_without_events_or_with_few_nodes():
    traj = pendulum("ctec", duration=0.4)
    assert len(traj.events) == 0
    assert traj.ledger.energy_jump.shape == traj.ledger.discrete_energy_jump.shape == (0,)
    assert traj.ledger.modified_energy_jump.shape == traj.ledger.own_jump.shape == (0,)
    assert traj.ledger.linear_momentum_jump.shape == (0, 3)
    every, some = pendulum("mhc"), pendulum("mhc", record_every=7)
    np.testing.assert_array_equal(some.ledger.own_jump, every.ledger.own_jump)
    np.testing.assert_array_equal(some.ledger.modified_energy_jump, every.ledger.modified_energy_jump)
    same = every.discrete_energy[np.rint(some.t / 0.02).astype(int)]
    # Newton starts from what the state before left: equal to the tolerance of a step
    assert some.discrete_energy[:-1] == pytest.approx(same[:-1], abs=1e-12 * 30, nan_ok=True)


def test_with_inputs_steps_are_not_made_again():
    push = np.full((150, 2), 0.05)
    traj = pendulum("mhc", control=push)
    assert traj.forced
    assert np.isnan(traj.discrete_energy).all()
    assert np.isnan(traj.ledger.modified_energy_jump).all()
    assert np.abs(traj.ledger.own_jump).max() <= 1e-11  # the engine's own
    assert not pendulum("mhc", control=0.0 * push).forced


# -- tolerances -------------------------------------------------------------------------------------------------------


@maps
def test_what_holds_does_not_change_the_run(impact):
    bounds = {"own_jump": 1e-11, OWN[impact]: 1e-11, "complementarity": 1e-12, "gap": 1e-10, "impulse": 0.0}
    watched, free = pendulum(impact, ledger=bounds, duration=30.0), pendulum(impact, duration=30.0)
    assert watched.status.ok
    np.testing.assert_array_equal(watched.q, free.q)
    np.testing.assert_array_equal(watched.events.array("impulse"), free.events.array("impulse"))


@maps
def test_what_does_not_hold_fails_loudly(impact):
    """Every scalar but the map's own ends the run at its first impact; the trajectory up to there is attached."""
    free = pendulum(impact, duration=30.0)
    for name in set(OWN.values()) - {OWN[impact]}:
        with pytest.raises(
            cvi.SimulationError, match=f"exceeds a tolerance of its ledger.*LEDGER: {name} is"
        ) as caught:
            pendulum(impact, ledger={name: 1e-8, "own_jump": 1e-11}, duration=30.0)
        status, traj = caught.value.status, caught.value.trajectory
        assert status.code == cvi.StatusCode.LEDGER == 8
        assert status.time == free.events[0].time
        assert traj.status == status
        assert len(traj.events) == 1
        assert traj.t[-2] < status.time <= traj.t[-1]
        np.testing.assert_array_equal(traj.q, free.q[: len(traj)])
        assert "trajectory.ledger" in caught.value.remedy
    quiet = pendulum(impact, ledger={"own_jump": 1e-30}, throw=False, duration=30.0)
    assert quiet.status.code == (cvi.StatusCode.LEDGER if np.any(quiet.events.array("jump")) else quiet.status.code)


@pytest.mark.parametrize(
    ("name", "bound"),
    [("energy", 1e-6), ("modified_energy", 1e-12), ("discrete_energy", 1e-6), ("linear_momentum", 0.1),
     ("angular_momentum", 0.1), ("linear_momentum_jump", 1.0), ("angular_momentum_jump", 1.0),
     ("complementarity", 0.0), ("gap", 0.0)],
)  # fmt: skip
def test_every_tolerance_can_be_exceeded(name, bound):
    """On a pendulum at a wall, which gives momentum; at the time of the first node or impact that is over the bound."""
    traj = pendulum("ctec", ledger={name: bound}, throw=False)
    assert traj.status.code == cvi.StatusCode.LEDGER
    assert name in traj.status.message
    free = pendulum("ctec")
    values = getattr(free.ledger, name)
    if name in ("energy", "modified_energy", "discrete_energy"):
        scale = np.maximum.accumulate(free.kinetic_energy)
        over = np.abs(values + free.ledger.loss - values[0]) > bound * scale
    elif name.endswith("_momentum"):
        over = np.linalg.norm(values - values[0], axis=1) > bound
    else:
        over = (np.abs(values) if values.ndim == 1 else np.linalg.norm(values, axis=1)) > bound
    times = free.events.array("time") if len(over) == len(free.events) else free.t
    assert traj.status.time == times[np.flatnonzero(over)[0]]


def test_every_tolerance_is_known():
    """And bounds that nothing exceeds let the run pass: each name is computed."""
    assert pendulum("mhc", ledger=dict.fromkeys(LEDGER_TOLERANCES, 1e3)).status.ok


def test_conserved_momentum_of_free_bodies_holds():
    bounds = {name: 1e-11 for name in LEDGER_TOLERANCES if "momentum" in name}
    assert cvi.simulate(free_bodies(), duration=1.0, dt=0.01, impact="dtec", ledger=bounds).status.ok


def test_blocks_make_no_difference():
    """Step by step and in blocks: the same excess at the same time, beyond the first block."""
    free = pendulum("dtec", 1.0, duration=60.0)
    drift = np.abs(free.modified_energy - free.modified_energy[0]) / np.maximum.accumulate(free.kinetic_energy + 1e-9)
    bounds = {"modified_energy": 0.8 * float(drift[100:].max())}
    assert not np.any(drift[:600] > bounds["modified_energy"])
    whole = pendulum("dtec", 1.0, duration=60.0, ledger=bounds, throw=False)
    sim = cvi.Simulator(free.scene, dt=0.02, impact="dtec", ledger=bounds)
    sim.reset()
    while sim.step().ok:
        assert sim.t < 60.0
    assert sim.status == whole.status
    assert whole.status.code == cvi.StatusCode.LEDGER
    assert len(whole.t) == len(sim.trajectory().t)
    with pytest.raises(cvi.SimulationError, match="has ended"):
        sim.step()
    assert sim.reset() is None
    assert sim.step().ok


def test_joint_limits_are_in_the_ledger():
    traj = cvi.simulate(slider_scene(0.5), duration=0.5, dt=0.01, impact="dtec", ledger={"own_jump": 1e-11})
    assert {event.kind for event in traj.events} == {"limit"}
    assert np.abs(traj.ledger.discrete_energy_jump).max() <= 1e-11 * traj.kinetic_energy.max()


# -- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ledger", "text"),
    [
        ({"energy_jmp": 1e-9}, "Did you mean 'energy_jump'"),
        ({"own_jump": -1.0}, "a number >= 0 that fits in a float, got -1.0"),
        ({"own_jump": float("nan")}, "nan"),
        ({"own_jump": "small"}, "'small'"),
        ({"own_jump": True}, "True"),
        (1e-9, "1e-09"),
        ([], r"\[\]"),
    ],
)
def test_bad_tolerances(ledger, text):
    with pytest.raises(cvi.InputError, match=text) as caught:
        pendulum("ctec", ledger=ledger)
    assert caught.value.name == "ledger"


def test_tolerances_that_inputs_would_blind_are_refused():
    with pytest.raises(cvi.InputError, match="cannot hold modified_energy_jump in a run with inputs"):
        pendulum("mhc", ledger={"modified_energy_jump": 1e-9}, control=np.full((150, 2), 0.05))
    assert pendulum("mhc", ledger={"own_jump": 1e-9}, control=np.full((150, 2), 0.05)).status.ok
