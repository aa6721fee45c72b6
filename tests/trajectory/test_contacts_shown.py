"""Lasting contact in files, pictures and words, on the run made by hand of helpers/contact_runs.py."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactvi as cvi
from contactvi.commands.summary import summary
from contactvi.playback import contact_frames as contact_frames_module
from contactvi.playback.contact_frames import ROLL, contact_frames
from contactvi.playback.page import make_html
from contactvi.records import contacts
from contactvi.records.codes import ContactMode
from contactvi.trajectory import plots
from helpers.contact_runs import (
    CORNERS,
    GRAVITY,
    MASS,
    MU,
    SPAN,
    SPEED,
    STEP,
    STOP,
    contact_arrays,
    place,
    sliding_box,
)
from helpers.playback_data import PageEvents, run_data, unpacked
from helpers.run_scenes import ball_scene


@pytest.fixture(scope="module")
def box() -> cvi.Trajectory:
    return sliding_box()


# -- the file ---------------------------------------------------------------------------------------------------------


def test_round_trip(box, tmp_path):
    loaded = cvi.Trajectory.load(box.save(tmp_path / "run.npz"))
    for name in contacts.FIELDS:
        np.testing.assert_array_equal(loaded.contacts.array(name), box.contacts.array(name))
    for name in contacts.CHANGE_FIELDS:
        np.testing.assert_array_equal(loaded.contact_changes.array(name), box.contact_changes.array(name))
    for name in ("t", "dt", "persistent"):
        np.testing.assert_array_equal(loaded.phases[name], box.phases[name])
    assert loaded.contacts.pairs == box.contacts.pairs
    assert loaded.stepping == box.stepping
    assert loaded.gaps[1] == box.gaps[1] == box.contacts.pairs


@pytest.mark.parametrize(
    "change",
    [
        lambda e: e.pop("contact/slip"),
        lambda e: e.update({"contact/h": e["contact/h"][:-1]}),
        lambda e: e.update({"contact/mode": e["contact/mode"] + 4}),
        lambda e: e.update({"contact/index": e["contact/index"] - 1}),
        lambda e: e.update({"contact/normal": e["contact/normal"][:, :2]}),
        lambda e: e.update({"change/change": e["change/change"] + 6}),
        lambda e: e.update({"change/kind": e["change/kind"] + 2}),
        lambda e: e.pop("phase/dt"),
        lambda e: e.pop("event/loss"),
    ],
)
def test_damaged_contacts_are_refused(box, tmp_path, change):
    path = box.save(tmp_path / "run.npz")
    with np.load(path) as file:
        entries = {name: file[name] for name in file.files}
    change(entries)
    np.savez(path, **entries)
    with pytest.raises(cvi.SceneError, match="Cannot read the run"):
        cvi.Trajectory.load(path)


# -- pictures ---------------------------------------------------------------------------------------------------------


def test_contacts_of_the_box(box):
    times = np.linspace(0.0, SPAN, 61)
    found = contact_frames(box, times, size=0.4)
    assert np.diff(found.first) == pytest.approx(np.full(61, 4))
    # the box is free and the ground is not: what the box gets is drawn
    assert found.force[:, 2] == pytest.approx(np.full(244, 0.25 * MASS * GRAVITY), rel=1e-12)
    assert np.all(found.force[np.repeat(times, 4) < STOP, 0] < 0.0)
    assert 0.25 * MASS * GRAVITY <= found.full <= 0.25 * MASS * GRAVITY * math.hypot(1.0, MU) * (1 + 1e-12)
    slips = np.repeat(times, 4) < STOP - STEP
    assert np.all(found.mode[slips] == ContactMode.SLIP)
    assert np.all(found.mode[np.repeat(times, 4) > STOP] == ContactMode.STICK)
    # Each corner moves to where it is in the next frame.
    moved = found.next >= 0
    assert np.flatnonzero(~moved).tolist() == list(range(240, 244))
    steps = found.point[found.next[moved]] - found.point[moved]
    assert np.abs(steps).max() <= SPEED * (1 / 60 + STEP)
    assert np.all(steps[:, 1:] == 0.0)


def test_a_contact_is_shown_in_every_step_that_it_lasts(box):
    """Frames finer than the steps: each shows the contacts of the step around it, the last one those of the end.

    The points go along the chords of the box's parabola; in the first step, before which there is none, as in the next.
    """
    times = np.linspace(0.0, SPAN, 1001)
    found = contact_frames(box, times, size=0.4)
    assert np.all(np.diff(found.first) == 4)
    off = np.abs(found.point[found.first[:-1], 0] - place(times) - CORNERS[0, 0])
    sagitta = MU * GRAVITY * STEP**2 / 8.0
    assert off[times >= STEP].max() <= sagitta * (1.0 + 1e-9)
    assert off.max() <= MU * GRAVITY * STEP**2 * (1.0 + 1e-9)


def test_a_part_of_a_step_that_is_too_brief_shows_the_force_before_it(box):
    """Steps of 1e-9 s between two changes have no force of their own, and the arrow must not go out for a frame."""
    arrays = contact_arrays(box.scene)
    brief = (arrays["step"] == 10) | (arrays["step"] == 0)
    t, h = arrays["t"].copy(), arrays["h"].copy()
    at = (arrays["step"] == 11) | (arrays["step"] == 1)
    h[at] += STEP - 1e-9
    t[at] -= STEP - 1e-9
    h[brief] = 1e-9
    force = 2.0 * arrays["end"] / STEP
    end, start = force * 0.5 * h[:, None], force * 0.5 * h[:, None]
    end[brief] = start[brief] = 1e3  # rounding, as a force of 1e12 N
    changed = sliding_box(t=t, h=h, start=start, end=end)
    times = np.unique(np.concatenate([np.linspace(0.0, SPAN, 101), t[brief]]))
    found = contact_frames(changed, times, size=0.4)
    assert np.all(np.diff(found.first) == 4)
    assert np.linalg.norm(found.force, axis=1).max() < 6.0
    at_brief = found.first[np.flatnonzero(times == t[brief].max())[0]]
    assert np.linalg.norm(found.force[at_brief]) == pytest.approx(np.linalg.norm(force[4 * 9]))


def test_a_released_point_is_gone_and_comes_back(box):
    """Corner 0 leaves after a quarter of the run and comes back as a point of another number at half of it."""
    arrays = contact_arrays(box.scene)
    later = (arrays["point"] == 0) & (arrays["t"] >= 0.25 * SPAN - 1e-9)
    away = later & (arrays["t"] < 0.5 * SPAN - 1e-9)
    point, h = np.where(later, 7, arrays["point"]), np.where(away, 0.0, arrays["h"])
    found = contact_frames(sliding_box(point=point, h=h), np.linspace(0.0, SPAN, 51), size=0.4)
    assert np.diff(found.first).tolist() == [4] * 13 + [3] * 12 + [4] * 26
    assert (found.next == -1).sum() == 1 + 4  # its last frame, and the end


def test_many_rows_get_fewer_frames(box, monkeypatch):
    monkeypatch.setattr(contact_frames_module, "MAX_ROWS", 60)
    found = contact_frames(box, box.t, size=0.4)
    assert len(found.point) <= 60
    assert np.all(np.diff(found.first) == 4)


def test_rolling_is_told_from_sticking():
    """A ball and a box on a slope; the box sticks on its corners, the ball sticks at a point that travels."""
    scene = cvi.Scene()
    scene.add_halfspace((math.sin(0.1), 0.0, math.cos(0.1)), 0.0)
    normal = np.array([math.sin(0.1), 0.0, math.cos(0.1)])
    scene.add_sphere("ball", 0.1, placement=tuple(0.1 * normal))
    turned = ((0.05 * normal + [0.0, 1.0, 0.0]).tolist(), (0.0, 0.1, 0.0))
    scene.add_box("box", (0.2, 0.2, 0.1), placement=turned)
    scene.set_contact(restitution=0.0, friction=0.5)
    traj = cvi.simulate(scene, duration=0.5, dt=1e-3)
    found = contact_frames(traj, np.linspace(0.0, 0.5, 31), size=0.1)
    names = [traj.events.label(0, int(k)) for k in found.pair]
    rolling = found.mode == ROLL
    of_ball = np.array(["ball" in pair for pair in names])
    frame = np.repeat(np.arange(31), np.diff(found.first))
    assert np.all(rolling[of_ball & (frame > 2)])
    assert not np.any(rolling[~of_ball])
    assert np.all(found.mode[~of_ball] == ContactMode.STICK)


def test_the_page_shows_forces(box):
    data = run_data(make_html(box))["contacts"]
    found = contact_frames(box, np.concatenate([unpacked(data["times"])]), size=0.4)
    assert unpacked(data["point"]).reshape(-1, 3) == pytest.approx(found.point, abs=1e-6)
    assert unpacked(data["force"]).reshape(-1, 3) == pytest.approx(found.force, rel=1e-6)
    assert unpacked(data["first"]).tolist() == found.first.tolist()
    assert run_data(make_html(box, forces=False))["contacts"] is None


def test_the_page_lists_changes(box):
    listed = PageEvents.of(make_html(box))
    changes = [(kind, time, count) for kind, time, count in zip(listed.kind, listed.time, listed.count, strict=True)]
    assert changes == [("begin", 0.0, 4), ("stick", STOP, 4)]  # four corners at one time are one thing


def test_plot_of_the_forces(box, tmp_path):
    figure = plots.plot_forces(box)
    normal, along, _ = figure.axes
    (line,) = [line for line in normal.lines if len(line.get_xdata()) == 50]
    assert line.get_ydata() == pytest.approx(np.full(50, MASS * GRAVITY), rel=1e-12)
    (line,) = [line for line in along.lines if len(line.get_xdata()) == 50]
    assert line.get_ydata()[0] == pytest.approx(MU * MASS * GRAVITY, rel=1e-12)
    assert plots.save_figure(plots.plot_forces(box), tmp_path / "forces.png").stat().st_size > 10_000
    h = box.contacts.h.copy()
    h[80:100] = 0.0
    apart = plots.plot_forces(sliding_box(h=h)).axes[0].lines  # the line is broken where the box has no contact
    assert any(np.isnan(line.get_ydata()).sum() == 1 and len(line.get_ydata()) == 46 for line in apart)
    assert not any(len(line.get_ydata()) > 2 for line in plots.plot_forces(sliding_box(h=0.0 * h)).axes[0].lines)
    plots.plot_forces(cvi.simulate(ball_scene(), duration=0.1, dt=0.01))  # without contacts: empty, no error


def test_more_impacts_are_no_more_artists():
    """A legend looks at every artist for its place, and so does the layout: pictures of many impacts took seconds."""
    scene = ball_scene(0.999)
    many, more = (cvi.simulate(scene, duration=span, dt=0.01) for span in (200.0, 400.0))
    assert len(more.events) > 1.8 * len(many.events) > 300
    for draw in (cvi.plot, cvi.plot_forces):
        artists = [[len(axis.get_children()) for axis in draw(traj).axes] for traj in (many, more)]
        assert artists[0] == artists[1]


def test_what_lasts_no_time_has_no_force_to_show(box):
    """A part of a step of 1e-9 s with an impulse of rounding would be the strongest force of the run."""
    h = box.contacts.h.copy()
    h[40] = 1e-9
    brief = sliding_box(h=h)
    assert np.linalg.norm(brief.contacts.force[40]) > 1e6
    assert contact_frames(brief, brief.t, size=0.4).full < 6.0
    lines = [line.get_ydata() for line in plots.plot_forces(brief).axes[0].lines if len(line.get_ydata()) > 2]
    assert lines
    assert max(map(np.nanmax, lines)) < 20.0
    assert "largest force at a point 5.1" in str(summary(brief))


def test_words_of_the_command_line(box):
    text = "\n".join(f"{name} {value}" for name, value in summary(box))
    assert "1 pair touched, largest force at a point 5.1" in text
    assert "gaps kept to 0 m" in text
    assert "50 steps in contact" in text
    assert "J by sliding" in text


def test_gaps_have_names_and_unpack(box):
    t, pairs, gap = box.gaps
    assert t is box.gaps.t
    assert pairs == box.gaps.pairs
    assert gap is box.gaps.gap
    assert gap.shape == (len(t), len(pairs))
    assert np.isfinite(gap).all()


def test_changes_without_a_value_have_zero(box):
    others = [change for change in box.contact_changes if change.change not in ("bouncing ended", "inconsistent")]
    assert others
    assert all(change.value == 0.0 for change in others)
