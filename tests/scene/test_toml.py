"""Scene files: every entry reaches the scene, and a misspelt word is an error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import contactvi as cvi
from contactvi.errors import ContactviError, InputError, SceneError
from contactvi.scene.toml import load_scene
from contactvi.scene.toml_tables import KEYS
from helpers.extras import needs_mujoco

MODELS = Path(__file__).resolve().parents[2] / "models"
EPS = np.finfo(float).eps

PAGE = """
[scene]
gravity = [0, 0, -3.7]
title = "all of it"

[[urdf]]
path = "example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf"
prefix = "h_"
xyz = [0, 0, 1]
rpy = [0, -1.5707963267948966, 0]

[[sphere]]
name = "ball"
radius = 0.03
mass = 0.1
xyz = [0, 0, 2]

[[box]]
name = "crate"
size = [0.1, 0.2, 0.3]
xyz = [1, 1, 1]
color = [1, 0, 0, 0.5]

[[capsule]]
name = "post"
radius = 0.1
length = 1
free = false
xyz = [5, 0, 0]

[[cylinder]]
name = "can"
radius = 0.1
length = 0.2
xyz = [-1, 0, 1]

[[ellipsoid]]
name = "egg"
radii = [0.1, 0.2, 0.3]
xyz = [-2, 0, 1]

[[halfspace]]
normal = [0, 0, 2]
offset = -0.5

[contact]
restitution = 0.7
friction = 0.2
disable = [["ball", "crate"]]
enable = [["h_palm_link", "h_link_13.0"]]

[[contact.body]]
name = "can"
restitution = 0.3

[[contact.pair]]
a = "ball"
b = "ground"
restitution = 1

[[joint]]
name = "h_joint_*"
stiffness = 0.5
rest = 0.4
damping = 0.01

[[joint]]
name = "h_joint_12.0"
rest = 0.5
limits = [0.4, 0.6]
restitution = 0.1

[initial]
springs_at_rest = true
q = { "h_joint_1*" = 0.45, "h_joint_2.0" = 0.3 }
v = { "h_joint_2.0" = -2 }

[[initial.body]]
name = "crate"
rpy = [0, 0, 1.5707963267948966]
velocity = [1, 0, 0]
angular_velocity = [0, 0, 3]

[run]
dt = 1e-3
duration = 0.5
"""


def write(folder: Path, text: str) -> Path:
    file = folder / "scene.toml"
    file.write_text(text)
    return file


def test_every_entry_arrives(tmp_path: Path):
    scene = load_scene(write(tmp_path, PAGE))
    assert scene.model.gravity.linear == pytest.approx([0, 0, -3.7])
    assert (scene.nq, scene.nv) == (16 + 4 * 7, 16 + 4 * 6)
    e = dict(zip(scene.pair_names, scene.pair_restitution, strict=True))
    assert (e["ball", "ground"], e["can", "ground"], e["crate", "ground"]) == (1.0, 0.3, 0.7)
    assert ("ball", "crate") not in e
    assert ("h_palm_link_0", "h_link_13.0_0") in e
    assert set(scene.pair_friction) == {0.2}
    arrays = scene.built().arrays
    twelve = scene.model.getJointId("h_joint_12.0")
    assert (arrays.stiffness[twelve], arrays.rest[scene.q_index("h_joint_12.0")]) == (0.5, 0.5)
    assert arrays.limit_restitution[twelve] == 0.1
    assert scene.model.upperPositionLimit[scene.q_index("h_joint_12.0")] == 0.6
    q, v = scene.q0, scene.v0
    values = {name: q[scene.q_index(name)][0] for name in ("h_joint_0.0", "h_joint_1.0", "h_joint_12.0", "h_joint_2.0")}
    assert values == {"h_joint_0.0": 0.4, "h_joint_1.0": 0.45, "h_joint_12.0": 0.45, "h_joint_2.0": 0.3}
    assert v[scene.v_index("h_joint_2.0")] == -2.0
    half = np.sqrt(0.5)
    assert q[scene.q_index("crate")] == pytest.approx([1, 1, 1, 0, 0, half, half], abs=4 * EPS)
    # World x is the turned crate's -y; rotation about z is the same in both.
    assert v[scene.v_index("crate")] == pytest.approx([0, -1, 0, 0, 0, 3], abs=4 * EPS)
    assert scene.settings == {"dt": 1e-3, "duration": 0.5}
    crate = next(g for g in scene.visual_model.geometryObjects if g.name == "crate")
    assert crate.meshColor == pytest.approx([1, 0, 0, 0.5])


@pytest.mark.parametrize(
    ("line", "wrong", "near"),
    [
        ("[scene]", "[sceen]", "scene"),
        ("[[sphere]]", "[[spehre]]", "sphere"),
        ("gravity =", "gravty =", "gravity"),
        ("radius = 0.03", "raduis = 0.03", "radius"),
        ("disable =", "disabled =", "disable"),
        ("[[contact.pair]]", "[[contact.pairs]]", "pair"),
        ('b = "ground"', 'b = "ground"\nrestitutoin = 1', "restitution"),
        ("stiffness = 0.5", "stifness = 0.5", "stiffness"),
        ("springs_at_rest", "spring_at_rest", "springs_at_rest"),
        ("angular_velocity", "angular_velocty", "angular_velocity"),
        ("duration =", "duraton =", "duration"),
        ('name = "ball"\nradius', 'nmae = "ball"\nradius', "name"),
    ],
)
def test_an_unknown_key_names_the_nearest(tmp_path: Path, line: str, wrong: str, near: str):
    assert line in PAGE
    with pytest.raises(SceneError, match=rf"Did you mean '{near}'\?") as caught:
        load_scene(write(tmp_path, PAGE.replace(line, wrong, 1)))
    assert caught.value.path.endswith("scene.toml")


@pytest.mark.parametrize(
    ("line", "wrong", "says"),
    [
        ("[[urdf]]", "[urdf]", r"\[\[urdf\]\]"),
        ("[scene]", "[[scene]]", r"\[scene\]"),
        ("radius = 0.03", "radius = -0.03", r"\[\[sphere\]\] 1: .*radius of 'ball'.*> 0"),
        ("radius = 0.03", 'radius = "big"', "radius of 'ball'"),
        ("radius = 0.03", "", "lacks 'radius'"),
        ("mass = 0.1", "mass = 0", "mass of 'ball'"),
        ("mass = 0.1", "mass = nan", "mass of 'ball'"),
        ("xyz = [0, 0, 2]", "xyz = [0, 0]", r"\(3,\)"),
        ("size = [0.1, 0.2, 0.3]", "size = [0.1, 0.2]", r"\(3,\)"),
        ("restitution = 0.7", "restitution = 1.7", r"\[contact\].*\[0, 1\]"),
        ('disable = [["ball", "crate"]]', 'disable = [["ball", "crat"]]', "'crate'"),
        ('disable = [["ball", "crate"]]', 'disable = ["ball", "crate"]', "disable"),
        ('name = "can"\nrestitution', 'name = "cann"\nrestitution', "Did you mean 'can'"),
        ('name = "h_joint_*"', 'name = "x_joint_*"', r"\[\[joint\]\] 1"),
        ("limits = [0.4, 0.6]", "limits = [0.6, 0.4]", "lower < upper"),
        ('"h_joint_2.0" = 0.3', '"h_joint_20" = 0.3', "h_joint_2"),
        ('name = "crate"\nrpy', 'name = "h_joint_1.0"\nrpy', "free body"),
        ("rpy = [0, 0, 1.57", "quaternion = [0, 0, 2, 0]\nxyz = [0, 0, 1.57", "length 1"),
        ('path = "example', 'path = "exampl', "exampl-robot-data"),
        ("dt = 1e-3", "dt = -1e-3", r"\[run\].*dt"),
        ("duration = 0.5", "duration = 0.5\norder = 3", "order"),
        ("[run]", "[run", "not TOML"),
    ],
)
def test_bad_values_say_where_and_what(tmp_path: Path, line: str, wrong: str, says: str):
    assert line in PAGE
    with pytest.raises(ContactviError, match=says):
        load_scene(write(tmp_path, PAGE.replace(line, wrong, 1)))


def test_paths_are_relative_to_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "p.urdf").write_text((MODELS / "double_pendulum.urdf").read_text())
    file = write(tmp_path, '[[urdf]]\npath = "robots/p.urdf"\n')
    monkeypatch.chdir("/")
    assert load_scene(file).nv == 2


def test_an_empty_file_is_an_empty_scene(tmp_path: Path):
    scene = load_scene(write(tmp_path, ""))
    assert (scene.nq, scene.q0.shape, scene.settings) == (0, (0,), {})


def test_the_documentation_names_every_key():
    page, docstring = MODELS.parent / "docs" / "scene_files.md", load_scene.__globals__["__doc__"]
    if not page.is_file():
        pytest.skip("the tests were copied without the docs")
    readme = page.read_text()
    for section, keys in KEYS.items():
        for key in keys:
            assert (
                f"`{key}`" in readme
                or f"`{section.partition('.')[0]}.{key}`" in readme
                or f"[{section}.{key}]" in readme
            )
        assert f"[{section}]" in docstring


class TestModels:
    def test_double_pendulum_gap_is_the_tip_and_start_is_problem_b(self):
        scene = load_scene(MODELS / "double_pendulum_wall.toml")
        assert scene.q0.cumsum() == pytest.approx([0.3, 0.5], abs=EPS)
        assert not scene.built().arrays.limits.any()
        for q in (scene.q0, np.array([0.7, -1.9]), np.array([-0.2, 0.5])):
            assert scene.core().gaps(q)[0] == pytest.approx([np.sin(q[0]) + np.sin(q.sum())], abs=4 * EPS)
        assert scene.pair_restitution == pytest.approx([1.0])

    def test_double_pendulum_has_the_mass_matrix_of_point_masses(self):
        model = load_scene(MODELS / "double_pendulum_wall.toml").model
        q = np.array([0.4, 0.7])
        upper = np.triu(pin.crba(model, model.createData(), q))
        c = np.cos(q[1])
        assert upper == pytest.approx(np.array([[3 + 2 * c, 1 + c], [0, 1]]), abs=16 * EPS)

    def test_bouncing_ball_starts_one_metre_up(self):
        scene = load_scene(MODELS / "bouncing_ball.toml")
        assert scene.core().gaps(scene.q0)[0] == pytest.approx([1.0], abs=4 * EPS)
        assert scene.pair_restitution == pytest.approx([0.9])

    def test_allegro_ball(self):
        scene = load_scene(MODELS / "allegro_ball.toml")
        model, q = scene.model, scene.q0
        # Nothing in penetration (coal, not the engine), fingers at rest within their limits.
        data, shapes = model.createData(), scene.collision_model.createData()
        pin.computeDistances(model, data, scene.collision_model, shapes, q)
        assert min(result.min_distance for result in shapes.distanceResults) > 1e-3
        hand = slice(0, 16)
        assert np.all(model.lowerPositionLimit[hand] < q[hand])
        assert np.all(q[hand] < model.upperPositionLimit[hand])
        assert np.array_equal(q[hand], scene.spring_rest()[hand])
        # The palm looks up, its fingers lowered by 0.4 rad; the ball (6 cm, 0.1 kg) falls straight onto it.
        palm = next(g for g in scene.collision_model.geometryObjects if g.name == "palm_link_0")
        normal, fingers = palm.placement.rotation[:, 0], palm.placement.rotation[:, 2]
        assert normal == pytest.approx([np.sin(0.4), 0.0, np.cos(0.4)], abs=4 * EPS)
        assert fingers == pytest.approx([np.cos(0.4), 0.0, -np.sin(0.4)], abs=4 * EPS)
        ball = q[scene.q_index("ball")]
        height = normal @ (ball[:3] - palm.placement.translation) - 0.0204 - 0.03
        hit = ball[:3] - [0.0, 0.0, height / normal[2]] - 0.03 * normal - palm.placement.translation
        assert np.all(np.abs(palm.placement.rotation.T @ hit)[1:] < [0.0565, 0.0475])  # half edges of the palm
        assert 0.14 < height / normal[2] < 0.15
        assert model.inertias[model.getJointId("ball")].mass == 0.1

    def test_allegro_springs_are_what_the_file_says(self):
        scene = load_scene(MODELS / "allegro_ball.toml")
        model = scene.model
        inertia = np.diag(pin.crba(model, model.createData(), scene.q0))[:16]
        omega = np.sqrt(scene.built().arrays.stiffness[1:17] / inertia)
        ratio = model.damping[:16] / (2 * np.sqrt(scene.built().arrays.stiffness[1:17] * inertia))
        assert omega / (2 * np.pi) == pytest.approx(np.full(16, 10.0), rel=0.02)  # two to three digits in the file
        assert ratio == pytest.approx(np.full(16, 0.5), rel=0.03)


@pytest.mark.parametrize("name", ["nowhere.toml", ""])
def test_no_such_scene_file(name: str):
    with pytest.raises((SceneError, InputError)):
        load_scene(MODELS / name if name else name)


@pytest.mark.parametrize(
    ("name", "text", "section"),
    [
        ("r.urdf", "<robot name='r'><link name='a'/></robot>", "urdf"),
        pytest.param("r.xml", "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "mjcf", marks=needs_mujoco),
        ("r.toml", "\n<robot name='r'><link name='a'/></robot>", "urdf"),
    ],
)
def test_a_model_in_the_place_of_a_scene_gets_the_scene_that_loads_it(tmp_path: Path, name, text, section):
    (tmp_path / name).write_text(text)
    with pytest.raises(SceneError, match=rf"{name} is a model, not a scene: expected a scene file") as caught:
        load_scene(tmp_path / name)
    said, lines = caught.value.remedy.split("\n\n", 1)
    file = tmp_path / said.split()[4]
    assert not file.exists()
    assert f"[[{section}]]" in lines
    file.write_text(lines)
    scene = load_scene(file)
    assert len(scene.report.parts) == 1
    assert scene.settings == {"dt": 1e-3, "duration": 1.0}


# -- the camera -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ('camera = "top"', "top"),
        ('camera = { follow = "ball" }', {"follow": "ball"}),
        ("camera = { eye = [1, 2, 3], target = [0, 0, 0.5] }", {"eye": [1.0, 2.0, 3.0], "target": [0.0, 0.0, 0.5]}),
        ("", None),
    ],
)
def test_camera(tmp_path, line, expected):
    file = tmp_path / "scene.toml"
    file.write_text(f'[scene]\n{line}\n[[sphere]]\nname = "ball"\nradius = 0.1\n')
    scene = cvi.load_scene(file)
    assert scene.camera == expected
    assert cvi.Scene.from_dict(scene.to_dict()).camera == expected
    assert scene.copy().camera == expected


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ('camera = "tp"', "Did you mean 'top'"),
        ('camera = { follow = "bal" }', "Did you mean 'ball'"),
        ("camera = { eye = [1, 2, 3] }", "Add target"),
        ("camera = 3", r"scene.toml, \[scene\]"),
    ],
)
def test_bad_camera(tmp_path, line, match):
    file = tmp_path / "scene.toml"
    file.write_text(f'[scene]\n{line}\n[[sphere]]\nname = "ball"\nradius = 0.1\n')
    with pytest.raises(cvi.InputError, match=match):
        cvi.load_scene(file)


def test_descriptions_without_a_camera_are_read():
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    data = scene.to_dict()
    del data["camera"]
    assert cvi.Scene.from_dict(data).camera is None


def test_tol_of_a_file_with_a_fixed_step_is_taken_as_solver_tol_with_a_warning(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('[[sphere]]\nname = "ball"\nradius = 0.1\nmass = 1.0\n\n[run]\ndt = 0.01\ntol = 1e-9\n')
    with pytest.warns(cvi.DeprecatedWarning, match=r"scene.toml, \[run\].*solver_tol = 1e-09") as told:
        scene = cvi.load_scene(file)
    assert [warning.filename for warning in told] == [__file__]
    assert scene.settings == {"dt": 0.01, "solver_tol": 1e-9}


def test_tol_of_a_file_without_a_fixed_step_is_the_accuracy_of_q(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text('[[sphere]]\nname = "ball"\nradius = 0.1\nmass = 1.0\n\n[run]\nduration = 0.1\ntol = 1e-9\n')
    traj = cvi.simulate(cvi.load_scene(file))
    assert (traj.options.dt, traj.options.tol, traj.options.solver_tol) == ("auto", 1e-9, None)
    assert traj.error_estimate <= 1e-9
