"""A leg learns to stand on its foot while it is pushed: PPO of Stable-Baselines3, sixteen legs in the engine's threads.

With targets that stay where they are the leg falls after a second or two. Prints the mean return of an episode (200 at
most) as it grows, and compares the policy with those targets on episodes that it has not seen.

python examples/learning/stand.py [--steps 100000] [--curve CURVE.png] [--save POLICY.zip]
"""

import argparse
import time
import warnings

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import contactvi.gym
from contactvi.gym.stable_baselines import ThreadedVecEnv

NAME = "contactvi/LegStand-v0"

parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=100_000)
parser.add_argument("--curve")
parser.add_argument("--save")
arguments = parser.parse_args()


class Curve(BaseCallback):
    """Keeps the mean return of the last hundred episodes after every round."""

    def __init__(self):
        super().__init__()
        self.steps, self.returns, self.start = [], [], time.perf_counter()

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        if self.model.ep_info_buffer:
            self.steps.append(self.num_timesteps)
            self.returns.append(float(np.mean([episode["r"] for episode in self.model.ep_info_buffer])))
            if len(self.steps) % 10 == 1:
                minutes = (time.perf_counter() - self.start) / 60.0
                print(f"{self.steps[-1]:7d} steps, {minutes:4.1f} min: return {self.returns[-1]:5.1f}", flush=True)


def measured(policy, episodes=20):
    """Return the mean return of episodes with seeds of their own, and the share that was not ended by a fall."""
    envs = contactvi.gym.make_vec(NAME, episodes, autoreset_mode="Disabled")
    seen, _ = envs.reset(seed=10_000)
    total, fallen = np.zeros(episodes), np.zeros(episodes, bool)
    for _ in range(200):
        seen, rewards, terminated, truncated, _ = envs.step(policy(seen))
        total += np.where(fallen, 0.0, rewards)
        fallen |= terminated
        if terminated.any() and not truncated.all():
            seen, _ = envs.reset(options={"reset_mask": terminated})
    return float(total.mean()), float(1.0 - fallen.mean())


def hold(seen):
    return np.zeros((len(seen), 3), np.float32)


torch.set_num_threads(1)
warnings.filterwarnings("ignore", message=".*run PPO on the GPU.*")
envs = make_vec_env(NAME, 16, seed=0, env_kwargs={"render_mode": None}, vec_env_cls=ThreadedVecEnv)
model = PPO(
    "MlpPolicy", envs, n_steps=128, batch_size=256, n_epochs=8, learning_rate=lambda left: 1e-3 * max(left, 0.1),
    gamma=0.98, gae_lambda=0.95, policy_kwargs={"log_std_init": -1.0, "net_arch": [64, 64]}, seed=0, device="cpu",
)  # fmt: skip
curve = Curve()
model.learn(arguments.steps, callback=curve)
minutes = (time.perf_counter() - curve.start) / 60.0
before, after = measured(hold), measured(lambda seen: model.predict(seen, deterministic=True)[0])
print(f"{curve.num_timesteps} steps in {minutes:.1f} min")
print(f"targets that stay: return {before[0]:.1f}, {before[1]:.0%} of episodes without a fall")
print(f"policy:            return {after[0]:.1f}, {after[1]:.0%} of episodes without a fall")

if arguments.save:
    model.save(arguments.save)
if arguments.curve:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axis = figure.subplots()
    axis.plot(np.array(curve.steps) / 1e3, curve.returns, color="#1f5fa8", label="PPO, mean of the last 100 episodes")
    axis.axhline(before[0], color="0.5", ls="--", label="targets that stay")
    axis.set(xlabel="steps of the environment [thousands]", ylabel="return of an episode", ylim=(0, 205))
    axis.set_title(f"{NAME}: {minutes:.1f} minutes on two cores")
    axis.legend(loc="lower right")
    axis.grid(alpha=0.25)
    figure.savefig(arguments.curve, dpi=110)
