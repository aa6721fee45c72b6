"""What notebooks show: short, well-formed, with all names escaped."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import contactvi as cvi

MODELS = Path(__file__).resolve().parents[2] / "models"
EVIL = "<script>alert('x')</script>&"


class Reader(HTMLParser):
    """Collects the tags and the text; tags that are not closed in their order are an error."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.text: list[str] = []
        self.rows = 0

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.tags.add(tag)
        self.rows += tag == "tr"

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(item) -> Reader:
    reader = Reader()
    reader.feed(item._repr_html_())
    reader.close()
    assert not reader.open
    assert "script" not in reader.tags
    return reader


@pytest.fixture(scope="module")
def scene() -> cvi.Scene:
    scene = cvi.Scene()
    scene.add_halfspace(name=EVIL)
    for k in range(40):
        scene.add_sphere(f"{EVIL}{k}", radius=0.1, mass=1.0, placement=(0.5 * k, 0, 0.12))
    scene.add_spring("world", f"{EVIL}0", stiffness=1.0, name=EVIL)
    scene.set_contact(restitution=0.6, friction=0.4)
    return scene


@pytest.fixture(scope="module")
def run(scene) -> cvi.Trajectory:
    return cvi.simulate(scene, dt=5e-3, duration=0.5)


def test_everything_is_short_and_escaped(scene, run):
    v0s = np.zeros((3, scene.nv))
    q0s = np.tile(scene.neutral(), (3, 1))
    q0s[1:, 2] = -1.0
    batch = cvi.simulate_batch(scene, q0s, v0s, dt=5e-3, duration=0.1, keep="ends")
    items = [scene, scene.report, run, run.events, run.contacts, run.contact_changes, batch, run.table("contacts")]
    for item in items:
        reader = read(item)
        assert "table" in reader.tags or item is items[1]  # a report without findings
        assert reader.rows < 60
        assert len(item._repr_html_()) < 40_000
    for item in (scene, run.events, run.contacts, run.contact_changes, run.table("contacts")):
        assert any(EVIL in text for text in read(item).text)
    assert any("PENETRATION" in text for text in read(batch).text)


def test_a_log_shows_its_first_and_last_rows(run):
    text = read(run.events).text
    assert f"{run.events[0].time:.9g}" in text
    assert f"{run.events[-1].time:.9g}" in text
    assert "…" in text
    assert any(f"Impacts: {len(run.events)}" in part for part in text)


def test_a_run_says_how_it_ended():
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", radius=0.1, mass=1.0, placement=(0, 0, 0.2))
    scene.set_contact(restitution=0.5)
    traj = cvi.simulate(scene, dt=1e-2, duration=3.0, zeno="end", throw=False)
    assert any("ZENO" in text for text in read(traj).text)


def test_logs_without_rows():
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.1, mass=1.0)
    traj = cvi.simulate(scene, dt=0.1, duration=0.2)
    for item in (scene, traj, traj.events, traj.contacts, traj.contact_changes, cvi.Scene()):
        read(item)


def test_a_scene_that_cannot_be_run_says_why(tmp_path):
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.1, mass=1.0)
    scene.add_force(lambda q, v, t: np.zeros(6), name="lost")
    stored = cvi.Scene.from_dict(scene.to_dict())
    assert "lost" in read(stored).text


def test_reports_are_unfolded_by_the_user():
    hand = cvi.load_scene(MODELS / "allegro_ball.toml")
    html = hand.report._repr_html_()
    assert html.count("<details>") == 1
    assert html.count("\n") < 200


def test_the_two_kinds_of_impulse_have_two_names():
    """Events have the normal impulse, contacts all of it; an impact has no force to show."""
    scene = cvi.Scene()
    scene.add_halfspace()
    ball = scene.add_sphere("ball", 0.1, placement=(0, 0, 0.11))
    scene.set_contact(restitution=0.0, friction=0.5)
    traj = cvi.simulate(scene, v0=scene.velocity({ball: (1.0, 0, 0)}), duration=0.1, dt=1e-3)
    assert "normal impulse [N s]" in read(traj.events).text
    contacts = read(traj.contacts)
    assert "impulse, friction included [N s]" in contacts.text
    assert "impact" in contacts.text
    assert "nan" not in contacts.text


def test_simulators_and_ledgers_are_a_line():
    scene = cvi.Scene()
    scene.add_sphere("ball", 0.1)
    sim = cvi.Simulator(scene, dt=1e-3)
    assert repr(sim) == "<Simulator: nq = 7, nv = 6, no state yet>"
    sim.reset(t=2.0)
    assert repr(sim) == "<Simulator: nq = 7, nv = 6, t = 2 s, SUCCESS>"
    sim.run(10)
    sim.step()
    assert repr(sim) == "<Simulator: nq = 7, nv = 6, t = 2.011 s, SUCCESS>"
    assert repr(sim.trajectory().ledger) == "<Ledger: 12 nodes, 0 impacts>"


def test_print_shows_a_short_table():
    run = cvi.simulate(cvi.load_scene(MODELS / "bouncing_ball.toml"))
    lines = str(run.events).splitlines()
    assert lines[0] == f"Impacts: {len(run.events)} (CTEC)"
    assert lines[1].split()[:3] == ["t", "[s]", "pair"]
    assert len(lines) == 2 + 9  # the first four, the last four, and what is left out
    assert f"{run.events[0].time:.9g}  ball | ground" in lines[2]
    assert len({line.index("ball") for line in lines[2:6]}) == 1
    assert str(run.contact_changes) == "Contact changes: 0"
    assert str(run.contacts).startswith(f"Contacts: {len(run.contacts)} rows of 1 pairs")
    assert repr(run.events) == f"<EventLog: {len(run.events)} events>"


def test_derivatives_show_the_shapes_of_their_arrays():
    scene = cvi.load_scene(MODELS / "double_pendulum_wall.toml")
    traj = cvi.simulate(scene, duration=0.1, dt=0.01, record="gradient", dense=True)
    found = repr(cvi.directional_derivative(traj, {"v0": [1.0, 0.0]}))
    assert found == "<DirectionalDerivative: q 11x2 numbers, v 11x2 numbers, one_sided False, kink None, error 0>"
    assert "A 4x4 numbers" in repr(cvi.step_derivatives(scene, [0.1, 0.2]))
    assert repr(traj.at(0.05)).startswith("<State: t 0.05, q [")
    second = cvi.hessian_vector(traj, lambda t, q, v: (0.0, q[-1], v[-1]), {"v0": [1.0, 0.0]}, hessp="linear")
    assert "product {'v0': [" in repr(second)
