"""The polynomials of the steps: states between the nodes, samples, frames for pictures, and how they are stored."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.playback import animation
from contactvi.trajectory import polynomials as dense
from contactvi.trajectory.compiled import compile_scene
from helpers import laws
from helpers.run_scenes import GRAVITY, HEIGHT, RADIUS, ball_scene

EPS = np.finfo(float).eps
FILE = Path(__file__).resolve().parents[2] / "models" / "double_pendulum_wall.toml"


def pendulum(order: int, dt: float, duration: float = 0.64, **options) -> cvi.Trajectory:
    """Problem B before its first impact."""
    return cvi.simulate(cvi.load_scene(FILE), duration=duration, dt=dt, order=order, **options)


@pytest.fixture(scope="module")
def exact() -> cvi.Trajectory:
    """Its polynomials are exact to rounding: order 16 with steps of 5 ms."""
    return pendulum(16, 0.005)


@pytest.fixture(scope="module")
def wall() -> cvi.Trajectory:
    """Problem B with its two impacts, at long steps."""
    return pendulum(8, 0.05, 3.0)


@pytest.fixture(scope="module")
def tumbling() -> cvi.Trajectory:
    """A box that turns about all axes, without gravity, and flies."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    scene.add_box("box", size=(0.4, 0.3, 0.1), mass=2.0)
    v0 = scene.velocity({"box": ((1.0, -0.5, 0.2), (0.3, 5.0, -0.2))})
    return cvi.simulate(scene, None, v0, duration=2.0, dt=0.1, order=12)


# -- at ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["wall", "tumbling"])
def test_nodes_are_met(name, request):
    """At the nodes the polynomials are the run itself: they end in its configurations and velocities."""
    traj = request.getfixturevalue(name)
    state = traj.at(traj.t)
    for a, b in zip(state.q, traj.q, strict=True):
        assert np.linalg.norm(laws.displacement(traj.scene.model, a, b)) <= 64 * EPS * max(1.0, np.abs(b).max())
    assert state.v == pytest.approx(traj.v, abs=1e3 * EPS * np.abs(traj.v).max())
    assert state.p == pytest.approx(traj.p, abs=1e3 * EPS * np.abs(traj.p).max())


def test_momentum_is_that_of_the_velocity(wall):
    model = wall.scene.model
    state = wall.at(np.linspace(0.0, 3.0, 13))
    for q, v, p in zip(state.q, state.v, state.p, strict=True):
        assert p == pytest.approx(laws.mass_matrix(model, q) @ v, abs=64 * EPS * np.abs(p).max())


@pytest.mark.parametrize("order", [4, 6, 8])
def test_order_between_the_nodes(order, exact):
    """O(h^(s+2)) with s = order / 2 stages: the error of the stages, which the raised polynomial keeps."""
    times = np.linspace(0.01, 0.63, 201)
    # twice as long steps at order 8, whose errors are near rounding with the others
    steps = np.array([0.08, 0.04, 0.02]) * (2.0 if order == 8 else 1.0)
    errors = [np.abs(pendulum(order, float(dt)).at(times).q - exact.at(times).q).max() for dt in steps]
    assert laws.orders(errors)[-1] >= order // 2 + 2 - 0.25, errors


@pytest.mark.parametrize("tol", [1e-6, 1e-8, 1e-10])
def test_states_to_a_tolerance(tol, exact):
    """From partial steps, and from the polynomials of steps that leave out no more: both are as accurate as asked.

    Of steps of all lengths, so that with each tolerance both are there.
    """
    core, most = compile_scene(exact.scene).core, 0.0
    for dt in (0.16, 0.08, 0.04, 0.02, 0.01):
        traj = pendulum(8, dt)
        times = np.linspace(0.0, traj.t[-1], 102)[1:-1]
        segments, reference = dense.Segments(traj.segments.arrays, 8, tol), exact.at(times)
        (q, v), (bare, _) = (segments.states(core, times, exact=exactly) for exactly in (True, False))
        speed = np.linalg.norm(exact.v, axis=1).max()
        nodes = exact.at(traj.t)
        off, off_v = np.abs(traj.q - nodes.q).max(), np.abs(traj.v - nodes.v).max()
        assert np.abs(q - reference.q).max() <= tol * speed * dt + off
        assert np.abs(v - reference.v).max() <= tol * speed + off_v
        again, p = segments.exact_momenta(core, times)
        np.testing.assert_array_equal(again, q)
        np.testing.assert_allclose(p, core.momentum(q, v), atol=1e3 * EPS * np.abs(p).max(), rtol=0.0)
        most = max(most, np.abs(bare - reference.q).max() / (tol * speed * dt + off))
    assert most > 1.0  # the polynomials of the longest steps are not


def test_velocity_is_the_derivative_of_the_configuration(exact):
    """Central differences of sixth order with 1 ms: exact to rounding / 1 ms."""
    times, e = np.array([0.1234, 0.3456, 0.5]), 1e-3
    rate = sum(weight * exact.at(times + k * e).q for k, weight in laws._STENCIL) / e
    assert exact.at(times).v == pytest.approx(rate, abs=1e2 * EPS / e)


def test_an_impact_has_two_sides(wall):
    """At its time the state after it; a moment before, the one before. The configuration does not jump."""
    model = wall.scene.model
    assert len(wall.events) == 2
    for event in wall.events:
        inverse = np.linalg.inv(laws.mass_matrix(model, event.q))
        after, before = wall.at(event.time), wall.at(event.time - 1e-9)
        assert after.q == pytest.approx(event.q, abs=1e-12)
        assert after.v == pytest.approx(inverse @ event.p_plus, abs=1e-10)
        assert before.v == pytest.approx(inverse @ event.p_minus, abs=1e-6)
        assert before.q == pytest.approx(event.q, abs=1e-7)


def test_one_time_and_many(wall):
    one, many = wall.at(1.0), wall.at([1.0])
    assert isinstance(one, cvi.State)
    assert (one.t, one.q.shape, one.v.shape, one.p.shape) == (1.0, (2,), (2,), (2,))
    assert (many.t.shape, many.q.shape, many.v.shape, many.p.shape) == ((1,), (1, 2), (1, 2), (1, 2))
    np.testing.assert_array_equal(many.q[0], one.q)
    backward = wall.at(np.array([2.0, 1.0, 0.0]))
    np.testing.assert_array_equal(backward.q[1], one.q)
    assert wall.at([]).q.shape == (0, 2)


@pytest.mark.parametrize("time", [-1e-3, 3.001, np.nan, "soon"])
def test_outside_the_run(wall, time):
    with pytest.raises(cvi.InputError, match=r"expected a time in \[0, 3\] s"):
        wall.at(time)


def test_without_polynomials():
    for traj in (pendulum(2, 0.02), pendulum(8, 0.02, dense=False)):
        assert traj.segments is None
        with pytest.raises(cvi.InputError, match="Run it with dense=True") as caught:
            traj.at(0.1)
        assert caught.value.name == "dense"
        assert traj.resample([0.1]).shape == (1, 2)


def test_order_two_keeps_them_when_asked(exact):
    """Cubic Hermite through the nodes: as accurate as these, of order 2."""
    times = np.linspace(0.01, 0.63, 101)
    errors = [np.abs(pendulum(2, dt, dense=True).at(times).q - exact.at(times).q).max() for dt in (0.02, 0.01, 0.005)]
    assert laws.orders(errors) == pytest.approx([2.0, 2.0], abs=0.1)


def test_flight_is_a_parabola():
    """Between impacts a ball's polynomial is exact, whatever the step and however it spins."""
    scene = ball_scene()
    v0 = scene.velocity({"ball": ((0.5, -0.2, 0.0), (0.0, 3.0, 7.0))})
    traj = cvi.simulate(scene, None, v0, duration=0.4, dt=0.2, order=4)
    times = np.linspace(0.0, 0.4, 41)
    assert traj.at(times).q[:, 2] == pytest.approx(RADIUS + HEIGHT - 0.5 * GRAVITY * times**2, abs=1e-12)
    assert traj.at(times).q[:, 0] == pytest.approx(0.5 * times, abs=1e-12)


def test_steps_of_a_simulator_are_joined():
    scene = cvi.load_scene(FILE)
    sim = cvi.Simulator(scene, dt=0.05, order=8)
    sim.reset()
    for _ in range(20):
        assert sim.step().ok
    whole = pendulum(8, 0.05, 1.0)
    times = np.linspace(0.0, 1.0, 77)
    # Each call starts the stage iterations anew: equal to the tolerance of the equations.
    assert sim.trajectory().at(times).q == pytest.approx(whole.at(times).q, abs=1e-10)


# -- samples ----------------------------------------------------------------------------------------------------------


def test_samples_are_states_of_the_run(wall):
    traj = pendulum(8, 0.05, 3.0, sample_dt=0.013)
    assert traj.t[:-1] == pytest.approx(0.013 * np.arange(len(traj) - 1), abs=8 * EPS)
    assert traj.t[-1] == wall.t[-1]
    state = wall.at(traj.t)
    assert traj.q == pytest.approx(state.q, abs=64 * EPS)
    assert traj.p == pytest.approx(state.p, abs=1e3 * EPS * np.abs(state.p).max())
    np.testing.assert_array_equal(traj.q[-1], wall.q[-1])
    np.testing.assert_array_equal(traj.events.array("time"), wall.events.array("time"))
    assert traj.stats.steps == 60
    assert np.ptp(traj.energy) <= 1e-5 * traj.kinetic_energy.max()  # the path's error at steps of 50 ms, no drift


@pytest.mark.parametrize(("end", "step", "count"), [(1.0, 0.1, 11), (1.0, 0.3, 5), (0.25, 1.0, 2), (1.0, 1 / 3, 4)])
def test_sample_times(end, step, count):
    times = dense.sample_times(0.0, end, step)
    assert len(times) == count
    assert times[-1] == end
    assert np.diff(times)[:-1] == pytest.approx(np.full(count - 2, step))


# -- pictures and files -----------------------------------------------------------------------------------------------


def test_pictures_of_long_steps_are_smooth(exact):
    """Nodes a tenth of a second apart, 60 frames a second: off by what a chord of 1/60 s is."""
    traj = pendulum(12, 0.16)
    assert len(traj) == 5
    frames = animation.frames_of(traj, 60.0)
    times = frames.times
    assert np.diff(times).max() <= 1.1 / 60.0
    q = traj.resample(times)
    acceleration = 2.0 * 9.81 / 1.0
    assert np.abs(q - exact.at(times).q).max() <= acceleration * (1 / 60) ** 2 / 8
    model, data = traj.scene.model, traj.scene.model.createData()
    pin.forwardKinematics(model, data, q[7])
    assert frames.poses[2].position[7] == pytest.approx(data.oMi[2].translation, abs=1e-12)


def test_dense_nodes_need_no_frames():
    assert len(pendulum(8, 0.01).frames[0]) == 0
    assert len(pendulum(2, 0.04).frames[0]) == 0


def test_round_trip(wall, tmp_path):
    loaded = cvi.Trajectory.load(wall.save(tmp_path / "run.npz"))
    assert loaded.options == wall.options
    assert loaded.options.order == 8
    assert loaded.segments is not None
    assert wall.segments is not None
    for name, values in wall.segments.arrays.items():
        np.testing.assert_array_equal(loaded.segments.arrays[name], values)
    assert np.isnan(loaded.error_estimate)
    assert loaded.adaptive_steps is None
    times = np.linspace(0.0, 3.0, 50)
    np.testing.assert_array_equal(loaded.resample(times), wall.resample(times))
    # inertias are rounded on their way through plain data
    assert loaded.at(times).q == pytest.approx(wall.at(times).q, abs=1e-12)


def test_replay_of_long_steps_needs_no_engine(wall, tmp_path):
    wall.save(tmp_path / "run.npz")
    program = """
import sys
sys.modules["contactvi._core"] = None
import contactvi as cvi
traj = cvi.Trajectory.load("run.npz")
traj.to_html("run.html")
cvi.plot(traj).savefig("run.png")
print(traj.resample([0.1234])[0, 0])
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(cvi.__file__).parents[1])}
    command = [sys.executable, "-c", program]
    run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert float(run.stdout) == wall.resample([0.1234])[0, 0]


def rewrite(path: Path, change) -> None:
    """Let `change` alter the entries (and the header as a dictionary) of a stored run."""
    with np.load(path) as file:
        entries = {name: file[name] for name in file.files}
    header = json.loads(str(entries["header"]))
    change(entries, header)
    entries["header"] = np.array(json.dumps(header))
    np.savez(path, **entries)


@pytest.mark.parametrize(
    "change",
    [
        lambda e, h: e.pop("segment/rates"),
        lambda e, h: e.update({"segment/rates": e["segment/rates"][:, :4]}),
        lambda e, h: e.update({"segment/q": np.full_like(e["segment/q"], np.nan)}),
        lambda e, h: e.update({"segment/t": e["segment/t"][::-1].copy()}),
        lambda e, h: e.update({"segment/h": 0.0 * e["segment/h"]}),
        lambda e, h: e.update({"segment/p": e["segment/p"].astype(np.float32)}),
        lambda e, h: e.update({"frame/q": e["frame/q"][:-1]}),
        lambda e, h: e.update({"frame/time": np.full_like(e["frame/time"], np.inf)}),
        lambda e, h: h["options"].update({"order": 10}),
    ],
)
def test_damaged_segments_are_refused(wall, tmp_path, change):
    path = wall.save(tmp_path / "run.npz")
    rewrite(path, change)
    with pytest.raises(cvi.SceneError, match="Cannot read the run"):
        cvi.Trajectory.load(path)
