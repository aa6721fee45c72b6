"""The folder graph of the code: what stands on the left may be used by what stands on the right, never the reverse.

Every import counts, wherever it stands (in a function, under TYPE_CHECKING, through import_module): a circle hidden
from the interpreter is still a circle. A new file belongs to the folder it stands in and needs no entry here; a new
folder does.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CORE = ROOT / "core"
MAX_COLUMNS = 120

# folder -> the folders it may use; what those may use it may use too. "base" are the modules beside the folders.
Folders = dict[str, tuple[str, ...]]

PYTHON_FOLDERS: Folders = {
    "_core": (),  # the compiled engine
    "base": (),
    "elements": ("base",),
    "records": ("base",),
    "importing": ("elements", "_core"),
    "scene": ("importing", "_core"),
    "playback": ("scene", "records"),
    "trajectory": ("playback",),
    "simulation": ("trajectory",),
    "batch": ("simulation",),
    "simultaneous": ("trajectory", "_core"),
    "bench": ("simulation",),
    "derivatives": ("simulation",),
    "reproduce": ("simulation",),
    "verify": ("reproduce", "simultaneous"),
    "commands": ("bench", "reproduce", "verify", "public"),
    "public": (
        "simulation",
        "simultaneous",
        "derivatives",
        "batch",
    ),  # contactvi/__init__.py, which names what is public
    "control": ("derivatives", "batch"),
    "crocoddyl": ("control",),
    "gym": ("simulation",),
    "adapters": ("control",),
}
# Modules beside the folders that connect contactvi to another package; nothing else uses them.
ADAPTERS = {"jax", "torch", "trep"}

CPP_FOLDERS: Folders = {
    "base": (),
    "lanes": (),
    "cone": ("base",),
    "model": ("base", "lanes"),
    "step": ("model",),
    "geometry": ("model",),
    "record": ("base",),
    "event": ("step", "geometry"),
    "contact": ("step", "geometry", "cone"),
    "impact": ("event", "contact", "record"),
    "run": ("impact",),
    "sensitivity": ("impact",),
    "bindings": ("run", "sensitivity"),
}
# A saved run is read and shown without the compiled engine: only these modules load it when they run. The types of its
# stub may be named anywhere, under TYPE_CHECKING.
USERS_OF_THE_ENGINE = {
    "importing.engine_model",
    "importing.hulls",
    "importing.mesh_distance",
    "importing.mesh_solids",
    "scene.engine",
    "scene.build",
    "simulation.engine",
    "batch.engine",
    "simulation.compatibility",
    "derivatives.linear",
    "trajectory.sensitivity",
}

# A header found by one of these names belongs to Python or to a parser: neither has a place in the engine.
PYTHON_HEADERS = re.compile(r"^(nanobind/|pybind11/|boost/python|Python\.h|numpy/)")
PARSER_HEADERS = re.compile(r"^(pinocchio/parsers/|urdf)")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.MULTILINE)


def python_root() -> Path:
    """The package's source; the installed package where the tests were copied away from it."""
    source = ROOT / "contactvi"
    if source.is_dir():
        return source
    import contactvi

    return Path(contactvi.__file__).parent


def reachable(folders: Folders, folder: str) -> set[str]:
    """The folders that `folder` may use, itself included."""
    return {folder}.union(*(reachable(folders, below) for below in folders[folder]))


# --- what uses what: unit -> units, where a unit is "folder.file" -----------------------------------------------------


def folder_of(unit: str) -> str:
    return unit.partition(".")[0]


def cpp_files() -> list[Path]:
    return sorted(path for path in CORE.rglob("*") if path.suffix in {".hpp", ".cpp"})


def cpp_unit(path: Path) -> str:
    """A header and its source are one unit."""
    folder, *rest = path.relative_to(CORE).with_suffix("").parts
    return ".".join([folder, *rest])


def cpp_includes(path: Path) -> list[tuple[str, str]]:
    """(bracket, header) of each include of a file."""
    return INCLUDE.findall(path.read_text())


def cpp_uses() -> dict[str, set[str]]:
    uses: dict[str, set[str]] = {}
    for path in cpp_files():
        unit = cpp_unit(path)
        own = uses.setdefault(unit, set())
        for bracket, header in cpp_includes(path):
            target = next((f for f in (path.parent / header, CORE / header) if f.is_file()), None)
            if target is not None:
                own.add(cpp_unit(target.resolve()))
            else:
                assert bracket == "<", f'{path.name}: #include "{header}" is no file of core/; use <> for libraries'
    return {unit: found - {unit} for unit, found in uses.items()}


def imported_names(node: ast.AST) -> Iterator[str]:
    """What one statement or call imports, as dotted names; `from a import b` is a.b, which may be a module or not."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = ".".join(filter(None, ["contactvi" if node.level else "", node.module]))
        yield from (f"{base}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
        function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        name = node.args[0].value
        if function in {"import_module", "__import__"} and isinstance(name, str):
            yield f"contactvi{name}" if name.startswith(".") else name


def python_unit(parts: tuple[str, ...], root: Path) -> str:
    """The unit of a dotted name below contactvi: the longest beginning that is a module, else the public names."""
    if parts[:1] == ("_core",):
        return "_core"
    if parts == ("__main__",):  # `python -m contactvi`, the command line
        return "commands.__main__"
    if parts and (root / f"{parts[0]}.py").is_file():
        return f"{'adapters' if parts[0] in ADAPTERS else 'base'}.{parts[0]}"
    for count in range(len(parts), 0, -1):
        place = root.joinpath(*parts[:count])
        if count > 1 and place.with_suffix(".py").is_file():
            return ".".join(parts[:count])
        if place.is_dir():
            return ".".join([*parts[:count], "__init__"])
    return "public"


def for_types_only(tree: ast.AST) -> set[ast.AST]:
    """The statements below `if TYPE_CHECKING:`, which are not run."""
    guarded: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            guarded.update(below for statement in node.body for below in ast.walk(statement))
    return guarded


def python_uses(types: bool = True) -> dict[str, set[str]]:
    """What uses what; without `types` only what is imported when the code runs."""
    root = python_root()
    uses: dict[str, set[str]] = {"_core": set(), "public": set()}
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        unit = "public" if parts == ("__init__",) else python_unit(parts, root)
        own = uses.setdefault(unit, set())
        tree = ast.parse(path.read_text())
        skipped = set() if types else for_types_only(tree)
        for node in ast.walk(tree):
            for name in imported_names(node) if node not in skipped else ():
                package, *rest = name.split(".")
                if package == "contactvi":
                    own.add(python_unit(tuple(rest), root))
        own.discard(unit)
    return uses


def check_folders(uses: dict[str, set[str]], folders: Folders, table: str) -> None:
    units = set(uses) | set().union(*uses.values())
    unlisted = sorted({folder_of(unit) for unit in units} - set(folders))
    assert not unlisted, f"{unlisted}: no such folder in {table} of tests/test_layers.py; add it with what it may use"
    gone = sorted(set(folders) - {folder_of(unit) for unit in units})
    assert not gone, f"{gone}: listed in {table} of tests/test_layers.py, but there is no such folder"
    wrong = [
        f"{unit} uses {used}"
        for unit in sorted(uses)
        for used in sorted(uses[unit])
        if folder_of(used) not in reachable(folders, folder_of(unit))
    ]
    assert not wrong, f"against the direction of {table}:\n" + "\n".join(wrong)


def find_circle(uses: dict[str, set[str]]) -> list[str]:
    """One circle of the graph as a list of units, empty where there is none."""
    done: set[str] = set()

    def visit(unit: str, path: list[str]) -> list[str]:
        if unit in path:
            return [*path[path.index(unit) :], unit]
        if unit in done:
            return []
        for used in sorted(uses.get(unit, set())):
            if circle := visit(used, [*path, unit]):
                return circle
        done.add(unit)
        return []

    return next((circle for unit in sorted(uses) if (circle := visit(unit, []))), [])


def between_folders(uses: dict[str, set[str]]) -> dict[str, set[str]]:
    """The same graph with folders as units."""
    found: dict[str, set[str]] = {}
    for unit, used in uses.items():
        found.setdefault(folder_of(unit), set()).update(map(folder_of, used))
    return {folder: used - {folder} for folder, used in found.items()}


def test_cpp_folders_point_left():
    check_folders(cpp_uses(), CPP_FOLDERS, "CPP_FOLDERS")


def test_python_folders_point_left():
    check_folders(python_uses(), PYTHON_FOLDERS, "PYTHON_FOLDERS")


@pytest.mark.parametrize("uses", [cpp_uses, python_uses])
def test_no_circles(uses):
    """Neither between folders nor between the files of one."""
    for graph in (between_folders(uses()), uses()):
        circle = find_circle(graph)
        assert not circle, "circle: " + " -> ".join(circle)


def test_replay_needs_no_engine():
    users = {unit for unit, used in python_uses(types=False).items() if "_core" in used}
    assert users == USERS_OF_THE_ENGINE, "a saved run is read and shown without the compiled engine"


def test_no_module_reaches_into_another():
    """`from contactvi.x import _name` takes what its owner keeps to itself."""
    wrong = []
    for path in sorted(python_root().rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("contactvi"):
                private = [a.name for a in node.names if a.name.startswith("_") and a.name not in {"_core"}]
                wrong += [f"{path.name}: {node.module}.{name}" for name in private if not name.startswith("__")]
    assert not wrong, "\n".join(wrong)


def private_names(tree: ast.AST) -> set[str]:
    """The underscore names that a file itself gives to attributes: methods, class variables, self._name = ..."""
    found = {node.name for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and is_own(node.value):
            found.add(node.attr)
        elif isinstance(node, ast.ClassDef):
            targets = [t for s in node.body for t in getattr(s, "targets", [getattr(s, "target", None)])]
            found.update(target.id for target in targets if isinstance(target, ast.Name))
    return found


def is_own(value: ast.AST) -> bool:
    """Whether an object is that of the method at hand: self, cls or super()."""
    if isinstance(value, ast.Call):
        value = value.func
    return isinstance(value, ast.Name) and value.id in {"self", "cls", "super"}


def reaches(tree: ast.AST) -> set[str]:
    """Accesses `something._name` of a file that gives no attribute this name; methods may look into their like."""
    known = private_names(tree)
    return {
        ast.unparse(node)
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr.startswith("_")
        and not node.attr.startswith("__")
        and node.attr not in known
        and not is_own(node.value)
    }


def test_no_module_uses_private_attributes_of_another():
    """An attribute `_name` belongs to the file that defines it; what others need of it has a public name."""
    wrong = []
    for path in sorted(python_root().rglob("*.py")):
        unit = python_unit(path.relative_to(python_root()).with_suffix("").parts, python_root())
        wrong += [f"{unit}: {access}" for access in sorted(reaches(ast.parse(path.read_text())))]
    assert not wrong, "\n".join(wrong)


def test_core_knows_neither_python_nor_parsers():
    wrong = [
        f"core/{path.relative_to(CORE)} includes <{header}>"
        for path in cpp_files()
        for _, header in cpp_includes(path)
        if PARSER_HEADERS.match(header) or (PYTHON_HEADERS.match(header) and folder_of(cpp_unit(path)) != "bindings")
    ]
    assert not wrong, "Python belongs into core/bindings only, parsing into contactvi/:\n" + "\n".join(wrong)


def defined_names(text: str) -> set[str]:
    """The constants and types defined at the beginning of a line. Functions may have equal names, as overloads."""
    found = set(re.findall(r"^(?:struct|class|enum class) (\w+)", text, re.MULTILINE))
    for constants in re.findall(r"^(?:inline )?constexpr [^;]*;", text, re.MULTILINE):
        found.update(re.findall(r"\b(k[A-Z]\w*)(?:\[\w*\])? *[={]", constants))
    return found


def hidden_names(text: str) -> set[str]:
    """Those of a file's anonymous namespaces."""
    hidden = re.findall(r"^namespace \{$(.*?)^\}  // namespace$", text, re.MULTILINE | re.DOTALL)
    return set().union(*map(defined_names, hidden))


def test_hidden_names_are_there_once_in_a_folder():
    """Up to CONTACTVI_TOGETHER files of a folder are compiled as one (core/CMakeLists.txt), with all their headers."""
    owners: dict[tuple[str, str], list[str]] = {}
    for path in cpp_files():
        folder = folder_of(cpp_unit(path))
        if folder == "lanes":  # each of its files is compiled alone
            continue
        if path.suffix == ".cpp":
            for name in hidden_names(path.read_text()):
                owners.setdefault((folder, name), []).append(path.name)
        else:
            for user in (user for user in CPP_FOLDERS if folder in reachable(CPP_FOLDERS, user)):
                for name in defined_names(path.read_text()):
                    owners.setdefault((user, name), []).append(path.name)
    twice = [
        f"core/{folder}: {name} in {files}"
        for (folder, name), files in owners.items()
        if len(files) > 1 and any(file.endswith(".cpp") for file in files)
    ]
    assert not twice, "share one in a header, or name them apart:\n" + "\n".join(twice)


def test_lines_are_short():
    """clang-format leaves comments alone; ruff watches the lines of Python."""
    wide = [
        f"{path.relative_to(CORE)}:{number}"
        for path in cpp_files()
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if len(line) > MAX_COLUMNS
    ]
    assert not wide, f"longer than {MAX_COLUMNS} columns:\n" + "\n".join(wide)


def test_the_checks_can_fail():
    """A wrong direction, an unlisted folder and a circle are each found: the tests above are no empty gates."""
    folders: Folders = {"low": (), "high": ("low",)}
    check_folders({"low.a": set(), "high.b": {"low.a"}}, folders, "folders")
    with pytest.raises(AssertionError, match=r"low\.a uses high\.b"):
        check_folders({"low.a": {"high.b"}, "high.b": set()}, folders, "folders")
    with pytest.raises(AssertionError, match="no such folder in"):
        check_folders({"low.a": set(), "high.b": set(), "other.c": set()}, folders, "folders")
    with pytest.raises(AssertionError, match="there is no such folder"):
        check_folders({"low.a": set()}, folders, "folders")
    hidden = "namespace {\nconstexpr int kA = 1, kB[2] = {kC, 2};\nstruct D {\n};\n}  // namespace\nstruct E {};"
    assert hidden_names(hidden) == {"kA", "kB", "D"}
    assert find_circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    assert between_folders({"low.a": {"high.b"}, "high.b": {"low.c"}}) == {"low": {"high"}, "high": {"low"}}
    hidden = (
        "def f():\n    from .playback.viewer import view\n    importlib.import_module('.commands.cli', 'contactvi')"
    )
    found = {name for node in ast.walk(ast.parse(hidden)) for name in imported_names(node)}
    assert found == {"contactvi.playback.viewer.view", "contactvi.commands.cli"}
    typed = ast.parse("if TYPE_CHECKING:\n    from contactvi import _core\nelse:\n    from contactvi import errors")
    skipped = {name for node in for_types_only(typed) for name in imported_names(node)}
    assert skipped == {"contactvi._core"}
    assert python_unit(("playback", "viewer", "view"), python_root()) == "playback.viewer"
    own = "class A:\n    _kind = 1\n    def f(self, a):\n        self._x = a._x = a._kind\n        return a._y, self._z"
    assert reaches(ast.parse(own)) == {"a._y"}
