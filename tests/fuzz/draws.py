"""What all families draw from: numbers and words that are nearly right, and small damages to trees of data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar
from xml.etree import ElementTree

from hypothesis import strategies as st

T = TypeVar("T")
Case = dict[str, Any]

# Numbers that a file may hold and that may well be meant so.
EXTREME = (0.0, -0.0, 1.0, -1.0, 5e-324, 1e-300, 1e-160, 1e-30, 1e-12, 1e-7, 1e7, 1e12, 1e30, 1e155, 1e300, 1.7e308)
# What stands for numbers in files and is none, or none of the reader's.
NO_NUMBERS = (
    *("nan", "inf", "-inf", "1e400", "-1e400", "1_0", "\u0661", "1\u00a0", "\uff11", "\u00bd", "", " ", "a", "1,5"),
    *(
        "0x10",
        "1e",
        "1.5.2",
        "+-1",
        "--1",
        "1 2",
        "1 2 3",
        "1 2 3 4",
        "true",
        "None",
        "${x}",
        "1e5f",
        "\u22121",
        "9" * 400,
    ),
)
WORDS = (
    *("", " ", "a", "world", "universe", "root_joint", "*", "[", "?", "a*", "\u00e9", "\U0001f916", "a/b", "../x", "."),
    *("a\u0000b", "\u202e", "x" * 300, "base", "link_1", "joint_1", "nan", "1", "%s", "{0}", "a b", "\ufeffa", "&lt;"),
)


class Draws:
    """Draws of hypothesis under short names."""

    def __init__(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        self._draw = draw

    def whole(self, low: int, high: int) -> int:
        """Return a whole number in [low, high]."""
        return int(self._draw(st.integers(low, high)))

    def chance(self, percent: int) -> bool:
        """Return True this often."""
        return self.whole(1, 100) <= percent

    def pick(self, choices: Sequence[T]) -> T:
        """Return one of the choices."""
        return choices[self.whole(0, len(choices) - 1)]

    def number(self, low: float, high: float) -> float:
        """Return a number in [low, high] with few digits."""
        return round(low + (high - low) * self.whole(0, 1000) / 1000, 4)

    def any_number(self) -> float:
        """Return any double, NaN and the infinite ones included."""
        return float(self._draw(st.floats(width=64)))

    def text(self) -> str:
        """Return any short text, of letters that XML and UTF-8 can have or not."""
        return "".join(chr(self.whole(0, self.pick((0x7F, 0x2FF, 0xD7FF, 0x10FFFF)))) for _ in range(self.whole(0, 6)))

    def bytes(self, most: int = 16) -> bytes:
        """Return a few bytes."""
        return bytes(self._draw(st.binary(max_size=most)))

    def damages(self) -> int:
        """Return to how many places a case is to be damaged: mostly to few, so that it gets far."""
        return self.pick((0, 0, 1, 1, 1, 2, 3))

    def wild_number(self) -> str:
        """Return the text of an extreme number, or of none."""
        kind = self.whole(0, 9)
        if kind < 6:
            return repr(self.pick(EXTREME))
        return self.pick(NO_NUMBERS) if kind < 9 else repr(self.any_number())

    def wild_word(self) -> str:
        """Return a name that is unusual."""
        return self.pick(WORDS) if self.chance(80) else self.text()


def cases(make: Callable[[Draws], Case]) -> st.SearchStrategy[Case]:
    """Return the strategy of the cases that `make` makes of its draws."""

    @st.composite
    def case(draw: Callable[[st.SearchStrategy[Any]], Any]) -> Case:
        return make(Draws(draw))

    return case()


def run_settings(d: Draws) -> Case:
    """Return how a scene is run for a few steps: mostly mildly, sometimes from a wild start."""
    wild = d.chance(12)

    def entries() -> list[float]:
        return [d.pick(EXTREME) if d.chance(40) else d.number(-3, 3) for _ in range(4)]

    return {
        "dt": d.pick((1e-3, 1e-3, 1e-2, 1e-5, 0.1, 1.0)),
        "steps": d.whole(1, 5),
        "order": d.pick((None, 2, 4, 8)),
        "impact": d.pick((None, "ctec", "mhc", "dtec")),
        "contact_mode": d.pick((None, None, "steps", "events")),
        "dq": [d.number(-0.5, 0.5) for _ in range(3)] if d.chance(30) else entries() if wild and d.chance(20) else None,
        "v": entries() if wild else [d.number(-2, 2) for _ in range(3)] if d.chance(30) else None,
        # Forces between these take the engine's dense steps down to nanoseconds: slow, as it should be.
        "tau": [x for x in entries() if not 1e7 < abs(x) < 1e100] or None if d.chance(10) else None,
    }


# --- damage to text, XML and plain data -------------------------------------------------------------------------------


def damage_bytes(d: Draws, data: bytes) -> bytes:
    """Return bytes with one damage: cut, overwritten, put in, doubled."""
    k = d.whole(0, max(0, len(data) - 1))
    kind = d.whole(0, 3)
    if kind == 0:
        return data[:k]
    if kind == 1:
        new = d.bytes()
        return data[:k] + new + data[k + len(new) :]
    if kind == 2:
        return data[:k] + d.bytes() + data[k:]
    return data[:k] + data[max(0, k - d.whole(1, 200)) :]


def damage_xml(d: Draws, root: ElementTree.Element, tags: Sequence[str], keys: Sequence[str]) -> None:
    """Damage one place of an XML tree. tags, keys: words of the format, for new elements and attributes."""
    elements = list(root.iter())
    with_attributes = [element for element in elements if element.attrib]
    element = d.pick(with_attributes or elements)
    kind = d.whole(0, 11)
    if kind <= 4 and element.attrib:
        _damage_attribute(d, element, d.pick(sorted(element.attrib)))
    elif kind == 5 and element.attrib:
        del element.attrib[d.pick(sorted(element.attrib))]
    elif kind == 6:
        element.set(d.pick(keys), d.wild_number() if d.chance(60) else d.wild_word())
    elif kind == 7:
        other = d.pick(with_attributes or elements)
        key = d.pick(sorted(other.attrib) or ["name"])
        element.set(key, other.get(key, ""))
    elif kind == 8:
        parent = d.pick(elements)
        if len(parent):
            del parent[d.whole(0, len(parent) - 1)]
    elif kind == 9:
        parent, child = d.pick(elements), d.pick(elements)
        if parent not in list(child.iter()):  # not into itself
            parent.append(child)
    elif kind == 10:
        element.tag = d.pick(tags)
    else:
        inner = ElementTree.SubElement(d.pick(elements), d.pick(tags))
        for _ in range(d.pick((0, 0, 1, 60, 250))):
            inner = ElementTree.SubElement(inner, inner.tag)


def _damage_attribute(d: Draws, element: ElementTree.Element, key: str) -> None:
    words = element.get(key, "").split()
    if words and d.chance(80) and any(letter.isdigit() for letter in words[0]):
        words[d.whole(0, len(words) - 1)] = d.wild_number()
        if d.chance(10):
            words.pop()
        element.set(key, " ".join(words))
    else:
        element.set(key, d.wild_word() if d.chance(60) else d.wild_number())


def xml_text(root: ElementTree.Element) -> str:
    """Return the XML of a tree. Twins, which hold each other's children, are written once each."""
    return ElementTree.tostring(root, encoding="unicode")


def damage_data(d: Draws, data: Any, keys: Sequence[str]) -> None:
    """Damage one place of plain data (dicts, lists, values). keys: words of the format."""
    places = list(_places(data))
    if not places:
        return
    holder, key = d.pick(places)
    kind = d.whole(0, 11)
    if kind <= 5:
        holder[key] = _near(d, holder[key])
    elif kind == 6:
        holder[key] = wild_value(d)
    elif kind == 7:
        del holder[key]
    elif kind == 8:
        other, place = d.pick(places)
        holder[key] = other[place] if not isinstance(other[place], (dict, list)) else len(other[place])
    elif kind == 9 and isinstance(holder, list):
        holder.append(holder[key])
    elif kind == 10 and isinstance(holder, dict):
        holder[d.wild_word()] = holder.pop(key)
    elif isinstance(holder, dict):
        holder[d.pick(keys)] = holder[key] if d.chance(30) else wild_value(d)


def _places(data: Any) -> Any:
    """Yield (holder, key) of all values within plain data."""
    if isinstance(data, dict):
        keys: Any = list(data)
    elif isinstance(data, list):
        keys = range(len(data))
    else:
        return
    for key in keys:
        yield data, key
        yield from _places(data[key])


def _near(d: Draws, value: Any) -> Any:
    """Return another value of the same kind."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return d.pick((0, -1, value + 1, value - 1, 2**31, 2**63, 10**30))
    if isinstance(value, float):
        return d.pick(EXTREME) if d.chance(70) else -value if d.chance(50) else d.any_number()
    if isinstance(value, str):
        return d.wild_word()
    if isinstance(value, list):
        return d.pick((value[:-1], value + value[:1], [], [value], [0.0] * len(value)))
    return wild_value(d)


def wild_value(d: Draws) -> Any:
    """Return plain data of any kind."""
    kind = d.whole(0, 8)
    if kind == 0:
        return d.any_number()
    if kind == 1:
        return d.pick(EXTREME)
    if kind == 2:
        return d.wild_word()
    if kind == 3:
        return d.pick((True, False))
    if kind == 4:
        return d.pick((0, 1, -1, 2, 2**31, 2**63, 10**30))
    if kind == 5:
        return [d.number(-1, 1) for _ in range(d.whole(0, 7))]
    if kind == 6:
        return {d.wild_word(): d.number(-1, 1) for _ in range(d.whole(0, 2))}
    if kind == 7:
        return [d.wild_word() for _ in range(d.whole(0, 3))]
    return [[d.pick(EXTREME)], {}]
