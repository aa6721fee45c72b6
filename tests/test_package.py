"""The package as it is installed: what importing it costs, its version, the libraries that its module loads."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import contactvi
from contactvi import _core

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path(contactvi.__file__).resolve().parent
# .ci/run sets it where the installed package must be the one under test.
MUST_BE_INSTALLED = "CONTACTVI_TEST_INSTALLED" in os.environ
IMPORT_LIMIT = 0.5  # [s], the bar of the project
STUB_COMMAND = "python -m nanobind.stubgen -m contactvi._core -o contactvi/_core.pyi"


def run_python(code: str, folder: Path) -> Any:
    """What `code` leaves in `answer`, run by a fresh interpreter in `folder` with this package and no other help."""
    environment = {key: value for key, value in os.environ.items() if key not in {"LD_LIBRARY_PATH", "LD_PRELOAD"}}
    environment["PYTHONPATH"] = str(PACKAGE.parent)
    program = f"{code}\nimport json\nprint(json.dumps(answer))"
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout.splitlines()[-1])


@pytest.fixture
def distribution() -> importlib.metadata.Distribution:
    """The installed distribution; a module built in place needs none."""
    try:
        return importlib.metadata.distribution("contactvi")
    except importlib.metadata.PackageNotFoundError:
        assert not MUST_BE_INSTALLED, "contactvi is not installed"
        pytest.skip("contactvi is built in place, not installed")


def test_import_is_quick(tmp_path):
    code = """
import time
start = time.perf_counter()
import contactvi
answer = time.perf_counter() - start
"""
    # The best of several: the others measure a cold disk or a busy machine.
    times = [run_python(code, tmp_path) for _ in range(5)]
    assert min(times) < IMPORT_LIMIT, times


@pytest.mark.parametrize("names", ["", "Scene load_scene simulate Simulator Trajectory Options errors"])
def test_import_brings_no_pictures(names, tmp_path):
    code = f"""
import sys
import contactvi
for name in {names.split()}:
    getattr(contactvi, name)
answer = [module for module in ("meshcat", "matplotlib") if module in sys.modules]
"""
    assert run_python(code, tmp_path) == []


def test_files_of_a_run_need_no_scipy(tmp_path):
    """Importing it would take longer than writing the page and the record of a short run."""
    code = """
import sys
import contactvi
scene = contactvi.Scene()
scene.add_halfspace()
scene.add_box("box", size=(0.1, 0.1, 0.1), mass=1.0, placement=(0, 0, 0.05))
traj = contactvi.simulate(scene, dt=0.01, duration=0.1)
traj.save("run.npz")
traj.to_html("run.html")
answer = sorted({name.partition(".")[0] for name in sys.modules} & {"scipy", "meshcat", "matplotlib"})
"""
    assert run_python(code, tmp_path) == []


def test_numpy_is_loaded_before_coal(tmp_path):
    """The module of coal crashes where Ctrl-C stops the import of NumPy that it makes itself."""
    code = """
import sys
import contactvi
before = 'numpy' in sys.modules
contactvi.Scene
names = list(sys.modules)
answer = [before, names.index('numpy') < names.index('coal')]
"""
    assert run_python(code, tmp_path) == [False, True]


def test_version_is_that_of_the_metadata(distribution):
    assert contactvi.__version__ == distribution.version
    declared = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert declared is not None
    assert distribution.version == declared.group(1)


def test_one_copy_of_the_libraries(tmp_path):
    """The module finds coal's library by itself, and shares it with `coal` and `pinocchio` imported afterwards.

    Of Pinocchio it loads nothing.
    """
    code = """
import os
from contactvi import _core
def loaded():
    lines = open(f"/proc/{os.getpid()}/maps").read().splitlines()
    names = ("libpinocchio_default.so", "libcoal.so")
    return sorted({line.split()[-1] for line in lines if line.endswith(names)})
alone = loaded()
import coal, pinocchio
answer = {"alone": alone, "together": loaded(), "pinocchio": pinocchio.__file__}
"""
    answer = run_python(code, tmp_path)
    assert [Path(path).name for path in answer["alone"]] == ["libcoal.so"]
    assert [Path(path).name for path in answer["together"]] == ["libcoal.so", "libpinocchio_default.so"]
    assert answer["together"][0] == answer["alone"][0]
    prefix = next(parent for parent in Path(answer["pinocchio"]).parents if parent.name == "cmeel.prefix")
    assert {Path(path).parent for path in answer["alone"]} == {prefix / "lib"}


def test_installed_module_is_relocatable(distribution):
    """The search path is relative to the module, and nothing of the machine that built it is left in it."""
    module = Path(_core.__file__).read_bytes()
    if PACKAGE.parent != Path(str(distribution.locate_file(""))).resolve():
        assert not MUST_BE_INSTALLED, f"tested {PACKAGE}, not the installed package"
        pytest.skip("contactvi is built in place, not installed")
    assert b"$ORIGIN/../cmeel.prefix/lib\0" in module
    assert b"cmeel.prefix/lib:" not in module


def test_built_for_the_libraries_at_hand(distribution):
    """Build and run time name the same coal: its ABI carries no version."""
    declared = (ROOT / "pyproject.toml").read_text()
    build, _, rest = declared.partition("[project]")
    built = re.search(r'"libcoal\[build\]==([\d.]+)"', build)
    assert built is not None
    for package in ("coal", "libcoal"):
        assert f'"{package}=={built.group(1)}"' in rest
        assert importlib.metadata.version(package) == built.group(1)
    pinned = re.search(r'"pin==([\d.]+)"', rest)
    assert pinned is not None
    assert importlib.metadata.version("pin") == pinned.group(1)
    assert {"pin", "coal", "numpy"} <= {re.split(r"[^\w-]", line)[0] for line in distribution.requires or []}


def test_stub_is_current(tmp_path):
    """contactvi/_core.pyi is written from the compiled module, and is reviewed like code."""
    stub = PACKAGE / "_core.pyi"
    assert stub.is_file(), f"no {stub.name}: write it with `{STUB_COMMAND}`"
    fresh = tmp_path / "_core.pyi"
    command = [sys.executable, "-m", "nanobind.stubgen", "-q", "-m", "contactvi._core", "-o", str(fresh)]
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)
    assert fresh.read_text() == stub.read_text(), f"_core.pyi is stale: write it with `{STUB_COMMAND}`"
    assert (PACKAGE / "py.typed").is_file()
