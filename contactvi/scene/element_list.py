"""The elements of a scene by name: constraints, springs, wrenches and functions of the user."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import replace

from contactvi.elements.element import Element
from contactvi.errors import InputError, did_you_mean
from contactvi.inputs import is_text, short


class ElementList:
    """The elements of a scene in the order they were added; no two have the same name.

    Attributes:
        elements: What was added.
        missing: Names of elements and servo targets that a stored scene had and lost, because Python functions gave
            them.
    """

    def __init__(self, elements: Iterable[Element] = (), missing: Iterable[str] = ()) -> None:
        self.elements = list(elements)
        self.missing = list(missing)

    def new_name(self, kind: str, name: str | None) -> str:
        """Return the name of a new element: the one given, or kind_1, kind_2, ...; raise InputError for a taken one."""
        taken = {element.name for element in self.elements}
        if name is None:
            return next(f"{kind}_{k}" for k in range(1, len(taken) + 2) if f"{kind}_{k}" not in taken)
        if not is_text(name):
            raise InputError(
                "Name of an element",
                name="name",
                expected="a non-empty str in UTF-8",
                got=short(name),
                remedy="Give name='...', or leave it out: it is then made from the kind and a number",
            )
        if name in taken:
            raise InputError(
                f"There is an element called {name!r} already",
                name="name",
                expected="a new name",
                got=repr(name),
                remedy="Give another name, or scene.remove(name) first",
            )
        return name

    def add(self, element: Element) -> None:
        """Add an element; it replaces a missing one of its name."""
        self.elements.append(element)
        self.supply({element.name})

    def add_from_file(self, elements: Iterable[Element]) -> None:
        """Add the elements of a model's file, numbered where their names are taken."""
        for element in elements:
            taken = {known.name for known in self.elements}
            names = (element.name, *(f"{element.name}_{k}" for k in range(2, len(taken) + 3)))
            self.elements.append(replace(element, name=next(name for name in names if name not in taken)))

    def supply(self, names: Container[str]) -> None:
        """Take names off the list of what is missing."""
        self.missing = [name for name in self.missing if name not in names]

    def remove(self, name: str) -> None:
        """Take an element, or the name of a missing one, out; raise InputError where there is none."""
        known = [element.name for element in self.elements] + self.missing
        if not isinstance(name, str) or name not in known:
            raise InputError(
                "Unknown element",
                name="name",
                expected="an element of the scene",
                got=short(name),
                remedy=did_you_mean(str(name), known),
            )
        self.elements = [element for element in self.elements if element.name != name]
        self.supply({name})

    def copy(self) -> ElementList:
        """Return a list of the elements, which are constants themselves."""
        return ElementList(self.elements, self.missing)
