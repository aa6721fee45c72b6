"""The equations of motion of a complete scene at a state, in Pinocchio's coordinates.

    M(q) a + b(q, v) = tau + f(q, v, t) + J_C^T f_C + J_phi^T lambda

M: the mass matrix; b: bias forces, of Coriolis, centrifugal and gravity; f: passive forces, those of springs, dampers,
wrenches and functions of the user; f_C: of contacts; lambda: of constraints and prescribed motions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError, SceneError, did_you_mean
from contactvi.inputs import real
from contactvi.scene.build import Built
from contactvi.scene.contact_frames import ContactJacobian, TouchingPoint, touching_points
from contactvi.scene.engine import engine_passive_forces

Array = NDArray[np.float64]

MARGIN = 1e-6  # [m] gap up to which a point counts as touching, as for shapes of models that merely touch


def mass_matrix(built: Built, q: Array) -> Array:
    """Return M (nv, nv) at q (nq,): the engine's, column by column."""
    nv = int(built.model.nv)
    columns = np.asarray(built.engine.momentum(np.repeat(q[None], nv, axis=0), np.eye(nv)))
    return np.asarray(0.5 * (columns + columns.T))


def inverse_mass_matrix(built: Built, q: Array) -> Array:
    """Return M^-1 (nv, nv) at q (nq,): the engine's, whose factors have the digits that inverting M would lose."""
    nv = int(built.model.nv)
    columns = np.asarray(built.engine.velocity(np.repeat(q[None], nv, axis=0), np.eye(nv)))
    return np.asarray(0.5 * (columns + columns.T))


def bias_forces(built: Built, q: Array, v: Array) -> Array:
    """Return b (nv,) at q (nq,), v (nv,)."""
    return np.asarray(built.engine.model.bias_forces(q, v))


def passive_forces(built: Built, q: Array, v: Array, t: float) -> Array:
    """Return f (nv,) at q (nq,), v (nv,), t [s]."""
    return engine_passive_forces(built.engine, q, v, t)


def gaps(built: Built, q: Array) -> Array:
    """Return the gaps of all guards (pairs, then limits) at q (nq,), shape (nguards,); see `gap_names`."""
    return np.concatenate([_pair_gaps(built, q), built.limits.gaps(q)])


def gap_gradients(built: Built, q: Array) -> Array:
    """Return the derivatives of the gaps in the tangent of q (nq,), shape (nguards, nv)."""
    return np.asarray(built.engine.gap_gradients(q))


def gap_names(built: Built) -> list[tuple[str, str]]:
    """Return the names of the guards: (shape, shape) of pairs, then (joint, "lower limit" or "upper limit")."""
    return [*built.pairs, *built.limits.names]


def touching(built: Built, q: Array, margin: float) -> list[TouchingPoint]:
    """Return the contact points within a margin [m] at q (nq,)."""
    return touching_points(built, q, _pair_gaps(built, q), margin)


def delassus(built: Built, q: Array, J: Array) -> Array:
    """Return J M^-1 J^T (m, m) of rows J (m, nv) at q (nq,)."""
    if not len(J):
        return np.zeros((0, 0))
    across = np.asarray(built.engine.velocity(np.repeat(q[None], len(J), axis=0), np.ascontiguousarray(J)))
    if not np.isfinite(across).all():
        raise SceneError(
            "The mass matrix is singular here", expected="a mass behind every motion",
            got="M^-1 J^T that is not finite",
            remedy="Look for masses near zero, or give inertia: set_joint(name, armature=1e-4)",
        )  # fmt: skip
    G = J @ across.T
    return np.asarray(0.5 * (G + G.T))


def constraint_jacobian(built: Built, q: Array, t: float, name: str | None) -> Array:
    """Return the gradients of all constraints, or of one, at q (nq,), t [s], shape (m, nv)."""
    J, first = np.asarray(built.engine.constraint_jacobian(q, t)).reshape(-1, built.model.nv), 0
    if name is None:
        return J
    for row in built.elements.constraints:
        if row.name == name:
            return J[first : first + row.rows]
        first += row.rows
    raise InputError(
        "Unknown constraint", name="name", expected="the name of a constraint", got=repr(name),
        remedy=did_you_mean(str(name), [row.name for row in built.elements.constraints]),
    )  # fmt: skip


def _pair_gaps(built: Built, q: Array) -> Array:
    values = np.asarray(built.engine.gaps(q)[0])
    if not np.isfinite(values).all():
        a, b = built.pairs[int(np.flatnonzero(~np.isfinite(values))[0])]
        raise SceneError(
            f"The distance of {a!r} and {b!r} is not known here", expected="finite distances", got="none",
            remedy="Look for positions that are very far, and for sizes near zero",
        )  # fmt: skip
    return values


class SceneDynamics(ABC):
    """What the equations of motion of a scene are at a given state.

    The equations, in Pinocchio's coordinates (of a free body: its body twist; derivatives by q are along that tangent):

        M(q) a + b(q, v) = tau + f(q, v, t) + J_C^T f_C + J_phi^T lambda
    """

    @abstractmethod
    def built(self) -> Built:
        """Return the complete scene."""

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), shape (nv, nv) [kg, kg m, kg m^2].

        It contains the inertia of all bodies and the armature of joints, with what rotors add; springs, dampers and
        constraints add nothing to it. Loops are not eliminated: it is that of the open tree.

        Args:
            q: configuration, shape (nq,).
        """
        return mass_matrix(self.built(), self._q(q))

    def bias_forces(self, q: ArrayLike, v: ArrayLike | None = None) -> Array:
        """Return b(q, v), shape (nv,) [N, N m]: Coriolis, centrifugal and gravity forces (Pinocchio's nle).

        Gravity that a motor has to hold is positive. Springs, dampers, wrenches and functions of the user are in
        `passive_forces`, those of constraints and contacts in neither.

        Args:
            q: configuration, shape (nq,). v: velocity, shape (nv,); None: at rest.
        """
        return bias_forces(self.built(), self._q(q), self._v(v))

    def passive_forces(self, q: ArrayLike, v: ArrayLike | None = None, t: float = 0.0) -> Array:
        """Return f(q, v, t), shape (nv,) [N, N m]: what acts besides inputs, gravity, contacts and constraints.

        Springs and damping of joints, springs, dampers, tendons and wrenches between bodies, functions of the user. Not
        in it: servos, which are inputs, and joint friction, which is a law and no force of the state.

        Args:
            q, v: as in `bias_forces`. t: time [s], for what depends on it.

        Raises:
            UserFunctionError: of a function of the user.
        """
        return passive_forces(self.built(), self._q(q), self._v(v), real("t", t))

    def gaps(self, q: ArrayLike) -> Array:
        """Return the gaps of all tested pairs [m], then of all joint limits [rad, m], shape (len(gap_names),).

        Signed distances, negative in penetration, exact near contact.

        Args:
            q: configuration, shape (nq,).
        """
        return gaps(self.built(), self._q(q))

    def gap_gradients(self, q: ArrayLike) -> Array:
        """Return d(gaps)/dq along tangent vectors, shape (len(gap_names), nv).

        Where two points of a pair are equally near it is the gradient of one of them. Arguments as of `gaps`.
        """
        return gap_gradients(self.built(), self._q(q))

    @property
    def gap_names(self) -> list[tuple[str, str]]:
        """What the entries of `gaps` belong to: (shape, shape), then (joint, "lower limit" or "upper limit")."""
        return gap_names(self.built())

    def contact_jacobian(self, q: ArrayLike, margin: float = MARGIN) -> ContactJacobian:
        """Return J_C of the points of the tested pairs with a gap of at most `margin` at q.

        J_C v is the velocity of the second body of each pair relative to the first in the contact frames, whose z axes
        are the normals from the first to the second: see `ContactJacobian`, whose rows are named by pair and point.
        Up to four points of a pair, those that span its face. Joint limits are in `gap_gradients` alone.

        Args:
            q: configuration, shape (nq,). margin: [m].
        """
        built, at = self.built(), self._q(q)
        return ContactJacobian(built, at, touching(built, at, real("margin", margin)))

    def delassus(self, q: ArrayLike, margin: float = MARGIN) -> Array:
        """Return J_C M^-1 J_C^T, shape (3 n, 3 n) [1/kg]: what contact impulses add to the relative velocities.

        Rows and columns are those of `contact_jacobian`. Constraints are not eliminated: with them, take the rows of
        `constraint_jacobian` in.
        """
        built, at = self.built(), self._q(q)
        return delassus(built, at, self.contact_jacobian(at, margin).matrix)

    def constraint_jacobian(self, q: ArrayLike, t: float = 0.0, name: str | None = None) -> Array:
        """Return J_phi = d(phi)/dq of all constraints in their order, or of the one called `name`, shape (m, nv).

        Args:
            q: configuration, shape (nq,). t: time [s], for driven lengths and motions.

        Raises:
            InputError: unknown name.
        """
        return constraint_jacobian(self.built(), self._q(q), real("t", t), name)

    def _q(self, q: Any) -> Array:
        return self.built().states.configuration(q, "q")

    def _v(self, v: Any) -> Array:
        return self.built().states.velocity(v, "v")
