"""The result of a run: arrays over time, events, status, statistics."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from contactvi.errors import InputError
from contactvi.events import EventLog
from contactvi.ledger import Ledger
from contactvi.options import Options
from contactvi.status import Stats, Status

if TYPE_CHECKING:
    from contactvi.scene import Scene

Array = NDArray[np.float64]
_MAX_GAP_SAMPLES = 2000


class Trajectory:
    """A run: t (N,), q (N, nq), p (N, nv) at the recorded nodes, and what follows from them.

    q is Pinocchio's configuration, p = M(q) v the momentum of Pinocchio's tangent velocity v. v, energy and
    modified_energy are computed when first asked for and kept.

    Attributes
    ----------
    scene : the scene that was run. options : its settings.
    events : the impacts, a sequence of `Event` (an `EventLog`).
    status : how the run ended. stats : what it cost.
    forced : whether the run had inputs (control) other than zero; they are not kept.
    """

    def __init__(
        self,
        scene: Scene,
        options: Options,
        t: Array,
        q: Array,
        p: Array,
        events: EventLog,
        status: Status,
        stats: Stats,
        *,
        forced: bool = False,
        core: Any = None,
        derived: Mapping[str, Array] | None = None,
        gaps: tuple[Array, list[tuple[str, str]], Array] | None = None,
        visuals: list[Any] | None = None,
    ) -> None:
        self.scene = scene
        self.options = options
        self.t, self.q, self.p = t, q, p
        self.events = events
        self.status = status
        self.stats = stats
        self.forced = forced
        self._core = core  # the engine's scene at the time of the run: the Python scene may be edited afterwards
        self._derived: dict[str, Array] = dict(derived or {})
        self._gaps = gaps
        self._visuals = visuals
        self._ledger: Ledger | None = None

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def __repr__(self) -> str:
        return (
            f"<Trajectory: {len(self)} nodes, t = {self.t[0]:.6g} .. {self.t[-1]:.6g} s, "
            f"{len(self.events)} events, {self.status.code.name}>"
        )

    @property
    def v(self) -> Array:
        """Pinocchio's tangent velocity (body twist for a free body), shape (N, nv)."""
        return self._get("v", lambda core: core.velocity(self.q, self.p))

    @property
    def kinetic_energy(self) -> Array:
        """T [J], shape (N,)."""
        self._energies()
        return self._derived["kinetic_energy"]

    @property
    def potential_energy(self) -> Array:
        """V [J], gravity and joint springs, shape (N,)."""
        self._energies()
        return self._derived["potential_energy"]

    @property
    def energy(self) -> Array:
        """H = T + V [J], shape (N,)."""
        return self.kinetic_energy + self.potential_energy

    @property
    def modified_energy(self) -> Array:
        """The modified Hamiltonian [J] that the midpoint rule with step dt conserves to O(dt^4), shape (N,)."""
        return self._get("modified_energy", lambda core: core.modified_energy(self.q, self.p, self.options.dt))

    @property
    def ledger(self) -> Ledger:
        """What should be conserved, node by node and impact by impact (contactvi.ledger)."""
        if self._ledger is None:
            self._ledger = Ledger(
                self._engine(), self.options.dt, self.t, self.q, self.p, self.events,
                damping=self.scene.model.damping, forced=self.forced, start=float(self.t[0]),
            )  # fmt: skip
        return self._ledger

    @property
    def discrete_energy(self) -> Array:
        """E_d [J] of the step that starts at each node, NaN where an impact cuts it (and with inputs), shape (N,)."""
        return self._get("discrete_energy", lambda core: self.ledger.discrete_energy)

    @property
    def impact_energy(self) -> Array:
        """H(p_plus) - H(p_minus) of the impacts up to each node [J], shape (N,); minus the loss with CTEC."""
        return self.events.total(self.events.energy_change, self.t)

    @property
    def impact_loss(self) -> Array:
        """What restitution took up to each node (>= 0) [J], shape (N,); what every impact map takes from its scalar."""
        return self.events.total(self.events.loss, self.t)

    @property
    def visuals(self) -> list[Any]:
        """What the viewer draws: a list of `contactvi.visuals.Visual`."""
        if self._visuals is None:
            from contactvi.visuals import from_scene

            self._visuals = from_scene(self.scene)
        return self._visuals

    @property
    def gaps(self) -> tuple[Array, list[tuple[str, str]], Array]:
        """(times (M,), pairs, gaps (M, len(pairs)) [m]) of the pairs that touched, at not more than 2000 nodes."""
        if self._gaps is None:
            index = np.unique(self.events.array("index")[self.events.array("kind") == 0])
            nodes = np.unique(np.linspace(0, len(self) - 1, min(len(self), _MAX_GAP_SAMPLES)).round().astype(int))
            values = np.zeros((len(nodes), len(index)))
            if len(index):
                core = self._engine()
                for row, node in enumerate(nodes):
                    values[row] = core.gaps(self.q[node])[0][index]
            self._gaps = (self.t[nodes], [self.events.label(0, int(i)) for i in index], values)
        return self._gaps

    def at(self, t: float) -> Array:
        """Return the configuration at time t [s], interpolated between the nodes and the impacts, shape (nq,)."""
        return self.resample([t])[0]

    def resample(self, times: ArrayLike) -> Array:
        """Return the configurations at these times [s], shape (len(times), nq).

        Between two known configurations (nodes and impacts) every joint moves with constant velocity; free and planar
        bodies as R^3 x SO(3) and R^2 x SO(2), as the engine steps them. Raises InputError outside the run.
        """
        wanted = np.asarray(times, dtype=float).reshape(-1)
        slack = 1e-9 * max(1.0, abs(float(self.t[-1])))
        if not np.all((wanted >= self.t[0] - slack) & (wanted <= self.t[-1] + slack)):
            raise InputError(
                "Time outside the run",
                name="t",
                expected=f"a time in [{self.t[0]:.9g}, {self.t[-1]:.9g}] s",
                got=np.array2string(wanted, threshold=4),
            )
        known = np.concatenate([self.t, self.events.array("time")])
        known, first = np.unique(known, return_index=True)
        q = np.concatenate([self.q, self.events.array("q")])[first]
        left = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, max(0, len(known) - 2))
        result = np.empty((len(wanted), self.q.shape[1]))
        linear = _linear_entries(self.scene.model)
        for row, (time, k) in enumerate(zip(wanted, left, strict=True)):
            right = min(k + 1, len(known) - 1)
            span = known[right] - known[k]
            s = min(1.0, max(0.0, (time - known[k]) / span)) if span > 0 else 0.0
            result[row] = pin.interpolate(self.scene.model, q[k], q[right], s)
            result[row, linear] = (1.0 - s) * q[k, linear] + s * q[right, linear]
        return result

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the run as one npz file (format: contactvi.storage), whole or not at all; return its path."""
        from contactvi.storage import save

        return save(self, path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Read a run written by `save`. Raises ContactviError for anything that is not such a file."""
        from contactvi.storage import load

        return cls(**load(path))

    def to_html(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write a self-contained page that plays the run (contactvi.page.write_html); return its path."""
        from contactvi.page import write_html

        return write_html(self, path, **options)

    def _engine(self) -> Any:
        if self._core is None:
            self._core = self.scene.core()
        return self._core

    def _get(self, name: str, compute: Any) -> Array:
        if name not in self._derived:
            self._derived[name] = np.asarray(compute(self._engine()), dtype=float)
        return self._derived[name]

    def _energies(self) -> None:
        if "kinetic_energy" not in self._derived or "potential_energy" not in self._derived:
            values = np.asarray(self._engine().energy(self.q, self.p), dtype=float)
            self._derived["kinetic_energy"] = values[:, 0]
            self._derived["potential_energy"] = values[:, 1]


def _linear_entries(model: pin.Model) -> NDArray[np.int64]:
    """Return the entries of q that are Cartesian positions of free and planar bodies."""
    entries: list[int] = []
    for joint in model.joints[1:]:
        count = {"JointModelFreeFlyer": 3, "JointModelPlanar": 2}.get(joint.shortname(), 0)
        entries += range(joint.idx_q, joint.idx_q + count)
    return np.array(entries, dtype=np.int64)
