"""An environment in the style of Gymnasium: reset(seed), step(action); runs repeat to the bit, and can be tried ahead.

A motor moves the cart of a pendulum, which is to be swung up; a planner tries actions from saved states.

python examples/gym_style.py
"""

from pathlib import Path

import numpy as np

import contactvi as cvi

MODELS = Path(__file__).resolve().parents[1] / "models"


class SwingUp:
    """The pendulum on a cart. Action: motor force, shape (1,), -1..1 of 20 N. Observation (5,): cart's place [m] and
    speed [m/s], cos and sin of the pendulum's angle from straight down, its rate [rad/s]."""

    FORCE, DT, SUBSTEPS, LONGEST, RAIL = 20.0, 5e-3, 20, 40, 1.5  # [N], [s], steps, steps of 0.1 s, [m]

    def __init__(self):
        scene = cvi.Scene()
        scene.add_urdf(MODELS / "cart_pendulum.urdf", limits=False)
        scene.set_joint("slide", limits=(-self.RAIL, self.RAIL), restitution=0.2)  # buffers at the rail's ends
        self.scene, self.simulator = scene, cvi.Simulator(scene, dt=self.DT)
        self.steps = 0

    def reset(self, seed=None, options=None):
        """Start near straight down; return the observation and info."""
        angle, rate = np.random.default_rng(seed).uniform(-0.1, 0.1, 2)
        q0, v0 = self.scene.configuration({"hinge": angle}), self.scene.velocity({"hinge": rate})
        self.simulator.reset(q0, v0)
        self.steps = 0
        return self._observation(), {}

    def step(self, action):
        """Hold the force for SUBSTEPS steps; return observation, reward, terminated, truncated, info."""
        force = self.FORCE * float(np.clip(action, -1, 1)[0])
        status = self.simulator.run(self.SUBSTEPS, np.tile([force, 0.0], (self.SUBSTEPS, 1)))
        self.steps += 1
        place, _, cosine, _, rate = seen = self._observation()
        reward = -cosine - 0.005 * rate**2 - 0.1 * place**2
        info = {"status": status, "impacts": self.simulator.impacts}
        return seen, float(reward), not status.ok, self.steps >= self.LONGEST, info

    def save(self):
        """Return the state, for `load`."""
        return self.simulator.save(), self.steps

    def load(self, state):
        """Go back to a saved state."""
        snapshot, self.steps = state
        self.simulator.load(snapshot)

    def _observation(self):
        (place, angle), (speed, rate) = self.simulator.q, self.simulator.v
        return np.array([place, speed, np.cos(angle), np.sin(angle), rate])


def plan(env, rng, tries=30, ahead=10):
    """Return the first of the best of some random sequences of actions, each tried from the present state."""
    state, best, chosen = env.save(), -np.inf, np.zeros(1)
    for _ in range(tries):
        actions = np.repeat(rng.uniform(-1, 1, (ahead // 2, 1)), 2, axis=0)
        total = sum(env.step(action)[1] for action in actions)
        env.load(state)
        if total > best:
            best, chosen = total, actions[0]
    return chosen


env, rng = SwingUp(), np.random.default_rng(1)
env.reset(seed=7)
actions, seen, rewards = [], [], []
truncated, info = False, {}
while not truncated:
    actions.append(plan(env, rng))
    observation, reward, terminated, truncated, info = env.step(actions[-1])
    seen.append(observation)
    rewards.append(reward)
env.reset(seed=7)  # once more, without the tries between
again = [env.step(action)[0] for action in actions]
equal = np.array_equal(again, seen)
high = -np.min(np.array(seen)[:, 2])
print(f"{len(actions)} actions, mean reward {np.mean(rewards):.3f} (hanging still: -1), highest point {high:.4f} of 1")
print(
    f"{info['impacts']} impacts at the buffers; the same actions again: {'equal to the bit' if equal else 'not equal'}"
)
if not equal or high < 0.9:
    raise SystemExit("the run does not repeat, or the pendulum was not swung up")
