"""The parameters of a scene with respect to which runs have derivatives, as directions of the engine's numbers.

A direction is {entry: array} in the engine's entries: "inertia" (njoints, 10), "stiffness" (njoints,), "gravity" (3,),
and "armature", "damping", "rest", "kp", "kd" (nv,). Derivatives with respect to a name are those along its directions.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.errors import InputError, did_you_mean
from contactvi.scene.parameter_values import CONTACT_NAMES as CONTACT_NAMES
from contactvi.scene.parameter_values import NAMES as NAMES
from contactvi.scene.parameter_values import is_parameter as is_parameter

Array = NDArray[np.float64]
Direction = dict[str, Array]

# What the energy of a motion depends on, inputs among it.
OF_ENERGY = ("control", "gravity", "mass", "inertia", "armature", "stiffness", "rest", "damping")


def directions_of(model: pin.Model, name: str) -> list[Direction]:
    """Return the directions of a name for which `is_parameter`, one per column; InputError for an unknown joint."""
    if name == "gravity":
        return [{"gravity": unit} for unit in np.eye(3)]
    kind, _, wanted = name.partition(":")
    joint = _joint(model, kind, wanted)
    if kind in ("mass", "inertia"):
        numbers = np.eye(10) if kind == "inertia" else _mass(model.inertias[joint])[None]
        return [{"inertia": _row(model.njoints, joint, row)} for row in numbers]
    if kind == "stiffness":
        return [{"stiffness": _row(model.njoints, joint, np.float64(1.0))}]
    first = model.idx_vs[joint]
    return [{kind: np.eye(model.nv)[first + k]} for k in range(model.nvs[joint])]


def along(gradients: dict[str, Array], direction: Direction) -> float:
    """Return the derivative along a direction from gradients in the engine's entries."""
    return sum(float(np.sum(np.asarray(gradients[entry]).reshape(values.shape) * values))
               for entry, values in direction.items())  # fmt: skip


def _joint(model: pin.Model, kind: str, wanted: str) -> int:
    names = [str(name) for name in model.names]
    if wanted in names[1:]:
        return names.index(wanted)
    raise InputError(
        "No joint has this name", name="wrt", expected=f"{kind}: and one of {', '.join(names[1:])}",
        got=f"{kind}:{wanted}", remedy=did_you_mean(wanted, names[1:]),
    )  # fmt: skip


def _mass(body: pin.Inertia) -> Array:
    """Return the change of the ten numbers with the mass, the centre of mass and the inertia about it as they are."""
    c = np.asarray(body.lever)
    about = c @ c * np.eye(3) - np.outer(c, c)
    return np.concatenate([[1.0], c, about[np.triu_indices(3)]])


def _row(count: int, at: int, value: Array | np.float64) -> Array:
    found = np.zeros((count, *np.shape(value)))
    found[at] = value
    return found
