"""Which shapes a name stands for when contacts are asked for."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import entries, short

Groups = Mapping[str, tuple[str, ...]]


class ShapeNames:
    """The shapes of the tested pairs, and the parts and bodies to which they belong.

    A name is that of a part, a body or a shape (the first kind that has it), or a pattern with * ? [] over all of them.
    """

    def __init__(self, pairs: Iterable[tuple[str, str]], groups: Groups) -> None:
        self._tested = {shape for pair in pairs for shape in pair}
        self._groups = groups

    def of(self, body: Any, argument: str = "body") -> set[str]:
        """Return the shapes of a name, of several names, or of a handle of the scene.

        Raises:
            InputError: not a name, or a name that none of the tested pairs has.
        """
        if isinstance(body, str):
            return self._named(body, argument)
        shapes = entries(getattr(body, "geometries", body))
        if shapes is None or not all(isinstance(shape, str) for shape in shapes):
            raise InputError(
                f"Argument {argument}", name=argument, expected="a name, several names, or a handle of the scene",
                got=short(body), remedy="Give the name of a body or shape, or what scene.add_... returned",
            )  # fmt: skip
        if hasattr(body, "geometries"):  # a handle may have shapes that no pair has
            return self._known(str(body), set(shapes), argument)
        return set().union(*(self._named(shape, argument) for shape in shapes))

    def _named(self, name: str, argument: str) -> set[str]:
        if name in self._groups:
            return self._known(name, set(self._groups[name]), argument)
        if name in self._tested:
            return {name}
        found = set(fnmatch.filter(self._tested, name))
        for group in fnmatch.filter(self._groups, name):
            found.update(self._groups[group])
        return self._known(name, found, argument)

    def _known(self, name: str, shapes: set[str], argument: str) -> set[str]:
        found = shapes & self._tested
        if found:
            return found
        tested = [group for group, its_shapes in self._groups.items() if self._tested & set(its_shapes)]
        raise InputError(
            f"{name!r} has no shape in the tested pairs" if shapes or name in self._groups else f"No body {name!r}",
            name=argument, expected="a part, body or shape of the tested pairs, or a pattern", got=repr(name),
            remedy=did_you_mean(name, [*tested, *sorted(self._tested)]),
        )  # fmt: skip


def matching_pairs(pairs: Sequence[tuple[str, str]], first: set[str], second: set[str]) -> list[bool]:
    """Return which pairs are of one shape of `first` and one of `second`, in whichever order."""
    return [(a in first and b in second) or (a in second and b in first) for a, b in pairs]
