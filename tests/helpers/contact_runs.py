"""A run with persistent contacts in closed form: a box that slides on a plane and stops, with its contact forces.

It tests the Python API without the engine: what is shown, stored and balanced is known here.
"""

from __future__ import annotations

import numpy as np

import contactvi as cvi
from contactvi.records.contacts import CHANGE_FIELDS, FIELDS, ChangeLog, ContactLog

GRAVITY, MASS, MU, SPEED = 9.81, 2.0, 0.3, 1.5  # m/s^2, kg, -, m/s
SIDE, HEIGHT = 0.4, 0.2  # of the box [m]
STEP, SPAN = 0.02, 1.0  # s
STOP = SPEED / (MU * GRAVITY)  # 0.51 s
CORNERS = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * 0.5 * SIDE


def box_scene() -> cvi.Scene:
    """A box on the ground, friction MU, no rebound."""
    scene = cvi.Scene()
    scene.add_halfspace()
    scene.add_box("box", (SIDE, SIDE, HEIGHT), mass=MASS, placement=(0.0, 0.0, 0.5 * HEIGHT))
    scene.set_contact(restitution=0.0, friction=MU)
    return scene


def place(t: np.ndarray) -> np.ndarray:
    """x of the box [m]."""
    t = np.minimum(t, STOP)
    return SPEED * t - 0.5 * MU * GRAVITY * t**2


def speed(t: np.ndarray) -> np.ndarray:
    return np.maximum(SPEED - MU * GRAVITY * t, 0.0)


def contact_arrays(scene: cvi.Scene) -> dict[str, np.ndarray]:
    """Four corners per step, a quarter of the weight each; friction decelerates the box."""
    (pair,) = scene.pair_names
    sign = 1.0 if pair[1] == "box" else -1.0  # impulses are on the second shape
    rows: dict[str, list] = {name: [] for name in FIELDS}
    for k in range(round(SPAN / STEP)):
        t = k * STEP
        sliding = speed(t) - speed(t + STEP)  # change of speed in the step
        half = 0.125 * MASS * np.array([-sliding, 0.0, GRAVITY * STEP])  # position or velocity impulse of a corner
        for corner, (x, y) in enumerate(CORNERS):
            new = {
                "t": t, "h": STEP, "step": k, "kind": 0, "index": 0, "point": corner,
                "feature": corner,
                "mode": 1 if speed(t + STEP) > 0.0 else 0, "dense": 0, "position": (place(t + STEP) + x, y, 0.0),
                "normal": (0.0, 0.0, sign), "start": sign * half, "end": sign * half, "gap": 0.0,
                "slip": (sign * speed(t + STEP), 0.0, 0.0),
                "work": -0.125 * MASS * sliding * (speed(t) + speed(t + STEP)),
            }  # fmt: skip
            for name, value in new.items():
                rows[name].append(value)
    return {name: np.array(rows[name], dtype=kind) for name, (_, kind) in FIELDS.items()}


def sliding_box(**changes: np.ndarray) -> cvi.Trajectory:
    """The run; `changes` replace arrays of its contacts."""
    scene = box_scene()
    t = np.linspace(0.0, SPAN, round(SPAN / STEP) + 1)
    q = np.tile(scene.neutral(), (len(t), 1))
    q[:, 0] = place(t)
    p = np.zeros((len(t), 6))
    p[:, 0] = MASS * speed(t)
    names = scene.pair_names, list(scene.model.names)
    moves = [(0.0, 0, 0, corner, 0, 0.0) for corner in range(4)] + [(STOP, 0, 0, corner, 2, 0.0) for corner in range(4)]
    changed = dict(zip(CHANGE_FIELDS, map(np.array, zip(*moves, strict=True)), strict=True))
    flight = cvi.simulate(
        scene, q[0] + [0, 0, 1, 0, 0, 0, 0], duration=STEP, dt=STEP
    )  # for the fields that do not matter here
    return cvi.Trajectory(
        scene, cvi.Options(dt=STEP, duration=SPAN), t, q, p, flight.events,
        cvi.Status(cvi.StatusCode.SUCCESS, "the run reached its end", SPAN), cvi.Stats(steps=50, contact_steps=50),
        contacts=ContactLog({**contact_arrays(scene), **changes}, *names),
        changes=ChangeLog({name: changed[name].astype(kind) for name, (_, kind) in CHANGE_FIELDS.items()}, *names),
        phases={"t": np.zeros(1), "dt": np.array([STEP]), "persistent": np.ones(1)},
    )  # fmt: skip
