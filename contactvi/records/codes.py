"""Numbers in the arrays of a run, and the words for them.

The numbers are those of the engine's enumerations of these names (contactvi._core) and of stored runs, which are read
without the engine: they are appended to, never changed. tests/records/test_codes.py compares the two.
"""

from __future__ import annotations

from enum import IntEnum

from contactvi.options import IMPACT_MAPS


class GuardKind(IntEnum):
    """What an event or a contact is about: a pair of shapes, or a limit of a joint."""

    CONTACT = 0
    LIMIT = 1


class ContactMode(IntEnum):
    """What a contact did in a step, or that it is a point of an impact."""

    STICK = 0
    SLIP = 1
    FRICTIONLESS = 2
    IMPACT = 3


class Change(IntEnum):
    """What became of a persistent contact."""

    BEGIN = 0
    RELEASE = 1
    STICK = 2
    SLIP = 3
    BOUNCING_ENDED = 4  # value: when the impacts would have accumulated [s]
    INCONSISTENT = 5  # Painleve: rigid bodies with friction have no answer without an impulse; value: A [1/kg]
    OVERLAP = 6  # a pair overlaps by more than is promised, and by half more than any before; value: its gap [m]


class StepKind(IntEnum):
    """The kind of a step: without contacts, with persistent contacts, or with all impacts inside of it (dense)."""

    FREE = 0
    PERSISTENT = 1
    DENSE = 2


class Fallback(IntEnum):
    """Why the impulse of an impact is not that of its law.

    GAIN: the coefficient of restitution would make energy; it is lowered where the law of the pair says so. All others:
    it is CTEC's.
    """

    NONE = 0
    PLASTIC = 1
    NO_CONVERGENCE = 2
    INADMISSIBLE = 3
    GRAZING = 4
    PERSISTENT = 5
    GAIN = 6


# The words, each at the place of its number.
KINDS = tuple(kind.name.lower() for kind in GuardKind)
MODES = tuple(mode.name.lower() for mode in ContactMode)
CHANGES = tuple(change.name.lower().replace("_", " ") for change in Change)
STEP_KINDS = tuple(kind.name.lower() for kind in StepKind)
METHODS = IMPACT_MAPS
FALLBACKS = (
    None,
    "plastic: without rebound the map's equation is singular",
    "no convergence: no root near CTEC's impulse",
    "inadmissible: the root pulls or does not separate",
    "grazing: too slow for the equation to fix the impulse, its root is far from CTEC's",
    "persistent: what the map conserves is not known while contacts persist",
    "gain: the coefficient of restitution would make energy",
)
