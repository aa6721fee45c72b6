"""What the tests of the Gauss steps share: engine and oracle of a case of the battery, and norms."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from batteries.models import Case, case, springs_of
from helpers.engine import core_scene
from oracles.del_step import System
from oracles.gauss_step import GaussStep

EPS = np.finfo(float).eps
ORDERS = (4, 8, 12, 16)
EVERY_ORDER = tuple(range(2, 17, 2))


@dataclass(frozen=True)
class Setup:
    """A case with engine scene, oracle system and the state (q, v, p) of seed 0."""

    case: Case
    model: pin.Model
    scene: object
    system: System
    q: np.ndarray
    v: np.ndarray
    p: np.ndarray

    def gauss(self, order: int) -> GaussStep:
        """The oracle of this order."""
        return GaussStep(self.system, order // 2)

    def state(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Another random (q, p)."""
        q, v = self.case.state(self.model, seed)
        return q, self.system.momentum(q, v)


def extra_of(name: str, model: pin.Model, springs: bool, damping: bool) -> dict[str, np.ndarray]:
    """Random springs and damping; in proportion to the small links of Allegro and Talos."""
    extra = springs_of(model, np.random.default_rng(7)) if springs or damping else {}
    if name in ("allegro", "talos"):
        extra = {k: x if k == "rest" else 0.02 * x for k, x in extra.items()}
    if not damping:
        extra.pop("damping", None)
    if not springs:
        extra.pop("stiffness", None)
    return extra


@functools.cache
def setup(name: str, springs: bool = False, damping: bool = False, gravity: bool = True) -> Setup:
    """The start is the same for all variants."""
    c = case(name)
    model = c.model()
    if not gravity:
        model.gravity = pin.Motion.Zero()
    extra = extra_of(name, model, springs, damping)
    system, (q, v) = System(model, **extra), c.state(model)
    return Setup(c, model, core_scene(model, **extra), system, q, v, system.momentum(q, v))


def rotates(model: pin.Model) -> bool:
    """Whether a joint moves on SO(3)."""
    return any(j.shortname().endswith(("Spherical", "FreeFlyer")) for j in list(model.joints)[1:])


def velocity_size(system: System, q: np.ndarray, v: np.ndarray) -> float:
    """Energy norm sqrt(v^T M v) of split velocities, the largest of the rows of v."""
    m = system.mass_matrix(q)
    return float(max(np.sqrt(max(w @ m @ w, 0.0)) for w in np.atleast_2d(v)))


def momentum_size(system: System, q: np.ndarray, p: np.ndarray) -> float:
    """Energy norm sqrt(p^T M^-1 p) of split momenta, the largest of the rows of p."""
    rows = np.atleast_2d(p)
    return float(np.sqrt(np.abs(np.sum(rows.T * np.linalg.solve(system.mass_matrix(q), rows.T), axis=0)).max()))
