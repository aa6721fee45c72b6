"""The leg of stand.py learns with rl_games: its vector environment on contactvi's threads, in thirty lines.

rl_games asks for `step`, `reset` and `get_env_info`, wants episodes to start again by themselves, and takes what was
cut off by the time from infos["time_outs"].

pip install rl-games, then: python examples/learning/rl_games_stand.py [--epochs 80]
"""

import argparse
import tempfile

import numpy as np
import torch
from rl_games.common import env_configurations, vecenv
from rl_games.common.algo_observer import DefaultAlgoObserver
from rl_games.common.ivecenv import IVecEnv
from rl_games.torch_runner import Runner

import contactvi.gym

parser = argparse.ArgumentParser()
parser.add_argument("--epochs", type=int, default=80)
arguments = parser.parse_args()


class ThreadedIVecEnv(IVecEnv):
    """Environments of contactvi as rl_games steps them."""

    def __init__(self, config_name, num_actors, **kwargs):
        kwargs.pop("seed", None)
        name = env_configurations.configurations[config_name]["env_creator"]()
        self.envs = contactvi.gym.make_vec(name, num_actors, autoreset_mode="SameStep", **kwargs)

    def reset(self):
        return torch.from_numpy(self.envs.reset(seed=0)[0])

    def step(self, actions):
        seen, rewards, terminated, truncated, infos = self.envs.step(np.asarray(actions))
        numbers = (seen, rewards.astype(np.float32), terminated | truncated, truncated & ~terminated)
        seen, rewards, ended, cut = map(torch.from_numpy, numbers)
        return seen, rewards, ended, {"time_outs": cut}

    def get_env_info(self):
        envs = self.envs
        return {"observation_space": envs.single_observation_space, "action_space": envs.single_action_space}


class Returns(DefaultAlgoObserver):
    """Prints the mean return after every tenth round."""

    last = float("nan")

    def after_print_stats(self, frame, epoch, total_time):
        super().after_print_stats(frame, epoch, total_time)
        if self.algo.game_rewards.current_size:
            Returns.last = float(self.algo.game_rewards.get_mean()[0])
            if epoch % 10 == 0:
                print(f"{frame:7d} steps, {total_time / 60.0:4.1f} min: return {Returns.last:5.1f}", flush=True)


vecenv.register("CONTACTVI", lambda name, number, **kwargs: ThreadedIVecEnv(name, number, **kwargs))
env_configurations.register("leg", {"vecenv_type": "CONTACTVI", "env_creator": lambda: "contactvi/LegStand-v0"})
mlp = {"units": [64, 64], "activation": "elu", "initializer": {"name": "default"}, "regularizer": {"name": "None"}}
normal = {
    "mu_activation": "None", "sigma_activation": "None", "mu_init": {"name": "default"},
    "sigma_init": {"name": "const_initializer", "val": -1.0}, "fixed_sigma": True,
}  # fmt: skip
runner = Runner(Returns())
runner.load({
    "params": {
        "seed": 0,
        "torch_threads": 1,
        "algo": {"name": "a2c_continuous"},
        "model": {"name": "continuous_a2c_logstd"},
        "network": {"name": "actor_critic", "separate": True, "space": {"continuous": normal}, "mlp": mlp},
        "config": {
            "name": "leg", "env_name": "leg", "device": "cpu", "device_name": "cpu", "num_actors": 16,
            "print_stats": False, "torch_compile": False, "train_dir": tempfile.mkdtemp(),
            "max_epochs": arguments.epochs, "horizon_length": 128, "minibatch_size": 512, "mini_epochs": 6, "ppo": True,
            "learning_rate": 1e-3, "lr_schedule": "None", "gamma": 0.98, "tau": 0.95, "e_clip": 0.2, "clip_value": True,
            "normalize_input": True, "normalize_value": True, "normalize_advantage": True, "value_bootstrap": True,
            "critic_coef": 1.0, "entropy_coef": 0.0, "bounds_loss_coef": 0.0, "grad_norm": 1.0, "truncate_grads": True,
            "reward_shaper": {"scale_value": 0.1}, "score_to_win": 1e9, "save_frequency": 0, "save_best_after": 10**9,
        },
    }
})  # fmt: skip
runner.run({"train": True, "play": False})
print(f"{arguments.epochs * 16 * 128} steps: return {Returns.last:.1f}")
