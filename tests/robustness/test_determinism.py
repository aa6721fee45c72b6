"""The same run gives the same bits: again, in another order, beside others, in other processes, on other hardware."""

from __future__ import annotations

import pytest

from contactvi import _core
from helpers import repeated_runs

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def expected() -> repeated_runs.Digests:
    return repeated_runs.in_process()


def test_again_and_in_any_order(expected: repeated_runs.Digests):
    for seed in range(3):
        found = repeated_runs.in_order(repeated_runs.shuffled(seed))
        assert repeated_runs.differing(expected, found) == []


def test_side_by_side_in_threads(expected: repeated_runs.Digests):
    for found in repeated_runs.in_threads(4):
        assert repeated_runs.differing(expected, found) == []


@pytest.mark.parametrize("seed", ["0", "1", "4242", "random"])
def test_hash_seeds(expected: repeated_runs.Digests, seed: str):
    assert repeated_runs.differing(expected, repeated_runs.in_process(PYTHONHASHSEED=seed)) == []


@pytest.mark.parametrize("name", _core.instruction_sets())
def test_instruction_sets(expected: repeated_runs.Digests, name: str):
    assert repeated_runs.differing(expected, repeated_runs.in_process(CONTACTVI_INSTRUCTION_SET=name)) == []


def test_a_difference_is_found(expected: repeated_runs.Digests):
    name = next(iter(expected))
    other = {**expected, name: {**expected[name], "q": "0"}}
    assert repeated_runs.differing(expected, other) == [f"{name}: q"]
