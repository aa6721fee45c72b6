"""The MJCF files of gymnasium and dm_control: where they are, which are refused, and how their pairs compare."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import contactvi as cvi
from helpers import mujoco_oracle as oracle
from helpers.extras import mujoco_module

mujoco = mujoco_module()

PACKAGES = ("gymnasium", "dm_control")
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


def files() -> list[Path]:
    found: list[Path] = []
    for package in PACKAGES:
        spec = find_spec(package)
        if spec is not None and spec.origin is not None:
            found += sorted(Path(spec.origin).parent.rglob("*.xml"))
    return found


def reason(path: Path) -> str | None:
    """A word of the reason for which a file is refused; None for one that loads."""
    return next((word for end, word in REFUSED.items() if str(path).endswith(end)), None)


def pairs(scene: cvi.Scene, m: mujoco.MjModel) -> tuple[int, int]:
    """The number of pairs that the scene should test by MuJoCo's own rules, and how many of the scene's differ.

    A pair differs that one of the two has alone, or with another friction. Pairs that overlap at the start and those
    of height fields that the import has left out, both by its report, are taken out of MuJoCo's. Where geoms have no
    names only the numbers of pairs can be compared.
    """
    geoms = {mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_GEOM, k): k for k in range(m.ngeom)}
    wanted = {pair: mu for pair, (mu, _) in oracle.tested_pairs(m).items()}
    removed = [(pair.first, pair.second) for pair in scene.report.removed]
    if all(name in geoms for pair in (*scene.pair_names, *removed) for name in pair):
        found = {_numbers(geoms, pair): mu for pair, mu in zip(scene.pair_names, scene.pair_friction, strict=True)}
        overlapping = {_numbers(geoms, pair) for pair in removed}
        lost = {geoms[note.name] for note in scene.report.all_notes("ignored", "geom") if note.name in geoms}
        wanted = {pair: mu for pair, mu in wanted.items() if pair not in overlapping and not lost & set(pair)}
        differing = set(found) ^ set(wanted)
        differing |= {
            pair for pair in set(found) & set(wanted) if not math.isclose(found[pair], wanted[pair], rel_tol=1e-6)
        }
        return len(wanted), len(differing)
    hidden = sum(bool(np.any(m.geom_type[list(pair)] == int(mujoco.mjtGeom.mjGEOM_HFIELD))) for pair in wanted)
    overlaps = sum(pair.reason.startswith("overlapping") for pair in scene.report.removed)
    expected = len(wanted) - hidden - overlaps
    return expected, abs(len(scene.pair_names) - expected)


def _numbers(geoms: dict[str, int], pair: tuple[str, str]) -> tuple[int, ...]:
    return tuple(sorted(geoms[name] for name in pair))


def lifted(scene: cvi.Scene) -> np.ndarray:
    """The start, with free bodies raised until nothing overlaps (MuJoCo pushes such bodies out softly)."""
    q = scene.neutral()
    gaps = scene.core().gaps(q)[0] if scene.pair_names else np.ones(1)
    if gaps.min() < 0.0:
        for k in range(1, scene.model.njoints):
            if scene.model.nqs[k] == 7:
                q[scene.model.idx_qs[k] + 2] -= 1.5 * gaps.min()
    return q
