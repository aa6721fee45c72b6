"""The structure of the code in numbers: folders and what uses what, the largest class, file and function.

    python benchmarks/structure.py            # of this checkout
    python benchmarks/structure.py ROOT       # of another one, also an older one whose files lie flat

Data members of a C++ class are those declared in its body (also of public structs), those of a Python class the
attributes set on self and the fields of its body, inherited ones of the package included. Public functions do not
count constructors, operators and names that start with an underscore. Nothing is imported or compiled.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)
COMMENT = re.compile(r'//[^\n]*|/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])\'', re.DOTALL)
DIRECTIVE = re.compile(r"^[ \t]*#(?:\\\n|[^\n])*", re.MULTILINE)
CLASS = re.compile(r"\b(class|struct)\s+(?:alignas\([^)]*\)\s*)?(\w+)[^;={}()]*$")
NO_DATA = re.compile(r"^\s*(using|friend|typedef|static|enum|class|struct|template|extern|constexpr)\b")
ACCESS = re.compile(r"^\s*(public|private|protected)\s*:")
Graph = dict[str, set[str]]


@dataclass
class Class:
    """A class and what is declared in it."""

    name: str
    file: str
    data: set[str] = field(default_factory=set)
    public: set[str] = field(default_factory=set)
    bases: list[str] = field(default_factory=list)


@dataclass
class Code:
    """What was found in one language."""

    lines: dict[str, int]
    classes: list[Class]
    functions: list[tuple[int, str]]  # lines, name and file
    folders: Graph


# --- C++ --------------------------------------------------------------------------------------------------------------


def bare(text: str) -> str:
    """Return C++ without comments, strings and directives; the lines stay."""
    text = COMMENT.sub(lambda found: "\n" * found[0].count("\n") if found[0][0] == "/" else '""', text)
    return DIRECTIVE.sub(lambda found: "\n" * found[0].count("\n"), text)


def closing(text: str, start: int) -> int:
    """Return where the brace that opens at `start` closes."""
    depth = 0
    for at in range(start, len(text)):
        depth += {"{": 1, "}": -1}.get(text[at], 0)
        if depth == 0:
            return at
    return len(text) - 1


def without_brackets(text: str) -> str:
    """Return a declaration without what stands in <>, () after a name stays as "()"."""
    for _ in range(8):
        text = re.sub(r"<[^<>()]*(?:\([^()]*\)[^<>()]*)*>", "", text)
    return text


def names_of_data(statement: str) -> list[str]:
    """Return the names that one declaration of data declares; none where it declares something else."""
    text = without_brackets(statement)
    if NO_DATA.match(text) or "operator" in text:
        return []
    head = re.split(r"[={]", text, maxsplit=1)[0]
    if "(" in head:
        return []
    text = re.sub(r"\{[^{}]*\}|\[[^\]]*\]|=[^,;]*", "", text)
    first, *others = text.split(",")
    words = re.findall(r"\w+", first)
    if len(words) < 2:
        return []
    return [words[-1], *(name for other in others for name in re.findall(r"\w+", other)[:1])]


def name_of_function(statement: str, owner: str) -> str:
    """Return the name of the member function that is declared, "" for constructors, operators and data."""
    text = without_brackets(statement)
    if "operator" in text or re.match(r"^\s*(using|friend|typedef)\b", text) or re.search(r"=\s*delete", text):
        return ""
    found = re.search(r"(~?\w+)\s*\(", text)
    if found is None or "=" in text[: found.start()] or found[1].lstrip("~") == owner:
        return ""
    return found[1]


def walk(text: str, file: str, code: Code, owner: Class | None, public: bool, line: int) -> None:
    """Read a namespace, a file or the body of a class: declarations, classes, functions."""
    at = start = 0
    while at < len(text):
        letter = text[at]
        if letter == ":" and owner is not None and (found := ACCESS.match(text[start : at + 1])):
            public, start = found[1] == "public", at + 1
        elif letter == "}":  # closes nothing here: a stray one of what was cut
            start = at + 1
        elif letter == ";":
            declare(text[start:at], owner, public)
            start = at + 1
        elif letter == "{":
            head, end = text[start:at], closing(text, at)
            body, top = text[at + 1 : end], line + text.count("\n", 0, at)
            made = CLASS.search(head)
            if re.search(r"\b(namespace\b[^;]*|extern\s*\"\")\s*$", head):
                walk(body, file, code, None, True, top)
                start = end + 1
            elif made and not re.search(r"\benum\b", head):
                inner = Class(made[2], file)
                code.classes.append(inner)
                walk(body, file, code, inner, made[1] == "struct", top)
                start = end + 1
            elif "(" in without_brackets(head) and not re.search(r"=\s*$|\benum\b", head):
                first = line + text.count("\n", 0, start + len(head) - len(head.lstrip()))
                last = line + text.count("\n", 0, end)
                name = re.search(r"([\w:~]+)\s*\(", without_brackets(head))
                code.functions.append((last - first + 1, f"{name[1] if name else '?'} in {file}"))
                declare(head, owner, public)
                start = end + 1
            at = end
        at += 1


def declare(statement: str, owner: Class | None, public: bool) -> None:
    if owner is None:
        return
    if name := name_of_function(statement, owner.name):
        if public:
            owner.public.add(name)
        return
    owner.data.update(names_of_data(statement))


def read_cpp(root: Path) -> Code:
    core = root / "core"
    code = Code({}, [], [], {})
    for path in sorted(path for path in core.rglob("*") if path.suffix in {".hpp", ".cpp"}):
        text, name = path.read_text(), str(path.relative_to(root))
        code.lines[name] = text.count("\n")
        walk(bare(text), name, code, None, True, 1)
        folder = folder_of(path, core)
        used = code.folders.setdefault(folder, set())
        for header in INCLUDE.findall(text):
            for target in (path.parent / header, core / header):
                if target.is_file():
                    used.add(folder_of(target.resolve(), core))
    return code


# --- Python -----------------------------------------------------------------------------------------------------------


def attributes(node: ast.ClassDef) -> Iterator[str]:
    """Yield the fields of the body and the attributes that methods set on self."""
    for item in node.body:
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            yield item.target.id
    for item in ast.walk(node):
        stored = isinstance(item, ast.Attribute) and isinstance(item.ctx, ast.Store)
        if stored and isinstance(item.value, ast.Name) and item.value.id == "self":
            yield item.attr


def read_python(root: Path) -> Code:
    package = root / "contactvi"
    code = Code({}, [], [], {})
    for path in sorted(package.rglob("*.py")):
        text, name = path.read_text(), str(path.relative_to(root))
        code.lines[name] = text.count("\n")
        tree = ast.parse(text)
        used = code.folders.setdefault(folder_of(path, package), set())
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                first = min([node.lineno, *(item.lineno for item in node.decorator_list)])
                code.functions.append(((node.end_lineno or first) - first + 1, f"{node.name} in {name}"))
            elif isinstance(node, ast.ClassDef):
                functions = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
                bases = [base.id for base in node.bases if isinstance(base, ast.Name)]
                public = {item for item in functions if not item.startswith("_")}
                code.classes.append(Class(node.name, name, set(attributes(node)), public, bases))
            elif isinstance(node, (ast.Import, ast.ImportFrom)):
                used.update(folders_imported(node, package))
    by_name = {found.name: found for found in code.classes}
    for found in code.classes:
        waiting, seen = list(found.bases), {found.name}
        while waiting:
            base = by_name.get(waiting.pop())
            if base is not None and base.name not in seen:
                seen.add(base.name)
                found.data |= base.data
                found.public |= base.public
                waiting += base.bases
    return code


def folders_imported(node: ast.Import | ast.ImportFrom, package: Path) -> Iterator[str]:
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    else:
        start = ".".join(filter(None, ["contactvi" if node.level else "", node.module]))
        names = [f"{start}.{alias.name}" for alias in node.names]
    for name in names:
        top, *parts = name.split(".")
        if top != "contactvi" or not parts or parts[0] == "_core":
            continue
        yield (
            parts[0]
            if (package / parts[0]).is_dir()
            else "base"
            if (package / f"{parts[0]}.py").is_file()
            else "__init__"
        )


def folder_of(path: Path, root: Path) -> str:
    """Return the folder of a file; "base" for modules beside the folders, "__init__" for the public names."""
    parts = path.relative_to(root).parts
    if len(parts) > 1:
        return parts[0]
    return "__init__" if path.name == "__init__.py" else "base"


# --- report -----------------------------------------------------------------------------------------------------------


def order(folders: Graph) -> tuple[list[str], list[str]]:
    """Return the folders from the lowest to the highest, and those that no order holds: they use each other."""
    left = {folder: {used for used in uses if used != folder and used in folders} for folder, uses in folders.items()}
    found: list[str] = []
    while free := sorted(folder for folder, uses in left.items() if uses <= set(found)):
        found += free
        left = {folder: uses for folder, uses in left.items() if folder not in free}
    return found, sorted(left)


def report(language: str, code: Code) -> None:
    low_to_high, circular = order(code.folders)
    arrows = sum(len(uses - {folder}) for folder, uses in code.folders.items())
    direction = f"circles among {', '.join(circular)}" if circular else "none upward"
    rows = [
        ("folders", f"{len(code.folders)}, {arrows} arrows between them, {direction}"),
        ("from low to high", " ".join(low_to_high) or "-"),
    ]
    for label, size in (
        ("most data members", lambda c: len(c.data)),
        ("most public functions", lambda c: len(c.public)),
    ):
        top = sorted(code.classes, key=size, reverse=True)[:3]
        rows.append((label, ", ".join(f"{c.name} {size(c)}" for c in top) + f" ({top[0].file})"))
    file = max(code.lines, key=lambda name: code.lines[name])
    lines, function = max(code.functions)
    rows += [("largest file", f"{file}, {code.lines[file]} lines"), ("largest function", f"{function}, {lines} lines")]
    print(f"{language}: {len(code.lines)} files, {sum(code.lines.values())} lines")
    for label, text in rows:
        print(f"  {label:<23}{text}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).parents[1], help="a checkout")
    root = parser.parse_args().root.resolve()
    if not (root / "contactvi").is_dir() or not (root / "core").is_dir():
        print(f"{root} is no checkout of contactvi: expected the folders contactvi and core", file=sys.stderr)
        return 2
    report("Python", read_python(root))
    report("C++", read_cpp(root))
    return 0


if __name__ == "__main__":
    sys.exit(main())
