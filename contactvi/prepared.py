"""A scene as its runs need it: taken as it is at a run, prepared once and again after an edit."""

from __future__ import annotations

import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contactvi.checks import States
from contactvi.scene import Scene


class Prepared:
    """What runs of a scene share: a copy that later edits do not reach, the engine's scene, names, checks of states.

    Attributes
    ----------
    built : the complete scene. core : the engine's (contactvi._core.Scene). states : checks of states and forces.
    pair_names : of the tested pairs, engine order. joint_names : of all joints, that of the world included.
    damping : of the joints, shape (nv,).
    """

    def __init__(self, scene: Scene) -> None:
        built = scene._complete()
        self.core = scene.core()
        self.built = built
        self._scene = _copy(scene)
        self.states = States(built.model)
        self.pair_names = [(str(a), str(b)) for a, b in built.pairs]
        self.joint_names = [str(name) for name in built.model.names]
        self.damping: NDArray[np.float64] = np.array(built.model.damping, dtype=float)

    def scene(self) -> Scene:
        """Return a new copy of the scene as it was, for the caller to keep and edit; what is built is shared."""
        return _copy(self._scene)

    def fits(self, scene: Scene) -> bool:
        """Return whether the scene is still as it was."""
        kept = self._scene
        same = scene._built is self.built and scene.q0 is kept.q0 and scene.v0 is kept.v0
        return same and scene.settings == kept.settings

    @property
    def q0(self) -> Any:
        """Where runs start, shape (nq,): as the scene says, else neutral."""
        return self.built.start if self._scene.q0 is None else self._scene.q0

    @property
    def v0(self) -> Any:
        """Velocity with which runs start, shape (nv,); None is rest."""
        return self._scene.v0

    @cached_property
    def loses_energy(self) -> bool:
        """Whether some pair or limit has a restitution below 1."""
        arrays = self.built.arrays
        return bool(np.any(self.built.restitution < 1.0) or np.any(arrays.limit_restitution[arrays.limits] < 1.0))


def prepare(scene: Scene) -> Prepared:
    """Return what runs of the scene need, kept with it until it is edited."""
    kept = scene._prepared
    if not isinstance(kept, Prepared) or not kept.fits(scene):
        kept = scene._prepared = Prepared(scene)
    return kept


def _copy(scene: Scene) -> Scene:
    taken = copy.copy(scene)
    for name, value in vars(scene).items():
        if isinstance(value, (list, dict)):
            setattr(taken, name, copy.copy(value))
    taken._edits, taken._prepared = copy.deepcopy(scene._edits), None
    return taken
