"""A cart with a pole as an environment for learning: reset, step, observation, reward, as Gymnasium has them.

The cart is a prismatic joint with an effort limit; the reward counts the time that the pole stays up. States are saved
and restored to the bit, so that a search may look ahead from where it is. Here a linear feedback does the work.

python examples/balance_env.py
"""

import numpy as np
import pinocchio as pin

import contactvi as cvi


def cart_with_pole() -> cvi.Scene:
    """1 kg on a rail along x, and a pole of 1 m and 0.1 kg, upright at zero."""
    model = pin.Model()
    cart = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "cart")
    model.appendBodyToJoint(cart, pin.Inertia.FromBox(1.0, 0.4, 0.2, 0.1), pin.SE3.Identity())
    pole = model.addJoint(cart, pin.JointModelRY(), pin.SE3.Identity(), "pole")
    centre = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    model.appendBodyToJoint(pole, pin.Inertia.FromCapsule(0.1, 0.02, 1.0), centre)
    scene = cvi.Scene.from_pinocchio(model, name="cart_pole")
    scene.set_joint("cart", limits=(-2.0, 2.0), restitution=0.2, friction=0.05)
    scene.set_joint("pole", damping=0.002)
    scene.set_actuator("cart", effort=10.0)
    return scene


class BalanceEnv:
    """reset(seed) -> (observation, info), step(action) -> (observation, reward, terminated, truncated, info)."""

    def __init__(self, dt: float = 1e-3, frame_skip: int = 20, limit: float = 5.0) -> None:
        self.simulator = cvi.Simulator(cart_with_pole(), dt=dt)
        self.encoders = [cvi.JointEncoder(self.simulator, name) for name in ("cart", "pole")]
        self.frame_skip, self.limit = frame_skip, limit

    def reset(self, seed: int | None = None) -> tuple[np.ndarray, dict]:
        """Start near upright, at random."""
        random = np.random.default_rng(seed)
        self.simulator.reset(random.uniform(-0.05, 0.05, 2), random.uniform(-0.05, 0.05, 2))
        return self._observation(), {}

    def step(self, action: float) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Push the cart with `action` [N] for frame_skip steps."""
        forces = np.tile([action, 0.0], (self.frame_skip, 1))
        status = self.simulator.run(self.frame_skip, forces)
        observation = self._observation()
        fallen = bool(abs(observation[1]) > 0.5) or not status.ok
        late = self.simulator.t > self.limit - 1e-9
        return observation, 0.0 if fallen else 1.0, fallen, late, {"impacts": self.simulator.impacts}

    def _observation(self) -> np.ndarray:
        readings = [encoder.read() for encoder in self.encoders]
        return np.concatenate([[r.q[0] for r in readings], [r.v[0] for r in readings]])


gains = np.array([3.0, 40.0, 4.0, 8.0])  # of cart, pole and their speeds
env = BalanceEnv()
observation, _ = env.reset(seed=1)
total, terminated, truncated = 0.0, False, False
while not (terminated or truncated):
    observation, reward, terminated, truncated, info = env.step(float(gains @ observation))
    total += reward

saved = env.simulator.save()
once = env.step(5.0)[0]
env.simulator.load(saved)
again = env.step(5.0)[0]

print(f"upright for {env.simulator.t:.2f} s, return {total:.0f}, at the end {np.round(observation, 4)}")
print(f"the same step from a saved state, largest difference: {np.abs(once - again).max():g}")
if terminated or np.any(once != again):
    raise SystemExit("the pole fell, or a restored state went another way")
