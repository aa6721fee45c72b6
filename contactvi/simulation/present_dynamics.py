"""The equations of motion at the present state of a `Simulator`, with its present contacts."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from contactvi.errors import InputError
from contactvi.options import Options
from contactvi.records.contacts import Contact
from contactvi.scene import dynamics
from contactvi.scene.build import Built
from contactvi.scene.contact_frames import ContactJacobian, TouchingPoint

Array = NDArray[np.float64]


class PresentDynamics(ABC):
    """What the equations of motion are now, in Pinocchio's coordinates; `Scene` has them at any state.

        M(q) a + b(q, v) = tau + f(q, v, t) + J_C^T f_C + J_phi^T lambda

    What each contains, its shape and its units are those of the method of `Scene` with the same name.
    """

    options: Options

    @property
    @abstractmethod
    def t(self) -> float: ...

    @property
    @abstractmethod
    def q(self) -> Array: ...

    @property
    @abstractmethod
    def v(self) -> Array: ...

    @property
    @abstractmethod
    def contacts(self) -> list[Contact]: ...

    @property
    @abstractmethod
    def _stepped(self) -> bool:
        """Whether a step was made since the start."""

    @abstractmethod
    def built(self) -> Built:
        """Return the complete scene. Treat it as constant."""

    def mass_matrix(self) -> Array:
        """Return M(q), shape (nv, nv), the armature of joints included."""
        return dynamics.mass_matrix(self.built(), self.q)

    def bias_forces(self) -> Array:
        """Return b(q, v), shape (nv,) [N, N m]: Coriolis, centrifugal and gravity forces."""
        return dynamics.bias_forces(self.built(), self.q, self.v)

    def passive_forces(self) -> Array:
        """Return f(q, v, t), shape (nv,) [N, N m]: springs, dampers, wrenches and functions of the user."""
        return dynamics.passive_forces(self.built(), self.q, self.v, self.t)

    def gaps(self) -> Array:
        """Return the gaps of all tested pairs [m] and joint limits [rad, m], in the order of `Scene.gap_names`."""
        return dynamics.gaps(self.built(), self.q)

    def gap_gradients(self) -> Array:
        """Return d(gaps)/dq along tangent vectors, one row for each of `Scene.gap_names`, (nguards, nv)."""
        return dynamics.gap_gradients(self.built(), self.q)

    def contact_jacobian(self) -> ContactJacobian:
        """Return J_C of the present contact points, in the order of `contacts`, without those of joint limits.

        J_C v is the velocity of the second body relative to the first in the contact frames; f_C = R_WC^T force of a
        `Contact`. Before the first step there are no persistent contacts yet, and it is that of the points that touch,
        as `Scene.contact_jacobian` finds and numbers them.

        Raises:
            InputError: with record_contacts=False.
        """
        if not self.options.record_contacts:
            raise InputError(
                "Contacts are not recorded", name="record_contacts", expected="True", got="False",
                remedy="Make the simulator with record_contacts=True, or use scene.contact_jacobian(sim.q)",
            )  # fmt: skip
        if not self._stepped:
            return self._jacobian_of(dynamics.touching(self.built(), self.q, dynamics.MARGIN))
        points = [
            TouchingPoint(c.pair, c.point, c.position, c.position, c.normal, c.gap)
            for c in self.contacts
            if c.kind == "contact"
        ]
        return self._jacobian_of(points)

    def _jacobian_of(self, points: list[TouchingPoint]) -> ContactJacobian:
        return ContactJacobian(self.built(), self.q, points)

    def delassus(self) -> Array:
        """Return J_C M^-1 J_C^T of the present contacts, shape (3 n, 3 n) [1/kg]; rows as of `contact_jacobian`."""
        return dynamics.delassus(self.built(), self.q, self.contact_jacobian().matrix)

    def constraint_jacobian(self, name: str | None = None) -> Array:
        """Return the gradients of all constraints in q, or of the one called `name`, shape (m, nv)."""
        return dynamics.constraint_jacobian(self.built(), self.q, self.t, name)
