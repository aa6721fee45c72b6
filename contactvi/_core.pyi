"""
Engine of contactvi. It checks sizes only: users go through the Python API.
"""

from collections.abc import Callable, Sequence
import enum
from typing import Annotated, Any

import numpy
from numpy.typing import NDArray


class StatusCode(enum.IntEnum):
    """How a run ended."""

    SUCCESS = 0

    ZENO = 1

    NEWTON_FAILED = 2

    NOT_FINITE = 3

    EVENT_UNRESOLVED = 4

    TOO_MANY_IMPACTS = 5

    PENETRATION = 6

    INTERRUPTED = 7

    CONSTRAINT = 9

    TOO_MANY_STEPS = 10

    IMPACT_UNSOLVED = 12

class ImpactMap(enum.IntEnum):
    """What an impact conserves besides the momentum."""

    CTEC = 0

    DTEC = 1

    MHC = 2

class MhcReference(enum.Enum):
    """Where the value that MHC conserves is taken from."""

    LOCAL = 0
    """The start of the step."""

    GLOBAL = 1
    """The start of the run, less the losses of all impacts since."""

class ContactSteps(enum.IntEnum):
    """Which steps a run takes where bodies touch."""

    AUTO = 0

    EVENTS = 1

    STEPS = 2

class StepKind(enum.IntEnum):
    """The kind of a step."""

    FREE = 0

    PERSISTENT = 1

    DENSE = 2

class Fallback(enum.IntEnum):
    """Why the impulse of an impact is not that of its law."""

    NONE = 0

    PLASTIC = 1

    NO_CONVERGENCE = 2

    INADMISSIBLE = 3

    GRAZING = 4

    PERSISTENT = 5

    GAIN = 6

class GuardKind(enum.IntEnum):
    """What a guard function watches."""

    CONTACT = 0
    """The distance of a pair of shapes."""

    LIMIT = 1
    """The distance of a joint from one of its limits."""

class ContactMode(enum.IntEnum):
    """What a contact did in a step."""

    STICK = 0

    SLIP = 1

    FRICTIONLESS = 2

    IMPACT = 3

class ContactChange(enum.IntEnum):
    """What became of a persistent contact."""

    BEGIN = 0

    RELEASE = 1

    STICK = 2

    SLIP = 3

    BOUNCING_ENDED = 4

    INCONSISTENT = 5

    OVERLAP = 6

class PointKind(enum.IntEnum):
    """The geometry that a contact point comes from."""

    WITNESS = 0

    VERTEX = 1

    RIM = 2

    LIMIT = 3

    EDGE = 4

    END = 5

    RIM_LINE = 6

    SURFACE = 7

    SOLIDS = 8

class ConstraintKind(enum.Enum):
    """What a constraint holds; core/model/constraints.hpp has the residuals."""

    POINT = 0

    DISTANCE = 1

    WELD = 2

    SCREW = 3

    EQUALITY = 4

    PRESCRIBED = 5

class JointType(enum.Enum):
    """The type of a joint of a model."""

    REVOLUTE = 0

    CONTINUOUS = 1

    PRISMATIC = 2

    HELICAL = 3

    PLANAR = 4

    TRANSLATION = 5

    SPHERICAL = 6

    FREE = 7

class Model:
    """The numbers of a pin.Model; velocities and forces are Pinocchio's."""

    def __init__(self, gravity: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], armature: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lower: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], upper: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None: ...

    def add_joint(self, type: JointType, parent: int, subspace: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], R_PJ: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], p_PJ: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], mass: float, centre: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], inertia: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], name: str) -> None:
        """
        The next joint; subspace (6,): what a unit of the velocity of a joint with one degree of freedom is; inertia (3, 3): about the centre of mass.
        """

    @property
    def nv(self) -> int: ...

    def __getstate__(self) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], list[tuple[int, int, Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], float, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], str]]]: ...

    def __setstate__(self, arg: tuple[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Sequence[tuple[int, int, Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], float, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], str]]], /) -> None: ...

    def bias_forces(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """Coriolis, centrifugal and gravity forces, (nv,)."""

    def mass_matrix(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """M(q), (nv, nv)."""

    def motions(self, joints: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')], q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))], Annotated[NDArray[numpy.float64], dict(shape=(None, None))], Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))]]:
        """
        Of some joints (n,) the rotations (n, 3, 3) and positions (n, 3) in the world, and their twists and spatial accelerations for dv/dt = 0 in their own frames, (n, 2, 6), linear parts first.
        """

    def jacobians(self, joints: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')], q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))], Annotated[NDArray[numpy.float64], dict(shape=(None, None))], Annotated[NDArray[numpy.float64], dict(shape=(None, None, None))]]:
        """
        Of some joints (n,) the rotations (n, 3, 3) and positions (n, 3) in the world, and the Jacobians of their twists in their own frames, (n, 6, nv), linear parts first.
        """

    def motion(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], a: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> TreeMotion:
        """The motion at q (nq,), v (nv,) and a = dv/dt (nv,)."""

class TreeMotion:
    """A model at q, v and a = dv/dt: points of bodies, and derivatives."""

    def rotation(self, joint: int) -> Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')]:
        """R_WJ (3, 3)."""

    def point(self, joint: int, x: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
        """
        Place, velocity and acceleration (3,) of a point x [m] of a body, given in the frame of its joint (0: the world), its Jacobian, and the derivatives in q of its velocity and in q and v of its acceleration, (3, nv); world axes.
        """

    def turned_force(self, joint: int, x: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], force: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """
        d(J^T force)/dq of the Jacobian of such a point at a constant force [N], world axes, (nv, nv).
        """

    def force_derivatives(self) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
        """Derivatives in q and v of M a + b at a constant a, (nv, nv) each."""

class Scene:
    def __init__(self, model: Model, shapes: Sequence[tuple[int, Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], str, int]], pairs: Annotated[NDArray[numpy.int32], dict(shape=(None, 2), order='C')], pair_restitution: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair_friction: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], stiffness: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rest: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], damping: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], limits: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], limit_restitution: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rounded_hulls: object | None = None) -> None:
        """
        shapes: of each geometry its joint (0: the world), rotation and position there, name, and the id() of its shape of coal, which is copied; pairs: numbers of two geometries in each row; rounded_hulls: keeps rounded hulls from one process to the next, has find and keep.
        """

    @property
    def model(self) -> Model: ...

    @property
    def nq(self) -> int: ...

    @property
    def nv(self) -> int: ...

    @property
    def njoints(self) -> int: ...

    @property
    def npairs(self) -> int: ...

    @property
    def calls_functions(self) -> bool:
        """Whether it calls functions of the user."""

    @property
    def rounding(self) -> list[float]:
        """Rounding radius [m] of each pair's shapes, 0 where they are sharp."""

    def velocity(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
        """v = M(q)^-1 p, shapes (N, nq), (N, nv) -> (N, nv)."""

    def lost_velocity(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[int, float]:
        """
        (dof, share): of a velocity of size one at q (nq,) that becomes a momentum and a velocity again, where most is lost, and how much.
        """

    def momentum(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
        """p = M(q) v, shapes (N, nq), (N, nv) -> (N, nv)."""

    def energy(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
        """Kinetic and potential energy [J], (N, 2)."""

    def modified_energy(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], h: float, order: int = 2, t: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
        """
        Modified Hamiltonian [J] for step h, (N,); H for order >= 4. t (N,): of the states, for constraints.
        """

    def discrete_energy(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], h: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], order: int = 2) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
        """E_d [J] of one step h (N,) from each state, (N,)."""

    def spatial_momentum(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
        """Total linear, angular momentum about the origin, (N, 6)."""

    def dynamics(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]:
        """(M v, dT/dq - dV/dq of gravity) in engine coordinates."""

    def step(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], h: float, tau: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, tol: float = 1e-12, order: int = 2) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], int, float]:
        """
        One smooth step without contact: (q1, p1, stage velocities (s, nv) in engine coordinates, stage iterations, residual).
        """

    def gaps(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
        """(gap (npairs,), normal, point_a, point_b (npairs, 3)), world frame."""

    def gaps_along(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], pairs: Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
        """Gaps of some pairs (k,) at configurations (n, nq), shape (n, k) [m]."""

    def gap_gradients(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """d(gap)/dq of all guards, pairs then limits, (nguards, nv)."""

    def to_engine(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def to_public(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def momentum_to_engine(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def momentum_to_public(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], p: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]: ...

    def set_joint_friction(self, limits: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """Largest friction force of each dof [N; N m], (nv,)."""

    def add_joint_potential(self, joint: int, rest: float, coefficients: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """Add V = sum_k c[k] x^(k+2), x = q - rest."""

    def add_path_spring(self, joints: Sequence[int], points: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], stiffness: float, rest_length: float, damping: float, tension_only: bool) -> None:
        """
        Add a spring along a line through points (n, 3) in the frames of joints.
        """

    def add_compliance(self, pair: int, a: int, b: int, name_a: str, name_b: str, stiffness: float, exponent: float, damping: float, friction: float, slip_speed: float, functions: Sequence[int] = [-1, -1, -1]) -> None:
        """
        Let two geometries press on each other by a law of their gap; see core/model/elements.hpp. functions: the numbers of those of force, energy and bound on friction (add_contact_function), -1: none.
        """

    def add_contact_function(self, function: int | Callable[[object, bool], object], numbers: int) -> int:
        """
        Adds a function of `numbers` numbers of contacts, of rows (n, 2) or (n, 3) and whether derivatives are wanted, which returns rows of the value (n, 1) or value and derivatives (n, 3) or (n, 4); or the address of a C function void(double, double, double[3]), void(double, double, double, double[4]), of one number double(double). Returns its number.
        """

    def compliant_contacts(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None))], Annotated[NDArray[numpy.float64], dict(shape=(None, None))]]:
        """
        The compliant contacts that overlap at states: (state, pair) (m, 2), (depth, normal, point, force) (m, 10).
        """

    def compliant_gaps(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
        """(pair, gap) of all compliant contacts, (m, 2)."""

    def add_wrench(self, joint: int, point: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], R: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')] | None, wrench: Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')] | Callable[[float], Annotated[NDArray[numpy.float64], dict(shape=(6), order='C')]]) -> None:
        """
        (force, torque) (6,) or a function of t, in the axes R of the joint's frame; without R in those of the world.
        """

    def add_user_force(self, value: Callable[[float, Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], derivatives: Callable[[float, Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]]] | None = None) -> None:
        """value(t, q, v) -> (nv,)."""

    def add_user_potential(self, value: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], float], gradient: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], hessian: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]] | None = None) -> None:
        """value(q) [J], gradient(q) -> (nv,)."""

    def add_constraint(self, kind: ConstraintKind, joint_a: int, R_a: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')] | None, p_a: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], joint_b: int, R_b: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')] | None, p_b: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], numbers: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], signal: Callable[[float], tuple[float, float, float]] | None = None, name: str = '', coupled: bool = False) -> None:
        """
        Frames of two bodies or joints, numbers or their motion; see core/model/constraints.hpp. A coupled one is for couple_joints.
        """

    def couple_joints(self, couplings: Sequence[tuple[int, float, Sequence[tuple[int, float]]]], lent_armature: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """
        Let joints follow others: (joint, offset, [(leader, ratio), ...]) each; see core/model/coupling.hpp. The lent armature (nv,), or empty, is no inertia of the coupled motion.
        """

    def add_prescribed_pose(self, joint: int, R: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], p: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], pose: Callable[[float], tuple[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]]], name: str) -> None:
        """
        Let a frame of a body follow pose(t) -> (position, rotation, velocity, angular velocity), world frame.
        """

    def set_servo(self, kp: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], kd: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], effort: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """
        Gains and largest torque of the servos of joints with one degree of freedom, (nv,) each.
        """

    def set_actuator_limits(self, effort: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], velocity: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """
        Largest effort [N; N m] and speed [m/s; rad/s] of the actuators, (nv,) each; inf is no limit.
        """

    @property
    def followers(self) -> list[int]:
        """
        The joints that follow others, in the order of their columns in the reactions of a run.
        """

    @property
    def constraint_rows(self) -> list[int]:
        """Number of rows of each constraint."""

    def constraint_residual(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
        """phi(q, t), (m,)."""

    def constraint_jacobian(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
        """d phi/dq in public coordinates, (m, nv)."""

    def constraint_rate(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]:
        """d phi/dt at fixed q, (m,)."""

    def set_contact_law(self, pairs: Sequence[int], restitution: int, incremental: bool, keeps_energy: bool, tangential: float, e: tuple[Sequence[float], Sequence[float]] | int | Callable[[float], float] | None, mu: tuple[Sequence[float], Sequence[float]] | int | Callable[[float], float] | None, static_mu: float | None, pull: tuple[Sequence[float], Sequence[float]] | int | Callable[[float], float] | None, axis_of: int, axis: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], shares: Annotated[NDArray[numpy.float64], dict(shape=(2), order='C')], spinning: float, rolling: float, body_pulls: Sequence[int], e_of_state: int | None, mu_of_state: int | None) -> None:
        """
        Gives pairs a law of restitution (0 Poisson, 1 Newton, 2 energetic), whether an impact of one point is followed through its impulse, whether e is lowered so that no energy is made, tangential restitution; e as a function of the closing speed, friction of that of the slip, adhesion of the time (table, address of a C function, function, or None); friction of what sticks or None; the geometry (0, 1; -1: none) and the axis along which and across which friction has its shares; radii [m] of the friction against spinning and rolling; the numbers of the adhesion of its bodies (add_body_pull); e by the closing speed, the slip before and the time, friction by the slip, the normal force and the time (numbers of functions of three numbers that add_contact_function returned, or None).
        """

    def add_body_pull(self, pull: tuple[Sequence[float], Sequence[float]] | int | Callable[[float], float]) -> None:
        """
        Adds the adhesion of a body [N] by the time (table, address of a C function, function), which all points share that touch it.
        """

    def set_surface(self, geometry: int, function: int | Callable[[object], object], is_height: bool, reach: float, lost: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]], object]) -> None:
        """
        Makes a halfspace a surface given by a function (address of a C function of one point, or function of arrays): a height, (n, 2) -> rows of f, f_x, f_y, f_xx, f_xy, f_yy, or a distance, (n, 3) -> rows of d, d_x, d_y, d_z. reach: the largest distance [m] of one of its points from the origin of a moving body; lost: called with a point (3,) of which no nearest point is known, raises.
        """

    def set_height_field(self, geometry: int, coefficients: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], corner: Annotated[NDArray[numpy.float64], dict(shape=(2), order='C')], spacing: Annotated[NDArray[numpy.float64], dict(shape=(2), order='C')], reach: float, lost: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]], object]) -> None:
        """
        Makes a halfspace a block under a bicubic spline, given by its B-spline coefficients (nx + 2, ny + 2) over nx * ny places from corner on.
        """

    def set_torus(self, geometry: int, ring: float, tube: float, cells: tuple[bool, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.int32], dict(shape=(3), order='C')]], reach: float, lost: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]], object]) -> None:
        """Makes a halfspace a torus about z."""

    def set_superellipsoid(self, geometry: int, radii: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], exponent: float, cells: tuple[bool, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.int32], dict(shape=(3), order='C')]], reach: float, lost: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]], object]) -> None:
        """Makes a halfspace a superellipsoid."""

    def set_thread(self, geometry: int, radius: float, depth: float, pitch: float, cells: tuple[bool, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.int32], dict(shape=(3), order='C')]], reach: float, lost: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]], object]) -> None:
        """Makes a halfspace a thread about z."""

    def set_spline_solid(self, geometry: int, coefficients: Sequence[float], cells: tuple[bool, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.int32], dict(shape=(3), order='C')]], reach: float, lost: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]], object]) -> None:
        """
        Makes a halfspace the solid in which a tricubic spline is negative, given by its B-spline coefficients, three more along each axis than cells, the last axis fastest.
        """

    def feet(self, geometry: int, point: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], reach: float) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]:
        """
        Rows (n, 4) of distance [m] and outward normal: the nearest foot of a point (3,) on a surface, and those nearer than reach, in the frame of the surface.
        """

    def common_normals(self, first: int, second: int, R: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], t: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], reach: float) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]:
        """
        Rows (n, 10) of gap [m], outward normal of the first solid, place on the first and on the second one, each in its own frame: the least common normal, and those with a gap up to reach; the second frame is at R x + t in the first one.
        """

    def set_surface_motion(self, geometry: int, linear: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], angular: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], profile: tuple[Sequence[float], Sequence[float]] | int | Callable[[float], float] | None) -> None:
        """
        Lets the surface of a geometry move along itself: linear and angular velocity in its frame, and a factor by the time (table, address of a C function, function) or None.
        """

def follow_impact(G: Annotated[NDArray[numpy.float64], dict(shape=(3, 3), order='F')], w: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], mu: float, e: float, law: int) -> tuple[bool, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]]:
    """
    Impulse (n, t1, t2) of one point by the incremental law, and that until the end of the compression: (ok, (3,), (3,)).
    """

class BlockContacts:
    """A contact problem of many blocks and its solver, for tests."""

    def __init__(self, sizes: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], masses: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], blocks: Annotated[NDArray[numpy.int32], dict(shape=(None, 2), order='C')], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], mu: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lower: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], box: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], W: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v_free: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], equations: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')] | None = None, turning: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')] | None = None) -> None:
        """
        sizes (b,): degrees of freedom of each block; masses: their matrices, one after the other [kg]; blocks (m, 2): the blocks of each contact, -1 for the world as second; rows (m,): 3 (n, t1, t2) or 1; mu (m,), lower (m,) [N s], box (m,) [N s], > 0 for joint friction; W: per contact rows x size of the first block, then rows x size of the second; v_free (nv,) and offset (rows,) [m/s]; equations (nv, m): W_e^T v stays what it is in v_free. With them, m = 0 too, the problem is reduced first as in dense steps (ReducedSolver). turning (m,): of rows (spin, roll1, roll2) the number of their point, which stands before them; else -1.
        """

    def set_free(self, v_free: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], offset: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> None:
        """New data of the same contacts."""

    def solve(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, bound: float = float('inf'), tolerance: float = 1e-08, accept: float = 1e-06, sweeps: int = 50, newton_steps: int = 8, factors: int = 60) -> dict[str, Any]:
        """
        Impulses (rows,) [N s], velocity v (nv,), stage, residual (over the scale [m/s]), violation [m/s], energy [J], free_energy [J], blend, sweeps, factors. start (rows,) [N s]; bound of the energy [J].
        """

    def solve_normals(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, tolerance: float = 1e-08) -> dict[str, Any]:
        """
        The normal impulses anew for the tangential ones of start; the same results.
        """

    def solve_convex(self, slip: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], tolerance: float = 1e-09) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], float, int]:
        """
        Impulses (rows,) of the law with frozen slip speeds (m,) [m/s], residual, factorizations.
        """

    def solve_weighted(self, K: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], x: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], symmetric: bool) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """(M + W K W^T)^-1 x with matrices K (3 m, 3) of the contacts, x (nv,)."""

    def seconds(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, bound: float = float('inf'), tolerance: float = 1e-08, accept: float = 1e-06, sweeps: int = 50, newton_steps: int = 8, factors: int = 60, prepare: bool = True, repeats: int = 3) -> float:
        """
        Seconds of one solve, with its preparation or without, the fastest of several.
        """

    def seconds_normals(self, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, tolerance: float = 1e-08, repeats: int = 3) -> float:
        """The same of solve_normals, prepared."""

def solve_cone(G: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], b: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], mu: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lower: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], frozen: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='F')] | None = None, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, regularize: bool = True, noise: float = 0.0, accept: float = 1e-12, box: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], bool, float, int, int]:
    """
    Coulomb cone problem w = b + G lambda of n contacts with rows[i] = 1 or 3 rows (n, t1, t2) each: G (m, m) [1/kg], b (m,) [m/s], mu (n,), lower (n,) [N s] bounds of the normal impulses, frozen (n, 2) unit slip directions (NaN: free), start (m,) [N s], noise [m/s] by which rows of b may disagree, accept: residual below which no other starts are tried, box (n,) [N s] > 0 for rows of joint friction. Returns (lambda (m,) [N s], ok, relative residual, Newton iterations, fallbacks).
    """

def solve_turning_cone(G: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], b: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], mu: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rolling: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lower: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], frozen: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')] | None = None, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, regularize: bool = True) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], bool, float, int, int]:
    """
    As solve_cone, with spinning and rolling friction: rows[i] = 1 or 3, and one more (spin), two more (roll1, roll2) or both; rolling (n,) coefficients, 0 without such rows; frozen (n, 5) directions of slip, spin and rolling (NaN: free).
    """

def cone_seconds(G: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')], b: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], rows: Annotated[NDArray[numpy.int32], dict(shape=(None,), order='C')], mu: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lower: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], frozen: Annotated[NDArray[numpy.float64], dict(shape=(None, 2), order='F')] | None = None, start: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, regularize: bool = True, calls: int = 100, repeats: int = 5, box: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None) -> float:
    """
    Seconds of one solve_cone, without Python, fastest of several blocks; for benchmarks.
    """

def dense(scene: Scene, segments: dict[str, Any], times: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], order: int, tol: float, exact: bool = False, momenta: bool = False) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None))], Annotated[NDArray[numpy.float64], dict(shape=(None, None))]]:
    """
    States (q (N, nq), v (N, nv)) at times (N,) from the segments of a run: from their polynomials, or exact, by steps of the lengths in between, solved to tol (of runs without inputs, and not where contacts persist). momenta: p instead of v, exact.
    """

def linear_step(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], x: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], momentum: bool, h: float, tau: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, target: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, t: float = 0.0, order: int = 2, tol: float = 1e-12, by_columns: bool = False) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]:
    """
    One smooth step and its derivatives: (q1, x1, A (2 nv, 2 nv), B (2 nv, nv), d(q1, x1)/dh (2 nv,)), x being the velocity or the momentum; target: references of the servos (2 nv,). by_columns: by the slow way, which solves one tangent equation per column.
    """

def linear_contact_step(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], x: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], momentum: bool, h: float, tau: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, target: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, t: float = 0.0, order: int = 2, tol: float = 1e-12) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]] | dict[str, Any]:
    """
    As linear_step(), of a step with impulses of constraints and joint friction, without contacts; or the reason why there is none.
    """

class Linearizer:
    def __init__(self, scene: Scene, order: int, tol: float) -> None: ...

    def step(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], x: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], momentum: bool, h: float, tau: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None, target: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None, t: float) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]] | None:
        """
        As linear_step(); None where the step is not solved, or not beyond doubt without contacts, actuators at their limits and motions without inertia.
        """

def adjoint_step(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], x: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], momentum: bool, h: float, lq: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], lx: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], tau: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, target: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, t: float = 0.0, order: int = 2, tol: float = 1e-12) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], float, dict[str, object]]:
    """
    From a gradient (lq, lx) (nv,) in the end (q1, x1) of a smooth step, dual to tangent vectors, to those in q, x and tau (nv,), h, and the parameters by name; inertia (njoints, 10): mass, first moment, rotational inertia about the joint's frame (xx xy xz yy yz zz).
    """

def derivative_costs(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], h: float, order: int = 2, calls: int = 1, repeats: int = 1) -> dict[str, float]:
    """
    Seconds and iterations of one direction of a step's derivative and of its transpose, and seconds to prepare each, fastest of several blocks; for benchmarks.
    """

def linear_forces(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], target: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None, t: float = 0.0) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
    """
    Forces of springs, dampers, servos and elements and their derivatives: (f (nv,), f_q, f_v (nv, nv)).
    """

def passive_forces(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
    """
    Forces of springs, dampers and elements, (nv,); without servos, gravity, contacts and constraints.
    """

def gap_hessian(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], guard: int, feature: int = 0) -> tuple[float, Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
    """
    (gap, W (nv,), dW (nv, nv)) of a guard, or of the contact point of a pair with that feature, in engine coordinates: column k of dW is the derivative of W = d(gap)/dq along the k-th tangent vector.
    """

def contact_row_changes(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], guard: int, t1: Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], feature: int = 0) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], list[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]:
    """
    (rows n, t1, t2 of the relative velocity as columns (nv, 3), their derivatives as three matrices like dW of gap_hessian, those of the normal, of a's and of b's point (9, nv)), engine coordinates.
    """

class RecordedRun:
    """The pieces and impacts of a run, for its derivatives."""

    def __init__(self, scene: Scene, settings: dict[str, Any], segments: dict[str, Any], events: dict[str, Any] | None, tau: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None, target: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None, q_end: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], p_end: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], contact_steps: Sequence[KeptContactSteps]) -> None: ...

    @property
    def guards(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]:
        """Kind and index of all guards, as in events, (nguards, 2)."""

    def tangent(self, directions: dict[str, Any], times: Sequence[float], take_branch: bool) -> dict[str, Any]:
        """
        d(q, v) at times along directions, columns of q, v, tau (nv, count), e and mu (guards, count), or of one direction the inputs step by step (steps, nv); or the reason why there is none.
        """

    def adjoint(self, times: Sequence[float], lq: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], lv: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], events: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], steps: int, take_branch: bool) -> dict[str, Any]:
        """
        From gradients in (q, v) at times (nodes, nv) and in the times of events to those in the start, the inputs of all steps and the parameters; or the reason why there is none.
        """

    def hessian(self, times: Sequence[float], lq: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], lv: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], direction: dict[str, Any], hessian: Callable[[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]], tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]]]) -> dict[str, Any]:
        """
        Gradients in q, v and tau from those at times, and their second derivatives along a direction (q, v: (nv,), tau: (steps, nv)); hessian(dq, dv) returns those of the cost at the nodes. Or the reason why there is none.
        """

def hull_vertices(points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.int64], dict(shape=(None,), order='C')]:
    """
    Ascending indices of the points (n, 3), finite, that are vertices of their convex hull; none without a hull.
    """

def mesh_distances(vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)], faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C', device='cpu', writable=False)], points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
    """
    Signed distances (k,) of points (k, 3) from a closed mesh of outward triangles, negative inside.
    """

def hull_of_points(points: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C', device='cpu', writable=False)]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C')], Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C')]]:
    """
    Vertices (n, 3) and triangles (m, 3) of the hull of points, finite, in coal's order; none where there is no hull.
    """

def hull_faces(hull: int) -> Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C')]:
    """Triangles (m, 3) of a coal.Convex, of which hull is the id()."""

def crowded_vertices(vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C')], faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C')]) -> int:
    """
    How many vertices of a hull have more edges than coal can count: distances there are right to HULL_ERROR.
    """

def neighbor_lists(vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C')], faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C')]) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C')], list[list[int]]]:
    """
    Points of the engine's copy of a hull, its vertices and their helpers, and the neighbours of each, for tests.
    """

HULL_ERROR: float = 1e-09

def set_hull(hull: int, vertices: Annotated[NDArray[numpy.float64], dict(shape=(None, 3), order='C')], faces: Annotated[NDArray[numpy.int32], dict(shape=(None, 3), order='C')]) -> None:
    """
    Gives a coal.Convex, of which hull is the id(), vertices (n, 3) and outward triangles (m, 3).
    """

def instruction_sets() -> list[str]:
    """Builds of the stage kernel that this processor runs, best last."""

def instruction_set(name: str = '') -> str:
    """
    Set (given a name) and return the one that engines made from now on use. The digits do not depend on it.
    """

def kernel_seconds(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], stages: int, instruction_set: str = '', calls: int = 2000, repeats: int = 5) -> dict[str, float]:
    """
    Seconds per stage of evaluate, factor, solve, f(q, p) and sweep, fastest of several blocks; for benchmarks.
    """

def iterate_kernel(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], stages: int, iterations: int, factors: int) -> None:
    """
    Make so many stage iterations at (q, v), the first of them with a factor; for benchmarks.
    """

def solve_masses(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], right: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')]:
    """
    M(q)^-1 times the columns of right, shape (nv, m), in engine coordinates, for tests.
    """

class SimulatorOptions:
    """Settings of a simulator; each has a default."""

    def __init__(self) -> None: ...

    @property
    def dt(self) -> float:
        """Step length [s]."""

    @dt.setter
    def dt(self, arg: float, /) -> None: ...

    @property
    def tol(self) -> float:
        """Tolerance on the residual of the stage equations, relative."""

    @tol.setter
    def tol(self, arg: float, /) -> None: ...

    @property
    def impact(self) -> ImpactMap: ...

    @impact.setter
    def impact(self, arg: ImpactMap, /) -> None: ...

    @property
    def mhc_reference(self) -> MhcReference: ...

    @mhc_reference.setter
    def mhc_reference(self, arg: MhcReference, /) -> None: ...

    @property
    def max_iterations(self) -> int:
        """Stage iterations per attempt at a step."""

    @max_iterations.setter
    def max_iterations(self, arg: int, /) -> None: ...

    @property
    def max_impacts_per_step(self) -> int: ...

    @max_impacts_per_step.setter
    def max_impacts_per_step(self, arg: int, /) -> None: ...

    @property
    def order(self) -> int:
        """Order 2s of the integrator with s Gauss stages."""

    @order.setter
    def order(self, arg: int, /) -> None: ...

    @property
    def dense(self) -> bool:
        """Whether the polynomials of the steps are kept."""

    @dense.setter
    def dense(self, arg: bool, /) -> None: ...

    @property
    def dt_contact(self) -> float:
        """Longest step with persistent contacts [s]; 0: dt."""

    @dt_contact.setter
    def dt_contact(self, arg: float, /) -> None: ...

    @property
    def end_at_zeno(self) -> bool:
        """
        Whether a run ends where impacts accumulate, instead of going on with a persistent contact.
        """

    @end_at_zeno.setter
    def end_at_zeno(self, arg: bool, /) -> None: ...

    @property
    def stiff_support(self) -> bool:
        """Whether persistent contacts take part in an impact as rigid supports."""

    @stiff_support.setter
    def stiff_support(self, arg: bool, /) -> None: ...

    @property
    def contact_points(self) -> int:
        """Largest number of points of a pair."""

    @contact_points.setter
    def contact_points(self, arg: int, /) -> None: ...

    @property
    def record_contacts(self) -> bool: ...

    @record_contacts.setter
    def record_contacts(self, arg: bool, /) -> None: ...

    @property
    def gradient(self) -> bool:
        """Whether contact steps are kept for derivatives; with dense."""

    @gradient.setter
    def gradient(self, arg: bool, /) -> None: ...

    @property
    def islands(self) -> bool:
        """Whether islands are advanced one by one where that is possible."""

    @islands.setter
    def islands(self, arg: bool, /) -> None: ...

    @property
    def threads(self) -> int:
        """
        Threads that advance islands side by side; results do not depend on it.
        """

    @threads.setter
    def threads(self, arg: int, /) -> None: ...

    @property
    def contact_steps(self) -> ContactSteps: ...

    @contact_steps.setter
    def contact_steps(self, arg: ContactSteps, /) -> None: ...

class KeptContactSteps:
    """
    The contact steps, dense ones too, of a call, as their derivatives need them.
    """

    def __init__(self, scene: Scene, numbers: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]]) -> None:
        """From what numbers() returns."""

    def numbers(self) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))]]:
        """
        Return the contact steps, impacts of several points, dense steps and smooth steps with rows as numbers, for files, and of the first and the last what their laws of contact need.
        """

class StillRows:
    """Contacts of what lies still, the same in every step of a span."""

    def columns(self, scene: Scene) -> dict[str, Any] | None:
        """
        Return the columns of one step; its start, length and number are of no account.
        """

    def __len__(self) -> int: ...

class Snapshot:
    """All that the rest of a run depends on."""

    def __init__(self, scene: Scene, bytes: bytes) -> None:
        """
        From what to_bytes() of one of this scene has returned, in this process or in another one.
        """

    def to_bytes(self) -> bytes:
        """Return it as bytes, for this version of the engine."""

class Simulator:
    def __init__(self, scene: Scene, options: SimulatorOptions) -> None: ...

    def run_auto(self, duration: float, level: float, progress: Callable[[float, int], object] | None = None, coarser: KeptRun | None = None, part: float = 1.0, sample: float = 0.0, after_impact: int = 1, target: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='F')] | Callable[[float], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]] | None = None, ends: Sequence[float] = []) -> tuple[KeptRun, object]:
        """
        Run with a step chosen between impacts; level [m; rad] bounds what the stage polynomials leave out. coarser: a run before, of whose steps these are this part. sample: multiples of it after the start [s] are nodes where steps are at most twice as long; 0: none. after_impact: steps at least from an impact to the end of its step. target: references of servos, (1, 2 nv), or a function t -> (2 nv,). ends: ascending times [s] at which steps end, too. Return (KeptRun, error of a callback or None).
        """

    def keep_problems(self) -> None:
        """
        From now on the contact problems of steps are kept for take_problems().
        """

    def take_problems(self) -> dict[str, Any]:
        """
        Return the contact problems kept since the last call, in their order: "dense", those of dense steps, with the arguments of BlockContacts, start (rows,) [N s] and bound [J]; "contact", those of contact steps, with G (m, m), b (m,), start (m,), whose first rows are those of `equations` constraints, then the contacts' arguments of solve_cone.
        """

    def reset(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], t: float = 0.0) -> dict[str, Any]:
        """Put the system to (q, v) at t [s]; return the fields of the status."""

    def lost_velocity(self, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]) -> tuple[int, float]:
        """As Scene.lost_velocity, between two calls."""

    def advance(self, steps: int, tau: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None = None, record_every: int = 1, progress: Callable[[float, int], object] | None = None, target: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None = None) -> dict[str, Any]:
        """
        Make steps without the interpreter lock; return nodes, events, statistics and status.
        """

    def step(self, tau: object | None = None, target: object | None = None) -> object:
        """
        Make one step, recorded for take(); return the time [s]. None: not made, with these inputs or now. False: made, and take() is to be looked at.
        """

    def take(self) -> object:
        """
        Return what step() has recorded since the last take(), as advance() does; None: nothing.
        """

    def limit_record(self, nodes: int) -> None:
        """
        Set how many nodes step() records before it returns False; 0: nothing of the step before is kept.
        """

    @property
    def before(self) -> object:
        """t, q and p at the start of the last step(); None after another call."""

    def save(self) -> Snapshot:
        """Return a snapshot to go back to."""

    def load(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot; what follows is equal to the bit."""

    @property
    def islands(self) -> int:
        """Number of islands now; 0 where all bodies are advanced together."""

    @property
    def t(self) -> float: ...

    @property
    def q(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...

    @property
    def p(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...

    @property
    def v(self) -> Annotated[NDArray[numpy.float64], dict(shape=(None,))]: ...

class KeptRun:
    """A run with the polynomials of its steps, kept in the engine."""

    @property
    def code(self) -> StatusCode: ...

    @property
    def time(self) -> float:
        """Reached [s]."""

    @property
    def seconds(self) -> float:
        """Wall time."""

    @property
    def t(self) -> list[float]:
        """Times of the nodes [s]."""

    @property
    def counts_work(self) -> bool:
        """
        Whether it counts work or reactions, which are known at its nodes alone.
        """

    @property
    def nodes(self) -> int: ...

    @property
    def segments(self) -> int: ...

    @property
    def sweeps(self) -> int: ...

    @property
    def contact_changes(self) -> int:
        """Begins, ends and slips of persistent contacts."""

    @property
    def dense_steps(self) -> int: ...

    @property
    def contact_iterations(self) -> int: ...

    @property
    def contact_time(self) -> float:
        """Length of the steps with persistent contacts together [s]."""

    @property
    def size(self) -> float:
        """Largest distance of a node from the first one [m, rad]."""

    @property
    def first_step_error(self) -> float:
        """
        Largest distance between a first step of a flight and two halves of it [m, rad].
        """

    def distances(self, other: KeptRun, times: int, over_time: bool = False, ended: bool = False) -> Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')]:
        """
        Distances of another run from the nodes of this one, evenly over the nodes or the time; infinite where one ended much earlier, unless `ended`: then up to the earlier end.
        """

    def error_share(self, companion: KeptRun, power: int, dt_contact: float) -> float:
        """
        Error over what that of the companion is larger, by the lengths h of the segments and the law h^power; inf: the runs are too much alike; NaN: unknown, because contacts persist and the impacts differ.
        """

    def take_segments(self) -> dict[str, Any]:
        """
        Hand over the polynomials of its steps, as results() does; it cannot be compared any more.
        """

    def results(self) -> dict[str, Any]:
        """
        Hand over what Simulator.advance returns, without "error"; the run is empty then.
        """

def step_together(simulators: Sequence[Simulator], steps: int, tau: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None = None, target: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')] | None = None, threads: int = 1) -> list[int]:
    """
    Make steps of several simulators in threads, without the interpreter lock, each with a row of tau (n, nv) and of target (n, 2 nv); return how many ordinary steps each has made. Where these are fewer than `steps` a further one was made, and take() is to be looked at.
    """

class ScenePart:
    """Some static trees of a scene, with all that is fixed to the world."""

    @property
    def scene(self) -> Scene:
        """As a scene of its own."""

    @property
    def q(self) -> list[int]:
        """Its entries of a configuration of the whole scene."""

    @property
    def v(self) -> list[int]:
        """Its entries of a velocity of the whole scene."""

class StaticTrees:
    """The trees of a scene that nothing but contacts couples."""

    def __init__(self, scene: Scene) -> None: ...

    @property
    def count(self) -> int: ...

    @property
    def guards(self) -> int:
        """Pairs and joint limits of the scene."""

    def part(self, trees: Sequence[int]) -> ScenePart:
        """The scene restricted to these trees."""

    def meetings(self, parts: Sequence[ScenePart], runs: Sequence[KeptRun], near: float) -> list[tuple[int, int]]:
        """
        Pairs of parts, by their places in the list, that may have come nearer than this [m] in these runs of each alone; all others are certain to have stayed apart.
        """

    def joined(self, parts: Sequence[ScenePart], runs: Sequence[KeptRun], leader: int) -> KeptRun:
        """
        The runs of parts that did not meet as one run of the scene, without polynomials. Its nodes are those of one of the runs, by its place in the list.
        """

class BatchKeep(enum.Enum):
    """What is kept of the runs of a batch."""

    ENDS = 0

    NODES = 1

    RUNS = 2

class SceneNumber(enum.Enum):
    """What a number of a scene is that differs from run to run."""

    GRAVITY = 0

    RESTITUTION = 1

    FRICTION = 2

    LIMIT_RESTITUTION = 3

    STIFFNESS = 4

    REST = 5

    ARMATURE = 6

    DAMPING = 7

    KP = 8

    KD = 9

    BODY = 10

class BatchInputs:
    """Inputs of the steps of a run, which several runs may share."""

    def __init__(self, rows: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')]) -> None: ...

class Batch:
    """Many runs with steps of one length, in several threads."""

    def __init__(self, options: SimulatorOptions, steps: int, record_every: int, keep: BatchKeep, most_lost: float) -> None: ...

    def set_changes(self, scene: Scene, places: Sequence[tuple[SceneNumber, int, int]]) -> None:
        """
        Tell what the numbers of the rows of changes are: (kind, index in the scene, column).
        """

    def set_start(self, snapshot: Snapshot) -> None:
        """Let all runs go on from a snapshot of their scene."""

    def add(self, scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], v: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], tau: BatchInputs | None = None, target: BatchInputs | None = None, changes: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')] | None = None) -> None:
        """
        Add a run from (q, v), with a row of numbers that differ from those of the scene; the scene calls no function of the user.
        """

    def run(self, threads: int, progress: Callable[[int], object] | None = None) -> None:
        """
        Make all runs without the interpreter lock; progress(runs made) is called now and then.
        """

    @property
    def shared_iterations(self) -> int:
        """
        Stage iterations that runs have made together, each counted once for every run in it.
        """

    def table(self, nq: int, nv: int) -> dict[str, Any]:
        """Return states and counts of all runs as arrays, once."""

    def status(self, k: int) -> dict[str, Any]:
        """Return the fields of the status of a run."""

    def result(self, k: int) -> tuple[Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))], Annotated[NDArray[numpy.float64], dict(shape=(None,))], dict[str, Any]]:
        """
        Return momenta at start and end, q at the end, and the results of a run, once.
        """

def contact_points(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, margin: float, max_points: int = 4) -> dict[str, Any]:
    """
    Points at which a collision pair touches at q: dict of kind, feature, material, valid (lists), gap (n,), point_a, point_b, normal (n, 3), world frame.
    """

def contact_points_of(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, features: Sequence[int]) -> dict[str, Any]:
    """
    Points of a pair at known features, wherever they are at q; entries as those of contact_points.
    """

def distance_bounds(scene: Scene, known: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], places: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], a: int, b: int) -> Annotated[NDArray[numpy.float64], dict(shape=(None, None))]:
    """
    Bounds (N, 3) on the distance of two geometries at places (N, nq), from that at the configuration `known`: a lower bound, the distance itself, an upper bound.
    """

def near_pairs(scene: Scene, start: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], end: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], bound: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], h: float, spans: bool = False) -> list[tuple[list[int], Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], bool]]:
    """
    For steps of length h that begin at start and were to end at end (N, nq), with velocities within bound (N, nv) of the engine: [(pairs that are looked at, bound on each pair's motion (npairs,), whether the step looks at all)]. spans: steps after one in which no pair comes near may look at none.
    """

def distance_noise(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int) -> float:
    """
    How far the distance of a pair may be from the gap of its lowest point [m].
    """

def nearest_gap(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int) -> float:
    """
    Distance [m] of a pair with a halfspace by its own features, NaN for other pairs.
    """

def none_deeper(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, features: Sequence[int], max_points: int = 4) -> tuple[bool, float]:
    """
    Whether a pair is seen to be no deeper than the points of these features without its distance, and by how much its distance is larger than their least gap.
    """

def rest_behind(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, features: Sequence[int], per_distance: float, slack: float) -> tuple[float, bool, float]:
    """
    (sine of the angle at which the edges of these features cross, 1 for vertices on a face, 0 for others; whether the rest of both shapes lies behind them by more than so much of its distance less a slack [m]; the gap of the pair if it is theirs, else NaN).
    """

def far_vertices(vertices: Sequence[Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]], directions: Annotated[NDArray[numpy.float64], dict(shape=(None, None), order='C')], depth: float) -> list[tuple[int, list[int]]]:
    """
    Of many vertices, (n, 3): per unit direction, (k, 3), the farthest one, the first of several, and those that miss it by at most a depth [m]. Empty for few vertices.
    """

def rest_gap(scene: Scene, q: Annotated[NDArray[numpy.float64], dict(shape=(None,), order='C')], pair: int, features: Sequence[int], max_points: int = 4, enough: float = float('inf')) -> tuple[float, float, Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')], Annotated[NDArray[numpy.float64], dict(shape=(3), order='C')]]:
    """
    (least gap over all features but these, slack included; that feature's gap, normal and point). Infinite where it is above `enough`, or where there is none.
    """

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
