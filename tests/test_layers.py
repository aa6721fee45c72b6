"""The import direction of the code: what stands left may be used by what stands right, never the reverse.

Every import counts, wherever it stands (in a function, under TYPE_CHECKING, through import_module): a cycle hidden
from the interpreter is still a cycle. Where a file belongs is written down below; a new file is added to its layer.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CORE = ROOT / "core"
MAX_FILE_LINES = 400
MAX_COLUMNS = 120

# layer -> (its units, the layers it may use; what those may use it may use too)
Layers = dict[str, tuple[tuple[str, ...], tuple[str, ...]]]

# C++: a unit is a header with its source (core/NAME.hpp, core/NAME.cpp); core/bindings/ and core/lanes/ are one each.
CPP_LAYERS: Layers = {
    "base": (("error", "numerics", "gauss", "lanes", "aligned_array", "reduction"), ()),
    "cone": (
        ("cone_problem", "cone_map", "cone_linear", "cone_newton", "cone_local", "cone_fallback", "cone"),
        ("base",),
    ),
    "scene": (
        (
            *("elements", "tree", "coordinates", "placement", "point_row", "forces", "constraints"),
            *("flat_model", "erosion", "load", "scene"),
        ),
        ("base",),
    ),
    "path": (("path",), ("scene",)),
    "step": (
        (
            *("stepper", "stages", "stage_forces", "start_values", "acceleration", "stiff_terms"),
            *("integrator", "integrator_kicked", "integrator_sums", "energy", "projection"),
        ),
        ("path",),
    ),
    "contact": (("contact",), ("scene",)),
    "manifold": (("outline", "candidates", "selection", "manifold", "manifold_point"), ("contact",)),
    "guard": (("guard",), ("manifold",)),
    "event": (("gap_path", "event", "event_locate"), ("guard", "step")),
    "impact": (("impact", "impact_ctec", "impact_dtec", "impact_mhc"), ("step",)),
    "held": (("held_contact", "held_step", "held_rows", "held_end", "held_forces"), ("guard", "step", "cone")),
    "recording": (("recording",), ("base",)),
    "sequence": (("impact_block", "impact_closed", "impact_sequence"), ("event", "impact", "held", "recording")),
    "simulator": (("simulator", "drive", "snapshot", "lasting", "contact_book", "arcs"), ("sequence",)),
    "bindings": (("bindings",), ("simulator", "cone")),
}

# Python: a unit is a module of contactvi. `_core` is the compiled engine.
PYTHON_LAYERS: Layers = {
    "engine": (("_core",), ()),
    "base": (
        (
            *("errors", "version", "files", "inputs", "checks", "option_checks", "options", "status", "events"),
            *("contacts", "user_functions", "signals", "forces"),
        ),
        (),
    ),
    "model": (("paths", "report", "xml_input", "urdf", "mjcf_equality", "mjcf", "hulls", "model_checks"), ("base",)),
    "scene": (
        (
            *("parts", "importers", "assembly", "pairs", "joint_values", "joints", "contact_rules", "selection"),
            *(
                "elements",
                "file_constraints",
                "element_build",
                "loops",
                "scene_build",
                "scene_data",
                "scene_parts",
                "scene_elements",
            ),
            *("scene_report", "scene", "scene_file_elements", "scene_file"),
        ),
        ("model", "engine"),
    ),
    "prepared": (("derivative_check", "prepared"), ("scene",)),
    "page": (("visuals", "animation", "lines", "force_arrows", "shapes", "page"), ("scene",)),
    "trajectory": (
        ("dense", "contact_ledger", "ledger", "storage_entries", "storage", "trajectory"),
        ("page", "prepared"),
    ),
    "progress": (("progress",), ("base",)),
    "simulation": (
        (
            *("map_checks", "endings", "ledger_watch", "record", "engine", "auto_step", "targets"),
            *("simulator", "simulation", "sensors"),
        ),
        ("trajectory", "progress"),
    ),
    "simultaneous": (("impact_sequences", "closed_contacts", "simultaneous"), ("prepared",)),
    "pictures": (("viewer", "plots"), ("trajectory",)),
    "face": (("__init__",), ("simulation", "simultaneous", "pictures", "prepared")),
    "bench": (("bench_runs", "bench", "bench_report"), ("simulation",)),
    "reproduce": (
        (
            *("reproduce_row", "reproduce_model", "reproduce_reference", "reproduce_laws", "reproduce_runs"),
            *("reproduce_figures", "reproduce_report", "reproduce"),
        ),
        ("simulation",),
    ),
    "verify": (
        (
            *("verify_check", "verify_model", "verify_cases_impact", "verify_cases_several", "verify_cases_contact"),
            *("verify_model_forced", "verify_cases_forced", "verify_cases_loops"),
            "verify",
        ),
        ("reproduce", "simultaneous"),
    ),
    "cli": (("run_summary", "cli"), ("face", "bench", "reproduce", "verify")),
}
USERS_OF_THE_ENGINE = {"scene", "scene_build", "engine"}

# A header found by one of these names belongs to Python or to a parser: neither has a place in the engine.
PYTHON_HEADERS = re.compile(r"^(nanobind/|pybind11/|boost/python|Python\.h|numpy/)")
PARSER_HEADERS = re.compile(r"^(pinocchio/parsers/|urdf)")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.MULTILINE)


def python_folder() -> Path:
    """The package's source; the installed package where the tests were copied away from it."""
    source = ROOT / "contactvi"
    if source.is_dir():
        return source
    import contactvi

    return Path(contactvi.__file__).parent


def layer_of(layers: Layers) -> dict[str, str]:
    return {unit: layer for layer, (units, _) in layers.items() for unit in units}


def reachable(layers: Layers, layer: str) -> set[str]:
    """The layers that `layer` may use, itself included."""
    found = {layer}
    for below in layers[layer][1]:
        found |= reachable(layers, below)
    return found


def cpp_files() -> list[Path]:
    return sorted(path for path in CORE.rglob("*") if path.suffix in {".hpp", ".cpp"})


def cpp_unit(path: Path) -> str:
    """`core/bindings/*` and `core/lanes/*` are one unit each, else the name without its ending."""
    parts = path.relative_to(CORE).parts
    return parts[0] if len(parts) > 1 else path.stem


def cpp_includes(path: Path) -> list[tuple[str, str]]:
    """(bracket, header) of each include of a file."""
    return INCLUDE.findall(path.read_text())


def cpp_uses() -> dict[str, set[str]]:
    """unit -> units of core/ whose header it includes."""
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
    """What one statement or call imports, as dotted names: `contactvi`, `contactvi.NAME`, `numpy`, ..."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = ".".join(filter(None, ["contactvi" if node.level else "", node.module]))
        # `from . import a` names modules (or names of __init__); `from .a import f` names the module a.
        yield from (f"{base}.{alias.name}" for alias in node.names) if base == "contactvi" else (base,)
    elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
        function = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        name = node.args[0].value
        if function in {"import_module", "__import__"} and isinstance(name, str):
            yield f"contactvi{name}" if name.startswith(".") else name


def python_uses() -> dict[str, set[str]]:
    """module -> modules of contactvi that it imports; `from contactvi import name` uses __init__."""
    known = set(layer_of(PYTHON_LAYERS))
    uses: dict[str, set[str]] = {"_core": set()}
    for path in sorted(python_folder().glob("*.py")):
        own = uses.setdefault(path.stem, set())
        for node in ast.walk(ast.parse(path.read_text())):
            for name in imported_names(node):
                package, _, rest = name.partition(".")
                module = rest.partition(".")[0]
                if package == "contactvi":
                    own.add(module if module in known or (path.parent / f"{module}.py").is_file() else "__init__")
        own.discard(path.stem)
    return uses


def check_layers(uses: dict[str, set[str]], layers: Layers, table: str) -> None:
    layer = layer_of(layers)
    unlisted = sorted((set(uses) | set().union(*uses.values())) - set(layer))
    assert not unlisted, f"{unlisted}: in no layer. Add each to its layer in {table} of tests/test_layers.py"
    gone = sorted(set(layer) - set(uses))
    assert not gone, f"{gone}: listed in {table} of tests/test_layers.py, but there is no such file"
    wrong = [
        f"{unit} (layer {layer[unit]}) uses {used} (layer {layer[used]})"
        for unit in sorted(uses)
        for used in sorted(uses[unit])
        if layer[used] not in reachable(layers, layer[unit])
    ]
    assert not wrong, f"against the import direction of {table}:\n" + "\n".join(wrong)


def find_cycle(uses: dict[str, set[str]]) -> list[str]:
    """One cycle of the graph as a list of units, empty where there is none."""
    done: set[str] = set()

    def visit(unit: str, path: list[str]) -> list[str]:
        if unit in path:
            return [*path[path.index(unit) :], unit]
        if unit in done:
            return []
        for used in sorted(uses.get(unit, set())):
            if cycle := visit(used, [*path, unit]):
                return cycle
        done.add(unit)
        return []

    return next((cycle for unit in sorted(uses) if (cycle := visit(unit, []))), [])


def test_cpp_includes_point_left():
    check_layers(cpp_uses(), CPP_LAYERS, "CPP_LAYERS")


def test_python_imports_point_left():
    check_layers(python_uses(), PYTHON_LAYERS, "PYTHON_LAYERS")


def test_replay_needs_no_engine():
    users = {unit for unit, used in python_uses().items() if "_core" in used}
    assert users <= USERS_OF_THE_ENGINE, "a saved run is read and shown without the compiled engine"


@pytest.mark.parametrize("uses", [cpp_uses, python_uses])
def test_no_cycles(uses):
    cycle = find_cycle(uses())
    assert not cycle, "import cycle: " + " -> ".join(cycle)


def test_core_knows_neither_python_nor_parsers():
    wrong = [
        f"core/{path.relative_to(CORE)} includes <{header}>"
        for path in cpp_files()
        for _, header in cpp_includes(path)
        if PARSER_HEADERS.match(header) or (PYTHON_HEADERS.match(header) and cpp_unit(path) != "bindings")
    ]
    assert not wrong, "Python belongs into core/bindings only, parsing into contactvi/:\n" + "\n".join(wrong)


def test_python_package_is_flat():
    nested = [str(path) for path in python_folder().rglob("*.py") if path.parent != python_folder()]
    assert not nested, f"{nested}: contactvi is one flat package; the layers above name modules, not folders"


def test_files_and_lines_are_short():
    folders = [python_folder(), CORE, *(ROOT / name for name in ("tests", "examples", "benchmarks"))]
    paths = [path for folder in folders for path in folder.rglob("*") if path.suffix in {".py", ".hpp", ".cpp"}]
    lines = {path: path.read_text().splitlines() for path in paths}
    long = {str(path): len(text) for path, text in lines.items() if len(text) > MAX_FILE_LINES}
    assert not long, f"more than {MAX_FILE_LINES} lines, is it two concepts? {long}"
    # clang-format leaves comments alone; ruff watches the lines of Python.
    wide = [f"{p}:{n}" for p in paths for n, line in enumerate(lines[p], 1) if len(line) > MAX_COLUMNS]
    assert not wide, f"longer than {MAX_COLUMNS} columns:\n" + "\n".join(wide)


def test_the_checks_can_fail():
    """A wrong direction, an unlisted file and a cycle are each found: the tests above are no empty gates."""
    layers: Layers = {"low": (("a",), ()), "high": (("b",), ("low",))}
    check_layers({"a": set(), "b": {"a"}}, layers, "layers")
    with pytest.raises(AssertionError, match="a .layer low. uses b"):
        check_layers({"a": {"b"}, "b": set()}, layers, "layers")
    with pytest.raises(AssertionError, match="in no layer"):
        check_layers({"a": set(), "b": set(), "c": set()}, layers, "layers")
    assert find_cycle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]
    hidden = "def f():\n    from .viewer import show\n    importlib.import_module('.cli', 'contactvi')"
    found = {name for node in ast.walk(ast.parse(hidden)) for name in imported_names(node)}
    assert found == {"contactvi.viewer", "contactvi.cli"}
