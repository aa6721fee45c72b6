"""Plots: one time axis, instants as lines or strips, curves that stand for the numbers of the run."""

from __future__ import annotations

import io

import coal
import numpy as np
import pinocchio as pin
import pytest
from matplotlib.collections import LineCollection
from matplotlib.image import imread

import contactvi as cvi
from contactvi.records.pair_colors import pair_colors
from contactvi.trajectory import plot_layout
from contactvi.trajectory.plot_layout import Instants, draw_curve, draw_curves, panels
from contactvi.trajectory.plots import save_figure
from helpers.contact_runs import GRAVITY, MASS, MU, STOP, sliding_box
from helpers.loop_scenes import BAR, arm, arm_scene, four_bar, four_bar_start


@pytest.fixture(scope="module")
def box() -> cvi.Trajectory:
    return sliding_box()


@pytest.fixture(scope="module")
def bouncing() -> cvi.Trajectory:
    """A ball without losses, which hits the ground some hundred times."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", radius=0.1, mass=1.0, placement=(0, 0, 0.11))
    scene.set_contact(restitution=1.0)
    return cvi.simulate(scene, dt=0.01, order=4, duration=12.0)


def labels(axis) -> list[str]:
    found = axis.get_legend()
    return [] if found is None else [text.get_text() for text in found.get_texts()]


def instants(axis) -> list[LineCollection]:
    return [found for found in axis.collections if isinstance(found, LineCollection)]


def test_the_same_time_axis_in_all_figures(box, bouncing):
    for traj in (box, bouncing):
        figures = [cvi.plot(traj), cvi.plot_states(traj), cvi.plot_forces(traj), cvi.plot_forces(traj, by="body")]
        room = 0.01 * (traj.t[-1] - traj.t[0])
        for figure in figures:
            for axis in figure.axes:
                box_ = axis.get_position()
                if axis.get_shared_x_axes().get_siblings(axis) == [axis]:
                    continue  # a scale of colours
                assert axis.get_xlim() == pytest.approx((traj.t[0] - room, traj.t[-1] + room))
                assert (box_.x0, box_.x1) == pytest.approx((0.11, 0.74))


def test_few_impacts_are_lines_and_many_a_strip(bouncing, monkeypatch):
    assert len(bouncing.events) > plot_layout._MOST_INSTANTS
    figure = cvi.plot(bouncing)
    strip, energy = figure.axes[:2]
    (image,) = strip.get_images()
    assert image.get_array().sum() == len(bouncing.events)
    assert f"impacts: {len(bouncing.events)}" in strip.texts[0].get_text()
    assert not instants(energy)
    monkeypatch.setattr(plot_layout, "_MOST_INSTANTS", len(bouncing.events))
    axis = cvi.plot(bouncing).axes[0]
    (lines,) = instants(axis)
    assert [ends[0][0] for ends in lines.get_segments()] == np.unique(bouncing.events.array("time")).tolist()
    assert f"impacts ({len(bouncing.events)})" in labels(axis)


def test_lines_of_instants_cover_a_tenth_of_a_panel():
    time = np.linspace(0.0, 1.0, plot_layout._MOST_INSTANTS)
    figure, (axis,) = panels("", (0.0, 1.0), 1, [Instants("impacts", time, "red")])
    width = axis.get_position().width * figure.get_size_inches()[0] * 72
    (lines,) = instants(axis)
    covered = len(lines.get_segments()) * lines.get_linewidth()[0]
    assert 0.09 * width < covered <= 0.1 * width


def test_a_curve_with_many_swings_becomes_the_band_of_its_values():
    t = np.linspace(0.0, 1.0, 20001)
    y = np.sin(2000.0 * t) * (1.0 + t)
    _, (axis,) = panels("", (0.0, 1.0), 1)
    draw_curve(axis, t, y, "swings", color="blue")
    assert not axis.lines
    (band,) = axis.collections
    edges = band.get_paths()[0].vertices
    assert edges[:, 1].max() == pytest.approx(y.max(), rel=1e-12)
    assert edges[:, 1].min() == pytest.approx(y.min(), rel=1e-12)
    draw_curve(axis, t, np.sin(20.0 * t), "line", color="blue")
    draw_curve(axis, t, 20.0 + 1e-11 * y, "rounding", color="blue")  # the swings of rounding are not seen
    assert len(axis.lines) == 2


def test_many_curves_have_a_scale_of_colours_and_few_a_legend():
    t = np.linspace(0.0, 1.0, 5)
    curves = [(f"joint_{k}", t * k) for k in range(45)]
    figure, (axis,) = panels("", (0.0, 1.0), 1)
    draw_curves(axis, t, curves)
    assert len(axis.lines) == 45
    assert len({tuple(line.get_color()) for line in axis.lines}) == 45
    names = [tick.get_text() for tick in figure.axes[1].get_yticklabels()]
    assert names == [f"joint_{k}" for k in range(0, 45, 3)]
    _, (axis,) = panels("", (0.0, 1.0), 1)
    draw_curves(axis, t, curves[:10])
    assert labels(axis) == [f"joint_{k}" for k in range(10)]


def test_legends_lie_inside_of_the_figure(box):
    scene = cvi.Scene()
    scene.add_halfspace(name="a halfspace with quite a long name")
    scene.add_box("a box whose name is longer than any legend", size=(0.1, 0.1, 0.1), mass=1.0, placement=(0, 0, 0.05))
    traj = cvi.simulate(scene, dt=0.01, duration=0.1)
    for figure in (cvi.plot(traj), cvi.plot_forces(traj), cvi.plot_states(traj)):
        figure.savefig(io.BytesIO(), format="png")  # places the text
        for axis in figure.axes:
            if axis.get_legend() is not None:
                assert axis.get_legend().get_window_extent().x1 <= figure.bbox.x1


def test_forces_and_the_friction_cone(box):
    """A quarter of the weight on each corner; on the cone while it slides, in its middle after that."""
    normal, friction, ratio = cvi.plot_forces(box).axes[-3:]
    curve = max(normal.lines, key=lambda line: len(line.get_xdata()))
    assert np.nanmax(np.abs(curve.get_ydata() - MASS * GRAVITY)) < 1e-10
    curve = max(friction.lines, key=lambda line: len(line.get_xdata()))
    sliding = curve.get_xdata() < STOP - 0.1
    assert curve.get_ydata()[sliding] == pytest.approx(MU * MASS * GRAVITY * np.ones(sliding.sum()), rel=1e-9)
    dots = max(ratio.lines, key=lambda line: len(line.get_xdata()))
    assert len(dots.get_xdata()) == len(box.contacts)
    sliding = dots.get_xdata() < STOP - 0.1
    assert dots.get_ydata()[sliding] == pytest.approx(np.ones(sliding.sum()), rel=1e-9)
    assert np.abs(dots.get_ydata()[dots.get_xdata() > STOP + 0.1]).max() < 1e-12


def test_a_pair_has_one_colour_in_all_plots():
    """Light balls that fall from afar have the stronger impacts, heavy ones that lie the stronger forces."""
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(12):
        mass, height = (1.0 + 0.1 * k, 0.05) if k % 2 else (0.4 + 0.1 * k, 0.5)
        scene.add_sphere(f"ball {k}", radius=0.05, mass=mass, placement=(0.2 * k, 0, height))
    traj = cvi.simulate(scene, dt=0.01, duration=0.5)
    colors = {" | ".join(pair): color for pair, color in pair_colors(traj.events, traj.contacts).items()}
    assert len(set(colors.values())) == len(colors) == 12
    lasting = {" | ".join(contact.pair) for contact in traj.contacts.at(0.45)}
    assert len(lasting) == 6
    for figure, panel in ((cvi.plot(traj), -1), (cvi.plot_forces(traj), -3), (cvi.plot_forces(traj), -2)):
        drawn = {line.get_label(): line.get_color() for line in figure.axes[panel].lines if "|" in line.get_label()}
        shown = list(colors) if panel == -1 else [pair for pair in colors if pair in lasting]
        assert drawn == {pair: colors[pair] for pair in shown[:6]}


def test_the_balance_is_flat_with_damping_friction_and_a_motor():
    """Their work is put back, so that only the error of the steps is left: a thousandth of what they took."""
    scene = arm_scene(2)
    scene.set_joint("j*", friction=0.3, damping=0.1)
    traj = cvi.simulate(scene, dt=0.002, duration=1.0, control=np.full((500, 2), 0.2))
    (curve, *_) = cvi.plot(traj).axes[-1].lines
    assert "work put in" in curve.get_label()
    assert traj.work.joint_friction[-1] > 0.3
    assert np.ptp(curve.get_ydata()) < 1e-3 * traj.work.joint_friction[-1]


def test_forces_on_bodies(box):
    along_x, _, along_z = cvi.plot_forces(box, by="body").axes[-3:]
    assert labels(along_z) == ["box", "ground"]
    for body, sign in (("box", 1.0), ("ground", -1.0)):  # what is fixed to the world has the opposite force
        (curve,) = (line for line in along_z.lines if line.get_label() == body)
        assert np.nanmax(np.abs(curve.get_ydata() - sign * MASS * GRAVITY)) < 1e-10
        (curve,) = (line for line in along_x.lines if line.get_label() == body)
        sliding = curve.get_xdata() < STOP - 0.1
        assert curve.get_ydata()[sliding] == pytest.approx(
            -sign * MU * MASS * GRAVITY * np.ones(sliding.sum()), rel=1e-9
        )
    with pytest.raises(cvi.InputError, match="'pair' | 'body' | 'joint'"):
        cvi.plot_forces(box, by="bodies")


def has_zero_line(axis) -> bool:
    return any(np.array_equal(line.get_ydata(), [0.0, 0.0]) for line in axis.lines)


def test_what_has_a_sign_says_so_and_has_a_line_at_zero(box):
    for axis, name in zip(cvi.plot_forces(box, by="body").axes[-3:], "xyz", strict=True):
        assert axis.get_ylabel() == f"force on the body [N]\n(+ along {name})"
        assert has_zero_line(axis)
        low, high = axis.get_ylim()
        assert low < 0.0 < high


def test_efforts_of_joints():
    """A servo holds an arm up: the torque is the one of the weight, upwards."""
    scene = arm_scene(2)
    scene.set_servo("j*", 400.0, 40.0)
    traj = cvi.simulate(scene, duration=0.2, dt=1e-2)
    (axis,) = cvi.plot_forces(traj, by="joint").axes
    assert axis.get_ylabel() == "torque of servo and input [N m]\n(+ towards larger coordinates)"
    assert has_zero_line(axis)
    drawn = {line.get_label(): line.get_ydata() for line in axis.lines}
    for joint in ("j1", "j2"):
        assert np.array_equal(drawn[joint], traj.effort(joint))
    (axis,) = cvi.plot_forces(cvi.simulate(arm_scene(1), duration=0.1, dt=1e-2), by="joint").axes
    assert axis.texts[0].get_text() == "no joint is driven"
    with pytest.raises(cvi.InputError, match="Leave pairs out"):
        cvi.plot_forces(traj, by="joint", pairs=[("a", "b")])


@pytest.fixture(scope="module")
def driven_loop() -> cvi.Trajectory:
    """A four-bar linkage that a motor turns, whose last bar is on a stick to the world."""
    scene = four_bar()
    scene.prescribe("j1", lambda t: (-np.pi / 3 + 0.5 * t, 0.5, 0.0), name="motor")
    return cvi.simulate(scene, four_bar_start(scene), duration=0.2, dt=2e-3)


def test_reactions_of_a_loop_and_of_its_motor(driven_loop):
    """What is drawn is what the run has: means over the steps, in their middles; torques in a panel of their own."""
    traj = driven_loop
    forces, torques = cvi.plot_reactions(traj).axes
    assert forces.get_ylabel() == "force of constraint [N]\n(on its second body, or joint)"
    assert torques.get_ylabel() == "torque of constraint [N m]\n(on its second body, or joint)"
    assert labels(forces) == ["loop.x", "loop.y", "loop.z"]
    assert labels(torques) == ["motor"]
    drawn = {line.get_label(): line for axis in (forces, torques) for line in axis.lines}
    middle = 0.5 * (traj.t[1:] + traj.t[:-1])
    for name, values in [
        *zip(labels(forces), traj.reactions("loop").T, strict=True),
        ("motor", traj.reactions("motor")[:, 0]),
    ]:
        assert np.array_equal(drawn[name].get_ydata(), values[1:])
        assert np.array_equal(drawn[name].get_xdata(), middle)
    assert np.abs(traj.reactions("loop")).max() > 1.0
    colors = {name: line.get_color() for name, line in drawn.items() if not name.startswith("_")}
    assert len({colors[f"loop.{axis}"] for axis in "xyz"}) == 1  # one for a constraint
    assert colors["motor"] != colors["loop.x"]
    assert len({drawn[f"loop.{axis}"].get_linestyle() for axis in "xy"}) == 2
    assert has_zero_line(forces)
    assert has_zero_line(torques)


def test_reactions_of_a_motor_hold_the_weight_of_an_arm():
    """A rod of 1 kg that a motor keeps level has the torque m g l / 2 about -y, at every step."""
    scene = arm_scene(1)
    scene.prescribe("j1", 0.0, name="motor")
    traj = cvi.simulate(scene, duration=0.1, dt=1e-2)
    (axis,) = cvi.plot_reactions(traj).axes
    (line,) = (line for line in axis.lines if line.get_label() == "motor")
    assert line.get_ydata() == pytest.approx(np.full(10, -0.5 * BAR * GRAVITY), rel=1e-9)


def test_reactions_of_joints_that_follow_others():
    """Those of a coupling come from the momenta; the unit is that of the joint that follows."""
    model = arm(2)
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    scene = cvi.Scene.from_pinocchio(model, name="arm")
    scene.add_joint_equality("j2", "j1", (0.0, -1.0), name="mimic")
    traj = cvi.simulate(scene, duration=0.1, dt=1e-3)
    (axis,) = cvi.plot_reactions(traj).axes
    assert axis.get_ylabel().startswith("torque of constraint [N m]")
    (line,) = (line for line in axis.lines if line.get_label() == "mimic")
    assert np.array_equal(line.get_ydata(), traj.reactions("mimic")[1:, 0])
    assert np.abs(line.get_ydata()).max() > 0.1


def test_chosen_constraints_and_none(driven_loop, box):
    (axis,) = cvi.plot_reactions(driven_loop, ["motor"], window=(0.05, 0.1), size=(7.0, 4.0)).axes
    assert labels(axis) == ["motor"]
    with pytest.raises(cvi.InputError, match="Unknown constraint"):
        cvi.plot_reactions(driven_loop, ["motors"])
    with pytest.raises(cvi.InputError, match="a list of names"):
        cvi.plot_reactions(driven_loop, "motor")
    (axis,) = cvi.plot_reactions(box).axes
    assert [text.get_text() for text in axis.texts] == ["no constraint"]


def test_reactions_of_welds_and_screws_have_their_units():
    """Six rows of a weld are forces and torques; of many curves in a panel there is a scale of colours."""
    scene = cvi.Scene()
    for k in range(4):
        scene.add_box(f"b{k}", (0.1, 0.1, 0.1), mass=1.0, placement=(0.3 * k, 0.0, 0.0))
        scene.add_weld("world", f"b{k}", name=f"weld {k}")
    traj = cvi.simulate(scene, duration=0.02, dt=1e-3)
    forces, torques, *scales = cvi.plot_reactions(traj).axes
    assert len(scales) == 2
    names = [f"weld {k}.{axis}" for k in range(4) for axis in "xyz"]
    assert [tick.get_text() for tick in scales[0].get_yticklabels()] == names
    curves = [line.get_ydata() for line in forces.lines if len(line.get_xdata()) == 20]
    assert np.array_equal(curves, np.hstack([traj.reactions(f"weld {k}")[1:, :3] for k in range(4)]).T)
    assert curves[2] == pytest.approx(np.full(20, GRAVITY), rel=1e-9)  # each holds its box
    curves = [line.get_ydata() for line in torques.lines if len(line.get_xdata()) == 20]
    assert np.array_equal(curves, np.hstack([traj.reactions(f"weld {k}")[1:, 3:] for k in range(4)]).T)
    (chosen, _) = cvi.plot_reactions(traj, ["weld 1"]).axes
    assert labels(chosen) == ["weld 1.x", "weld 1.y", "weld 1.z"]


def test_reactions_of_a_stored_run_are_the_same(driven_loop, tmp_path):
    """Its scene lacks the function of the motor, so that the unit of its effort is not known."""
    stored = cvi.Trajectory.load(driven_loop.save(tmp_path / "run.npz"))
    panels_ = cvi.plot_reactions(stored).axes
    assert [axis.get_ylabel().split("\n")[0] for axis in panels_] == [
        "force of constraint [N]", "force or torque of constraint [N or N m]",
    ]  # fmt: skip
    (line,) = (line for line in panels_[1].lines if line.get_label() == "motor")
    assert np.array_equal(line.get_ydata(), driven_loop.reactions("motor")[1:, 0])


def test_forces_on_a_body_that_is_fixed_and_on_the_universe():
    """A ball lies on a fixed table of the scene, and another one on a shape of Pinocchio's universe."""
    model, geometry = pin.Model(), pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("floor", 0, 0, pin.SE3.Identity(), coal.Box(1.0, 1.0, 0.2)))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="room")
    scene.add_box("table", size=(1.0, 1.0, 0.2), placement=(3.0, 0.0, 0.0), free=False)
    for name, x, mass in (("light", 0.0, 1.0), ("heavy", 3.0, 2.0)):
        scene.add_sphere(name, 0.1, mass=mass, placement=(x, 0.0, 0.2))
    traj = cvi.simulate(scene, duration=0.05, dt=1e-3)
    along_z = cvi.plot_forces(traj, by="body").axes[-1]
    drawn = {line.get_label(): line.get_ydata() for line in along_z.lines}
    for body, force in (("light", 1.0), ("world", -1.0), ("heavy", 2.0), ("table", -2.0)):
        assert drawn[body] == pytest.approx(force * GRAVITY, rel=1e-9)


def test_states(box):
    position, velocity, spin = cvi.plot_states(box).axes[-3:]
    assert labels(position) == ["box.x", "box.y", "box.z"]
    drawn = {line.get_label(): line.get_ydata() for line in position.lines}
    assert np.array_equal(drawn["box.x"], box.q[:, 0])
    assert velocity.get_ylabel() == "velocity [m/s]\n(bodies: own axes)"
    assert spin.get_ylabel() == "angular velocity [rad/s]\n(bodies: own axes)"


def test_a_notebook_shows_the_figure(box):
    figure = cvi.plot(box)
    picture = imread(io.BytesIO(figure._repr_png_()))
    assert picture.shape[1] == 1000
    assert 0.02 < np.mean(picture[..., :3] < 0.9) < 0.5  # something is drawn


def test_a_run_of_one_node_can_be_drawn():
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.1, mass=1.0)
    sim = cvi.Simulator(scene, dt=0.1)
    sim.reset()
    for figure in (cvi.plot(sim.trajectory()), cvi.plot_states(sim.trajectory()), cvi.plot_forces(sim.trajectory())):
        figure.savefig(io.BytesIO(), format="png")


def test_states_say_which_velocities_are_in_the_axes_of_a_body():
    """Those of a free body are; those of joints that turn or slide have none."""
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    free = cvi.plot_states(cvi.simulate(scene, duration=0.01, dt=1e-3))
    assert [axis.get_ylabel() for axis in free.axes][:3] == [
        "position [m]", "velocity [m/s]\n(bodies: own axes)", "angular velocity [rad/s]\n(bodies: own axes)",
    ]  # fmt: skip
    arm = cvi.Scene()
    arm.add_urdf("models/double_pendulum.urdf")
    labels = [axis.get_ylabel() for axis in cvi.plot_states(cvi.simulate(arm, duration=0.01, dt=1e-3)).axes]
    assert labels == ["angle [rad]", "angular velocity [rad/s]"]


@pytest.mark.parametrize("draw", [cvi.plot, cvi.plot_states, cvi.plot_forces, cvi.plot_reactions])
def test_resolution_and_background_of_a_file(box, tmp_path, draw):
    """Ten inches are as many pixels as dpi says; without a background the corner is clear; an SVG holds lines."""
    from PIL import Image

    with Image.open(save_figure(draw(box), tmp_path / "a.png", dpi=60, transparent=True)) as image:
        assert image.width == 600
        assert image.convert("RGBA").getpixel((0, 0))[3] == 0
    with Image.open(save_figure(draw(box), tmp_path / "b.png")) as image:
        assert image.width == 1300
        assert image.convert("RGBA").getpixel((0, 0)) == (255, 255, 255, 255)
    text = save_figure(draw(box), tmp_path / "a.svg", transparent=True).read_text()
    assert "<svg" in text
    assert "<path" in text
    for wrong in ({"dpi": 0}, {"dpi": "high"}, {"transparent": 1}):
        with pytest.raises(cvi.InputError, match=next(iter(wrong))):
            save_figure(draw(box), tmp_path / "c.png", **wrong)
    assert not (tmp_path / "c.png").exists()


def test_a_panel_without_cones_says_why():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (0.2, 0.2, 0.1), placement=(0, 0, 0.05))
    scene.set_contact("ground", "box", friction=lambda speed: 0.3 + 0.1 * np.exp(-speed))
    traj = cvi.simulate(scene, v0=scene.velocity({"box": (0.5, 0, 0)}), duration=0.05, dt=1e-3)
    panel = cvi.plot_forces(traj).axes[2]
    assert "a function of the slip" in panel.texts[0].get_text()
    assert labels(panel) == []


@pytest.mark.parametrize("options", [{"dt": 1e-3}, {"dt": 0.05, "order": 8}, {"tol": 1e-8}])
def test_the_angle_of_a_joint_without_end_goes_on_over_whole_turns(options):
    """A hinge without weight turns at 20 rad/s: by 40 rad, also where nodes are more than half a turn apart."""
    scene = cvi.Scene(gravity=(0, 0, 0))
    scene.add_urdf("models/damped_pendulum.urdf")
    scene.set_joint("hinge", damping=0.0)
    traj = cvi.simulate(scene, scene.configuration({"hinge": 1.0}), [20.0], duration=2.0, **options)
    angle = traj.table("states").column("hinge.angle")
    assert np.abs(angle - (1.0 + 20.0 * traj.t)).max() < 1e-7
    panel = cvi.plot_states(traj).axes[0]
    assert panel.get_ylabel() == "angle [rad]"
    assert labels(panel) == ["hinge.angle"]
    assert np.array_equal(panel.get_lines()[0].get_ydata(), angle)


def test_a_size_a_window_and_pairs(box):
    scene = arm_scene(2)
    scene.prescribe("j1", 0.0, name="motor")
    driven = cvi.simulate(scene, duration=0.5, dt=1e-2)
    span, room = (0.1, 0.3), 0.01 * 0.2
    for draw, run in ((cvi.plot, box), (cvi.plot_states, box), (cvi.plot_forces, box), (cvi.plot_reactions, driven)):
        figure = draw(run, size=(7.0, 9.0), window=span)
        assert figure.get_size_inches() == pytest.approx((7.0, 9.0))
        for axis in figure.axes:
            assert axis.get_xlim() == pytest.approx((span[0] - room, span[1] + room))
            for line in axis.get_lines():
                t = np.asarray(line.get_xdata(), dtype=float)
                if len(t) > 2:
                    assert np.nanmin(t) > span[0] - 0.05
                    assert np.nanmax(t) < span[1] + 0.05
        figure.canvas.draw()
        page = figure.bbox
        for axis in figure.axes:  # nothing is cut, and labels stand below each other
            tight = axis.get_tightbbox()
            assert tight.x0 >= page.x0 and tight.x1 <= page.x1 and tight.y0 >= page.y0 and tight.y1 <= page.y1  # noqa: PT018
        assert len({round(axis.yaxis.label.get_window_extent().x1) for axis in figure.axes if axis.get_ylabel()}) == 1
        with pytest.raises(cvi.InputError, match=r"at least 5\.2 inches of width .* Use size=\(5\.2, "):
            draw(run, size=(3.0, 2.0))
        with pytest.raises(cvi.InputError, match="two times of the run in order"):
            draw(run, window=(0.3, 0.1))


def test_chosen_pairs():
    scene = cvi.Scene()
    scene.add_halfspace()
    for k in range(3):
        scene.add_box(f"b{k}", (0.1, 0.1, 0.1), placement=(0.3 * k, 0, 0.05))
    scene.set_contact(restitution=0.0, friction=0.4)
    traj = cvi.simulate(scene, duration=0.05, dt=1e-3)
    assert [name for name in labels(cvi.plot_forces(traj).axes[0]) if "b" in name] != []
    chosen = labels(cvi.plot_forces(traj, pairs=[("b1", "ground")]).axes[0])
    assert [name for name in chosen if "|" in name] == ["b1 | ground" if "b1 | ground" in chosen else "ground | b1"]
    assert len(labels(cvi.plot(traj, pairs=[("b0", "ground"), ("b2", "ground")]).axes[2])) == 2
    with pytest.raises(cvi.InputError, match="have no contact in this run"):
        cvi.plot_forces(traj, pairs=[("b0", "b1")])


def test_neighbours_have_different_colours():
    scene = cvi.Scene()
    for k in range(10):
        scene.add_box(f"b{k}", (0.1, 0.1, 0.1), placement=(0.15 * k, 0, 0))
    colors = [tuple(picture.geometry.meshColor) for picture in scene.pictures()]
    assert len(set(colors)) == 8
    assert all(a != b for a, b in zip(colors, colors[1:], strict=False))
