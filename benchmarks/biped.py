"""A biped of linkages.py: two legs, each closed by a loop, on a trunk that stands still or flies; and its equations.

Each leg has a hip with two axes, a thigh, a shank that is moved by a crank on the thigh through a rod (a four-bar,
whose crank can turn all the way round), and a foot. The crank has the reflected inertia of a geared motor. Masses and
lengths are made up: some 70 cm of leg, 5 kg each.

The four-bar lies in the plane of thigh and shank. With angles about y from the thigh's x axis, alpha of the crank, psi
of the rod, kappa of the shank, and e(x) = (cos x, sin x) in x and -z,

    A + a e(alpha) + b e(psi) = K + c e(kappa),

psi and kappa follow from alpha by the triangle of K, the end of the crank and the pin, and so do their rates.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from scipy.linalg import lapack

import contactvi as cvi

sys.path.insert(0, str(Path(__file__).parent / "peers"))
from worker import coordinate_rate

CRANK, ROD, LEVER = 0.06, 0.36, 0.1  # a, b, c [m]
PIVOT, KNEE = (0.05, 0.05), (0.0, 0.4)  # A and K in the thigh, x and -z [m]
ROTOR = 0.03  # reflected inertia of a crank's motor [kg m^2]
GRAVITY = 9.81
DURATION = 1.0  # s
FREE = ("roll", "hip", "crank", "foot")  # joints of a leg that are free; rod and shank follow
Array = np.ndarray
Angles = tuple[float, float, float, float, float, float]


def four_bar(alpha: float, rate: float) -> Angles:
    """Return psi and kappa, their derivatives by alpha, and their accelerations where alpha has none."""
    x, z = PIVOT[0] + CRANK * math.cos(alpha) - KNEE[0], PIVOT[1] + CRANK * math.sin(alpha) - KNEE[1]
    s2 = x * x + z * z
    kappa = math.atan2(z, x) + math.acos((LEVER**2 + s2 - ROD**2) / (2.0 * LEVER * math.sqrt(s2)))
    psi = math.atan2(LEVER * math.sin(kappa) - z, LEVER * math.cos(kappa) - x)
    across = math.sin(psi - kappa)
    kappa1 = CRANK * math.sin(psi - alpha) / (LEVER * across)
    psi1 = CRANK * math.sin(kappa - alpha) / (ROD * across)
    crank, rod, lever = CRANK, ROD * psi1**2, LEVER * kappa1**2
    turn = rate * rate / across
    kappa2 = (lever * math.cos(kappa - psi) - crank * math.cos(alpha - psi) - rod) / LEVER * turn
    psi2 = (lever - crank * math.cos(alpha - kappa) - rod * math.cos(psi - kappa)) / ROD * turn
    return psi, kappa, psi1, kappa1, psi2, kappa2


def model(flies: bool) -> pin.Model:
    """The tree without its loops; joints of a leg: roll, hip, crank, rod, shank, foot."""
    made, trunk = pin.Model(), 0

    def add(parent: int, kind: pin.JointModel, at: tuple, name: str, mass: float, com: tuple, size: tuple) -> int:
        joint = made.addJoint(parent, kind, pin.SE3(np.eye(3), np.array(at)), name)
        about = pin.Inertia.FromBox(mass, *size).inertia
        made.appendBodyToJoint(joint, pin.Inertia(mass, np.array(com), about), pin.SE3.Identity())
        return joint

    y = pin.JointModelRY
    if flies:
        trunk = add(0, pin.JointModelFreeFlyer(), (0.0, 0.0, 0.0), "trunk", 15.0, (0.02, 0.0, 0.1), (0.2, 0.3, 0.4))
    for side, name in ((1.0, "left"), (-1.0, "right")):
        at = (0.0, 0.1 * side, -0.1)
        roll = add(trunk, pin.JointModelRX(), at, f"{name}_roll", 1.0, (0.0, 0.0, -0.02), (0.08, 0.08, 0.08))
        at = (0.0, 0.02 * side, -0.05)
        hip = add(roll, y(), at, f"{name}_hip", 2.2, (0.0, 0.0, -0.16), (0.08, 0.07, 0.38))
        at = (PIVOT[0], 0.0, -PIVOT[1])
        crank = add(hip, y(), at, f"{name}_crank", 0.2, (0.5 * CRANK, 0.0, 0.0), (CRANK, 0.02, 0.02))
        add(crank, y(), (CRANK, 0.0, 0.0), f"{name}_rod", 0.2, (0.5 * ROD, 0.0, 0.0), (ROD, 0.02, 0.02))
        at = (KNEE[0], 0.0, -KNEE[1])
        shank = add(hip, y(), at, f"{name}_shank", 1.2, (0.0, 0.0, -0.15), (0.06, 0.05, 0.34))
        add(shank, y(), (0.0, 0.0, -0.32), f"{name}_foot", 0.5, (0.03, 0.0, -0.04), (0.16, 0.06, 0.03))
        made.armature[made.joints[crank].idx_v] = ROTOR
    made.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    return made


class Biped:
    """The biped in the coordinates that are left: of the trunk, if it flies, and four joints of each leg."""

    def __init__(self, flies: bool) -> None:
        self.flies, self.model = flies, model(flies)
        self.data = self.model.createData()
        self.base_q, self.base_v = (7, 6) if flies else (0, 0)
        self.at_q = [*range(self.base_q), *(self.base_q + 6 * leg + k for leg in (0, 1) for k in (0, 1, 2, 5))]
        at_v = [*range(self.base_v), *(self.base_v + 6 * leg + k for leg in (0, 1) for k in (0, 1, 2, 5))]
        self.nq, self.nv = len(self.at_q), len(at_v)
        self.S = np.zeros((self.model.nv, self.nv))
        self.S[at_v, np.arange(self.nv)] = 1.0
        self.full, self.bias = np.zeros(self.model.nq), np.zeros(self.model.nv)

    def place(self, y: Array, u: Array | None = None) -> Array:
        """Return q of all joints; with speeds also set S and the accelerations S' u."""
        q, S, bias = self.full, self.S, self.bias
        q[self.at_q] = y
        for leg in (0, 1):
            own, row, col = self.base_q + 6 * leg, self.base_v + 6 * leg, self.base_v + 4 * leg + 2
            alpha, rate = float(q[own + 2]), 0.0 if u is None else float(u[col])
            psi, kappa, psi1, kappa1, psi2, kappa2 = four_bar(alpha, rate)
            q[own + 3], q[own + 4] = psi - alpha, kappa
            S[row + 3, col], S[row + 4, col] = psi1 - 1.0, kappa1
            bias[row + 3], bias[row + 4] = psi2, kappa2
        return q

    def start(self) -> tuple[Array, Array]:
        """y and u: legs astride, random speeds of 1 rad/s and m/s from a fixed seed."""
        base = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0] if self.flies else []
        y = np.array([*base, 0.05, -0.4, 0.5, 0.2, -0.05, 0.3, 1.5, -0.1])
        return y, np.random.default_rng(3).standard_normal(self.nv)

    def all_joints(self, y: Array, u: Array) -> tuple[Array, Array]:
        """Return q and v of all joints."""
        q = self.place(y, u).copy()
        return q, self.S @ u

    def rate(self, _: float, x: Array) -> Array:
        """x = (y, u) and its derivative: S^T M S u' = -S^T (M S' u + b)."""
        y, u = x[: self.nq], x[self.nq :]
        q, S = self.place(y, u), self.S
        force = S.T @ pin.rnea(self.model, self.data, q, S @ u, self.bias)
        mass = S.T @ pin.crba(self.model, self.data, q) @ S
        return np.concatenate([coordinate_rate(y, u, self.flies), lapack.dposv(mass, -force)[1]])

    def scene(self) -> cvi.Scene:
        """The scene of contactvi: the tree, and a point in which rod and shank are joined in each leg."""
        scene = cvi.Scene.from_pinocchio(self.model)
        for name in ("left", "right"):
            scene.add_point(f"{name}_rod", f"{name}_shank", (ROD, 0.0, 0.0), (LEVER, 0.0, 0.0), name=f"{name}_loop")
        return scene

    def by_constraints(self) -> Callable[[float, Array], Array]:
        """The rate of (q, v) of all joints with Pinocchio's constraintDynamics, in which the loops are constraints."""
        robot, data = self.model, self.model.createData()
        loops, kept = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for name in ("left", "right"):
            rod, shank = robot.getJointId(f"{name}_rod"), robot.getJointId(f"{name}_shank")
            ends = [pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])) for length in (ROD, LEVER)]
            loops.append(
                pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, robot, rod, ends[0], shank, ends[1], pin.LOCAL)
            )
            kept.append(loops[-1].createData())
        settings = pin.ProximalSettings(1e-14, 1e-10, 10)
        pin.initConstraintDynamics(robot, data, loops, kept)
        tau, n = np.zeros(robot.nv), robot.nq

        def rate(_: float, x: Array) -> Array:
            q, v = x[:n], x[n:]
            turned = pin.constraintDynamics(robot, data, q, v, tau, loops, kept, settings)
            return np.concatenate([coordinate_rate(q, v, self.flies), turned])

        return rate


def integrate(rate: Callable[[float, Array], Array], start: Array, tol: float) -> tuple[Array, Array]:
    """Return t (n,) and the states (n, nx) of DOP853 at a tolerance."""
    found = solve_ivp(rate, (0.0, DURATION), start, method="DOP853", rtol=tol, atol=tol)
    return found.t, found.y.T


def distance(robot: pin.Model, q: Array, q_ref: Array) -> float:
    """Largest error [rad, m] of any joint, of the trunk's place and of its orientation; rows are configurations."""
    rows = [
        pin.difference(robot, pin.normalize(robot, a), pin.normalize(robot, b)) for a, b in zip(q, q_ref, strict=True)
    ]
    return float(np.abs(rows).max())
