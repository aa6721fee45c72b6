"""A hand with mimic joints in scipy: DOP853 on the equations in its free joints, which nothing has to hold together.

setting: method, rtol, equations:
- mimic: Pinocchio's own mimic joints, whose crba and nle are in the free joints (its aba has no such joints).
- projected: S^T M S and S^T b of the crba and nle of all joints, with v = S u.

Mass matrices are factored by LAPACK's Cholesky without SciPy's checks, which is the fastest that Python offers.
Pinocchio's mimic joints follow free joints of lower numbers only: chains of followers are composed before, and of
joints that move together the first one is the free one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from scipy.linalg import lapack
from worker import Run

Array = np.ndarray
Equations = Callable[[Array, Array], Array]  # accelerations of the free joints (n,) of their positions and speeds


def composed(followers: dict[str, list], names: list[str]) -> dict[str, tuple[str, float, float]]:
    """The followers of the first joint of each group, in the order of the names: joint: (leader, ratio, offset)."""
    first: dict[str, tuple[str, float, float]] = {}  # by the free joint of the file
    found = {}
    for name in names:
        leader, ratio, offset = name, 1.0, 0.0
        while leader in followers:
            leader, more, shift = followers[leader]
            ratio, offset = ratio * more, offset + ratio * shift
        head, own, start = first.setdefault(leader, (name, ratio, offset))
        if name != head:
            found[name] = (head, ratio / own, offset - ratio / own * start)
    return found


def by_mimic_joints(model: pin.Model, free: list[str], followers: dict[str, tuple[str, float, float]]) -> Equations:
    for name, (leader, ratio, offset) in followers.items():
        model = pin.transformJointIntoMimic(model, model.getJointId(leader), model.getJointId(name), ratio, offset)
    data, at = model.createData(), [model.joints[model.getJointId(name)].idx_v for name in free]
    if at != list(range(len(free))):
        raise ValueError("the free joints are not in the order of the model")

    def accelerate(y: Array, u: Array) -> Array:
        bias = pin.nonLinearEffects(model, data, y, u)
        # In the other convention, Pinocchio 4.1 adds to the last result where a joint follows one of another branch.
        return lapack.dposv(pin.crba(model, data, y, pin.Convention.WORLD), -bias)[1]

    return accelerate


def by_projection(model: pin.Model, c: Array, S: Array) -> Equations:
    data, St = model.createData(), np.ascontiguousarray(S.T)

    def accelerate(y: Array, u: Array) -> Array:
        q = c + S @ y
        bias = St @ pin.nonLinearEffects(model, data, q, S @ u)
        return lapack.dposv(St @ pin.crba(model, data, q) @ S, -bias)[1]

    return accelerate


def prepare(job: dict, setting: dict) -> Run:
    model = pin.buildModelFromUrdf(job["urdf_file"])
    names = list(model.names)[1:]  # in the order of Pinocchio's reader, not in the job's
    followers = composed(job["followers"], names)
    free = [name for name in names if name not in followers]
    c, S = np.zeros(len(names)), np.zeros((len(names), len(free)))
    for k, name in enumerate(names):
        leader, ratio, c[k] = followers.get(name, (name, 1.0, 0.0))
        S[k, free.index(leader)] = ratio
    own = {name: k for k, name in enumerate(names)}
    at = [own[name] for name in job["joints"]]
    begin = np.array([job[key][job["joints"].index(name)] for key in ("q0", "v0") for name in free])
    mimic = setting["equations"] == "mimic"
    accelerate = by_mimic_joints(model, free, followers) if mimic else by_projection(model, c, S)
    samples = np.arange(1, round(job["duration"] / job["sample"]) + 1) * job["sample"]
    options = {"method": setting["method"], "rtol": setting["rtol"], "atol": 0.1 * setting["rtol"]}
    n = len(free)

    def rate(_: float, y: Array) -> Array:
        u = y[n:]
        return np.concatenate([u, accelerate(y[:n], u)])

    def run() -> tuple[Array, Array, dict]:
        out = solve_ivp(rate, (0.0, samples[-1]), begin, t_eval=samples, **options)
        q, v = c + out.y[:n].T @ S.T, out.y[n:].T @ S.T
        return q[:, at], v[:, at], {"evaluations": out.nfev}

    return run
