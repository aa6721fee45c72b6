"""The leg of stand.py learns with PPO in this one file (Schulman et al. 2017), with PyTorch alone.

The loop steps sixteen legs in the engine's threads, finds advantages (Schulman et al. 2016) and climbs; an episode that
the time has cut off goes on in the value of its last observation.

python examples/learning/ppo.py [--rounds 60]
"""

import argparse
import time

import numpy as np
import torch
from torch import nn

import contactvi.gym

LEGS, STEPS, EPOCHS, BATCH = 16, 128, 8, 256
GAMMA, LAMBDA, CLIP = 0.98, 0.95, 0.2

parser = argparse.ArgumentParser()
parser.add_argument("--rounds", type=int, default=60)
arguments = parser.parse_args()


def net(inputs, outputs, gain):
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
    for layer, scale in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


torch.manual_seed(0)
torch.set_num_threads(1)
envs = contactvi.gym.make_vec("contactvi/LegStand-v0", LEGS, autoreset_mode="SameStep")
first = envs.reset(seed=0)[0]
width, number = first.shape[1], envs.action_space.sample().shape[1]
actor, critic, log_std = net(width, number, 0.01), net(width, 1, 1.0), nn.Parameter(torch.full((number,), -1.0))
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimizer = torch.optim.Adam(parameters, lr=1e-3, eps=1e-5)


def policy(seen):
    return torch.distributions.Normal(actor(seen), log_std.exp())


def value(seen):
    return critic(torch.as_tensor(np.asarray(seen), dtype=torch.float32)).squeeze(-1)


start, running, returns = time.perf_counter(), np.zeros(LEGS), []
seen = torch.from_numpy(first)
for k in range(arguments.rounds):
    optimizer.param_groups[0]["lr"] = 1e-3 * max(1.0 - k / arguments.rounds, 0.1)
    states, actions, chances, gains = [], [], [], np.zeros((STEPS, LEGS), np.float32)
    values, ends = np.zeros((STEPS + 1, LEGS), np.float32), np.zeros((STEPS, LEGS), bool)
    for step in range(STEPS):
        with torch.no_grad():
            drawn = policy(seen)
            action = drawn.sample()
            values[step] = value(seen)
        states.append(seen)
        actions.append(action)
        chances.append(drawn.log_prob(action).sum(-1))
        after, rewards, terminated, truncated, infos = envs.step(action.numpy())
        running += rewards
        ends[step] = terminated | truncated
        gains[step] = rewards
        for leg in np.flatnonzero(truncated & ~terminated):
            gains[step, leg] += GAMMA * value(infos["final_obs"][leg]).item()
        returns += running[ends[step]].tolist()
        running[ends[step]] = 0.0
        seen = torch.from_numpy(after)
    with torch.no_grad():
        values[STEPS] = value(seen)
    advantages, last = np.zeros((STEPS, LEGS), np.float32), np.zeros(LEGS, np.float32)
    for step in reversed(range(STEPS)):
        error = gains[step] + GAMMA * values[step + 1] * ~ends[step] - values[step]
        advantages[step] = last = error + GAMMA * LAMBDA * ~ends[step] * last
    numbers = (torch.cat(states), torch.cat(actions), torch.cat(chances), torch.from_numpy(advantages.ravel()))
    targets = torch.from_numpy((advantages + values[:STEPS]).ravel())
    for _ in range(EPOCHS):
        for part in torch.randperm(STEPS * LEGS).split(BATCH):
            state, action, chance, advantage = (numbers_of[part] for numbers_of in numbers)
            advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
            ratio = (policy(state).log_prob(action).sum(-1) - chance).exp()
            gain = torch.minimum(ratio * advantage, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * advantage).mean()
            loss = 0.5 * (critic(state).squeeze(-1) - targets[part]).square().mean() - gain
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimizer.step()
    if k % 5 == 4 or k == arguments.rounds - 1:
        minutes = (time.perf_counter() - start) / 60.0
        print(
            f"{(k + 1) * STEPS * LEGS:7d} steps, {minutes:4.1f} min: return {np.mean(returns[-100:]):5.1f}", flush=True
        )
