"""Batches that go on where they were interrupted: their blocks are kept in files beside the one that they become.

The folder FILE.parts holds a file of each block of runs that is made, named by their numbers, with the key of the
batch: a hash of all that the runs depend on. A later call with the same key makes the runs that are missing, which have
the bits that they would have had; then the blocks become one file, and the folder goes.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from contactvi.batch.blocks import Block
from contactvi.batch.plan import Plan
from contactvi.batch.storage import StoredBatch, load_batch, save_batch
from contactvi.errors import InputError, OverwriteError, SceneError
from contactvi.scene.fingerprint import fingerprint

Made = Callable[[Plan, int], Iterator[Block]]  # of a part of the plan, which starts with this run


def key_of(plan: Plan) -> str:
    """Return a hash of all that the runs of a plan depend on.

    Raises:
        InputError: for functions, of which nobody can tell whether they are still the same.
    """
    data = plan.scene.to_dict()
    functions = [name for name, value in plan.shared.items() if callable(value)] + list(data["missing"])
    if functions or plan.start is not None:
        raise InputError(
            "This batch cannot be resumed", name="resume", expected="inputs as arrays and a scene without functions",
            got="the state of a simulator" if plan.start is not None else ", ".join(functions),
            remedy="Leave resume out, or split the batch into several files and make those that are missing",
        )  # fmt: skip
    whole = {
        "scene": fingerprint(data), "start": [data["q0"], data["v0"]], "options": plan.options.to_dict(),
        "keep": plan.keep, "runs": plan.runs,
    }  # fmt: skip
    found = hashlib.sha256(json.dumps(whole, sort_keys=True).encode())
    for group in (plan.rows, plan.shared, plan.parameters, plan.common):
        for name, values in sorted(group.items()):
            numbers = np.ascontiguousarray(values, dtype=float)
            found.update(f"{name} {numbers.shape} ".encode() + numbers.tobytes())
    return found.hexdigest()


class Resumed:
    """A batch that is written to a file and may be interrupted.

    Raises:
        OverwriteError: there is a file of another batch at the path, without `overwrite`.
    """

    def __init__(self, path: Path, plan: Plan, overwrite: bool) -> None:
        self._path, self._plan, self._overwrite = path, plan, overwrite
        self._folder = path.with_name(path.name + ".parts")
        self._key = key_of(plan)
        if not path.is_file() or overwrite or self.finished is not None:
            return
        raise OverwriteError(
            f"There is a file {path}", path=path, expected="this batch, begun with resume=True, or a name that is free",
            got="a batch of other starts, scene or options, or one made without resume=True" if _is_batch(path)
            else "a file of something else",
            remedy="Give another path, or overwrite=True, which replaces the file",
        )  # fmt: skip

    @property
    def finished(self) -> StoredBatch | None:
        """The file of the batch, where it is complete."""
        return _with_key(self._path, self._key) if self._path.is_file() else None

    def run(self, made: Made) -> StoredBatch:
        """Make the runs that are missing, and write the file; return it."""
        self._folder.mkdir(parents=True, exist_ok=True)
        batch = save_batch(self._path, self._plan, self._blocks(made), self._overwrite, self._key)
        shutil.rmtree(self._folder)
        return batch

    def _blocks(self, made: Made) -> Iterator[Block]:
        first = 0
        parts = [*self._parts(), (self._plan.runs, self._plan.runs, None)]
        for start, end, stored in parts:
            for block in made(self._plan.part(first, start), first) if start > first else ():
                part = self._plan.part(first, first + len(block))
                save_batch(self._folder / f"{first}-{first + len(block)}", part, [block], True, self._key)
                first += len(block)
                yield block
            if stored is not None:
                yield stored.block
            first = end

    def _parts(self) -> list[tuple[int, int, StoredBatch]]:
        """Return the blocks that are there: first run, the one after the last, the file."""
        found: list[tuple[int, int, StoredBatch]] = []
        for path in self._folder.iterdir():
            ends = path.name.split("-")
            batch = _with_key(path, self._key) if len(ends) == 2 and all(end.isdigit() for end in ends) else None
            if batch is not None:
                found.append((int(ends[0]), int(ends[1]), batch))
        found.sort(key=lambda part: part[:2])
        return [part for k, part in enumerate(found) if k == 0 or part[0] >= found[k - 1][1]]


def _is_batch(path: Path) -> bool:
    """Return whether a file is a batch of runs."""
    try:
        load_batch(path)
    except SceneError:
        return False
    return True


def _with_key(path: Path, key: str) -> StoredBatch | None:
    """Return the batch in a file, None where it is another one, or none."""
    try:
        batch = load_batch(path)
    except SceneError:
        return None
    return batch if batch.header["key"] == key else None
