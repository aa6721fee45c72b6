"""Instruction sets: the same trajectories to the last bit on each of them, switching, and what the objects export."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from batteries.models import CASES, case
from contactvi.errors import EngineError
from helpers import contact_models, map_runs
from helpers.engine import core_scene, simulator
from helpers.gauss_laws import EVERY_ORDER, extra_of

CORE = Path(__file__).resolve().parents[3] / "core"


@pytest.fixture
def sets():
    """Names usable on this machine; afterwards the old one is in use again."""
    from contactvi import _core

    before = _core.instruction_set()
    yield _core.instruction_sets()
    _core.instruction_set(before)


def on_each(names: list[str], run) -> list[dict[str, np.ndarray]]:
    """What `run` gives with engines of each instruction set."""
    from contactvi import _core

    if len(names) == 1:
        pytest.skip(f"this machine has {names} only")
    results = []
    for name in names:
        assert _core.instruction_set(name) == name
        results.append(run())
    return results


def assert_bitwise_equal(results: list[dict[str, np.ndarray]]) -> None:
    for other in results[1:]:
        for key, array in results[0].items():
            assert array.shape == other[key].shape, key
            assert array.tobytes() == other[key].tobytes(), (key, np.abs(array - other[key]).max())


# --- switching ----------------------------------------------------------------------------------------------------
def test_names_and_switching(sets):
    from contactvi import _core

    assert sets[0] == "base"
    assert set(sets) <= {"base", "avx2", "avx512"}
    for name in sets:
        assert _core.instruction_set(name) == name
        assert _core.instruction_set() == name


def test_unknown_name_is_refused_and_changes_nothing(sets):
    from contactvi import _core

    _core.instruction_set(sets[-1])
    with pytest.raises(EngineError, match="sse9"):
        _core.instruction_set("sse9")
    assert _core.instruction_set() == sets[-1]


@pytest.mark.parametrize("name", ["base", "", "sse9"])
def test_environment_chooses_the_first(sets, name, tmp_path):
    code = "from contactvi import _core; print(_core.instruction_set())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,  # the source root would shadow the installed package
        env={
            **os.environ,
            "CONTACTVI_INSTRUCTION_SET": name,
            "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        },
        capture_output=True,
        text=True,
    )
    if name == "sse9":
        assert done.returncode != 0
        assert "EngineError: The environment variable CONTACTVI_INSTRUCTION_SET" in done.stderr
        assert f"expected one of {', '.join(sets)}, got '{name}'. Unset CONTACTVI_INSTRUCTION_SET" in done.stderr
    else:
        assert done.stdout.strip() == (name or sets[-1]), done.stderr


# --- bits -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_steps_are_bitwise_equal(sets, case):
    """Three steps at each order, with springs, damping and input."""
    model = case.model()
    extra = extra_of(case.name, model, True, True)
    q0, v0 = case.state(model)
    tau = 0.1 * np.random.default_rng(1).uniform(-1, 1, model.nv)

    def run():
        scene, out = core_scene(model, **extra), {}
        for order in EVERY_ORDER:
            q, p = q0, scene.momentum(q0[None], v0[None])[0]
            for k in range(3):
                q, p, v, *_ = scene.step(q, p, 2 * case.h, tau, 1e-12, order)
                out |= {f"q {order} {k}": q, f"p {order} {k}": p, f"v {order} {k}": v}
        return out

    assert_bitwise_equal(on_each(sets, run))


@pytest.mark.parametrize(
    "name", ["double_pendulum", "free_body", "joint_planar", "joint_helical_x", "forest", "allegro"]
)
@pytest.mark.parametrize("order", [2, 4, 6, 16])
def test_runs_are_bitwise_equal(sets, name, order):
    """Through the event loop, where each step starts from the last one's polynomial."""
    c = case(name)
    model = c.model()
    q, v = c.state(model)
    extra = extra_of(name, model, True, False)

    def run():
        run = simulator(core_scene(model, **extra), 2 * c.h, order=order)
        assert run.reset(q, v, 0.0)["code"] == 0
        result = run.advance(100, None, 1, None)
        assert result["code"] == 0, result["message"]
        return {k: result[k] for k in ("t", "q", "p")}

    assert_bitwise_equal(on_each(sets, run))


@pytest.mark.parametrize("name", ["double_pendulum", "joint_helical_x", "allegro"])
def test_columns_are_solved_with_the_mass_matrix(name):
    """M^-1 M = 1; the coordinates of these models are those of the engine."""
    from contactvi import _core

    model = case(name).model()
    q, _ = case(name).state(model)
    mass = pin.crba(model, model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    assert np.abs(_core.solve_masses(core_scene(model), q, mass) - np.eye(model.nv)).max() <= 1e-10


@pytest.mark.parametrize("name", ["free_body", "joint_planar", "joint_helical_x", "forest", "allegro"])
def test_columns_do_not_depend_on_each_other(sets, name):
    """Any number of columns, some of which act on a few trees only, has the bits of each column by itself."""
    from contactvi import _core

    model = case(name).model()
    q, _ = case(name).state(model)
    scene = core_scene(model)
    random = np.random.default_rng(2)
    right = random.uniform(-1.0, 1.0, (model.nv, 19))
    right[:, ::3] *= random.uniform(0.0, 1.0, model.nv)[:, None] < 0.2

    def run():
        out = {f"{m}": _core.solve_masses(scene, q, right[:, :m]) for m in (1, 2, 4, 5, 8, 9, 19)}
        alone = np.hstack([_core.solve_masses(scene, q, right[:, [k]]) for k in range(19)])
        for m, found in out.items():
            assert np.array_equal(found, alone[:, : int(m)])
        return out

    assert_bitwise_equal(on_each(sets, run))


def contact_run(scene, q, v, duration, h, method, order) -> dict[str, np.ndarray]:
    """Nodes and events of a run with at least two impacts."""
    result = map_runs.run(scene, q, v, duration, h, method, order=order)
    assert result.code == 0, result.message
    assert len(result.events) >= 2
    return {"t": result.t, "q": result.q, "p": result.p} | {k: np.asarray(a) for k, a in result.log.items()}


@pytest.mark.parametrize("method", map_runs.METHODS)
@pytest.mark.parametrize("order", [2, 4, 8])
def test_runs_with_impacts_are_bitwise_equal(sets, method, order):
    model, geometry = contact_models.room()
    q, v = contact_models.room_start(model, 1.0)

    def run():
        return contact_run(contact_models.scene(model, geometry, 0.8), q, v, 0.5, 0.01, method, order)

    assert_bitwise_equal(on_each(sets, run))


@pytest.mark.parametrize("method", map_runs.METHODS)
def test_hand_and_ball_are_bitwise_equal(sets, method):
    def run():
        scene, _, q = map_runs.hand_and_ball()
        return contact_run(scene, q, np.zeros(scene.model.nv), 0.3, 2e-3, method, 8)

    assert_bitwise_equal(on_each(sets, run))


# --- objects --------------------------------------------------------------------------------------------------------
def compile_options() -> dict[str, list[str]]:
    """Options of each source of core/lanes/ in core/CMakeLists.txt, by file name."""
    found: dict[str, list[str]] = {}
    text = re.sub(r"#.*", "", (CORE / "CMakeLists.txt").read_text())
    for block in re.findall(r"set_source_files_properties\((.*?)\)", text, re.DOTALL):
        files, _, rest = block.partition("PROPERTIES")
        for quoted in re.findall(r'COMPILE_(?:OPTIONS|FLAGS)\s+("[^"]*"|\S+)', rest):
            options = quoted.strip('"').replace(";", " ").split()
            for name in re.findall(r"(\w+\.cpp)", files):
                found.setdefault(name, []).extend(options)
    return found


def foreign_symbols(source: Path, options: list[str], folder: Path) -> tuple[list[str], list[str]]:
    """(weak symbols, exported symbols) of the object of a source, without optimization, so that nothing is inlined."""
    compiler, nm = shutil.which("c++") or shutil.which("g++"), shutil.which("nm")
    if not (compiler and nm):
        pytest.skip("no C++ compiler or no nm")
    target = folder / f"{source.stem}.o"
    subprocess.run(
        [compiler, "-std=c++17", "-O0", "-fPIC", *options, "-I", str(CORE), "-c", str(source), "-o", str(target)],
        check=True,
    )
    text = subprocess.run([nm, "-P", str(target)], check=True, capture_output=True, text=True).stdout
    symbols = [line.split()[:2] for line in text.splitlines()]
    weak = [name for name, kind in symbols if kind in "WwVvu"]
    return weak, [name for name, kind in symbols if kind.isupper() and kind not in "UWV"]


@pytest.mark.slow
def test_objects_export_one_c_symbol_and_nothing_weak(tmp_path):
    """A weak symbol compiled for AVX-512 may be the one the linker keeps, and crash an older machine."""
    sources = sorted((CORE / "lanes").glob("*.cpp"))
    if not sources:
        pytest.skip("the tests were copied without the engine's source")
    options = compile_options()
    for source in sources:
        flags = options.get(source.name, [])
        assert bool(flags) == ("avx" in source.name), f"{source.name}: {flags}"
        weak, exported = foreign_symbols(source, flags, tmp_path)
        assert not weak, f"{source.name}: weak symbols {weak}"
        assert len(exported) == 1, f"{source.name} exports {exported}"
        assert not exported[0].startswith("_Z"), f"{source.name}: {exported[0]} is not extern C"


def test_a_weak_symbol_is_found(tmp_path):
    source = tmp_path / "weak.cpp"
    source.write_text("inline int f(int x) { return x; }\nint g(int x) { return f(x); }\n")
    assert foreign_symbols(source, [], tmp_path) == (["_Z1fi"], ["_Z1gi"])
