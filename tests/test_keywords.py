"""What users call things: unknown keywords, keys and flags lead to the right words; signatures show all options."""

from __future__ import annotations

import copy
import inspect
import pickle
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi
from contactvi import keywords
from contactvi.options import FurtherOptions, option_names
from contactvi.playback.page import write_html
from contactvi.playback.render import render
from contactvi.words import in_flags, in_lines
from helpers.run_scenes import ball_file, ball_scene


@pytest.mark.parametrize(
    ("word", "says"),
    [
        *((word, "Did you mean 'dt'") for word in ("timestep", "time_step", "step", "h")),
        *((word, "Did you mean 'duration'") for word in ("T", "t_end", "tend", "t_final", "horizon")),
        ("n_steps", "the number of steps times dt"),
        ("gravity", "Scene(gravity=(0, 0, -9.81))"),
        *((word, "set_contact(friction=...)") for word in ("mu", "friction", "friction_coefficient")),
        *((word, "set_contact(restitution=...)") for word in ("e", "restitution", "cor")),
        ("tolerance", "Did you mean 'tol'"),
        ("recordevery", "Did you mean 'record_every'"),
    ],
)
@pytest.mark.parametrize(
    "run",
    [
        lambda scene, **options: cvi.simulate(scene, **options),
        lambda scene, **options: cvi.Simulator(scene, **options),
        lambda scene, **options: cvi.simulate_batch(scene, **options),
    ],
)
def test_synonyms_of_the_options_of_a_run(run, word, says):
    with pytest.raises(cvi.InputError) as told:
        run(ball_scene(), **{word: 1.0})
    assert says in told.value.remedy
    assert told.value.name == word


def test_a_start_of_one_run_leads_to_those_of_a_batch():
    with pytest.raises(cvi.InputError, match="simulate_batch has no option 'v0'.*Did you mean 'v0s'"):
        cvi.simulate_batch(ball_scene(), v0=np.zeros(6), duration=0.1, dt=1e-2)


@pytest.mark.parametrize(
    ("call", "word", "says"),
    [
        (lambda s, **more: s.set_contact(**more), "mu", "Did you mean 'friction'"),
        (lambda s, **more: s.set_contact(**more), "e", "Did you mean 'restitution'"),
        (lambda s, **more: s.set_contact(**more), "cor", "Did you mean 'restitution'"),
        (lambda s, **more: s.add_sphere("b", **more), "r", "Did you mean 'radius'"),
        (lambda s, **more: s.add_sphere("b", 0.1, **more), "pos", "Did you mean 'placement'"),
        (lambda s, **more: s.add_sphere("b", 0.1, **more), "rgba", "Did you mean 'color'"),
        (lambda s, **more: s.set_joint("ball", **more), "k", "Did you mean 'stiffness'"),
        (lambda s, **more: s.add_spring("ball", "world", **more), "c", "Did you mean 'damping'"),
    ],
)
def test_synonyms_of_the_arguments_of_a_scene(call, word, says):
    scene = ball_scene()
    before = scene.to_dict()
    with pytest.raises(cvi.InputError, match="has no argument") as told:
        call(scene, **{word: 0.5})
    assert says in told.value.remedy
    assert scene.to_dict() == before


def test_a_warning_of_a_scene_is_that_of_the_line_of_the_call():
    scene = ball_scene()
    scene.disable_pair("ball", "ground")
    with pytest.warns(cvi.UnusedSettingWarning) as told:
        scene.set_contact("ball", "ground", restitution=0.3)
    assert [warning.filename for warning in told] == [__file__]


def test_the_signatures_of_runs_show_every_option():
    for function in (cvi.simulate, cvi.Simulator, cvi.simulate_batch, cvi.check_gradient):
        parameters = inspect.signature(function).parameters
        assert not [p for p in parameters.values() if p.kind is p.VAR_KEYWORD]
        assert {*FurtherOptions.__annotations__} <= {*parameters}
    whole = inspect.signature(cvi.simulate).parameters
    assert {*option_names()} <= {*whole}
    assert whole["zeno"].annotation.__args__[0].__args__ == ("hold", "end")


def test_the_docstrings_of_runs_describe_every_option_once():
    for function in (cvi.simulate, cvi.simulate_batch):
        entries = keywords._entries(function.__doc__)
        for name in FurtherOptions.__annotations__:
            assert len(entries[name]) > len(name) + 10
            assert function.__doc__.count(f"\n    {name}: ") == 1
    assert "**options" not in cvi.simulate.__doc__


@pytest.mark.parametrize(("method", "function"), [("to_html", write_html), ("render", render)])
def test_pictures_have_the_signature_and_the_texts_of_what_draws_them(method, function):
    shown = inspect.signature(getattr(cvi.Trajectory, method))
    wanted = inspect.signature(function)
    assert [*shown.parameters][1:] == [*wanted.parameters][1:]
    kinds = [[p.annotation for p in signature.parameters.values()][1:] for signature in (shown, wanted)]
    assert kinds[0] == kinds[1]
    assert getattr(cvi.Trajectory, method).__doc__ == function.__doc__
    traj = cvi.simulate(ball_scene(), duration=0.1, dt=1e-2)
    assert "self" not in inspect.signature(getattr(traj, method)).parameters
    with pytest.raises(cvi.InputError, match=f"{method} has no option 'fsp'.*Did you mean 'fps'"):
        getattr(traj, method)("run.html", fsp=3)


def test_the_view_shows_the_options_of_runs_and_of_simulators():
    parameters = inspect.signature(cvi.view).parameters
    assert {"open_browser", "fps", "title", "play", "forces", "camera", "realtime"} <= {*parameters}
    assert "overwrite" not in parameters
    assert "    realtime: True, so that" in cvi.view.__doc__
    with pytest.raises(cvi.InputError, match="has no option 'overwrite'"):
        cvi.view(cvi.simulate(ball_scene(), duration=0.1, dt=1e-2), open_browser=False, overwrite=True)


def test_a_text_in_the_words_of_the_command_line_and_of_scene_files():
    flags = {"dt": "--dt", "record_every": "--record-every"}
    assert in_flags("Give dt=..., for example dt=1e-3", flags) == "Give --dt ..., for example --dt 1e-3"
    assert in_flags("Use dt='auto' and record_every=3", flags) == "Use --dt auto and --record-every 3"
    assert in_flags("Give overwrite=True", flags) == "Give --force"
    assert in_flags("Use contact_points=4", {}) == "Use contact_points = 4 under [run] in the scene file"
    assert in_lines("Give dt=1e-3, zeno='hold', dense=True") == 'Give dt = 1e-3, zeno = "hold", dense = true'


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("[run]\ntimestep = 0.01", "Did you mean 'dt'"),
        ("[run]\nT = 1.0", "Did you mean 'duration'"),
        ("[run]\ngravity = [0, 0, -9.81]", "Write it as gravity = ... under [scene]"),
        ("[run]\nmu = 0.5", "Write it as friction = ... under [contact]"),
        ("[contact]\nmu = 0.5", "Did you mean 'friction'"),
        ("[contact]\ne = 0.5", "Did you mean 'restitution'"),
        ("[scene]\ntimestep = 0.01", "Write it as dt = ... under [run]"),
        ('[run]\ndt = 1e-3\ncontact_mode = "steps"\nzeno = "end"', 'Give dt = 1e-3, impact = "ctec" or'),
        ("[run]\ndt = 1e-3\norder = 3", "Use order = 4"),
    ],
)
def test_remedies_of_a_scene_file_are_lines_of_it(tmp_path: Path, lines: str, says: str):
    file = tmp_path / "scene.toml"
    file.write_text('[[sphere]]\nname = "ball"\nradius = 0.1\n\n' + lines)
    with pytest.raises(cvi.ContactviError) as told:
        cvi.load_scene(file)
    assert says in told.value.remedy
    assert told.value.remedy in str(told.value)


def test_remedies_of_the_command_line_are_flags(command, tmp_path):
    scene = ball_file(tmp_path)
    for arguments, says in (
        (("--order", 3), "Use --order 4"),
        (("--dt", "auto", "--order", 2), "Use --order 16"),
        (("--dt", "auto", "--solver-tol", 1e-9), "give --dt"),
        (("--dt", "auto", "--record-every", 5), "Use --sample-dt"),
    ):
        result = command("run", scene, *arguments)
        assert result.exit_code == 2
        assert says in result.stderr
        assert "=" not in result.stderr.split("remedy:")[1]


def test_tol_beside_a_fixed_step_is_told_in_the_words_of_the_command_line(command, tmp_path):
    result = command("run", ball_file(tmp_path), "--tol", 1e-9, "--no-html", "--no-plot", "-o", "out")
    assert result.exit_code == 0
    assert "--solver-tol 1e-09" in result.stderr
    assert "DeprecatedWarning" not in result.stderr
    assert cvi.Trajectory.load("out/trajectory.npz").options.solver_tol == 1e-9
    assert np.isnan(cvi.Trajectory.load("out/trajectory.npz").error_estimate)


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda: cvi.Simulation, "contactvi has no attribute 'Simulation'. Did you mean 'Simulator'?"),
        (lambda: cvi.Trajektory, "Did you mean 'Trajectory'?"),
        (lambda: cvi.Scene().add_plane, "A scene has no attribute 'add_plane'. Did you mean 'add_halfspace'?"),
        (lambda: cvi.Scene().set_contacts, "Did you mean 'set_contact'?"),
    ],
)
def test_an_attribute_that_is_not_there_leads_to_the_right_one(ask, says):
    with pytest.raises(AttributeError) as told:
        ask()
    assert says in str(told.value)


def test_names_of_python_are_asked_for_as_ever():
    """hasattr, copies and pickles ask for names that a scene has not; submodules are imported by `from`."""
    scene = ball_scene()
    assert not hasattr(scene, "__array__")
    assert not hasattr(cvi, "__wrapped__")
    assert copy.deepcopy(scene).nq == pickle.loads(pickle.dumps(scene)).nq
    from contactvi import verify  # noqa: F401


def test_half_extents_are_told_to_be_half():
    with pytest.raises(cvi.InputError, match="'size', the full edges: twice as long"):
        cvi.Scene().add_box("box", half_extents=(0.1, 0.1, 0.1))


def test_two_numbers_are_no_placement():
    with pytest.raises(cvi.InputError, match=r"got \(0, 0\)\. Give a position \(x, y, z\)"):
        cvi.Scene().add_box("box", (0.1, 0.1, 0.1), placement=(0, 0))


def test_a_method_is_an_order_or_an_impact_map():
    with pytest.raises(cvi.InputError, match="order=2, 4, .* impact='ctec'"):
        cvi.simulate(ball_scene(), method="rk4", duration=1.0)


def test_parts_without_joints_are_no_joints():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_urdf("models/double_pendulum.urdf")
    with pytest.raises(cvi.InputError, match="Use one of 'joint_1', 'joint_2', 'double_pendulum'") as told:
        scene.set_joint("wrist", damping=1.0)
    assert "ground" not in told.value.remedy
