"""Persistent contact in the Python API: options, the log of contacts, its ledger, files, pictures, words.

Most of it is tested on a run made by hand (helpers/contact_runs.py), whose forces have closed forms.
"""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import contactvi as cvi
from contactvi.playback.contact_frames import contact_frames
from contactvi.playback.page import make_html
from contactvi.records import events
from contactvi.simulation.tolerances import LedgerWatch
from contactvi.trajectory.compiled import compile_scene
from helpers.contact_runs import CORNERS, GRAVITY, MASS, MU, SPAN, SPEED, STEP, STOP, box_scene, sliding_box
from helpers.run_scenes import ball_file, ball_scene, slider_scene

EPS = np.finfo(float).eps


@pytest.fixture(scope="module")
def box() -> cvi.Trajectory:
    return sliding_box()


# -- options ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "step"),
    [
        ({"dt": 0.01}, 0.01),
        ({"dt": 0.01, "order": 4}, 1e-3),
        ({"dt": 1e-4, "order": 8}, 1e-4),
        ({"dt": 0.01, "dt_contact": 2e-3}, 2e-3),
        ({"dt": 0.01, "order": 16, "dt_contact": 0.01}, 0.01),
    ],
)
def test_step_in_contact(given, step):
    assert cvi.Options(**given).contact_dt == step


def test_defaults():
    options = cvi.Options(dt="auto")
    assert (options.dt_contact, options.zeno, options.support) == (None, "hold", "sequence")
    assert (options.contact_points, options.record_contacts) == (4, True)
    assert cvi.Options(dt="auto", dt_contact="auto").dt_contact == "auto"
    assert cvi.Options.from_dict(options.to_dict()) == options


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"dt_contact": 0.0}, "dt_contact is not usable: expected the step in contact in seconds, > 0"),
        ({"dt_contact": math.nan}, "dt_contact is not usable"),
        ({"dt_contact": True}, "dt_contact is not usable"),
        ({"dt_contact": "short"}, "dt_contact is not usable"),
        ({"dt_contact": 0.02}, "expected at most dt = 0.01 s, got 0.02 s"),
        ({"dt_contact": "auto"}, "or dt='auto' too, got 'auto'. Give dt_contact="),
        ({"zeno": "stop"}, "expected 'hold' | 'end', got 'stop'"),
        ({"zeno": 1}, "accumulating impacts"),
        ({"support": "sequences"}, "Did you mean 'sequence'"),
        ({"contact_points": 0}, "contact_points is not usable: expected a whole number >= 1"),
        ({"contact_points": 2.5}, "contact_points is not usable"),
        ({"record_contacts": "yes"}, "record_contacts is not usable: expected True or False"),
    ],
)
def test_what_is_no_option(given, message):
    with pytest.raises(cvi.InputError, match=re.escape(message)):
        cvi.Options(dt=0.01, **given)


def test_options_of_files_and_command_line(command, tmp_path):
    path = ball_file(tmp_path, restitution=0.5, duration=2.0)
    path.write_text(path.read_text() + 'dt_contact = 5e-3\nzeno = "end"\nsupport = "stiff"\ncontact_points = 6\n')
    result = command("run", path, "-o", "out", "--dt-contact", "1e-3", "--zeno", "hold", "--no-html", "--no-plot")
    assert result.exit_code == 0, result.stderr
    options = cvi.Trajectory.load("out/trajectory.npz").options
    assert (options.dt_contact, options.zeno, options.support, options.contact_points) == (1e-3, "hold", "stiff", 6)
    assert command("run", path, "--support", "soft").exit_code == 2


# -- the log ----------------------------------------------------------------------------------------------------------


def test_forces_of_the_box(box):
    """A corner carries a quarter of the weight, and friction MU of it while the box slides."""
    log = box.contacts
    assert len(log) == 4 * len(box.t[1:])
    time, force = log.on("box")
    assert time == pytest.approx(np.arange(0.5, 50) * STEP, abs=4 * EPS)
    assert force[:, 2] == pytest.approx(np.full(50, MASS * GRAVITY), rel=8 * EPS)
    sliding = time < STOP - STEP
    assert force[sliding, 0] == pytest.approx(-MU * MASS * GRAVITY * np.ones(sliding.sum()), rel=1e-13)
    assert np.abs(force[time > STOP + STEP, 0]).max() == 0.0
    assert log.on("ground")[1] == pytest.approx(-force, abs=1e-14)
    assert log.impulse_on("box") == pytest.approx([-MASS * SPEED, 0.0, MASS * GRAVITY * SPAN], abs=1e-13)
    assert log.impulse_on(["box", "ground"]) == pytest.approx(np.zeros(3), abs=0.0)
    sign = 1.0 if log.pairs[0][1] == "box" else -1.0
    assert log.total_impulse == pytest.approx(sign * log.impulse_on("box"), abs=1e-13)
    assert log.force_of("box", "ground")[1] == pytest.approx(sign * force, abs=1e-14)
    assert log.on(box.scene.parts[1])[1] == pytest.approx(force, abs=0.0)  # a handle stands for its shapes


def test_contacts_at_a_time(box):
    found = box.contacts.at(0.5 * STEP)
    assert [contact.point for contact in found] == [0, 1, 2, 3]
    contact = found[1]
    assert (contact.kind, contact.mode, contact.step, contact.h) == ("contact", "slip", 0, STEP)
    assert set(contact.pair) == {"ground", "box"}
    assert contact.normal_force == pytest.approx(0.25 * MASS * GRAVITY, rel=8 * EPS)
    assert contact.impulse == pytest.approx(STEP * contact.force, rel=8 * EPS)
    assert contact.position[:2] == pytest.approx(CORNERS[1] + [box.q[1, 0], 0.0], abs=1e-15)
    assert [c.step for c in box.contacts.at(STEP)] == [1] * 4  # at a node the step that starts there
    assert [c.step for c in box.contacts.at(SPAN)] == [49] * 4  # at the end that which ends there
    assert box.contacts.at(0.9)[0].mode == "stick"
    assert box.contacts.at(2.0) == []
    assert len(box.contacts[3:5]) == 2
    with pytest.raises(IndexError):
        box.contacts[200]


def test_of_a_pair(box):
    assert len(box.contacts.of("box", "ground")) == len(box.contacts.of("ground", "box")) == 200
    for wrong in (lambda: box.contacts.of("box", "grond"), lambda: box.contacts.on("bux")):
        with pytest.raises(cvi.InputError, match="Did you mean"):
            wrong()


def test_an_impact_has_an_impulse_and_no_force(box):
    h = box.contacts.h.copy()
    h[:4] = 0.0
    log = sliding_box(h=h).contacts
    assert np.isnan(log[0].force).all()
    assert log[0].impulse == pytest.approx(box.contacts[0].impulse, abs=0.0)
    assert [contact.h for contact in log.at(0.0)] == [0.0] * 4
    assert log.impulse_on("box") == pytest.approx(box.contacts.impulse_on("box"), abs=1e-15)
    assert len(log.on("box")[0]) == 49


def test_a_run_without_contacts():
    traj = cvi.simulate(ball_scene(), duration=0.2, dt=1e-2)
    assert len(traj.contacts) == len(traj.contact_changes) == 0
    assert traj.contacts.pairs == []
    assert traj.contacts.at(0.1) == []
    assert traj.contacts.total_impulse == pytest.approx(np.zeros(3), abs=0.0)
    assert traj.phases is None
    assert np.all(traj.friction_loss == 0.0)
    assert contact_frames(traj, traj.t, size=0.1) is None
    assert "persistent contact" not in traj.stepping


def test_changes(box):
    assert [change.change for change in box.contact_changes] == ["begin"] * 4 + ["stick"] * 4
    assert box.contact_changes[4].time == STOP
    assert "stick" in str(box.contact_changes[4])
    assert set(box.contact_changes[0].pair) == {"ground", "box"}
    assert len(box.contact_changes[2:6]) == 4
    with pytest.raises(IndexError):
        box.contact_changes[8]


def test_which_step_was_taken_where():
    box = sliding_box()
    assert box.stepping == "order 2, dt = 0.02 s, persistent contact for 1 s"
    box.options = cvi.Options(dt=0.02, duration=1.0, order=8)
    box.phases = {
        "t": np.array([0.0, 0.25, 0.75]), "dt": np.array([0.02, 1e-3, 0.02]), "persistent": np.array([0, 1.0, 0])
    }  # fmt: skip
    assert box.stepping == "order 8, dt = 0.02 s, persistent contact for 0.5 s with order 2, dt = 0.001 s"


# -- the ledger -------------------------------------------------------------------------------------------------------


def test_the_ledger_of_the_box(box):
    ledger = box.ledger
    assert np.abs(ledger.impulse_balance).max() <= 8 * EPS * MASS * SPEED
    assert np.all(ledger.contacts.gap == 0.0)
    assert np.all(ledger.contacts.complementarity == 0.0)
    assert ledger.contacts.impulse == pytest.approx(np.full(200, 0.25 * MASS * GRAVITY * STEP), rel=8 * EPS)
    assert ledger.energy_rise.max() <= 8 * EPS * ledger.energy[0]
    assert ledger.persistent[:-1].all()


def test_friction_takes_the_energy(box):
    """To rounding while the slip changes evenly; in the step in which the box stops to O(h^2)."""
    loss, kinetic = box.friction_loss, box.kinetic_energy
    sliding = box.t < STOP
    assert loss[sliding] == pytest.approx(kinetic[0] - kinetic[sliding], abs=1e-13)
    assert loss[-1] == pytest.approx(0.5 * MASS * SPEED**2, rel=1e-3)
    assert np.all(np.diff(loss) >= 0.0)
    np.testing.assert_array_equal(loss, box.ledger.friction_loss)


def damaged(**changes):
    """The name of the first tolerance that a damaged run of the box exceeds, at 1e-9, and when."""
    box = sliding_box(**changes)
    names = ("gap", "impulse", "complementarity", "impulse_balance", "energy_rise")
    return LedgerWatch(dict.fromkeys(names, 1e-9)).check(box.ledger)


def test_tolerances_of_persistent_contacts(box):
    assert damaged() is None
    arrays = box.contacts.arrays
    gap = arrays["gap"].copy()
    gap[41] = 1e-8
    assert damaged(gap=gap)[:2] == ("gap", 1e-8)
    gap[41] = -1e-8
    assert damaged(gap=gap)[3] == pytest.approx(11 * STEP, abs=1e-12)
    start, end = arrays["start"].copy(), arrays["end"].copy()
    start[41], end[41] = 0.0, 0.0
    gap[41] = 1e-8
    assert damaged(gap=gap, start=start, end=end).name == "impulse_balance"  # open and without impulse: no gap
    end[41] = -arrays["end"][41]
    assert damaged(end=end, start=start).name == "impulse"
    rising = sliding_box()
    rising.p[:, 0] = -rising.p[::-1, 0]
    assert LedgerWatch({"energy_rise": 1e-9}).check(rising.ledger).name == "energy_rise"


def test_tolerances_that_need_a_run_without_inputs():
    scene = box_scene()
    with pytest.raises(cvi.InputError, match="cannot hold impulse_balance"):
        cvi.simulate(scene, duration=0.1, dt=0.01, control=np.ones((10, 6)), ledger={"impulse_balance": 1.0})


def test_the_balance_is_not_known_across_a_node(box):
    h = box.contacts.h.copy()
    h[4:8] = 1.5 * STEP
    balance = sliding_box(h=h).ledger.impulse_balance
    assert np.isnan(balance).any()
    assert damaged(h=h) is None or damaged(h=h).name == "impulse_balance"


def test_what_several_points_or_friction_change_is_measured():
    """The formula of one point without friction stays where it holds; elsewhere T(p_plus) - T(p_minus)."""
    traj = cvi.simulate(ball_scene(restitution=0.8), duration=2.0, dt=1e-2)
    arrays = traj.events.arrays
    asked = []

    def kinetic_energy(q, p):
        asked.append(len(q))
        return np.asarray(traj._engine().energy(q, p))[:, 0]

    found = events.with_energy_change(arrays, kinetic_energy)
    assert not asked
    np.testing.assert_array_equal(found["points"], 1)
    assert found["energy_change"] == pytest.approx(-found["loss"], rel=1e-13)
    assert found["impulse_vector"] == pytest.approx(found["impulse"][:, None] * found["normal"], abs=1e-15)
    rough = arrays | {"friction": np.full(len(traj.events), 0.3)}
    found = events.with_energy_change(rough, kinetic_energy)
    assert asked == [len(traj.events)] * 2
    assert found["energy_change"] == pytest.approx(arrays["energy_change"], abs=1e-12)


# -- states between the nodes -----------------------------------------------------------------------------------------


def test_segments_in_contact_are_evaluated_by_their_polynomials():
    """There the exact states are those of the polynomials; in flight they are those of partial steps."""
    scene = box_scene()
    lying = cvi.simulate(scene, duration=0.01, dt=0.01).q[0]
    start = lying + np.array([0, 0, 0.05, 0, 0, 0, 0])  # above the ground, turning
    traj = cvi.simulate(scene, start, [0, 0, 0, 3, 2, 5], duration=0.5, dt=0.01, order=4)
    segments = traj.segments
    persistent = segments.arrays["persistent"] != 0.0
    assert persistent.any()
    assert not persistent.all()
    middles = segments.arrays["t"] + 0.37 * segments.arrays["h"]
    core = compile_scene(scene).core
    exact, smooth = segments.states(core, middles, exact=True), segments.states(core, middles)
    for found, polynomial in zip(exact, smooth, strict=True):
        np.testing.assert_array_equal(found[persistent], polynomial[persistent])
        np.testing.assert_allclose(found, polynomial, atol=1e-6)
    assert (exact[0][~persistent] != smooth[0][~persistent]).any()


# -- the scene --------------------------------------------------------------------------------------------------------


def test_the_report_says_restitution_and_friction():
    scene = box_scene()
    assert "restitution 0, Coulomb friction 0.3" in str(scene.report)
    scene.add_sphere("ball", 0.1, placement=(2.0, 0.0, 1.0))
    scene.set_contact("ball", "box", friction=0.9, restitution=0.5)
    assert "restitution 0 to 0.5, Coulomb friction 0.3 to 0.9" in str(scene.report)
    assert scene.pair_friction.tolist().count(0.9) == 1


# -- with the engine --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("impact", ["ctec", "mhc"])
@pytest.mark.parametrize("order", [2, 8])
def test_a_ball_comes_to_rest(order, impact):
    """Its weight is carried from the end of the bouncing on; all impulses together stop what it has fallen."""
    traj = cvi.simulate(ball_scene(restitution=0.5), duration=3.0, dt=1e-2, order=order, impact=impact, dense=True)
    weight = 0.5 * GRAVITY
    assert traj.status.ok
    time, force = traj.contacts.on("ball")
    assert time[0] >= 1.354
    assert force[10:, 2] == pytest.approx(np.full(len(force) - 10, weight), rel=1e-9)
    assert traj.contacts.impulse_on("ball")[2] == pytest.approx(3.0 * weight, rel=1e-9)
    assert np.nanmax(traj.ledger.impulse_balance) <= 1e-12
    assert traj.phases["persistent"].tolist() == [0.0, 1.0]
    assert traj.phases["dt"].tolist() == [1e-2, 1e-2]
    assert traj.ledger.contacts.gap == pytest.approx(0.0, abs=1e-10)
    assert np.abs(traj.ledger.contacts.complementarity).max() <= 1e-12
    ended = [change for change in traj.contact_changes if change.change == "bouncing ended"]
    assert ended[0].value == pytest.approx(3.0 * math.sqrt(2.0 / GRAVITY), abs=1e-9)
    assert traj.at(2.345).q == pytest.approx(traj.q[-1], abs=1e-9)
    assert traj.contacts.h.max() == pytest.approx(1e-2, rel=1e-12)
    assert len(force) > 100
    # contact steps of order 2, or smooth steps that hold the contact
    assert (traj.stats.contact_steps > 100) if order == 2 else (traj.stats.contact_steps == 0)
    held = traj.segments.arrays["persistent"]
    assert set(held[traj.segments.arrays["t"] > 1.36].tolist()) == {1.0 if order == 2 else 2.0}
    assert not held[traj.segments.arrays["t"] < 1.35].any()
    assert len(make_html(traj)) > 500_000


@pytest.mark.parametrize("block", [1, 7])
def test_a_ball_that_is_lifted(block):
    """Twice its weight for 0.14 s: it is released at once, and the phases of single calls are one after the other."""
    sim = cvi.Simulator(ball_scene(restitution=0.0), dt=1e-2)
    sim.reset(np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]))
    up = np.tile([0.0, 0.0, 2.0 * 0.5 * GRAVITY, 0.0, 0.0, 0.0], (block, 1))
    for k in range(0, 49, block):
        sim.run(block, up if 28 <= k < 42 else None)
    traj = sim.trajectory()
    assert traj.phases["t"] == pytest.approx([0.0, 0.28], abs=1e-12)
    assert traj.phases["persistent"].tolist() == [1.0, 0.0]
    assert traj.contact_changes[-1].change == "release"
    assert traj.contact_changes[-1].time == pytest.approx(0.28, abs=1e-9)
    height = 0.5 * GRAVITY * 0.14**2 + GRAVITY * 0.14 * 0.07 - 0.5 * GRAVITY * 0.07**2
    assert traj.q[-1, 2] == pytest.approx(0.1 + height, abs=1e-10)


def test_losses_are_added_back():
    kept = cvi.simulate(ball_scene(restitution=0.0), duration=0.8, dt=1e-2, ledger={"energy": 1e-9}, throw=False)
    assert kept.status.ok
    assert kept.phases is not None


def test_nothing_is_kept_where_not_wanted():
    traj = cvi.simulate(ball_scene(restitution=0.0), duration=0.8, dt=1e-2, record_contacts=False)
    assert len(traj.contacts) == 0
    assert traj.phases is not None
    assert "persistent contact" in traj.stepping


def test_endings():
    maps = "impact='ctec' or 'mhc'"
    for given, needed in (
        ({"zeno": "end"}, "zeno='hold'"),
        ({"zeno": "end", "impact": "dtec"}, f"zeno='hold' and {maps}"),
        ({"impact": "dtec"}, maps),
    ):
        with pytest.raises(cvi.SimulationError, match="accumulate") as caught:
            cvi.simulate(ball_scene(restitution=0.5), duration=3.0, dt=1e-2, **given)
        assert caught.value.status.code == cvi.StatusCode.ZENO
        assert caught.value.remedy == f"Use {needed}: the run then goes on with a persistent contact"
    assert "DTEC cannot answer there" in str(caught.value)
    slider = cvi.simulate(slider_scene(0.0), duration=1.0, dt=1e-2)
    assert slider.status.ok
    assert slider.q[-1] == pytest.approx([-0.2], abs=1e-10)


@pytest.mark.parametrize("order", [4, 16])
def test_auto_measures_runs_that_come_to_rest(order):
    """The motion is known: bounces, then rest; more or fewer impacts before it do not confuse the estimate."""
    falls = math.sqrt(2.0 / GRAVITY)  # from 1 m
    for dt_contact in (None, 2e-4):
        traj = cvi.simulate(ball_scene(restitution=0.5), duration=3.0, dt="auto", order=order, dt_contact=dt_contact)
        assert traj.error_estimate <= 1e-6
        kinds = traj.phases["persistent"]
        assert kinds[0] == 0.0
        assert np.all(kinds[1:] == 1.0)
        assert 0.0 <= 3.0 * falls - traj.phases["t"][1] < 1e-2
        exact = np.full(len(traj), 0.1)
        begin, flight = -falls, 2.0 * falls
        while flight > 1e-12:
            inside = (traj.t >= max(begin, 0.0)) & (traj.t <= begin + flight)
            since = traj.t[inside] - begin
            exact[inside] = 0.1 + 0.5 * GRAVITY * since * (flight - since)
            begin, flight = begin + flight, 0.5 * flight
        assert np.abs(traj.q[:, 2] - exact).max() <= 1e-6
        # the contact is held in steps as long as those of the flight before
        assert traj.stats.contact_steps == 0
        lengths = traj.adaptive_steps["dt"]
        assert lengths[-1] >= 0.99 * lengths[0]


def test_zeros_while_nothing_touches():
    """A box is pulled up and falls again: a line through the rows alone would join the forces before and after."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), mass=2.0, placement=(0, 0, 0.05))
    scene.add_wrench("box", force=lambda t: (0.0, 0.0, 60.0 if 0.1 < t < 0.15 else 0.0))
    scene.set_contact(restitution=0.0, friction=0.5)
    contacts = cvi.simulate(scene, duration=0.6, dt=1e-3).contacts
    for t, force, with_zeros in (
        (*contacts.on("box"), contacts.on("box", zeros=True)),
        (*contacts.force_of("ground", "box"), contacts.force_of("ground", "box", zeros=True)),
    ):
        times, forces = with_zeros
        size = np.linalg.norm(forces, axis=1)
        added = np.flatnonzero(~np.isin(times, t))
        assert len(added) == 2
        assert np.all(size[added] == 0.0)
        assert 0.09 < times[added[0]] < 0.11
        assert times[added[1]] > 0.2
        assert np.array_equal(np.delete(times, added), t)
        assert np.array_equal(np.delete(forces, added, axis=0), force)
        assert np.interp(0.15, times, size) == 0.0
        assert np.interp(0.3, times, size) == 0.0
        assert np.interp(0.3, t, np.linalg.norm(force, axis=1)) > 1.0  # the ramp that a line without them draws
        assert np.all(np.diff(times) >= 0.0)
