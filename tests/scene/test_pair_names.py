"""Names of pairs: a sequence of tuples, whatever it is made of."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import contactvi as cvi
from contactvi.scene.pair_names import PairNames

GEOMETRIES = [f"shape {k}" for k in range(100)]
NUMBERS = np.argwhere(np.triu(np.ones((100, 100), dtype=bool), 1)).astype(np.int32)  # more than are read at a time
TUPLES = [(GEOMETRIES[a], GEOMETRIES[b]) for a, b in NUMBERS.tolist()]


def test_it_is_the_sequence_of_its_tuples():
    names = PairNames(GEOMETRIES, NUMBERS)
    assert len(names) == len(TUPLES) == 4950
    assert list(names) == TUPLES
    assert [names[k] for k in (0, 7, -1)] == [TUPLES[k] for k in (0, 7, -1)]
    assert list(names[10:5000:3]) == TUPLES[10:5000:3]
    assert TUPLES[4200] in names
    assert ("shape 1", "shape 0") not in names
    assert names.index(TUPLES[4200]) == 4200
    assert list(pickle.loads(pickle.dumps(names))) == TUPLES
    with pytest.raises(IndexError):
        names[4950]


def test_no_pairs():
    scene = cvi.Scene()
    scene.add_sphere("ball", radius=0.1, mass=1.0)
    assert scene.pair_names == []
    assert not scene.built().pairs
    scene.core()


def test_pairs_of_the_scene_are_those_of_its_geometry():
    scene = cvi.Scene()
    scene.add_halfspace(name="ground")
    for k in range(3):
        scene.add_sphere(f"ball {k}", radius=0.1, mass=1.0, placement=(0.0, 0.0, 0.5 + k))
    model = scene.collision_model
    names = [geometry.name for geometry in model.geometryObjects]
    expected = [(names[pair.first], names[pair.second]) for pair in model.collisionPairs]
    assert scene.pair_names == expected
    gaps = scene.core().gaps(scene.neutral())[0]
    alone = {frozenset(pair): gap for pair, gap in zip(expected, gaps, strict=True)}
    assert alone[frozenset({"ground", "ball 0"})] == pytest.approx(0.4, abs=1e-12)
    assert alone[frozenset({"ball 0", "ball 2"})] == pytest.approx(1.8, abs=1e-12)
