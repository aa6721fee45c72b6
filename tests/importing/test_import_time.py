"""What importing contactvi and loading models must not import: it would take longer than the rest."""

import subprocess
import sys
from pathlib import Path

import pytest

# scipy.spatial takes .3 s by itself, as long as everything else; meshcat and matplotlib are for pictures alone.
SLOW = ("scipy.spatial", "matplotlib", "meshcat", "mujoco")
SCENES = {
    "the scene class": "contactvi.Scene",
    "a run": "contactvi.simulate",
    "a robot with meshes": (
        "contactvi.Scene().add_urdf('example-robot-data://robots/panda_description/urdf/panda.urdf')"
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_slow_packages_are_imported_where_they_are_used(name: str, tmp_path: Path):
    code = f"import sys, contactvi; {SCENES[name]}; print(*[m for m in {SLOW} if m in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True,
        cwd=tmp_path,  # the source root would shadow an installed package
    )  # fmt: skip
    assert done.stdout.split() == []
