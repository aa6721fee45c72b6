"""Mass, restitution and friction of a thrown box from a noisy recording, learned as parameters of PyTorch.

The recording gives place and attitude of the box every 10 ms, with 1 mm and 1 mrad of noise. `contactvi.torch.rollout`
is a differentiable function of the scene's parameters, through bounces with friction, so that torch.optim trains them
like the weights of a network. The longer the flight, the more local minima has the loss, because bounces amplify every
error: the first bounce is fitted first, and the second one from there.

python examples/identify_torch.py      (needs PyTorch: pip install "contactvi[torch]")
"""

import time

import numpy as np
import pinocchio as pin

import contactvi as cvi
from contactvi.torch import rollout

try:
    import torch
except ImportError:
    raise SystemExit('This example needs torch: pip install "contactvi[torch]"') from None

NAMES = ["mass:box", "restitution", "friction"]
TRUTH = torch.tensor([1.3, 0.62, 0.25], dtype=torch.float64)  # mass [kg], restitution, friction
GUESS = torch.tensor([1.0, 0.5, 0.15], dtype=torch.float64)
NOISE = 1e-3  # [m], [rad]
DT, SPANS = 0.01, (0.35, 0.55)  # [s]


def box_on_ground() -> cvi.Scene:
    """A box whose rotational inertia is known: what 1 kg of a solid box would have."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.3, 0.25), pin.SE3.Identity())
    geometry = pin.GeometryModel()
    geometry.addGeometryObject(pin.GeometryObject("shape", joint, pin.SE3.Identity(), pin.hppfcl.Box(0.2, 0.3, 0.25)))
    scene = cvi.Scene.from_pinocchio(model, geometry, name="box")
    scene.add_halfspace()
    scene.set_contact(restitution=0.5, friction=0.15)
    return scene


SCENE = box_on_ground()
START = pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.7, 0.2), np.array([0.0, 0.0, 0.6])))
SPEED = [3.0, 0.5, 0.0, 1.0, -2.0, 0.5]


def throw(values: torch.Tensor, span: float) -> torch.Tensor:
    """Throw the box with the speed and the spin of the recording; return its configurations, (nodes, 7)."""
    named = dict(zip(NAMES, values.split(1), strict=True))
    return rollout(SCENE, START, SPEED, dt=DT, steps=round(span / DT), order=4, parameters=named)[0]


def residual(values: torch.Tensor, span: float) -> torch.Tensor:
    """Return how far the run lies from the recording in place and attitude, over the noise, (nodes, 6)."""
    run = throw(values, span)
    there = RECORDED[: len(run)]
    turn = 2.0 * torch.einsum("nij,nj->ni", TURNS[: len(run)], run[:, 3:])  # of conjugate(recorded) * run, x y z
    return torch.cat([run[:, :3] - there[:, :3], turn], dim=1) / NOISE


random = np.random.default_rng(2)
true = throw(TRUTH, SPANS[-1]).numpy()
noise = NOISE * random.standard_normal((len(true), 6))
RECORDED = torch.tensor(np.array([pin.integrate(SCENE.model, q, w) for q, w in zip(true, noise, strict=True)]))
x, y, z, w = RECORDED[:, 3:].T
TURNS = torch.stack([w, z, -y, -x, -z, w, x, -y, y, -x, w, -z], dim=1).reshape(-1, 3, 4)


def fit(weights: torch.Tensor, span: float) -> None:
    """Train the weights on the recording until a time [s]; the values are exp(0.01 weights) of the guess, all > 0."""
    optimizer = torch.optim.LBFGS([weights], max_iter=60, tolerance_change=1e-9, line_search_fn="strong_wolfe")
    losses: list[float] = []

    def closure() -> float:
        optimizer.zero_grad()
        loss = residual(GUESS * torch.exp(0.01 * weights), span).square().mean()
        loss.backward()
        losses.append(loss.item())
        return losses[-1]

    optimizer.step(closure)
    print(f"{span:.2f} s: loss {losses[0]:.4g} -> {min(losses):.4g} in {len(losses)} runs")


start = time.perf_counter()
weights = torch.zeros(3, dtype=torch.float64, requires_grad=True)
for span in SPANS:
    fit(weights, span)
found = GUESS * torch.exp(0.01 * weights.detach())
jacobian = torch.autograd.functional.jacobian(lambda x: residual(x, SPANS[-1]), found).reshape(-1, len(NAMES))
spread = torch.linalg.inv(jacobian.T @ jacobian).diagonal().sqrt()
for name, value, truth, deviation in zip(NAMES, found, TRUTH, spread, strict=True):
    print(f"{name:12}  found {value:.5f}  true {truth:.5f}  standard deviation {deviation:.5f}")
print(f"{time.perf_counter() - start:.2f} s")
assert torch.all((found - TRUTH).abs() <= 4.0 * spread)  # what is found lies within the noise of the recording
steps = 1e-6 * torch.eye(len(NAMES), dtype=torch.float64)  # and the derivative is that of differences
numbers = torch.stack([(residual(found + s, SPANS[-1]) - residual(found - s, SPANS[-1])) / 2e-6 for s in steps], -1)
assert (jacobian - numbers.reshape(-1, len(NAMES))).abs().max() <= 1e-5 * jacobian.abs().max()
