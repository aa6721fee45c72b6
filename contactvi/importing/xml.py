"""Read an XML model file and check the numbers in it; Pinocchio's parsers drop silently what they cannot read."""

from __future__ import annotations

import math
import re
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

from contactvi.errors import SceneError
from contactvi.importing.paths import unreadable

Element = ElementTree.Element
# Numbers as the parsers of models read them; Python's float() takes more: 1_0, other scripts' digits, inf.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_SPACE = " \t\r\n"
# Elements within elements: the parsers of models recurse, and a file that is nested more deeply ends the process.
MOST_LEVELS = 200


def read_xml(path: Path, root_tag: str | None, kind: str) -> Element:
    """Return the root element of an XML file.

    Raises:
        SceneError: not readable, broken XML (with the line), or the root is not `root_tag` (None: any).
    """
    try:
        root = parsed(path.read_bytes())
    except (expat.error, ElementTree.ParseError) as error:
        raise SceneError(
            f"Broken XML in {path.name}",
            path=path,
            expected="well-formed XML",
            got=str(error),
            remedy="This is a scene file: use load_scene" if path.suffix == ".toml" else "Correct the file there",
        ) from None
    except (OSError, UnicodeDecodeError, LookupError, ValueError) as error:
        raise unreadable(path, error) from None
    if (levels := depth(root)) > MOST_LEVELS:
        raise SceneError(
            f"{path.name} is nested too deeply",
            path=path,
            expected=f"at most {MOST_LEVELS} elements within each other",
            got=levels,
            remedy="Close the elements where they end, or split the model into several files",
        )
    if root_tag is not None and root.tag != root_tag:
        remedies = {
            "robot": "This is a URDF: use add_urdf",
            "mujoco": "This is an MJCF: use add_mjcf",
            "sdf": "SDF is not supported: convert it to URDF",
        }
        raise SceneError(
            f"{path.name} is not {kind}",
            path=path,
            expected=f"the root element <{root_tag}>",
            got=f"<{root.tag}>",
            remedy=remedies.get(root.tag, f"Name a file whose root element is <{root_tag}>"),
        )
    return root


def parsed(text: bytes | str) -> Element:
    """Return the root element of an XML text; a prefix stays part of a tag (`drake:capsule`), declared or not.

    The readers of these formats know no namespaces, so files with prefixes that nothing declares are about.

    Raises:
        xml.parsers.expat.error: broken XML. ValueError, LookupError: an encoding that is not known.
    """
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close()


def depth(root: Element) -> int:
    """Return how many elements lie within each other, the root included."""
    deepest, waiting = 0, [(root, 1)]
    while waiting:
        element, level = waiting.pop()
        deepest = max(deepest, level)
        waiting += [(child, level + 1) for child in element]
    return deepest


def numbers(element: Element, key: str, path: Path, where: str, count: int | None = None) -> list[float] | None:
    """Return the finite numbers of an attribute, None when it is absent.

    Raises:
        SceneError: not numbers, not finite, or not `count` of them.
    """
    text = element.get(key)
    if text is None:
        return None
    words = [word for word in re.split(f"[{_SPACE}]+", text) if word]
    values = [float(word) if _NUMBER.fullmatch(word) else math.nan for word in words]
    if not values or not all(math.isfinite(v) for v in values) or (count is not None and len(values) != count):
        raise SceneError(
            f"{path.name}: {key} of <{element.tag}> in {where}",
            path=path,
            expected=f"{count if count is not None else 'some'} finite number(s)",
            got=repr(text),
            remedy="Write plain decimals, such as 0.5 or 1e-3, with spaces between them",
        )
    return values


def check_positive(element: Element, key: str, path: Path, where: str, count: int) -> None:
    """Raise a SceneError unless the attribute is there and all its numbers are > 0."""
    values = numbers(element, key, path, where, count)
    if values is None or min(values) <= 0.0:
        raise SceneError(
            f"{path.name}: {key} of <{element.tag}> in {where}",
            path=path,
            expected=f"{count} number(s) > 0",
            got=repr(element.get(key)),
            remedy=f'Write {key}="{" ".join(["0.5"] * count)}" with your own numbers, in metres',
        )


def named(elements: list[Element], path: Path, kind: str) -> dict[str, Element]:
    """Return the elements by name.

    Raises:
        SceneError: one without a name, or two of the same name.
    """
    found: dict[str, Element] = {}
    for element in elements:
        name = element.get("name", "")
        if not name:
            raise SceneError(
                f"{path.name}: a {kind} without a name",
                path=path,
                expected="a name",
                got="none",
                remedy=f'Add name="..." to the {kind}',
            )
        if name in found:
            raise SceneError(
                f"{path.name}: two of the {kind} names are {name!r}",
                path=path,
                expected="distinct names",
                got=repr(name),
                remedy="Rename one of them, also where it is referred to",
            )
        found[name] = element
    return found
