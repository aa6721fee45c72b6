"""Steps of a run that are made again, whole or in part, for what its ledger says of them."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from contactvi import _core

Array = NDArray[np.float64]
_STEP_TOL = 1e-13  # of the steps that are made again, below that of any run


class RemadeSteps:
    """Makes smooth steps of a scene, and finds the energies that belong to them.

    Args:
        dt: length of the run's steps [s], NaN where they differ. order: of the method.
        damping: of the dofs, shape (nv,).
        order_2: whether the steps with constraints or joint friction have order 2 whatever that of the method.
        complete: whether the scene has all of its functions of the user; without some no energy is known.
    """

    def __init__(self, core: _core.Scene, dt: float, order: int, damping: Array, order_2: bool, complete: bool) -> None:
        self._core, self._dt, self._order = core, dt, order
        self._damping, self._order_2, self._complete = damping, order_2, complete
        c, b = np.polynomial.legendre.leggauss(order // 2)
        self._gauss = 0.5 * (1.0 + c), 0.5 * b

    def discrete_energy(self, q: Array, p: Array, h: Array) -> Array:
        """Return E_d [J] of steps h (n,) from states q (n, nq), p (n, nv), shape (n,).

        H where a step has no length, NaN where that is not known.
        """
        if not self._complete:
            return np.full(len(q), np.nan)
        values: Array = self._core.energy(q, p).sum(axis=1)
        some = np.flatnonzero(h != 0.0)
        try:
            values[some] = self._core.discrete_energy(q[some], p[some], h[some], self._order)
        except RuntimeError:  # an EngineError: the run had to cut such a step in two, so it cannot be made again
            for i in some:
                one = slice(i, i + 1)
                with contextlib.suppress(RuntimeError):
                    values[i] = np.nan
                    values[i] = self._core.discrete_energy(q[one], p[one], h[one], self._order)[0]
        return values

    def modified_energy(self, q: Array, p: Array, t: Array | None = None) -> Array:
        """Return the modified Hamiltonian of the full step at states q (n, nq), p (n, nv) [J], shape (n,).

        t: their times (n,) [s], for constraints that are prescribed motions.
        """
        if not self._complete:
            return np.full(len(q), np.nan)
        order = 2 if self._order_2 else self._order
        return np.asarray(self._core.modified_energy(q, p, self._dt, order, t))

    def after(self, q: Array, p: Array, h: Array) -> tuple[Array, Array, Array, Array]:
        """Return where parts of steps h (n,) [s] from states q (n, nq), p (n, nv) at impacts end, and damping's work.

        That is q, p and two arrays (n,) [J]: first its work over the whole part, h sum_j b_j P_j with the power
        P_j = -v_j D v_j at the Gauss stages; second that between the impact and E_d, which is the mean of E over the
        stages: h sum_ij b_i a_ij P_j, and sum_i b_i a_ij = b_j (1 - c_j). Negative h: where the step that ended there
        began. NaN where h is not known.
        """
        q, p, c, b = q.copy(), p.copy(), *self._gauss
        whole, near = np.zeros(len(h)), np.zeros(len(h))
        for i in np.flatnonzero(h != 0.0):
            if not np.isfinite(h[i]):
                p[i] = whole[i] = near[i] = np.nan
                continue
            try:
                q[i], p[i], v, *_ = self._core.step(q[i], p[i], float(h[i]), None, _STEP_TOL, self._order)
            except RuntimeError:
                p[i] = whole[i] = near[i] = np.nan
                continue
            power = -np.sum(self._damping * np.asarray(v) ** 2, axis=1)  # of the stages, (s,)
            whole[i] = abs(h[i]) * float(b @ power)
            near[i] = abs(h[i]) * float((b * (1.0 - c)) @ power)
        return q, p, whole, near
