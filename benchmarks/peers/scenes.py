"""The scenes of compare.py and auto.py as Pinocchio models, and their references; needs pin, numpy, scipy, contactvi.

- S1: double pendulum, massless rods of 1 m, balls of 1 kg, from (1.5, 1.0) rad at rest, 10 s.
- S2: chain of n = 10, 40, 100 rods of 0.1 m and 0.1 kg, axes x and y in turn, from 3/n rad each, 1 s.
- S3: Allegro right hand (example-robot-data), 16 joints, no damping, random speeds of 1 rad/s, 1 s.
- S4: S1's pendulum from (-0.6, -0.9) rad with a ball of 5 cm at the tip, wall at x = 0.5 m, e = 1 and 0.5, 3 s.
- S5: ball of radius 0.1 m falls from 1 m (its centre), e = 1, 10 s.
- S6: five pendulums side by side (Newton's cradle), the first from -30 degrees, e = 1, 10 s.
- panda: Panda arm (fingers locked), talos: Talos (reduced hands) with a free base, both from example-robot-data without
  damping, random speeds of 1 rad/s, 1 s. Nothing was tuned for these two.
- Hands with mimic joints, 1 s: mimic_hands.py.
- ur5, ur10, xarm7, z1: arms of example-robot-data, as the Panda; not among the scenes that compare.py runs by itself.

References: S1 to S4 and the robots DOP853 on pin.aba at rtol 1e-13, impacts by Newton's iteration; S5 exact; hands with
mimic joints the same on the equations in their free joints.

A reference holds q at every multiple of 0.1 s. The reference of S6 is the ideal cradle: the moving ball hands all its
momentum to the last one. The simultaneous impact has no unique answer; this is what the experiment shows.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mimic_hands
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp
from worker import coordinate_rate

from contactvi.importing.paths import resolve_path

SAMPLE = 0.1  # s
GRAVITY = 9.81
BALL = 0.05  # radius of the pendulums' balls [m]
TIGHT = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}


@dataclass
class Scene:
    """A model, its start, balls (joint, centre, radius), contacts, restitution, duration [s]."""

    name: str
    model: pin.Model
    q0: np.ndarray
    v0: np.ndarray
    duration: float
    balls: list[tuple[int, np.ndarray, float]] = field(default_factory=list)
    wall: float | None = None  # the balls stay at x <= wall
    floor: bool = False  # the balls stay at z >= 0
    neighbours: bool = False  # the balls touch their neighbours
    restitution: float = 1.0
    followers: mimic_hands.Followers = field(default_factory=dict)  # joints that follow others

    @property
    def free(self) -> bool:
        """Whether the first joint is a free base."""
        return self.model.nq > self.model.nv

    def distance(self, q: np.ndarray, q_ref: np.ndarray) -> float:
        """Largest distance of the rows [rad, m]: |q - q_ref|, orientations by the rotation between them."""
        if not self.free:
            return float(np.linalg.norm(q - q_ref, axis=1).max())
        unit = [pin.normalize(self.model, row) for row in q]
        return max(float(np.linalg.norm(pin.difference(self.model, a, b))) for a, b in zip(unit, q_ref, strict=True))

    @property
    def samples(self) -> np.ndarray:
        return np.arange(1, round(self.duration / SAMPLE) + 1) * SAMPLE


def pendulum_link(model: pin.Model, parent: int, origin: tuple[float, float, float], name: str) -> int:
    """A ball of 1 kg at the end of a massless rod of 1 m; a positive angle moves it towards +x."""
    axis = pin.JointModelRevoluteUnaligned(0.0, -1.0, 0.0)
    joint = model.addJoint(parent, axis, pin.SE3(np.eye(3), np.array(origin)), name)
    inertia = pin.Inertia(1.0, np.array([0.0, 0.0, -1.0]), 0.4 * BALL**2 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return joint


def double_pendulum() -> pin.Model:
    model = pin.Model()
    first = pendulum_link(model, 0, (0, 0, 0), "j00")
    pendulum_link(model, first, (0, 0, -1), "j01")
    return model


def chain(n: int, length: float = 0.1, mass: float = 0.1, radius: float = 0.01) -> pin.Model:
    model, parent = pin.Model(), 0
    across = mass * length**2 / 12
    inertia = pin.Inertia(
        mass, np.array([0.0, 0.0, -length / 2]), np.diag([across, across, 0.5 * mass * radius**2])
    )  # fmt: skip
    for k in range(n):
        axis = pin.JointModelRX() if k % 2 == 0 else pin.JointModelRY()
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length if k else 0.0]))
        parent = model.addJoint(parent, axis, place, f"j{k:02d}")
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return model


def allegro() -> tuple[pin.Model, np.ndarray, np.ndarray]:
    """The hand without damping, friction and limits; the middle of its ranges; speeds from a fixed seed."""
    path = resolve_path("example-robot-data://robots/allegro_hand_description/urdf/allegro_right_hand.urdf")
    model = pin.buildModelFromUrdf(str(path))
    model.damping[:] = 0.0
    q0, v0 = np.zeros(16), np.zeros(16)
    middle = [0.0, 0.7, 0.75, 0.7] * 3 + [0.83, 0.5, 0.7, 0.75]
    speeds = np.random.default_rng(3).standard_normal(16)
    for k in range(16):
        i = model.joints[model.getJointId(f"joint_{k}.0")].idx_q
        q0[i], v0[i] = middle[k], speeds[k]
    return model, q0, v0


def robot(path: str, locked: tuple[str, ...] = (), free: bool = False) -> tuple[pin.Model, np.ndarray, np.ndarray]:
    """A robot of example-robot-data without damping; the middle of its ranges; speeds from a fixed seed."""
    root = (pin.JointModelFreeFlyer(),) if free else ()
    model = pin.buildModelFromUrdf(str(resolve_path(f"example-robot-data://robots/{path}")), *root)
    if locked:
        model = pin.buildReducedModel(model, [model.getJointId(name) for name in locked], pin.neutral(model))
    for values in (model.damping, model.friction, model.armature):
        values[:] = 0.0
    q0, base = pin.neutral(model), 7 if free else 0
    q0[base:] = 0.5 * (model.lowerPositionLimit + model.upperPositionLimit)[base:]
    return model, q0, np.random.default_rng(3).standard_normal(model.nv)


def cradle() -> pin.Model:
    model = pin.Model()
    for k in range(5):
        pendulum_link(model, 0, (2 * BALL * k, 0.0, 0.0), f"j{k:02d}")
    return model


def ball() -> pin.Model:
    """A point on a vertical axis: the joint is at the ball's centre."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "j00")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    return model


def make(name: str) -> Scene:
    tip = np.array([0.0, 0.0, -1.0])
    if name == "S1":
        scene = Scene(name, double_pendulum(), np.array([1.5, 1.0]), np.zeros(2), 10.0)
    elif name.startswith("S2"):
        n = int(name.removeprefix("S2_n"))
        scene = Scene(name, chain(n), np.full(n, 3.0 / n), np.zeros(n), 1.0)
    elif name == "S3":
        scene = Scene(name, *allegro(), 1.0)
    elif name == "panda":
        fingers = ("panda_finger_joint1", "panda_finger_joint2")
        scene = Scene(name, *robot("panda_description/urdf/panda.urdf", locked=fingers), 1.0)
    elif name == "talos":
        scene = Scene(name, *robot("talos_data/robots/talos_reduced.urdf", free=True), 1.0)
    elif name in ARMS:
        scene = Scene(name, *robot(ARMS[name]), 1.0)
    elif name in mimic_hands.HANDS:
        hand = mimic_hands.HANDS[name]()
        scene = Scene(name, hand.model, *mimic_hands.start(hand), 1.0, followers=hand.followers)
    elif name.startswith("S4"):
        e = {"S4_e1": 1.0, "S4_e05": 0.5}[name]
        scene = Scene(name, double_pendulum(), np.array([-0.6, -0.9]), np.zeros(2), 3.0,
                      balls=[(2, tip, BALL)], wall=0.5, restitution=e)  # fmt: skip
    elif name == "S5":
        scene = Scene(name, ball(), np.ones(1), np.zeros(1), 10.0, balls=[(1, np.zeros(3), 0.1)], floor=True)
    elif name == "S6":
        start = np.array([-np.pi / 6, 0.0, 0.0, 0.0, 0.0])
        scene = Scene(name, cradle(), start, np.zeros(5), 10.0,
                      balls=[(k + 1, tip, BALL) for k in range(5)], neighbours=True)  # fmt: skip
    else:
        raise ValueError(f"no scene {name!r}")
    scene.model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    return scene


ARMS = {
    "ur5": "ur_description/urdf/ur5_robot.urdf", "ur10": "ur_description/urdf/ur10_robot.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf", "z1": "z1_description/urdf/z1.urdf",
}  # fmt: skip
NAMES = ("S1", "S2_n10", "S2_n40", "S2_n100", "S3", "S4_e1", "S4_e05", "S5", "S6", "panda", "talos")


def reference(scene: Scene) -> tuple[np.ndarray, float]:
    """q at the samples, (samples, nv), and an estimate of its own error [rad, m]."""
    if scene.name == "S5":
        return _bounces(scene), 1e-14
    if scene.name == "S6":
        return _ideal_cradle(scene), 1e-11
    solve = _integrate_coupled if scene.followers else _integrate
    states = [solve(scene, bound) for bound in (np.inf, 2e-3)]  # the second one with smaller steps
    return states[0], scene.distance(states[0], states[1])


def _integrate(scene: Scene, max_step: float) -> np.ndarray:
    """DOP853 from sample to sample; an impact is found by Newton's iteration on integrated states, not interpolated."""
    model, data, n = scene.model, scene.model.createData(), scene.model.nq
    tau = np.zeros(model.nv)

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:n], y[n:]
        return np.concatenate([coordinate_rate(q, v, scene.free), pin.aba(model, data, q, v, tau)])

    def flow(y: np.ndarray, h: float) -> np.ndarray:
        return solve_ivp(rate, (0.0, h), y, max_step=max_step, **TIGHT).y[:, -1]

    out, y, t = [], np.concatenate([scene.q0, scene.v0]), 0.0
    crossing = _crossing(scene)
    for end in scene.samples:
        while True:
            run = solve_ivp(rate, (t, end), y, max_step=max_step, events=crossing, **TIGHT)
            if run.status != 1:
                break
            hit, h = run.y_events[0][0], 0.0
            for _ in range(8):  # from the interpolated crossing to one of the flow itself
                state = flow(y, run.t_events[0][0] - t + h)
                gap, row = gap_and_row(scene, state[:n])
                h -= gap / (row @ state[n:])
            hit = flow(y, run.t_events[0][0] - t + h)
            y, t = reflect(scene, hit), run.t_events[0][0] + h
        y, t = run.y[:, -1], end
        out.append(pin.normalize(model, y[:n]))
    return np.array(out)


def _integrate_coupled(scene: Scene, max_step: float) -> np.ndarray:
    options = {"max_step": max_step, **TIGHT}
    return mimic_hands.motion(scene.model, scene.followers, scene.q0, scene.v0, scene.samples, **options)


def _crossing(scene: Scene) -> list:
    if scene.wall is None:
        return []

    def gap(_: float, y: np.ndarray) -> float:
        return gap_and_row(scene, y[: scene.model.nv])[0]

    gap.terminal, gap.direction = True, -1.0
    return [gap]


def gap_and_row(scene: Scene, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Gap of the first ball to the wall and its gradient."""
    joint, centre, radius = scene.balls[0]
    data = scene.model.createData()
    pin.computeJointJacobians(scene.model, data, q)
    arm = data.oMi[joint].rotation @ centre
    jac = pin.getJointJacobian(scene.model, data, joint, pin.LOCAL_WORLD_ALIGNED)
    row = -(jac[:3] - pin.skew(arm) @ jac[3:])[0]
    return float(scene.wall - radius - (data.oMi[joint].translation + arm)[0]), row


def reflect(scene: Scene, y: np.ndarray) -> np.ndarray:
    """Newton's law of impact: normal speed times -e, impulse along the gap's gradient."""
    n = scene.model.nv
    q, v = y[:n], y[n:]
    row = gap_and_row(scene, q)[1]
    mass = pin.crba(scene.model, scene.model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    change = np.linalg.solve(mass, row)
    return np.concatenate([q, v - (1.0 + scene.restitution) * (row @ v) / (row @ change) * change])


def _bounces(scene: Scene) -> np.ndarray:
    fall = np.sqrt(2 * 0.9 / GRAVITY)
    since = (scene.samples + fall) % (2 * fall)
    return (0.1 + GRAVITY * fall * since - 0.5 * GRAVITY * since**2)[:, None]


def _ideal_cradle(scene: Scene) -> np.ndarray:
    inertia = 1.0 + 0.4 * BALL**2
    y, t, out = np.array([scene.q0[0], 0.0]), 0.0, []
    for end in scene.samples:
        y = solve_ivp(lambda _, s: [s[1], -GRAVITY * np.sin(s[0]) / inertia], (t, end), y, **TIGHT).y[:, -1]
        t = end
        out.append(np.eye(5)[0 if y[0] < 0 else 4] * y[0])
    return np.array(out)


def to_urdf(scene: Scene, shapes: dict[int, list[str]] | None = None) -> str:
    """The model as URDF, for peers that read one. Collision geometry: the balls, and `shapes` (URDF, by joint)."""
    model, shapes = scene.model, shapes or {}
    base = "".join(['<link name="base">', *shapes.get(0, []), "</link>"])

    def text(values) -> str:
        return " ".join(repr(float(x)) for x in values)

    out = [f'<robot name="{scene.name}">' + ("" if scene.free else base)]
    for j in range(1, model.njoints):
        inertia, place = model.inertias[j], model.jointPlacements[j]
        moments = " ".join(f'{k}="{float(x)!r}"' for k, x in _components(inertia.inertia))
        out.append(f'<link name="L{j}"><inertial><origin xyz="{text(inertia.lever)}"/><mass value="{inertia.mass!r}"/>'
                   f"<inertia {moments}/></inertial>")  # fmt: skip
        for joint, centre, radius in scene.balls:
            if joint == j:
                out.append(f'<collision><origin xyz="{text(centre)}"/><geometry><sphere radius="{radius!r}"/>'
                           "</geometry></collision>")  # fmt: skip
        out += [*shapes.get(j, []), "</link>"]
        if model.parents[j] == 0 and scene.free:
            continue
        parent = "base" if model.parents[j] == 0 else f"L{model.parents[j]}"
        kind = "prismatic" if model.joints[j].shortname() == "JointModelPZ" else "revolute"
        out.append(f'<joint name="{model.names[j]}" type="{kind}"><parent link="{parent}"/><child link="L{j}"/>'
                   f'<origin xyz="{text(place.translation)}" rpy="{text(pin.rpy.matrixToRpy(place.rotation))}"/>'
                   f'<axis xyz="{text(axis(model.joints[j]))}"/><limit lower="-1e4" upper="1e4" effort="1e6" '
                   f'velocity="1e6"/>{_mimic(scene, model.names[j])}</joint>')  # fmt: skip
    return "\n".join([*out, "</robot>"])


def _mimic(scene: Scene, joint: str) -> str:
    if joint not in scene.followers:
        return ""
    leader, ratio, offset = scene.followers[joint]
    return f'<mimic joint="{leader}" multiplier="{ratio!r}" offset="{offset!r}"/>'


def _components(moment: np.ndarray) -> list[tuple[str, float]]:
    return [(f"i{'xyz'[a]}{'xyz'[b]}", moment[a, b]) for a in range(3) for b in range(a, 3)]


def axis(joint: pin.JointModel) -> np.ndarray:
    """The joint's axis in its own frame: the moving part of its motion subspace."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq), np.zeros(joint.nv))
    subspace = np.asarray(data.S).reshape(6)
    return subspace[:3] + subspace[3:]
