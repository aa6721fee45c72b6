"""Dense steps in a run: when they are taken, what is recorded and said of them, bounds on them, what is refused."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

import contactvi as cvi
from contactvi.bench import heaps
from contactvi.bench.heap_gaps import GapCheck
from contactvi.commands.cli import app
from contactvi.commands.summary import summary
from contactvi.records import dense_steps
from contactvi.records.codes import StepKind
from helpers.run_scenes import ball_scene, funnel

SPAN = 0.25  # [s]
ROUNDING = 1e-13  # relative, of energies that are differences over hundreds of steps
NOISE = 1e-9  # [m] of coal's distance of two cylinders
SHORTEST_RISE = 1e-9  # of the largest kinetic energy; (dt / 64)^2 over (0.1 s)^2, the time in which motions change


def tower() -> cvi.Scene:
    """Three boxes on each other, turned and aside, the lowest on the ground."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k, (height, angle) in enumerate(((0.1, 0.2), (0.08, 0.9), (0.12, 1.7))):
        middle = (0.01 * k, -0.006 * k, (0.05, 0.14, 0.24)[k] + 1e-3 * (k + 1))
        scene.add_box(f"box{k}", size=(0.2, 0.18, height), mass=1.0 + k, placement=(middle, (0.0, 0.0, angle)))
    scene.set_contact(restitution=0.2, friction=0.5)
    return scene


def heap_run(**options) -> cvi.Trajectory:
    """The funnel at a step of 1 ms."""
    return cvi.simulate(funnel(), duration=SPAN, dt=1e-3, max_impacts_per_step=200, **options)


def tower_run(**options) -> cvi.Trajectory:
    """The tower by dense steps alone."""
    return cvi.simulate(tower(), duration=0.1, dt=1e-3, contact_mode="steps", **options)


@pytest.fixture(scope="module")
def heap() -> cvi.Trajectory:
    with pytest.warns(cvi.DenseStepWarning):
        return heap_run()


@pytest.fixture(scope="module")
def stack() -> cvi.Trajectory:
    return tower_run()


# -- switching --------------------------------------------------------------------------------------------------------


def test_a_heap_goes_on_by_dense_steps(heap):
    assert heap.status.ok
    assert 0 < len(heap.dense_steps) == heap.stats.dense_steps
    assert len(heap.events) > 0  # while they did not accumulate they were located
    assert heap.dense_steps.span < SPAN


def test_events_alone_end_with_a_status():
    traj = heap_run(contact_mode="events", throw=False)
    assert traj.status.code == cvi.StatusCode.TOO_MANY_IMPACTS
    assert len(traj.dense_steps) == traj.stats.dense_steps == 0
    assert "dense" not in traj.stepping
    assert "dense" not in dict(summary(traj))
    with pytest.raises(cvi.SimulationError, match="contact_mode='auto' goes on with dense steps"):
        heap_run(contact_mode="events")


def test_steps_alone_locate_nothing(stack):
    assert stack.status.ok
    assert len(stack.events) == 0
    assert stack.dense_steps.span == pytest.approx(0.1, rel=1e-12)
    np.testing.assert_array_equal(stack.phases["persistent"], [StepKind.DENSE])
    assert np.all(stack.ledger.persistent)


def test_many_resting_points_are_stepped_densely():
    """Seven boxes side by side have 28 points on the ground: at rest to rounding, and it carries their weight."""
    scene = cvi.Scene()
    scene.add_halfspace()
    boxes = [scene.add_box(f"box{k}", size=(0.1, 0.1, 0.1), placement=(0.1 * k, 0.0, 0.05)) for k in range(7)]
    scene.set_contact(restitution=0.0, friction=0.5)
    with pytest.warns(cvi.DenseStepWarning):
        traj = cvi.simulate(scene, duration=0.02, dt=1e-3)
    assert traj.dense_steps.span == pytest.approx(0.02, rel=0.1)
    assert np.abs(traj.q - traj.q[0]).max() <= 1e-12
    for box in boxes:  # of four points: each to the solver's tolerance, 1e-8 of g h, times m / h
        times, force = traj.contacts.on(box)
        assert len(times) == 20
        np.testing.assert_allclose(force, np.tile([0.0, 0.0, 9.81], (20, 1)), atol=1e-6)


@pytest.mark.parametrize(("options", "longest"), [({}, 1e-3), ({"dt_contact": 3e-3}, 3e-3)])
def test_dense_steps_have_the_length_of_steps_with_persistent_contacts(options, longest):
    traj = cvi.simulate(tower(), duration=0.1, dt=0.01, order=4, contact_mode="steps", **options)
    lengths = traj.dense_steps.h
    parts = np.ceil(0.01 / longest)
    np.testing.assert_allclose(lengths[lengths > 0.3 * longest], 0.01 / parts, rtol=1e-9)
    assert lengths.sum() == pytest.approx(0.1, rel=1e-12)


def test_a_bouncing_ball_never_takes_a_dense_step():
    """Its impacts accumulate at one contact: bouncing ends with a plastic impact and the contact persists."""
    scene = ball_scene(restitution=0.7)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        traj = cvi.simulate(scene, duration=4.0, dt=1e-3)
    assert "bouncing ended" in {change.change for change in traj.contact_changes}
    assert len(traj.dense_steps) == traj.stats.dense_steps == 0
    assert set(traj.phases["kind"]) == {"free", "persistent"}


def test_short_steps_alone_are_no_reason_for_dense_ones():
    """Twice as many steps with a persistent contact as events may cost, none of which an event has cut."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", size=(0.1, 0.1, 0.1), placement=(0.0, 0.0, 0.05))
    scene.set_contact(restitution=0.0, friction=0.1)
    v0 = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    traj = cvi.simulate(scene, v0=v0, duration=0.004, dt=2e-6)
    assert len(traj.dense_steps) == 0
    assert traj.ledger.persistent.sum() >= 1990
    np.testing.assert_allclose(traj.q[-1, 0], 0.5 * 0.004 - 0.5 * 0.981 * 0.004**2, rtol=1e-12)  # 2000 sums


def balls_in_a_pipe(count: int) -> cvi.Scene:
    """Balls fall onto each other between four walls that leave them little room."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k, normal in enumerate([(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)]):
        scene.add_halfspace(normal, -0.06, name=f"wall{k}")
    for k in range(count):
        place = (0.009 * (-1) ** k, 0.005 * (-1) ** (k // 2), 0.06 + 0.11 * k)
        scene.add_sphere(f"ball{k}", 0.05, placement=place)
    scene.set_contact(restitution=0.3, friction=0.5)
    return scene


def test_what_many_contacts_do_is_not_located_for_long():
    """Two balls have few modes of contact (open, sticking, sliding), and all of their impacts are located."""
    two = cvi.simulate(balls_in_a_pipe(2), duration=0.5, dt=1e-3)
    assert len(two.dense_steps) == 0
    assert len(two.events) > 200
    with pytest.warns(cvi.DenseStepWarning):
        four = cvi.simulate(balls_in_a_pipe(4), duration=0.5, dt=1e-3)
    assert four.dense_steps.t[0] < 0.2


def test_phases_are_those_of_the_dense_steps(heap):
    """A time lies in a dense phase where it lies in a dense step, and the words are those of the numbers."""
    phases, steps = heap.phases, heap.dense_steps
    at = np.searchsorted(phases["t"], steps.t + 0.5 * steps.h, side="right") - 1
    assert set(phases["kind"][at]) == {"dense"}
    ends = np.append(phases["t"][1:], heap.t[-1])
    dense = phases["kind"] == "dense"
    assert (ends - phases["t"])[dense].sum() == pytest.approx(steps.span, rel=1e-9)
    assert list(phases["kind"]) == [StepKind(int(kind)).name.lower() for kind in phases["persistent"]]


def test_step_by_step_it_is_the_same_run(heap):
    """Records of many calls are joined to those of one, and a simulator does not warn."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sim = cvi.Simulator(funnel(), dt=1e-3, max_impacts_per_step=200)
        sim.reset()
        for k in range(250):
            if k == 200:
                twin = sim.copy()
            sim.step()
        twin.run(50)
    for one in (sim, twin):
        traj = one.trajectory()
        np.testing.assert_array_equal(traj.q, heap.q)
        for name in dense_steps.FIELDS:
            np.testing.assert_array_equal(traj.dense_steps[name], heap.dense_steps[name])
        for name in ("t", "dt", "persistent", "kind"):
            np.testing.assert_array_equal(traj.phases[name], heap.phases[name])


@pytest.mark.parametrize("options", [{"dt": "auto"}, {"dt": 1e-3, "impact": "dtec"}, {"dt": 1e-3, "zeno": "end"}])
def test_steps_alone_are_refused(options):
    with pytest.raises(cvi.InputError, match="Dense steps need a fixed step") as caught:
        cvi.simulate(ball_scene(restitution=0.5), duration=0.1, contact_mode="steps", **options)
    assert caught.value.name == "contact_mode"
    assert "dt='auto', impact='dtec' or zeno='end'" in caught.value.expected
    assert caught.value.got == "'steps'"
    assert "dt=1e-3" in caught.value.remedy


def test_an_unknown_mode_is_refused():
    with pytest.raises(cvi.InputError, match="'dense'") as caught:
        cvi.simulate(ball_scene(restitution=0.5), duration=0.1, dt=1e-3, contact_mode="dense")
    assert caught.value.name == "contact_mode"


# -- what is kept, and the ledger -------------------------------------------------------------------------------------


def test_promises_of_every_dense_step(heap, stack):
    """Gaps, the energy and the cone; the figures of the rows of contacts agree with those of the steps."""
    for traj in (heap, stack):
        steps, log = traj.dense_steps, traj.contacts
        assert steps["gap"].min() >= -1e-9
        # A step that is halved down to dt / 64 is taken even where the energy rises beyond its error.
        assert steps["energy_rise"].max() <= SHORTEST_RISE * traj.kinetic_energy.max()
        assert np.all(steps["h"][steps["energy_rise"] > 0.0] <= 1e-3 / 64.0)
        np.testing.assert_allclose(np.maximum(0.0, -steps.energy_margin), steps["energy_rise"], rtol=1e-9, atol=1e-15)
        dense = log.array("dense") == 1
        assert np.all(log.normal_impulse[dense] >= 0.0)
        # The velocity impulse belongs to the normal at the end, which is recorded, the position impulse to that before.
        end, normal = log.array("end")[dense], log.array("normal")[dense]
        along = np.sum(end * normal, axis=1)
        sideways = np.linalg.norm(end - along[:, None] * normal, axis=1)
        assert np.all(sideways <= 0.5 * along + 1e-13 * np.abs(end).max())
        of_islands = Counter()
        for t, h, count in zip(steps.t, steps.h, steps["contacts"], strict=True):
            of_islands[t, h] += count
        for (t, h), count in of_islands.items():
            assert np.count_nonzero((log.t == t) & (log.h == h) & dense) == count


@pytest.mark.parametrize(("seed", "restitution", "friction", "duration"), [(0, 0.0, 0.0, 0.37), (3, 0.3, 0.5, 0.35)])
def test_other_points_of_a_pair_in_contact_are_located(seed, restitution, friction, duration):
    """Cylinders that touch and turn fast meet at another point; while they touched it had been skipped, 0.5 mm deep."""
    heap = heaps.make("bin", seed, restitution=restitution, friction=friction)
    scene, q, v = heaps.to_scene(heap)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cvi.DenseStepWarning)
        traj = cvi.simulate(scene, q, v, duration, dt=1e-3)
    check = GapCheck(heap)
    deepest = min((gap for q in traj.q for gap, _ in check.below(q, -NOISE)), default=0.0)
    assert deepest >= -NOISE
    assert min(event.gap for event in traj.events) >= -NOISE


def test_the_balances_close(heap, stack):
    """Energy: the loss of a dense step is the difference of energies. Momentum: independent of it, to rounding."""
    for traj in (heap, stack):
        ledger = traj.ledger
        # From node to node by dense steps, and by flights under gravity, which are exact.
        located = np.concatenate([traj.events.array("time"), traj.contacts.t[traj.contacts.array("dense") == 0]])
        dense = np.ones(len(traj.t) - 1, dtype=bool)
        dense[np.clip(np.searchsorted(traj.t, located + 1e-12, side="right") - 1, 0, len(dense) - 1)] = False
        assert dense.sum() > 50
        assert np.abs(np.diff(ledger.energy_balance)[dense]).max() <= ROUNDING * np.abs(ledger.energy).max()
        assert ledger.impulse_balance.max() <= 1e-12 * np.abs(traj.p).max()
        assert np.all(ledger.contacts.friction_work[traj.contacts.array("dense") == 1] == 0.0)
        taken = float(traj.dense_steps["energy_loss"].sum())
        assert ledger.dense_loss[-1] == pytest.approx(taken, rel=1e-12)
        assert taken > 0.01 * traj.kinetic_energy.max()
        np.testing.assert_array_equal(traj.friction_loss, ledger.friction_loss)
        np.testing.assert_allclose(ledger.loss, traj.impact_loss + traj.friction_loss, rtol=1e-12)


def test_the_loss_of_a_sliding_box_is_that_of_friction():
    """Beside mu m g times the way: an account that knows neither the ledger nor the step."""
    mass, mu, speed, span = 2.0, 0.3, 1.5, 0.2
    scene = cvi.Scene()
    scene.add_halfspace()
    box = scene.add_box("box", size=(0.4, 0.4, 0.05), mass=mass, placement=(0.0, 0.0, 0.025))
    scene.set_contact(restitution=0.0, friction=mu)
    traj = cvi.simulate(
        scene, v0=scene.velocity({box: (speed, 0.0, 0.0)}), duration=span, dt=1e-3, contact_mode="steps"
    )
    way = speed * span - 0.5 * mu * 9.81 * span**2
    assert traj.q[-1, 0] == pytest.approx(way, rel=1e-8)
    assert traj.ledger.dense_loss[-1] == pytest.approx(mu * mass * 9.81 * way, rel=1e-8)


def test_columns_of_the_ledger(heap):
    ledger, steps = heap.ledger, heap.dense_steps
    assert ledger.dense_steps is steps
    np.testing.assert_array_equal(ledger.dense_residual, steps["residual"])
    np.testing.assert_array_equal(ledger.dense_gap, steps["gap"])
    np.testing.assert_array_equal(ledger.dense_energy_rise, steps["energy_rise"])
    rise = np.maximum(0.0, -steps["energy_loss"])
    np.testing.assert_array_equal(ledger.dense_energy_margin, steps["energy_error"] - rise)


@pytest.mark.parametrize("name", ["dense_residual", "dense_gap"])
def test_a_bound_ends_the_run(heap, name):
    """At the first dense step beyond it, as the bound says, and what was recorded after it is forgotten."""
    steps = heap.dense_steps
    values = {"dense_residual": steps["residual"], "dense_gap": np.maximum(0.0, -steps["gap"])}[name]
    bound = 0.5 * float(values.max())
    first = int(np.flatnonzero(values > bound)[0])
    with pytest.warns(cvi.DenseStepWarning):
        traj = heap_run(ledger={name: bound}, throw=False)
    assert traj.status.code == cvi.StatusCode.LEDGER
    assert name in traj.status.message
    assert traj.status.time == steps.end[first]
    assert first < len(traj.dense_steps) < len(steps)  # kept to the end of the step of length dt
    assert traj.dense_steps.t[-1] < traj.t[-1] < traj.status.time + 1e-3
    if name == "dense_gap":
        with pytest.warns(cvi.DenseStepWarning):
            assert heap_run(ledger={name: float(values.max())}).status.ok


def test_a_rise_of_the_energy_ends_the_run(stack):
    """No dense step is known whose energy rises, so the bound is tested on a record in which one does."""
    from contactvi.simulation.tolerances import LedgerWatch
    from contactvi.trajectory.ledger import Ledger, LedgerInputs

    arrays = {name: values.copy() for name, values in stack.dense_steps.arrays.items()}
    kinetic = np.maximum.accumulate(stack.kinetic_energy)
    node = np.searchsorted(stack.t, stack.dense_steps.end[50] - 1e-9)
    arrays["energy_rise"][50] = 1e-3 * kinetic[node]
    arrays["energy_loss"][50] = -arrays["energy_error"][50] - arrays["energy_rise"][50]
    steps = dense_steps.DenseSteps(arrays)
    inputs = LedgerInputs(
        stack.options, 0.0, False, stack.t, stack.q, stack.p, stack.events, stack.contacts, stack.phases, stack.forces,
        dense_steps=steps,
    )  # fmt: skip
    block = Ledger(stack.scene.core(), stack.scene.built(), inputs)
    found = LedgerWatch({"dense_energy_rise": 0.9e-3}).check(block)
    assert found is not None
    assert found.time == steps.end[50]
    assert found.value == pytest.approx(1e-3, rel=1e-12)
    assert "of the largest kinetic energy" in str(found)
    assert LedgerWatch({"dense_energy_rise": 1.1e-3}).check(block) is None
    assert block.dense_energy_margin[50] < 0.0


# -- files and words --------------------------------------------------------------------------------------------------


def test_round_trip(heap, tmp_path):
    loaded = cvi.Trajectory.load(heap.save(tmp_path / "run.npz"))
    for name in dense_steps.FIELDS:
        np.testing.assert_array_equal(loaded.dense_steps[name], heap.dense_steps[name])
        assert loaded.dense_steps[name].dtype == heap.dense_steps[name].dtype
    assert loaded.options.contact_mode == "auto"
    assert loaded.stats.dense_steps == heap.stats.dense_steps
    assert list(loaded.phases["kind"]) == list(heap.phases["kind"])
    assert loaded.stepping == heap.stepping
    np.testing.assert_array_equal(loaded.ledger.loss, heap.ledger.loss)


def test_files_without_dense_steps_load(heap, tmp_path):
    """A run without them has no such entries; files whose steps make no sense do not load."""
    path = heap.save(tmp_path / "run.npz")
    with np.load(path) as file:
        entries = {name: file[name] for name in file.files}
    older = {name: values for name, values in entries.items() if not name.startswith("dense/")}
    np.savez(path, **older)
    assert len(cvi.Trajectory.load(path).dense_steps) == 0
    for name, wrong in (("dense/t", entries["dense/t"][::-1]), ("phase/held", entries["phase/held"] + 3.0)):
        np.savez(path, **{**entries, name: wrong})
        with pytest.raises(cvi.SceneError, match="Cannot read the run"):
            cvi.Trajectory.load(path)


def test_pictures_of_dense_steps(heap, tmp_path):
    """The page has arrows of the mean forces of dense steps, the plot their forces."""
    assert heap.to_html(tmp_path / "run.html", fps=20.0).stat().st_size > 1000
    assert cvi.plot_forces(heap).axes
    during = heap.dense_steps.t[len(heap.dense_steps) // 2]
    assert any(contact.mode in ("stick", "slip") and contact.force.any() for contact in heap.contacts.at(during))


def test_states_inside_dense_steps():
    """From the polynomials that are kept: the nodes to the bit, no jump of the configuration in between."""
    traj = tower_run(dense=True)
    np.testing.assert_allclose(traj.at(traj.t[1:-1]).q, traj.q[1:-1], rtol=0.0, atol=1e-14)
    middles = 0.5 * (traj.t[1:] + traj.t[:-1])
    way = np.abs(np.diff(traj.q, axis=0)).max()
    assert np.abs(traj.at(middles).q - 0.5 * (traj.q[1:] + traj.q[:-1])).max() <= 0.5 * way


def test_words_of_the_summary(heap):
    lines = dict(summary(heap))
    words = f"dense steps for {heap.dense_steps.span:.4g} s of {SPAN:.4g} s"
    assert words in heap.stepping
    assert words in lines["dense"]
    text = "\n".join(line for _, line in summary(heap))
    assert f"residual of Coulomb's law up to {heap.dense_steps['residual'].max():.2g}" in text
    assert heap.dense_steps.worst() in text
    assert "J by dense steps" in text


def test_repaired_problems_and_a_broken_promise_are_named(heap):
    """By records made by hand: what a heap shows depends on its last digits."""
    arrays = {name: values.copy() for name, values in heap.dense_steps.arrays.items()}
    arrays["repaired"][:], arrays["energy_rise"][:], arrays["energy_loss"][:] = 0, 0.0, 1.0
    text = dense_steps.DenseSteps(arrays).worst()
    assert "repaired" not in text
    assert f"energy within its error (margin {arrays['energy_error'].min():.2g} J)" in text
    arrays["repaired"][:3] = 2
    arrays["energy_rise"][1] = 0.25
    text = dense_steps.DenseSteps(arrays).worst()
    assert "6 contact problems repaired" in text
    assert "energy up by 0.25 J beyond its error" in text


def test_one_warning_per_run():
    """It names the line that called `simulate`, the share of the time and how to refuse such steps."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        traj = cvi.simulate(funnel(), duration=SPAN, dt=1e-3, max_impacts_per_step=200)
    assert [entry.category for entry in caught] == [cvi.DenseStepWarning]
    assert caught[0].filename == __file__
    text = str(caught[0].message)
    assert f"{len(traj.dense_steps)} dense steps for {traj.dense_steps.span:.4g} s of {SPAN:.4g} s" in text
    assert traj.dense_steps.worst() in text
    assert "contact_mode='events'" in text


def test_steps_alone_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(tower_run().dense_steps)


def test_an_early_end_raises_and_does_not_warn(heap):
    """The error has the trajectory and so what a warning would say."""
    bound = 0.5 * float(heap.dense_steps["residual"].max())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(cvi.SimulationError) as caught:
            heap_run(ledger={"dense_residual": bound})
    assert len(caught.value.trajectory.dense_steps)


def test_command_line(tmp_path):
    from typer.testing import CliRunner

    text = """
[run]
dt = 1e-3
duration = 0.05
contact_mode = "auto"

[[halfspace]]

[[box]]
name = "box"
size = [0.2, 0.2, 0.1]
xyz = [0, 0, 0.051]
"""
    file = tmp_path / "box.toml"
    file.write_text(text)
    assert cvi.load_scene(file).settings["contact_mode"] == "auto"
    options = ["-o", str(tmp_path / "out"), "--no-html", "--no-plot", "--contact-mode", "steps"]
    result = CliRunner().invoke(app, ["run", str(file), *options])
    assert result.exit_code == 0, result.output
    assert "50 dense steps for 0.05 s of 0.05 s" in result.stdout
    assert "Dense contact" not in result.output
    stored = cvi.Trajectory.load(tmp_path / "out" / "trajectory.npz")
    assert stored.options.contact_mode == "steps"


def test_the_command_line_says_that_contact_was_dense(heap, capsys):
    from contactvi.commands.output import Phases, print_summary

    print_summary(heap, [], Phases())
    words = " ".join(capsys.readouterr().err.split())
    assert f"Dense contact: dense steps for {heap.dense_steps.span:.4g} s" in words
    steps = replace(heap.options, contact_mode="steps")
    heap.options, kept = steps, heap.options
    try:
        print_summary(heap, [], Phases())
        assert "Dense contact" not in capsys.readouterr().err
    finally:
        heap.options = kept


@pytest.mark.parametrize("family", ["tower", "cards"])
def test_what_comes_down_at_once_takes_dense_steps_soon(family):
    """Locating what lands costs more than such steps; nobody waits for that to add up."""
    scene, q, v = heaps.to_scene(heaps.make(family, 7, restitution=0.3))
    with pytest.warns(cvi.DenseStepWarning):
        traj = cvi.simulate(scene, q, v, 0.1, dt=1e-3)
    assert 0.0 < traj.dense_steps["t"][0] - traj.events[0].time < 0.02


def test_what_bounces_now_and_then_takes_none():
    """Two balls, until they lie."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k, height in enumerate((0.3, 0.6)):
        scene.add_sphere(f"ball{k}", radius=0.05, mass=0.1 + k, placement=(0.4 * k, 0.0, height))
    scene.set_contact(restitution=0.8, friction=0.5)
    traj = cvi.simulate(scene, duration=3.5, dt=1e-3)
    assert traj.stats.impacts > 30
    assert len(traj.dense_steps) == 0
    assert np.abs(traj.v[-1]).max() < 1e-3
