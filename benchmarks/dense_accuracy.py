"""Error of dense steps and of located events on scenes where both work: largest displacement at the end over the step.

    python benchmarks/dense_accuracy.py [PARTS,OF,NAMES]

The reference of each scene is a run with located events and a step of 0.125 ms (of the tower: of contact_mode "auto").
Errors are in the tangent space of the configurations: m and rad. Order: the slope of log error over log step, of the
errors above 1e-11.
"""

from __future__ import annotations

import math
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import clutter
import coal
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


def ramp(t: float, end: float) -> tuple[float, float, float]:
    """Return what goes from 0 to 1 until `end`, its rate and its acceleration, continuous."""
    s = min(1.0, max(0.0, t / end))
    value, rate = s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * (s * (1.0 - s)) ** 2
    return value, rate / end, 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / end**2


def rods(shapes: pin.GeometryModel, lengths: tuple[float, ...], radius: float) -> pin.Model:
    """Return a chain of hinged rods of 1 kg/m along x, joints j1, j2, ..., with balls at the ends of those before."""
    model, parent = pin.Model(), 0
    for k, length in enumerate(lengths):
        where = pin.SE3(np.eye(3), np.array([lengths[k - 1] if k else 0.0, 0.0, 0.0]))
        parent = model.addJoint(parent, pin.JointModelRY(), where, f"j{k + 1}")
        spread = np.diag([1e-4, length**2 / 12.0, length**2 / 12.0])
        own = pin.Inertia(length, np.array([0.5 * length, 0.0, 0.0]), length * spread)
        model.appendBodyToJoint(parent, own, pin.SE3.Identity())
        if radius and k + 1 < len(lengths):
            at = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
            shapes.addGeometryObject(pin.GeometryObject(f"ball{k + 1}", parent, at, coal.Sphere(radius)))
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    return model


def linkage(lengths: tuple[float, ...], restitution: float, friction: float, joint_friction: float = 0.0) -> Start:
    """A chain of rods that closes with the ground to a loop of one or two freedoms falls on the ground."""
    shapes = pin.GeometryModel()
    model = rods(shapes, lengths, 0.03)
    scene = cvi.Scene.from_pinocchio(model, shapes, name="linkage")
    scene.add_point("world", f"j{len(lengths)}", (0.5, 0.0, 0.0), (lengths[-1], 0.0, 0.0), name="loop")
    scene.add_halfspace(UP, -0.41, name="ground")
    scene.set_contact(restitution=restitution, friction=friction)
    for name in list(scene.model.names)[1:]:
        scene.set_joint(name, friction=joint_friction)
    given = (2.1, -2.34, -0.43) if len(lengths) == 3 else (2.4, -2.1, 0.5, -1.5)
    fixed = ["j1"] if len(lengths) == 3 else ["j1", "j2"]
    q = scene.assemble(scene.configuration({f"j{k + 1}": angle for k, angle in enumerate(given)}), fixed=fixed)
    return scene, q, np.zeros(scene.nv)


def crank(feet: int) -> Start:
    """A driven crank pushes a slider by a rod, and that a table on three or four round feet, off its middle."""
    shapes = pin.GeometryModel()
    model = rods(shapes, (0.1, 0.3), 0.0)
    slider = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(slider, pin.Inertia.FromSphere(0.2, 0.04), pin.SE3.Identity())
    shapes.addGeometryObject(pin.GeometryObject("head", slider, pin.SE3.Identity(), coal.Sphere(0.04)))
    table = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "table")
    model.appendBodyToJoint(table, pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.08), pin.SE3.Identity())
    shapes.addGeometryObject(pin.GeometryObject("top", table, pin.SE3.Identity(), coal.Box(0.1, 0.1, 0.06)))
    front = [(0.04, 0.0)] if feet == 3 else [(0.04, -0.04), (0.04, 0.04)]
    places = [(-0.04, -0.04), (-0.04, 0.04), *front]
    for k, (x, y) in enumerate(places):
        at = pin.SE3(np.eye(3), np.array([x, y, -0.04]))
        shapes.addGeometryObject(pin.GeometryObject(f"foot{k}", table, at, coal.Sphere(0.01)))
    scene = cvi.Scene.from_pinocchio(model, shapes, name="crank")
    scene.add_point("slider", "j2", (0.0, 0.0, 0.0), (0.3, 0.0, 0.0), name="loop")
    scene.add_halfspace(UP, -0.05, name="ground")

    def turn(t: float) -> tuple[float, float, float]:
        angle, rate, acceleration = ramp(t, 0.5)
        return math.pi * (1.0 - 0.9 * angle), -0.9 * math.pi * rate, -0.9 * math.pi * acceleration

    scene.prescribe("j1", turn)
    scene.set_contact(restitution=0.0, friction=0.4)
    scene.set_contact("head", "top", friction=0.0)
    start = {"j1": math.pi, "j2": -math.pi, "slider": 0.2, "table": ((0.29, 0.01, 0.0), (0.0, 0.0, 0.0))}
    return scene, scene.configuration(start), np.zeros(scene.nv)


def gripper() -> Start:
    """A gripper, one finger of which follows the other, takes a ball from the ground; its wrist is driven."""
    scene = on_the_ground()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gripper.urdf"
        path.write_text(clutter.urdf(gantry=True))
        scene.add_urdf(path, self_collision=False)
    scene.add_sphere("ball", radius=0.02, mass=0.05)
    scene.add_joint_equality("right", "left", (0.0, 1.0), name="fingers")
    scene.set_servo("left", kp=2e3, kd=40.0, effort=8.0, target=clutter.OPEN)
    for axis in "xy":
        scene.prescribe(f"wrist_{axis}", lambda t: (0.0, 0.0, 0.0))

    def lift(t: float) -> tuple[float, float, float]:
        height, rate, acceleration = ramp(t - 0.2, 0.3)
        return 0.13 + 0.1 * height, 0.1 * rate, 0.1 * acceleration

    scene.prescribe("wrist_z", lift)
    scene.set_contact(restitution=0.0, friction=0.8)
    q = scene.configuration({"wrist_z": 0.13, "ball": ((0.006, 0.003, 0.03), (0.0, 0.0, 0.0))})
    return scene, q, np.zeros(scene.nv)


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
    "four-bar linkage that bounces": (lambda: linkage((0.4, 0.4, 0.4), 0.8, 0.0), 0.5),
    "four-bar linkage that lands": (lambda: linkage((0.4, 0.4, 0.4), 0.0, 0.3), 0.5),
    "five-bar linkage that lands": (lambda: linkage((0.3, 0.3, 0.3, 0.3), 0.0, 0.3), 0.5),
    "five-bar linkage, joint friction": (lambda: linkage((0.3, 0.3, 0.3, 0.3), 0.0, 0.3, 0.05), 0.5),
    "crank that pushes a table on three feet": (lambda: crank(3), 0.5),
    "crank that pushes a table on four feet": (lambda: crank(4), 0.5),
    "gripper with coupled fingers": (gripper, 0.4),
}


def order(errors: list[float]) -> str:
    """Return the observed order of errors at the STEPS, nothing where they are rounding."""
    known = [(np.log(dt), np.log(error)) for dt, error in zip(STEPS, errors, strict=True) if error > 1e-11]
    return f"{np.polyfit(*np.array(known).T, 1)[0]:.1f}" if len(known) > 2 else "-"


def main() -> None:
    """Print the table."""
    wanted = sys.argv[1].split(",") if len(sys.argv) > 1 else [""]
    warnings.simplefilter("ignore", cvi.DenseStepWarning)
    print("| scene | steps | " + " | ".join(f"{1e3 * dt:g} ms" for dt in STEPS) + " | order |")
    print("|---|---|" + "---|" * (len(STEPS) + 1))
    for name, (make, duration) in SCENES.items():
        if not any(part in name for part in wanted):
            continue
        scene, q, v = make()
        fine = "auto" if name == "tower" else "events"
        exact = cvi.simulate(scene, q, v, duration, dt=FINE, contact_mode=fine).q[-1]
        for title, mode in (("dense", "steps"), ("located events", fine)):
            errors = []
            for dt in STEPS:
                end = cvi.simulate(scene, q, v, duration, dt=dt, contact_mode=mode).q[-1]
                errors.append(np.abs(pin.difference(scene.model, exact, end)).max())
            print(f"| {name} | {title} | " + " | ".join(f"{error:.1e}" for error in errors), end=" | ")
            print(f"{order(errors)} |", flush=True)


if __name__ == "__main__":
    main()
