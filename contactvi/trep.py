"""One step of a scene as a discrete system x[k+1] = f(x[k], u[k], k), under the names of trep's `DSystem`.

For people who come from trep (Murphey Lab): docs/coming_from_trep.md. There is no optimiser here; f and its derivatives
are what optimisers ask for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contactvi import inputs as checks
from contactvi.derivatives.lqr import LqrSolution as LqrSolution
from contactvi.derivatives.lqr import Weight
from contactvi.derivatives.lqr import solve_tv_lqr as solve_tv_lqr
from contactvi.derivatives.state_vectors import StatesAndInputs, StateVectors
from contactvi.derivatives.state_vectors import rows_of as _rows
from contactvi.derivatives.step_map import Step, StepMap
from contactvi.errors import InputError, SimulationError

if TYPE_CHECKING:
    from contactvi.scene.scene import Scene

Array = NDArray[np.float64]

UNIFORM = 1e-9  # of a step: times that differ from those of equal steps by no more are such


class TangentTrajectory(NamedTuple):
    """Changes of states (N, ndX) and of inputs (N - 1, nU)."""

    dX: Array
    dU: Array


class Linearization(NamedTuple):
    """A (N - 1, ndX, ndX) and B (N - 1, ndX, nU) of the steps of a trajectory."""

    A: Array
    B: Array


class Feedback(NamedTuple):
    """Gains K (N - 1, nU, ndX), and the linearization that they are for."""

    Kproj: Array
    A: Array
    B: Array


class Comparison(NamedTuple):
    """How far exact derivatives are from differences: Frobenius norms."""

    error: float
    exact_norm: float
    approx_norm: float


class DiscreteSystem(StateVectors):
    """The steps of a scene as x[k+1] = f(x[k], u[k], k), with exact derivatives; the names are those of trep's DSystem.

    The state x is (q, p): the configuration in Pinocchio's numbers (nq,) and the momenta p = M(q) v (nv,); with
    state="velocity" it is (q, v). trep's state has a third part, the speeds of kinematic configurations; here every
    joint has a momentum. Changes of states, and so the columns and rows of derivatives, have ndX = 2 nv numbers:
    tangent vectors of Pinocchio at q, then changes of p. That is nX where configurations are vectors.

    The input is (u, rho): generalized forces of the joints `inputs` [N, N m], and targets of the servos of the joints
    `targets` [rad, m], both constant over a step. trep's rho are configurations that a motor holds exactly; here a
    servo pulls its joint there with kp (Scene.set_servo), which has exact derivatives. A joint with
    Scene.prescribe moves as a function of time and is no input; x must then be on that motion.

    f is what one step of contactvi.Simulator from x gives, with the impacts in it; what a run remembers besides its
    state (which contacts stick, where) begins anew in each step. First derivatives go through impacts; second ones
    are exact for smooth steps and impacts without friction with impact="ctec", else NotDifferentiable.

    Args:
        scene: the scene.
        t: times of the states [s], shape (N,), at equal steps; or give dt, steps and t0.
        dt: step [s]. steps: their number, N - 1. t0: time of the first state [s].
        order: of the integrator, 2, 4, ... 16; 2 is trep's midpoint rule.
        state: "momentum" or "velocity".
        inputs: names of the joints whose forces are inputs; None: all. targets: names of those whose targets are.
        options: further options of contactvi.Simulator, such as impact.
    """

    def __init__(
        self,
        scene: Scene,
        t: ArrayLike | None = None,
        *,
        dt: float | None = None,
        steps: int | None = None,
        t0: float = 0.0,
        order: int = 2,
        state: str = "momentum",
        inputs: Sequence[str] | None = None,
        targets: Sequence[str] = (),
        **options: Any,
    ) -> None:
        time = _times(t, dt, steps, t0)
        step = float(time[-1] - time[0]) / (len(time) - 1) if dt is None else float(dt)
        self._steps = StepMap(scene, step, order, state, options)
        super().__init__(scene, time, state, inputs, targets)
        self._step: Step | None = None
        self._second: tuple[Array, Array] | None = None
        self._k = 0

    def kf(self) -> int:
        """Return the index of the last state, which is the number of steps."""
        return len(self.time) - 1

    @property
    def k(self) -> int:
        """Index of the present state."""
        return self._k

    @property
    def xk(self) -> Array:
        """The present state (nX,)."""
        self._made()
        return self._state.copy()

    @property
    def uk(self) -> Array:
        """The present input (nU,)."""
        self._made()
        return self._input.copy()

    def set(self, xk: ArrayLike, uk: ArrayLike, k: int) -> None:
        """Put the system to the state xk with the input uk at time[k]; the step is made when something is asked for.

        Raises:
            InputError: for arguments of the wrong shape or range. f() and the derivatives raise PenetrationError and
                ConstraintError where x is no start of a run, SimulationError where the step cannot be made.
        """
        if isinstance(k, bool) or not isinstance(k, (int, np.integer)) or not 0 <= k < self.kf():
            raise InputError(
                "No step begins there", name="k", expected=f"a whole number from 0 to {self.kf() - 1}",
                got=checks.short(k), remedy="There is one step less than there are times",
            )  # fmt: skip
        x, u = self.checked_state(xk), self.checked_input(uk)
        tau = self.acts[:, self.forces] @ u[self.forces]
        self._step = self._steps.at(x[: self.nQ], x[self.nQ :], tau, self.target(u), float(self.time[k]))
        self._state, self._input, self._k, self._second = x, u, int(k), None

    def step(self, uk: ArrayLike) -> None:
        """Go on to the next state, with the input uk there."""
        self.set(self.f(), uk, self._k + 1)

    def f(self) -> Array:
        """Return the next state (nX,)."""
        return np.concatenate(self._made().end)

    def fdx(self) -> Array:
        """Return the derivative of f by the state, shape (ndX, ndX)."""
        return self._made().first[0].copy()

    def fdu(self) -> Array:
        """Return the derivative of f by the input, shape (ndX, nU)."""
        return np.asarray(self._made().first[1] @ self.acts)

    def fdxdx(self, z: ArrayLike) -> Array:
        """Return the second derivative of z^T f by the state, shape (ndX, ndX); z of shape (ndX,)."""
        return self._curved(z)[: self.ndX, : self.ndX].copy()

    def fdxdu(self, z: ArrayLike) -> Array:
        """Return the second derivative of z^T f by state and input, shape (ndX, nU)."""
        return self._curved(z)[: self.ndX, self.ndX :].copy()

    def fdudu(self, z: ArrayLike) -> Array:
        """Return the second derivative of z^T f by the input, shape (nU, nU)."""
        return self._curved(z)[self.ndX :, self.ndX :].copy()

    def simulate(self, x0: ArrayLike, U: ArrayLike) -> StatesAndInputs:
        """Return the states that follow from x0 under the inputs U (steps, nU), and U."""
        values = _rows("U", U, self.nU)
        X = [self.checked_state(x0)]
        for k, u in enumerate(values):
            self.set(X[-1], u, k)
            X.append(self.f())
        return StatesAndInputs(np.array(X), values)

    def linearize_trajectory(self, X: ArrayLike, U: ArrayLike) -> Linearization:
        """Return A and B of the step from each state of X with its input; X need not be a motion of the system."""
        states, values = self._trajectory(X, U)
        pairs = []
        for k, u in enumerate(values):
            self.set(states[k], u, k)
            pairs.append((self.fdx(), self.fdu()))
        return Linearization(np.array([a for a, _ in pairs]), np.array([b for _, b in pairs]))

    def project(self, bX: ArrayLike, bU: ArrayLike, Kproj: ArrayLike | None = None) -> StatesAndInputs:
        """Return the motion that follows (bX, bU) by feedback, U[k] = bU[k] - Kproj[k] (X[k] - bX[k]), X[0] = bX[0].

        X - bX is `difference`. Kproj None: that of calc_feedback_controller along (bX, bU).
        """
        wanted, values = self._trajectory(bX, bU)
        gains = self.calc_feedback_controller(wanted, values).Kproj if Kproj is None else self._gains(Kproj, values)
        X, U = [wanted[0]], []
        for k, u in enumerate(values):
            U.append(u - gains[k] @ self.difference(wanted[k], X[k]))
            self.set(X[k], U[k], k)
            X.append(self.f())
        return StatesAndInputs(np.array(X), np.array(U))

    def dproject(self, A: ArrayLike, B: ArrayLike, bdX: ArrayLike, bdU: ArrayLike, K: ArrayLike) -> TangentTrajectory:
        """Return the change of the projected motion along (bdX, bdU), in the linearization (A, B)."""
        changes, values = _rows("bdX", bdX, self.ndX), _rows("bdU", bdU, self.nU)
        gains, linear = self._gains(K, values), Linearization(np.asarray(A, float), np.asarray(B, float))
        dX, dU = [changes[0]], []
        for k, du in enumerate(values):
            dU.append(du - gains[k] @ (dX[k] - changes[k]))
            dX.append(linear.A[k] @ dX[k] + linear.B[k] @ dU[k])
        return TangentTrajectory(np.array(dX), np.array(dU))

    def calc_feedback_controller(
        self, X: ArrayLike, U: ArrayLike, Q: Weight | None = None, R: Weight | None = None, end: str | ArrayLike = "Q"
    ) -> Feedback:
        """Return the gains of the time-varying LQR problem of the linearization along (X, U).

        Q, R, end: as for solve_tv_lqr, by default identities.
        """
        A, B = self.linearize_trajectory(X, U)
        weights = np.eye(self.ndX) if Q is None else Q, np.eye(self.nU) if R is None else R
        return Feedback(solve_tv_lqr(A, B, *weights, end=end).K, A, B)

    def convert_trajectory(self, other: DiscreteSystem, X: ArrayLike, U: ArrayLike) -> StatesAndInputs:
        """Return states and inputs of another system with the joints and inputs that this one has too, by name.

        What the other one lacks is neutral, at rest and zero here. What is returned need not be a motion.
        """
        given, own = other.split_trajectory(X, U), self.split_trajectory()
        for name in set(self.scene.names.by_joint) & set(other.scene.names.by_joint):
            own.Q[:, self.scene.q_index(name)] = given.Q[:, other.scene.q_index(name)]
            own.v[:, self.scene.v_index(name)] = given.v[:, other.scene.v_index(name)]
        names = other.input_names
        values = np.zeros((len(own.u), self.nU))
        for column, name in enumerate(self.input_names):
            if name in names:
                values[:, column] = np.asarray(U)[:, names.index(name)]
        return StatesAndInputs(self.build_trajectory(own.Q, v=own.v).X, values)

    def check_fdx(self, xk: ArrayLike, uk: ArrayLike, k: int, delta: float = 1e-5) -> Comparison:
        """Compare fdx with central differences of f."""
        return self._check(self.fdx, self._from_end, "x", (xk, uk, k), delta)

    def check_fdu(self, xk: ArrayLike, uk: ArrayLike, k: int, delta: float = 1e-5) -> Comparison:
        """Compare fdu with central differences of f."""
        return self._check(self.fdu, self._from_end, "u", (xk, uk, k), delta)

    def check_fdxdx(self, xk: ArrayLike, uk: ArrayLike, k: int, delta: float = 1e-5) -> Comparison:
        """Compare fdxdx with central differences of fdx."""
        return self._check(self._each(self.fdxdx), self._slopes_in_x, "x", (xk, uk, k), delta)

    def check_fdxdu(self, xk: ArrayLike, uk: ArrayLike, k: int, delta: float = 1e-5) -> Comparison:
        """Compare fdxdu with central differences of fdx."""
        return self._check(self._each(self.fdxdu), self._slopes_in_x, "u", (xk, uk, k), delta)

    def check_fdudu(self, xk: ArrayLike, uk: ArrayLike, k: int, delta: float = 1e-5) -> Comparison:
        """Compare fdudu with central differences of fdu."""
        return self._check(self._each(self.fdudu), self._slopes_in_u, "u", (xk, uk, k), delta)

    def _check(
        self, exact: Callable[[], Array], value: Callable[[Array, Array], Array], by: str,
        at: tuple[ArrayLike, ArrayLike, int], delta: float,
    ) -> Comparison:  # fmt: skip
        """Compare a derivative with differences of value(end, dx), end being f at the place and dx how far it is left.

        Values are in the coordinates of changes at the place and at its end, so that configurations need no vectors.
        """
        self.set(*at)
        x, u, end, known = self._state, self._input, self.f(), exact()
        columns = []
        for change in delta * np.eye(self.ndX if by == "x" else self.nU):
            sides = []
            for way in (1.0, -1.0):
                dx = way * change if by == "x" else np.zeros(self.ndX)
                self.set(self.integrate(x, dx), u if by == "x" else u + way * change, at[2])
                sides.append(value(end, dx))
            columns.append((sides[0] - sides[1]) / (2.0 * delta))
        approx = np.stack(columns, axis=-1)
        self.set(*at)
        return Comparison(*(float(np.linalg.norm(part)) for part in (known - approx, known, approx)))

    def _each(self, second: Callable[[Array], Array]) -> Callable[[], Array]:
        return lambda: np.array([second(z) for z in np.eye(self.ndX)])

    def _from_end(self, end: Array, dx: Array) -> Array:
        return self.difference(end, self.f())

    def _slopes_in_x(self, end: Array, dx: Array) -> Array:
        begin = self.integrate(self._state, -dx)
        return np.asarray(self.d_difference(end, self.f()) @ self.fdx() @ self.d_integrate(begin, dx))

    def _slopes_in_u(self, end: Array, dx: Array) -> Array:
        return np.asarray(self.d_difference(end, self.f()) @ self.fdu())

    def _made(self) -> Step:
        if self._step is None:
            raise SimulationError(
                "The system has no state yet", expected="a state and an input to step from", got="none",
                remedy="Call set(xk, uk, k) first",
            )  # fmt: skip
        return self._step

    def _curved(self, z: ArrayLike) -> Array:
        """Return the second derivative of z^T f in state and input; that of the last z is kept."""
        along = checks.array("z", z, (self.ndX,), "one number per row of fdx")
        if self._second is None or not np.array_equal(self._second[0], along):
            self._second = along, self._made().second(along, self.acts)
        return self._second[1]

    def _trajectory(self, X: Any, U: Any) -> tuple[Array, Array]:
        values = _rows("U", U, self.nU)
        return checks.array("X", X, (len(values) + 1, self.nX), "one state more than inputs"), values

    def _gains(self, K: Any, U: Array) -> Array:
        return checks.array("K", K, (len(U), self.nU, self.ndX), "one matrix of gains per input")


def _times(t: Any, dt: Any, steps: Any, t0: Any) -> Array:
    """Return the times of the states, (N,)."""
    if (t is None) == (dt is None):
        raise InputError(
            "The times of the states", name="t", expected="t, or dt with steps",
            got="none" if dt is None else "both",
            remedy="For example t=np.linspace(0, 1, 101), or dt=0.01, steps=100",
        )  # fmt: skip
    if t is None:
        step = checks.positive("dt", dt, "the step in seconds, > 0")
        return np.asarray(checks.real("t0", t0) + step * np.arange(checks.count("steps", steps) + 1.0))
    numbers = checks.real_numbers(t)
    count = len(numbers) if numbers is not None and numbers.ndim == 1 else 2
    time = checks.array("t", t, (max(count, 2),), "two times or more")
    equal = np.linspace(time[0], time[-1], len(time))
    step = float(equal[1] - equal[0])
    if step <= 0.0 or np.abs(time - equal).max() > UNIFORM * step * len(time):
        raise InputError(
            "The steps are not equal", name="t", expected="times at equal steps > 0",
            got=f"steps from {np.diff(time).min():.6g} to {np.diff(time).max():.6g} s",
            remedy="Make one system per step length: cost and feedback may span several",
        )  # fmt: skip
    return time
