"""Lasting contact in files, pictures and words, on the run made by hand of helpers/contact_runs.py."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import contactvi as cvi
from contactvi.commands.summary import summary
from contactvi.playback import force_arrows
from contactvi.playback.page import make_html
from contactvi.records import contacts
from contactvi.trajectory import plots
from helpers.contact_runs import GRAVITY, MASS, MU, SPAN, STOP, contact_arrays, sliding_box
from helpers.playback_data import commands
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


def test_arrows_of_the_box(box):
    times = np.linspace(0.0, SPAN, 61)
    forces = force_arrows.forces_of(box, times)
    assert len(forces.arrows) == 4
    assert forces.hidden == 0
    for arrow in forces.arrows:
        assert arrow.time == pytest.approx(times)
        assert all(arrow.shown)
        # the box is free and the ground is not: what the box gets is drawn
        assert np.array(arrow.force)[:, 2] == pytest.approx(np.full(61, 0.25 * MASS * GRAVITY), rel=1e-12)
        assert np.all(np.array(arrow.force)[times < STOP, 0] < 0.0)
    assert 0.25 * MASS * GRAVITY <= forces.full <= 0.25 * MASS * GRAVITY * math.hypot(1.0, MU) * (1 + 1e-12)
    assert forces.reference == 5.0


def test_an_arrow_is_used_again_after_a_rest(box):
    """Corner 0 leaves after a quarter of the run, a fifth point comes later and takes its arrow."""
    arrays = contact_arrays(box.scene)
    rows = np.flatnonzero((arrays["point"] == 0) & (arrays["t"] > 0.25 * SPAN))
    gone = rows[arrays["t"][rows] < 0.5 * SPAN]
    start, end, point = arrays["start"].copy(), arrays["end"].copy(), arrays["point"].copy()
    start[gone], end[gone] = 0.0, 0.0
    point[rows] = 7
    forces = force_arrows.forces_of(sliding_box(start=start, end=end, point=point), np.linspace(0.0, SPAN, 61))
    assert len(forces.arrows) == 4
    (arrow,) = [arrow for arrow in forces.arrows if not all(arrow.shown)]
    k = arrow.shown.index(False)
    assert 0.25 * SPAN <= arrow.time[k] <= 0.25 * SPAN + 0.05
    assert np.all(arrow.point[k] == arrow.point[k - 1])
    assert arrow.time[k + 1] >= 0.5 * SPAN
    assert all(arrow.shown[k + 1 :])


def test_more_points_than_arrows(box, monkeypatch):
    monkeypatch.setattr(force_arrows, "MAX_ARROWS", 3)
    forces = force_arrows.forces_of(box, box.t)
    assert len(forces.arrows) == 3
    assert forces.hidden > 0
    monkeypatch.setattr(force_arrows, "MAX_KEYS", 60)
    forces = force_arrows.forces_of(box, box.t)
    assert sum(len(arrow.time) for arrow in forces.arrows) <= 60


def test_the_page_shows_forces(box):
    page = make_html(box)
    paths = {command["path"] for command in commands(page) if command["type"] == "set_object"}
    assert sum(path.startswith("/contactvi/forces/") for path in paths) == 8  # shaft and head
    assert "blue arrows: contact forces, " in page
    animations = next(c["animations"] for c in commands(page) if c["type"] == "set_animation")
    moved = [item["clip"]["tracks"] for item in animations if item["path"].startswith("/contactvi/forces/")]
    assert [[track["name"] for track in tracks] for tracks in moved] == [
        [".visible", ".position", ".quaternion", ".scale"]
    ] * 4
    assert "/contactvi/forces/" not in json.dumps([c.get("path", "") for c in commands(make_html(box, forces=False))])


def test_plot_of_the_forces(box, tmp_path):
    figure = plots.plot_forces(box)
    normal, along, _ = figure.axes
    (line,) = [line for line in normal.lines if len(line.get_xdata()) == 50]
    assert line.get_ydata() == pytest.approx(np.full(50, MASS * GRAVITY), rel=1e-12)
    (line,) = [line for line in along.lines if len(line.get_xdata()) == 50]
    assert line.get_ydata()[0] == pytest.approx(MU * MASS * GRAVITY, rel=1e-12)
    assert plots.save_force_plot(box, tmp_path / "forces.png").stat().st_size > 10_000
    h = box.contacts.h.copy()
    h[80:100] = 0.0
    apart = plots.plot_forces(sliding_box(h=h)).axes[0].lines  # the line is broken where the box has no contact
    assert any(np.isnan(line.get_ydata()).sum() == 1 and len(line.get_ydata()) == 46 for line in apart)
    assert not any(len(line.get_ydata()) > 2 for line in plots.plot_forces(sliding_box(h=0.0 * h)).axes[0].lines)
    plots.plot_forces(cvi.simulate(ball_scene(), duration=0.1, dt=0.01))  # without contacts: empty, no error


def test_marks_of_many_impacts_are_one_artist():
    """A legend looks at every artist for its place, and so does the layout: pictures of many impacts took seconds."""
    scene = ball_scene(0.999)
    few, many = (cvi.simulate(scene, duration=span, dt=0.01) for span in (2.0, 300.0))
    assert len(many.events) > 300
    for draw in (cvi.plot, cvi.plot_forces):
        artists = [[len(axis.get_children()) for axis in draw(traj).axes] for traj in (few, many)]
        assert artists[0] == artists[1]
    marks = cvi.plot(few).axes[0].collections[0]
    assert marks.get_label() == "impact"
    times = [segment[:, 0] for segment in marks.get_segments()]
    assert np.array(times) == pytest.approx(np.repeat(few.events.array("time"), 2).reshape(-1, 2), abs=0.0)


def test_what_lasts_no_time_has_no_force_to_show(box):
    """A part of a step of 1e-9 s with an impulse of rounding would be the strongest force of the run."""
    h = box.contacts.h.copy()
    h[40] = 1e-9
    brief = sliding_box(h=h)
    assert np.linalg.norm(brief.contacts.force[40]) > 1e6
    assert force_arrows.forces_of(brief, brief.t).full < 6.0
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
