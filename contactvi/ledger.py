"""The ledger of a run: what should be conserved, node by node and impact by impact, and tolerances on it.

Energies [J], momenta [N s, N m s] about the world's origin, in world axes. A loss is what restitution takes,
(1 - e^2) gamma_minus^2 / (2 G_c); a jump has it added back: what an impact changes beyond its loss.

Jumps of the three scalars at an impact (q_c, p_minus -> p_plus; `before` and `after` the parts of the step):

- energy H: T(p_plus) - T(p_minus) + loss.
- discrete energy E_d, the mean of E over the Gauss stages, of the partial step that starts at the impact less that of
  the one that ended there. Of several impacts at one instant each starts from what the one before it left.
- modified Hamiltonian of the full step length (H itself from order 4 on), of the node that the step would end at
  without further impacts less that of the node it started from; of several impacts in one step each starts from what
  the one before it left.

What damping does between the two things compared (the stages of the parts, the two nodes) is no jump, and taken off: by
the Gauss weights of the stages.

Tolerances, the keys of `ledger` of a run (options.LEDGER_TOLERANCES), are upper bounds of

- energy, modified_energy, discrete_energy: drift from the start at the recorded nodes, losses added back, relative to
  the largest kinetic energy so far. Damping and inputs change these energies; a tolerance is for runs without.
- energy_jump, modified_energy_jump, discrete_energy_jump, own_jump (of the map used): likewise relative.
- linear_momentum, angular_momentum: distance from the start [N s], [N m s], for free bodies without gravity;
  linear_momentum_jump, angular_momentum_jump: at an impact of free bodies.
- impulse: how far one is below zero [N s]. complementarity: |gap * impulse| [N m s]. gap: |gap| at an impact [m].

Inputs are not kept in a run; what needs a step to be made again (discrete energy, jumps but that of the energy) is NaN
where a run had some, and where the run had to cut that step in two because its sweeps did not converge.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contactvi.events import EventLog
from contactvi.options import Options

Array = NDArray[np.float64]
_STEP_TOL = 1e-13  # of the steps made again, below that of any run


class Ledger:
    """See the module. Every array is computed when first asked for and kept.

    Per node, shapes (N,) and (N, 3): energy, modified_energy, discrete_energy (of the step that starts there; NaN where
    an impact cuts that step, and at the last node), linear_momentum, angular_momentum, loss (of all impacts so far).
    Per event, shapes (n,) and (n, 3): energy_jump, modified_energy_jump, discrete_energy_jump, own_jump, event_loss,
    impulse, gap, complementarity, linear_momentum_jump, angular_momentum_jump.
    """

    def __init__(
        self,
        core: Any,
        options: Options,
        t: Array,
        q: Array,
        p: Array,
        events: EventLog,
        *,
        damping: Array,
        forced: bool,
        start: float,
    ) -> None:
        """Of nodes t (N,) [s], q (N, nq), p (N, nv) and events of a run that began at `start` [s].

        options: its settings; of them the order, and dt where all steps have one length. damping: of the joints, (nv,).
        forced: whether there were inputs, which are not known here.
        """
        self._core, self._forced, self._start = core, forced, start
        self._dt = float("nan") if options.auto else options.fixed_dt
        self._order = options.order
        c, b = np.polynomial.legendre.leggauss(options.order // 2)
        self._gauss = 0.5 * (1.0 + c), 0.5 * b
        self._damping = np.array(damping, dtype=float)
        self.t, self._q, self._p, self.events = t, q, p, events

    # -- per node ------------------------------------------------------------------------------------------------------

    @cached_property
    def kinetic_energy(self) -> Array:
        """T [J], shape (N,)."""
        return self._energies[:, 0]

    @cached_property
    def energy(self) -> Array:
        """H [J], shape (N,)."""
        return np.asarray(self._energies.sum(axis=1))

    @cached_property
    def modified_energy(self) -> Array:
        """Modified Hamiltonian of the full step [J], shape (N,); H from order 4 on."""
        return self._modified(self._q, self._p)

    @cached_property
    def discrete_energy(self) -> Array:
        """E_d of the step that starts at the node [J], shape (N,); NaN without such a step, with inputs or "auto"."""
        values = np.full(len(self.t), np.nan)
        if not np.isfinite(self._dt):
            return values
        step = (self.t - self._start) / self._dt
        index = np.rint(step).astype(np.int64)
        whole = np.abs(step - index) < 1e-6  # a run that ended inside a step has its last node there
        whole[-1:] = False
        whole &= ~np.isin(index, self.events.array("step"))
        if not self._forced:
            values[whole] = self._discrete(self._q[whole], self._p[whole], np.full(int(whole.sum()), self._dt))
        return values

    @cached_property
    def linear_momentum(self) -> Array:
        """Of all bodies [N s], shape (N, 3)."""
        return self._momenta[:, :3]

    @cached_property
    def angular_momentum(self) -> Array:
        """Of all bodies about the world's origin [N m s], shape (N, 3)."""
        return self._momenta[:, 3:]

    @cached_property
    def loss(self) -> Array:
        """What restitution took until each node [J], >= 0, shape (N,)."""
        return self.events.total(self.event_loss, self.t)

    # -- per event -----------------------------------------------------------------------------------------------------

    @property
    def event_loss(self) -> Array:
        """(1 - e^2) gamma_minus^2 / (2 G_c) [J], shape (n,)."""
        return self.events.loss

    @property
    def impulse(self) -> Array:
        """lambda [N s; N m s at the limit of a revolute joint], shape (n,)."""
        return self.events.array("impulse")

    @property
    def gap(self) -> Array:
        """Signed distance at the impact [m; rad], shape (n,)."""
        return self.events.array("gap")

    @property
    def complementarity(self) -> Array:
        """gap * impulse [N m s], shape (n,): no impulse at a distance."""
        return self.gap * self.impulse

    @cached_property
    def energy_jump(self) -> Array:
        """Of H, loss added back [J], shape (n,)."""
        return self.events.energy_change + self.event_loss

    @cached_property
    def discrete_energy_jump(self) -> Array:
        """Of E_d, loss added back [J], shape (n,)."""
        if self._forced:
            return np.full(len(self.events), np.nan)
        q, before, after = map(self.events.array, ("q", "before", "after"))
        start = self._discrete(q, self.events.array("p_minus"), -before) + self._before[3]
        end = self._discrete(q, self.events.array("p_plus"), after) - self._after[3]
        chained = self._follows("step", "time", "before")
        start[chained] = end[np.flatnonzero(chained) - 1]
        return end - start + self.event_loss

    @cached_property
    def modified_energy_jump(self) -> Array:
        """Of the modified Hamiltonian over the step, loss added back [J], shape (n,)."""
        if self._forced:
            return np.full(len(self.events), np.nan)
        q_end, p_end, work_after, _ = self._after
        q_start, p_start, work_before, _ = self._before
        end = self._modified(q_end, p_end) - work_after
        start = self._modified(q_start, p_start)
        chained = self._follows("step")
        start[chained] = end[np.flatnonzero(chained) - 1]
        # the work until the first impact of an instant; those after it have none of their own
        start += np.where(self._follows("step", "time", "before"), 0.0, work_before)
        return end - start + self.event_loss

    @cached_property
    def own_jump(self) -> Array:
        """Of the scalar that the map of the event conserves, against its own reference [J], shape (n,)."""
        return np.where(self.events.array("method") == 0, self.energy_jump, self.events.array("jump"))

    @property
    def linear_momentum_jump(self) -> Array:
        """p_plus less p_minus of all bodies [N s], shape (n, 3)."""
        return self._momentum_jumps[:, :3]

    @property
    def angular_momentum_jump(self) -> Array:
        """Of all bodies about the world's origin [N m s], shape (n, 3)."""
        return self._momentum_jumps[:, 3:]

    # -- how -----------------------------------------------------------------------------------------------------------

    @cached_property
    def _energies(self) -> Array:
        return np.asarray(self._core.energy(self._q, self._p))

    @cached_property
    def _momenta(self) -> Array:
        return np.asarray(self._core.spatial_momentum(self._q, self._p))

    @cached_property
    def _momentum_jumps(self) -> Array:
        q, p_minus, p_plus = map(self.events.array, ("q", "p_minus", "p_plus"))
        return np.asarray(self._core.spatial_momentum(q, p_plus) - self._core.spatial_momentum(q, p_minus))

    @cached_property
    def event_kinetic_energy(self) -> Array:
        """T before each impact [J], shape (n,)."""
        return np.asarray(self._core.energy(self.events.array("q"), self.events.array("p_minus")))[:, 0]

    def _follows(self, *names: str) -> NDArray[np.bool_]:
        """Return which events share these fields with the event before them, shape (n,)."""
        same = np.ones(len(self.events), dtype=bool)
        same[:1] = False
        for name in names:
            same[1:] &= np.diff(self.events.array(name)) == 0
        return same

    def _discrete(self, q: Array, p: Array, h: Array) -> Array:
        """E_d of steps h (n,) from these states; H where the step has no length, NaN where its length is not known."""
        values = np.asarray(self._core.energy(q, p)).sum(axis=1)
        some = np.flatnonzero(h != 0.0)
        try:
            values[some] = self._core.discrete_energy(q[some], p[some], h[some], self._order)
        except RuntimeError:  # CoreError is one: a step that the run had to cut in two is none to be made again
            for i in some:
                one = slice(i, i + 1)
                with contextlib.suppress(RuntimeError):
                    values[i] = np.nan
                    values[i] = self._core.discrete_energy(q[one], p[one], h[one], self._order)[0]
        return values

    def _modified(self, q: Array, p: Array) -> Array:
        return np.asarray(self._core.modified_energy(q, p, self._dt, self._order))

    @cached_property
    def _before(self) -> tuple[Array, Array, Array, Array]:
        """The part of the step that ends at each impact, see `_part`."""
        return self._part(self.events.array("p_minus"), -self.events.array("before"))

    @cached_property
    def _after(self) -> tuple[Array, Array, Array, Array]:
        """The rest of the step after each impact, see `_part`."""
        return self._part(self.events.array("p_plus"), self.events.array("after"))

    def _part(self, p: Array, h: Array) -> tuple[Array, Array, Array, Array]:
        """Return where steps h (n,) from the impacts end, q and p, and what damping does over them [J], twice.

        First its work over the whole part, h sum_j b_j P_j with the power P_j = -v_j D v_j at the Gauss stages; second
        that between the impact and E_d, which is the mean of E over the stages: h sum_ij b_i a_ij P_j, and
        sum_i b_i a_ij = b_j (1 - c_j). Negative h: where the step that ended there began. NaN where h is not known.
        """
        q, p, c, b = self.events.array("q").copy(), p.copy(), *self._gauss
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


class Excess(NamedTuple):
    """A tolerance that was exceeded: its name, the value and the bound, time [s]."""

    name: str
    value: float
    bound: float
    time: float

    def __str__(self) -> str:
        relative = " of the largest kinetic energy" if self.name in _RELATIVE else ""
        return f"{self.name} is {self.value:.3g}{relative}, more than {self.bound:.3g}"


class Watch:
    """Holds the ledger of a growing run to its tolerances, block by block."""

    def __init__(self, tolerances: Mapping[str, float]) -> None:
        self._tolerances = dict(tolerances)
        self._start: dict[str, Any] = {}
        self._lost = 0.0
        self._scale = 0.0

    def check(self, block: Ledger) -> Excess | None:
        """Return the first excess in time of a block, None where all holds.

        A block starts with the last node of the one before it, and has the events since.
        """
        nodes = np.maximum.accumulate(np.append(self._scale, block.kinetic_energy))[1:]
        hits = np.maximum.accumulate(np.append(self._scale, block.event_kinetic_energy))[1:]
        found: list[Excess] = []
        for name, bound in self._tolerances.items():
            if name in _NODE:
                time, value = block.t, self._drift(block, name)
                scale = nodes
            else:
                time, value = block.events.array("time"), _EVENT[name](block)
                scale = hits
            if name in _RELATIVE:
                value = np.divide(value, scale, out=np.where(value > 0, np.inf, 0.0), where=scale > 0)
            holds = value <= bound
            if name == "discrete_energy":
                holds |= np.isnan(value)  # of steps cut by an impact; any other NaN holds nothing
            over = np.flatnonzero(~holds)
            if len(over):
                found.append(Excess(name, float(value[over[0]]), bound, float(time[over[0]])))
        self._scale = max(self._scale, *nodes[-1:], *hits[-1:])
        self._lost += float(block.event_loss.sum())
        return min(found, key=lambda excess: excess.time, default=None)

    def _drift(self, block: Ledger, name: str) -> Array:
        """Distance of a quantity at the nodes from the start of the run, losses added back, shape (N,)."""
        value = getattr(block, name)
        if name in _RELATIVE:
            value = value + self._lost + block.loss
            known = value[np.isfinite(value)]
            if name not in self._start and len(known):
                self._start[name] = known[0]
            return np.abs(value - self._start.get(name, 0.0))
        return np.linalg.norm(value - self._start.setdefault(name, value[0]), axis=1)


_NODE = ("energy", "modified_energy", "discrete_energy", "linear_momentum", "angular_momentum")
_RELATIVE = (
    *("energy", "modified_energy", "discrete_energy"),
    *("energy_jump", "modified_energy_jump", "discrete_energy_jump", "own_jump"),
)
_EVENT: dict[str, Callable[[Ledger], Array]] = {
    "energy_jump": lambda ledger: np.abs(ledger.energy_jump),
    "modified_energy_jump": lambda ledger: np.abs(ledger.modified_energy_jump),
    "discrete_energy_jump": lambda ledger: np.abs(ledger.discrete_energy_jump),
    "own_jump": lambda ledger: np.abs(ledger.own_jump),
    "impulse": lambda ledger: -ledger.impulse,
    "complementarity": lambda ledger: np.abs(ledger.complementarity),
    "gap": lambda ledger: np.abs(ledger.gap),
    "linear_momentum_jump": lambda ledger: np.linalg.norm(ledger.linear_momentum_jump, axis=1),
    "angular_momentum_jump": lambda ledger: np.linalg.norm(ledger.angular_momentum_jump, axis=1),
}
