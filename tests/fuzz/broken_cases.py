"""Cases that break the law in every way, for the test that such findings are seen."""

from __future__ import annotations

import os
import signal
import warnings

import contactvi as cvi
from fuzz import law
from fuzz.draws import Case, Draws

WAYS = ("ran", "accepted", "refused", "foreign", "memory", "warned", "not finite", "crash", "hang")


def draw(d: Draws) -> Case:
    """Return a case."""
    return {"way": d.pick(WAYS), "number": d.whole(0, 10**9)}


def attempt(case: Case) -> bool:
    """Do what the case says."""
    way = case["way"]
    if way == "refused":
        raise cvi.ContactviError("No")
    if way == "foreign":
        raise ValueError("no")
    if way == "memory":
        bytearray(2**33)
    if way == "warned":
        warnings.warn("no", RuntimeWarning, stacklevel=1)
    if way == "not finite":
        law.check_numbers("q", [1.0, float("nan")])
    if way == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    while way == "hang":
        pass
    return way == "ran"
