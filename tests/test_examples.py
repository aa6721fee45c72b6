"""The examples and the README's code run as they stand, headless."""

from __future__ import annotations

import os
import pathlib
import re
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

pytestmark = pytest.mark.skipif(not EXAMPLES, reason="the tests were copied without the examples")


def run(arguments: list[str], folder: pathlib.Path) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=dict(os.environ, MPLBACKEND="agg", PYTHONPATH=os.pathsep.join(p for p in sys.path if p)),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_example_runs(path, tmp_path):
    assert run([str(path)], tmp_path).strip()
    assert len(path.read_text().splitlines()) <= 100


def readme_code() -> list[str]:
    """The README's Python: the first use, the impact maps, persistent contact, a linkage."""
    return re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)


def test_readme_code_runs(tmp_path):
    code, _, _, _ = readme_code()
    (tmp_path / "readme.py").write_text(code)
    printed = run(["readme.py"], tmp_path)
    assert "palm_link_0" in printed.splitlines()[-1]  # the ball hits the palm
    assert (tmp_path / "run.npz").stat().st_size > 0
    assert (tmp_path / "run.html").stat().st_size > 0


def test_readme_code_of_the_impact_maps_runs(tmp_path):
    """It prints the three jumps that the README gives."""
    _, maps, _, _ = readme_code()
    script = tmp_path / "maps.py"
    script.write_text(f"import contactvi as cvi\n{maps}")
    energy, discrete, modified = (abs(float(x)) for x in run([str(script)], ROOT).split())
    assert min(energy, discrete) > 1e-4
    assert modified < 1e-12


def test_readme_code_of_persistent_contact_runs(tmp_path):
    """The box touches down, stops, and its corners carry it."""
    _, _, persistent, _ = readme_code()
    script = tmp_path / "persistent.py"
    script.write_text(f"import contactvi as cvi\n{persistent}")
    printed = run([str(script)], tmp_path).splitlines()
    assert [line.split()[-1] for line in printed[:8]] == ["begin"] * 4 + ["stick"] * 4
    corners = [line for line in printed[8:] if line.startswith("('ground', 'box') stick")]
    assert len(corners) == 4
    assert all(abs(float(line.rstrip(" ]").split()[-1]) - 2.0 * 9.81 / 4.0) < 1e-6 for line in corners)


def test_readme_code_of_a_linkage_runs(tmp_path):
    """It prints the numbers that the README gives; the works account for the energy, up to the balance."""
    *_, linkage = readme_code()
    script = tmp_path / "linkage.py"
    script.write_text(f"import contactvi as cvi\n{linkage}\nprint(traj.energy[-1] - traj.energy[0])")
    power, balance, opened, gained = (
        [float(x) for x in line.split()] for line in run([str(script)], ROOT).splitlines()
    )
    least, most, motion, damping = power
    assert (round(least, 2), round(most, 2)) == (-1.25, 1.56)
    assert damping > 0.1
    assert abs(motion - damping - gained[0]) <= balance[0] < 1.3e-5
    assert opened[0] <= 1e-14


def test_guide_code_runs(tmp_path):
    """The guide's snippets one after the other, beside the models."""
    code = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "guide.md").read_text(), re.DOTALL)
    script = tmp_path / "guide.py"
    script.write_text("import contactvi as cvi\n" + "".join(code))
    (tmp_path / "models").symlink_to(ROOT / "models")
    assert run([str(script)], tmp_path).strip()
