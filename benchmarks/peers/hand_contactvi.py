"""S7 in contactvi. setting: order, dt, dt_contact, squeeze (whether it is counted: see hand.py). Timed: simulate() as a
user calls it, all contact forces kept.

The PD controller is the engine's servo where this version has one, else a spring and a damper of the joints, which is
the same law without the effort limit.
"""

from __future__ import annotations

import inspect

import hand
import numpy as np
from worker import Run, steps_per_sample

import contactvi as cvi
from contactvi import _core

# Both the Python API and the engine report it.
SERVO = hasattr(_core.Scene, "set_servo") and "target" in inspect.signature(cvi.simulate).parameters
COUNTS = (
    "steps", "sweeps", "impacts", "seconds", "guards_evaluated", "guards_skipped", "held_steps", "contact_rounds",
    "cone_problems", "cone_iterations", "cone_fallbacks", "contact_seconds",
)  # fmt: skip


def build(job: dict) -> tuple[cvi.Scene, dict]:
    """The scene and what simulate needs for its controller."""
    scene, ball = cvi.Scene(gravity=(0.0, 0.0, -job["gravity"])), job["ball"]
    hand = scene.add_urdf(job["urdf_file"], base="fixed")
    scene.add_sphere("ball", ball["radius"], ball["mass"], placement=job["start"]["q"][16:])
    scene.set_contact(restitution=0.0, friction=job["friction"])
    scene.disable_pair(hand, hand)
    goals = dict(zip(job["joints"], job["goal"], strict=True))
    for name, goal in goals.items():
        if SERVO:
            scene.set_joint(name, damping=0.0, limits=False)
            scene.set_servo(name, job["kp"], job["kd"], effort=job["effort"])
        else:
            scene.set_joint(name, stiffness=job["kp"], damping=job["kd"], rest=goal, limits=False)
    return scene, {"target": [goals[name] for name in scene.servo_joints]} if SERVO else {}


def _places(scene: cvi.Scene, job: dict) -> list[int]:
    """Return the indices of the job's joints in q and in v."""
    return [scene.model.joints[scene.model.getJointId(name)].idx_q for name in job["joints"]]


def _to_world(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The ball's velocities, (N, 6), from its own axes (those of its quaternion q[:, 3:7]) to the world's."""
    vec, w = q[:, 3:6], q[:, 6:7]
    out = []
    for part in (v[:, :3], v[:, 3:]):
        turn = 2.0 * np.cross(vec, part)
        out.append(part + w * turn + np.cross(vec, turn))
    return np.hstack(out)


def prepare(job: dict, setting: dict) -> Run:
    options = dict(setting)
    start, squeeze = options.pop("start", job["start"]), options.pop("squeeze", False)
    scene, control = build(job)
    at, every = _places(scene, job), steps_per_sample(job, setting["dt"])
    q0, v0 = scene.neutral(), np.zeros(scene.nv)
    q0[at], q0[16:19] = start["q"][:16], start["q"][16:]
    v0[at], v0[16:] = start["v"][:16], start["v"][16:]

    def run() -> tuple[np.ndarray, np.ndarray, dict]:
        traj = cvi.simulate(scene, q0, v0, job["duration"], record_every=every, **control, **options)
        counts = {name: getattr(traj.stats, name) for name in COUNTS}
        counts["gap_error"] = -float(traj.contacts.array("gap").min(initial=0.0))  # of every step
        counts["servo"] = SERVO
        if squeeze:
            late = (traj.contacts.h > 0.0) & (traj.contacts.t >= job["duration"] - hand.SQUEEZE - 1e-9)
            counts["squeeze"] = float(traj.contacts.normal_impulse[late].sum()) / hand.SQUEEZE
        q, v = traj.q[1:], traj.v[1:]
        return np.hstack([q[:, at], q[:, 16:19]]), np.hstack([v[:, at], _to_world(q[:, 16:], v[:, 16:])]), counts

    return run
