"""Reactions of coupled joints, which steps do not need: computed from the momenta at the nodes when they are asked for.

The momentum of a follower changes by what acts on it, which the engine sums up, and by the reaction of the coupling:
with p = M v, and f the mean force of all else on it, lambda = dp/dt - f. These forces on the followers, with those on
their leaders that do no work with them, are the reactions of the equalities that couple the joints.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from contactvi.records.work import ConstraintRows, Forces
from contactvi.scene.build import Built

if TYPE_CHECKING:
    from contactvi.scene.element_rows import ConstraintRow

Array = NDArray[np.float64]


def coupled_rows(built: Built) -> list[ConstraintRow]:
    """Return the equalities that are couplings, in the order of the scene."""
    return [row for row in built.elements.constraints if row.coupled]


def with_coupled(forces: Forces, p: Array, built: Built) -> Forces:
    """Return forces with the reactions of couplings; p: the momenta at the nodes, (N, nv)."""
    rows = coupled_rows(built)
    if not rows or forces.on_followers is None:
        return forces
    dofs, back = _of_equalities(built)
    spans = np.diff(forces.t)[:, None]
    mean = np.zeros((len(forces.t), len(dofs)))
    mean[1:] = np.diff(p[:, dofs], axis=0) / spans - forces.on_followers[1:]
    coupled = [ConstraintRows(row.name, row.kind, row.rows) for row in rows]
    constraints = [*forces.constraints, *coupled]
    return Forces(forces.t, forces.values, np.hstack([forces.reactions, mean @ back.T]), constraints)


def _of_equalities(built: Built) -> tuple[list[int], Array]:
    """Return the dofs of the followers, and the forces of the equalities for unit forces on these."""
    model, couplings = built.model, built.elements.couplings
    in_order = list(built.engine.followers)
    of_joint = {f.joint: f for f in couplings.followers}
    complement = np.zeros((model.nv, len(in_order)))
    for k, joint in enumerate(in_order):
        complement[model.idx_vs[joint], k] = 1.0
        complement[model.idx_vs[of_joint[joint].leader], k] = -of_joint[joint].ratio
    rows = coupled_rows(built)
    gradients = np.zeros((model.nv, len(rows)))
    for k, row in enumerate(rows):
        gradients[model.idx_vs[row.b[0]], k] += 1.0
        gradients[model.idx_vs[row.a[0]], k] -= row.numbers[1]
    return [int(model.idx_vs[joint]) for joint in in_order], np.linalg.lstsq(gradients, complement, rcond=None)[0]
