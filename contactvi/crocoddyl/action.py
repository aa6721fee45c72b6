"""An interval of a scene as crocoddyl's action."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import crocoddyl
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from contactvi.control.drives import Drives
from contactvi.control.interval import Interval
from contactvi.crocoddyl.residuals import BUILT_WITH, reads_pinocchio
from contactvi.errors import InputError
from contactvi.inputs import check_choice, short
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]


class Failure(NamedTuple):
    """An error, and where it came: in "calc" or "calcDiff"."""

    where: str
    error: BaseException


class ActionData(crocoddyl.ActionDataAbstract):
    """What an action keeps of its last calc.

    Attributes:
        trajectory: the run of the interval; None before calc, and where it failed. impacts: their number in it.
    """

    def __init__(self, model: ActionModel) -> None:
        crocoddyl.ActionDataAbstract.__init__(self, model)
        # Costs can be added to a sum at any time: they are looked at when they get their data.
        residuals = [] if model.costs is None else [item.data().cost.residual for item in model.costs.costs]
        _check_memory(residuals)
        own = model.interval.model.createData() if any(map(reads_pinocchio, residuals)) else None
        self.pinocchio, self.shared = own, _collector(own)
        self.costs: Any = None if model.costs is None else model.costs.createData(self.shared)
        self.trajectory: Trajectory | None = None
        self.at: tuple[Array, Array] | None = None  # the x and u of the last calc

    @property
    def impacts(self) -> int:
        return 0 if self.trajectory is None else len(self.trajectory.events)


class ActionModel(crocoddyl.ActionModelAbstract):
    """One interval of a scene: x = (q, v) on the configuration manifold, `steps` steps of dt with constant u.

    As in crocoddyl's integrated models, a running cost is that of the start of the interval times its length, and a
    terminal cost (a node without u) is taken as it is.

    Args:
        scene: the scene. Actuators must have no limits in it; bounds on u are the solver's (Box-FDDP).
        dt: step [s]. steps: steps in the interval.
        costs: crocoddyl.CostModelSum with nu entries of u; its state is that of the action. Residuals of the state and
            of the control are crocoddyl's; those of frames, centre of mass and momentum are this package's, under the
            same names, as long as crocoddyl's wheels are built with another version of Pinocchio.
        torques, targets: what u does (contactvi.control.Drives). By default u are the generalized forces of all joints.
        bounds: "model", the efforts and positions of the model, or (lower, upper), each a number or of shape (nu,);
            None: no bounds. Only solvers with bounds (Box-FDDP, Box-DDP) use them.
        t: time at the start of the interval [s], for scenes in which something depends on it.
        on_kink: as for Sensitivity.
        options: of the run, as for `simulate`: order, impact, solver_tol, contact_mode, ...

    Raises:
        InputError: for bad arguments, and costs of another model or number of inputs.

    Attributes:
        drives, interval: what u does, and the steps as a map. costs, t, steps: as given.
        failures: errors of calc and calcDiff, in their order. No exception may pass through the parallel loops of
            crocoddyl's solvers, so calc gives the cost NaN instead, upon which they take a shorter step, and calcDiff a
            matrix of NaN, upon which they end. `solve` of this module raises what came of calcDiff.
    """

    def __init__(
        self, scene: Scene, dt: float, *, steps: int = 1, costs: Any = None, torques: Any = None, targets: Any = (),
        bounds: Any = None, t: float = 0.0, on_kink: str = "raise", **options: Any,
    ) -> None:  # fmt: skip
        settings = {"torques": torques, "targets": targets, "on_kink": on_kink, **options}
        self._given = scene.copy(), dt, {"costs": costs, "bounds": bounds, **settings}
        self.t, self.steps = t, steps
        self.drives = Drives(scene, torques, targets)
        self.interval = Interval(scene, dt, self.drives, steps=steps, t=t, on_kink=on_kink, **options)
        self.costs = costs
        if costs is not None:
            _check_costs(costs, self.interval, self.drives.nu)
        state = crocoddyl.StateMultibody(self.interval.model) if costs is None else costs.state
        crocoddyl.ActionModelAbstract.__init__(self, state, self.drives.nu, 1 if costs is None else costs.nr)
        self.failures: list[Failure] = []
        if bounds is not None:
            given = (self.drives.lower, self.drives.upper) if isinstance(bounds, str) else bounds
            self.u_lb, self.u_ub = _bounds(bounds, given, self.drives.nu)

    def longer(self, steps: int) -> ActionModel:
        """Return the action of an interval that begins at the same time and has so many steps."""
        scene, dt, settings = self._given
        return ActionModel(scene, dt, steps=steps, t=self.t, **settings)

    def createData(self) -> ActionData:
        return ActionData(self)

    def calc(self, data: ActionData, x: Array, u: Array | None = None) -> None:
        """Make the steps: data.xnext and data.cost."""
        with self._guarded(data, "calc"):
            q, v = self._split(x)
            data.cost = self._cost(data, q, v, x, u) * (1.0 if u is None else self.interval.span)
            if u is None:
                return
            self._advance(data, x, u)

    def calcDiff(self, data: ActionData, x: Array, u: Array | None = None) -> None:
        """Give the derivatives of what calc made at (x, u)."""
        with self._guarded(data, "calcDiff"):
            q, v = self._split(x)
            self._cost_derivatives(data, q, v, x, u)
            if u is None:
                return
            if data.at is None or not (np.array_equal(data.at[0], x) and np.array_equal(data.at[1], u)):
                self._advance(data, x, u)
            assert data.trajectory is not None
            data.Fx, data.Fu = self.interval.derivatives(data.trajectory)

    def _advance(self, data: ActionData, x: Array, u: Array) -> None:
        data.at = None
        data.trajectory = run = self.interval.run(*self._split(x), np.array(u))
        data.at = np.array(x), np.array(u)
        data.xnext = np.concatenate([run.q[-1], run.v[-1]])

    @contextlib.contextmanager
    def _guarded(self, data: ActionData, where: str) -> Iterator[None]:
        try:
            yield
        except BaseException as error:
            self.failures.append(Failure(where, error))
            data.cost, data.trajectory, data.at = np.nan, None, None
            data.Fx = np.full_like(data.Fx, np.nan)

    def _split(self, x: Array) -> tuple[Array, Array]:
        return np.array(x[: self.interval.nq]), np.array(x[self.interval.nq :])

    def _cost(self, data: ActionData, q: Array, v: Array, x: Array, u: Array | None) -> float:
        if self.costs is None:
            return 0.0
        if data.pinocchio is not None:
            pin.computeAllTerms(self.interval.model, data.pinocchio, q, v)
            pin.updateFramePlacements(self.interval.model, data.pinocchio)
        self.costs.calc(data.costs, *([x] if u is None else [x, u]))
        return float(data.costs.cost)

    def _cost_derivatives(self, data: ActionData, q: Array, v: Array, x: Array, u: Array | None) -> None:
        if self.costs is None:
            return
        self._cost(data, q, v, x, u)
        if data.pinocchio is not None:
            pin.computeRNEADerivatives(self.interval.model, data.pinocchio, q, v, np.zeros(self.interval.nv))
        self.costs.calcDiff(data.costs, *([x] if u is None else [x, u]))
        scale, costs = 1.0 if u is None else self.interval.span, data.costs
        data.Lx, data.Lxx = scale * costs.Lx, scale * costs.Lxx
        if u is not None:
            data.Lu, data.Luu, data.Lxu = scale * costs.Lu, scale * costs.Luu, scale * costs.Lxu


def _check_memory(residuals: list[Any]) -> None:
    """Raise InputError for residuals that would end the process."""
    for residual in residuals:
        name = type(residual).__name__
        if reads_pinocchio(residual) and BUILT_WITH.get(crocoddyl.__version__, pin.__version__) != pin.__version__:
            raise InputError(
                f"crocoddyl's {name} reads the memory of another version of Pinocchio", name="costs",
                expected=f"residuals for Pinocchio {pin.__version__}",
                got=f"one built with {BUILT_WITH[crocoddyl.__version__]}",
                remedy=f"Use contactvi.crocoddyl.{name}, which takes the same arguments, or one of your own in Python",
            )  # fmt: skip


def _collector(data: pin.Data | None) -> Any:
    """Return what gives the residuals of crocoddyl's own the data of Pinocchio, where there are any."""
    return crocoddyl.DataCollectorAbstract() if data is None else crocoddyl.DataCollectorMultibody(data)


def _check_costs(costs: Any, interval: Interval, nu: int) -> None:
    if not isinstance(costs, crocoddyl.CostModelSum):
        raise InputError(
            "These are no costs", name="costs", expected="a crocoddyl.CostModelSum", got=short(costs),
            remedy="crocoddyl.CostModelSum(crocoddyl.StateMultibody(scene.model), nu)",
        )  # fmt: skip
    state = costs.state
    if (state.nq, state.nv, costs.nu) != (interval.nq, interval.nv, nu) or not hasattr(state, "pinocchio"):
        raise InputError(
            "The costs are those of another action", name="costs",
            expected=f"a StateMultibody of the scene's model (nq = {interval.nq}, nv = {interval.nv}) and nu = {nu}",
            got=f"{type(state).__name__} with nq = {state.nq}, nv = {state.nv}, and nu = {costs.nu}",
            remedy="crocoddyl.CostModelSum(crocoddyl.StateMultibody(scene.model), nu)",
        )  # fmt: skip


def _bounds(bounds: Any, pair: Any, nu: int) -> tuple[Array, Array]:
    if isinstance(bounds, str):
        check_choice("bounds", bounds, ("model",), "Unknown bounds")
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError(
            "These are no bounds", name="bounds", expected="'model', or (lower, upper)", got=short(bounds),
            remedy="For example bounds=(-10.0, 10.0)",
        )  # fmt: skip
    lower, upper = (np.array(np.broadcast_to(np.asarray(part, dtype=float), nu)) for part in pair)
    if not np.all(lower <= upper):
        raise InputError(
            "Bounds out of order", name="bounds", expected="lower <= upper", got=short(bounds), remedy="Exchange them",
        )  # fmt: skip
    return lower, upper
