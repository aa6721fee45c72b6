"""Error of dense steps and of located events on scenes where both work: largest displacement at the end over the step.

    python benchmarks/dense_accuracy.py

The reference of each scene is a run with located events and a step of 0.125 ms (of the tower: of contact_mode "auto").
Errors are in the tangent space of the configurations: m and rad.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.bench import heaps

STEPS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)
FINE = 1.25e-4
UP = (0.0, 0.0, 1.0)
HAND = Path(__file__).resolve().parents[1] / "models" / "allegro_ball.toml"
Start = tuple[cvi.Scene, np.ndarray, np.ndarray]


def on_the_ground(gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)) -> cvi.Scene:
    """Return a scene with a halfspace."""
    scene = cvi.Scene(gravity=gravity)
    scene.add_halfspace(UP, 0.0, name="ground")
    return scene


def ball(friction: float) -> Start:
    """A ball that bounces three times."""
    scene = on_the_ground()
    scene.add_sphere("ball", radius=0.1, mass=1.0)
    scene.set_contact(restitution=0.6, friction=friction)
    q, v = scene.neutral(), np.zeros(6)
    q[2], v[0] = 0.5, 0.3
    return scene, q, v


def slope(friction: float) -> Start:
    """A box on a slope of 0.3 rad."""
    scene = on_the_ground((9.81 * np.sin(0.3), 0.0, -9.81 * np.cos(0.3)))
    scene.add_box("box", size=(0.2, 0.2, 0.1), mass=1.0)
    scene.set_contact(restitution=0.0, friction=friction)
    q = scene.neutral()
    q[2] = 0.05
    return scene, q, np.zeros(6)


def rocking() -> Start:
    """A block that stands on one edge and falls on the other."""
    scene = on_the_ground()
    scene.add_box("block", size=(0.1, 0.1, 0.3), mass=1.0)
    scene.set_contact(restitution=0.0, friction=0.8)
    q = scene.neutral()
    R = pin.AngleAxis(0.1, np.array([0.0, 1.0, 0.0])).toRotationMatrix()
    q[2] = -min((R @ [x, 0.0, -0.15])[2] for x in (-0.05, 0.05))
    q[3:7] = pin.Quaternion(R).coeffs()
    return scene, q, np.zeros(6)


def cradle() -> Start:
    """Four balls in a row, 1 mm apart, of which the first one moves."""
    scene = cvi.Scene(gravity=(0.0, 0.0, 0.0))
    for k in range(4):
        scene.add_sphere(f"ball{k}", radius=0.1, mass=1.0, placement=(0.201 * k, 0.0, 0.0))
    scene.set_contact(restitution=0.8, friction=0.0)
    v = np.zeros(scene.nv)
    v[0] = 1.0
    return scene, scene.neutral(), v


def tower() -> Start:
    """Six boxes that stand upon each other."""
    return heaps.to_scene(heaps.make("tower", 3, restitution=0.3, friction=0.5))


def hand() -> Start:
    """The Allegro hand, on which the ball falls."""
    scene = cvi.load_scene(HAND)
    return scene, scene.q0, scene.v0


# name -> scene, duration [s]
SCENES: dict[str, tuple[Callable[[], Start], float]] = {
    "bouncing ball": (lambda: ball(0.0), 1.0),
    "bouncing ball, friction 0.5": (lambda: ball(0.5), 1.0),
    "box that slides down a slope": (lambda: slope(0.2), 0.5),
    "box that sticks on a slope": (lambda: slope(0.5), 0.5),
    "rocking block": (rocking, 0.4),
    "cradle of four balls": (cradle, 0.5),
    "tower": (tower, 0.5),
    "hand and ball": (hand, 0.3),
}


def main() -> None:
    """Print the table."""
    warnings.simplefilter("ignore", cvi.DenseStepWarning)
    print("| scene | steps | " + " | ".join(f"{1e3 * dt:g} ms" for dt in STEPS) + " |")
    print("|---|---|" + "---|" * len(STEPS))
    for name, (make, duration) in SCENES.items():
        scene, q, v = make()
        fine = "auto" if name == "tower" else "events"
        exact = cvi.simulate(scene, q, v, duration, dt=FINE, contact_mode=fine).q[-1]
        for title, mode in (("dense", "steps"), ("located events", fine)):
            errors = []
            for dt in STEPS:
                end = cvi.simulate(scene, q, v, duration, dt=dt, contact_mode=mode).q[-1]
                errors.append(np.abs(pin.difference(scene.model, exact, end)).max())
            print(f"| {name} | {title} | " + " | ".join(f"{error:.1e}" for error in errors) + " |", flush=True)


if __name__ == "__main__":
    main()
