"""Cases of laws of contact: restitution of three kinds, impacts followed through their impulse, rolling, spinning."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from contactvi.reproduce.check import Check, at_most, near, same
from contactvi.scene.scene import Scene
from contactvi.verify import systems, woodpecker
from contactvi.verify.case import Case, Runs

_POINT = 1e-8  # [m] radius of the ball that stands for a point
_DIGITS = "a point is a ball of 1e-8 m"
# Of `ball_on_waves`, by tests/oracles/surface_ball.py.
_BOUNCES = [0.26983746702406525, 0.7617580313362451, 1.2069460165656505]
_CENTER = [0.18825838925377178, 0.10248485729188399, 0.12624836592804958]
_SLIDE = [0.5151440012863606, 0.31271460486957914, 0.053099501308036035, 0.0, 0.0, 0.0]
_SLID_TO = [0.37048275963659066, 0.7659175699016553, 0.07082441821895792]
_ROLL = [0.394623894791432, 0.18681276529542976, 0.04199672840114495, -2.0, 4.0, 1.0]
_ROLLED_TO = [0.2852671609478495, 0.48742020978711753, 0.10472867720373581]


def super_ball(runs: Runs) -> list[Check]:
    """Walton's closed form: a ball that grips reverses its slip by e_t, one that does not slides through the impact."""
    radius, e, e_t = 0.03, 0.8, 0.5
    v, omega = np.array([1.0, -0.4, -2.0]), np.array([3.0, 20.0, 5.0])
    checks = []
    for mu in (0.3, 0.02):
        scene = Scene((0.0, 0.0, 0.0))
        scene.add_halfspace()
        scene.add_sphere("ball", radius)
        scene.set_contact(restitution=e, friction=mu, tangential_restitution=e_t)
        q = np.array([0.0, 0.0, radius + 0.01, 0.0, 0.0, 0.0, 1.0])
        traj = runs.simulate(scene, q, np.hstack([v, omega]), 0.02, 0.01)
        slip = np.array([v[0] - radius * omega[1], v[1] + radius * omega[0]])
        normal = (1.0 + e) * 2.0
        push = -(1.0 + e_t) * slip * 0.4 / 1.4
        grips = bool(np.linalg.norm(push) <= mu * normal)
        if not grips:
            push = -mu * normal * slip / np.linalg.norm(slip)
        checks += [
            same(f"grips, mu = {mu}", mu == 0.3, grips),
            near(f"impulse [N s], mu = {mu}", [*push, normal], traj.events[0].impulse_vector, 1e-12, "rounding"),
        ]
    return checks


def oblique_rod(runs: Runs) -> list[Check]:
    """Routh's rod: the slip turns back in the impact; closed form, piece by piece (Stronge's energetic law)."""
    checks = []
    for degrees, mu, vx, known in (
        (60.0, 0.6, 0.3, (0.637669779098, 0.075739638401, -1.472635274466)),
        (45.0, 0.2, 0.1, (0.212349979184, -0.338250104082, -2.330906440238)),
    ):
        scene, q = systems.rod_on_ground(math.radians(degrees), _POINT, 0.5, mu)
        scene.set_contact(restitution_law="energetic")
        q[1] += 0.01
        traj = runs.simulate(scene, q, [vx, -1.0, 0.0], 0.02, 0.01)
        found = traj.v[-1] * [1.0, 1.0, -1.0]
        checks.append(near(f"v_x, v_z, omega after, {degrees:g} deg", known, found, 1e-7, _DIGITS))
    return checks


def pendulum_on_ground(runs: Runs) -> list[Check]:
    """Kane and Levinson's double pendulum: by Newton's law it gains energy, by the energetic one it loses some."""
    known = {
        "newton": ((-0.3346489298, 0.3631153642), 1.362e-2),
        "poisson": ((-0.1960551161, 0.2127322652), -1.055e-2),
        "energetic": ((-0.1989323360, 0.2231367854), -1.036e-2),
    }
    checks = []
    for law, (rates, change) in known.items():
        scene, q = _pendulum()
        scene.set_contact(restitution_law=law, limit_energy=False)
        traj = runs.simulate(scene, q, [0.1, 0.1], 0.02, 0.01)
        event = traj.events[0]
        masses = pin.crba(scene.model, scene.model.createData(), event.q)
        found = np.cumsum(-np.linalg.solve(masses, event.p_plus))
        checks += [
            near(f"rates after, {law} [rad/s]", rates, found, 1e-6, _DIGITS),
            near(f"change of energy, {law} [J]", change, -event.loss, 1e-5, "digits given"),
            same(f"{law} is told to gain energy", law == "newton", bool(event.fallback)),
        ]
    scene.set_contact(restitution_law="newton", limit_energy=True)
    event = runs.simulate(scene, q, [0.1, 0.1], 0.02, 0.01).events[0]
    return [*checks, at_most("gain of Newton's law, limited [J]", 1e-12, -event.loss, "given by the law")]


def _pendulum() -> tuple[Scene, np.ndarray]:
    """Two uniform rods m = l = 1 at 20 and 30 degrees from straight down, the end 1e-9 m above the ground."""
    model, joint = systems.empty_model(), 0
    for k, where in enumerate((systems.place(), systems.place(z=-1.0))):
        joint = model.addJoint(joint, pin.JointModelRY(), where, f"joint_{k + 1}")
        inertia = pin.Inertia(1.0, np.array([0.0, 0.0, -0.5]), np.diag([1.0 / 12.0, 1.0 / 12.0, 1e-3]))
        model.appendBodyToJoint(joint, inertia, systems.place())
    angles = np.radians([20.0, 30.0])
    height = -np.cos(angles).sum() - _POINT - 1e-9
    shapes: systems.Shapes = {
        "ground": (0, systems.place(), systems.halfspace(0.0, 0.0, 1.0, height)),
        "end": (joint, systems.place(z=-1.0), coal.Sphere(_POINT)),
    }
    scene = systems.built(model, shapes, [("ground", "end")], 0.5, 0.5)
    # A turn about y takes what hangs towards -x.
    return scene, -np.array([angles[0], angles[1] - angles[0]])


def speed_restitution(runs: Runs) -> list[Check]:
    """A coefficient by a table: each bounce has that of its closing speed, to rounding."""
    scene = Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", 0.1)
    speeds, values = (0.0, 2.0, 9.0), (0.8, 0.6, 0.3)
    scene.set_contact(restitution=list(zip(speeds, values, strict=True)))
    traj = runs.simulate(scene, [0.0, 0.0, 1.1, 0.0, 0.0, 0.0, 1.0], np.zeros(6), 1.5, 0.01)
    before, after = traj.events.array("gamma_minus"), traj.events.array("gamma_plus")
    error = float(np.abs(after + before * np.interp(-before, speeds, values)).max())
    return [at_most("speeds after, largest error [m/s]", 1e-12, error, "rounding")]


def woodpecker_toy(runs: Runs) -> list[Check]:
    """Period and drop of its limit cycle, by events that DOP853 locates; from a state on it, where the sleeve slips."""
    period, drop = 0.14597606514404576, 0.01944537928490946
    with tempfile.TemporaryDirectory() as folder:
        scene = woodpecker.woodpecker(Path(folder))
    q, v = woodpecker.start(
        scene, np.array([0.0, -0.10344827586206894, -0.20513534924352278]), np.array([0.0, 0.0, 17.574666205609134])
    )
    traj = runs.simulate(scene, q, v, 0.15, 2.5e-4, order=8)
    slips = [change.time for change in traj.contact_changes if change.change == "slip"]
    at = scene.q_index("y")
    fallen = float(np.hstack([traj.q[0][at] - traj.at(period).q[at]])[0])
    return [
        near("period [s]", period, slips[-1], 2e-9, "a slip begins by the forces, which are known to fewer digits"),
        near("drop [m]", drop, fallen, 1e-10, "runs with steps of twice this length differ by 5e-12 m"),
        same("impacts", ["upper", "beak", "upper", "lower", "lower"], [e.pair[0][:-2] for e in traj.events]),
    ]


def ball_on_waves(runs: Runs) -> list[Check]:
    """A ball on z = .05 sin 3x cos 3y: bounces of the parabola on the offset surface, sliding and rolling by DOP853."""
    radius, checks = 0.1, []

    def height(p: np.ndarray) -> np.ndarray:
        return 0.05 * np.sin(3.0 * p[:, 0]) * np.cos(3.0 * p[:, 1])

    def gradient(p: np.ndarray) -> np.ndarray:
        x, y = 3.0 * p.T
        return 0.15 * np.stack([np.cos(x) * np.cos(y), -np.sin(x) * np.sin(y)], axis=1)

    def scene(restitution: float, friction: float) -> Scene:
        made = Scene()
        made.add_surface("ground", height=height, gradient=gradient)
        made.add_sphere("ball", radius)
        made.set_contact(restitution=restitution, friction=friction)
        return made

    def start(x: list[float]) -> list[float]:
        return [*x, 0.0, 0.0, 0.0, 1.0]

    traj = runs.simulate(scene(0.9, 0.0), start([0.3, 0.2, 0.5]), [0.4, -0.2, 0.0, 0.0, 0.0, 0.0], 1.6, 0.02)
    times = [event.time for event in traj.events][:3]
    checks.append(near("impacts [s]", _BOUNCES, times, 1e-10, "each impact multiplies the errors before"))
    for what, friction, motion, known in (("slides", 0.0, _SLIDE, _SLID_TO), ("rolls", 2.0, _ROLL, _ROLLED_TO)):
        traj = runs.simulate(scene(0.5, friction), start(_CENTER), motion, 1.0, 0.02, order=8)
        checks.append(near(f"place where it {what} to [m]", known, traj.q[-1, :3], 1e-8, "order 8"))
    return checks


def spinning_down(runs: Runs) -> list[Check]:
    """A ball that spins on its point: the torque is mu r_s N, and it stands still when it has stopped."""
    radius, drill, mu, spin = 0.05, 0.002, 0.3, 3.0
    scene, q = _turning_ball(radius, mu, drill, 0.0)
    traj = runs.simulate(scene, q, [0.0, 0.0, 0.0, 0.0, 0.0, spin], 0.8, 0.01, order=2)
    rate = mu * 9.81 * drill / (0.4 * radius**2)
    (stop,) = (change.time for change in traj.contact_changes if change.change == "stick")
    angle = 2.0 * math.atan2(traj.q[-1, 5], traj.q[-1, 6])
    return [
        near("stop [s]", spin / rate, stop, 1e-9, "the torque is constant"),
        near("angle [rad]", spin**2 / (2.0 * rate), angle, 1e-9, "the torque is constant"),
        at_most("speed afterwards", 1e-12, float(np.abs(traj.v[-1]).max()), "rounding"),
    ]


def rolling_to_a_stop(runs: Runs) -> list[Check]:
    """A ball that rolls: it is slowed by g r_r / (1.4 r), and stands still when it has stopped."""
    radius, rolling, speed = 0.05, 0.001, 0.05
    scene, q = _turning_ball(radius, 0.3, 0.0, rolling)
    traj = runs.simulate(scene, q, [speed, 0.0, 0.0, 0.0, speed / radius, 0.0], 0.6, 0.01, order=2)
    slowing = rolling * 9.81 / (1.4 * radius)
    return [
        near("distance [m]", speed**2 / (2.0 * slowing), traj.q[-1, 0], 1e-9, "the torque is constant"),
        at_most("speed afterwards", 1e-12, float(np.abs(traj.v[-1]).max()), "rounding"),
    ]


def _turning_ball(radius: float, mu: float, spinning: float, rolling: float) -> tuple[Scene, np.ndarray]:
    """A ball of 1 kg that touches the ground, with radii of friction; scene and q."""
    scene = Scene()
    scene.add_halfspace()
    scene.add_sphere("ball", radius)
    scene.set_contact(restitution=0.0, friction=mu, spinning_radius=spinning, rolling_radius=rolling)
    return scene, np.array([0.0, 0.0, radius, 0.0, 0.0, 0.0, 1.0])


def tippe_top(runs: Runs) -> list[Check]:
    """The tippe top of Leine and Glocker rises by its drilling friction; by events that DOP853 locates."""
    dt = 2e-4
    scene, q = _tippe_top()
    coarse, fine = (
        runs.simulate(scene, q, [0.0, 0.0, 0.0, 0.0, 0.0, 180.0], 0.5, h, order=2).q[-1, 3:7] for h in (2.0 * dt, dt)
    )
    theta = [math.acos(1.0 - 2.0 * (x**2 + y**2)) for x, y, _, _ in (coarse, fine)]
    found = (4.0 * theta[1] - theta[0]) / 3.0
    return [near("inclination after .5 s [rad]", 0.5180101458, found, 2e-4, "extrapolated from steps of order 2")]


def _tippe_top() -> tuple[Scene, np.ndarray]:
    """A body of two spheres, of which the large one touches the ground, 0.1 rad inclined; scene and q."""
    joint = pin.JointModelFreeFlyer()
    model = systems.empty_model(9.81)
    body = model.addJoint(0, joint, pin.SE3.Identity(), "top")
    model.appendBodyToJoint(body, pin.Inertia(6e-3, np.zeros(3), np.diag([8e-7, 8e-7, 7e-7])), pin.SE3.Identity())
    shapes = {
        "ground": (0, systems.place(), systems.halfspace(0.0, 0.0, 1.0)),
        "body": (body, systems.place(0.0, 0.0, 0.003), coal.Sphere(0.015)),
        "stem": (body, systems.place(0.0, 0.0, 0.016), coal.Sphere(0.005)),
    }
    scene = systems.built(model, shapes, [("ground", "body"), ("ground", "stem")], 0.0, 0.3)
    scene.set_contact(spinning_radius=3.0 * math.pi / 16.0 * 5e-4)
    tilt = pin.Quaternion(pin.exp3(np.array([0.1, 0.0, 0.0]))).coeffs()
    return scene, np.array([0.0, 0.0, 0.015 - 0.003 * math.cos(0.1), *tilt])


CASES = (
    Case("spinning-down", "a ball that spins on its point is stopped by drilling friction", spinning_down),
    Case("rolling-to-a-stop", "a ball that rolls is stopped by rolling friction", rolling_to_a_stop),
    Case("tippe-top", "the tippe top of Leine and Glocker, friction of slip and spin in one ellipsoid", tippe_top),
    Case("super-ball", "a ball that grips the ground, with tangential restitution", super_ball),
    Case("oblique-rod", "Routh's oblique impact of a rod, the slip turns back", oblique_rod),
    Case("pendulum-on-ground", "Kane and Levinson's double pendulum, three laws of restitution", pendulum_on_ground),
    Case("woodpecker", "Glocker's woodpecker toy with Newton's restitution: its limit cycle", woodpecker_toy),
    Case("speed-restitution", "restitution that falls with the closing speed", speed_restitution),
    Case("ball-on-waves", "a ball on a surface that a function gives: bounces, slides, rolls", ball_on_waves),
)
