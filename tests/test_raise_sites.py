"""All places that raise: each error says what was expected, what it got and what to do, and is one of contactvi's.

What no user can see is exempt by its class: in Python an exception of the package that the package catches itself, in
C++ `Error`, a fault of the program, to which the bindings add the texts.
"""

from __future__ import annotations

import ast
import builtins
import copy
import functools
import importlib
import inspect
import pickle
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import contactvi
from contactvi import errors

ROOT = Path(__file__).parents[1]
PACKAGE = Path(contactvi.__file__).parent
MODULES = {path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}
PARTS = ("expected", "got", "remedy")
KINDS = {
    name: kind
    for name, kind in vars(errors).items()
    if inspect.isclass(kind) and issubclass(kind, errors.ContactviError)
}
WARNINGS = {name for name, kind in vars(errors).items() if inspect.isclass(kind) and issubclass(kind, Warning)}
BUILTIN = {name for name, kind in vars(builtins).items() if inspect.isclass(kind) and issubclass(kind, BaseException)}
# What Python asks for: the end of a sequence, a name that a module or an object does not have.
PROTOCOL = {"IndexError": "__getitem__", "AttributeError": "__getattr__"}
# The user's own wish to stop, and the end of the command line program.
ENDS = {"KeyboardInterrupt", "Exit"}
# Remedies that name nothing to do.
FILLER = re.compile(r"(check|correct|look at|mind|mend|fix)( (the|your|its|this|that))?( \w+)?\.?", re.IGNORECASE)


def name_of(node: ast.expr | None) -> str:
    """Return the last name of an expression such as `a.b.Error(...)`."""
    if isinstance(node, ast.Call):
        return name_of(node.func)
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def with_function(tree: ast.AST, inside: str = "") -> Iterator[tuple[ast.AST, str]]:
    """Yield all nodes with the name of the function that they stand in."""
    for node in ast.iter_child_nodes(tree):
        yield node, inside
        yield from with_function(
            node, node.name if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) else inside
        )


@functools.cache
def makers() -> set[str]:
    """Return the names of functions that return an error of contactvi, by their annotations."""
    nodes = (node for tree in MODULES.values() for node in ast.walk(tree))
    return {node.name for node in nodes if isinstance(node, ast.FunctionDef) and name_of(node.returns) in KINDS}


@functools.cache
def caught() -> set[str]:
    """Return the names of exceptions that the package catches somewhere."""
    found = set()
    for tree in MODULES.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.ExceptHandler) and node.type is not None:
                found |= {name_of(kind) for kind in getattr(node.type, "elts", [node.type])}
    return found


@functools.cache
def own_exceptions() -> set[str]:
    """Return the names of exceptions that the package defines for itself."""
    nodes = (node for tree in MODULES.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    return {node.name for node in nodes if {name_of(base) for base in node.bases} & BUILTIN} - set(KINDS) - WARNINGS


@pytest.mark.parametrize("module", [name for name in MODULES if name != "errors.py"])
def test_each_error_is_made_with_its_three_texts(module):
    wrong = []
    for node in ast.walk(MODULES[module]):
        if not (isinstance(node, ast.Call) and name_of(node) in KINDS):
            continue
        given = {keyword.arg: keyword.value for keyword in node.keywords}
        for part in PARTS:
            value = given.get(part)
            if value is None or (isinstance(value, ast.Constant) and value.value in (None, "")):
                wrong.append(f"line {node.lineno}: no {part}")
        remedy = given.get("remedy")
        if isinstance(remedy, ast.Constant) and FILLER.fullmatch(str(remedy.value)):
            wrong.append(f"line {node.lineno}: the remedy {remedy.value!r} says nothing to do")
    assert not wrong, f"{module}: {wrong}"


@pytest.mark.parametrize("module", list(MODULES))
def test_nothing_else_is_raised(module):
    """Built-in exceptions neither leave the package nor serve inside of it."""
    wrong, internal = [], own_exceptions() & caught()
    for node, function in with_function(MODULES[module]):
        if not isinstance(node, ast.Raise) or node.exc is None:
            continue
        name = name_of(node.exc)
        made = isinstance(node.exc, ast.Call) or name in BUILTIN
        if not made or name in set(KINDS) | makers() | ENDS | internal or PROTOCOL.get(name) == function:
            continue  # what is not made here was an error before, which is raised again
        wrong.append(f"line {node.lineno}: {name}")
    assert not wrong, f"{module}: {wrong}"


@pytest.mark.parametrize("name", KINDS)
def test_no_error_can_be_made_without_them(name):
    texts = dict.fromkeys(PARTS, "text")
    KINDS[name]("what", **texts)
    for part in PARTS:
        with pytest.raises(TypeError, match=part):
            KINDS[name]("what", **{other: text for other, text in texts.items() if other != part})


@pytest.mark.parametrize("name", KINDS)
def test_message_and_copies(name):
    texts = ("Radius of 'ball'", "a number > 0", "-1", "Use 0.5 or more")
    kind = KINDS[name]
    made = kind(*texts) if name == "EngineError" else kind(texts[0], **dict(zip(PARTS, texts[1:], strict=True)))
    for error in (made, copy.copy(made), pickle.loads(pickle.dumps(made))):
        assert str(error) == "Radius of 'ball': expected a number > 0, got -1. Use 0.5 or more."
        assert (error.what, error.expected, error.got, error.remedy) == texts
        assert type(error) is kind


def test_lines_of_a_file_get_no_full_stop():
    error = errors.SceneError("x", expected="y", got="z", remedy="Write these lines:\ndt = 1")
    assert str(error).endswith("\ndt = 1")


# --- names ------------------------------------------------------------------------------------------------------------
def test_all_errors_are_exported_and_documented():
    stub = (PACKAGE / "__init__.pyi").read_text()
    assert set(re.findall(r"from \.errors import (\w+)", stub)) == set(KINDS) | WARNINGS
    assert "automodule:: contactvi.errors\n   :members:" in (ROOT / "docs" / "api" / "errors.md").read_text()
    assert all(inspect.getdoc(kind) for kind in KINDS.values())


def test_pages_and_docstrings_name_errors_that_exist():
    known = set(KINDS) | WARNINGS | BUILTIN | own_exceptions() | {"JaxRuntimeError"}  # that one is of JAX
    texts = {path.name: path.read_text() for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]}
    for module, tree in MODULES.items():
        documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
        docs = (ast.get_docstring(node) for node in ast.walk(tree) if isinstance(node, documented))
        texts[module] = "\n".join(doc for doc in docs if doc)
    for name, text in texts.items():
        unknown = set(re.findall(r"\b[A-Z]\w*[a-z](?:Error|Warning)\b", text)) - known
        assert not unknown, f"{name} names {unknown}"


# --- the engine -------------------------------------------------------------------------------------------------------
_CPP = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])\'', re.DOTALL)
# Faults and what other libraries ask for: an error of Python on its way, memory that is used up.
FAULTS = {"Error", "nb::python_error", "std::bad_alloc"}


def plain(source: str) -> str:
    """Return C++ without comments; the text in strings is replaced by x, so that it holds no punctuation."""

    def short(found: re.Match[str]) -> str:
        text = found[0]
        return f'"{"x" * (len(text) > 2)}"' if text[0] in "\"'" else " " + "\n" * text.count("\n")

    return _CPP.sub(short, source)


def arguments(source: str, begin: int) -> list[str]:
    """Return the arguments of a call; `begin` is behind its opening parenthesis."""
    found, depth = [""], 1
    for letter in source[begin:]:
        depth += (letter in "([{") - (letter in ")]}")
        if depth == 0:
            break
        if letter == "," and depth == 1:
            found.append("")
        else:
            found[-1] += letter
    return [text.strip() for text in found]


def thrown(source: str) -> Iterator[tuple[int, str, list[str]]]:
    """Yield line, class and arguments of each throw expression, also those of a nanobind error that is made."""
    text = plain(source)
    for found in re.finditer(r"\bthrow\b\s*([\w:]*)\s*([({;])", text):
        if found[1]:
            yield text[: found.start()].count("\n") + 1, found[1], arguments(text, found.end())


def test_the_lexer_reads_what_it_should():
    source = 'throw Refusal("a, b(" + f(x, y), "c", /* , */ g, "");  // throw Bad(1)\nthrow;\nauto s = "throw Bad(2)";'
    assert list(thrown(source)) == [(1, "Refusal", ['"x" + f(x, y)', '"x"', "g", '""'])]


REFUSALS = {"Refusal": 4, "NoDerivative": 5}  # the engine's errors for users, and how many arguments they have


@pytest.mark.skipif(not (ROOT / "core").is_dir(), reason="needs the source folder")
def test_the_engine_refuses_with_four_texts():
    wrong, refusals = [], 0
    for path in sorted((ROOT / "core").rglob("*.?pp")):
        for line, kind, texts in thrown(path.read_text()):
            refusals += kind in REFUSALS
            if kind in REFUSALS and (len(texts) != REFUSALS[kind] or '""' in texts):
                wrong.append(f"{path.name}:{line}: fact, expected, got, remedy of a {kind}")
            elif kind not in REFUSALS and kind not in FAULTS:
                wrong.append(f"{path.name}:{line}: {kind} is neither a Refusal nor a fault")
    assert not wrong
    assert refusals > 5


def test_a_fault_of_the_engine_has_all_texts():
    engine = importlib.import_module("contactvi._core")
    with pytest.raises(errors.EngineError, match="sse9") as caught:
        engine.instruction_set("sse9")
    assert isinstance(caught.value, errors.ContactviError)
    assert all(getattr(caught.value, part) for part in PARTS)
    assert "bug" in caught.value.remedy
