"""pin.aba under scipy's solve_ivp with event functions: what one writes without a package. setting: method, rtol.

Hands with mimic joints: coupled_scipy.py.
"""

from __future__ import annotations

from collections.abc import Callable

import coupled_scipy
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from worker import Run, coordinate_rate, measure

TOUCH = 1e-9  # m; the cradle's balls touch from the start: their events fire below -TOUCH


Array = np.ndarray


class Touch:
    """A contact of a ball with a plane (normal, offset) or with another ball: its gap and the gap's gradient."""

    def __init__(
        self, model: pin.Model, a: dict, b: dict | None, normal: Array | None = None, offset: float = 0.0
    ) -> None:
        self.model, self.data, self.normal, self.offset = model, model.createData(), normal, offset
        self.balls = [(ball["joint"], np.array(ball["centre"])) for ball in (a, b) if ball]
        self.reach = a["radius"] + (b["radius"] if b else 0.0)

    def centres(self, q: Array) -> list[Array]:
        pin.forwardKinematics(self.model, self.data, q)
        return [self.data.oMi[joint].act(centre) for joint, centre in self.balls]

    def gap(self, q: Array) -> float:
        centres = self.centres(q)
        if self.normal is not None:
            return float(self.normal @ centres[0]) - self.offset - self.reach
        return float(np.linalg.norm(centres[1] - centres[0])) - self.reach

    def row(self, q: Array) -> Array:
        centres, rows = self.centres(q), []
        pin.computeJointJacobians(self.model, self.data, q)
        for joint, centre in self.balls:
            jac = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
            rows.append(jac[:3] - pin.skew(self.data.oMi[joint].rotation @ centre) @ jac[3:])
        if self.normal is not None:
            return self.normal @ rows[0]
        between = centres[1] - centres[0]
        return between / np.linalg.norm(between) @ (rows[1] - rows[0])


def contacts(job: dict, model: pin.Model) -> list[Touch]:
    balls = job["balls"]
    if job["wall"] is not None:
        return [Touch(model, balls[0], None, np.array([-1.0, 0.0, 0.0]), -job["wall"])]
    if job["floor"]:
        return [Touch(model, balls[0], None, np.array([0.0, 0.0, 1.0]))]
    return [Touch(model, a, b) for a, b in zip(balls, balls[1:], strict=False)] if job["neighbours"] else []


def prepare(job: dict, setting: dict) -> Run:
    if job["followers"]:
        return coupled_scipy.prepare(job, setting)
    free = bool(job["base"])
    root = (pin.JointModelFreeFlyer(),) if free else ()
    model = pin.buildModelFromUrdf(job["urdf_file"], *root)
    data, aux, n = model.createData(), model.createData(), model.nq
    joints = [model.joints[model.getJointId(name)] for name in job["joints"]]
    at_q = [*range(7 if free else 0), *(joint.idx_q for joint in joints)]
    at_v = [*range(n, n + 6 if free else n), *(n + joint.idx_v for joint in joints)]
    start = np.zeros(n + model.nv)
    start[at_q], start[at_v] = job["base"] + job["q0"], job["base_v"] + job["v0"]
    touches, tau = contacts(job, model), np.zeros(model.nv)
    slack = TOUCH if len(touches) > 1 else 0.0
    options = {"method": setting["method"], "rtol": setting["rtol"], "atol": 0.1 * setting["rtol"]}
    samples = np.arange(1, round(job["duration"] / job["sample"]) + 1) * job["sample"]

    def rate(_: float, y: Array) -> Array:
        q, v = y[:n], y[n:]
        return np.concatenate([coordinate_rate(q, v, free), pin.aba(model, data, q, v, tau)])

    def event(touch: Touch) -> Callable:
        def value(_: float, y: Array) -> float:
            return touch.gap(y[:n]) + slack

        value.terminal, value.direction = True, -1.0
        return value

    def impact(y: Array) -> Array:
        """Reflect each touching and approaching contact in turn until none approaches."""
        q, v = y[:n], y[n:].copy()
        mass = pin.crba(model, aux, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        rows = [touch.row(q) for touch in touches if touch.gap(q) < 1e-8 + 10 * slack]
        for _ in range(1000):
            hits = [row for row in rows if row @ v < -1e-10]
            if not hits:
                break
            change = np.linalg.solve(mass, hits[0])
            v -= (1.0 + job["restitution"]) * (hits[0] @ v) / (hits[0] @ change) * change
        return np.concatenate([q, v])

    events = [event(touch) for touch in touches]

    def run() -> tuple[Array, Array, dict]:
        parts, y, t, done, evaluations = [], start, 0.0, 0, 0
        for _ in range(5000):
            out = solve_ivp(rate, (t, samples[-1]), y, t_eval=samples[done:], events=events or None, **options)
            evaluations += out.nfev
            if len(out.t):
                parts.append(out.y.T)
                done += len(out.t)
            if out.status != 1:
                break
            k = next(k for k, times in enumerate(out.t_events) if len(times))
            t, y = out.t_events[k][0], impact(out.y_events[k][0])
        states = np.concatenate(parts)
        return states[:, at_q], states[:, at_v], {"evaluations": evaluations}

    return run


if __name__ == "__main__":
    measure(prepare)
