"""Contacts of parts, bodies, shapes and patterns; their forces over the steps of a run."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import contactvi as cvi
from contactvi.records.contacts import FIELDS, ContactLog
from contactvi.records.force_sums import mean_forces
from contactvi.records.rows import joined

GRAVITY, MASS = 9.81, 3.0
TABLE = """
<robot name="table"><link name="top"><inertial><mass value="3.0"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>{legs}</link></robot>
"""
LEG = '<collision><origin xyz="{x} {y} -0.1"/><geometry><sphere radius="0.05"/></geometry></collision>'


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> cvi.Scene:
    path = tmp_path_factory.mktemp("table") / "table.urdf"
    legs = "".join(LEG.format(x=x, y=y) for x, y in [(-0.2, -0.2), (-0.2, 0.2), (0.2, 0.2), (0.2, -0.2)])
    path.write_text(TABLE.format(legs=legs))
    scene = cvi.Scene()
    scene.add_urdf(path, base="free", placement=(0, 0, 0.15))
    scene.add_halfspace()
    scene.add_sphere("far", 0.1, placement=(0, 0, 9.0))
    scene.set_contact(restitution=0.0, friction=0.5)
    return scene


@pytest.fixture(scope="module")
def contacts(scene) -> ContactLog:
    return cvi.simulate(scene, duration=0.2, dt=1e-2).contacts


WEIGHT = np.array([0.0, 0.0, MASS * GRAVITY])


@pytest.mark.parametrize("name", ["top", "table", "to*", "top_?", ["top_0", "top_1", "top_2", "top_3"]])
def test_a_body_is_found_by_all_its_names(scene, contacts, name):
    _, force = contacts.on(name)
    assert force == pytest.approx(np.tile(WEIGHT, (20, 1)), abs=1e-9)
    assert contacts.impulse_on(name) == pytest.approx(0.2 * WEIGHT, abs=1e-9)
    assert contacts.force_of("ground", name)[1] == pytest.approx(contacts.force_of(name, "ground")[1], abs=0.0)
    assert len(contacts.of(name, "ground")) == len(contacts)


def test_of_several_pairs_the_force_is_that_on_one_side(scene, contacts):
    sign = 1.0 if contacts.pairs[0][1] != "ground" else -1.0
    assert contacts.force_of("top", "ground")[1] == pytest.approx(np.tile(sign * WEIGHT, (20, 1)), abs=1e-9)
    assert contacts.force_of("top_*", "ground")[1] == pytest.approx(np.tile(sign * WEIGHT, (20, 1)), abs=1e-9)


def test_a_handle_stands_for_its_shapes(scene, contacts):
    assert contacts.impulse_on(scene.parts[0]) == pytest.approx(0.2 * WEIGHT, abs=1e-9)
    assert len(contacts.of(scene.parts[0], scene.parts[1])) == len(contacts)
    assert contacts.impulse_on("far") == pytest.approx(np.zeros(3), abs=0.0)  # tested, and touched by nothing


def test_names_are_kept(contacts, scene, tmp_path):
    kept = pickle.loads(pickle.dumps(contacts))
    assert kept.impulse_on("top") == pytest.approx(contacts.impulse_on("top"), abs=0.0)
    path = cvi.simulate(scene, duration=0.2, dt=1e-2).save(tmp_path / "run.npz")
    assert cvi.Trajectory.load(path).contacts.impulse_on("table") == pytest.approx(0.2 * WEIGHT, abs=1e-9)


@pytest.mark.parametrize("wrong", ["tpo", ["top", "grond"], "leg_*", ""])
@pytest.mark.parametrize("ask", ["on", "impulse_on"])
def test_an_unknown_name_is_an_error_and_not_zero(contacts, ask, wrong):
    with pytest.raises(cvi.InputError, match="No body"):
        getattr(contacts, ask)(wrong)


def test_what_never_touched(contacts):
    with pytest.raises(cvi.InputError, match=r"far and ground have no contact in this run.*'top_0'"):
        contacts.of("far", "ground")
    with pytest.raises(cvi.InputError, match=r"Did you mean 'top'\?"):
        contacts.of("tops", "ground")
    with pytest.raises(cvi.InputError, match="have no contact in this run"):
        contacts.of("joint", "lower limit")


def test_a_body_without_tested_shapes_is_said_to_be_one():
    log = ContactLog(joined((), FIELDS), [("a", "b")], [], {"shell": ("c",)})
    with pytest.raises(cvi.InputError, match="'shell' has no shape in the tested pairs"):
        log.impulse_on("shell")


# -- forces over the steps --------------------------------------------------------------------------------------------


def forces(*parts: tuple[float, float, int, float]) -> tuple[np.ndarray, np.ndarray]:
    """The mean forces of parts of steps: start, length, step, force along z."""
    t, h, step, force = np.array(parts).T
    impulse = np.outer(h * force, [0.0, 0.0, 1.0])
    middle, mean = mean_forces(t, h, step.astype(np.int64), impulse)
    return middle, mean[:, 2]


def test_a_part_as_short_as_rounding_makes_no_spike():
    parts = [(0.0, 0.01, 0, 2.0), (0.01, 1e-20, 1, 2e8), (0.01, 0.004, 1, 3.0), (0.014, 1e-13, 1, 2e3),
             (0.014, 0.006, 1, 3.0), (0.02, 0.01, 2, 2.0)]  # fmt: skip
    t, force = forces(*parts)
    assert t == pytest.approx([0.005, 0.012, 0.017, 0.025])
    assert force == pytest.approx([2.0, 3.0, 3.0, 2.0], rel=1e-7)


def test_the_integral_of_the_force_is_the_impulse():
    rng = np.random.default_rng(3)
    for _ in range(50):
        cuts = np.sort(rng.uniform(0.0, 1.0, 40))
        t = np.unique(np.concatenate([np.arange(11) / 10.0, cuts]))
        h, step = np.diff(t), np.floor(10.0 * (t[:-1] + 1e-12)).astype(np.int64)
        force = rng.uniform(0.0, 5.0, len(h))
        middle, mean = forces(*zip(t[:-1], h, step, force, strict=True))
        edges = np.zeros(len(middle) + 1)
        for k, at in enumerate(middle):  # steps follow each other without gaps
            edges[k + 1] = 2.0 * at - edges[k]
        assert edges[-1] == pytest.approx(1.0, abs=1e-12)
        assert np.diff(edges) @ mean == pytest.approx(h @ force, rel=1e-12)
        assert np.diff(edges).min() > 1e-3 * 0.1


def test_steps_of_contact_within_a_step_stay_apart():
    t, force = forces(*((0.001 * k, 0.001, 0, float(k)) for k in range(10)))
    assert t == pytest.approx(0.001 * (np.arange(10) + 0.5))
    assert force == pytest.approx(np.arange(10.0))


def test_parts_of_separate_islands_that_overlap_are_summed():
    t, force = forces((0.0, 0.01, 0, 1.0), (0.0, 0.004, 0, 5.0), (0.004, 0.006, 0, 5.0))
    assert t == pytest.approx([0.005])
    assert force == pytest.approx([6.0])


def test_a_brief_contact_alone_has_no_force():
    t, force = forces((0.0, 0.01, 0, 2.0), (0.01, 1e-20, 1, 2e8))
    assert t == pytest.approx([0.005])
    assert force == pytest.approx([2.0])
