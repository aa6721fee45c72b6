"""What a simulator has recorded lately: its present contacts, and what has happened since a time."""

from __future__ import annotations

from dataclasses import dataclass

from contactvi.records.contacts import ChangeLog, ContactLog
from contactvi.records.events import EventLog


@dataclass(frozen=True)
class Recent:
    """The newest part of a record.

    Attributes:
        contacts: the persistent contacts at the end of the last step, one row per point.
        events: the impacts after the time that was asked for.
        contact_changes: the changes of persistent contacts after that time.
        happened: whether there are any of these.
        impacts: number of impacts since the reset.
    """

    contacts: ContactLog
    events: EventLog
    contact_changes: ChangeLog
    happened: bool
    impacts: int
