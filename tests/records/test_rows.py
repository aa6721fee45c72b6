"""Rows of a run as arrays: parts one after the other, and arrays that are made when they are asked for."""

from __future__ import annotations

import numpy as np
import pytest

from contactvi.records.contacts import CHANGE_FIELDS, FIELDS, ChangeLog, empty_changes, empty_contacts
from contactvi.records.dense_steps import FIELDS as DENSE_FIELDS
from contactvi.records.dense_steps import DenseSteps, no_dense_steps, of_parts
from contactvi.records.rows import joined

PARTS = [
    {"time": [0.1, 0.2], "place": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "count": [1.0, 2.0]},
    {"time": [], "place": [], "count": []},
    {"time": [0.3], "place": [[7.0, 8.0, 9.0]], "count": [3.0]},
]


def test_parts_are_joined_in_their_order():
    rows = joined(PARTS, {"time": (0, float), "place": (3, float), "count": (0, np.int64)})
    np.testing.assert_array_equal(rows["time"], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(rows["place"], np.arange(1.0, 10.0).reshape(3, 3))
    np.testing.assert_array_equal(rows["count"], [1, 2, 3])
    assert rows["count"].dtype == np.int64


@pytest.mark.parametrize(
    ("log", "fields"), [(empty_contacts(), FIELDS), (empty_changes(), CHANGE_FIELDS), (no_dense_steps(), DENSE_FIELDS)]
)
def test_logs_without_rows(log, fields):
    assert len(log) == 0
    assert {name: (values.shape[1:], values.dtype) for name, values in log.arrays.items()} == {
        name: ((width,) if width else (), np.dtype(kind)) for name, (width, kind) in fields.items()
    }


def test_arrays_are_made_once_and_when_they_are_asked_for():
    made = []

    def arrays() -> dict[str, np.ndarray]:
        made.append(True)
        return {**joined((), DENSE_FIELDS), "other": np.zeros(3)}

    log = DenseSteps(arrays)
    assert not made
    assert list(log.arrays) == list(DENSE_FIELDS)
    assert len(log) == 0
    assert len(made) == 1


def test_ends_of_steps():
    part = {name: np.array([1.0, 2.0]) for name in DENSE_FIELDS}
    steps = of_parts([part, part])
    np.testing.assert_array_equal(steps.end, [2.0, 4.0, 2.0, 4.0])
    np.testing.assert_array_equal(steps["gap"], steps.array("gap"))


def test_items_from_the_end_and_beyond():
    part = {name: np.arange(3.0) for name in CHANGE_FIELDS} | {"kind": np.ones(3), "index": np.zeros(3)}
    log = ChangeLog(joined([part], CHANGE_FIELDS), [], ["hinge"])
    assert [change.time for change in log] == [0.0, 1.0, 2.0]
    assert log[-1].time == 2.0
    assert [change.time for change in log[1:]] == [1.0, 2.0]
    for item in (3, -4):
        with pytest.raises(IndexError, match=f"change {item} of 3"):
            log[item]
