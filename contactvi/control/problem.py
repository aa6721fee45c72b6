"""A whole run through contact as a nonlinear programme: what to choose, what it costs, what it has to satisfy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from contactvi.control.evaluation import Evaluation
from contactvi.control.inputs import Inputs
from contactvi.control.terms import Constraint, InputCost, ParameterCost, Terms
from contactvi.control.variables import Variables, checked_point
from contactvi.errors import InputError, SimulationError
from contactvi.inputs import callback, short
from contactvi.scene.scene import Scene
from contactvi.simulation.settings import settings_of
from contactvi.simulation.simulation import simulate
from contactvi.simulation.targets import Targets
from contactvi.status import StatusCode
from contactvi.trajectory.compiled import checked_scene, compile_scene
from contactvi.trajectory.gradient import Cost, RunGradients
from contactvi.trajectory.hessian import CostHessian
from contactvi.trajectory.sensitivity import check_on_kink
from contactvi.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from contactvi.control.casadi_functions import CasadiProblem

Array = NDArray[np.float64]


class Problem:
    """Minimize a cost of a run over inputs, parts of the start and parameters of the scene, within constraints.

    The variables z are numbers of inputs, rows first; a tangent vector by which the start of reference is moved, of the
    free joints, q0 (+) z; velocities of free joints; and the values of parameters. All derivatives are exact: those of
    the run as it is computed, through impacts whose times and whose number are free. Where another point has another
    sequence of impacts, they jump; a solver sees that as a kink.

    Args:
        scene: the scene.
        duration, dt: of the run [s], dt a number; None: those of the scene file.
        inputs: `Inputs`, or None for none.
        q0, v0: start of reference, (nq,), (nv,); None: as `contactvi.simulate`.
        free_q0, free_v0: joints, by name, handle or pattern, whose place and whose velocity at the start are variables.
        parameters: names of `Scene.parameter`, which are variables.
        cost: function (t, q, v) -> (J, dJ/dq, dJ/dv) as for contactvi.gradient, or None.
        input_cost: function u (rows, nu) -> (J, dJ/du), such as `quadratic(weights)`.
        parameter_cost: function of {name: value} -> (J, {name: gradient}); those without a gradient have none.
        constraints: a sequence of `Constraint`.
        bounds: {block: (lower, upper)}, each a number, or numbers that fit the block; blocks are "inputs" (also
            "limits": those of effort and position of the model), "q0", "v0" and the names of parameters.
            Restitution is within [0, 1], friction, stiffness, damping, armature and gains are not negative anyway.
        hessp: the second derivative of `cost`, as for contactvi.hessian_vector, if it is known.
        on_kink: as for contactvi.gradient.
        options: of the run, as for contactvi.simulate: order, impact, solver_tol, dt_contact, ...

    Attributes:
        variables: the layout of z: `blocks` (name -> slice), `names`, `z0` (what is not chosen).
        lower, upper: bounds of z, shapes (n,).
        runs: how many runs were made.

    Raises:
        InputError: for bad arguments.
    """

    def __init__(
        self,
        scene: Scene,
        duration: float | None = None,
        dt: float | None = None,
        *,
        inputs: Inputs | None = None,
        q0: Any = None,
        v0: Any = None,
        free_q0: Any = (),
        free_v0: Any = (),
        parameters: Sequence[str] = (),
        cost: Cost | None = None,
        input_cost: InputCost | None = None,
        parameter_cost: ParameterCost | None = None,
        constraints: Sequence[Constraint] = (),
        bounds: Mapping[str, Any] | None = None,
        hessp: CostHessian | None = None,
        on_kink: str = "raise",
        **options: Any,
    ) -> None:
        check_on_kink(on_kink)
        self.scene = checked_scene(scene).copy()
        chosen = {**options, "duration": duration, "dt": dt, "record": "gradient"}
        self.options = settings_of(self.scene, chosen, forced=True)
        self._given = chosen | {"dt": self.options.fixed_dt, "duration": self.options.span}
        grid = None if inputs is None else _checked(inputs, self.scene).over(self.options.steps, self.options.fixed_dt)
        self.variables = Variables(self.scene, q0, v0, inputs, grid, free_q0, free_v0, parameters)
        for name, function in (("input_cost", input_cost), ("parameter_cost", parameter_cost)):
            callback(name, function)
        if input_cost is not None and inputs is None:
            raise InputError(
                "There are no inputs that cost anything", name="input_cost", expected="inputs=Inputs(...)", got="None",
                remedy="Give inputs, or leave input_cost out",
            )  # fmt: skip
        self.terms = Terms(cost, input_cost, parameter_cost, _constraints(constraints))
        self.lower, self.upper = self.variables.bounds(bounds or {})
        self.hessp, self._on_kink = hessp, on_kink
        self.runs = 0
        self._base = self._references()
        self._last: Evaluation | None = None

    # --- points -------------------------------------------------------------------------------------------------------

    @property
    def z0(self) -> Array:
        """The point without a choice, moved into the bounds: no torques, references and a start as they are."""
        return np.clip(self.variables.z0, self.lower, self.upper)

    def pack(self, values: Mapping[str, Any]) -> Array:
        """Return z with the values given by block, others as in `z0`; one row of inputs stands for all."""
        return self.variables.pack(values, self.z0)

    def unpack(self, z: Any) -> dict[str, Array]:
        """Return the values of z by block; inputs have shape (rows, nu)."""
        return self.variables.split(checked_point(self.variables, z))

    # --- values and derivatives ---------------------------------------------------------------------------------------

    def simulate(self, z: Any) -> Trajectory:
        """Return the run at z, with record="gradient"; raises what contactvi.simulate raises."""
        return self._run(checked_point(self.variables, z))

    def evaluate(self, z: Any) -> Evaluation:
        """Return the problem at z. The last point is kept: asked again, it costs nothing.

        Raises:
            SimulationError, PenetrationError, NotDifferentiable, InputError: where there is no run, or a run without
                derivative. KeyboardInterrupt: Ctrl-C.
        """
        z = checked_point(self.variables, z)
        if self._last is not None and np.array_equal(self._last.z, z):
            return self._last
        traj = self._run(z)
        compiled = compile_scene(traj.scene)
        terms = self.terms.at(traj, compiled, self.variables.split(z))
        gradients = RunGradients(traj, compiled, self.variables.wrt, self._on_kink)
        self._last = Evaluation(z, traj, terms, self.variables, gradients)
        return self._last

    def hessian_product(self, z: Any, w: Any) -> Array:
        """Return the second derivative of the cost at z times w (n,), exact where contactvi.hessian_vector is.

        Elsewhere it is Gauss-Newton's. Constraints have no part in it.

        Raises:
            InputError: `hessp` is not given, or a cost has none; the free start turns in space.
        """
        self.check_second()
        at, w = self.evaluate(z), checked_point(self.variables, w)
        values, found = self.variables.split(at.z), np.zeros(len(w))
        if self.terms.cost is not None:
            assert self.hessp is not None
            direction = self.variables.along(values, w)
            product = at.trajectory.hessian_vector(
                self.terms.cost, direction, self.variables.wrt, hessp=self.hessp, method="auto", on_kink=self._on_kink
            )
            found += self.variables.gradient(values, product.product)
        if self.terms.input_cost is not None:
            own = self.terms.input_cost.hessp(values["inputs"], self.variables.split(w)["inputs"])  # type: ignore[attr-defined]
            found[self.variables.blocks["inputs"]] += np.asarray(own).ravel()
        return found

    def check_second(self) -> None:
        """Raise InputError where the second derivative of the cost is not known."""
        missing = self.second_missing()
        if missing is not None:
            raise InputError(
                "The second derivative of the cost is not known", name="hessp", expected="that of every cost",
                got=missing, remedy="Give it, or use a method that needs none, such as 'L-BFGS-B'",
            )  # fmt: skip

    def second_missing(self) -> str | None:
        """Return why there is no second derivative of the cost; None where there is one."""
        if self.terms.cost is not None and self.hessp is None:
            return "hessp=None"
        if self.terms.input_cost is not None and not hasattr(self.terms.input_cost, "hessp"):
            return "an input_cost without a method hessp(u, du)"
        if self.terms.parameter_cost is not None:
            return "a parameter_cost"
        joint = self.variables.curved()
        return None if joint is None else f"a free start of {joint!r}, whose coordinates do not add"

    # --- solvers ------------------------------------------------------------------------------------------------------

    def minimize(self, z0: Any = None, method: str | None = None, *, on_failure: str = "raise", **options: Any) -> Any:
        """Minimize by scipy.optimize.minimize; see contactvi.control.scipy_solvers.minimize."""
        from contactvi.control.scipy_solvers import minimize

        return minimize(self, z0, method, on_failure=on_failure, **options)

    def nlp(self, z0: Any = None) -> CasadiProblem:
        """Return the problem for casadi.nlpsol, IPOPT among them (needs `pip install "contactvi[casadi]"`)."""
        from contactvi.control.casadi_functions import CasadiProblem

        return CasadiProblem(self, z0)

    # --- helpers ------------------------------------------------------------------------------------------------------

    def _run(self, z: Array) -> Trajectory:
        values, grid = self.variables.split(z), self.variables.grid
        scene, (q, v) = self.variables.scene(values), self.variables.start(values)
        control = None if grid is None else grid.control(values["inputs"])
        target = self._base if grid is None or self._base is None else grid.target(values["inputs"], self._base)
        self.runs += 1
        try:
            return simulate(scene, q, v, control=control, target=target, **self._given)
        except SimulationError as error:
            if error.status is not None and error.status.code == StatusCode.INTERRUPTED:
                raise KeyboardInterrupt from error
            raise

    def _references(self) -> Array | None:
        """Return the references of all servos in the steps that are not chosen, (steps, 2 n)."""
        targets = Targets(compile_scene(self.scene), self.variables.q0)
        if not targets.joints:
            return None
        steps, nv = self.options.steps, len(self.variables.v0)
        rows = targets.rows(None, self.options.fixed_dt * np.arange(steps, dtype=np.float64))
        assert rows is not None
        dofs = [self.scene.v_index(joint).start for joint in targets.joints]
        return np.hstack([rows[:, dofs], rows[:, [nv + dof for dof in dofs]]])


def _checked(inputs: Any, scene: Scene) -> Inputs:
    if not isinstance(inputs, Inputs):
        raise InputError(
            "These are no inputs of a problem", name="inputs", expected="contactvi.control.Inputs, or None",
            got=short(inputs), remedy="For example inputs=Inputs(scene, torques='*', hold=5)",
        )  # fmt: skip
    inputs.check(scene)
    return inputs


def _constraints(given: Any) -> tuple[Constraint, ...]:
    found = tuple(given) if isinstance(given, (list, tuple)) else (given,)
    for constraint in found:
        if not isinstance(constraint, Constraint):
            raise InputError(
                "This is no constraint", name="constraints", expected="a list of contactvi.control.Constraint",
                got=short(constraint), remedy="Wrap the function: Constraint(function, lower, upper)",
            )  # fmt: skip
    return found
