"""Mass, restitution and friction of a thrown box from a noisy recording of its flight, by least squares.

The recording gives place and attitude of the box every 10 ms, with 1 mm and 1 mrad of noise. A run from a guess has
exact derivatives through its bounces (record="gradient"), so that scipy's solver needs no differences. The longer the
flight, the more local minima has the fit, because bounces amplify every error: the first bounce is fitted first, and
the second one from there. What is found is compared with the truth and with the standard deviations that the Jacobian
predicts.

python examples/identify_box.py
"""

import time
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

import contactvi as cvi

TRUTH = np.array([1.3, 0.62, 0.25])  # mass [kg], restitution, friction
NAMES = ["mass:box", "restitution", "friction"]
NOISE = 1e-3  # [m], [rad]
DT, SPANS = 0.01, (0.35, 0.55)  # [s]


def box(parameters: np.ndarray) -> cvi.Scene:
    """A box on the ground; its rotational inertia is known, 1 kg of it would be that of a solid box."""
    mass, restitution, friction = parameters
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    inertia = pin.Inertia.FromBox(1.0, 0.2, 0.3, 0.25)
    model.appendBodyToJoint(joint, pin.Inertia(mass, inertia.lever, inertia.inertia), pin.SE3.Identity())
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("shape", joint, pin.SE3.Identity(), pin.hppfcl.Box(0.2, 0.3, 0.25)))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="box")
    scene.add_halfspace()
    scene.set_contact(restitution=restitution, friction=friction)
    return scene


def throw(parameters: np.ndarray, span: float = SPANS[-1]) -> cvi.Trajectory:
    """Throw it with the speed and the spin of the recording, and run so long [s]."""
    scene = box(parameters)
    q = scene.neutral()
    q[:7] = pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.7, 0.2), np.array([0.0, 0.0, 0.6])))
    return cvi.simulate(scene, q, [3.0, 0.5, 0.0, 1.0, -2.0, 0.5], span, DT, order=4, record="gradient")


def residual(parameters: np.ndarray, span: float) -> np.ndarray:
    """Return how far the run lies from the recording, as tangent vectors over the noise."""
    run = throw(parameters, span)
    return np.concatenate([pin.difference(MODEL, a, b) for a, b in zip(RECORDED, run.q, strict=False)]) / NOISE


def jacobian(parameters: np.ndarray, span: float) -> np.ndarray:
    """Return its derivative, (residuals, 3)."""
    run = throw(parameters, span)
    exact = run.sensitivity(NAMES).matrix[:, :6]  # d q, tangent at the run's configurations
    rows = [pin.dDifference(MODEL, a, b)[1] @ d for a, b, d in zip(RECORDED, run.q, exact, strict=False)]
    return np.concatenate(rows) / NOISE


MODEL = box(TRUTH).model
random = np.random.default_rng(2)
truth = throw(TRUTH)
RECORDED = [pin.integrate(MODEL, q, NOISE * random.standard_normal(6)) for q in truth.q]
start = time.perf_counter()
guess, runs = np.array([1.0, 0.5, 0.15]), 0
settings: dict[str, Any] = {"jac": jacobian, "bounds": ([0.1, 0.0, 0.0], [10.0, 1.0, 2.0]), "x_scale": "jac"}
for span in SPANS:
    found = least_squares(residual, guess, args=(span,), **settings)
    guess, runs = found.x, runs + found.nfev + found.njev
seconds = time.perf_counter() - start
spread = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
print(f"{len(truth.events)} impacts; {runs} runs in {seconds:.2f} s")
for name, value, true, deviation in zip(NAMES, found.x, TRUTH, spread, strict=True):
    print(f"{name:12}  found {value:.5f}  true {true:.5f}  standard deviation {deviation:.5f}")
assert found.success
assert np.all(np.abs(found.x - TRUTH) <= 4.0 * spread)  # what is found lies within the noise of the recording
