"""The URDF models of example-robot-data: what each needs to load, and how it compares with Pinocchio's own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.importing.paths import example_robot_data_share

# What no model says by itself: joints that move no mass, mimic tags of joints that the file does not have.
NEEDS: dict[str, dict[str, Any]] = {
    "romeo.urdf": {"armature": 1e-3},
    "romeo_laas_small.urdf": {"armature": {"*_gripper_joint": 1e-3}},
    "alex_psyonic_hands.urdf": {"mimic": False},
    "icub.urdf": {"armature": 1e-3},  # two joints about one axis in the neutral pose, without inertia between them
    "talos_left_arm.urdf": {"base": "fixed"},  # its SRDF is that of the whole robot
}
# A word of the reason for which a file is refused, whatever it is given.
REFUSED = {"ur3.urdf": "no link"}
# What walks or flies, beside those whose poses place their base.
FREE = (
    "alex", "anymal", "borinot", "g1", "hector", "hextilt", "human", "iris", "laikago", "quadruped", "romeo",
    "simple_humanoid",
)  # fmt: skip


def robots_folder() -> Path:
    return example_robot_data_share() / "example-robot-data" / "robots"


def files() -> list[Path]:
    return sorted(robots_folder().rglob("*.urdf"))


def label(path: Path) -> str:
    """The folder of the robot and the name of the file."""
    return f"{path.relative_to(robots_folder()).parts[0]}/{path.name}"


def srdf_of(path: Path) -> Path | None:
    """The SRDF of a robot: of its package, with a name that the file's begins with, or that begins with the file's."""
    package = robots_folder() / path.relative_to(robots_folder()).parts[0]
    known = sorted(package.rglob("*.srdf"))
    above = [srdf for srdf in known if path.stem.startswith(srdf.stem)]
    below = [srdf for srdf in known if srdf.stem.startswith(path.stem)]
    return max(above, key=lambda srdf: len(srdf.stem)) if above else below[0] if below else None


def options_of(path: Path) -> dict[str, Any]:
    """Arguments of Scene.add_urdf."""
    srdf = srdf_of(path)
    places_its_base = srdf is not None and 'joint name="root_joint"' in srdf.read_text()
    free = places_its_base or path.relative_to(robots_folder()).parts[0].startswith(FREE)
    return {"base": "free" if free else "fixed", "srdf": srdf, **NEEDS.get(path.name, {})}


@dataclass
class Differences:
    """Largest differences between a scene and the model that Pinocchio reads from the same file.

    Attributes:
        mass: of the sums, relative.
        matrix: of the engine's mass matrix, relative to sqrt(M_ii M_jj).
        bias: of bias forces with gravity, of the scene's model, relative to the largest.
        gravity: of the engine's gravity, relative to the largest.
        limits: of joint limits [rad or m], where both have some.
    """

    mass: float
    matrix: float
    bias: float
    gravity: float
    limits: float

    def largest(self) -> float:
        return max(vars(self).values())


def differences(scene: cvi.Scene, path: Path, options: dict[str, Any], states: int = 3) -> Differences:
    """How far a scene of one robot is from Pinocchio's model of its file at random states."""
    free = options["base"] == "free"
    own = pin.buildModelFromUrdf(str(path), *([pin.JointModelFreeFlyer()] if free else []))
    own.armature = np.array(scene.model.armature)  # not in a URDF: the scene's is what the caller gave
    model, core = scene.model, scene.core()
    total = sum(inertia.mass for inertia in own.inertias)
    mass = abs(sum(inertia.mass for inertia in model.inertias) - total) / max(total, 1e-300)
    found = Differences(mass, 0.0, 0.0, 0.0, _limits(model, own))
    data, own_data = model.createData(), own.createData()
    assert (model.nq, model.nv) == (own.nq, own.nv)
    for seed in range(states if own.nv else 0):
        rng = np.random.default_rng(seed)
        q = pin.integrate(own, pin.neutral(own), rng.normal(size=own.nv))
        wanted = pin.crba(own, own_data, q)
        wanted = np.triu(wanted) + np.triu(wanted, 1).T
        size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
        matrix = np.asarray(core.momentum(np.tile(q, (own.nv, 1)), np.eye(own.nv))).T
        found.matrix = max(found.matrix, float(np.abs((matrix - wanted) / size).max()))
        v, rest = rng.normal(size=own.nv), np.zeros(own.nv)
        bias = pin.nonLinearEffects(own, own_data, q, v)
        found.bias = max(found.bias, _relative(pin.nonLinearEffects(model, data, q, v), bias))
        gravity = -np.asarray(core.momentum_to_public(q, core.dynamics(q, rest)[1]))
        found.gravity = max(found.gravity, _relative(gravity, pin.nonLinearEffects(own, own_data, q, rest)))
    return found


def _relative(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.abs(found - wanted).max() / max(np.abs(wanted).max(), 1e-300))


def beyond_limits(scene: cvi.Scene, q: np.ndarray) -> list[str]:
    """The joints whose q is outside of the limits of their files."""
    found = []
    for row in (row for part in scene.report.parts for row in part.joints):
        if row.limited:
            value = q[scene.q_index(row.name)][0]
            if not row.lower <= value <= row.upper:
                found.append(row.name)
    return found


def _limits(model: pin.Model, own: pin.Model) -> float:
    lower = np.abs(np.array(model.lowerPositionLimit) - own.lowerPositionLimit)
    upper = np.abs(np.array(model.upperPositionLimit) - own.upperPositionLimit)
    both = np.concatenate([lower, upper])
    return float(both[np.isfinite(both)].max(initial=0.0))
