"""Constrained and forced motion by index reduction: slow, on Pinocchio's crba and nonLinearEffects, DOP853.

  M a + nle = tau + J^T lam,   J a = -gamma      (phi'' = J a + gamma = 0, oracles.constraints)
Redundant rows leave lam open: the one of least Euclidean norm in the rows as given is taken. The constraints' drift is
removed by projection in the metric M at every output time, nowhere else. Joint damping and friction stored in
`pin.Model` are not used; what acts is in `forces`.

Each force is of one kind, by where its power goes:
  "spring"   has an `energy`, part of the potential energy
  "damping"  its power is -(rate of dissipation)
  "input"    its power is work put in
Balance: kinetic + potential - (their start) = work_input - dissipated + work_prescribed, where the power of
prescribed motions is -lam . d phi/dt (v . J^T lam with J v = -d phi/dt).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from .constraints import Constraint, Jet, Motion, Place, stack

RANK = 1e-8  # singular values of J M^-1/2 below it times the largest belong to redundant rows
VectorOfTime = Callable[[float], Sequence[float]]


class Force:
    """A generalized force of one kind."""

    kind = "input"

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        raise NotImplementedError

    def energy(self, motion: Motion) -> float:
        return 0.0


@dataclass(frozen=True)
class JointDamping(Force):
    """tau = -d v, d (nv,) [N s/m, N m s/rad]."""

    coefficients: Sequence[float]
    kind = "damping"

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        return -np.asarray(self.coefficients, float) * motion.v


@dataclass(frozen=True)
class JointSpring(Force):
    """tau = -(k_1 x + k_2 x^2 + ..), x = q - rest, joint of one degree of freedom; one coefficient: linear."""

    joint: int
    coefficients: Sequence[float]
    rest: float = 0.0
    kind = "spring"

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        x = motion.joint(self.joint)
        return -np.polynomial.Polynomial([0.0, *self.coefficients])(x.value[0] - self.rest) * x.jac[0]

    def energy(self, motion: Motion) -> float:
        potential = np.polynomial.Polynomial([0.0, *self.coefficients]).integ()
        return float(potential(motion.joint(self.joint).value[0] - self.rest))


@dataclass(frozen=True)
class PathSpring(Force):
    """Spring along the straight pieces between points on bodies: V = k (l - rest)^2 / 2; a slack one only pulls."""

    places: Sequence[Place]
    stiffness: float
    rest: float
    slack: bool = False
    kind = "spring"

    def _stretch(self, length: Jet) -> float:
        stretch = float(length.value[0]) - self.rest
        return max(stretch, 0.0) if self.slack else stretch

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        length = motion.length(self.places)
        return -self.stiffness * self._stretch(length) * length.jac[0]

    def energy(self, motion: Motion) -> float:
        return 0.5 * self.stiffness * self._stretch(motion.length(self.places)) ** 2


@dataclass(frozen=True)
class PathDamper(Force):
    """-c l' along the same path."""

    places: Sequence[Place]
    coefficient: float
    kind = "damping"

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        length = motion.length(self.places)
        return -self.coefficient * float(length.rate[0]) * length.jac[0]


def spring_damper(places: Sequence[Place], stiffness: float, rest: float, damping: float) -> list[Force]:
    """Between two body points, or along a tape over three and more."""
    return [PathSpring(places, stiffness, rest), PathDamper(places, damping)]


@dataclass(frozen=True)
class PathPull(Force):
    """Tension f(t) [N] along the path, put in from outside."""

    places: Sequence[Place]
    tension: Callable[[float], float]

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        return -self.tension(t) * motion.length(self.places).jac[0]


@dataclass(frozen=True)
class Wrench(Force):
    """Force [N] at a point of a body and torque [N m] on it, functions of time in world or in body axes."""

    place: Place
    force: VectorOfTime
    torque: VectorOfTime = lambda _t: (0.0, 0.0, 0.0)
    body_axes: bool = False

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        joint = self.place[0]
        turn = motion.data.oMi[joint].rotation if self.body_axes else np.eye(3)
        spin = pin.getJointJacobian(motion.model, motion.data, joint, pin.LOCAL_WORLD_ALIGNED)[3:]
        force, torque = (turn @ np.asarray(f(t), float) for f in (self.force, self.torque))
        return motion.point(self.place).jac.T @ force + spin.T @ torque


@dataclass(frozen=True)
class UserForce(Force):
    """tau = function(q, v, t), (nv,); potential(q) for the kind "spring"."""

    function: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    kind: str = "input"
    potential: Callable[[np.ndarray], float] | None = None

    def tau(self, motion: Motion, t: float) -> np.ndarray:
        return np.asarray(self.function(motion.q, motion.v, t), float)

    def energy(self, motion: Motion) -> float:
        return 0.0 if self.potential is None else float(self.potential(motion.q))


class Response(NamedTuple):
    """Acceleration (nv,), multipliers (m,), powers [W] (input, dissipated, prescribed motions), misfit.

    misfit: largest entry of J a + gamma; more than rounding where redundant constraints contradict each other.
    """

    a: np.ndarray
    multipliers: np.ndarray
    powers: np.ndarray
    misfit: float


def mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def rows(motion: Motion, t: float, constraints: Sequence[Constraint]) -> Jet:
    """All constraints below one another."""
    none = Jet(np.zeros(0), np.zeros((0, motion.model.nv)), np.zeros(0), np.zeros(0))
    return stack(none, *(c.jet(motion, t) for c in constraints))


def least(mass: np.ndarray, jac: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(dv, lam): dv = M^-1 J^T lam with J dv = target, lam of least norm; least squares where rows contradict."""
    root = np.linalg.cholesky(mass)
    if jac.shape[0] == 0:
        return np.zeros(jac.shape[1]), np.zeros(0)
    u, s, vt = np.linalg.svd(np.linalg.solve(root, jac.T).T, full_matrices=False)
    inverse = np.where(s > RANK * s[0], 1.0 / np.maximum(s, 1e-300), 0.0)
    change = inverse * (u.T @ target)
    return np.linalg.solve(root.T, vt.T @ change), u @ (inverse * change)


def acceleration(
    model: pin.Model,
    q: np.ndarray,
    v: np.ndarray,
    t: float = 0.0,
    forces: Sequence[Force] = (),
    constraints: Sequence[Constraint] = (),
) -> Response:
    """Acceleration and multipliers at a state."""
    motion, mass = Motion(model, q, v), mass_matrix(model, q)
    tau = {"spring": np.zeros(model.nv), "damping": np.zeros(model.nv), "input": np.zeros(model.nv)}
    for force in forces:
        tau[force.kind] += force.tau(motion, t)
    nle = pin.nonLinearEffects(model, model.createData(), q, v)
    free = np.linalg.solve(mass, sum(tau.values()) - nle)
    phi = rows(motion, t, constraints)
    change, lam = least(mass, phi.jac, -(phi.jac @ free + phi.bias))
    a = free + change
    prescribed = -lam @ (phi.rate - phi.jac @ v)
    misfit = float(np.abs(phi.jac @ a + phi.bias).max(initial=0.0))
    return Response(a, lam, np.array([tau["input"] @ v, -tau["damping"] @ v, prescribed]), misfit)


def energies(model: pin.Model, q: np.ndarray, v: np.ndarray, forces: Sequence[Force] = ()) -> tuple[float, float]:
    """(kinetic, potential) [J]; potential: gravity and springs."""
    motion = Motion(model, q, v)
    gravity = pin.computePotentialEnergy(model, model.createData(), q)
    return 0.5 * float(v @ mass_matrix(model, q) @ v), gravity + sum(f.energy(motion) for f in forces)


def project(
    model: pin.Model, q: np.ndarray, v: np.ndarray, t: float, constraints: Sequence[Constraint]
) -> tuple[np.ndarray, np.ndarray, float]:
    """(q, v) on the constraints, by steps of least kinetic energy, and the largest |phi| found before.

    Raises ArithmeticError where the constraints cannot be met.
    """
    found = best = float(np.abs(rows(Motion(model, q), t, constraints).value).max(initial=0.0))
    for _ in range(50):
        phi = rows(Motion(model, q), t, constraints)
        step = least(mass_matrix(model, q), phi.jac, -phi.value)[0]
        trial = pin.normalize(model, pin.integrate(model, q, step))
        residual = float(np.abs(rows(Motion(model, trial), t, constraints).value).max(initial=0.0))
        if residual >= best and best <= 1e-12:  # rounding is reached
            break
        q, best = trial, residual
    if best > 1e-12:
        raise ArithmeticError(f"the constraints are left by {best:.3g} at t = {t}")
    phi = rows(Motion(model, q, v), t, constraints)
    return q, v + least(mass_matrix(model, q), phi.jac, -phi.rate)[0], found


def configuration_rate(model: pin.Model, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """dq/dt in the numbers of q."""
    out = np.zeros(model.nq)
    for joint in list(model.joints)[1:]:
        x, w = q[joint.idx_q : joint.idx_q + joint.nq], v[joint.idx_v : joint.idx_v + joint.nv]
        if joint.nq == joint.nv:
            rate = w
        elif joint.nq == 2:  # (cos, sin)
            rate = w[0] * np.array([-x[1], x[0]])
        elif joint.shortname() == "JointModelPlanar":
            c, s = x[2:]
            rate = np.array([c * w[0] - s * w[1], s * w[0] + c * w[1], -s * w[2], c * w[2]])
        elif joint.nq in (4, 7):  # a quaternion x y z w, alone or after a position; w: body axes
            u, r, spin = x[-4:-1], x[-1], w[-3:]
            turn = np.append(0.5 * (r * spin + np.cross(u, spin)), -0.5 * u @ spin)
            body = pin.Quaternion(x[-4:]).toRotationMatrix()
            rate = turn if joint.nq == 4 else np.concatenate([body @ w[:3], turn])
        else:
            raise ValueError(f"no rate for {joint.shortname()}")
        out[joint.idx_q : joint.idx_q + joint.nq] = rate
    return out


@dataclass(frozen=True)
class Run:
    """A motion at the times t (n,): q (n, nq), v (n, nv), multipliers (n, m), energies and work [J] (n,).

    drift: largest |phi| before a projection; misfit: largest of Response.misfit at the times.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    multipliers: np.ndarray
    kinetic: np.ndarray
    potential: np.ndarray
    work_input: np.ndarray
    dissipated: np.ndarray
    work_drive: np.ndarray
    drift: float
    misfit: float

    def imbalance(self) -> np.ndarray:
        """Energy less what was put in [J], 0 in exact arithmetic."""
        total = self.kinetic + self.potential
        return total - total[0] - self.work_input + self.dissipated - self.work_drive


def solve(
    model: pin.Model,
    q0: np.ndarray,
    v0: np.ndarray,
    times: Sequence[float],
    forces: Sequence[Force] = (),
    constraints: Sequence[Constraint] = (),
    rtol: float = 1e-12,
    atol: float = 1e-13,
) -> Run:
    """The motion from (q0, v0) at times[0], by DOP853 from each time to the next; the start is projected too."""
    nq, nv = model.nq, model.nv

    def rhs(t: float, y: np.ndarray) -> np.ndarray:
        q, v = pin.normalize(model, y[:nq]), y[nq : nq + nv]
        now = acceleration(model, q, v, t, forces, constraints)
        return np.concatenate([configuration_rate(model, y[:nq], v), now.a, now.powers])

    q, v, _ = project(model, np.asarray(q0, float), np.asarray(v0, float), times[0], constraints)
    work, drift, states = np.zeros(3), 0.0, [(q, v, np.zeros(3))]
    for start, end in zip(times[:-1], times[1:], strict=True):
        y0 = np.concatenate([q, v, work])
        run = solve_ivp(rhs, (start, end), y0, method="DOP853", rtol=rtol, atol=atol)
        if not run.success:
            raise ArithmeticError(run.message)
        y = run.y[:, -1]
        q, v, left = project(model, pin.normalize(model, y[:nq]), y[nq : nq + nv], end, constraints)
        work, drift = y[nq + nv :], max(drift, left)
        states.append((q, v, work))
    now = [acceleration(model, x, u, t, forces, constraints) for t, (x, u, _) in zip(times, states, strict=True)]
    energy = np.array([energies(model, x, u, forces) for x, u, _ in states])
    work = np.array([w for _, _, w in states])
    return Run(
        t=np.asarray(times, float),
        q=np.array([x for x, _, _ in states]),
        v=np.array([u for _, u, _ in states]),
        a=np.array([n.a for n in now]),
        multipliers=np.array([n.multipliers for n in now]),
        kinetic=energy[:, 0],
        potential=energy[:, 1],
        work_input=work[:, 0],
        dissipated=work[:, 1],
        work_drive=work[:, 2],
        drift=drift,
        misfit=max(n.misfit for n in now),
    )
