"""
Engine of contactvi. Checks sizes only: users go through the Python face.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy
from numpy.typing import NDArray


class CoreError(RuntimeError):
    pass

class Scene:
    def __init__(self, model: bytes, geometry: bytes, pair_restitution: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], stiffness: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rest: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], damping: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], limits: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], limit_restitution: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair_friction: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None) -> None:
        """
        From the binary archives of a pin.Model and a collision pin.GeometryModel and per joint and pair data.
        """

    @property
    def nq(self) -> int: ...

    @property
    def nv(self) -> int: ...

    @property
    def njoints(self) -> int: ...

    @property
    def npairs(self) -> int: ...

    @property
    def rounding(self) -> list[float]:
        """Rounding radius [m] of each pair's shapes, 0 where they are sharp."""

    def velocity(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> object:
        """v = M(q)^-1 p, shapes (N, nq), (N, nv) -> (N, nv)."""

    def momentum(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> object:
        """p = M(q) v, shapes (N, nq), (N, nv) -> (N, nv)."""

    def energy(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> object:
        """Kinetic and potential energy [J], (N, 2)."""

    def modified_energy(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], h: float, order: int = 2) -> object:
        """Modified Hamiltonian [J] for step h, (N,); H for order >= 4."""

    def discrete_energy(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], h: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], order: int = 2) -> object:
        """E_d [J] of one step h (N,) from each state, (N,)."""

    def spatial_momentum(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> object:
        """Total linear, angular momentum about the origin, (N, 6)."""

    def dynamics(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]:
        """(M v, dT/dq - dV/dq of gravity) in engine coordinates."""

    def step(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], h: float, tau: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, tol: float = 1e-12, order: int = 2) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], int, float]:
        """
        One smooth step without contact: (q1, p1, stage velocities (s, nv) in engine coordinates, sweeps, residual).
        """

    def gaps(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
        """(gap (npairs,), normal, point_a, point_b (npairs, 3)), world frame."""

    def gap_gradients(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """d(gap)/dq of all guards, pairs then limits, (nguards, nv)."""

    def to_engine(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def to_public(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def momentum_to_engine(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def momentum_to_public(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def set_dry_friction(self, limits: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """Largest dry friction of each dof [N; N m], (nv,)."""

    def add_joint_potential(self, joint: int, rest: float, coefficients: Sequence[float]) -> None:
        """V = sum_k c[k] x^(k+2), x = q - rest."""

    def add_path_spring(self, joints: Sequence[int], points: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], stiffness: float, rest_length: float, damping: float, tension_only: bool) -> None:
        """Along a line through points (n, 3) in the frames of joints."""

    def add_wrench(self, joint: int, point: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], R: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')] | None, wrench: object) -> None:
        """
        (force, torque) (6,) or a function of t, in the axes R of the joint's frame, or None: of the world.
        """

    def add_user_force(self, value: object, derivatives: object | None = None) -> None:
        """value(t, q, v) -> (nv,)."""

    def add_user_potential(self, value: object, gradient: object, hessian: object | None = None) -> None:
        """value(q) [J], gradient(q) -> (nv,)."""

    def add_constraint(self, kind: str, joint_a: int, R_a: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')] | None, p_a: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], joint_b: int, R_b: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')] | None, p_b: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], numbers: Sequence[float], signal: object | None = None, name: str = '') -> None:
        """See constraints.hpp."""

    def set_servo(self, kp: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], kd: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], effort: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """
        Gains and largest torque of the servos of joints with one degree of freedom, (nv,) each.
        """

    def set_actuator_limits(self, effort: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], velocity: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """(nv,) each, inf: none."""

    @property
    def constraint_rows(self) -> list[int]: ...

    def constraint_residual(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> object:
        """phi(q, t), (m,)."""

    def constraint_jacobian(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> object:
        """d phi/dq in public coordinates, (m, nv)."""

    def constraint_rate(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> object:
        """d phi/dt at fixed q, (m,)."""

def solve_cone(G: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], b: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], mu: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lower: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], frozen: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='F')] | None = None, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, regularize: bool = True, noise: float = 0.0) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], bool, float, int, int]:
    """
    Coulomb cone problem w = b + G lambda of n contacts with rows[i] = 1 or 3 rows (n, t1, t2) each: G (m, m) [1/kg], b (m,) [m/s], mu (n,), lower (n,) [N s] bounds of the normal impulses, frozen (n, 2) unit slip directions (NaN: free), start (m,) [N s], noise [m/s] by which rows of b may disagree. Returns (lambda (m,) [N s], ok, relative residual, Newton iterations, fallbacks).
    """

def cone_seconds(G: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], b: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], mu: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lower: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], frozen: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='F')] | None = None, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, regularize: bool = True, calls: int = 100, repeats: int = 5) -> float:
    """
    Seconds of one solve_cone, without Python, fastest of several blocks; for benchmarks.
    """

def dense(scene: Scene, segments: dict, times: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], order: int, exact: bool = False) -> tuple[object, object]:
    """
    States (q (N, nq), v (N, nv)) at times (N,) from the segments of a run: from their polynomials, or exact, by the steps of the lengths in between (of runs without inputs).
    """

def instruction_sets() -> list[str]:
    """Builds of the stage kernel that this processor runs, best last."""

def instruction_set(name: str = '') -> str:
    """
    Set (given a name) and return the one that engines made from now on use. The digits do not depend on it.
    """

def kernel_seconds(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], stages: int, instruction_set: str = '', calls: int = 2000, repeats: int = 5) -> dict:
    """
    Seconds per stage of evaluate, factor, solve, f(q, p) and sweep, fastest of several blocks; for benchmarks.
    """

class Snapshot:
    """All that the rest of a run depends on."""

class Simulator:
    def __init__(self, scene: Scene, dt: float, tol: float = 1e-12, impact: int = 0, max_impacts_per_step: int = 100000, max_iterations: int = 50, mhc_global: bool = False, order: int = 2, dense: bool = False, dt_contact: float = 0.0, zeno: int = 0, stiff_support: bool = False, contact_points: int = 4, record_contacts: bool = True) -> None: ...

    def reset(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> dict:
        """Status fields as a dict."""

    def advance(self, steps: int, tau: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None = None, record_every: int = 1, progress: object | None = None, target: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None = None) -> dict:
        """
        Run; the interpreter lock is released. Nodes, events, statistics and status as a dict.
        """

    def run_auto(self, duration: float, level: float, progress: object | None = None) -> dict:
        """
        Run with a step chosen per smooth arc; level [m; rad] bounds what the stage polynomials leave out.
        """

    def save(self) -> Snapshot:
        """A snapshot to go back to."""

    def load(self, snapshot: Snapshot) -> None:
        """Go back; what follows has the same digits."""

    @property
    def t(self) -> float: ...

    @property
    def q(self) -> object: ...

    @property
    def p(self) -> object: ...

    @property
    def v(self) -> object: ...

def contact_points(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, margin: float, max_points: int = 4) -> dict:
    """
    Points at which a collision pair touches at q: dict of kind, feature, material, valid (lists), gap (n,), point_a, point_b, normal (n, 3), world frame.
    """

def contact_points_of(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, features: Sequence[int]) -> dict:
    """The same for known features, wherever they are at q."""

def nearest_gap(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int) -> float:
    """
    Distance [m] of a pair with a halfspace by its own features, NaN for other pairs.
    """

def rest_gap(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, features: Sequence[int], max_points: int = 4) -> tuple:
    """
    (least gap over all features but these, slack included; that feature's gap, normal and point).
    """

def rnea_seconds(model: bytes, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], calls: int = 2000, repeats: int = 5) -> float:
    """
    Seconds per pinocchio::rnea, fastest of several blocks; for benchmarks.
    """

def aba_seconds(model: bytes, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], calls: int = 2000, repeats: int = 5) -> float:
    """Seconds per pinocchio::aba."""

class ImpactsAt:
    def __init__(self, scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], guards: Sequence[int], restitution: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], margin: float, max_impacts: int) -> None:
        """
        Frictionless impacts of these guards at q, taken as closed; momenta are in engine coordinates.
        """

    def gradients(self, contact: int) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """d(gap)/dq of its points, public coordinates, (points, nv)."""

    def directions(self, contact: int) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """
        What an impulse at each of its points adds to the momentum, constraints included, (points, nv).
        """

    def strike(self, contact: int, p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], float]:
        """(momentum after one impact, sum of its impulses [N s])."""

    def settle(self, p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]:
        """All contacts as one plastic problem: (momentum after, impulses (n,))."""

    def run(self, p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], list[list[int]], bool, bool]:
        """
        The sequence that a run takes: (momentum after, impulses (n,), contacts struck as one, whether it ended, whether elastic contacts ended plastically).
        """
