"""Pictures without a browser: where things are follows from the pinhole camera, and what is nearer hides the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi.playback import sketch
from contactvi.playback.animation import Frames, Poses
from contactvi.playback.lathe import outline_mesh
from contactvi.playback.live_frames import BodyPoses
from contactvi.playback.open_side import trees_of
from contactvi.playback.scene_visuals import from_scene
from contactvi.playback.sight import covered
from contactvi.playback.sketch import Sketch
from contactvi.playback.touches import Touches

MODELS = Path(__file__).resolve().parents[2] / "models"

EYE, SIZE = (4.0, 0.0, 0.0), (200, 100)
SCALE = 0.5 * 100 / np.tan(np.radians(15.0))  # [pixels] of 1 m at 1 m: 30 degrees of height


def scene_of(**places: tuple[float, float, float]) -> cvi.Scene:
    scene = cvi.Scene()
    for name, place in places.items():
        scene.add_sphere(name, radius=0.1, mass=1.0, placement=place)
    return scene


def drawn(scene: cvi.Scene, target=(0.0, 0.0, 0.0), q=None) -> np.ndarray:
    q = scene.neutral() if q is None else q
    return Sketch(scene, q, size=SIZE, camera={"eye": list(EYE), "target": list(target)}).draw(q)


def body(picture: np.ndarray) -> np.ndarray:
    """Pixels that are coloured: sky and ground are grey."""
    return np.ptp(picture.astype(int), axis=2) > 15


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, 0.5, 0.2), (1.0, -0.3, -0.1)])
def test_a_ball_is_where_the_camera_sees_it(place):
    rows, columns = np.nonzero(body(drawn(scene_of(ball=place))))
    depth = EYE[0] - place[0]
    # Seen from +x along -x, +y is to the right and +z upwards.
    wanted = 100 + SCALE * place[1] / depth, 50 - SCALE * place[2] / depth
    assert np.array([columns.mean() + 0.5, rows.mean() + 0.5]) == pytest.approx(wanted, abs=0.75)
    # The outline is the cone around the ball, less what a polygon of 24 sides lacks, 1.2 %; pixels at its border count
    # where they are covered in part.
    radius = SCALE * 0.1 / np.sqrt(depth**2 - 0.1**2)
    assert 0.988 * np.pi * (radius - 0.1) ** 2 <= len(rows) <= np.pi * (radius + 1.0) ** 2


def test_what_is_nearer_hides_the_rest():
    """In whatever order they are drawn: the near one is the first body, seen from the other side the second."""
    ahead, behind = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)
    both = scene_of(first=ahead, second=behind)
    np.testing.assert_array_equal(drawn(both), drawn(scene_of(first=ahead)))
    q = both.neutral()
    around = Sketch(both, q, size=SIZE, camera={"eye": [-4.0, 0.0, 0.0], "target": [0.0, 0.0, 0.0]}).draw(q)
    color = around[50, 100].astype(float) / drawn(both)[50, 100]
    assert np.ptp(color) > 0.2  # another ball's colour


def test_a_ground_ends_at_the_horizon_and_hides_what_is_below():
    scene = scene_of(ball=(0.0, 0.0, 0.15))
    scene.add_halfspace()
    q = scene.neutral()
    camera = {"eye": [4.0, 0.0, 0.5], "target": [0.0, 0.0, 0.5]}  # level: the horizon is in the middle
    above = Sketch(scene, q, size=SIZE, camera=camera)
    first = above.draw(q)
    assert np.ptp(first[:49, :20].reshape(-1, 3), axis=0).max() == 0  # sky
    assert np.ptp(first[60:, :20].reshape(-1, 3), axis=0).max() > 5  # squares
    assert body(first).any()
    q[2] = -0.2  # the ball is below the ground
    assert not body(above.draw(q)).any()
    q[2] = 0.15
    np.testing.assert_array_equal(above.draw(q), first)


def test_a_followed_body_stays_in_the_middle():
    scene = scene_of(ball=(0.0, 0.0, 0.0), other=(0.5, 0.5, 0.0))
    q = scene.neutral()
    sketch = Sketch(scene, q, size=SIZE, camera={"follow": "ball"})
    first = sketch.draw(q)
    q[:3] += [3.0, -2.0, 1.0]
    moved = sketch.draw(q)
    assert body(first)[50, 100]
    assert body(moved)[50, 100]
    rows, columns = np.nonzero(body(moved))  # the other one is out of the picture
    assert [columns.mean(), rows.mean()] == pytest.approx([99.5, 49.5], abs=1.0)


@pytest.mark.parametrize(
    ("shape", "sizes", "volume"),
    [
        ("box", (0.1, 0.2, 0.3), 8 * 0.1 * 0.2 * 0.3),
        ("sphere", (0.2,), 4 / 3 * np.pi * 0.2**3),
        ("ellipsoid", (0.1, 0.2, 0.3), 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
        ("cylinder", (0.1, 0.3), np.pi * 0.1**2 * 0.6),
        ("cone", (0.1, 0.3), np.pi * 0.1**2 * 0.6 / 3),
        ("capsule", (0.1, 0.3), np.pi * 0.1**2 * 0.6 + 4 / 3 * np.pi * 0.1**3),
    ],
)
def test_plain_shapes_have_their_volume_and_face_outwards(shape, sizes, volume):
    """By the divergence theorem over the triangles; polygons of 24 sides lack up to 2.5 %."""
    vertices, faces = outline_mesh(shape, sizes)
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    found = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0
    assert 0.97 * volume < found <= volume * (1 + 1e-6)


@pytest.mark.parametrize("size", [(10, 100), (100, 5000), "wide", (1.5, 20)])
def test_a_bad_size_is_refused(size):
    scene = scene_of(ball=(0.0, 0.0, 0.0))
    with pytest.raises(cvi.InputError, match="size"):
        Sketch(scene, scene.neutral(), size=size)


def test_an_unknown_body_is_not_followed():
    scene = scene_of(ball=(0.0, 0.0, 0.0))
    with pytest.raises(cvi.InputError, match="unknown body"):
        Sketch(scene, scene.neutral(), camera={"follow": "bal"})


@pytest.mark.parametrize("where", ["a hand under a ball", "a ball on the ground behind a wall"])
def test_the_camera_sees_what_will_touch(where):
    """The nearest points of different bodies are in the middle of the picture, and most of them in sight."""
    if where.startswith("a hand"):
        scene = cvi.load_scene(MODELS / "allegro_ball.toml")
        q = scene.q0
    else:
        scene = scene_of(ball=(0.0, 0.0, 0.11))
        scene.add_halfspace()
        scene.add_box("wall", (0.1, 1.0, 0.8), free=False, placement=(0.25, 0.0, 0.4))
        q = scene.neutral()
    sketch = Sketch(scene, q, size=SIZE)
    touches = Touches.expected(scene, q, trees_of(scene.model))
    assert len(touches) >= 2
    visuals = from_scene(scene)
    joints = sorted({joint for visual in visuals for joint in visual.joints})
    poses = dict(zip(joints, BodyPoses(scene.model, joints).at(q), strict=True))
    frames = Frames(np.zeros(1), {j: Poses(pose[None, :3], pose[None, 3:]) for j, pose in poses.items()})
    away = sketch._eye - sketch._target
    hidden = covered(visuals, frames, 0, touches.point, away[None] / np.linalg.norm(away))[0]
    assert touches.weight[np.isfinite(hidden)].sum() > 0.5 * touches.weight.sum()
    off = touches.center() - sketch._target
    aside = np.linalg.norm(off - off @ away / (away @ away) * away)
    assert aside < 0.5 * np.tan(np.radians(15.0)) * np.linalg.norm(away)


def test_a_lone_body_has_nothing_to_touch():
    scene = scene_of(ball=(0.0, 0.0, 0.0))
    assert len(Touches.expected(scene, scene.neutral(), trees_of(scene.model))) == 0


def test_triangles_are_those_of_an_oracle():
    """Drawn ones, some of no width, some beyond the picture, against every pixel in every triangle by its areas."""
    random, size = np.random.default_rng(3), (37, 29)
    canvas = sketch._Canvas(*size, np.array(EYE), np.zeros(3))
    corners = random.uniform(-12.0, 45.0, (60, 3, 2))
    corners[::7, 2] = corners[::7, 1]  # a line
    corners[3::7] = np.round(corners[3::7]) + 0.5  # corners and edges at centres of pixels
    x, y = corners[..., 0], corners[..., 1]
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    nearness, shade = random.uniform(0.1, 1.0, (60, 3)), random.uniform(0.0, 1.0, (60, 3))
    real = area != 0.0
    canvas._fill(x[real], y[real], nearness[real], shade[real], np.array([255.0, 128.0, 64.0]))
    wanted, tone = np.zeros(size[::-1]), np.full(size[::-1], np.nan)
    sure = np.ones(size[::-1], dtype=bool)  # not within rounding of an edge
    for row in range(size[1]):
        for column in range(size[0]):
            for k in np.flatnonzero(real):
                parts = [
                    (x[k, j] - x[k, i]) * (row + 0.5 - y[k, i]) - (y[k, j] - y[k, i]) * (column + 0.5 - x[k, i])
                    for i, j in ((1, 2), (2, 0), (0, 1))
                ]
                weights = np.array(parts) / area[k]
                sure[row, column] &= abs(weights.min()) > 1e-6
                depth = weights @ nearness[k]
                if weights.min() >= 0.0 and depth > wanted[row, column]:
                    wanted[row, column], tone[row, column] = depth, weights @ shade[k]
    found = canvas._nearness.reshape(size[::-1])
    assert sure.mean() > 0.9
    assert np.abs(found - wanted)[sure].max() < 1e-9
    drawn_ = sure & (wanted > 0.0)
    assert np.abs(canvas._color.reshape(*size[::-1], 3)[drawn_][:, 0] - 255.0 * tone[drawn_]).max() < 1e-3


def test_what_is_fixed_is_drawn_once():
    """And is there in every picture: the pictures are those of a sketch that draws it for the first time."""
    scene = scene_of(ball=(0.0, 0.2, 0.0))
    scene.add_halfspace(offset=-0.5)
    scene.add_box("post", (0.1, 0.1, 0.6), free=False, placement=(0.0, -0.3, 0.0))
    camera, q = {"eye": list(EYE), "target": [0.0, 0.0, 0.0]}, scene.neutral()
    kept = Sketch(scene, q, size=SIZE, camera=camera)
    for height in (0.0, 0.1, -0.2):
        q[2] = height
        fresh = Sketch(scene, scene.neutral(), size=SIZE, camera=camera)
        np.testing.assert_array_equal(kept.draw(q), fresh.draw(q))
    assert (kept.draw(q) != drawn(scene_of(ball=(0.0, 0.2, -0.2)))).any()
