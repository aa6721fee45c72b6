"""Pictures and films of runs: their arguments, what is missing on the machine, and in a browser what is in them."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import contactvi as cvi
from contactvi.playback import browser as headless
from contactvi.playback import render as render_module
from helpers.contact_runs import sliding_box
from helpers.run_scenes import ball_scene


@pytest.fixture(scope="module")
def ball() -> cvi.Trajectory:
    scene = ball_scene(restitution=0.8)
    v0 = scene.velocity({"ball": ((0.5, -0.2, 0.0), (0.0, 3.0, 7.0))})
    return cvi.simulate(scene, None, v0, duration=1.0, dt=1e-2)


def program(folder: Path, name: str, text: str) -> None:
    """Write a shell script that stands for a program."""
    file = folder / name
    file.write_text(f"#!/bin/sh\n{text}\n")
    file.chmod(0o755)


# -- without a browser -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "options", "match"),
    [
        ("a.avi", {}, r"\.gif, \.mp4, \.png"),
        ("a", {}, "Name it a.gif"),
        ("a.png", {}, "Use at=0.5"),
        ("a.gif", {"at": 0.5}, "Leave at out"),
        ("a.png", {"at": 1.5}, "a time of the run, 0 to 1 s"),
        ("a.png", {"at": "soon"}, "at is not usable"),
        ("a.gif", {"size": "800"}, "800x600"),
        ("a.gif", {"size": (0, 10)}, "size"),
        ("a.gif", {"size": (8, 10)}, "from 16 to 4096"),
        ("a.gif", {"size": "90000x20"}, "from 16 to 4096"),
        ("a.mp4", {"size": (101, 100)}, "even"),
        ("a.gif", {"fps": 0}, "fps"),
        ("a.gif", {"speed": -1.0}, "speed"),
        ("a.gif", {"start": 0.6, "end": 0.5}, "end"),
        ("a.gif", {"speed": 1e-4}, "at most 5000 frames"),
        ("a.gif", {"camera": "bottom"}, "camera|Camera"),
        ("a.gif", {"forces": 1}, "forces"),
        ("a.gif", {"labels": 1}, "labels"),
        ("a.gif", {"transparent": True}, "a .png for it"),
        ("a.mp4", {"dpi": 300}, "a .png for it"),
        ("a.png", {"at": 0.5, "dpi": 0}, "dpi"),
        ("a.gif", {"ground": "no"}, "ground"),
        ("a.gif", {"force_scale": 0.0}, "force_scale"),
    ],
)
def test_bad_arguments(ball, tmp_path, monkeypatch, name, options, match):
    """They are told where there is no browser, too."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(cvi.InputError, match=match):
        ball.render(tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


def test_no_browser_is_said_with_a_remedy(ball, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(cvi.ContactviError, match="apt install chromium"):
        ball.render(tmp_path / "a.gif")


def test_no_ffmpeg_is_said_before_anything_is_drawn(ball, tmp_path, monkeypatch):
    program(tmp_path, "chromium", f"touch {tmp_path}/started")
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    monkeypatch.setattr(shutil, "which", which_but("ffmpeg"))
    with pytest.raises(cvi.ContactviError, match="apt install ffmpeg"):
        ball.render(tmp_path / "a.mp4")
    assert not (tmp_path / "started").exists()


def which_but(hidden: str):
    which = shutil.which
    return lambda name, *rest, **more: None if name == hidden else which(name, *rest, **more)


def test_a_browser_that_ends_is_an_error_with_its_last_words(ball, tmp_path, monkeypatch):
    program(tmp_path, "chromium", "echo first >&2; echo 'no display' >&2; exit 3")
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    with pytest.raises(cvi.ContactviError, match="its end with code 3: no display"):
        ball.render(tmp_path / "a.png", at=0.5)
    assert not (tmp_path / "a.png").exists()


def test_a_browser_that_draws_nothing_is_given_up(ball, tmp_path, monkeypatch):
    program(tmp_path, "chromium", f"echo $$ > {tmp_path}/id; exec sleep 600")
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    monkeypatch.setattr(headless, "PATIENCE", 1.0)
    with pytest.raises(cvi.ContactviError, match="nothing for 1 s"):
        ball.render(tmp_path / "a.png", at=0.5)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "id").read_text()), 0)


# -- in a browser ------------------------------------------------------------------------------------------------------


def green(picture: np.ndarray) -> np.ndarray:
    red, greens, blue = (picture[..., k].astype(int) for k in range(3))
    return (greens > red + 40) & (greens > blue + 20)


@pytest.fixture(scope="module")
def falling() -> cvi.Trajectory:
    """A green ball that falls from a metre beside a wall."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, color=(0.1, 0.6, 0.2, 1.0), placement=(0, 0, 1.0))
    return cvi.simulate(scene, duration=0.4, dt=1e-2)


@pytest.mark.browser
def test_picture_of_one_time(falling, tmp_path):
    """It fits to the ball at that time; seen from one place the ball falls through the picture."""
    heights, place = [], {"eye": [0.0, -2.0, 0.6], "target": [0.0, 0.0, 0.6]}
    for time in (0.0, 0.4):
        near = falling.render(tmp_path / "near.png", overwrite=True, at=time, size="320x240", camera="side")
        with Image.open(near) as image:
            rows, columns = np.nonzero(green(np.asarray(image.convert("RGB"))))
        assert max(np.ptp(rows) / 240, np.ptp(columns) / 320) > 0.5
        assert abs(rows.mean() - 119.5) < 12
        file = falling.render(tmp_path / "a.png", overwrite=True, at=time, size="320x240", camera=place)
        with Image.open(file) as image:
            assert image.size == (320, 240)
            shown = green(np.asarray(image.convert("RGB")))
        assert shown.sum() > 100
        heights.append(np.flatnonzero(shown.any(axis=1)).mean())
    # From 1 m to 1 - g t^2 / 2 = 0.215 m: a good part of the picture's height.
    assert 0.3 * 240 < heights[1] - heights[0] < 240
    followed = falling.render(tmp_path / "b.png", at=0.4, size=(320, 240), camera={"follow": "ball"})
    with Image.open(followed) as image:
        rows, columns = np.nonzero(green(np.asarray(image.convert("RGB"))))
    assert [columns.mean(), rows.mean()] == pytest.approx([160, 120], abs=6)


@pytest.mark.browser
def test_film(falling, tmp_path):
    file = falling.render(tmp_path / "a.gif", size=(160, 120), camera="side", fps=15.0, speed=0.5, start=0.1, end=0.3)
    with Image.open(file) as image:
        assert image.n_frames == 7  # 0.2 s / 0.5 * 15 + 1
        durations, places = [], []
        for k in range(image.n_frames):
            image.seek(k)
            durations.append(image.info["duration"])
            places.append(np.flatnonzero(green(np.asarray(image.convert("RGB"))).any(axis=1)).mean())
    assert sum(durations[:6]) == pytest.approx(6000 / 15, abs=10)
    assert np.all(np.diff(places) > 0)


@pytest.mark.browser
def test_frames_of_a_film_in_which_nothing_moves_are_drawn_once(tmp_path, monkeypatch):
    """A ball falls, and then lies: each frame of the fall is sent, those at rest are not, and the film shows them."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, color=(0.1, 0.6, 0.2, 1.0), placement=(0, 0, 0.3))
    scene.set_contact(restitution=0.0)
    run = cvi.simulate(scene, duration=1.0, dt=1e-2)
    landed = np.sqrt(2.0 * 0.2 / 9.81)
    sizes, plain = [], headless.pictures

    def watched(page, count):
        for data in plain(page, count):
            sizes.append(len(data))
            yield data

    monkeypatch.setattr(render_module, "pictures", watched)
    program(tmp_path, "ffmpeg", 'for last; do :; done; exec cat > "$last"')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with headless.measured() as cost:
        film = run.render(tmp_path / "a.mp4", size=(96, 72), fps=20.0, camera="side", forces=False)
    sent = np.array(sizes) > 0
    assert (cost.asked, cost.drawn) == (21, sent.sum())
    assert not cost.seconds <= 0.0
    assert len(sent) == 21
    times = np.arange(21) / 20.0
    assert np.all(sent[times < landed])
    assert not sent[times > landed + 0.1].any()
    assert set(sizes) == {0, 4 * 96 * 72}
    frames = np.frombuffer(film.read_bytes(), np.uint8).reshape(-1, 72, 96, 3)
    places = [np.flatnonzero(green(frame).any(axis=1)).mean() for frame in frames]
    assert len(places) == 21
    assert np.all(np.diff(places)[: np.count_nonzero(times < landed) - 1] > 0)
    assert np.array_equal(frames[-1], frames[-8])
    assert not np.array_equal(frames[-1], frames[0])


@pytest.mark.browser
def test_edges_of_films_are_smooth(tmp_path, monkeypatch):
    """A square that is turned a little: pixels at its edges are between it and what is behind it."""
    scene = cvi.Scene(gravity=(0, 0, 0))
    scene.add_box("box", (0.2, 0.2, 0.2), color=(0.1, 0.1, 0.1, 1.0), placement=((0, 0, 0), (0.3, 0, 0)))
    program(tmp_path, "ffmpeg", 'for last; do :; done; exec cat > "$last"')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    camera = {"eye": [2.0, 0, 0], "target": [0, 0, 0]}
    run = cvi.simulate(scene, duration=0.1, dt=1e-2)
    film = run.render(tmp_path / "a.mp4", size=(160, 120), fps=20.0, camera=camera, forces=False)
    frame = np.frombuffer(film.read_bytes(), np.uint8).reshape(-1, 120, 160, 3)[0].mean(axis=2)
    values, counts = np.unique(frame, return_counts=True)
    box, behind = sorted(values[np.argsort(counts)[-2:]])
    between = np.count_nonzero((frame > box + 10) & (frame < behind - 10))
    side = np.sqrt(np.count_nonzero(frame < box + 10))
    assert 4 * side / 2 < between < 4 * side * 3


@pytest.mark.browser
def test_names_and_scales_are_in_every_frame_of_a_film(tmp_path):
    """The name moves with the ball, and the scale of forces stays where it is."""
    box = sliding_box()
    options = {"size": (320, 240), "fps": 10.0, "end": 0.4, "camera": "side"}
    films = {}
    for name, shown in (("plain", {"forces": False}), ("named", {"forces": False, "labels": True}), ("scaled", {})):
        with Image.open(box.render(tmp_path / f"{name}.gif", **options, **shown)) as image:
            frames = []
            for k in range(image.n_frames):
                image.seek(k)
                frames.append(np.asarray(image.convert("RGB")).astype(int))
        films[name] = np.array(frames)
    assert len(films["plain"]) == len(films["named"]) == len(films["scaled"]) == 5
    columns, inked = [], []
    for plain, named, scaled in zip(*films.values(), strict=True):
        changed = np.abs(named - plain).max(axis=2) > 60
        assert changed.sum() > 50
        columns.append(np.flatnonzero(changed.any(axis=0)).mean())
        inked.append(np.abs(scaled - (0x1D, 0x27, 0x33)).max(axis=2)[-30:, :120] < 40)  # the colour of the scale
    assert np.all(np.diff(columns) > 1.0)
    assert inked[0].sum() > 60
    assert all(np.mean(ink == inked[0]) > 0.99 for ink in inked)


@pytest.mark.browser
def test_film_by_ffmpeg_gets_the_frames(falling, tmp_path, monkeypatch):
    """A program in the place of ffmpeg writes what it gets: raw frames of the size that it was told."""
    program(tmp_path, "ffmpeg", f'echo "$@" > {tmp_path}/arguments; for last; do :; done; exec cat > "$last"')
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    file = falling.render(tmp_path / "a.mp4", size=(64, 48), fps=10.0, camera="side")
    frames = np.frombuffer(file.read_bytes(), np.uint8).reshape(-1, 48, 64, 3)
    assert len(frames) == 5
    places = [np.flatnonzero(green(frame).any(axis=1)).mean() for frame in frames]
    assert np.all(np.diff(places) > 0)
    assert "-s 64x48 -r 10" in (tmp_path / "arguments").read_text()
    program(tmp_path, "ffmpeg", "echo 'Unknown encoder libx264' >&2; exit 1")
    with pytest.raises(cvi.ContactviError, match="Unknown encoder libx264"):
        falling.render(tmp_path / "b.mp4", size=(64, 48), fps=10.0)
    assert not (tmp_path / "b.mp4").exists()


@pytest.mark.browser
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg")
def test_film_of_ffmpeg(falling, tmp_path):
    file = falling.render(tmp_path / "a.mp4", size=(64, 48), fps=10.0)
    assert file.read_bytes()[4:8] == b"ftyp"


@pytest.mark.browser
def test_pictures_show_forces_on_wish(tmp_path):
    box, shown = sliding_box(), []
    for forces in (True, False):
        with Image.open(box.render(tmp_path / f"{forces}.png", at=0.5, size=(320, 240), forces=forces)) as image:
            pixels = np.asarray(image.convert("RGB")).astype(int)
        shown.append((np.abs(pixels - (0x1E, 0x4F, 0xBF)).max(axis=2) < 40).sum())
    assert shown[0] > 100
    assert shown[1] == 0


@pytest.mark.browser
def test_pictures_tell_how_long_a_newton_is(tmp_path):
    """The arrow of a known weight beside that of the scale: the scale's is one of 1, 2, 5, 10, ... newtons."""
    run = heavy_ball()
    file = run.render(tmp_path / "a.png", at=0.1, size=(640, 480), camera="side")
    with Image.open(file) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    blue = np.abs(pixels - (0x1E, 0x4F, 0xBF)).max(axis=2) < 60
    ink = np.abs(pixels - (0x1D, 0x27, 0x33)).max(axis=2) < 60  # of the scale, whose words are on the right of it
    row = ink[460:468, :200].sum(axis=1).argmax() + 460
    scale_length = np.flatnonzero(np.diff(np.flatnonzero(ink[row, :200]), append=1000) > 1)[0] + 1
    grey = np.abs(pixels[:, 310:330] - 0x8C).max(axis=2) < 6  # the point from which the force's arrow starts
    arrow_length = np.flatnonzero(grey.any(axis=1)).mean() - np.flatnonzero(blue[:, 300:340].any(axis=1))[0]
    newtons = 3.0 * 9.81 * scale_length / arrow_length
    known = np.array([digit * 10.0**power for power in range(-1, 4) for digit in (1, 2, 5)])
    nearest = known[np.argmin(np.abs(np.log(known / newtons)))]
    assert newtons == pytest.approx(nearest, rel=0.1)  # the ball is not just at the target, and pixels are whole
    assert 0.06 * 640 < scale_length < 0.17 * 640


def heavy_ball() -> cvi.Trajectory:
    """A ball of 3 kg that lies on the ground, seen through: it hides no arrow."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1, mass=3.0, color=(0.8, 0.8, 0.2, 0.3), placement=(0, 0, 0.1))
    scene.set_contact(restitution=0.0)
    return cvi.simulate(scene, duration=0.2, dt=1e-2)


@pytest.mark.browser
@pytest.mark.parametrize("force_scale", [100.0, 60.0])
def test_a_given_scale_of_forces_is_that_of_the_arrows(tmp_path, force_scale):
    """Seen from the side, the arrow of the weight and that of the scale are as long as the camera says."""
    distance, height = 2.0, 480
    camera = {"eye": (0.0, -distance, 0.1), "target": (0.0, 0.0, 0.1)}
    file = heavy_ball().render(
        tmp_path / "a.png", at=0.1, size=(640, height), camera=camera, force_scale=force_scale
    )  # fmt: skip
    with Image.open(file) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    per_metre = height / (2.0 * distance * np.tan(np.radians(15.0)))
    blue = np.abs(pixels[:, 300:340] - (0x1E, 0x4F, 0xBF)).max(axis=2) < 60
    tip = np.flatnonzero(blue.any(axis=1))[0]
    start = height / 2 + 0.1 * per_metre  # the ground is a tenth of a metre below the middle
    assert start - tip == pytest.approx(3.0 * 9.81 / force_scale * per_metre, abs=3.0)
    ink = np.abs(pixels - (0x1D, 0x27, 0x33)).max(axis=2) < 60
    row = ink[460:468, :120].sum(axis=1).argmax() + 460
    length = np.flatnonzero(np.diff(np.flatnonzero(ink[row, :200]), append=1000) > 1)[0] + 1
    newtons = length / per_metre * force_scale
    known = np.array([digit * 10.0**power for power in range(-1, 4) for digit in (1, 2, 5)])
    nearest = known[np.argmin(np.abs(np.log(known / newtons)))]
    assert newtons == pytest.approx(nearest, abs=2.0 / per_metre * force_scale)  # two pixels


@pytest.mark.browser
def test_a_picture_without_background(falling, tmp_path):
    """Nothing is where sky and ground were, but the shadow on it; the ball is as it was; and the file says how many
    pixels an inch has."""
    camera = {"eye": (0.0, -2.0, 1.2), "target": (0.0, 0.0, 0.35)}
    options = {"at": 0.4, "size": "160x120", "camera": camera}
    file = falling.render(tmp_path / "a.png", transparent=True, dpi=300, **options)
    with Image.open(file) as image:
        assert image.mode == "RGBA"
        assert image.info["dpi"] == pytest.approx((300, 300), abs=0.1)
        pixels = np.asarray(image)
    with Image.open(falling.render(tmp_path / "b.png", **options)) as image:
        assert image.mode == "RGB"
        plain = np.asarray(image)
    ball = green(plain)
    inner = ball & np.roll(ball, 2, 0) & np.roll(ball, -2, 0) & np.roll(ball, 2, 1) & np.roll(ball, -2, 1)
    assert inner.sum() > 50
    assert pixels[inner, 3].min() == 255
    assert np.abs(pixels[inner, :3].astype(int) - plain[inner]).max() <= 3
    alpha = pixels[..., 3]
    assert [alpha[2, 2], alpha[-3, 2], alpha[-3, -3]] == [0, 0, 0]  # the lower corners show the ground
    shadow = np.abs(alpha.astype(int) - 0.25 * 255) < 1.0  # of the opacity that it has where no sun comes
    assert (pixels[shadow, :3].max(axis=1) <= 3).sum() > 50  # others are on the border of the ball


@pytest.mark.browser
def test_the_ground_is_left_out_or_drawn_on_wish(falling, tmp_path):
    camera = {"eye": (0.0, -2.0, 1.2), "target": (0.0, 0.0, 0.35)}
    options = {"at": 0.4, "size": "160x120", "camera": camera, "forces": False}
    with Image.open(falling.render(tmp_path / "a.png", ground=False, **options)) as image:
        bare = np.asarray(image).astype(int)
    assert np.abs(bare[[2, -3, -3], [2, 2, -3]] - bare[2, -3]).max() == 0  # all of it is sky
    with Image.open(falling.render(tmp_path / "b.png", ground=True, transparent=True, **options)) as image:
        alpha = np.asarray(image)[..., 3]
    assert min(alpha[-3, 2], alpha[-3, -3]) > 80  # it fades out in the distance
    assert alpha[2, 2] == 0


@pytest.mark.browser
def test_names_are_written_on_wish(falling, tmp_path):
    shown = []
    for labels in (True, False):
        file = falling.render(tmp_path / f"{labels}.png", at=0.2, size=(320, 240), labels=labels, forces=False)
        with Image.open(file) as image:
            shown.append(np.asarray(image.convert("RGB")).astype(int))
    changed = np.argwhere(np.abs(shown[0] - shown[1]).max(axis=2) > 60)
    assert len(changed) > 50
    low, high = changed.min(axis=0), changed.max(axis=0)
    assert np.all(high - low < (24, 60))  # one word
    assert 0.5 * (low + high) == pytest.approx([119.5, 159.5], abs=12)  # at the ball, to which the picture fits


@pytest.mark.browser
def test_a_browser_without_webgl_is_said(falling, tmp_path, monkeypatch):
    plain = headless.pictures
    blind = "<script>HTMLCanvasElement.prototype.getContext = () => null;</script></head>"
    monkeypatch.setattr(render_module, "pictures", lambda page, n: plain(page.replace("</head>", blind, 1), n))
    with pytest.raises(cvi.ContactviError, match="WebGL"):
        falling.render(tmp_path / "a.png", at=0.1)


@pytest.mark.browser
def test_what_goes_wrong_in_the_page_is_said():
    page = "<script>fetch('failed', {method: 'POST', body: 'no WebGL'})</script>"
    with pytest.raises(cvi.ContactviError, match="no WebGL"):
        list(headless.pictures(page, 1))
