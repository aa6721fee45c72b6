"""Environments of contactvi for Stable-Baselines3: many of them stepped in the engine's threads.

    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    from contactvi.gym.stable_baselines import ThreadedVecEnv

    envs = make_vec_env("contactvi/LegStand-v0", 16, seed=0, vec_env_cls=ThreadedVecEnv)
    PPO("MlpPolicy", envs).learn(100_000)

Stable-Baselines3 is needed: pip install "contactvi[sb3]".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium

from contactvi.errors import InputError, missing_package
from contactvi.gym.environment import SceneEnv, step_all
from contactvi.gym.vector import ThreadedVectorEnv
from contactvi.inputs import short
from contactvi.threads import Workers

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv
except ImportError:
    raise missing_package("Stable-Baselines3", "sb3") from None


class ThreadedVecEnv(DummyVecEnv):
    """A VecEnv of Stable-Baselines3 whose environments of contactvi are stepped side by side in threads.

    Every number is that of a DummyVecEnv of the same environments, whatever the number of threads. Wrappers do what
    they do there (Monitor, TimeLimit, RescaleAction); one that changes actions has to be a gymnasium.ActionWrapper.

    Args:
        envs: functions that return environments, as `make_vec_env(..., vec_env_cls=ThreadedVecEnv)` gives them; or what
            `gymnasium.make_vec` returns, whose environments are then this one's.
        workers: number of threads; None for one per core, or those of the vector environment.

    Raises:
        InputError: for environments that are not contactvi's, or of unlike frames, and a bad number of threads. In a
            step, for a wrapper that changes actions but is no ActionWrapper.
    """

    def __init__(self, envs: ThreadedVectorEnv | Sequence[Callable[[], Any]], *, workers: int | None = None) -> None:
        if isinstance(envs, ThreadedVectorEnv):
            workers = envs.workers if workers is None else workers
            envs = [lambda env=env: Monitor(env) for env in envs.envs]  # type: ignore[misc]
        self._workers = Workers(workers).number
        super().__init__(list(envs))
        for env in self.envs:
            if not isinstance(env.unwrapped, SceneEnv):
                raise InputError(
                    "An environment that is not stepped by the engine", name="envs",
                    expected="environments of contactvi.gym", got=short(env), remedy="Use DummyVecEnv for it",
                )  # fmt: skip

    def step_wait(self) -> Any:
        """Make the step of all environments at once, then let each with its wrappers take what it is given."""
        actions = [_inner(env, action) for env, action in zip(self.envs, self.actions, strict=True)]
        scenes: list[Any] = [env.unwrapped for env in self.envs]
        for scene, action, result in zip(scenes, actions, step_all(scenes, actions, self._workers), strict=True):
            scene.prepare(action, result)
        return super().step_wait()


def _inner(env: gymnasium.Env[Any, Any], action: Any) -> Any:
    """Return the action that arrives at the innermost environment."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, gymnasium.ActionWrapper):
            action = env.action(action)
        env = env.env
    return action
