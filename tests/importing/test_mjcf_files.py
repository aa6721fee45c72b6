"""Every MJCF of gymnasium and dm_control loads with MuJoCo's numbers and runs, or is refused with the one reason."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

import contactvi as cvi
from helpers import mujoco_oracle as oracle

# What MuJoCo itself cannot compile, or what is no model: a word of the reason.
REFUSED = {
    "drosophila.xml": "head_body.msh",
    "drosophila_defaults.xml": "nothing in it",
    "build_fruitfly/floor.xml": "Error opening file",
    "build_fruitfly/fruitfly.xml": "head_body.msh",
    "dog_v2/scene.xml": "repeated name 'grid'",
    "mjcf/schema.xml": "not an MJCF",
    "attribute_test_schema.xml": "not an MJCF",
    "included_with_invalid_filenames.xml": "invalid_mesh_name",
    "model_with_invalid_filenames.xml": "invalid_included_name.xml",
    "mjcf/test_assets/test_model.xml": "mass and inertia of moving bodies",
    "testing/assets/model_with_assets.xml": "included.xml",
    "composer/arena.xml": "nothing in it",
    "common/materials.xml": "nothing in it",
    "common/skybox.xml": "nothing in it",
    "common/visual.xml": "nothing in it",
    "kinova/common.xml": "nothing in it",
}
# Meshes of hundreds of bodies, or minutes of contact in a second.
LONG = ("fruitfly", "drosophila", "dog", "rodent", "humanoid_CMU")


def files() -> list[Path]:
    found: list[Path] = []
    for package in ("gymnasium", "dm_control"):
        spec = find_spec(package)
        if spec is not None and spec.origin is not None:
            found += sorted(Path(spec.origin).parent.rglob("*.xml"))
    return found


def label(path: Path) -> str:
    return "/".join(path.parts[-3:])


def cases() -> list:
    marks = [pytest.mark.long]
    return [
        pytest.param(path, id=label(path), marks=marks if any(word in str(path) for word in LONG) else [])
        for path in files()
    ]


def reason(path: Path) -> str | None:
    return next((word for end, word in REFUSED.items() if str(path).endswith(end)), None)


def test_the_packages_are_there():
    names = [label(path) for path in files()]
    assert sum("mujoco/assets" in name for name in names) >= 14
    assert sum("control/suite" in name for name in names) >= 18


@pytest.mark.parametrize("path", cases())
def test_file(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file in the working folder
    if (why := reason(path)) is not None:
        with pytest.raises(cvi.SceneError, match=why):
            cvi.Scene.from_mjcf(path)
        return
    scene, m = cvi.Scene.from_mjcf(path), mujoco.MjModel.from_xml_path(str(path))
    if m.nbody > 1:
        assert oracle.differences(scene, m).largest() < 1e-9
    geoms = {mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_GEOM, k): k for k in range(m.ngeom)}
    wanted = {pair: mu for pair, (mu, _) in oracle.tested_pairs(m).items()}
    removed = [(pair.first, pair.second) for pair in scene.report.removed]
    if all(name in geoms for pair in (*scene.pair_names, *removed) for name in pair):
        found = {numbers_of(geoms, pair): mu for pair, mu in zip(scene.pair_names, scene.pair_friction, strict=True)}
        overlapping = {numbers_of(geoms, pair) for pair in removed}
        lost = {geoms[note.name] for note in scene.report.all_notes("ignored", "geom") if note.name in geoms}
        wanted = {pair: mu for pair, mu in wanted.items() if pair not in overlapping and not lost & set(pair)}
        assert found == pytest.approx(wanted)
    else:  # geoms without a name
        hidden = sum(bool(np.any(m.geom_type[list(pair)] == int(mujoco.mjtGeom.mjGEOM_HFIELD))) for pair in wanted)
        overlapping = sum(pair.reason.startswith("overlapping") for pair in scene.report.removed)
        assert len(scene.pair_names) + overlapping == len(wanted) - hidden


def numbers_of(geoms: dict[str, int], pair: tuple[str, str]) -> tuple[int, ...]:
    return tuple(sorted(geoms[name] for name in pair))


@pytest.mark.parametrize("path", [case for case in cases() if reason(case.values[0]) is None])
def test_run(path: Path):
    """One second from the file's start, lifted where bodies lie in the floor (MuJoCo pushes them out softly)."""
    scene = cvi.Scene.from_mjcf(path)
    if scene.nv == 0:
        return
    q = lifted(scene)
    traj = cvi.simulate(scene, q, duration=1.0, dt=1e-3)
    assert traj.status.code is cvi.StatusCode.SUCCESS
    assert np.isfinite(traj.q).all()


def lifted(scene: cvi.Scene) -> np.ndarray:
    """The start, with free bodies raised until nothing overlaps."""
    q = scene.neutral()
    gaps = scene.core().gaps(q)[0] if scene.pair_names else np.ones(1)
    if gaps.min() < 0.0:
        for k in range(1, scene.model.njoints):
            if scene.model.nqs[k] == 7:
                q[scene.model.idx_qs[k] + 2] -= 1.5 * gaps.min()
    return q
