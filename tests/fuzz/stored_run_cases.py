"""Stored runs (npz): entries dropped, retyped, resized, with other numbers; a damaged header; damaged archives."""

from __future__ import annotations

import contextlib
import io
import json
import struct
import zipfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import contactvi as cvi
from fuzz import law
from fuzz.draws import EXTREME, Case, Draws, damage_bytes, damage_data
from fuzz.scene_file_cases import ARM

RUNS = ("bounce", "rest", "arm", "dense", "auto", "samples", "dtec", "gradient", "gradient")
KINDS = ("f4", "i8", "c16", "U8", "O", "bool", "f2", ">f8", "u1", "M8[s]", "V8")
TRICKS = ("twice", "folder", "compressed", "lies", "pickle", "fortran", "bomb", "encrypted", "comment", "empty", "npy")
HEADER_KEYS = (
    "format",
    "schema",
    "options",
    "status",
    "scene",
    "visuals",
    "$array",
    "name",
    "joint",
    "code",
    "dt",
    "x",
)


def draw(d: Draws) -> Case:
    """Return a case: the name of a stored run and what is done to it."""
    changes: list[Any] = []
    for _ in range(max(1, d.damages()) if d.chance(90) else 0):
        kind = d.pick(("number", "number", "number", "header", "header", "drop", "kind", "shape", "swap", "rows"))
        change: Case = {"do": kind, "entry": d.whole(0, 10**6)}
        if kind == "number":
            change |= {
                "at": d.whole(0, 10**6),
                "value": d.pick(("near", "near", *EXTREME, "nan", "inf", "-inf", 3.0, 2.0**62)),
            }
        elif kind == "header":
            change["path"] = [d.whole(0, 99) for _ in range(400)] if d.chance(0) else d.whole(0, 2**31)
            change["words"] = HEADER_KEYS
        elif kind == "kind":
            change["kind"] = d.pick(KINDS)
        elif kind in ("shape", "rows"):
            change["how"] = d.whole(0, 5)
        elif kind == "swap":
            change["other"] = d.whole(0, 10**6)
        changes.append(change)
    raw = None
    if d.chance(12):
        raw = [d.whole(0, 2**31) for _ in range(2)]
    return {"run": d.pick(RUNS), "changes": changes, "trick": d.pick(TRICKS) if d.chance(12) else None, "raw": raw}


class Seeded(Draws):
    """Draws from a seed: of places in data that are not there yet when the case is drawn."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def whole(self, low: int, high: int) -> int:
        return int(self._random.integers(low, high, endpoint=True))

    def any_number(self) -> float:
        return float(np.frombuffer(self._random.bytes(8))[0])

    def bytes(self, most: int = 16) -> bytes:
        return self._random.bytes(self.whole(0, most))


@cache
def stored(name: str) -> dict[str, np.ndarray]:
    """Return the entries of a stored run."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.set_contact(restitution=0.5, friction=0.3)
    options: Case = {"duration": 0.05, "dt": 1e-3}
    if name == "arm":
        Path("arm.urdf").write_text(ARM)
        scene.add_urdf("arm.urdf", placement=(0, 0, 2), friction=True)
        scene.add_spring("upper", "lower", 10.0, damping=0.1)
        scene.prescribe("shoulder", ([0.0, 0.5, 1.0], [0.0, 0.1, 0.4]))
    elif name == "gradient":  # it bounces, a contact becomes persistent, and it slips
        scene.set_contact(restitution=0.0, friction=0.3)
        scene.add_sphere("ball", 0.1, placement=(0, 0, 0.105))
        scene.v0 = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
        options |= {"record": "gradient", "control": np.full((50, 6), 0.1)}
    else:
        height = {"rest": 0.1, "dense": 0.12}.get(name, 0.11)
        scene.add_box("box", (0.2, 0.2, 0.2), placement=(0, 0, height))
        scene.add_sphere("ball", 0.1, placement=(1, 0, 0.105))
    options |= {
        "dense": {"contact_mode": "steps"},
        "auto": {"dt": "auto", "duration": 0.2},
        "samples": {"order": 4, "sample_dt": 5e-3},
        "dtec": {"impact": "dtec"},
    }.get(name, {})
    traj = cvi.simulate(scene, throw=False, **options)
    traj.v, traj.energy, traj.gaps, traj.frames  # noqa: B018  kept with the run
    traj.save("base.npz")
    with np.load("base.npz") as file:
        return {entry: file[entry] for entry in file.files}


def attempt(case: Case) -> bool:
    """Write the changed run, load it, and look at all of it."""
    entries = {name: np.array(values) for name, values in stored(case["run"]).items()}
    for change in case["changes"]:
        _change(entries, change)
    data = _archive(entries, case["trick"])
    if case["raw"] is not None:
        data = damage_bytes(Seeded(case["raw"][0]), data)
    Path("run.npz").write_bytes(data)
    traj = cvi.Trajectory.load("run.npz")
    look(traj)
    return False


def look(traj: cvi.Trajectory) -> None:
    """Read everything of a run; what it has not is refused, what it has is finite."""
    law.check_run(traj)
    repr(traj), traj.stepping, len(traj)
    readers = (
        lambda: traj.modified_energy,
        lambda: traj.impact_loss,
        lambda: traj.friction_loss,
        lambda: traj.work,
        lambda: traj.gaps,
        lambda: traj.frames,
        lambda: traj.visuals,
        lambda: traj.constraints,
        lambda: [traj.reactions(row.name) for row in traj.constraints],
        lambda: traj.at(0.5 * (traj.t[0] + traj.t[-1])),
        lambda: traj.resample([traj.t[0], traj.t[-1]]),
        lambda: list(traj.events),
        lambda: list(traj.contacts),
        lambda: list(traj.contact_changes),
        lambda: traj.contacts.at(float(traj.t[-1])),
        lambda: traj.dense_steps.worst(),
        lambda: [traj.contacts.force_of(*pair) for pair in traj.contacts.pairs],
        lambda: str(traj.scene.report),
        lambda: traj.ledger.energy,
        lambda: traj.ledger.energy_balance,
        lambda: traj.ledger.own_jump,
        lambda: traj.ledger.impulse_balance,
        lambda: traj.ledger.gap,
        lambda: traj.sensitivity(("v0", "friction"), on_kink="taken"),
        lambda: traj.gradient((np.zeros(traj.scene.nv), np.ones(traj.scene.nv)), ("q0", "control"), on_kink="taken"),
        lambda: traj.to_html("page.html", fps=5.0),
        lambda: traj.save("again.npz"),
    )
    for read in readers:
        with contextlib.suppress(cvi.ContactviError):
            read()


def _change(entries: dict[str, np.ndarray], change: Case) -> None:
    names = sorted(entries)
    name = names[change["entry"] % len(names)] if names else ""
    kind = change["do"]
    if kind == "header" and "header" in entries:
        with contextlib.suppress(ValueError):
            header = json.loads(str(entries["header"]))
            damage_data(Seeded(change["path"]), header, change["words"])
            entries["header"] = np.array(json.dumps(header))
    elif not names:
        return
    elif kind == "drop":
        del entries[name]
    elif kind == "swap":
        entries[name] = entries[names[change["other"] % len(names)]]
    elif kind == "kind":
        with contextlib.suppress(ValueError, TypeError), np.errstate(all="ignore"):
            entries[name] = entries[name].astype(change["kind"])
    elif kind == "shape":
        values = entries[name]
        entries[name] = (
            values[None],
            values.reshape(-1),
            values.T,
            values[..., None],
            values[:0] if values.ndim else values,
            np.zeros(()),
        )[change["how"]]
    elif kind == "rows" and entries[name].ndim:
        values = entries[name]
        entries[name] = (
            values[:-1],
            values[::-1],
            np.concatenate([values, values]),
            values[:1],
            values[1:],
            np.concatenate([values, values[:1]]),
        )[change["how"]]
    elif kind == "number" and entries[name].size and entries[name].dtype.kind in "fi":
        value = change["value"]
        flat = entries[name].reshape(-1)
        at = change["at"] % flat.size
        with contextlib.suppress(ValueError, OverflowError), np.errstate(all="ignore"):
            flat[at] = flat[at] * 1.001 + 1 if value == "near" else float(value)


def _archive(entries: dict[str, np.ndarray], trick: str | None) -> bytes:
    """Return an npz file, made with a trick."""
    made = io.BytesIO()
    if trick == "npy":
        np.save(made, next(iter(entries.values()), np.zeros(1)), allow_pickle=True)
        return made.getvalue()
    with zipfile.ZipFile(
        made, "w", zipfile.ZIP_DEFLATED if trick in ("compressed", "bomb") else zipfile.ZIP_STORED
    ) as file:
        for name, values in entries.items():
            array = io.BytesIO()
            np.save(array, np.asfortranarray(values) if trick == "fortran" else values, allow_pickle=True)
            data = array.getvalue()
            if trick == "lies" and name in ("t", "q"):
                data = data.replace(b"'shape': (", b"'shape': (9", 1)
            if trick == "pickle" and name == "p":
                array = io.BytesIO()
                np.save(array, np.array([{}, None]), allow_pickle=True)
                data = array.getvalue()
            if trick == "empty" and name == "q":
                data = b""
            file.writestr(("../" if trick == "folder" else "") + name + ".npy", data)
            if trick == "twice" and name == "t":
                file.writestr(name + ".npy", data)
        if trick == "bomb":
            file.writestr("array/9999.npy", bytes(50_000_000))
        if trick == "comment":
            file.comment = b"PK\x05\x06" + bytes(18)
    data = made.getvalue()
    if trick == "encrypted":
        return data.replace(struct.pack("<IH", 0x02014B50, 0x0314), struct.pack("<IH", 0x02014B50, 0x0314), 1).replace(
            b"PK\x01\x02\x14\x03\x14\x00\x00\x00", b"PK\x01\x02\x14\x03\x14\x00\x01\x00"
        )
    return data
