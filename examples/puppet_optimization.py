"""Winches pull the strings of a puppet so that its limbs follow a desired motion: the optimisation of trep's example.

trep (Johnson, Murphey; its examples/puppet-optimization.py) finds the strings of a marionette for a desired motion,
that of strings pulled by +-0.1 sin(0.6 pi t) m, from strings at rest. Here the puppet is models/puppet.urdf, pulled by
half as much on strings that hang from winches: masses on slides, the targets of whose servos are the inputs. trep moves
the ends of strings exactly. Weights are trep's, 100 for joints and 0.1 for inputs; momenta are left out. scipy's
trust-ncg takes the gradient through the constraints and products with the Gauss-Newton Hessian. trep gives no numbers.

python examples/puppet_optimization.py [PLAYBACK.html]
"""

import sys
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

import contactvi as cvi

MODEL = Path(__file__).resolve().parents[1] / "models" / "puppet.urdf"
DT, HOLD, COUNT = 0.01, 4, 50  # [s]; steps per target; targets per winch: 2 s
# Winch in x and y, end of the string along the body, length [m], sign of the desired pull.
STRINGS = {"left_forearm": (0.3, 0.195, -0.16, 0.85, 1), "right_forearm": (0.3, -0.195, -0.16, 0.85, -1),
           "left_thigh": (0.25, 0.13, -0.2, 1.15, -1), "right_thigh": (0.25, -0.13, -0.2, 1.15, 1)}  # fmt: skip


def puppet() -> tuple[cvi.Scene, np.ndarray]:
    """Return the scene and its configuration at rest."""
    winches = pin.Model()
    for body, (x, y, *_) in STRINGS.items():
        joint = winches.addJoint(0, pin.JointModelPZ(), pin.SE3(np.eye(3), np.array([x, y, 1.9])), f"{body}_winch")
        winches.appendBodyToJoint(joint, pin.Inertia(0.1, np.zeros(3), 1e-4 * np.eye(3)), pin.SE3.Identity())
        winches.addFrame(pin.Frame(f"{body}_drum", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    scene = cvi.Scene.from_pinocchio(winches, name="winches")
    scene.add_urdf(MODEL, base="free", placement=(0, 0, 1), limits=False)
    scene.set_joint("*_winch", limits=False)
    scene.set_servo("*_winch", kp=2000.0, kd=30.0, target=0.0)
    for side, y in (("left", 0.1), ("right", -0.1)):
        scene.add_distance("world", "torso", (0.0, y, 1.9), (0.0, y, 0.17), 0.73, f"{side}_shoulder_string")
    scene.add_distance("world", "torso", (-0.35, 0, 1.9), (-0.05, 0, -0.15), 1.07, "back_string")
    for body, (_, _, z, length, _) in STRINGS.items():
        scene.add_distance(f"{body}_drum", body, (0, 0, 0), (0, 0, z), length, f"{body}_string")
    q = scene.assemble(scene.configuration({"*_swing": 0.5, "*_elbow": 0.8, "*_knee": -0.5}))
    for _ in range(40):  # start again from rest where it is fastest, which is near the equilibrium
        traj = cvi.simulate(scene, q, duration=0.5, dt=DT)
        q = traj.q[np.argmax(traj.kinetic_energy)]
    return scene, q


scene, q0 = puppet()
EACH = np.kron(np.eye(COUNT), np.tile(np.eye(4), (HOLD, 1)))  # from targets to those of all steps
LIMBS = 11  # the first joint behind the winches and the free torso, in q; one less in v


def pulled(x: np.ndarray) -> cvi.Trajectory:
    """Return the run under targets x (COUNT * 4,) [m]."""
    return cvi.simulate(scene, q0, None, COUNT * HOLD * DT, DT, target=(EACH @ x).reshape(-1, 4), record="gradient")


TIMES, SIGNS = HOLD * DT * np.arange(COUNT), [sign for *_, sign in STRINGS.values()]
KNOWN = np.outer(0.05 * np.sin(0.6 * np.pi * TIMES), SIGNS).ravel()
DESIRED = pulled(KNOWN).q[:, LIMBS:]


def sides(off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients in q and v of half of 100 off^2 in the angles of the limbs."""
    return np.pad(100.0 * off, ((0, 0), (LIMBS - 1, 0))), np.zeros((len(off), scene.nv))


def cost(x: np.ndarray) -> float:
    return float(50.0 * np.sum((pulled(x).q[:, LIMBS:] - DESIRED) ** 2) + 0.05 * HOLD * x @ x)


def gradient(x: np.ndarray) -> np.ndarray:
    slopes = cvi.gradient(run := pulled(x), sides(run.q[:, LIMBS:] - DESIRED), ["target"])[1]
    return EACH.T @ slopes["target"].ravel() + 0.1 * HOLD * x


def product(x: np.ndarray, w: np.ndarray) -> np.ndarray:
    second = {"hessp": lambda t, q, v, dq, dv: sides(dq[:, LIMBS - 1 :]), "method": "gauss-newton"}
    made = cvi.hessian_vector(pulled(x), sides(0 * DESIRED), {"target": (EACH @ w).reshape(-1, 4)}, **second)
    return EACH.T @ made.product["target"].ravel() + 0.1 * HOLD * w


start, costs, rest = time.perf_counter(), [], np.zeros(4 * COUNT)
found = minimize(cost, rest, (), "trust-ncg", gradient, hessp=product, callback=lambda x: costs.append(cost(x)),
                 options={"maxiter": 10})  # fmt: skip
print(f"{found.nfev} costs, {found.njev} gradients, {found.nhev} products in {time.perf_counter() - start:.1f} s")
print("costs", *(f"{c:.4g}" for c in [cost(rest), *costs]), f"; of the pulls of the motion {cost(KNOWN):.4g}")
off = np.abs(pulled(found.x).q[:, LIMBS:] - DESIRED).max()
print(f"angles are off by {off:.1e} rad at most, of {np.ptp(DESIRED, axis=0).max():.2f} rad of motion")
w = 1e-5 * np.cos(np.arange(4 * COUNT))
exact, near = gradient(0.5 * found.x) @ w, (cost(0.5 * found.x + w) - cost(0.5 * found.x - w)) / 2
print(f"gradient half way {1e5 * exact:.7f}, by differences {1e5 * near:.7f}")
if len(sys.argv) > 1:
    pulled(found.x).to_html(sys.argv[1], overwrite=True, title="puppet on winches")
assert costs[-1] < 1.001 * cost(KNOWN) < 1e-4 * cost(rest)
assert abs(exact - near) < 1e-5 * abs(exact)
