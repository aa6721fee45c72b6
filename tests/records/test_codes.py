"""The numbers of stored runs are those of the engine's enumerations."""

from __future__ import annotations

import pytest

import contactvi as cvi
from contactvi import _core
from contactvi.options import IMPACT_MAPS, MHC_REFERENCES
from contactvi.records import codes


def members(enumeration) -> dict[str, int]:
    return {member.name: member.value for member in enumeration}


@pytest.mark.parametrize(
    ("own", "engine"),
    [
        (codes.GuardKind, _core.GuardKind),
        (codes.ContactMode, _core.ContactMode),
        (codes.Change, _core.ContactChange),
        (codes.Fallback, _core.Fallback),
        (codes.StepKind, _core.StepKind),
    ],
)
def test_numbers(own, engine):
    assert members(own) == members(engine)


def test_status_codes():
    """All but LEDGER, which the engine does not know."""
    assert {
        name: code for name, code in members(cvi.StatusCode).items() if name not in ("LEDGER", "REFUSED")
    } == members(_core.StatusCode)


def test_words():
    assert tuple(name.lower() for name in members(_core.ImpactMap)) == codes.METHODS
    assert list(members(_core.ImpactMap).values()) == list(range(len(IMPACT_MAPS)))
    assert {name.upper() for name in MHC_REFERENCES} == set(members(_core.MhcReference))
    assert len(codes.FALLBACKS) == len(codes.Fallback)
    for fallback, words in zip(codes.Fallback, codes.FALLBACKS, strict=True):
        assert (words or "none").startswith(fallback.name.lower().replace("_", " "))
    assert codes.CHANGES[codes.Change.BOUNCING_ENDED] == "bouncing ended"
